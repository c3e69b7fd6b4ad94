"""Data read otherwise than they are, as differences from a model; the clock by a velocity that was recorded. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.audit.comparison import LEAST_SIGMAS
from identification.audit.difference import Difference, Number, with_interval
from identification.audit.reading import with_clock
from identification.recordings.clock import SMALLEST_CLOCK_ERROR, clock_by_velocity
from identification.recordings.recording import Recording

FILTERED = 0.005
"""By which the filter of a recorded velocity makes it smaller or larger."""


def misread(
    effect: str, joints: tuple[int, ...], explained: float, text: str, numbers: tuple[Number, ...] = ()
) -> Difference:
    """A difference in how the data were read. explained: share of the misfit that goes, nan where that is not known."""
    return Difference(effect, None, None, numbers, explained, float("nan"), "recording", f"{text}.", joints=joints)


def by_its_velocity(recordings: Sequence[Recording]) -> tuple[list[Recording], Difference] | None:
    """Recordings with the clock that their velocity says, None where it is the stated one or nothing says."""
    found = [clock_by_velocity(recording) for recording in recordings]
    each = [item for item in found if item is not None]
    if not each or len(each) < len(recordings):
        return None
    ratio, std = (float(np.mean(values)) for values in zip(*each, strict=True))
    apart = float(np.std([value for value, _ in each]))
    std = float(np.sqrt(std**2 + apart**2 + (FILTERED * ratio) ** 2))
    if abs(np.log(ratio)) < max(SMALLEST_CLOCK_ERROR, LEAST_SIGMAS * std / ratio):
        return None
    number = Number("ratio", ratio, std, "")
    text = f"The clock is wrong: by the recorded velocity, true rate over stated rate is {with_interval(number)}"
    corrected = [with_clock(recording, ratio) for recording in recordings]
    return corrected, misread("wrong_time_base", (), float("nan"), text, (number,))
