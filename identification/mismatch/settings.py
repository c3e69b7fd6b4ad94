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

# Of what may be claimed, in nats of log-likelihood (4 nats are odds of about 1 : 50), chances, shares and rows.
PRIOR_COST = 4.0
"""Nats that one class on one joint, and one band whose noise is not the measured one, cost beforehand."""
SPEAK = 8.0
"""Nats by which the evidence must fall without a class for it to be claimed, or rise with a torque turned: 3000 : 1."""
ALTERNATIVE = 3.0
"""Nats within which one explanation is as good as another, and the simpler one, or both, are said: 20 : 1."""
NOISE_ROWS = 20.0
"""How many rows the measured noise of a band is worth against its own residual."""
VARIANCE_CAP = 100.0
"""Most that a class may be beforehand, as a multiple of the joint's mean square misfit."""
HIDDEN = 0.01
"""Square over the noise's of what a class's weight shows on the rows at its largest below which it is not asked: no
hypothesis gains half of it in nats, odds of 200 : 201."""
FADE = 0.25
"""Distance beyond the fitted range, as a share of it, over which a class fades to zero."""
FOLDS = 5
"""Parts of a recording without periods that are predicted from the others."""
CAPTURE = 0.1
"""Share of a whole that may be something else: of a name, of a difference between recordings, of what shows most."""
LEAST_SHOWN = 2.0 * ALTERNATIVE / CAPTURE
"""λ that a name needs: one that shows less may as well be another torque which shares all of λ but `CAPTURE`."""
DIFFERENT = 1e-3
"""Chance below which figures of two recordings, or of fitted and held-out rows, differ."""
UNLIKELY = 1e-4
"""Chance, over all that was looked at, below which what is seen is no noise."""
ROUNDING = 1e-9
"""Share of a whole below which what is left of it is rounding."""
ROWS_TELL = 1e-4
"""Share of a joint's torque to which rows without periods are known: low-passed motion has no closer torque (1e-5 to
3e-4 of a simulator's exact one), and no torque sensor is better."""
MOST = 0.5
"""Share of a whole beyond which it is most of it: of a name's torque and nats, a misfit, a difference, a block."""
CLEARLY = 4.0
"""Deviations beyond which one figure is not another: a chance of 6e-5, of 3e-5 to one side."""


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
    consistency_probability: float = UNLIKELY
    margin_of_indistinguishable: float = 4.6
    largest_explanation: int = 3
    largest_findings: int = 5
    torque_bandwidth_hz: float = 60.0
    motion_bandwidth_hz: float = 20.0
    low_pass_hz: float | None = None
    split: str | None = None
