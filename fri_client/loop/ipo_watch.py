"""Whether the robot's own set-point, the IPO position, stands still: a motion begins from rest or not at all."""

from __future__ import annotations

from collections.abc import Sequence

from fri_client.session.robot_counter import WRAP

STILL_RAD = 2e-7
"""A joint counts as still within this: three steps of the robot's position numbers (6e-8 rad)."""

STILL_MESSAGES = 5
"""Messages in a row within STILL_RAD: at 1 ms, anything above 4e-5 rad/s moves."""


class IpoWatch:
    """`observe` each message in a commanding state; is_still after STILL_MESSAGES more that show the same position."""

    def __init__(self) -> None:
        self._position: Sequence[float] = ()
        self._counter = 0
        self._still = 0
        self.moving_joint = 0
        self.speed_rad_s = 0.0

    def reset(self) -> None:
        """Forget what was seen: the robot does not command any more."""
        self._position = ()
        self._still = 0
        self.moving_joint = 0

    def observe(self, position: Sequence[float], counter: int, period_s: float) -> None:
        """Take the IPO position, rad, of the message with this counter; period_s: of the robot's messages.

        Of several messages that come at once only the newest is seen: time is what the robot counted.
        """
        if not self._position:
            self._position, self._counter = position, counter
            return
        joint, step = max(
            enumerate((abs(now - then) for now, then in zip(position, self._position, strict=True)), start=1),
            key=lambda pair: pair[1],
        )
        if step <= STILL_RAD:
            self._still += 1
            if self._still >= STILL_MESSAGES:
                self.moving_joint = 0
            return
        elapsed_s = (counter - self._counter & WRAP) * period_s
        self.moving_joint, self.speed_rad_s = joint, step / elapsed_s if elapsed_s else 0.0
        self._position, self._counter = position, counter
        self._still = 0

    @property
    def is_still(self) -> bool:
        """Whether the set-point has stood still for long enough."""
        return self._still >= STILL_MESSAGES

    def clause(self) -> str:
        """Why no motion may begin yet, as a clause; empty where it may."""
        if self.is_still:
            return ""
        if self.moving_joint:
            return (
                f"the robot's own set-point (IPO) of joint {self.moving_joint} moves at {self.speed_rad_s:.3g} rad/s, "
                "and a motion begins only from rest"
            )
        return "the robot's own set-point (IPO) was not seen standing still yet"
