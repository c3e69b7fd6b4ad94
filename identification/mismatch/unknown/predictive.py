"""What a class is worth on held-out rows: log p(held out | fitted) with it minus without it, in nats.

Weights and variances come from the fitted rows alone (the chain rule); the noise of the held-out rows is estimated band
by band with the price of `evidence`, with the class and without it, so that broadband torque is the rival of every
class there too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.mismatch.unknown.evidence import Hyper, JointGram, Shared, log_prior, marginal, posterior, updated
from identification.mismatch.unknown.rows import products
from identification.mismatch.unknown.selection import FEW_ROUNDS, Selection

__all__ = ["log_predictive"]


@dataclass(frozen=True, slots=True, eq=False)
class _Joint:
    """One joint's fitted rows and its held-out ones beside them, as bands of their own."""

    fitted: JointGram
    both: JointGram
    hyper: Hyper


def log_predictive(selection: Selection) -> float:
    """Nats of the held-out rows of all joints under a selection of the fitted ones; but for what all share."""
    settings, measured = selection.settings, selection.rows.problem.noise_is_measured
    rows, odds = settings.noise_rows if measured else 0.0, float(np.exp(-settings.prior_cost))
    joints = [_stacked(selection, joint) for joint in range(selection.rows.problem.n)]
    fitted = Shared.of([marginal(item.fitted, item.hyper) for item in joints], selection.rows.prior).log_evidence
    bands = selection.rows.count.shape[2]
    hypers = [Hyper(item.hyper.variance, np.tile(item.hyper.noise, 2)) for item in joints]
    for _ in range(FEW_ROUNDS):
        parts = [marginal(item.both, hyper) for item, hyper in zip(joints, hypers, strict=True)]
        shared = Shared.of(parts, selection.rows.prior)
        for place, (item, hyper) in enumerate(zip(joints, hypers, strict=True)):
            now = posterior(item.both, parts[place], shared)
            noise = updated(item.both, hyper, now, np.inf, rows, odds).noise
            noise[:bands] = item.hyper.noise
            hypers[place] = Hyper(hyper.variance, noise)
    parts = [marginal(item.both, hyper) for item, hyper in zip(joints, hypers, strict=True)]
    prior = sum(log_prior(hyper.noise[bands:], rows, odds) for hyper in hypers)
    return Shared.of(parts, selection.rows.prior).log_evidence - fitted + prior


def _stacked(selection: Selection, joint: int) -> _Joint:
    rows, state = selection.rows, selection.states[joint]
    there = np.flatnonzero(rows.part == rows.folds)
    whitened = rows.joints[joint].whitened[there]
    size = rows.joints[joint].columns
    kept = np.concatenate([selection.columns(joint, state), np.arange(size, whitened.shape[1])])
    seen, bands = whitened[:, kept], rows.count.shape[2]
    gram = products(seen, seen, rows.band[there], (1, bands))[0]
    used = rows.problem.weight[joint, there] > 0.0
    count = np.bincount(rows.band[there], weights=used, minlength=bands).astype(np.float64)
    both = JointGram(
        np.concatenate([state.gram.gram, gram]), np.concatenate([state.gram.count, count]), state.gram.group
    )
    return _Joint(state.gram, both, state.hyper)
