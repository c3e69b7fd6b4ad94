"""The whole life of a motion, seeded: start ramp, periodic table, stop at some tick.

Every command is judged by the guard, and the stream is differenced here, independently of guard and planner.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

from safety.guard import CommandGuard
from safety.limits import IIWA7_R800, IIWA14_R820, JointLimits
from safety.preflight import preflight
from safety.ramps import plan_start_ramp, plan_stop_ramp
from tests.safety.motions import judged, random_fourier_table

PERIOD = 0.001
STOPS_PER_MOTION = 170


def _derivatives(table: np.ndarray, row: int) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and acceleration of a periodic table at one row, by fourth-order central differences."""
    around = [table[(row + k) % len(table)] for k in (-2, -1, 0, 1, 2)]
    velocity = (around[0] - 8 * around[1] + 8 * around[3] - around[4]) / (12 * PERIOD)
    acceleration = (-around[0] + 16 * around[1] - 30 * around[2] + 16 * around[3] - around[4]) / (12 * PERIOD**2)
    return velocity, acceleration


@pytest.mark.parametrize("seed", range(18))
def test_at_any_tick_the_stop_stays_inside_every_limit_and_ends_at_rest(seed: int) -> None:
    generator = np.random.default_rng(1000 + seed)
    limits: JointLimits = [IIWA14_R820, IIWA7_R800][seed % 2]
    table = random_fourier_table(generator, limits, harmonics=int(generator.choice([5, 10])))
    report = preflight(table, PERIOD, limits)
    assert report.safe, [check.sentence for check in report.failures]

    handover = int(generator.integers(len(table)))
    begin = table.mean(axis=0)
    ramp = plan_start_ramp(begin, table[handover], *_derivatives(table, handover), limits)
    ticks = round(ramp.duration_s / PERIOD)
    stream = [ramp.at(k * PERIOD)[0] for k in range(1, ticks + 1)]
    stream += [table[(handover + k) % len(table)] for k in range(1, len(table) // 2)]

    guard = CommandGuard(limits, PERIOD)
    guard.anchor(begin)
    stop_ticks = set(generator.choice(len(stream), STOPS_PER_MOTION, replace=False).tolist())
    for tick, command in enumerate(stream):
        verdict = judged(guard, command, command)
        assert verdict is None, (tick, ticks, verdict.sentence() if verdict else "")
        if tick in stop_ticks:
            _assert_stops_well(guard, stream[max(0, tick - 2) : tick + 1], limits)


def _assert_stops_well(running: CommandGuard, past: list[np.ndarray], limits: JointLimits) -> None:
    guard = copy.copy(running)  # accepting replaces its lists, so the running guard is not touched
    stop = plan_stop_ramp(guard.position, guard.velocity, guard.acceleration, limits)
    commands = np.array([stop.at(k * PERIOD)[0] for k in range(1, round(stop.duration_s / PERIOD) + 5)])
    for command in commands:
        verdict = judged(guard, command, command, stopping=True)
        assert verdict is None, verdict.sentence() if verdict else ""
    whole = np.vstack([*past, commands])
    assert np.all(whole <= limits.position_upper + 2e-7)
    assert np.all(whole >= limits.position_lower - 2e-7)
    assert np.all(np.abs(np.diff(whole, axis=0)) <= limits.velocity * PERIOD * (1 + 1e-4))
    assert np.all(np.abs(np.diff(whole, 2, axis=0)) <= limits.acceleration * PERIOD**2 * 1.001)
    assert np.ptp(commands[-3:], axis=0) == pytest.approx(np.zeros(7), abs=1e-12)


def test_stops_are_accepted_without_being_announced_as_stops_where_the_motion_keeps_a_margin() -> None:
    """With a table made for 98 % of the limits, the guard's stopping criteria never refuse the stop itself."""
    generator = np.random.default_rng(5)
    tight = replace(
        IIWA14_R820,
        position_lower=IIWA14_R820.position_lower + 0.02,
        position_upper=IIWA14_R820.position_upper - 0.02,
        velocity=0.98 * IIWA14_R820.velocity,
        acceleration=0.98 * IIWA14_R820.acceleration,
    )
    for _ in range(4):
        table = random_fourier_table(generator, tight)
        guard = CommandGuard(IIWA14_R820, PERIOD)
        begin = table.mean(axis=0)
        ramp = plan_start_ramp(begin, table[0], *_derivatives(table, 0), IIWA14_R820)
        guard.anchor(begin)
        for k in range(1, round(ramp.duration_s / PERIOD)):
            assert judged(guard, ramp.at(k * PERIOD)[0], ramp.at(k * PERIOD)[0]) is None
        for k in range(3000):
            assert judged(guard, table[k], table[k]) is None
            if k % 100 == 0:
                trial = copy.copy(guard)
                stop = plan_stop_ramp(guard.position, guard.velocity, guard.acceleration, IIWA14_R820)
                for j in range(1, round(stop.duration_s / PERIOD) + 3):
                    verdict = judged(trial, stop.at(j * PERIOD)[0], stop.at(j * PERIOD)[0])
                    assert verdict is None, verdict.sentence() if verdict else ""


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("period", [0.001, 0.005])
def test_whatever_the_guard_accepts_can_be_stopped(seed: int, period: float) -> None:
    """Reckless streams: bang-bang accelerations of random length, far beyond any jerk limit, until the guard refuses.

    At the last accepted command a stop has to exist that keeps to the position limits and adds no velocity or
    acceleration.
    """
    generator = np.random.default_rng(2000 + seed)
    limits = [IIWA14_R820, IIWA7_R800][seed % 2]
    criteria = set()
    for _ in range(12):
        guard = CommandGuard(limits, period)
        last = generator.uniform(0.98, 1.0, 7) * limits.position_upper * generator.choice([-1, 1], 7)
        guard.anchor(last)
        step = np.zeros(7)
        for k in range(3000):
            if k % int(generator.integers(2, 400)) == 0:
                rate = generator.uniform(-1, 1, 7) * limits.acceleration * generator.choice([0.0, 0.02, 1.0], 7)
            step = np.clip(step + rate * period**2, -limits.velocity * period, limits.velocity * period)
            verdict = judged(guard, last + step, last)
            if verdict is not None:
                criteria.add(verdict.criterion)
                break
            last = last + step
        stop = plan_stop_ramp(guard.position, guard.velocity, guard.acceleration, limits)
        whole = np.vstack(
            [guard.position, [stop.at(k * period)[0] for k in range(1, round(stop.duration_s / period) + 4)]]
        )
        assert np.all(np.abs(whole) <= limits.position_upper + 2e-7)
        assert np.all(
            np.abs(np.diff(whole, axis=0)) <= (limits.velocity + limits.jerk * period**2) * period * (1 + 1e-5)
        )
        assert np.all(np.abs(np.diff(whole, 2, axis=0)) <= limits.acceleration * period**2 * 1.0011)
        assert np.ptp(whole[-3:], axis=0) == pytest.approx(np.zeros(7), abs=1e-12)
    assert "stopping_position" in criteria  # the campaign does reach the edge it is about
