"""The preflight's answers about distances: the motion, stops from it and the start ramp against arm and surroundings.

Here: which paths are looked at with which margin, the smallest distance per pair over all of them, and the sentence.
Not here: the distances themselves (`collision`), how stops and ramps are planned (`preflight`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from safety.collision import (
    Clearance,
    Workspace,
    self_clearances,
    self_collision_pairs,
    tool_pairs,
    workspace_clearances,
)
from safety.geometry import SELF_COLLISION_MARGIN_M, WORKSPACE_MARGIN_M, RobotGeometry
from safety.limits import FloatArray, JointLimits
from safety.preflight_report import Check
from safety.ramps import Ramp

STOP_ROWS = 50
"""Stops are looked at from every so many rows at least."""


@dataclass(frozen=True, slots=True)
class SampledPath:
    """A path (M, n) rad sampled every period_s. row: row of the table where it leaves or meets it, None: the table."""

    positions: FloatArray
    period_s: float
    row: int | None = None


@dataclass(frozen=True, slots=True)
class Distances:
    """The arm and its surroundings, and the distances in m that paths must keep from them."""

    geometry: RobotGeometry
    workspace: Workspace
    limits: JointLimits
    self_collision_margin_m: float = SELF_COLLISION_MARGIN_M
    workspace_margin_m: float = WORKSPACE_MARGIN_M

    def check(self, paths: Sequence[SampledPath], along: str) -> tuple[tuple[Check, Check], tuple[Clearance, ...]]:
        """Two checks, arm and surroundings, over all paths, and the smallest distance of every pair, closest first.

        along: "motion", "stop", "start ramp" or "stop on the start ramp".
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

    def check_stops(
        self, stops: FloatArray, period_s: float, along: str = "stop", *, every_row: bool = True
    ) -> tuple[tuple[Check, Check], tuple[Clearance, ...]]:
        """As `check`, of a stop from every row of a table: (rows, m, n) rad, sampled every period_s, the ends held.

        every_row: False where rows lie between those given: a stop from such a row is taken to be no further from its
        two neighbours here than they are from each other. along: "stop" or "stop on the start ramp".

        Distances are looked for from every 50th row, and from as many rows between as the proof needs: at no time are
        two stops further apart than sum_j reach_j (max |dq_j| + A_j T²/4), where the second term is what their
        accelerations can add between two samples. The distances of a measured stop, which stands for the rows around
        it, are reduced by that much.
        """
        reach = np.max([self.geometry.reach(capsule) for capsule in self.geometry.capsules], axis=0)
        turn = self.limits.acceleration * period_s**2 / 4.0
        looked_at: dict[int, tuple[tuple[Check, Check], tuple[Clearance, ...]]] = {}

        def look(row: int) -> float:
            if row not in looked_at:
                looked_at[row] = self.check([SampledPath(stops[row], period_s, row)], along)
            return min(each.guaranteed_m - each.margin_m for each in looked_at[row][1])

        def apart(rows: slice, row: int) -> FloatArray:
            gap: FloatArray = (np.abs(stops[rows] - stops[row]).max(axis=1) + turn) @ reach
            return gap

        neighbours = np.zeros(max(len(stops) - 1, 0))
        if not every_row:
            neighbours = (np.abs(np.diff(stops, axis=0)).max(axis=1) + turn) @ reach
        lessened: dict[int, float] = {}
        last = len(stops) - 1
        pending = [(begin, min(begin + STOP_ROWS, last)) for begin in range(0, last, STOP_ROWS)] or [(0, 0)]
        while pending:
            begin, end = pending.pop()
            room, middle = min(look(begin), look(end)), (begin + end) // 2
            before, after = apart(slice(begin, middle + 1), begin), apart(slice(middle + 1, end + 1), end)
            # The stops at both ends stand for themselves without a bound; next to each other they need none.
            between = float(neighbours[begin:end].max(initial=0.0))
            widest = max(before[1:].max(initial=0.0), after[:-1].max(initial=0.0)) + between
            if 0.0 <= room < widest and end - begin > 1:
                pending += [(begin, middle), (middle, end)]
                continue
            lessened[begin] = max(lessened.get(begin, 0.0), float(before[1:].max(initial=0.0)) + between)
            lessened[end] = max(lessened.get(end, 0.0), float(after[:-1].max(initial=0.0)) + between)
        best: dict[str, Clearance] = {}
        for row, less in lessened.items():
            found = [replace(each, guaranteed_m=each.guaranteed_m - less) for each in looked_at[row][1]]
            _keep(best, found, row)
        return self._judge(best)

    def _judge(self, best: dict[str, Clearance]) -> tuple[tuple[Check, Check], tuple[Clearance, ...]]:
        closest = sorted(best.values(), key=lambda each: each.guaranteed_m)
        links = {f"link {i} - link {j}" for i, j in (*self_collision_pairs(self.geometry), *tool_pairs(self.geometry))}
        own = [each for each in closest if each.pair in links]
        outer = [each for each in closest if each.pair not in links]
        checks = (
            _check("stop_self_collision", own, self.self_collision_margin_m),
            _check("stop_workspace", outer, self.workspace_margin_m),
        )
        return checks, (*own, *outer)


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
        "stop on the start ramp": "In a stop on the start ramp, ",
    }[closest.along]
    place = {"motion": f" in row {closest.row}", "stop": f" (from row {closest.row})"}.get(closest.along, "")
    row = None if "start ramp" in closest.along else closest.row
    sentence = start + nearest_sentence(closest, place)
    return Check(name, closest.kept, None, closest.guaranteed_m, margin_m, "m", sentence, row)
