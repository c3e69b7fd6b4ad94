"""Claims about forecasts where a form fades, or holds another one. Truth: evidences and fits of drawn rows."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from identification.investigation import choice
from identification.investigation.choice import Chooser
from identification.investigation.columns import Form, Sums
from identification.investigation.forecast import STANDS_OUT, forecast
from identification.investigation.hypotheses import NOTHING, Hypothesis
from identification.investigation.separation import Layout, beside_names, separations, special_cases
from identification.mismatch.effects.base import Place
from identification.mismatch.names.alternatives import EXPLAINS_MORE
from identification.mismatch.settings import ALTERNATIVE, LEAST_SHOWN, SPEAK

BASE_VARIANCE, LARGEST, ROWS = 9.0, 0.3, 60
EFFECTS = {1: ("torque_offset", "torque_sensor_gain"), 2: ("cable_spring", "position_dependent_torque")}


def log_evidence(columns: np.ndarray, variances: np.ndarray, torque: np.ndarray) -> float:
    """Log p(torque) under unit noise and independent weights of these variances, less that of no weights."""
    precision = np.diag(1.0 / variances) + columns.T @ columns
    across = columns.T @ torque
    determinant = np.linalg.slogdet(precision)[1] + np.log(variances).sum()
    return float(0.5 * (across @ np.linalg.solve(precision, across) - determinant))


def fitted(base: np.ndarray, columns: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Size of a form beside base parameters, and its covariance."""
    both = np.hstack([base, columns])
    covariance = np.linalg.inv(both.T @ both)
    return (covariance @ both.T @ torque)[base.shape[1] :], covariance[base.shape[1] :, base.shape[1] :]


def odds_over_nothing(base: np.ndarray, columns: np.ndarray, torque: np.ndarray) -> float:
    """As the assessment weighs a form: beforehand each coefficient is as large as makes its torque the average one."""
    square = (columns**2).sum(axis=0)
    own = np.mean(square * fitted(base, columns, torque)[0] ** 2) / square
    free = np.full(base.shape[1], BASE_VARIANCE)
    whole = log_evidence(np.hstack([base, columns]), np.r_[free, own], torque)
    return whole - log_evidence(base, free, torque) - math.log(4.0)


def one_forecast(random: np.random.Generator, size: int) -> tuple[float, bool]:
    """A forecast and whether it came true, where nothing is or one of two forms with so many coefficients."""
    rows = ROWS + int(random.integers(10, 2000))
    base, first, second = (random.normal(size=(rows, count)) for count in (3, size, size))
    shapes, true = (first, second), int(random.integers(-1, 2))
    torque = base @ random.normal(size=3) + random.normal(size=rows)
    if true >= 0:
        torque += shapes[true] @ (LARGEST * random.normal(size=size))
    now, then = ([odds_over_nothing(base[:n], own[:n], torque[:n]) for own in shapes] for n in (ROWS, rows))
    free = np.full(3, BASE_VARIANCE)
    variances = np.r_[free, np.full(size, LARGEST**2)]
    before = [log_evidence(np.hstack([base, own])[:ROWS], variances, torque[:ROWS]) for own in shapes]
    share = np.exp([*before, log_evidence(base[:ROWS], free, torque[:ROWS])])
    share /= share.sum()
    alive = []
    for name, own, odds, chance in zip(EFFECTS[size], shapes, now, share, strict=False):
        form = Form.of(name, Place(1), {})
        found = fitted(base[:ROWS], own[:ROWS], torque[:ROWS])
        alive.append(Hypothesis(name, Place(1), (form,), form, *found, odds, float(chance)))
    hypotheses = (*alive, replace(NOTHING, probability=float(share[-1])))
    both = np.hstack([base, *shapes])
    layout = Layout(tuple(item.forms[0] for item in alive))
    told = [separations(Sums(both[:n].T @ both[:n], 3), layout, hypotheses) for n in (ROWS, rows)]
    foretold = forecast(hypotheses, *told).probability
    if true < 0:
        return foretold, max(then) <= -STANDS_OUT
    found, covariance = fitted(base, shapes[true], torque)
    shown = float(found @ np.linalg.solve(covariance, found))
    return foretold, then[true] >= STANDS_OUT and then[true] >= then[1 - true] + 4.6 and shown >= LEAST_SHOWN


@pytest.mark.parametrize("size", [1, 2])
def test_that_nothing_is_there_comes_true_as_often_as_it_is_foretold(size: int) -> None:
    """However much a motion shows, what speaks for a form can fade to nothing and no further: 65 % came true in 20."""
    random = np.random.default_rng(31)
    pairs = np.array([one_forecast(random, size) for _ in range(1200)])
    for low, high in ((0.0, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.01)):
        inside = pairs[(pairs[:, 0] >= low) & (pairs[:, 0] < high)]
        mean, share = inside.mean(axis=0)
        spread = math.sqrt(max(mean * (1.0 - mean), 1e-3) / len(inside))
        assert abs(share - mean) < 3.0 * spread + 0.02, (low, len(inside), mean, share)


