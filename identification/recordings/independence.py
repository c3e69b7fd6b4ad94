"""Are recordings different measurements? A recording that checks itself confirms whatever was fitted to it.

Here: names that tell recordings apart, and the refusal of samples that stand in two of them. Called by the diagnosis,
by `validate` and by whatever holds recordings out.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from identification.errors import RecordingError
from identification.recordings.recording import Recording

KEPT_DECIMALS = 6
"""Of q and tau in a sample's fingerprint: a file with rounded numbers is still the same measurement."""
FEWEST_SHARED = 10
"""Moving samples in common that are no accident, where each is of NUMBERS or more."""
NUMBERS = 8
"""That noise and the steps of sensors do not repeat together; an arm of few joints needs several rows in a row."""


def recording_names(recordings: Sequence[Recording]) -> list[str]:
    """File names, with as many of their folders as tell them apart (every run calls its log alike)."""
    parts = [Path(recording.source.path).parts for recording in recordings]
    depth = 1
    while len({item[-depth:] for item in parts}) < len(set(parts)):
        depth += 1
    return [str(Path(*item[-depth:])) for item in parts]


def is_called(recording: Recording, name: str) -> bool:
    """Whether a name of `recording_names` is a recording's."""
    parts = Path(name).parts
    return Path(recording.source.path).parts[-len(parts) :] == parts


def refuse_shared_samples(fitted: Sequence[Recording], heldout: Sequence[Recording]) -> None:
    """Raises RecordingError where a held-out recording is a fitted one, whole or in part, by digest or by samples.

    A copy, an import and a cut of a recording have its samples under other names and other time stamps, so samples are
    compared: q and tau of every row in which the robot moves.
    """
    names = recording_names([*fitted, *heldout])
    known = [_fingerprints(own) for own in fitted]
    for other, other_name in zip(heldout, names[len(fitted) :], strict=True):
        prints = _fingerprints(other)
        for own, name, own_prints in zip(fitted, names, known, strict=False):
            shared = int(np.isin(prints, own_prints).sum()) if own.n == other.n else 0
            if own.source.sha256 == other.source.sha256:
                what = f"is the fitted recording {name} itself"
            elif shared >= FEWEST_SHARED:
                what = f"shares {shared} of its {prints.size} moving samples with the fitted recording {name}"
            else:
                continue
            raise RecordingError(
                f"{other_name}: {what}; a recording cannot confirm what was fitted to it. Hold out another run",
                file=other.source.path,
                field="heldout",
            )


def _fingerprints(recording: Recording) -> npt.NDArray[np.int64]:
    """One number for each sample that differs from the one before it; equal samples have equal numbers."""
    rows = np.round(np.concatenate([recording.position, recording.torque], axis=1) * 10.0**KEPT_DECIMALS)
    whole = rows.astype(np.int64)
    moving = (np.diff(whole[:, : recording.n], axis=0) != 0).any(axis=1)
    behind = -(-NUMBERS // whole.shape[1])
    whole = np.concatenate([np.roll(whole, shift, axis=0) for shift in range(behind)], axis=1)
    moving[: behind - 1] = False
    # Odd multipliers: sums wrap around at 2⁶⁴, and no number of a row is lost.
    multipliers = np.random.default_rng(0).integers(2**62, size=whole.shape[1], dtype=np.int64) | 1
    with np.errstate(over="ignore"):
        return np.asarray((whole[1:][moving] * multipliers).sum(axis=1), dtype=np.int64)
