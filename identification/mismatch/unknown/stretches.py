"""Stretches of time that predict each other where the noise is not measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.arrays import IntArray
from identification.mismatch.evidence import Evidence
from identification.mismatch.settings import FOLDS


def parts_of(evidences: Sequence[Evidence], fitted: int, measured: bool) -> tuple[IntArray, int]:
    """Part of each row, and how many of these are fitted. Where noise is measured all rows of a role are one; else
    stretches of time in turn, those held out about as long as those fitted.
    """
    if measured:
        sizes = [sum(item.frequency.size for item in part) for part in (evidences[:fitted], evidences[fitted:])]
        return np.repeat([0, 1], sizes), 1
    blocks, rest = _blocks_of(evidences[:fitted]), _blocks_of(evidences[fitted:])
    first = _in_stretches(blocks, FOLDS)
    folds = int(first[-1]) + 1
    return np.concatenate([first, folds + _in_stretches(rest, round(rest.size * folds / blocks.size))]), folds


def _blocks_of(evidences: Sequence[Evidence]) -> IntArray:
    """Number of the block of time of each row; the lines of one begin at 0 Hz."""
    found = np.zeros(0, dtype=np.int64)
    for item in evidences:
        own = np.maximum(np.cumsum(item.frequency == 0.0).astype(np.int64) - 1, 0)
        found = np.concatenate([found, own + (found[-1] + 1 if found.size else 0)])
    return found


def _in_stretches(block: IntArray, stretches: int) -> IntArray:
    """Stretch of each row, as many as asked for, at least one and at most one for each block."""
    if not block.size:
        return block
    count = int(block[-1]) + 1
    return block * min(max(stretches, 1), count) // count
