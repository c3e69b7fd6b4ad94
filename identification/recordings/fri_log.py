"""Rows of a live run's log: the channel /fri/state, with the run's labels and the sign turned to inverse dynamics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.errors import RecordingError
from identification.recordings.bag import FRI_STATE_TOPIC, Bag
from identification.recordings.npz_reader import resolve_robot
from identification.recordings.recording import CLOCK_START, Finding
from identification.recordings.table import RawTable
from identification.robots.installation import Installation

EXCITATION_PHASE = 3
FARTHEST_STEP = 1000
"""A sequence counter that leaps farther is not believed where the robot's clock contradicts it."""
LONGEST_LOSS_S = 600.0
"""The same without a clock of the robot: time that a recording which goes on may have lost."""
JOINTS = 7
_VECTORS = (
    "measured_joint_position",
    "measured_torque",
    "external_torque",
    "commanded_joint_position",
    "ipo_joint_position",
)
_FLAGS = (
    "measured_joint_position_valid",
    "measured_torque_valid",
    "duplicate",
    "out_of_order",
    "robot_time_valid",
    "send_period_ms",
)
_NUMBERS = ("sequence_counter", "robot_time_sec", "robot_time_nanosec", "motion_phase", "period", "sample_in_period")


def read_fri_log(path: Path, bag: Bag) -> RawTable:
    """Rows of /fri/state: the torque gets the inverse-dynamics sign, the labels of the run are kept.

    Raises RecordingError where no message can be used.
    """
    findings: list[Finding] = []
    states, left_out = _usable(_states(path, bag), findings)
    table = {name: states[name].astype(np.float64, copy=False) for name in _VECTORS}
    label = {name: states[name].astype(np.int64) for name in _NUMBERS}
    stated_ms = states["send_period_ms"].astype(np.int64)
    send_period_ms = np.where(stated_ms > 0, stated_ms, 1)
    if not label["sequence_counter"].size:
        raise RecordingError.named(path, f"{FRI_STATE_TOPIC} holds no usable sample")
    clock = label["robot_time_sec"] * 10**9 + label["robot_time_nanosec"] if states["robot_time_valid"].all() else None
    steps = _counted(label["sequence_counter"], clock, send_period_ms[1:], findings)
    _note_lost(label["sequence_counter"], steps, left_out, findings)
    metadata = bag.metadata
    # KUKA measures the torque against the sign of the inverse dynamics; external torque is not turned.
    sign = 1.0 if metadata.get("torque_sign_convention", "vendor") == "inverse_dynamics" else -1.0
    command = table["commanded_joint_position"]
    optional = {
        "external_torque": table["external_torque"],
        "command_position": table["ipo_joint_position"] if np.isnan(command).all() else command,
    }
    result = RawTable(
        path=path,
        kind="log",
        time=_robot_time(clock, steps, send_period_ms[1:], table["measured_joint_position"], findings),
        position=table["measured_joint_position"],
        torque=sign * table["measured_torque"],
        optional={name: values for name, values in optional.items() if not np.isnan(values).all()},
        robot=resolve_robot(path, metadata.get("robot", "")),
        installation=installation_in(path, metadata),
        metadata=metadata if clock is None else {**metadata, CLOCK_START: repr(float(clock[0]) * 1e-9)},
        findings=findings,
    )
    period, sample = label["period"], label["sample_in_period"]
    labelled = (label["motion_phase"] == EXCITATION_PHASE) & (period >= 0) & (sample >= 0)
    if labelled.any():
        # The robot may have begun the session anew, with another period, before the motion: what the rows say counts.
        send_period_s = 1e-3 * float(np.median(send_period_ms[labelled]))
        per_period = number_in(metadata, "samples_per_period")
        if (period_s := number_in(metadata, "period_s")) and stated_ms[labelled].any():
            per_period = round(period_s / send_period_s)
        result.samples_per_period = int(per_period) if per_period else int(sample[labelled].max()) + 1
        result.period_index = np.where(labelled, period, -1)
        result.sample_in_period = np.where(labelled, sample, -1)
        result.period_s = period_s or result.samples_per_period * send_period_s
    return result


def _usable(states: dict[str, Any], findings: list[Finding]) -> tuple[dict[str, Any], IntArray]:
    """The rows that can be used, and the sequence counters of the others."""
    usable = (
        states["measured_joint_position_valid"]
        & states["measured_torque_valid"]
        & ~(states["duplicate"] | states["out_of_order"])
    )
    bad = np.flatnonzero(~usable) + 1
    if bad.size:
        sentence = (
            f"{bad.size} messages between {bad[0]} and {bad[-1]} carry no position or torque, or came twice or too "
            "late; they were left out"
        )
        findings.append(Finding.of_rows("unusable_message", bad, sentence))
    left_out = states["sequence_counter"][~usable].astype(np.int64)
    return {name: values[usable] for name, values in states.items()} if bad.size else states, left_out


def _states(path: Path, bag: Bag) -> dict[str, Any]:
    """The fields of /fri/state, one row each message. Raises RecordingError where they are not what they say."""
    topic = bag.topics[FRI_STATE_TOPIC]
    assert topic.columns is not None
    layout = topic.columns.layout
    missing = [name for name in (*_VECTORS, *_NUMBERS, *_FLAGS) if name not in (layout.names or ())]
    try:
        if missing or any(layout[name].shape != (JOINTS,) for name in _VECTORS):
            raise ValueError(f"it has no {', '.join(missing)}" if missing else f"its arrays are not of {JOINTS} joints")
        return topic.columns.columns((*_VECTORS, *_NUMBERS, *_FLAGS))
    except ValueError as error:
        raise RecordingError.named(
            path,
            f"the messages on {FRI_STATE_TOPIC} do not fit their schema {topic.type} ({error})",
            field=FRI_STATE_TOPIC,
        ) from error


