"""What of the torque without a name goes into the model; truth is a plant with friction of no known form."""

from __future__ import annotations

import numpy as np
import pytest

from identification.mismatch.diagnosis import diagnose
from identification.mismatch.extended_model import extended_model
from identification.mismatch.unknown.model_terms import with_friction
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


def falling(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
    speed = np.abs(dq[:, 3])
    return plant.on_joint(4, 1.5 * np.exp(-speed / 0.4) * np.tanh(dq[:, 3] / 0.01))


def test_beside_a_torque_that_falls_with_the_speed_the_joint_keeps_a_friction_of_a_machine() -> None:
    """Viscous friction came out at -0.4 Nm s/rad, and physical parameters left three times what base parameters do."""
    fitted = plant.record(ROBOT, ARM, falling, motion=3)
    result = diagnose([fitted], ROBOT, heldout=[plant.record(ROBOT, ARM, falling, motion=7, seed=2)])
    assert not result.findings
    model = extended_model(result, [fitted], ROBOT)
    values = {item["name"]: item["value"] for item in model["base_parameters"]}
    assert values["FV_4"] >= 0.1 - 1e-12
    assert any(term["class"] == "friction" and term["joint"] == 4 for term in model["class_terms"]["terms"])
    rms = model["rms_nm"]
    assert rms["fit_physical"][3] < 1.1 * rms["fit"][3]


def test_friction_that_no_joint_has_moves_to_the_terms_of_its_joint() -> None:
    terms = {"terms": [{"class": "own_velocity", "joint": 4}, {"class": "own_load", "joint": 1, "angle": True}]}
    values = {"FV_4": -0.3, "FS_4": 0.2, "MX_4": -5.0, "FV_1": -1.0}
    moved, kept = with_friction(terms, values, {"FV": (0.1, 2.0), "FS": (0.0, 2.0)})
    assert kept == {"FV_4": 0.1, "FS_4": 0.2, "MX_4": -5.0, "FV_1": -1.0}
    assert moved["terms"] == [
        *terms["terms"], {"class": "friction", "joint": 4, "weights": [pytest.approx(-0.4), 0.0]}
    ]  # fmt: skip
