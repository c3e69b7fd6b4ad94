"""The verdict in one word, and whether what is left is much."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.evidence import Evidence
from identification.mismatch.findings import Baseline, Finding, Verdict
from identification.mismatch.unknown.claims import ClassClaim

MUCH = 3.0
"""Noise of another colour lies within; a model that leaves more may lack physics."""


def verdict_of(
    findings: Sequence[Finding],
    baseline: Baseline,
    left: Sequence[bool],
    unnamed: bool,
    *,
    classes: Sequence[ClassClaim] = (),
    much: bool,
) -> Verdict:
    """left: per joint whether misfit remains beside the findings; unnamed: whether it does on held-out recordings, or
    torque is there that is too weak for a name.

    classes: what the torque depends on; one of which the names leave something is a mismatch without a name.
    much: noise was not measured, and more is left than the level above the compared band would give (`much_is_left`);
    beside names that may be misfit too.
    """
    unnamed = unnamed or not all(item.named for item in classes)
    if findings:
        return "partly_explained" if any(left) or unnamed or much else "explained"
    if bool(np.any(baseline.detected)) or unnamed:
        return "unexplained"
    return "undecided" if much else "no_mismatch"


def much_is_left(rms_nm: FloatArray, evidences: Sequence[Evidence]) -> bool:
    """Whether a model leaves more (n,) Nm on some joint than three times the noise that the quietest octave above the
    compared band would give within it, where noise is not measured: it may be misfit, or noise of another colour.
    """
    floors = [item.noise if item.white_noise is None else item.white_noise for item in evidences]
    square = sum((floor**2).sum(axis=0) for floor in floors) / sum(item.samples for item in evidences)
    return not all(item.noise_is_measured for item in evidences) and bool(np.any(rms_nm > MUCH * np.sqrt(square)))
