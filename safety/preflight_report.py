"""What a preflight answers: one `Check` per question and the distances that were found. Made by preflight.py."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from safety.collision import Clearance

_OF_A_CLEARANCE = ("pair", "along", "distance_m", "guaranteed_m", "margin_m", "row")


@dataclass(frozen=True, slots=True)
class Check:
    """One question about the table and its answer.

    joint: the worst joint, counted from 1, None where the question concerns no single joint. row: the row of the
    table (from 0) where the worst value stands. value, limit: in `unit`, NaN where there is none.
    """

    name: str
    passed: bool
    joint: int | None
    value: float
    limit: float
    unit: str
    sentence: str
    row: int | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values for a JSON file; a number that is not finite becomes null."""
        numbers = {name: getattr(self, name) for name in ("value", "limit")}
        return asdict(self) | {name: value if math.isfinite(value) else None for name, value in numbers.items()}


@dataclass(frozen=True, slots=True)
class PreflightReport:
    """Answers to all checks, and the smallest distance of every pair of links, and of links and obstacles, along the
    motion, along stops and along the start ramp.
    """

    checks: tuple[Check, ...]
    clearances: tuple[Clearance, ...] = ()

    @property
    def safe(self) -> bool:
        """Whether every check passed."""
        return bool(self.checks) and all(check.passed for check in self.checks)

    @property
    def failures(self) -> tuple[Check, ...]:
        """The checks that did not pass."""
        return tuple(check for check in self.checks if not check.passed)

    @property
    def objection(self) -> str:
        """The first sentence that speaks against the motion; empty where it is safe."""
        return "" if self.safe else self.failures[0].sentence

    def to_json(self) -> dict[str, Any]:
        """{"safe", "checks": [...], "clearances": [...]}; a clearance has pair, along, distance_m, guaranteed_m,
        margin_m and row.
        """
        return {
            "safe": self.safe,
            "checks": [check.to_json() for check in self.checks],
            "clearances": [{name: getattr(each, name) for name in _OF_A_CLEARANCE} for each in self.clearances],
        }
