"""Stops of random motions at random ticks for random reasons, each through the whole state machine. No test in here.

A motion is driven once; at each of the ticks drawn a copy of it is stopped and driven to rest. Judged are the commands
alone, by differences taken here: nothing of the guard, the planner or the spline has a say in it.
"""

from __future__ import annotations

import copy
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode
from fri_client.motion.program import MotionProgram, StopReason
from fri_client.motion.table import MotionError
from safety.guard import GuardVerdict
from safety.limits import IIWA7_R800, IIWA14_R820, JointLimits
from safety.ramps import RampError
from tests.safety.motions import random_fourier_table

REASONS = (
    "OPERATOR_STOP",
    "SIGNAL_STOP",
    "SUPERVISOR_LOST",
    "RECORDER_LOST",
    "DISK_FULL",
    "FAULT",
    "external torque",
    "arm does not follow",
    "table refused",
    "session lost",
)
TOLERANCE = np.array([1e-4, 2e-3, 2e-2])
"""Relative, of velocity, acceleration and jerk: round-off of a planner's 1e-10 rad in a third difference at 1 ms."""

_HISTORY = 4


@dataclass(slots=True)
class Figures:
    """What a campaign found. worst: largest share of the limits of velocity, acceleration and jerk, by kind of stop."""

    cases: Counter[tuple[str, str]] = field(default_factory=Counter)
    worst: dict[str, np.ndarray] = field(default_factory=lambda: {"path": np.zeros(3), "joint_space": np.zeros(3)})
    durations: dict[str, list[float]] = field(default_factory=lambda: {"path": [], "joint_space": []})
    violations: list[str] = field(default_factory=list)

    @property
    def total(self) -> int:
        """Cases judged."""
        return sum(self.cases.values())


def run_campaign(cases: int, seed: int, stops_per_motion: int = 25) -> Figures:
    """At least `cases` stops, seeded."""
    figures, motion = Figures(), 0
    while figures.total < cases:
        _one_motion(
            np.random.default_rng([seed, motion]), figures, min(stops_per_motion, cases - figures.total), motion
        )
        motion += 1
    return figures


def _one_motion(generator: np.random.Generator, figures: Figures, stops: int, motion: int) -> None:
    limits = [IIWA14_R820, IIWA7_R800][int(generator.integers(2))]
    period = float(generator.choice([0.001, 0.001, 0.002, 0.005]))
    table = random_fourier_table(generator, limits, harmonics=int(generator.choice([3, 5, 10])), period_s=6.0)
    # Some motions meet their limits, where a stop on the path finds no room; most have the room a real one has.
    middle = table.mean(axis=0)
    table = middle + float(generator.choice([1.0, 0.9, 0.7, 0.4])) * (table - middle)
    try:
        program = MotionProgram(table, limits, command_period_s=period, periods=2, lead_in_s=0.5)
        start = middle + generator.uniform(-0.1, 0.1, 7)
        start = tuple(np.clip(start, limits.position_lower + 0.05, limits.position_upper - 0.05).tolist())
        program.begin(start)
    except (RampError, MotionError):
        return  # such a motion is refused before anything moves
    drawn = np.sort(generator.choice(round(9.0 / period), stops, replace=False)).tolist()
    past, tick = [start] * _HISTORY, 0
    own_jerk = np.abs(np.diff(table[np.arange(-3, len(table))], 3, axis=0)).max(axis=0) / 1e-9
    while drawn and program.phase < MotionPhase.STOP_RAMP:
        while drawn and drawn[0] == tick:
            drawn.pop(0)
            reason = REASONS[int(generator.integers(len(REASONS)))]
            kind, commands = _stopped(program, reason, past[-1])
            figures.cases[kind, reason] += 1
            figures.durations[kind].append((len(commands) - _HISTORY) * period)
            wrong = _judge(np.array(past + commands), period, limits, own_jerk, figures.worst[kind])
            if wrong:
                figures.violations.append(f"motion {motion}, tick {tick}, {reason}, {kind}: {wrong}")
        command = tuple(program.tick(past[-1]))
        past = [*past[1:], command]
        tick += 1


def _stopped(running: MotionProgram, reason: str, last: tuple[float, ...]) -> tuple[str, list[tuple[float, ...]]]:
    """How a copy of the motion stops, and its commands until some after the end."""
    program = copy.copy(running)
    program.guard = copy.copy(running.guard)  # accepting replaces its lists, so the running guard is not touched
    program.stopping = copy.copy(running.stopping)
    program.stopping._guard = program.guard
    program.standstill = copy.copy(running.standstill)
    program._external_torque_limit = (60.0,) * 7
    commands: list[tuple[float, ...]] = []
    measured, torque = last, (0.0,) * 7
    if reason == "external torque":
        torque = (0.0, 0.0, 61.0, 0.0, 0.0, 0.0, 0.0)
    elif reason == "arm does not follow":
        measured = tuple(value + 0.2 for value in last)
    elif reason == "table refused":
        program.stop(StopReason.from_verdict(GuardVerdict("velocity", 3, 9.0, 1.7, "rad/s")))
    elif reason == "session lost":
        program.latch()
    else:
        program.stop(StopReason(EventCode[reason], reason, path_is_good=reason != "FAULT"))
    while True:
        if program.phase == MotionPhase.LATCHED:
            commands.append(tuple(program.tick(last)))
        else:
            commands.append(tuple(program.tick(measured, torque)))
        if len(commands) > _HISTORY and len(set(commands[-_HISTORY:])) == 1:
            return program.stopping.kind or "none", commands


def _judge(path: np.ndarray, period: float, limits: JointLimits, own_jerk: np.ndarray, worst: np.ndarray) -> str:
    """What is outside a limit, empty where nothing is. The jerk may be what the motion itself has."""
    if np.any(path > limits.position_upper + 2e-7) or np.any(path < limits.position_lower - 2e-7):
        return "position"
    bounds = (limits.velocity, limits.acceleration, np.maximum(limits.jerk, own_jerk))
    for order, bound in enumerate(bounds):
        share = float((np.abs(np.diff(path, order + 1, axis=0)).max(axis=0) / period ** (order + 1) / bound).max())
        worst[order] = max(worst[order], share)
        if share > 1.0 + TOLERANCE[order]:
            return f"{('velocity', 'acceleration', 'jerk')[order]} at {100 * share:.2f} %"
    return ""
