"""Claims about hypotheses, motions and forecasts. Truth: closed forms, random draws, limits of the arm."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest, norm

from identification.excitation import TableTrajectory, iiwa_limits
from identification.investigation import columns
from identification.investigation.columns import Form, Sums
from identification.investigation.equivalences import inseparable, twins_of
from identification.investigation.experiments import KINDS, PERIOD_S, Room, experiment, experiments
from identification.investigation.forecast import APART, forecast, stands_out
from identification.investigation.hypotheses import NOTHING, Hypothesis
from identification.investigation.separation import Layout, agreement, separations
from identification.mismatch.effects.base import Place
from identification.mismatch.settings import LEAST_SHOWN, DiagnosisSettings

ROOM = Room(iiwa_limits("iiwa14"), np.zeros(7))


def hypothesis(effect: str, joint: int, log_odds: float, probability: float, size: float = 1.0) -> Hypothesis:
    form = Form.of(effect, Place(joint), {})
    return Hypothesis(effect, Place(joint), (form,), form, np.array([size]), np.array([[1e-12]]), log_odds, probability)


def sums_of_columns(base: np.ndarray, columns: np.ndarray) -> Sums:
    both = np.hstack([base, columns])
    return Sums(both.T @ both, base.shape[1])


def test_separation_is_the_distance_that_base_parameters_and_the_rival_leave() -> None:
    """Truth: least squares on the rows themselves."""
    random = np.random.default_rng(5)
    base, first, second = (random.normal(size=(400, k)) for k in (6, 1, 1))
    second = 0.95 * first + 0.3 * second
    one, two = hypothesis("torque_offset", 1, 5.0, 0.5, 0.7), hypothesis("cable_spring", 1, 5.0, 0.5, 0.4)
    two = replace(two, coefficients=np.array([0.4, 0.0]))
    layout = Layout.of([one, two])
    sums = sums_of_columns(base, np.hstack([first, second, 0.0 * second]))
    found = separations(sums, layout, [one, two, NOTHING])

    def left(target: np.ndarray, columns: np.ndarray) -> float:
        return float(np.sum((target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]) ** 2))

    assert found[0, 1] == pytest.approx(left(0.7 * first, np.hstack([base, second])), rel=1e-6)
    assert found[1, 0] == pytest.approx(left(0.4 * second, np.hstack([base, first])), rel=1e-6)
    assert found[0, 2] == pytest.approx(left(0.7 * first, base), rel=1e-6)


def test_classes_take_up_what_their_size_allows() -> None:
    """Truth: generalised least squares with the covariance noise + B V Bᵀ, written out over the rows."""
    random = np.random.default_rng(7)
    base, column, classes = (random.normal(size=(300, k)) for k in (4, 2, 9))
    column = column + classes[:, :2]
    deviations = np.where(np.arange(9) < 6, random.uniform(0.05, 0.5, 9), 0.0)
    together = np.hstack([classes, base, column])
    sums = Sums(np.hstack([base, column]).T @ np.hstack([base, column]), 4, (classes.T @ together,))
    precision = np.linalg.inv(np.eye(300) + (classes * deviations**2) @ classes.T)
    taken = precision @ base @ np.linalg.inv(base.T @ precision @ base) @ base.T @ precision
    np.testing.assert_allclose(sums.projected([deviations]), column.T @ (precision - taken) @ column, rtol=1e-8)


SHOWN = 1e4 * np.eye(2)
"""Much more of each hypothesis than a name needs."""


def test_what_has_no_name_is_not_foretold_to_get_one() -> None:
    """A class of its own leads: whatever a motion shows, a form that is not there does not come to stand out."""
    unnamed = replace(NOTHING, probability=0.9, log_odds=0.0, beside=(np.array([0.1]),))
    alive = (unnamed, hypothesis("cable_spring", 1, -2.2, 0.1))
    after = np.full((2, 2), 400.0)
    assert forecast(alive, np.zeros((2, 2)), after).probability == pytest.approx(0.1, abs=1e-3)
    assert unnamed.name == "no form of the library (joint 1)"


@pytest.mark.parametrize("shown", [1.1, 0.9])
def test_a_name_is_foretold_where_it_will_show_as_much_as_the_diagnosis_asks(shown: float) -> None:
    """A weak effect that nothing looks like leads every rival for certain, and has no name below λ = 60."""
    alive = (hypothesis("cable_spring", 1, 50.0, 1.0), NOTHING)
    then = np.array([[shown * LEAST_SHOWN, 1e3], [1e3, 0.0]])
    found = forecast(alive, np.array([[20.0, 0.0], [0.0, 0.0]]), then)
    assert found.named_now == pytest.approx(0.0, abs=1e-6)
    assert found.named == pytest.approx(float(shown > 1.0), abs=1e-6)


def test_a_forecast_of_two_hypotheses_is_the_gaussian_log_odds_integral() -> None:
    """Truth: log odds of a known waveform are N(λ/2, λ), drawn a hundred thousand times."""
    alive = (hypothesis("torque_offset", 1, 0.0, 0.5), hypothesis("cable_spring", 1, 0.0, 0.5))
    strength = 16.0
    found = forecast(alive, SHOWN, SHOWN + strength * (1.0 - np.eye(2)))
    random = np.random.default_rng(1)
    rows = random.normal(size=(100_000, 4))
    truth = np.full(4, math.sqrt(strength) / 2.0)
    odds = 0.5 * np.sum((rows) ** 2 - (rows + truth) ** 2, axis=1) * -1.0
    assert found.probability == pytest.approx(np.mean(odds >= APART), abs=5e-3)
    assert found.probability == pytest.approx(norm.cdf((strength / 2.0 - APART) / math.sqrt(strength)), abs=1e-3)
    assert found.hardest is not None


def test_a_motion_that_adds_nothing_foretells_nothing() -> None:
    alive = (hypothesis("torque_offset", 1, 1.0, 0.6), hypothesis("cable_spring", 1, 0.5, 0.4))
    standing = np.array([[100.0, 9.0], [9.0, 100.0]])
    found = forecast(alive, standing, standing)
    assert found.probability == pytest.approx(found.now)
    assert found.probability < 1e-3
    assert not stands_out(alive)


def test_the_more_a_motion_shows_the_more_surely_it_tells() -> None:
    alive = (hypothesis("torque_offset", 1, 1.0, 0.6), hypothesis("cable_spring", 1, 0.5, 0.4))
    chances = [forecast(alive, SHOWN, SHOWN + strength * (1.0 - np.eye(2))).probability for strength in (1, 9, 30, 90)]
    assert chances == sorted(chances)
    assert chances[-1] > 0.99


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_motion_keeps_to_the_limits_and_closes_its_period(kind: str) -> None:
    limits = ROOM.limits
    for seed in range(6):
        joint = None if kind == "fourier" else seed
        motion = experiment(np.random.default_rng(seed), ROOM, kind, joint)
        q, dq, ddq = motion.states
        assert np.all(q <= limits.position_upper)
        assert np.all(q >= limits.position_lower)
        assert np.all(np.abs(dq) <= limits.velocity)
        assert np.all(np.abs(ddq) <= limits.acceleration)
        table = motion.trajectory("iiwa14").table()
        assert len(table) == round(1000 * PERIOD_S)
        step = np.abs(np.diff(np.vstack([table, table[:1]]), axis=0)).max(axis=0)
        assert np.all(step <= 1e-3 * limits.velocity)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_no_motion_accelerates_beyond_the_band_in_which_a_recorded_motion_is_read(kind: str) -> None:
    """Truth: lines of the acceleration; a thousandth of 1 rad/s² is a few mNm at the heaviest joint."""
    random, band_hz = np.random.default_rng(8), DiagnosisSettings().motion_bandwidth_hz
    for number in range(30):
        acceleration = experiment(random, ROOM, kind, None if kind == "fourier" else number % 7).states[2]
        lines = np.fft.rfft(acceleration, axis=0) / len(acceleration)
        beyond = lines[int(band_hz * PERIOD_S) + 1 :]
        assert np.sqrt(2.0 * (np.abs(beyond) ** 2).sum(axis=0)).max() < 1e-3


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"fourier"}))
def test_no_joint_rests_while_another_is_asked(kind: str) -> None:
    """A joint at rest is held by its friction and takes any torque."""
    motion = experiment(np.random.default_rng(3), ROOM, kind, 2)
    slow = np.abs(motion.states[1]) < 1e-3
    assert np.all(slow.mean(axis=0) < 0.2)


def test_the_same_seed_gives_the_same_motions() -> None:
    for first, second in zip(
        experiments(np.random.default_rng(8), ROOM, [1]), experiments(np.random.default_rng(8), ROOM, [1]), strict=False
    ):
        assert first.kind == second.kind
        np.testing.assert_array_equal(first.table, second.table)
        if first.kind == "whole_range":
            break


def test_one_torque_under_two_names_is_found_and_two_torques_are_not() -> None:
    alive = (hypothesis("torque_sensor_gain", 1, 9.0, 0.5), hypothesis("payload", 1, 9.0, 0.49), NOTHING)
    same = np.array([[0.0, 1e-6, 500.0], [1e-6, 0.0, 500.0], [500.0, 500.0, 0.0]])
    other = np.array([[0.0, 30.0, 500.0], [20.0, 0.0, 500.0], [500.0, 500.0, 0.0]])
    assert inseparable(alive, same) == ((0, 1),)
    assert inseparable(alive, other) == ()


def test_an_offset_is_always_said_to_be_asymmetric_coulomb_friction_too() -> None:
    (found,) = twins_of(["torque_offset", "torque_offset", "stribeck_friction"])
    assert "differs between the two directions" in found.sentence
    assert "Warm the arm up" in found.sentence


def recordings_of(sizes: list[float], seed: int) -> list[Any]:
    """Rows of one column beside three base columns, a size of its own for each recording, unit noise."""
    random = np.random.default_rng(seed)
    found = []
    for size in sizes:
        nominal, column = random.normal(size=(60, 7, 3)), random.normal(size=(60, 7, 1))
        torque = nominal @ np.array([1.0, -2.0, 0.5]) + size * column[..., 0] + random.normal(size=(60, 7))
        found.append(SimpleNamespace(nominal=nominal, noise=np.ones((60, 7)), torque=torque, column=column))
    return found


def test_sizes_of_recordings_agree_by_chance_as_often_as_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: drawn recordings; chances of one size are uniform, and another size in one of them is found."""
    monkeypatch.setattr(columns, "form_rows", lambda *given: given[0].column)
    form = Form.of("torque_offset", Place(1), {})
    chances = np.array([agreement(recordings_of([0.3, 0.3, 0.3], seed), form) for seed in range(60)])
    assert kstest(chances, "uniform").pvalue > 1e-3
    assert agreement(recordings_of([0.3, 0.3, 0.6], 1), form) < 1e-3
    assert agreement(recordings_of([0.3], 1), form) == 1.0


