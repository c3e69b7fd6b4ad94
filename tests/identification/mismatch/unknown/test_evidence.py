"""Claims about the Gaussian model. Truth: SciPy's density of the stacked rows, and a numerical optimum."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from identification.mismatch.unknown import evidence
from identification.mismatch.unknown.evidence import (
    Hyper,
    JointGram,
    Shared,
    log_prior,
    loss_without,
    marginal,
    posterior,
    squares_of,
    updated,
)

BANDS = np.repeat([0, 1], [14, 22])
GROUPS = np.repeat([0, 1], [3, 2])
SHARED = 4
PRECISION = 0.01
FLAT = np.full(SHARED, evidence.FREE)


def rows_of(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(B, F, y) of one joint: a class that is there and one that is not, and noise that is larger in a band."""
    random = np.random.default_rng(seed)
    columns, base = random.normal(size=(BANDS.size, 5)), random.normal(size=(BANDS.size, SHARED))
    noise = np.where(BANDS == 1, 2.0, 1.0) * random.normal(size=BANDS.size)
    return columns, base, columns[:, :3] @ (2.0 * random.normal(size=3)) + base @ np.ones(SHARED) + noise


def gram_of(columns: np.ndarray, base: np.ndarray, torque: np.ndarray) -> JointGram:
    every = np.concatenate([columns, base, torque[:, None]], axis=1)
    parts = np.stack([every[band == BANDS].T @ every[band == BANDS] for band in (0, 1)])
    return JointGram(parts, np.bincount(BANDS).astype(float), GROUPS)


def density(joints: list[tuple[np.ndarray, np.ndarray, np.ndarray]], hypers: list[Hyper]) -> float:
    """Log density of all rows of all joints, base parameters with a prior of precision PRECISION."""
    base = np.concatenate([item[1] for item in joints])
    covariance = base @ base.T / PRECISION
    first = 0
    for (columns, _, torque), hyper in zip(joints, hypers, strict=True):
        own = (columns * hyper.variance[GROUPS]) @ columns.T + np.diag(hyper.noise[BANDS])
        covariance[first : first + torque.size, first : first + torque.size] += own
        first += torque.size
    return float(
        multivariate_normal(cov=covariance, allow_singular=False).logpdf(np.concatenate([j[2] for j in joints]))
    )


def test_log_evidence_is_the_density_of_the_stacked_rows() -> None:
    # SciPy takes a prior that says nothing for a singular covariance; one that says something must come out as well.
    joints = [rows_of(1), rows_of(2)]
    grams = [gram_of(*item) for item in joints]
    hypers = [Hyper(np.array([3.0, 0.2]), np.array([1.0, 3.5])), Hyper(np.array([0.7, 1.9]), np.array([1.3, 4.0]))]
    other = [Hyper(np.array([0.5, 0.01]), np.array([2.0, 2.5])), hypers[1]]
    ours, theirs = (
        [
            Shared.of(
                [marginal(gram, hyper) for gram, hyper in zip(grams, chosen, strict=True)], np.full(SHARED, PRECISION)
            ).log_evidence
            for chosen in (hypers, other)
        ],
        [density(joints, chosen) for chosen in (hypers, other)],
    )
    constant = 0.5 * SHARED * np.log(evidence.FREE) - 0.5 * 2 * BANDS.size * np.log(2.0 * np.pi)
    assert ours[0] - ours[1] == pytest.approx(theirs[0] - theirs[1], abs=1e-4)
    assert ours[0] + constant == pytest.approx(theirs[0], abs=1e-3)


