"""Claims about joints that follow another one by a URDF's mimic rule while it moves.

Truth: MuJoCo's inverse dynamics of the whole tree, every joint by itself; the motor of a leader has the power of all
its joints, so its torque is Σ multiplier · torque (virtual work).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio
import pytest

from daemon.cli import main
from identification.base_parameters import BaseRegressor
from identification.errors import RobotError
from identification.excitation.limits import limits_of_robot
from identification.export.write import export_model
from identification.mismatch.diagnosis import diagnose
from identification.model_file import read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitResult, FitSettings, fit_recordings
from identification.recordings import read_recording
from identification.recordings.reader import read_inputs
from identification.robots import Installation, load_robot
from identification.validation import validate_model
from tests.identification.test_installation import ARM, joint, link

BRANCHED = "".join(
    [
        '<robot name="branched">',
        '<link name="base"/>',
        link("upper", 3.0, "0.1 0.02 0.1"),
        link("left", 0.9, "0.02 0.05 0.03"),
        link("right", 0.7, "0.01 -0.05 0.03"),
        link("tip", 0.5, "0.03 0.01 0.1"),
        joint("a", "revolute", "base", "upper", "0 1 0", "0 0 0.3"),
        # The follower comes before its leader, another follows the follower, and both carry what the leader does not.
        joint(
            "b", "revolute", "upper", "right", "0 0 1", "0 -0.2 0", '<mimic joint="z" multiplier="-2" offset="0.3"/>'
        ),
        joint(
            "c", "prismatic", "right", "tip", "1 0 0", "0.1 0 0", '<mimic joint="b" multiplier="0.25" offset="0.1"/>'
        ),
        joint("z", "revolute", "upper", "left", "1 0 0", "0.1 0 0"),
        "</robot>",
    ]
)
ARMS = {"arm": ARM, "branched": BRANCHED}
# By name: driven joints, and of the followers the leader, multiplier and offset through all rules between.
RULES = {
    "arm": (("a", "b", "c", "finger"), {"thumb": ("finger", -2.0, 0.0)}),
    "branched": (("a", "z"), {"b": ("z", -2.0, 0.3), "c": ("z", -0.5, 0.175)}),
}
VISCOUS, COULOMB, FOLLOWER_VISCOUS, NOISE_NM = 0.8, 0.5, 0.3, 0.02


def states_of(name: str, samples: int, seed: int, period_s: float = 0.0) -> tuple[np.ndarray, ...]:
    """Time, and q, dq, ddq of the driven joints (samples, joints): three sines each."""
    generator = np.random.default_rng(seed)
    time = np.arange(samples) * 0.01
    count = len(RULES[name][0])
    omega, phase, size = generator.uniform(0.5, 5.0, (3, count)), generator.uniform(0, 6, (3, count)), 0.3
    if period_s > 0.0:
        omega = 2.0 * np.pi / period_s * np.ceil(omega * period_s / (2.0 * np.pi))
    angle = time[:, None, None] * omega + phase
    return (
        time,
        (size * np.sin(angle)).sum(axis=1),
        (size * omega * np.cos(angle)).sum(axis=1),
        (-size * omega**2 * np.sin(angle)).sum(axis=1),
    )


def motors(name: str, q: Any, dq: Any, ddq: Any, *, friction: bool) -> np.ndarray:
    """(S, driven) torque of the motors."""
    text = ARMS[name]
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    data = mujoco.MjData(model)
    driven, rules = RULES[name]
    names = [model.joint(index).name for index in range(model.njnt)]
    through = np.zeros((model.njnt, len(driven)))
    shift = np.zeros(model.njnt)
    for index, own in enumerate(names):
        leader, multiplier, offset = rules.get(own, (own, 1.0, 0.0))
        through[index, driven.index(leader)], shift[index] = multiplier, offset
    following = np.array([own in rules for own in names])
    result = np.empty_like(q)
    for row in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = through @ q[row] + shift, through @ dq[row], through @ ddq[row]
        speed = data.qvel.copy()
        mujoco.mj_inverse(model, data)
        torque = data.qfrc_inverse.copy()
        if friction:
            torque += np.where(following, FOLLOWER_VISCOUS * speed, VISCOUS * speed + COULOMB * np.sign(speed))
        result[row] = through.T @ torque
    return result


def recorded(folder: Path, name: str, seed: int, period_s: float = 0.0) -> Path:
    """An .npz of the driven joints beside its URDF."""
    (folder / f"{name}.urdf").write_text(ARMS[name])
    time, q, dq, ddq = states_of(name, 3000, seed, period_s)
    torque = motors(name, q, dq, ddq, friction=True)
    torque += NOISE_NM * np.random.default_rng(seed).standard_normal(torque.shape)
    file = folder / f"{name}-{seed}.npz"
    names = np.array(RULES[name][0])
    np.savez(file, t=time, q=q, tau=torque, joint_names=names, robot=f"{name}.urdf", period_s=period_s)
    return file


@pytest.mark.parametrize("name", ARMS)
def test_a_leaders_torque_is_that_of_all_joints_that_it_moves(name: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(ARMS[name])
    robot = load_robot(file)
    assert robot.driven_names == RULES[name][0]
    _, q, dq, ddq = states_of(name, 40, 5)
    whole = [np.zeros((40, robot.n)) for _ in range(3)]
    for state, values in zip(whole, (q, dq, ddq), strict=True):
        state[:, list(robot.driven)] = values
    for follower, leader, multiplier, offset in robot.followers:
        for state, shift in zip(whole, (offset, 0.0, 0.0), strict=True):
            state[:, follower] = multiplier * state[:, leader] + shift
    regressor = BaseRegressor(robot)
    model = pinocchio.buildModelFromXML(ARMS[name])
    inertias = list(model.inertias)[1:]
    bodies = PhysicalParameters(
        np.array([item.mass for item in inertias]),
        np.array([item.lever for item in inertias]),
        np.array([item.inertia for item in inertias]),
        np.zeros(robot.n),
        np.zeros(robot.n),
    )
    values = regressor.base_from_physical(bodies)
    expected = motors(name, q, dq, ddq, friction=False)
    found = regressor.matrix(*whole) @ values
    np.testing.assert_allclose(found[:, list(robot.driven)], expected, atol=1e-9)
    followers = [item[0] for item in robot.followers]
    assert not found[:, followers].any()
    stacked, of_row = regressor.stacked(*whole)
    np.testing.assert_allclose((stacked @ values).reshape(robot.n, -1).T, found, atol=1e-12)
    assert len(of_row) == found.size
    for joint_number, (columns, used) in enumerate(regressor.joint_columns(*whole)):
        np.testing.assert_allclose(values[used] @ columns, found[:, joint_number], atol=1e-12)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, FitResult]]:
    folder = tmp_path_factory.mktemp("followers")
    results = {}
    for name in ARMS:
        inputs = read_inputs([recorded(folder, name, 1)])
        results[name] = fit_recordings(inputs.recordings, inputs.robot, FitSettings())
    return folder, results


@pytest.mark.parametrize("name", ARMS)
def test_a_fit_follows_joints_that_follow(name: str, fitted: tuple[Path, dict[str, FitResult]]) -> None:
    folder, results = fitted
    result = results[name]
    driven = list(result.robot.driven)
    model = read_model(write_model(result.to_model_json(notes=False), folder / f"{name}.json"))
    table = validate_model(model, [read_recording(recorded(folder, name, 2), model_robot=model.load_robot())])
    for row in table.rows:
        assert np.all(row.rms_nm[driven] < 2.0 * NOISE_NM), row.label
    values = dict(zip(result.regressor.names, result.least_squares.values, strict=True))
    sigma = dict(zip(result.regressor.names, result.least_squares.std, strict=True))
    # The follower's friction is felt by the motor, its speed multiplied on both ways.
    for motor, number in ((name_, place + 1) for place, name_ in enumerate(result.robot.joint_names)):
        if motor not in RULES[name][0]:
            assert f"FV_{number}" not in values
            continue
        multipliers = [rule[1] for rule in RULES[name][1].values() if rule[0] == motor]
        expected = VISCOUS + FOLLOWER_VISCOUS * sum(value**2 for value in multipliers)
        assert abs(values[f"FV_{number}"] - expected) < 5.0 * sigma[f"FV_{number}"] + 0.02


def test_a_repeated_motion_of_joints_that_follow_is_fitted_too(tmp_path: Path) -> None:
    inputs = read_inputs([recorded(tmp_path, "branched", 3, period_s=10.0)])
    result = fit_recordings(inputs.recordings, inputs.robot, FitSettings(physical=False))
    row, driven = result.rms.rows[0], list(result.robot.driven)
    assert result.pipelines == ("periodic",)
    assert np.all(row.rms_nm[driven] < 2.0 * NOISE_NM)
    assert np.isnan(np.delete(row.rms_nm, driven)).all()


def test_what_cannot_follow_says_so_in_a_sentence(
    fitted: tuple[Path, dict[str, FitResult]], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, results = fitted
    model = read_model(write_model(results["arm"].to_model_json(notes=False), folder / "refused.json"))
    with pytest.raises(RobotError, match=r"'thumb' follows 'finger', which moves.*--lock finger=0"):
        export_model(model, folder / "out.urdf", "urdf")
    with pytest.raises(RobotError, match="cannot diagnose"):
        diagnose(results["arm"].recordings, results["arm"].robot)
    endless = replace(results["arm"].robot, position_upper=np.full(results["arm"].robot.n, np.inf))
    with pytest.raises(RobotError, match="cannot design"):  # it asked for limits, with which it refused
        limits_of_robot(endless)
    with pytest.raises(SystemExit):
        main(["simulate", str(folder / "refused.json")])
    assert "cannot simulate" in capsys.readouterr().err  # it asked for a motion, which cannot be designed


def test_rules_in_a_circle_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "circle.urdf"
    file.write_text(BRANCHED.replace('"0.1 0 0"/><limit', '"0.1 0 0"/><mimic joint="c"/><limit', 2))
    with pytest.raises(RobotError, match="follows"):
        load_robot(file)


def test_a_leader_that_is_locked_takes_all_its_followers_along(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(BRANCHED)
    robot = load_robot(file, Installation(locked_joints=(("z", 0.2),)))
    assert robot.joint_names == ("a",)
    assert not robot.mimics
