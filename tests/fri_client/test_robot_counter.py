"""What is missing by the robot's counter, against a slow reference that remembers everything."""

from __future__ import annotations

from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fri_client.session.robot_counter import Order, RobotCounter


class Reference:
    """Counts with a growing set and unbounded integers: no window arithmetic, no wrap-around."""

    def __init__(self, first: int) -> None:
        self.seen = {first}
        self.first = self.newest = first

    def observe(self, number: int) -> None:
        """Whatever is 64 or more behind is too old to be told from one seen before."""
        if self.newest - number < 64:
            self.seen.add(number)
        self.newest = max(self.newest, number)

    def missing(self) -> int:
        return sum(number not in self.seen for number in range(self.first, self.newest + 1))


@settings(deadline=None, max_examples=300)
@given(
    st.integers(0, 2**32 - 1) | st.just(2**32 - 5),
    st.lists(st.integers(-70, 6) | st.integers(-3, 3) | st.just(1) | st.integers(50, 200), max_size=80),
)
def test_what_is_missing_agrees_with_a_reference_that_remembers_everything(start: int, steps: list[int]) -> None:
    first = newest = start + 2**33
    counter, reference, missing = RobotCounter(), Reference(first), 0
    counter.judge(first % 2**32)
    for step in steps:
        number = newest + step
        newest = max(newest, number)
        reference.observe(number)
        order = counter.judge(number % 2**32)
        assume(order != Order.RESTARTED)
        if order == Order.NEXT:
            missing += counter.gap
        elif order == Order.BELATED:
            missing -= 1
    assert missing == reference.missing()
