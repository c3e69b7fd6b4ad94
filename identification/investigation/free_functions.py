"""A free function of the same state in a name's place: what it would weigh, were the name true.

The diagnosis gives a name only where it explains more than every class of dependence could in its place. Were the name
true, a class takes up what its functions can, at the size that is worth most, and costs what its freedom does. Here:
that weight, and which classes come nearest. Not here: the classes (`identification.mismatch.unknown`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.unknown.evidence import JointGram
from identification.mismatch.unknown.rows import JointRows

NEAREST = 3
"""Free functions that are weighed against each name."""
_SIZES = np.geomspace(0.03, 1e4, 16)[:, None]
"""Of a class, as multiples of what gives it the strength of the name."""


def lead(strength: float, own: FloatArray, across: FloatArray) -> float:
    """Nats by which a name leads a free function in its place, were the name true, their prior odds left out.

    strength: λ of the name. own: (q, q) BᵀB of the function's whitened columns; across: (q,) Bᵀ times the name's
    torque; base parameters taken off both. The function's weights are N(0, v), v as is worth most.
    """
    values, vectors = np.linalg.eigh(own)
    values, along = np.maximum(values, 0.0), (vectors.T @ across) ** 2
    total = float(values.sum())
    if total <= 0.0 or strength <= 0.0:
        return 0.5 * max(strength, 0.0)
    variances = _SIZES * strength / total
    grown = variances * values
    taken = 0.5 * np.sum(variances * along / (1.0 + grown) - np.log1p(grown), axis=1)
    return 0.5 * strength - max(0.0, float(taken.max()))


def nearest(
    grams: Sequence[JointGram], noises: Sequence[FloatArray], rows: JointRows, joint: int, size: FloatArray,
    described: Collection[int],
) -> tuple[int, ...]:  # fmt: skip
    """Places in `rows.bases` of the free functions of a joint (from 0) that a name of this size leads least.

    grams: of all joints, the name's columns last before the torque. noises: of each joint, per band. size: (k,) of the
    name. described: numbers of classes that the name describes completely: no rivals of it.
    """
    weighted = [np.tensordot(1.0 / noise, item.gram, axes=1) for item, noise in zip(grams, noises, strict=True)]
    shared = np.sum(
        [total[item.columns : -1, item.columns : -1] for item, total in zip(grams, weighted, strict=True)], axis=0
    )
    base, count = len(shared) - size.size, grams[joint].columns
    across = weighted[joint][:count, count:-1]
    solved = np.linalg.solve(shared[:base, :base], np.column_stack([across[:, :base].T, shared[:base, base:] @ size]))
    own = weighted[joint][:count, :count] - across[:, :base] @ solved[:, :-1]
    taken = across[:, base:] @ size - across[:, :base] @ solved[:, -1]
    strength = float(size @ shared[base:, base:] @ size - (shared[:base, base:] @ size) @ solved[:, -1])
    found = []
    for place, basis in enumerate(rows.bases):
        if basis.number not in described:
            chosen = np.flatnonzero(rows.group == place)
            found.append((lead(strength, own[chosen[:, None], chosen], taken[chosen]), place))
    return tuple(place for _, place in sorted(found)[:NEAREST])
