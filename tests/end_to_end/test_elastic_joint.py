"""A joint that winds up, under feedback: the plant's own simulation of it is named, with its stiffness.

Truth: the fake robot's plant, whose encoder sits before a spring and whose controller, friction and noise are its own.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fixtures.fake_robot.plant import Plant
from fixtures.physics.settings import PhysicsSettings
from identification.excitation import default_trajectory
from identification.mismatch.diagnosis import diagnose
from identification.recordings import read_recording
from identification.robots import load_robot

STIFFNESS, PERIODS, LEAD_IN = 7000.0, 2, 1000
THINNED = 4
"""The plant runs at 1 kHz; every fourth sample is recorded."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    trajectory = default_trajectory("iiwa14")
    samples = PERIODS * round(1e3 * trajectory.period_s)
    time = 1e-3 * np.arange(-LEAD_IN, samples)
    path = trajectory.evaluate(time)[0]
    effect = {"effect": "joint_elasticity", "joint": 2, "stiffness_nm_rad": STIFFNESS}
    settings = replace(PhysicsSettings(), initial_position_rad=tuple(path[0].tolist()), effects=(effect,))
    plant = Plant(settings, seed=1)
    seen = [(sample.measured_position, sample.measured_torque) for sample in map(plant.step, path)][LEAD_IN:]
    position, torque = (np.array(values[::THINNED]) for values in zip(*seen, strict=True))
    file = tmp_path_factory.mktemp("elastic") / "recording.npz"
    clock = time[LEAD_IN::THINNED]
    np.savez(file, t=clock, q=position, tau=torque, robot="iiwa14", period_s=trajectory.period_s)
    return file


def test_a_joint_that_winds_up_under_feedback_is_named_with_its_stiffness(recording: Path) -> None:
    diagnosis = diagnose([read_recording(recording)], load_robot("iiwa14"))
    assert diagnosis.verdict == "explained"
    (finding,) = diagnosis.findings
    assert (finding.effect, finding.place.joint) == ("joint_elasticity", 2)
    stiffness = next(item for item in finding.parameters if item.name == "stiffness")
    assert stiffness.value == pytest.approx(STIFFNESS, rel=0.1)
