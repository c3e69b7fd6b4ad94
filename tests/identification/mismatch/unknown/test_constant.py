"""A constant beside a function of the position is part of it. Truth: a function written onto the plant here."""

from __future__ import annotations

import numpy as np

from identification.mismatch.diagnosis import diagnose
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record

JOINT = 3


def bumper(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A soft stop that the joint leans on over half of its range: its torque has one sign."""
    del dq, torque
    return on_joint(JOINT, 0.4 / (1.0 + np.exp(-(q[:, JOINT - 1] - 0.1) / 0.1)))


def test_the_constant_part_of_a_function_of_position_is_in_its_curve_and_in_its_evidence(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    fitted = record(iiwa14, table3, bumper, motion=9)
    unseen = record(iiwa14, table3, bumper, periods=4, motion=3, seed=2)
    diagnosis = diagnose([fitted], iiwa14, heldout=[unseen])
    (claim,) = diagnosis.classes
    assert (claim.name, claim.joint) == ("own_position", JOINT)
    assert claim.curve is not None
    place = claim.curve.place
    truth = 0.4 / (1.0 + np.exp(-(place - 0.1) / 0.1))
    # What base parameters may take up is open: gravity's first harmonic, but no constant.
    open_to_base = np.stack([np.sin(place), np.cos(place)], axis=1)
    missed = truth - claim.curve.mean_nm
    left = missed - open_to_base @ np.linalg.lstsq(open_to_base, missed, rcond=None)[0]
    assert np.abs(left).max() < 0.01
