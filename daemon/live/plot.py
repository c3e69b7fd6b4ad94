"""One point of the live plots: a frame, its motion and its difference to the model, as Foxglove and PlotJuggler get it.

Pure. The names of the fields are those of the series; the layouts in `layouts/` use them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daemon.live.frame import LiveState, Seven
from daemon.live.residual import Modelled
from daemon.live.screen import remaining_s


class LivePoint(LiveState, frozen=True, kw_only=True, omit_defaults=True):
    """Joints 1 to 7 in each list: rad, rad/s, Nm. torque_model, torque_minus_model: sign of eq. (1). times_noise: RMS
    of torque minus model over that of the noise. remaining_s: of the excitation. What is not known is left out.
    """

    remaining_s: float | None = None
    velocity: Seven | None = None
    torque_model: Seven | None = None
    torque_minus_model: Seven | None = None
    times_noise: Seven | None = None


def point_of(known: Modelled, ratio: NDArray[np.float64] | None) -> LivePoint:
    """The point of one frame; ratio: `LiveResidual.ratio`, (7,)."""
    frame = known.frame
    finite = None if ratio is None or not np.all(np.isfinite(ratio)) else ratio
    return LivePoint(
        **{name: getattr(frame, name) for name in LiveState.__struct_fields__},
        remaining_s=remaining_s(frame),
        velocity=_seven(known.velocity),
        torque_model=_seven(known.modelled),
        torque_minus_model=_seven(known.difference),
        times_noise=_seven(finite),
    )


def _seven(values: NDArray[np.float64] | None) -> Seven | None:
    if values is None:
        return None
    a, b, c, d, e, f, g = values.tolist()
    return a, b, c, d, e, f, g