@pytest.mark.parametrize("noise_rows", [0.0, 20.0])
def test_the_fixed_point_is_where_a_numerical_optimiser_ends(noise_rows: float) -> None:
    gram, odds = gram_of(*rows_of(5)), np.exp(-4.0)

    def value(hyper: Hyper) -> float:
        return Shared.of([marginal(gram, hyper)], FLAT).log_evidence + log_prior(hyper.noise, noise_rows, odds)

    hyper = Hyper(np.full(2, 0.5), np.ones(2))
    for _ in range(300):
        part = marginal(gram, hyper)
        hyper = updated(gram, hyper, posterior(gram, part, Shared.of([part], FLAT)), 100.0, noise_rows, odds)
    best = minimize(
        lambda x: -value(Hyper(np.exp(x[:2]), np.exp(x[2:]))),
        np.log([1.0, 0.1, 1.0, 3.0]),
        bounds=[(np.log(1e-4), np.log(100.0))] * 2 + [(-5.0, 5.0)] * 2,
        method="L-BFGS-B",
    )
    assert value(hyper) == pytest.approx(-best.fun, abs=0.02)
    assert hyper.variance[0] == pytest.approx(np.exp(best.x[0]), rel=0.05)
    assert hyper.noise == pytest.approx(np.exp(best.x[2:]), rel=0.05)


def test_what_a_class_is_missed_by_is_the_difference_of_two_evidences() -> None:
    gram = gram_of(*rows_of(9))
    hyper = Hyper(np.array([2.0, 0.3]), np.array([1.1, 3.0]))
    part = marginal(gram, hyper)
    now = posterior(gram, part, Shared.of([part], FLAT))
    for group in (0, 1):
        rest = gram.only([1 - group])
        less = Shared.of([marginal(rest, Hyper(hyper.variance[[1 - group]], hyper.noise))], FLAT).log_evidence
        expected = Shared.of([part], FLAT).log_evidence - less
        assert loss_without(gram, hyper, now, [group]) == pytest.approx(expected, abs=1e-6)


def test_weights_and_base_parameters_are_those_of_generalised_least_squares() -> None:
    columns, base, torque = rows_of(3)
    gram = gram_of(columns, base, torque)
    hyper = Hyper(np.array([2.0, 0.3]), np.array([1.1, 3.0]))
    part = marginal(gram, hyper)
    now = posterior(gram, part, Shared.of([part], FLAT))
    every = np.concatenate([columns, base], axis=1)
    weight = 1.0 / hyper.noise[BANDS]
    prior = np.diag(np.concatenate([1.0 / hyper.variance[GROUPS], np.full(SHARED, evidence.FREE)]))
    precision = every.T @ (weight[:, None] * every) + prior
    solution = np.linalg.solve(precision, every.T @ (weight * torque))
    assert np.concatenate([now.weights, now.base]) == pytest.approx(solution, abs=1e-8)
    assert now.covariance == pytest.approx(np.linalg.inv(precision), abs=1e-8)
    left = (torque - every @ solution) ** 2
    assert now.left == pytest.approx([left[band == BANDS].sum() for band in (0, 1)])


def gram_of_rows(rows: tuple[np.ndarray, np.ndarray, np.ndarray], chosen: np.ndarray) -> JointGram:
    columns, base, torque = rows
    every = np.concatenate([columns, base, torque[:, None]], axis=1)
    parts = np.stack([every[chosen & (band == BANDS)].T @ every[chosen & (band == BANDS)] for band in (0, 1)])
    return JointGram(parts, np.bincount(BANDS[chosen], minlength=2).astype(float), GROUPS)


@pytest.mark.parametrize("open_direction", [False, True])
def test_what_is_left_of_rows_that_were_not_fitted_is_that_of_their_residuals(open_direction: bool) -> None:
    """Truth: rows written out. A base column that the fitted rows do not hold is settled on the others."""
    columns, base, torque = rows_of(5)
    fitted = np.arange(BANDS.size) % 3 != 0
    if open_direction:
        base[fitted, 0] = 0.0
    hyper = Hyper(np.array([4.0, 1.0]), np.array([1.0, 1.5]))
    seen, every = (gram_of_rows((columns, base, torque), chosen) for chosen in (fitted, np.ones_like(fitted)))
    part = marginal(seen, hyper)
    shared = Shared.of([part], FLAT)
    now = posterior(seen, part, shared)
    squares, count = squares_of(every.less(seen), part, shared, hyper.noise)
    left = (torque - columns @ now.weights - base @ now.base)[~fitted]
    if open_direction:
        own = base[~fitted, 0]
        left = left - own * (own @ left) / (own @ own)
    assert squares == pytest.approx(left @ left, rel=1e-5)
    assert count == left.size - open_direction
