"""Every threshold of the diagnosis, in one place, with what it was tuned on.

The defaults are what `prove` scores. Nothing is computed here. Tuned on `prove` cases:
complete_score and provisional_score on 74 clean recordings and decoys of seeds 200 and 230 (but for a hum and a
jittering clock the best of all candidates has a median of 4.4 and a largest of 9.0, fitted and held-out together; an
exponential tail puts one in 200 beyond 14); background_score on seeds 5 to 19, 101 and 102 (false names of 78 to 150,
true ones from 113), when it was asked with measured noise too. Others by design.
"""

from __future__ import annotations

from dataclasses import dataclass

OPEN_BEYOND_NOISE = 5.0
"""Deviations of the noise along a direction of the base parameters beyond which rows leave it open: what other rows
predict there says nothing of an effect, and it is settled by these rows."""


@dataclass(frozen=True, slots=True)
class DiagnosisSettings:
    """Thresholds and bandwidths of one diagnosis.

    Scores are log-likelihood units (half a χ²), penalties included. complete_score: what an effect must gain where no
    other recording is held out, and a drift in any case;
    provisional_score: on the fitted ones alone, for the held-out ones to be asked; push_score: of a push that comes
    with every period, whose window is free in time; background_score: where the noise is not measured.
    consistency_probability: smallest probability, over joints and bands, at which a residual still counts as noise.
    margin_of_indistinguishable: other names that stay this close on the fitted recordings are named as alternatives;
    4.6 are odds of 100 to 1.
    largest_explanation: most effects that explain everything together by the noise alone; five smooth ones fitted a
    weak background down to the noise (seed 9021), so beyond three names are searched beside classes.
    largest_findings: most effects that one diagnosis names. torque_bandwidth_hz, motion_bandwidth_hz: lines compared,
    and harmonics of the position that count as motion. low_pass_hz: of recordings without periods, None = that of
    the fit (`fitting.band`). split: text of a `Split`, rows of such recordings to hold out where no
    other recording is; None = every third of fifteen blocks of time.
    """

    complete_score: float = 14.0
    provisional_score: float = 10.0
    push_score: float = 20.0
    background_score: float = 100.0
    consistency_probability: float = 1e-4
    margin_of_indistinguishable: float = 4.6
    largest_explanation: int = 3
    largest_findings: int = 5
    torque_bandwidth_hz: float = 60.0
    motion_bandwidth_hz: float = 20.0
    low_pass_hz: float | None = None
    split: str | None = None
