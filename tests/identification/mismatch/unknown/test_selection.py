"""What a selection holds is what stands on the joint. No truth from outside: a rule about the program itself."""

from __future__ import annotations

from itertools import count

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.aperiodic_evidence import default_split
from identification.mismatch.prepared import prepare
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown import choice
from identification.mismatch.unknown.choice import eliminated, exchange
from identification.mismatch.unknown.rows import build_rows
from identification.mismatch.unknown.selection import Selection
from identification.physical_parameters import PhysicalParameters
from identification.recordings import read_recording
from identification.robots import RobotModel, load_robot
from tests.identification.mismatch.plant import on_joint, record
from tests.reference import recording_file


def bends(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    del dq, torque
    return on_joint(3, 0.3 * np.tanh(q[:, 2] / 0.2))


def test_what_is_held_stands_also_where_every_exchange_seems_better(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = prepare([record(iiwa14, table3, bends)], iiwa14, iiwa14_base, DiagnosisSettings(), None)
    monkeypatch.setattr(choice, "ALTERNATIVE", 1e9)
    selection = Selection.of(build_rows(fitted, None), [0])
    selection.states[2] = eliminated(selection, 2)
    calls = count()
    monkeypatch.setattr(Selection, "score", lambda *_: float(next(calls)))
    exchange(selection, [2])
    standing = selection.families(2, selection.states[2])
    assert selection.held
    assert [item.number for item in selection.held] == list(standing)


def test_noise_that_is_not_measured_is_what_stays_of_rows_that_were_not_fitted() -> None:
    """All classes together describe every fitted row of 18 s of the UR10 in some band; not of what is left out."""
    robot = load_robot(recording_file("ur10_mdh.csv"))
    recording = read_recording(recording_file("ur10.npz"))
    split = default_split([recording], DiagnosisSettings())
    fitted = prepare([recording], robot, BaseRegressor(robot), DiagnosisSettings(), split)
    rows = build_rows(fitted, None)
    least = {}
    for predicted in (False, True):
        selection = Selection.of(rows, range(rows.folds), predicted=predicted)
        before = selection.states[0].hyper.noise
        share = selection.settled(0, selection.full(0), 8).hyper.noise / before
        least[predicted] = float(share[selection.states[0].gram.count > 0.0].min())
    assert least[False] < 1e-3
    assert 0.02 < least[True] < 2.0


def test_a_recording_that_is_held_out_is_predicted_in_stretches_as_long_as_the_fitted_ones() -> None:
    """One stretch as long as all others together would be most of the noise, and predicted from half of the rows."""
    robot = load_robot(recording_file("emps.urdf"))
    fitted, unseen = (
        prepare([read_recording(recording_file(name))], robot, BaseRegressor(robot), DiagnosisSettings(), None)
        for name in ("emps_a.npz", "emps_b.npz")
    )
    rows = build_rows(fitted, unseen)
    size = np.bincount(rows.part)
    assert size.size == len(rows.parts) == 2 * rows.folds
    assert size[rows.folds :].sum() == sum(item.frequency.size for item in unseen.evidences)
    assert size.max() < 2 * size.min()
