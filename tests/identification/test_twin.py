"""Claims about the twin of the paper's arm. Truth: Table 3 as printed, its torque by Pinocchio, MuJoCo's own checks."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from daemon.cli.app import main
from identification.excitation.nominal import table_three
from identification.export.twin import Twin, twin_of_table_three
from identification.physical_parameters import PhysicalParameters
from identification.robots import load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics


@pytest.fixture(scope="module")
def twin() -> Twin:
    return twin_of_table_three()


def test_the_shipped_table_is_the_printed_one(table3: PhysicalParameters) -> None:
    mine = table_three()
    for name in ("mass", "center_of_mass", "inertia", "viscous", "coulomb"):
        np.testing.assert_array_equal(getattr(mine, name), getattr(table3, name))


def test_table_three_as_printed_is_no_arm_and_its_twin_is(table3: PhysicalParameters, twin: Twin) -> None:
    def slack(physical: PhysicalParameters) -> np.ndarray:
        moments = np.linalg.eigvalsh(physical.inertia)
        return moments[:, 0] + moments[:, 1] - moments[:, 2]

    assert [link + 1 for link in np.flatnonzero(slack(table3) < -1e-5)] == [4, 7]
    assert np.all(slack(twin.settled.physical) > 0.0)


def test_on_a_motion_nobody_used_its_torque_is_that_of_table_three(table3: PhysicalParameters, twin: Twin) -> None:
    robot = load_robot("iiwa14")
    states = fourier_motion(7, period_s=10.0, samples=400, seed=8)
    difference = inverse_dynamics(robot, twin.settled.physical, *states) - inverse_dynamics(robot, table3, *states)
    assert np.sqrt(np.mean(difference**2, axis=0)).max() < 0.002  # Nm; the arm's sensors resolve 0.03


def test_the_command_writes_what_simulators_take_without_mending(tmp_path: Path, twin: Twin) -> None:
    with pytest.raises(SystemExit) as end:
        main(["twin", "--out", str(tmp_path), "--json", str(tmp_path / "twin.json")])
    assert end.value.code in (0, None)
    # MuJoCo refuses inertias that violate the triangle inequality unless it is told to balance them.
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "iiwa14.xml"))
    assert model.body_mass[-7:] == pytest.approx(twin.settled.physical.mass, rel=1e-9)
    assert model.dof_frictionloss == pytest.approx(twin.settled.physical.coulomb, rel=1e-9)
    written = json.loads((tmp_path / "twin.json").read_text(encoding="utf-8"))
    assert set(written["files"]) == {"urdf", "mjcf", "sdf"}
    assert all(item["difference_nm"] < 1e-9 for items in written["read_back"].values() for item in items)