@pytest.mark.parametrize("rows", [500, 501])
def test_a_table_is_refined_by_the_interpolation_that_evaluate_states(rows: int) -> None:
    random = np.random.default_rng(rows)
    table = TableTrajectory(random.normal(size=(rows, 2)), rows / 5.0)
    fine = table.table(1000.0)
    np.testing.assert_allclose(fine, table.evaluate(np.arange(5000) * 1e-3)[0], atol=1e-9)


SIZE, CLASS = 0.6, 0.15


def log_evidence(columns: np.ndarray, variances: np.ndarray, torque: np.ndarray) -> float:
    """Log p(torque) under unit noise and independent weights of these variances."""
    covariance = np.eye(len(torque)) + (columns * variances) @ columns.T
    factor = np.linalg.cholesky(covariance)
    half = np.linalg.solve(factor, torque)
    return float(-0.5 * half @ half - np.log(np.diag(factor)).sum())


def one_forecast(random: np.random.Generator) -> tuple[float, bool]:
    """A forecast and whether it came true, in a world of two look-alike forms, base parameters and a class.

    Truth: evidences by the full covariance of the rows, before and after the rows that were foretold.
    """
    rows, new = 60, int(random.integers(10, 200))
    base, classes = random.normal(size=(rows + new, 3)), random.normal(size=(rows + new, 5))
    first = random.normal(size=(rows + new, 1)) + classes[:, :1]
    second = 0.7 * first + 0.7 * random.normal(size=(rows + new, 1))
    shapes, true = (first, second), int(random.integers(2))
    size = SIZE * random.normal()
    torque = base @ random.normal(size=3) * 3.0 + classes @ (CLASS * random.normal(size=5))
    torque += size * shapes[true][:, 0] + random.normal(size=rows + new)

    def evidences(upto: int) -> list[float]:
        variances = np.r_[np.full(3, 9.0), np.full(5, CLASS**2), SIZE**2]
        return [log_evidence(np.hstack([base, classes, shape])[:upto], variances, torque[:upto]) for shape in shapes]

    before = evidences(rows)
    weight = np.exp(before - np.max(before))
    alive = []
    for shape, name, odds, share in zip(
        shapes, ("torque_offset", "torque_sensor_drift"), before, weight / weight.sum(), strict=True
    ):
        matrix = np.hstack([base, classes, shape])[:rows]
        precision = matrix.T @ matrix + np.diag(1.0 / np.r_[np.full(3, 9.0), np.full(5, CLASS**2), SIZE**2])
        covariance = np.linalg.inv(precision)
        mean = covariance @ matrix.T @ torque[:rows]
        form = Form.of(name, Place(1), {})
        alive.append(
            Hypothesis(
                name,
                Place(1),
                (form,),
                form,
                mean[-1:],
                covariance[-1:, -1:],
                odds - before[0],
                float(share),
                (np.zeros(0),),
            )
        )
    both = np.hstack([base, first, second])

    def sums(part: slice) -> Sums:
        own = classes[part].T @ np.hstack([classes, both])[part]
        return Sums(both[part].T @ both[part], 3, (own,))

    class Beside:
        """One joint with one class of five columns."""

        bases = ((),)

        def deviations(self, variances: object) -> tuple[np.ndarray, ...]:
            del variances
            return (np.full(5, CLASS),)

    layout = Layout(tuple(item.forms[0] for item in alive))
    now = separations(sums(slice(0, rows)), layout, alive, Beside())  # type: ignore[arg-type]
    then = separations(sums(slice(0, rows + new)), layout, alive, Beside())  # type: ignore[arg-type]
    foretold = forecast(alive, now, then).probability
    after = evidences(rows + new)
    matrix = np.hstack([base, classes, shapes[true]])
    precision = matrix.T @ matrix + np.diag(1.0 / np.r_[np.full(3, 9.0), np.full(5, CLASS**2), SIZE**2])
    found = float(np.linalg.solve(precision, matrix.T @ torque)[-1])
    left = shapes[true][:, 0] - base @ np.linalg.lstsq(base, shapes[true][:, 0], rcond=None)[0]
    shown = found**2 * float(left @ left)
    return foretold, after[true] - after[1 - true] >= APART and shown >= LEAST_SHOWN


def test_a_forecast_comes_true_as_often_as_it_says() -> None:
    """Bins of forecasts over 600 drawn worlds whose model is the true one: foretold and come true agree."""
    random = np.random.default_rng(12)
    pairs = np.array([one_forecast(random) for _ in range(600)])
    for low, high in ((0.0, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.01)):
        inside = pairs[(pairs[:, 0] >= low) & (pairs[:, 0] < high)]
        mean, share = inside.mean(axis=0)
        spread = math.sqrt(max(mean * (1.0 - mean), 1e-3) / len(inside))
        assert abs(share - mean) < 3.0 * spread + 0.02, (low, len(inside), mean, share)
