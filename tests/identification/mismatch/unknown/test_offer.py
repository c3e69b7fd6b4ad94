"""What of the torque without a name goes into the model; truth is a plant with friction of no known form."""

from __future__ import annotations

import numpy as np
import pytest

from identification.mismatch.diagnosis import diagnose
from identification.physical_parameters import PhysicalParameters
from identification.robots import load_robot
from tests.identification.mismatch import plant
from tests.identification.mismatch.plant import FloatArray
from tests.identification.synthetic import table_three

ROBOT = load_robot("iiwa14")
ARM: PhysicalParameters = table_three()


def friction(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
    speed = np.abs(dq[:, 3]) / 0.3
    return plant.on_joint(4, 3.0 * np.sin(3.0 * speed) * np.exp(-speed) * np.tanh(dq[:, 3] / 0.02))


@pytest.mark.parametrize("seed", [10, 17, 24])
def test_what_base_parameters_scatter_by_keeps_no_term_out_of_the_model(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Few samples, and noise of each joint as of an iiwa: by chance another joint is left 1.5 % more (seen before)."""
    monkeypatch.setattr(plant, "SAMPLES", 400)
    monkeypatch.setattr(plant, "NOISE_NM", np.array([0.17, 0.17, 0.12, 0.12, 0.08, 0.04, 0.03]))
    fitted = plant.record(ROBOT, ARM, friction, seed=seed, motion=3)
    unseen = plant.record(ROBOT, ARM, friction, seed=seed + 50, motion=7, periods=4)
    result = diagnose([fitted], ROBOT, heldout=[unseen])
    assert result.offer is not None
    assert result.heldout is not None
    share = result.offer.heldout_rms / result.heldout.rms_before_nm
    assert share[3] < 0.6
    assert share.max() < 1.05
