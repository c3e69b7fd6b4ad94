"""Dry friction that turns over gently on every joint belongs to the nominal model; on one joint it does not."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from identification.mismatch.diagnosis import diagnose
from identification.mismatch.extended_model import extended_model
from identification.mismatch.prediction import validate_with_effects
from identification.model_file import read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import NOISE_NM, Hidden, on_joint, record

FloatArray = npt.NDArray[np.float64]


def blunted(coulomb: FloatArray, velocity: float, joints: list[int]) -> Hidden:
    """The friction of some joints (from 1) turns over like tanh(q̇/v) in place of sign(q̇)."""
    here = np.isin(np.arange(1, 8), joints)

    def hidden(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
        return np.where(here, coulomb, 0.0) * (np.tanh(dq / velocity) - np.sign(dq))

    return hidden


@pytest.mark.parametrize("velocity", [5e-3, 2e-2])
def test_a_width_that_all_joints_share_is_measured_and_called_no_missing_physics(
    iiwa14: RobotModel, table3: PhysicalParameters, velocity: float, tmp_path: Path
) -> None:
    """And the model that is exported keeps it: validated, it leaves the noise on the same rows and on others."""
    hidden = blunted(table3.coulomb, velocity, list(range(1, 8)))
    fitted = record(iiwa14, table3, hidden)
    unseen = record(iiwa14, table3, hidden, periods=4, motion=9, seed=2)
    found = diagnose([fitted], iiwa14, heldout=[unseen])
    assert (found.verdict, found.findings) == ("no_mismatch", ())
    (said,) = (note for note in found.notes if "turns over" in note)
    (width,) = re.findall(r"±([0-9.]+) mrad/s", said)
    assert float(width) == pytest.approx(1000.0 * velocity, rel=0.15)
    model = read_model(write_model(extended_model(found, [fitted], iiwa14), tmp_path / "model.json"))
    assert model.options.coulomb_velocity == pytest.approx(velocity, rel=0.15)
    # The mean of eight periods holds the noise that was added and nothing else.
    for recording, periods in ((fitted, 8), (unseen, 4)):
        rms = validate_with_effects(model, [recording]).rows[0].rms_nm
        np.testing.assert_allclose(rms, NOISE_NM / np.sqrt(periods), rtol=0.05)


def test_an_effect_is_found_beside_it(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    gentle = blunted(table3.coulomb, 1e-2, list(range(1, 8)))

    def hidden(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
        return gentle(q, dq, torque) + on_joint(6, 0.4 * (q[:, 5] - 0.3))

    fitted = record(iiwa14, table3, hidden)
    unseen = record(iiwa14, table3, hidden, periods=4, motion=9, seed=2)
    found = diagnose([fitted], iiwa14, heldout=[unseen])
    assert [(item.effect, item.place.joint) for item in found.findings] == [("cable_spring", 6)]


def test_what_one_joint_alone_asks_for_stays_with_that_joint(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    hidden = blunted(table3.coulomb, 2e-2, [2])
    found = diagnose([record(iiwa14, table3, hidden)], iiwa14)
    assert found.baseline.detected.tolist() == [joint == 2 for joint in range(1, 8)]
    assert not any("turns over" in note for note in found.notes)
