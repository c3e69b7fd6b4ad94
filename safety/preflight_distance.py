"""The preflight's answers about distances: the motion, stops from it and the start ramp against arm and surroundings.

Here: which paths are looked at with which margin, the smallest distance per pair over all of them, and the sentence.
Not here: the distances themselves (`collision`), how stops and ramps are planned (`preflight`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from safety.collision import Clearance, Workspace, self_clearances, workspace_clearances
from safety.geometry import RobotGeometry
from safety.limits import FloatArray, JointLimits
from safety.preflight_report import Check
from safety.ramps import Ramp

SELF_COLLISION_MARGIN_M = 0.02
"""Distance that links keep from each other. The capsules already enclose the housings."""

WORKSPACE_MARGIN_M = 0.02
"""Distance that links keep from floor, walls and boxes."""


@dataclass(frozen=True, slots=True)
class SampledPath:
    """A path (M, n) rad sampled every period_s. row: row of the table where it leaves or meets it, None: the table."""

    positions: FloatArray
    period_s: float
    row: int | None = None


@dataclass(frozen=True, slots=True)
class Distances:
    """What paths are held against, and how far they keep from it, m."""

    geometry: RobotGeometry
    workspace: Workspace
    limits: JointLimits
    self_collision_margin_m: float = SELF_COLLISION_MARGIN_M
    workspace_margin_m: float = WORKSPACE_MARGIN_M

    def check(self, paths: Sequence[SampledPath], along: str) -> tuple[tuple[Check, Check], tuple[Clearance, ...]]:
        """Two checks, arm and surroundings, over all paths, and the smallest distance of every pair, closest first.

        along: "motion", "stop" or "start ramp".
        """
        own: dict[str, Clearance] = {}
        outer: dict[str, Clearance] = {}
        for path in paths:
            turn = self.limits.acceleration * path.period_s**2 / 4.0
            _keep(own, self_clearances(path.positions, self.geometry, turn_rad=turn), path.row)
            found = workspace_clearances(path.positions, self.geometry, self.workspace, turn_rad=turn)
            _keep(outer, found, path.row)
        prefix = "" if along == "motion" else along.split()[0] + "_"
        judged = [
            sorted(
                (replace(each, margin_m=margin, along=along) for each in best.values()), key=lambda c: c.guaranteed_m
            )
            for best, margin in ((own, self.self_collision_margin_m), (outer, self.workspace_margin_m))
        ]
        checks = (
            _check(prefix + "self_collision", judged[0], self.self_collision_margin_m),
            _check(prefix + "workspace", judged[1], self.workspace_margin_m),
        )
        return checks, (*judged[0], *judged[1])


def _keep(best: dict[str, Clearance], found: Sequence[Clearance], row: int | None) -> None:
    """Of each pair the smallest bound over all paths."""
    for each in found:
        if each.pair not in best or each.guaranteed_m < best[each.pair].guaranteed_m:
            best[each.pair] = each if row is None else replace(each, row=row)


def sample(ramp: Ramp, period_s: float) -> FloatArray:
    """Positions of a ramp, (M, n) rad, at most period_s apart, both ends included."""
    count = max(2, math.ceil(ramp.duration_s / period_s) + 1)
    return np.array([ramp.position_at(float(t)) for t in np.linspace(0.0, ramp.duration_s, count)])


def nearest_sentence(closest: Clearance, place: str = "") -> str:
    """Which two come how close, what holds between the rows, and what is required."""
    required = f"{1e3 * closest.margin_m:.0f} mm are required."
    names = f"{closest.first} and {closest.second}"
    if closest.distance_m < 0.0:
        return f"{names} overlap by {-1e3 * closest.distance_m:.0f} mm{place}; {required}"
    return (
        f"{names} come as close as {1e3 * closest.distance_m:.0f} mm{place}, "
        f"and nowhere between samples closer than {1e3 * closest.guaranteed_m:.0f} mm; {required}"
    )


def _check(name: str, found: Sequence[Clearance], margin_m: float) -> Check:
    if not found:
        return Check(name, True, None, math.inf, margin_m, "m", "There is nothing to keep a distance from.")
    closest = found[0]
    start = {
        "motion": "Along the motion, ",
        "stop": "In a stop, ",
        "start ramp": "Along the start ramp, ",
    }[closest.along]
    place = {"motion": f" in row {closest.row}", "stop": f" (from row {closest.row})"}.get(closest.along, "")
    row = None if closest.along == "start ramp" else closest.row
    sentence = start + nearest_sentence(closest, place)
    return Check(name, closest.kept, None, closest.guaranteed_m, margin_m, "m", sentence, row)
