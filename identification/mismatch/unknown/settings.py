"""Every constant that decides what may be claimed without a form, each as odds, a probability or a count of rows.

Nothing is computed here.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ClaimSettings:
    """What a hypothesis costs, and when it is spoken of. Log-likelihood in nats: 4 nats are odds of about 1 : 50.

    prior_cost: nats that one class on one joint, and one band whose noise is not the measured one, cost beforehand.
    speak: nats by which the evidence must fall without a class for it to be claimed. alternative: nats within which
    another class in its place is as good (3 nats: 20 : 1). noise_rows: how many rows the measured noise of a band is
    worth against its own residual. other_noise: whether a band may have another noise than the measured one at all;
    not between periods, whose scatter is what measures it. variance_cap: most that a class may be beforehand, as a
    multiple of the joint's mean square misfit. fade: distance beyond the fitted range, as a share of it, over which a
    class fades to zero. folds: parts of a recording without periods that are predicted from the others. rival: share
    of a name's torque that a class must be able to carry, and of its nats that it must lose to the name, to be its
    rival. capture: share of what is named that may be something else, of what two recordings differ by and of a
    name's energy. invariance: chance below which coefficients of fitted and of held-out rows differ.
    """

    prior_cost: float = 4.0
    speak: float = 8.0
    alternative: float = 3.0
    noise_rows: float = 20.0
    other_noise: bool = True
    variance_cap: float = 100.0
    fade: float = 0.25
    folds: int = 5
    rival: float = 0.5
    capture: float = 0.1
    invariance: float = 1e-3
