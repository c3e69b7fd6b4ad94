"""Rows and products of the classes: what is put together piece by piece is what plain products give."""

from __future__ import annotations

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.evidence import rows_of_each
from identification.mismatch.prepared import prepare
from identification.mismatch.settings import HIDDEN, VARIANCE_CAP, DiagnosisSettings
from identification.mismatch.unknown.classes import CLASSES, STATE_ORDER
from identification.mismatch.unknown.functions import smooth_table, tabulated
from identification.mismatch.unknown.model_terms import terms_of, terms_torque
from identification.mismatch.unknown.rows import Rows, build_rows
from identification.mismatch.unknown.selection import Selection
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record


@pytest.fixture(scope="module")
def rows(iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters) -> Rows:
    def kink(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return on_joint(4, np.maximum(q[:, 3] - np.median(q[:, 3]), 0.0))

    roles = [
        prepare(
            [record(iiwa14, table3, kink, periods=4, motion=motion)], iiwa14, iiwa14_base, DiagnosisSettings(), None
        )
        for motion in (3, 9)
    ]
    return build_rows(roles[0], roles[1]).resolved()


def plain_products(rows: Rows, joint: int) -> np.ndarray:
    """(parts, bands, M, M) of one joint, from its rows."""
    whitened = rows.joints[joint].whitened
    chosen = [
        [whitened[(rows.part == part) & (rows.band == band)] for band in range(rows.count.shape[2])]
        for part in range(rows.count.shape[1])
    ]
    return np.array([[block.T @ block for block in part] for part in chosen])


def test_columns_that_are_added_have_the_products_of_all_columns(rows: Rows) -> None:
    columns = np.random.default_rng(1).normal(size=(7, rows.problem.rows, 3))
    grown = rows.with_columns([(columns[..., :2], np.ones(2)), (columns[..., 2:], np.ones(1))])
    assert grown.joints[3].whitened.shape[1] == rows.joints[3].whitened.shape[1] + 3
    truth = plain_products(grown, 3)
    assert np.abs(grown.grams[3] - truth).max() < 1e-9 * np.abs(truth).max()


def test_parts_together_have_the_sum_of_their_products(rows: Rows) -> None:
    truth = plain_products(rows, 3)
    for parts in ([0], [1], [0, 1]):
        together = rows.of(parts)[3]
        assert np.abs(together.gram - truth[parts].sum(axis=0)).max() < 1e-9 * np.abs(truth).max()


def test_the_functions_of_the_state_are_products_of_functions_of_one_variable(rows: Rows) -> None:
    inputs = rows.inputs[0]
    (state,) = (item for item in CLASSES if item.name == "state")
    values, _ = state.groups[0](inputs, 0)
    own = tabulated(smooth_table(1.0, STATE_ORDER, ()), inputs.position[:, 0])[:, 0]
    speed = tabulated(smooth_table(1.0, STATE_ORDER, ()), inputs.velocity[:, 0])[:, 0]
    table = smooth_table(2.0, STATE_ORDER, ())
    rest = [tabulated(table, inputs.position[:, joint])[:, :2] for joint in range(1, 7)]
    # The largest one that is not the constant: one joint far off in its second function, all else in the first.
    candidates = []
    for far in range(6):
        parts = [item[:, int(joint == far)] for joint, item in enumerate(rest)]
        candidates.append(own * speed * np.prod(parts, axis=0))
    distance = [np.abs(values - candidate[:, None]).max(axis=0).min() for candidate in candidates]
    assert max(distance) < 1e-12


def test_only_what_no_hypothesis_tells_from_noise_is_left_out_of_the_functions(rows: Rows) -> None:
    """Truth: the functions themselves, sent through the projection of the torque."""
    own, weight = rows.joints[3], rows.problem.weight[3][:, None]
    assert own.columns < sum(len(shown) for shown in own.shown)
    for place, (basis, shown) in enumerate(zip(own.bases, own.shown, strict=True)):
        parts = [item.project(basis.columns(inputs)) for item, inputs in zip(rows.evidences, rows.inputs, strict=True)]
        functions = np.concatenate(parts) * weight
        kept = functions @ shown
        assert np.abs(own.whitened[:, np.flatnonzero(own.group == place)] - kept).max() < 1e-9 * np.abs(functions).max()
        left_out = np.linalg.norm(functions - kept @ shown.T, 2) ** 2
        assert left_out * VARIANCE_CAP * rows.misfit[3] <= HIDDEN * (1.0 + 1e-6)


def test_a_models_terms_have_the_torque_that_the_rows_were_given(rows: Rows) -> None:
    """Their weights are of functions, those of the rows of what shows of these."""
    selection = Selection.of(rows, [0])
    selection.states[3] = state = selection.full(3)
    weights = selection.posterior(3, state).weights
    torque = terms_torque(terms_of(selection), rows.evidences[0].motion)[:, 3]
    here = rows_of_each(rows.evidences)[0]
    expected = rows.joints[3].whitened[here, : weights.size] @ weights
    found = rows.evidences[0].project(torque[:, None])[:, 0] * rows.problem.weight[3][here]
    assert np.abs(expected).max() > 1.0
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
