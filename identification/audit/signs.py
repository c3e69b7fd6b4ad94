"""Torques as they have to be before recordings are weighed or compared: of the sign of the inverse dynamics. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import RecordingError
from identification.mismatch.data_faults.torque_signs import signs_of
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel


def require_stated_signs(recordings: Sequence[Recording], robot: RobotModel, what: str) -> None:
    """Raises RecordingError, field tau, for a torque with the wrong sign: it makes a load that was put on one that was
    taken off, as exact as the true one.

    what: that cannot be done with such a recording, as "no load can be weighed with it".
    """
    regressor = BaseRegressor(robot, RegressorOptions(rotor_inertia=True, offset=True))
    for recording, signs in zip(recordings, signs_of(recordings, regressor), strict=True):
        joints = [int(joint) + 1 for joint in np.flatnonzero(signs < 0.0)]
        if joints:
            which, remedy = f"joint {', '.join(map(str, joints))}", "`iiwa-ident doctor --log` says what is wrong"
            if len(joints) == robot.n:
                which, remedy = "every joint", "Turn it with `iiwa-ident import --flip-torque`"
            raise RecordingError.at(
                recording.source.path,
                f"as it stands, {what}: with the torque of {which} turned it goes far better with one rigid body of "
                f"positive inertia and friction. {remedy}.",
                field="tau",
                joint=joints[0],
            )
