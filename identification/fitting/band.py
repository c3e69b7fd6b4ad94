"""Which low-pass recordings without periods go through: chosen from the data, one for the fit and the diagnosis.

A narrow band leaves out what tells parameters apart (friction at a reversal has many harmonics), a wide one lets in
what no column describes (resonances, noise). Both show in the standard deviations of the parameters on coloured
residuals: the widest band whose deviations are nearly the smallest is taken. Called by the fit; the diagnosis takes
over what the fit chose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from identification.base_parameters import BaseRegressor
from identification.errors import EstimationError
from identification.fitting.blocks import Block, RowsOverTime, build_block
from identification.fitting.estimate import estimate_parameters
from identification.recordings.recording import Recording
from identification.signals.aperiodic import AperiodicSettings, process_aperiodic
from identification.signals.periodic import to_lines

FloatArray = npt.NDArray[np.float64]

CANDIDATES_HZ = (10.0, 14.0, 20.0, 28.0, 40.0, 60.0)
NEARLY_THE_SMALLEST = 1.05
"""Of the geometric mean of the parameters' standard deviations, against the best band."""


@dataclass(frozen=True, slots=True)
class BandChoice:
    """low_pass_hz: the band taken. deviations: of each band tried, geometric mean of σ over the smallest such mean."""

    low_pass_hz: float
    deviations: dict[float, float]

    @property
    def sentence(self) -> str:
        """What the reader is told."""
        if not self.deviations:
            return f"Compared up to {self.low_pass_hz:g} Hz, the lowest band there is"
        tried = ", ".join(f"{value:.2f} at {band:g}" for band, value in self.deviations.items())
        return (
            f"Compared up to {self.low_pass_hz:g} Hz: the widest band that costs no precision (σ of the parameters "
            f"against the best band: {tried} Hz)"
        )


def choose_low_pass(recordings: Sequence[Recording], regressor: BaseRegressor) -> BandChoice:
    """The band for recordings of one robot, fitted together; regressor: with every option that may be wanted.

    Never above an eighth of the lowest sampling rate, where signs of velocity alias. The lowest candidate where no band
    determines the parameters. Raises RecordingError as `process_aperiodic` where a recording is too short for any.
    """
    highest = min(1.0 / recording.sampling_period_s for recording in recordings) / 8.0
    bands = [band for band in CANDIDATES_HZ if band <= highest] or [highest]
    if len(bands) == 1:
        return BandChoice(bands[0], {})
    blocks = []
    for recording in recordings:
        for signals in process_aperiodic(recording, AperiodicSettings(low_pass_hz=bands[-1])):
            block = build_block(signals, regressor, None, float(recording.time[0]), recording.duration_s)
            if block is not None:
                blocks.append(_in_lines(block))
    sizes = {}
    for band in bands:
        try:
            result = estimate_parameters([_below(block, band) for block in blocks], regressor.names, "weighted")
        except EstimationError:
            continue
        sizes[band] = float(np.exp(np.mean(np.log(result.least_squares.std))))
    if not sizes:
        return BandChoice(bands[0], {})
    smallest = min(sizes.values())
    deviations = {band: size / smallest for band, size in sizes.items()}
    return BandChoice(max(band for band, share in deviations.items() if share <= NEARLY_THE_SMALLEST), deviations)


def _in_lines(block: Block) -> Block:
    """The block with spectral lines for rows; rows in which a joint stands still are zero on both sides."""
    lines = (len(block.torque) - 1) // 2
    return replace(
        block,
        columns=to_lines(np.where(block.fitted[..., None], block.columns, 0.0), lines),
        torque=to_lines(np.where(block.fitted, block.torque, 0.0), lines),
        signals=replace(block.signals, row_time=None, row_noise=None),
        evaluation=RowsOverTime(()),
        evaluation_held_out=None,
    )


def _below(block: Block, band_hz: float) -> Block:
    """The lines up to band_hz."""
    assert block.signals.evaluation_time.size > 1
    step = float(block.signals.evaluation_time[1] - block.signals.evaluation_time[0])
    rows = 2 * min(int(band_hz * len(block.torque) * step), (len(block.torque) - 1) // 2) + 1
    every = np.ones((rows, block.torque.shape[1]), dtype=np.bool_)
    return replace(
        block, columns=block.columns[:rows], torque=block.torque[:rows], fitted=every, held_out=~every,
        scale=np.ones(every.shape),
    )  # fmt: skip
