"""One point of the live plots: a frame, its motion and its difference to the model, as Foxglove and PlotJuggler get it.

Pure. The names of the fields are those of the series; the layouts in `layouts/` use them.
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from daemon.live.frame import Seven
from daemon.live.residual import Modelled
from daemon.live.screen import remaining_s

__all__ = ["LivePoint", "point_of"]


class LivePoint(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """timestamp: Unix time, s. Joints 1 to 7 in each list: rad, rad/s, Nm. torque, torque_model, torque_minus_model:
    sign of eq. (1); external_torque: vendor's sign. times_noise: RMS of torque minus model over that of the noise.
    remaining_s: of the excitation. What is not known is left out.
    """

    timestamp: float
    phase: str
    period: int = -1
    session_state: str = ""
    quality: str = ""
    received: int = 0
    late: int = 0
    missing: int = 0
    lost: int = 0
    remaining_s: float | None = None
    position: Seven | None = None
    velocity: Seven | None = None
    command: Seven | None = None
    torque: Seven | None = None
    torque_model: Seven | None = None
    torque_minus_model: Seven | None = None
    times_noise: Seven | None = None
    external_torque: Seven | None = None


def point_of(known: Modelled, ratio: NDArray[np.float64] | None) -> LivePoint:
    """The point of one frame; ratio: `LiveResidual.ratio`, (7,)."""
    frame = known.frame
    finite = None if ratio is None or not np.all(np.isfinite(ratio)) else ratio
    return LivePoint(
        timestamp=frame.timestamp,
        phase=frame.phase,
        period=frame.period,
        session_state=frame.session_state,
        quality=frame.quality,
        received=frame.received,
        late=frame.late,
        missing=frame.missing,
        lost=frame.lost,
        remaining_s=remaining_s(frame),
        position=frame.position,
        velocity=_seven(known.velocity),
        command=frame.command,
        torque=frame.torque,
        torque_model=_seven(known.modelled),
        torque_minus_model=_seven(known.difference),
        times_noise=_seven(finite),
        external_torque=frame.external_torque,
    )


def _seven(values: NDArray[np.float64] | None) -> Seven | None:
    if values is None:
        return None
    a, b, c, d, e, f, g = values.tolist()
    return a, b, c, d, e, f, g
