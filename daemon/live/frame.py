"""One frame of the live view: the mean of 10 ms of samples with the state of the link; values only."""

from __future__ import annotations

import msgspec

FRAME_S = 0.01
"""Time that one frame averages, by the robot's own cycles."""
Seven = tuple[float, float, float, float, float, float, float]


class LiveState(msgspec.Struct, frozen=True, kw_only=True):
    """What frames and points of the plots share.

    timestamp: Unix time of the newest sample, s. position: rad, command: rad, torque: Nm, sign of eq. (1),
    external_torque: Nm, vendor's sign; means of the frame, None where nothing came. received, late, missing: counts of
    the loop; lost: between loop and file.
    """

    timestamp: float
    phase: str = ""
    period: int = -1
    session_state: str = ""
    quality: str = ""
    received: int = 0
    late: int = 0
    missing: int = 0
    lost: int = 0
    position: Seven | None = None
    command: Seven | None = None
    torque: Seven | None = None
    external_torque: Seven | None = None


class LiveFrame(LiveState, frozen=True, kw_only=True):
    """What a watcher sees; sent as one JSON object. Unknown fields are skipped: a watcher may be older or newer.

    robot_time_s: sequence counter times send period, mean of the frame, s. sample_in_period: row of the table at which
    the frame begins, −1 outside the excitation. rows_per_period, rows_per_frame: length of the table and of a frame in
    its rows. event: the newest sentence of /run/events. ended: no frame follows.
    """

    run_id: str
    robot: str
    folder: str
    robot_time_s: float = 0.0
    periods: int = 0
    sample_in_period: int = -1
    rows_per_period: int = 0
    rows_per_frame: int = 1
    table_period_s: float = 0.001
    event: str = ""
    ended: bool = False
