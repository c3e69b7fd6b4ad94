"""Which rows are held out when the data choose rotor inertias and offsets. Truth: torques written down here."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import UndeterminedParametersError
from identification.fitting.drives import choose_drive_parameters
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import read_recording
from identification.robots import RobotModel, load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

ROTOR = np.array([4.0, 4.0, 2.0, 2.0, 1.0, 0.5, 0.5])
OFFSET = np.array([0.9, -1.2, 0.5, 0.7, -0.3, 0.2, -0.25])


@pytest.mark.parametrize(("offsets", "wanted"), [((1.0, -0.3), False), ((1.0, 0.9), True)])
def test_an_offset_has_to_hold_on_the_recording_that_was_not_fitted(
    iiwa14: RobotModel, offsets: tuple[float, float], wanted: bool
) -> None:
    """1.0 Nm on one day and -0.3 Nm on another: each predicts the other worse than none does."""
    regressor = BaseRegressor(iiwa14, RegressorOptions(offset=True))
    generator = np.random.default_rng(2)
    blocks: list[Any] = []
    for number, offset in enumerate(offsets):
        columns = regressor.matrix(*fourier_motion(7, period_s=10.0, samples=400, seed=number))
        torque = offset + 0.02 * generator.normal(size=columns.shape[:2])
        signals = SimpleNamespace(row_time=np.arange(400) * 0.025)
        fitted = np.ones(torque.shape, dtype=bool)
        blocks.append(SimpleNamespace(columns=columns, torque=torque, fitted=fitted, signals=signals, recording=number))
    assert choose_drive_parameters(blocks, regressor, rotor_inertia=False, offset=None).offset is wanted


def _one_way(folder: Path) -> Path:
    """A joint that turns one way, faster and slower: 2.0 Nm of friction, 0.7 Nm besides, which it cannot tell apart."""
    time = np.arange(4000) * 0.005
    pace = 2.0 * np.pi * np.array([0.2, 0.37])
    swing = np.array([0.5, 0.4])
    position = 1.5 * time - (swing * np.cos(time[:, None] * pace) / pace).sum(axis=1)
    velocity = 1.5 + (swing * np.sin(time[:, None] * pace)).sum(axis=1)
    acceleration = (swing * pace * np.cos(time[:, None] * pace)).sum(axis=1)
    assert velocity.min() > 0.0
    torque = 0.8 * acceleration + 0.3 * velocity + 2.7 + 0.02 * np.random.default_rng(5).normal(size=time.size)
    (folder / "wheel.urdf").write_text(WHEEL)
    file = folder / "one_way.npz"
    np.savez(file, t=time, q=position[:, None], tau=torque[:, None], robot="wheel.urdf")
    return file


WHEEL = """<robot name="wheel"><link name="base"/><link name="rim"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="axle" type="continuous"><parent link="base"/><child link="rim"/><axis xyz="0 0 1"/></joint></robot>"""


def test_an_offset_is_not_chosen_where_no_velocity_reverses(tmp_path: Path) -> None:
    recording = read_recording(_one_way(tmp_path))
    robot = load_robot(tmp_path / "wheel.urdf")
    found = fit_recordings([recording], robot, FitSettings(physical=False))
    assert dict(zip(found.names, found.values, strict=True))["FS_1"] == pytest.approx(2.7, abs=0.02)
    with pytest.raises(UndeterminedParametersError, match="--offset no"):
        fit_recordings([recording], robot, FitSettings(physical=False, offset="yes"))


def test_the_mean_of_a_period_is_never_held_out(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    """No other line tells an offset: held out with it, rotor inertias were chosen or not as rounding would have it."""
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=1250, seed=4, speed=0.4)
    torque = inverse_dynamics(iiwa14, table3, q, dq, ddq) + ROTOR * ddq + OFFSET
    noise = 0.02 * np.random.default_rng(4).normal(size=(4 * 1250, 7))
    recording = recording_of(np.tile(q, (4, 1)), np.tile(torque, (4, 1)) + noise, period_s=10.0, periods=4)
    found = fit_recordings([recording], replace(iiwa14, name="another arm"), FitSettings(physical=False))
    assert (found.regressor.options.rotor_inertia, found.regressor.options.offset) == (True, True)
    values = dict(zip(found.names, found.values, strict=True))
    assert values["IA_7"] == pytest.approx(ROTOR[6], rel=0.05)
    assert found.provenance["drive_choice_held_out_cost"]["both"] < 0.5


@pytest.mark.parametrize("offset", [0.0, 1.0])
def test_a_single_period_gets_offsets_where_they_are(
    iiwa14: RobotModel, table3: PhysicalParameters, offset: float
) -> None:
    """Its mean alone tells one: as the other lines are fitted no worse without it, rounding gave offsets to any arm."""
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=1250, seed=4, speed=0.4)
    torque = inverse_dynamics(iiwa14, table3, q, dq, ddq) + offset * OFFSET
    found = fit_recordings([recording_of(q, torque, period_s=10.0)], iiwa14, FitSettings(physical=False))
    assert found.regressor.options.offset is bool(offset)
