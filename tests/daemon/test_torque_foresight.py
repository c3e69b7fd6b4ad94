"""Claims about the torque that `check` and `run` foresee; truth: statics by Pinocchio, closed form, exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest

from daemon.motion import torque_foresight as torque_foresight_module
from daemon.motion.preparation import TABLE_RATE_HZ, prepare_motion
from daemon.motion.torque_foresight import torque_foresight
from identification.base_parameters import BaseRegressor
from identification.errors import ModelFileError
from identification.excitation import default_trajectory
from identification.excitation.nominal import nominal_parameters
from identification.model_file import MODEL_FORMAT
from identification.robots import load_robot
from identification.robots.model import build_pinocchio_model
from tests.daemon.command_line import run

PERIOD = 1.0 / TABLE_RATE_HZ


def model_of(robot: str, scale: float, file: Path) -> Path:
    """A model.json of Table 3's arm with every base parameter multiplied."""
    nominal = nominal_parameters(load_robot("iiwa14"))
    assert nominal is not None
    regressor = BaseRegressor(load_robot(robot))
    rows = [
        {"name": name, "value": scale * value, "std": 0.1, "unit": unit}
        for name, value, unit in zip(
            regressor.names, regressor.base_from_physical(nominal).tolist(), regressor.units, strict=True
        )
    ]
    document: dict[str, Any] = {"format": MODEL_FORMAT, "robot": robot, "base_parameters": rows}
    file.write_text(json.dumps(document), encoding="utf-8")
    return file


def test_an_arm_that_stands_stretched_out_needs_the_torque_of_its_weight() -> None:
    robot = load_robot("iiwa14")
    nominal = nominal_parameters(robot)
    assert nominal is not None
    bodies = tuple(
        pinocchio.Inertia(mass, center, tensor)
        for mass, center, tensor in zip(nominal.mass, nominal.center_of_mass, nominal.inertia, strict=True)
    )
    model = build_pinocchio_model("nominal", robot.kinematics, robot.joint_names, robot.gravity, bodies)
    stretched = np.array([0.0, 1.57, 0.3, 0.0, 0.0, -0.2, 0.0])
    weight = pinocchio.computeGeneralizedGravity(model, model.createData(), stretched)
    foresight = torque_foresight("iiwa14")
    assert foresight is not None
    torque = foresight.along(np.tile(stretched, (20, 1)), PERIOD)
    assert abs(weight[1]) > 50.0
    np.testing.assert_allclose(torque, np.tile(weight, (20, 1)), atol=1e-9)


def test_torque_along_a_motion_is_that_of_its_own_velocities_and_accelerations() -> None:
    trajectory = default_trajectory()
    foresight = torque_foresight("iiwa14")
    assert foresight is not None
    q, dq, ddq = trajectory.evaluate(np.arange(round(trajectory.period_s * TABLE_RATE_HZ)) * PERIOD)
    torque = foresight.along(trajectory.table(TABLE_RATE_HZ), PERIOD)
    exact = foresight.regressor.matrix(q, dq, ddq) @ foresight.values
    # sign(q̇) may differ in the row in which a joint turns round.
    turning = np.abs(dq) < 1e-2
    np.testing.assert_allclose(torque[~turning], exact[~turning], atol=1e-2)


def sway(file: Path) -> Path:
    """A table of 1 s in which the stretched-out arm sways a little about joint 2."""
    table = np.tile([0.0, 1.2, 0.0, -0.1, 0.0, 0.1, 0.0], (1000, 1))
    table[:, 1] += 0.01 * np.sin(2.0 * np.pi * np.arange(1000) / 1000)
    np.savez(file, q=table, rate_hz=1000.0)
    return file


def test_a_motion_within_all_other_limits_is_refused_for_its_torque(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    motion = str(sway(tmp_path / "sway.npz"))
    light, heavy = (str(model_of("iiwa14", scale, tmp_path / f"{scale}.json")) for scale in (1.0, 10.0))
    assert run("check", motion, "--model", light) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert light in shown
    assert "Predicted: joint 2 reaches" in shown
    assert run("check", motion, "--model", heavy, "--json", "-") == 1
    failed = [check for check in json.loads(capsys.readouterr().out)["checks"] if not check["passed"]]
    assert [(check["name"], check["joint"], check["limit"]) for check in failed] == [("torque", 2, 320.0)]
    assert run("run", motion, "--model", heavy, "--out", str(tmp_path / "run")) == 1
    assert not (tmp_path / "run").exists()


def test_a_model_of_another_arm_or_none_at_all_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="iiwa7"):
        torque_foresight("iiwa14", model_of("iiwa7", 1.0, tmp_path / "other.json"))
    assert run("check", "--model", str(tmp_path / "nowhere.json")) == 66


def test_where_nothing_is_known_of_the_arm_no_torque_is_claimed(tmp_path: Path) -> None:
    motion = prepare_motion(sway(tmp_path / "sway.npz"), robot="iiwa7")
    assert motion.foresight is None
    assert "torque" not in {check.name for check in motion.preflight.checks}
    assert "No torque was checked" in motion.foresight_sentence()


def test_a_motion_with_its_times_in_ms_is_refused_before_its_table_fills_the_memory(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Four seconds in ms are 4000 s: a table of 4 million rows, whose regressor alone would take 12 GB."""
    file = tmp_path / "ms.npz"
    np.savez(file, t=1000.0 * np.arange(0.0, 4.0, 0.001), q=np.zeros((4000, 7)))
    assert run("check", str(file)) == 65
    assert "at most 600 s can be driven" in capsys.readouterr().err


def test_torque_foreseen_in_blocks_is_that_of_the_whole_table(monkeypatch: pytest.MonkeyPatch) -> None:
    foresight = torque_foresight("iiwa14")
    assert foresight is not None
    table = 0.3 * np.sin(2.0 * np.pi * np.arange(500)[:, None] / 500.0 + np.arange(7))
    whole = foresight.along(table, 0.004)
    monkeypatch.setattr(torque_foresight_module, "BLOCK_ROWS", 64)
    np.testing.assert_allclose(foresight.along(table, 0.004), whole, rtol=1e-12)
