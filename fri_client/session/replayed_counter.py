"""What was lost before the loop, from the messages that it recorded: its own rule, asked once more.

Not here: the rule itself (`robot_counter`).
"""

from __future__ import annotations

from fri_client.session.robot_counter import RESTART_RUN, WRAP, Order, RobotCounter


class ReplayedCounter(RobotCounter):
    """`take` the counter of each recorded message in its order; missing: gaps, less what arrived late after all."""

    def __init__(self) -> None:
        super().__init__()
        self._doubted = (0, 0)  # the last counter that was not believed, and how many in a row came before it
        self.missing = 0

    def take(self, counter: int, *, believed: bool = True) -> None:
        """One message. believed: False where the session refused its counter, as one ahead of the robot's time."""
        before, run = self._doubted
        run = run + 1 if counter == (before + 1) & WRAP else 1
        # The one that proves a restart was not refused any more, nor had it come in time.
        in_time = believed and run < RESTART_RUN
        self._doubted = (counter, run) if not in_time else (0, 0)
        order = self.judge(counter, in_time=in_time)
        if order == Order.NEXT:
            self.missing += self.gap
        elif order == Order.BELATED and self.missing:
            self.missing -= 1