def number_in(metadata: dict[str, str], name: str) -> float | None:
    """A number of a log's metadata; None where there is none."""
    try:
        return float(metadata[name]) or None
    except (KeyError, ValueError):
        return None


def installation_in(path: Path, metadata: dict[str, str]) -> Installation:
    """How the robot stood, by a log's metadata; on the floor where it says nothing."""
    try:
        return Installation.from_json(json.loads(metadata.get("installation") or "null"))
    except ValueError as error:
        raise RecordingError.named(path, f"its installation is no JSON ({error})") from error


def _counted(counters: IntArray, clock: IntArray | None, send_period_ms: IntArray, findings: list[Finding]) -> IntArray:
    """(N - 1,) how many messages of the robot lie between one row and the next, by a counter that wraps at 2³².

    One that goes back, or so far ahead that the robot's clock (ns) contradicts it, was begun anew: nobody knows what
    was lost there, and 1 is taken.
    """
    steps = np.diff(counters) % 2**32
    if clock is None:
        anew = (steps == 0) | (steps * send_period_ms * 1e-3 > LONGEST_LOSS_S)
    else:
        expected = steps * send_period_ms * 1e6
        contradicted = np.abs(np.diff(clock) - expected) > 0.1 * expected
        anew = (steps == 0) | ((steps > FARTHEST_STEP) & contradicted)
    places = np.flatnonzero(anew)
    if places.size:
        further = f" and {places.size - 1} times more" if places.size > 1 else ""
        sentence = (
            f"the robot's sequence counter was begun anew after row {places[0] + 1}{further}; what was lost there "
            "is not known"
        )
        findings.append(Finding("counter_restart", int(places[0]) + 1, int(places[-1]) + 2, places.size, sentence))
    return np.where(anew, 1, steps)


def _note_lost(counters: IntArray, steps: IntArray, left_out: IntArray, findings: list[Finding]) -> None:
    """left_out: counters of the messages that came, but cannot be used, or came too late; they are not lost."""
    lost = np.flatnonzero(steps > 1)
    came = np.unique(left_out)
    missing, places = 0, []
    for place in lost.tolist():
        gap = (counters[place] + np.arange(1, steps[place])) % 2**32
        absent = int((~np.isin(gap, came)).sum())
        missing += absent
        places += [place] if absent else []
    if missing:
        how_many = "1 message of the robot is" if missing == 1 else f"{missing} messages of the robot are"
        where = "1 place" if len(places) == 1 else f"{len(places)} places"
        sentence = f"{how_many} missing at {where}, seen by its sequence counter"
        findings.append(Finding("lost_samples", places[0] + 1, places[-1] + 2, missing, sentence))


def _set_ahead(elapsed: IntArray, counted: IntArray, position: FloatArray) -> IntArray:
    """Rows after which the robot's clock was set ahead, by times (N - 1,) ns of clock and counter and position (N, n).

    By more than a recording can have lost; or the counter has gone on for less, and the arm with it: a robot that was
    held up while its counter stood has moved on as the clock says.
    """
    ahead = elapsed - counted
    far = ahead > LONGEST_LOSS_S * 1e9
    # A stamp that alone is late or early is given back by the next one.
    steady = 2 * np.maximum(np.abs(ahead[:-2]), np.abs(ahead[2:])) < ahead[1:-1]
    places = np.flatnonzero((2 * ahead[1:-1] > counted[1:-1]) & steady & ~far[1:-1]) + 1
    moved = np.diff(position, axis=0)
    beside = 0.5 * (moved[places - 1] / counted[places - 1, None] + moved[places + 1] / counted[places + 1, None])
    way = np.linalg.norm(moved[places], axis=1)
    by_counter, by_clock = (
        np.linalg.norm(moved[places] - beside * time[places, None], axis=1) for time in (counted, elapsed)
    )
    near = way < 2.0 * np.linalg.norm(beside, axis=1) * counted[places]
    return np.sort(np.concatenate([np.flatnonzero(far), places[near & (by_counter < by_clock)]]))


def _robot_time(
    clock: IntArray | None,
    steps: IntArray,
    send_period_ms: IntArray,
    position: FloatArray,
    findings: list[Finding],
) -> FloatArray:
    """Time since the first sample by the robot's own clock (ns), else by its sequence counter and send period.

    The counter also says how long it was where the clock was set ahead.
    """
    counted = steps * send_period_ms * 1_000_000
    if clock is not None and np.all(np.diff(clock) > 0):
        elapsed = np.diff(clock)
        leaps = _set_ahead(elapsed, counted, position)
        if leaps.size:
            sentence = (
                f"the robot's clock was set ahead by {elapsed[leaps].max() * 1e-9:.4g} s; what passed there is its "
                "sequence counter times the send period"
            )
            findings.append(Finding("clock_set", int(leaps[0]) + 1, int(leaps[-1]) + 2, leaps.size, sentence))
            elapsed[leaps] = counted[leaps]
        return np.asarray(np.concatenate([[0], np.cumsum(elapsed)]) * 1e-9, dtype=np.float64)
    sentence = (
        "the robot's time stamps are absent or do not advance; time is its sequence counter times the send period"
    )
    findings.append(Finding.of_all("no_robot_clock", len(steps) + 1, sentence))
    return np.asarray(np.concatenate([[0], np.cumsum(counted)]) * 1e-9, dtype=np.float64)
