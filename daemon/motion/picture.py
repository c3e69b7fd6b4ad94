"""A motion as a picture before it is run: where the end-effector goes, how near to what, and every joint's path.

Here: the drawing, from a prepared motion to a PNG or SVG file. Not here: any number in it, which come from the
preflight and the trajectory. No window is opened.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from daemon.errors import ConfigurationError, LogIOError
from daemon.motion.preparation import TABLE_RATE_HZ, PreparedMotion, start_row_of
from identification.arrays import FloatArray
from safety.collision import ForbiddenBox, Workspace
from safety.geometry import RobotGeometry
from safety.limits import limits_for
from safety.preflight import start_path

_PATH, _LIMIT, _ARM, _OBSTACLE, _RAMP = "#1f5fa8", "#c0392b", "#8a8f98", "#d98c21", "#2a7d4f"
_VIEWS = ((0, 1, "from above"), (0, 2, "from the right"), (1, 2, "from the front"))
_AXES = "xyz"
_SHOWN_PAIRS = 6
_SWEPT_POSES, _SWEPT_POSES_OF_RAMP = 40, 8


def draw_motion(motion: PreparedMotion, file: Path) -> None:
    """Write the picture of a motion: the arm as it sweeps in three projections, its start ramp included, seven joints
    over time, closest distances. The ramp begins in the middle of the motion, as in the preflight.

    The suffix of `file` chooses the format (.png or .svg). Raises ConfigurationError for another suffix, LogIOError
    where the file cannot be written.
    """
    if file.suffix.lower() not in (".png", ".svg"):
        raise ConfigurationError("a picture is a .png or .svg file.", file=str(file))
    figure = Figure(figsize=(13.0, 10.5), layout="constrained")
    verdict = "safe to run" if motion.preflight.safe else "NOT safe"
    figure.suptitle(
        f"{motion.name} · amplitude {motion.amplitude:g} · {motion.trajectory.period_s:g} s per period · {verdict}",
        color="black" if motion.preflight.safe else _LIMIT,
    )
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.0, 1.05)).ravel()
    _draw_projections(upper.subplots(1, 3), motion)
    cells = lower.subplots(2, 4).ravel()
    _draw_joints(cells[:7], motion)
    _draw_distances(cells[7], motion)
    try:
        figure.savefig(file, dpi=130)
    except OSError as error:
        raise LogIOError(str(file), error) from error


def _draw_projections(axes: Any, motion: PreparedMotion) -> None:
    geometry = motion.surroundings.geometry
    path = geometry.tip_path(motion.table)
    ramp = start_path(
        motion.table, 1.0 / TABLE_RATE_HZ, limits_for(motion.robot), start_row_of(motion.table, motion.lead_in_s)
    )
    swept = motion.table[:: max(1, len(motion.table) // _SWEPT_POSES)]
    before = motion.table[:0] if ramp is None else ramp.positions
    # The ramp's own poses beside those of the motion: what the arm passes before the period begins.
    swept = np.vstack([swept, before[:: max(1, len(before) // _SWEPT_POSES_OF_RAMP)]])
    sticks = _sticks(geometry, swept)
    stick, approach = sticks[0], geometry.tip_path(before) if len(before) else path[:0]
    everything = np.vstack([path, approach, *sticks])
    lowest, highest = (extreme(everything, axis=0) for extreme in (np.min, np.max))
    # One scale for all three views, so that they can be compared.
    middle, half = (lowest + highest) / 2.0, float((highest - lowest).max()) / 2.0 + 0.15
    for ax, (first, second, title) in zip(axes, _VIEWS, strict=True):
        _draw_surroundings(ax, motion.surroundings.workspace, first, second)
        for number, each in enumerate(sticks):
            ax.plot(
                each[:, first], each[:, second], color=_ARM, linewidth=1.0, alpha=0.22, solid_joinstyle="round",
                label="arm as it sweeps" if not number else None,
            )  # fmt: skip
        ax.plot(
            stick[:, first], stick[:, second], color=_ARM, linewidth=3, alpha=0.6, solid_joinstyle="round",
            label="arm at the start",
        )  # fmt: skip
        closed = np.vstack([path, path[:1]])
        ax.plot(closed[:, first], closed[:, second], color=_PATH, linewidth=1.2, label="end-effector")
        ax.plot(approach[:, first], approach[:, second], color=_RAMP, linewidth=1.2, linestyle=":", label="start ramp")
        ax.plot(path[0, first], path[0, second], "*", color=_PATH, markersize=13, label="start and end")
        ax.set_xlabel(f"{_AXES[first]} (m)")
        ax.set_ylabel(f"{_AXES[second]} (m)")
        ax.set_title(title)
        ax.set_xlim(middle[first] - half, middle[first] + half)
        ax.set_ylim(middle[second] - half, middle[second] + half)
        ax.set_aspect("equal")
        ax.grid(alpha=0.25)
    axes[1].legend(loc="best", fontsize="small")


def _sticks(geometry: RobotGeometry, poses: FloatArray) -> FloatArray:
    """The arm as a line from base to end-effector for poses (N, 7) rad: (N, points, 3) m."""
    _, joints = geometry.link_poses(poses)
    tips = geometry.tip_path(poses)
    return np.concatenate([np.zeros((len(poses), 1, 3)), joints, tips[:, None]], axis=1)


def _draw_surroundings(ax: Axes, workspace: Workspace, first: int, second: int) -> None:
    """Floor and walls that stand upright on the view as lines, boxes as their outlines."""
    for plane in workspace.planes():
        normal = np.array([plane.normal[first], plane.normal[second]])
        if np.linalg.norm(normal) < 0.999:
            continue
        foot = normal * plane.offset_m
        along = (foot[0] - normal[1], foot[1] + normal[0])
        ax.axline(tuple(foot), along, color=_OBSTACLE, linestyle="--", linewidth=1.2)
        ax.annotate(plane.name, tuple(foot), color=_OBSTACLE, fontsize="small", annotation_clip=True)
    for box in workspace.boxes:
        corners = _corners(box)[:, (first, second)]
        outline = corners[ConvexHull(corners).vertices]
        ax.add_patch(Polygon(outline, closed=True, facecolor=_OBSTACLE, alpha=0.35, edgecolor=_OBSTACLE))
        ax.annotate(box.name, tuple(outline.mean(axis=0)), fontsize="small", ha="center", annotation_clip=True)


def _corners(box: ForbiddenBox) -> FloatArray:
    """The eight corners, (8, 3) m in the base frame."""
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    local = np.array(list(product((-0.5, 0.5), repeat=3))) * np.array(box.size_m)
    turned: FloatArray = local @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + np.array(box.center_m)
    return turned


def _draw_joints(axes: Any, motion: PreparedMotion) -> None:
    limits = limits_for(motion.robot)
    time = np.arange(len(motion.table)) / TABLE_RATE_HZ
    for joint, ax in enumerate(axes):
        lower, upper = float(limits.position_lower[joint]), float(limits.position_upper[joint])
        ax.axhspan(upper, upper + 1.0, color=_LIMIT, alpha=0.12)
        ax.axhspan(lower - 1.0, lower, color=_LIMIT, alpha=0.12)
        for limit in (lower, upper):
            ax.axhline(limit, color=_LIMIT, linestyle="--", linewidth=1.0)
        ax.plot(time, motion.table[:, joint], color=_PATH, linewidth=1.3)
        ax.set_ylim(1.12 * lower, 1.12 * upper)
        ax.set_xlim(0.0, time[-1])
        ax.set_title(f"A{joint + 1}", fontsize="medium")
        ax.grid(alpha=0.25)
        if joint % 4 == 0:
            ax.set_ylabel("joint position (rad), limits dashed")
        if joint >= 3:
            ax.set_xlabel("time (s)")


def _draw_distances(ax: Axes, motion: PreparedMotion) -> None:
    """The pairs with the least room, over the motion, its stops and the start ramp."""
    nearest: dict[str, tuple[float, float, float]] = {}
    for each in motion.preflight.clearances:
        room = each.guaranteed_m - each.margin_m
        if each.pair not in nearest or room < nearest[each.pair][0]:
            nearest[each.pair] = (room, each.guaranteed_m, each.margin_m)
    shown = sorted(nearest.items(), key=lambda item: item[1][0])[:_SHOWN_PAIRS]
    for place, (pair, (room, distance, margin)) in enumerate(shown):
        ax.barh(place, 1e3 * distance, color=_PATH if room >= 0.0 else _LIMIT, alpha=0.8)
        ax.plot([1e3 * margin] * 2, [place - 0.4, place + 0.4], color=_LIMIT, linestyle="--", linewidth=1.2)
        ax.text(1e3 * max(distance, margin), place, f" {pair}", va="center", fontsize="small")
    ax.set_yticks([])
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.margins(x=0.7)
    ax.set_title("least distances", fontsize="medium")
    ax.set_xlabel("distance (mm), margin dashed")
