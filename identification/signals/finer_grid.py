"""Rows that slide along the period: a logger whose rate is no whole number of rows per period, or is uneven.

Each period is then sampled at other moments, so that the mean over the periods is of the torque itself, where one grid
for all of them would hold the steps of Coulomb friction wherever a sample happens to stand. A model evaluated on that
one grid does: its steps come up to half a sample early or late, which looks like friction that turns over gradually,
and like more than noise. So such rows are read at the moments of one grid by a spline, and the model is evaluated on a
finer one and brought to the same band.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from identification.arrays import ComplexArray, FloatArray
from identification.recordings.labels import SMALLEST_SLIDE
from identification.recordings.recording import Recording
from identification.recordings.uneven import is_uneven, missing_rows

FINEST_S = 2.5e-4
"""A model's steps stand within half of that: an eighth of a millisecond."""
_DEGREE, _UNEVEN_DEGREE = 5, 3
"""Of the spline: between uneven rows a higher one swings with their noise."""
_SMALLEST_STEP, _LARGEST_STEP = 0.5, 1.8
"""Of the usual distance of rows: nearer ones are left out of a spline, and across a longer one none goes."""


@dataclass(frozen=True, slots=True, eq=False)
class FinerGrid:
    """A grid `factor` times finer than the samples of a period, and what of its lines the mean over periods holds.

    kept: (factor // 2 + 1,) complex share of the lines that come out as others when sampled, by how many times the
    sampling rate they lie from these. Of rows that all stand on the grid it is one; the more evenly they stand beside
    it, the nearer it is to zero: exp(2 π i m δ) over all rows, δ samples off.
    """

    factor: int = 1
    kept: ComplexArray = field(default_factory=lambda: np.ones(1, dtype=np.complex128))

    def refined(self, values: FloatArray) -> FloatArray:
        """A period of samples (M, …), repeated for ever, on the finer grid (factor M, …): no line is added."""
        samples = values.shape[0]
        if self.factor == 1:
            return values
        spectrum = np.fft.rfft(values, axis=0)
        if samples % 2 == 0:
            spectrum[-1] *= 0.5  # half of the highest line is that of negative frequency
        return np.asarray(np.fft.irfft(spectrum, n=self.factor * samples, axis=0) * self.factor)

    def sampled(self, values: FloatArray) -> FloatArray:
        """The mean period (M, …) that rows of these values, a period on the finer grid (factor M, …), would give."""
        if self.factor == 1:
            return values
        samples = values.shape[0] // self.factor
        spectrum = np.fft.rfft(values, axis=0)
        times = np.minimum(np.rint(np.arange(len(spectrum)) / samples).astype(np.int64), self.kept.size - 1)
        spectrum *= self.kept[times].reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(np.fft.irfft(spectrum, n=values.shape[0], axis=0)[:: self.factor])


ON_THE_ROWS = FinerGrid()


def slides(recording: Recording) -> bool:
    """Whether the rows of a recording labelled by its time stamps stand at other moments in every period."""
    assert recording.period_index is not None
    assert recording.sample_in_period is not None
    assert recording.period_s is not None
    assert recording.samples_per_period is not None
    labelled = np.flatnonzero(recording.period_index >= 0)
    time = recording.time[labelled[0] : labelled[-1] + 1]
    # Of coarse stamps (3, 3, 4 ms) and late ones the mean distance of rows is the true one, of rows with gaps the
    # median.
    apart = np.polyfit(np.arange(time.size), time, 1)[0], np.median(np.diff(time))
    periods = (time[-1] - time[0]) / recording.period_s
    slide = min(abs(recording.period_s / each - recording.samples_per_period) for each in apart)
    return bool(slide * periods > SMALLEST_SLIDE)


def finer_grid_of(recording: Recording, offset: FloatArray) -> FinerGrid:
    """The grid for the model of a recording labelled by time stamps; that of its rows where they stand on it.

    offset: of labelled rows behind the moments of their samples, in samples.
    """
    assert recording.period_s is not None
    assert recording.samples_per_period is not None
    if not slides(recording) and not is_uneven(recording.time):
        return ON_THE_ROWS
    factor = max(2, int(np.ceil(recording.period_s / recording.samples_per_period / FINEST_S)))
    return FinerGrid(factor, np.exp(2.0j * np.pi * np.outer(np.arange(factor // 2 + 1), offset)).mean(axis=1))


def at_moments(time: FloatArray, values: FloatArray, moments: FloatArray) -> FloatArray:
    """Rows (N, n) at increasing times (N,), read at moments (m,) by a spline through them; nan outside and in gaps.

    Of even stamps, a row that comes right behind another is late, and left out: a spline through both swings.
    """
    from scipy.interpolate import make_interp_spline  # slow to load, and few recordings need it

    uneven = is_uneven(time)
    degree = _UNEVEN_DEGREE if uneven else _DEGREE
    if not uneven:
        step = float(np.median(np.diff(time)))
        apart = np.diff(time, prepend=-np.inf) > _SMALLEST_STEP * step
        time, values = time[apart], values[apart]
    result = np.full((moments.size, values.shape[1]), np.nan)
    edges = np.flatnonzero(missing_rows(time)[0] if uneven else np.diff(time) > _LARGEST_STEP * step) + 1
    for first, last in zip([0, *edges], [*edges, time.size], strict=True):
        if last - first <= degree:
            continue
        run = time[first:last]
        inside = (moments >= run[0]) & (moments <= run[-1])
        result[inside] = make_interp_spline(run, values[first:last], k=degree)(moments[inside])
    return result
