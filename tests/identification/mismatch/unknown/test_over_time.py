"""Names of what changes between periods, against torque written onto the plant that Pinocchio computes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.findings import Diagnosis
from identification.mismatch.prepared import prepare
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.summary import verdict_of
from identification.mismatch.unknown.over_time import Refused, changing, earned_over_time
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

PERIOD_S, SAMPLES, PERIODS = 10.0, 1250, 10
Extra = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def drifting_zero(time: np.ndarray, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    del q, dq, torque
    return 4.0 * time / 3600.0


def warming_up(time: np.ndarray, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    del q, torque
    return np.exp(-time / 60.0) * (0.3 * dq[:, 3] + 0.3 * np.sign(dq[:, 3]))


def gain_that_settles(time: np.ndarray, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    del q, dq
    return 0.1 * np.exp(-time / 60.0) * torque[:, 3]


def hose_that_softens(time: np.ndarray, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    del dq, torque
    return 0.6 * np.exp(-time / 60.0) * np.maximum(q[:, 3] - np.median(q[:, 3]), 0.0) ** 2


@pytest.mark.parametrize(
    ("extra", "name"),
    [
        (drifting_zero, "torque_sensor_drift"),
        (warming_up, "thermal_friction"),
        (gain_that_settles, None),
        (hose_that_softens, None),
    ],
)
def test_a_change_is_named_where_it_is_that_and_not_where_a_class_changes(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters, extra: Extra, name: str | None
) -> None:
    """All on joint 4. What changes in proportion to the torque or with the position has no name of the library."""
    random = np.random.default_rng(3)
    q, dq, ddq = fourier_motion(7, period_s=PERIOD_S, samples=SAMPLES, seed=4)
    torque = np.tile(inverse_dynamics(iiwa14, table3, q, dq, ddq), (PERIODS, 1))
    time = np.arange(PERIODS * SAMPLES) * PERIOD_S / SAMPLES
    hidden = extra(time, np.tile(q, (PERIODS, 1)), np.tile(dq, (PERIODS, 1)), torque)
    torque = torque + hidden[:, None] * (np.arange(7) == 3) + 0.08 * random.normal(size=torque.shape)
    recording = recording_of(np.tile(q, (PERIODS, 1)), torque, period_s=PERIOD_S, periods=PERIODS)
    found = prepare([recording], iiwa14, iiwa14_base, DiagnosisSettings(), None)
    assert found.changes
    kept, refused = earned_over_time(found)
    assert [(item.effect.name, item.estimate.place.joint) for item in kept.changes] == ([(name, 4)] if name else [])
    assert bool(refused) == (name is None)


def test_a_joint_that_changes_without_a_name_is_not_passed_as_one_without_mismatch(clean_diagnosis: Diagnosis) -> None:
    assert clean_diagnosis.verdict == "no_mismatch"
    gain = Refused("thermal_friction", 4, ("own_load",), 0.012, (0.008, 0.015), 21.0)
    load = Refused("payload_change", None, ("own_load",), 0.0, (0.0, 0.0), 12.0)
    (claim,) = changing([gain, load])
    assert (claim.name, claim.joint) == ("time", 4)
    assert "Joint 4: a torque that changes over the recording and depends on own load" in claim.sentence
    plain = clean_diagnosis.baseline
    assert verdict_of((), plain, [False] * 7, False, classes=[claim], much=False) == "unexplained"
    assert verdict_of((), plain, [False] * 7, False, classes=changing([load]), much=False) == "no_mismatch"


def test_a_change_that_is_too_weak_for_a_name_is_one_over_time_all_the_same() -> None:
    weak = Refused("torque_sensor_drift", 4, (), 0.012, (0.008, 0.015), 16.7, weak=True)
    (claim,) = changing([weak])
    assert (claim.name, claim.joint, claim.significance) == ("time", 4, 16.7)
    assert claim.sentence == "Joint 4: a torque that changes over the recording, 0.012 Nm RMS (0.008 to 0.015)."
    assert "torque sensor drift of joint 4 is too weak here to be told from" in weak.sentence
    assert not changing([Refused("payload_change", None, (), 0.0, (0.0, 0.0), 12.0, weak=True)])
