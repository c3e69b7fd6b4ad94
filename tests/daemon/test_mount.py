"""Claims about an arm that does not stand on a floor: preflight, design and log count with the gravity that it feels.

Truth: Pinocchio's inverse dynamics with the base turned by the angles of the cabinet, and gravity straight down.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from daemon.api import RecorderJob
from daemon.config import load_config
from daemon.errors import ConfigurationError
from daemon.motion.preparation import prepare_motion, write_run_request
from daemon.motion.torque_foresight import stand_of_model, torque_foresight
from daemon.run.log_inputs import metadata_of
from identification.base_parameters import BaseRegressor
from identification.errors import ModelFileError
from identification.excitation.nominal import nominal_parameters
from identification.recordings.fri_log import installation_in
from identification.robots import Installation, RobotModel, load_robot
from tests.daemon.command_line import run

STANDS = {
    # mount: A, B, C of the cabinet in rad, turns about z, y and x one after the other
    "floor": (0.0, 0.0, 0.0),
    "wall": (0.0, 0.5 * np.pi, 0.0),
    "ceiling": (0.0, 0.0, np.pi),
}


def stand(mount: str) -> Installation:
    found = Installation.parse(mount=mount)
    assert found is not None
    return found


def torque_of_turned_base(mount: str, q: np.ndarray) -> np.ndarray:
    """Torque (S, 7) at rest of Table 3's arm whose base is turned in space."""
    a, b, c = STANDS[mount]
    model = load_robot("iiwa14").pinocchio_model.copy()
    nominal = nominal_parameters(load_robot("iiwa14"))
    assert nominal is not None
    for link in range(7):
        body = float(nominal.mass[link]), nominal.center_of_mass[link], nominal.inertia[link]
        model.inertias[link + 1] = pinocchio.Inertia(*body)
    turn = pinocchio.rpy.rpyToMatrix(c, b, a)
    model.jointPlacements[1] = pinocchio.SE3(turn, np.zeros(3)) * model.jointPlacements[1]
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    data, rest = model.createData(), np.zeros(7)
    return np.array([pinocchio.rnea(model, data, row, rest, rest) for row in q])


@pytest.mark.parametrize("mount", STANDS)
def test_the_foreseen_torque_is_that_of_the_base_turned_by_the_angles_of_the_cabinet(mount: str) -> None:
    foresight = torque_foresight("iiwa14", installation=stand(mount))
    assert foresight is not None
    for pose in np.random.default_rng(7).uniform(-1.5, 1.5, (3, 7)):
        expected = torque_of_turned_base(mount, pose[None])[0]
        np.testing.assert_allclose(foresight.along(np.tile(pose, (4, 1)), 1e-3)[0], expected, atol=1e-6)


def test_a_motion_is_checked_and_logged_as_the_arm_stands(tmp_path: Path) -> None:
    motion = prepare_motion(None, amplitude=0.1, installation=stand("wall"))
    assert motion.foresight is not None
    assert motion.foresight.regressor.robot.gravity.tolist() == [9.81, 0.0, 0.0]
    for moved, expected in ((motion, stand("wall")), (replace(motion, installation=Installation()), Installation())):
        request = write_run_request(moved, tmp_path / str(expected.gravity[0]), run_id="r")
        metadata = metadata_of(RecorderJob(request=request, path=str(tmp_path / "r.mcap")))
        assert installation_in(tmp_path, metadata) == expected


def test_a_model_foresees_the_arm_only_as_it_stood(tmp_path: Path) -> None:
    file = tmp_path / "wall.json"
    robot = load_robot("iiwa14", stand("wall"))
    base = BaseRegressor(robot)
    items = [
        {"name": name, "value": 0.1, "std": 0.01, "unit": unit}
        for name, unit in zip(base.names, base.units, strict=True)
    ]
    document = {"format": "iiwa-ident/model/1", **robot.to_json(), "base_parameters": items}
    file.write_text(json.dumps(document))
    assert stand_of_model(file) == stand("wall")
    assert torque_foresight("iiwa14", file, installation=stand("wall")) is not None
    with pytest.raises(ModelFileError, match="gravity"):
        torque_foresight("iiwa14", file, installation=stand("ceiling"))


def test_run_check_and_design_take_the_mount_and_refuse_what_is_none(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    asked: list[Installation] = []

    def prepared(*_: object, installation: Installation, **__: object) -> None:
        asked.append(installation)
        raise ConfigurationError("That will do.")

    def designed(robot: RobotModel, *_: object, **__: object) -> None:
        asked.append(robot.installation)
        raise ConfigurationError("That will do.")

    monkeypatch.setattr("daemon.motion.preparation.prepare_motion", prepared)
    monkeypatch.setattr("identification.excitation.design.design_excitation", designed)
    lab = tmp_path / "lab.yaml"
    lab.write_text("run: {gravity_m_s2: [9.81, 0, 0]}\n")
    for words in (["check"], ["run", "--config", str(lab)], ["design"]):
        assert run(*words, "--mount", "ceiling") == 78
        assert run(*words, "--mount", "door") == 2
        assert "door" in capsys.readouterr().err
    assert run("run", "--config", str(lab)) == 78
    assert asked == [stand("ceiling")] * 3 + [stand("wall")]


def test_two_more_parameters_show_on_a_wall() -> None:
    """On a floor the first moments of link 1 across its axis weigh nothing; on a wall both do."""
    floor, wall = (set(BaseRegressor(load_robot("iiwa14", stand(mount))).names) for mount in ("floor", "wall"))
    assert wall - floor == {"MX_1", "MYR_1"}


def test_the_configuration_says_how_the_arm_stands(tmp_path: Path) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text("run: {gravity_m_s2: [9.81, 0, 0]}\n")
    assert load_config(file).request_fields()["gravity_m_s2"] == (9.81, 0.0, 0.0)
    file.write_text("run: {gravity_m_s2: [0, 0, -1.6]}\n")
    with pytest.raises(ConfigurationError, match=r"9\.7") as refusal:
        load_config(file)
    assert refusal.value.field == "run.gravity_m_s2"