def offset_and_spring(random: np.random.Generator, rows: int) -> tuple[np.ndarray, tuple[Hypothesis, Hypothesis]]:
    """Columns of three base parameters, an offset and a spring, and both as hypotheses; the spring holds the offset."""
    position = random.normal(size=(rows, 1))
    columns = np.hstack([random.normal(size=(rows, 3)), np.ones((rows, 1)), position, np.ones((rows, 1))])
    forms = [Form.of(name, Place(1), {}) for name in ("torque_offset", "cable_spring")]
    sizes = np.array([0.9]), np.array([0.01, 0.9])
    first, second = (
        Hypothesis(form.effect, Place(1), (form,), form, size, 1e-12 * np.eye(size.size), odds, share)
        for form, size, odds, share in zip(forms, sizes, (9.0, 8.0), (0.9, 0.1), strict=True)
    )
    return columns, (first, second)


def test_an_offset_gets_its_name_beside_a_spring_that_explains_as_much_whatever_is_recorded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Truth: fits of drawn rows, and what the diagnosis asks: a further coefficient has to bring two nats."""
    random = np.random.default_rng(8)
    columns, alive = offset_and_spring(random, 300)
    base, offset, spring = columns[:, :3], columns[:, 3:4], columns[:, 4:]
    alone = []
    for _ in range(2000):
        torque = 0.9 * offset[:, 0] + random.normal(size=300)
        left = [float(np.linalg.lstsq(np.hstack([base, own]), torque, rcond=None)[1][0]) for own in (offset, spring)]
        alone.append(0.5 * (left[0] - left[1]) - ALTERNATIVE <= -EXPLAINS_MORE)
    sums = Sums(columns.T @ columns, 3)
    layout = Layout.of(alive)
    assert special_cases(sums, layout, alive).tolist() == [[False, True], [False, False]]
    chooser: Any = SimpleNamespace(
        assessment=SimpleNamespace(alive=alive, discrepancies=None), recorded=sums, layout=layout,
        separated=separations(sums, layout, alive), rows=lambda *_: None, over_all=False,
        shown_beside=np.zeros(2),
    )  # fmt: skip
    monkeypatch.setattr(choice, "sums_of", lambda *_, **__: sums)
    found = Chooser.foretell(chooser, None, 4)  # type: ignore[arg-type]
    assert found.named == pytest.approx(0.9 * np.mean(alone), abs=0.02)


def test_a_form_that_another_one_only_resembles_is_no_special_case_of_it() -> None:
    columns, alive = offset_and_spring(np.random.default_rng(9), 300)
    columns[:, 3] += 0.1 * columns[:, 0] ** 2
    assert not special_cases(Sums(columns.T @ columns, 3), Layout.of(alive), alive).any()


def test_a_name_that_will_show_less_than_the_classes_beside_it_is_not_foretold() -> None:
    """Truth: λ of a class on drawn weights, by rows; and what the diagnosis asks, which gives no such name."""
    random = np.random.default_rng(10)
    base, name, other = random.normal(size=(200, 2)), random.normal(size=(200, 1)), random.normal(size=(200, 5))
    weights, deviation = random.normal(size=(4000, 5)), 0.3
    left = other - base @ np.linalg.lstsq(base, other, rcond=None)[0]
    mean = float(((left @ (deviation * weights.T)) ** 2).sum(axis=0).mean())
    both = np.hstack([base, name])
    sums = Sums(both.T @ both, 2, (other.T @ np.hstack([other, both]),))
    form = Form.of("torque_offset", Place(1), {})
    basis = SimpleNamespace(centre=np.zeros(5))
    free: Any = SimpleNamespace(deviations=lambda held: (np.repeat(np.sqrt(held[0]), 5),), bases=((basis,),))
    for share, named in ((0.9, 0.0), (1.1, 1.0)):
        size = np.sqrt(share * mean / (200.0 - 2.0)) * np.ones(1)
        held = (np.array([deviation**2]),)
        truth = Hypothesis("torque_offset", Place(1), (form,), form, size, 1e-12 * np.eye(1), 9.0, 0.9, held)
        shown = beside_names(sums, (truth, NOTHING), free)
        assert shown == pytest.approx([mean, 0.0], rel=0.03)
        told = np.array([[share * mean, 1e6], [1e6, 0.0]])
        assert forecast((truth, NOTHING), told, told, (shown, shown)).named == pytest.approx(named, abs=1e-6)


@pytest.mark.parametrize(("unnamed", "asked"), [(False, STANDS_OUT), (True, SPEAK)])
def test_beside_torque_without_a_name_free_functions_have_to_be_led_by_more(unnamed: bool, asked: float) -> None:
    """Truth: what the diagnosis asks, 3 nats, and 8 where a class speaks beside the name on any joint."""
    form = Form.of("torque_offset", Place(1), {})
    size, covariance = np.array([0.9]), np.array([[1e-12]])
    rival = replace(NOTHING, probability=0.1, beside=(np.array([0.2]), np.array([0.2])))
    sure = np.full((2, 2), 1e6)
    for above, named in ((0.5, 1.0), (-0.5, 0.0)):
        truth = Hypothesis(
            "torque_offset", Place(1), (form,), form, size, covariance, asked + above, 0.9,
            (np.array([0.0]), np.array([0.2])), unnamed,
        )  # fmt: skip
        assert forecast((truth, rival), sure, sure).named_now == pytest.approx(named)
