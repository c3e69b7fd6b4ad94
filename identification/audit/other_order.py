"""Do the joints of a recording stand in another order than the robot's, positions and torques alike? Asked of it alone.

A table that has its joints by the alphabet does so, and no torque then goes better with another joint's motion. Two
joints change places, the likeliest two first, as long as one rigid body explains the recording clearly better. An order
from which no first exchange leads on, as all joints from the last to the first may be, is not found. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from identification.audit.comparison import LEAST_GAIN
from identification.audit.exchange import Stated
from identification.audit.misread import STAYS
from identification.audit.reading import Columns
from identification.audit.rows import REPEATED
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel


@dataclass(frozen=True, slots=True)
class OtherOrder:
    """columns: of each joint the recorded one, from 1, that is it. gain: nats against the order as it stands."""

    columns: Columns
    gain: float

    @property
    def joints(self) -> Columns:
        """Those that stand elsewhere, from 1."""
        return tuple(joint for joint, column in enumerate(self.columns, start=1) if column != joint)

    @property
    def sentence(self) -> str:
        """What an operator reads."""
        return f"{self.against}: the recording then goes far better with one rigid body."

    @property
    def against(self) -> str:
        """The same against a model, as the beginning of a sentence."""
        places = ", ".join(f"joint {joint} under joint {self.columns[joint - 1]}" for joint in self.joints)
        return (
            f"Positions and torques stand in another order than the robot's joints: {places}. "
            f"Put them in its order, --joints {','.join(map(str, self.columns))} where they have no names"
        )


def other_order(
    recordings: Sequence[Recording], robot: RobotModel, least_gain: float = LEAST_GAIN
) -> OtherOrder | None:
    """The order in which the joints stand; None where it is the robot's, or too much misfit stays in any.

    least_gain: nats that the best other explanation gains. Joints that follow others are not asked. Raises
    RecordingError for recordings at rest or too short.
    """
    stated = Stated.of(recordings, robot)
    if stated is None or np.all(stated.left_by(stated.directions) <= stated.sizes.first_noise):
        return None
    order, best, nats = np.arange(robot.n), stated, _nats(stated)
    for _ in range(robot.n - 1):
        swapped = [order.copy() for _ in range(robot.n * (robot.n - 1) // 2)]
        for each, (first, second) in zip(swapped, combinations(range(robot.n), 2), strict=True):
            each[[first, second]] = each[[second, first]]
        tried = [Stated.of_rows(stated.rows.joints_in_order(each), robot) for each in swapped]
        likelihoods = [_nats(each) for each in tried]
        place = int(np.argmax(likelihoods))
        if likelihoods[place] <= nats + LEAST_GAIN:
            break
        order, best, nats = swapped[place], tried[place], likelihoods[place]
    # Noise goes with the torque's column, not with the joint that it stands under.
    std = best.left_by(best.directions)
    recorded = np.empty_like(std)
    recorded[order] = std
    (found, after), (before, misfit) = best.under(std), stated.under(recorded)
    believed = found - before > max(least_gain, LEAST_GAIN) and after <= STAYS * misfit
    return OtherOrder(tuple(int(column) + 1 for column in order), found - before) if believed else None


def _nats(reading: Stated) -> float:
    """Log-likelihood of rows in one order, whose torques have as many rows in any."""
    directions = reading.directions
    return -float((directions.products.counts(directions.parts) * np.log(reading.left_by(directions))).sum()) / REPEATED
