"""Random periodic motions for the tests of guard, ramps and preflight. No test in here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from safety.guard import CommandGuard, GuardVerdict
from safety.limits import FloatArray, JointLimits


def random_fourier_table(
    generator: np.random.Generator, limits: JointLimits, *, harmonics: int = 5, period_s: float = 10.0
) -> np.ndarray:
    """One period at 1 kHz, (N, n) rad, of random Fourier series; each joint meets one of its limits.

    The offsets push joints towards one of their position limits, up to 30 mrad before it.
    """
    t = np.arange(round(period_s * 1000)) * 1e-3
    omega = 2 * np.pi / period_s * np.arange(1, harmonics + 1)
    n = limits.joint_count
    a, b = generator.normal(size=(2, n, harmonics))
    sine, cosine = np.sin(np.outer(t, omega)), np.cos(np.outer(t, omega))
    q = sine @ a.T + cosine @ b.T
    dq = (cosine * omega) @ a.T - (sine * omega) @ b.T
    ddq = -(sine * omega**2) @ a.T - (cosine * omega**2) @ b.T
    q -= (q.max(axis=0) + q.min(axis=0)) / 2
    middle = (limits.position_upper + limits.position_lower) / 2
    # At a turning point with full deceleration a stop still needs some 30 mrad to take the deceleration back.
    half = (limits.position_upper - limits.position_lower) / 2 - 0.03
    share = generator.choice([1.0, 0.5], n)  # of the range of positions
    scale = 0.999 * np.minimum.reduce(
        [
            share * half / np.abs(q).max(axis=0),
            limits.velocity / np.abs(dq).max(axis=0),
            limits.acceleration / np.abs(ddq).max(axis=0),
        ]
    )
    q = q * scale
    offset = generator.choice([-1.0, 0.0, 1.0], n) * (0.999 * half - np.abs(q).max(axis=0))
    table: np.ndarray = q + middle + offset
    return table


def judged(
    guard: CommandGuard, command: Sequence[float] | FloatArray, measured: Sequence[float] | FloatArray, *,
    stopping: bool = False,
) -> GuardVerdict | None:  # fmt: skip
    """`examine` and, where nothing speaks against the command, `accept`: as for one that is sure to go out."""
    outcome = guard.examine(command, measured, stopping=stopping)
    if isinstance(outcome, GuardVerdict):
        return outcome
    guard.accept(outcome)
    return None
