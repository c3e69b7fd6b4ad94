"""Periods that are alike to rounding: a simulator's, or copies of one. They tell no noise, and stand for one period."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.errors import RecordingError
from identification.recordings.recording import Finding, Recording
from identification.recordings.rounded import moving_rows
from identification.remembered import once_per_object
from identification.signals.periods import average_periods, period_table

__all__ = ["notes_on_alike", "one_of_alike"]

ALIKE = "alike_periods"
"""The kind of finding made here."""


@once_per_object
def alike_joints(recording: Recording) -> tuple[int, ...]:
    """Joints (from 1) whose torque differs from period to period by less than rounding alone makes of noise; empty
    where the recording does not repeat. A torque that never changes was not measured, and says nothing.

    Values that noise moves over a step or more have a variance of that of the noise and step² / 12 (Widrow 1961); a
    smaller one is of rounding that repeats with the motion. step: `moving_rows`.
    """
    if not recording.repeats:
        return ()
    try:
        deviation = average_periods(period_table(recording)).torque_noise_nm
    except RecordingError:  # it does not repeat with the stated period
        return ()
    step = moving_rows(recording).step[recording.n :]
    alike = (deviation < step / np.sqrt(12.0)) & (np.ptp(recording.torque, axis=0) > 0.0)
    return tuple(int(joint) + 1 for joint in np.flatnonzero(alike))


def one_of_alike(recording: Recording) -> Recording:
    """Its first period where no noise can be told from its periods, which its report then says; else the same object.

    All of them would count one rounding, or one noise, several times.
    """
    return _first_period(recording) if alike_joints(recording) else recording


@once_per_object
def _first_period(recording: Recording) -> Recording:
    joints = alike_joints(recording)
    sentence = (
        f"its periods are alike to rounding in the torque of joint{'s' * (len(joints) > 1)} "
        f"{', '.join(map(str, joints))}, as a simulator's or copies of one are: they tell no noise, and one of them is "
        "used, as of a recording without periods"
    )
    assert recording.period_index is not None, "it repeats"
    first = recording.rows(recording.period_index == period_table(recording).periods[0])
    return replace(first, report=first.report.first([Finding.of_all(ALIKE, recording.samples, sentence)]))


def notes_on_alike(recording: Recording) -> list[str]:
    """What the report of `one_of_alike` says of it, for sentences that name the recording themselves."""
    return [finding.sentence for finding in recording.report.of_kind(ALIKE)]
