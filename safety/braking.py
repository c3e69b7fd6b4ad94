"""How far a joint still travels when it is stopped as firmly as the limits allow: closed form, no planner.

This is the definition of a feasible state: its firmest stop stays inside the position limits and does not have to
pass the velocity limit. The guard asks it for each command, the preflight for each row of a table. ramps.py plans the
same stop with Ruckig; the tests hold the two against each other.

The firmest stop of one joint from (q, v, a) is time-optimal to v = 0, a = 0 under |a| <= A and |jerk| <= J: first the
acceleration is driven to the deceleration's peak, held there if A is reached, and driven back to 0.
"""

from __future__ import annotations

import math


def stopping_travel(velocity: float, acceleration: float, acceleration_limit: float, jerk_limit: float) -> float:
    """Largest displacement, rad, in positive direction during the firmest stop of one joint; never below 0.

    velocity: rad/s; acceleration: rad/s², |acceleration| <= acceleration_limit; limits: rad/s², rad/s³. The travel in
    negative direction is that of (-velocity, -acceleration).
    """
    removed = acceleration * acceleration / (2.0 * jerk_limit)  # velocity gained or lost while a is driven to 0
    time = abs(acceleration) / jerk_limit
    if acceleration >= 0.0:
        start = velocity + removed  # velocity once the acceleration has become 0
        if start <= 0.0:
            # The joint comes back from the negative side without ever passing its start, or passes it by not braking
            # at once: it moves in positive direction only while velocity > 0, which cannot be with start <= 0.
            return 0.0
        offset = velocity * time + acceleration * time * time / 3.0
        return max(0.0, offset + _travel_from_constant_velocity(start, acceleration_limit, jerk_limit))
    if velocity <= 0.0:
        # Moving backwards and accelerating backwards: it only turns round if the stop overshoots, which it does not.
        return 0.0
    if velocity >= removed:
        # On the way down already: this state lies on the stop that began `time` ago at constant velocity.
        start = velocity + removed
        if acceleration * acceleration <= jerk_limit * start:
            done = start * time - jerk_limit * time**3 / 6.0
            return max(0.0, _travel_from_constant_velocity(start, acceleration_limit, jerk_limit) - done)
    # Braking harder than needed: the velocity passes 0 while the deceleration is taken back.
    zero = (-acceleration - math.sqrt(max(0.0, acceleration * acceleration - 2.0 * jerk_limit * velocity))) / jerk_limit
    return max(0.0, velocity * zero + acceleration * zero * zero / 2.0 + jerk_limit * zero**3 / 6.0)


def stopping_state(
    velocity: float, acceleration: float, acceleration_limit: float, jerk_limit: float, period_s: float
) -> tuple[float, float]:
    """Velocity, rad/s, and acceleration, rad/s², at tick k from which a stop of a stream of commands is planned.

    velocity: (q_k - q_{k-1}) / T; acceleration: (q_k - 2 q_{k-1} + q_{k-2}) / T², which is the acceleration at tick
    k-1. What it became until tick k is open: the next command settles it. So the stop is taken to have begun at tick
    k-1: the acceleration is moved by up to jerk_limit T towards the end of the motion. The commands that follow then
    have third differences within the jerk limit, and along a stop at full jerk this state is the state of that very
    stop. With the acceleration at k-1 instead, the stop would be one period late, 2 mrad at full velocity.
    """
    now = velocity + 0.5 * period_s * acceleration
    remaining = now + acceleration * abs(acceleration) / (2.0 * jerk_limit)
    most = jerk_limit * period_s
    start = acceleration - min(max(remaining / period_s, -most), most)
    start = min(max(start, -acceleration_limit), acceleration_limit)
    return now + (start - acceleration) * period_s / 3.0, start


def _travel_from_constant_velocity(velocity: float, acceleration_limit: float, jerk_limit: float) -> float:
    if velocity * jerk_limit <= acceleration_limit * acceleration_limit:
        return velocity * math.sqrt(velocity / jerk_limit)
    return velocity * (velocity / acceleration_limit + acceleration_limit / jerk_limit) / 2.0
