"""Torque of effects that a diagnosis found, on other motions: what makes them part of the model.

Findings come as they stand in `model.json`. Here: their torque on a motion, and recordings with it taken off. What a
model file predicts of a recording is this and the torque of its base parameters (`validation.torque_left`): `validate`,
`leaderboard` and `compare` ask both. Not here: how they were found.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor, plain_name
from identification.errors import ModelFileError, RecordingError
from identification.fitting.rms import RmsTable
from identification.fitting.settings import Split
from identification.mismatch.baseline import baseline_values, own_values
from identification.mismatch.effects import effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.evidence import Evidence, with_parameters
from identification.mismatch.motion import Motion
from identification.mismatch.reduction import build_evidence
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown.model_terms import terms_torque
from identification.model_file import Model
from identification.recordings.recording import Recording
from identification.robots import RobotModel
from identification.signals.aperiodic import cutoff_as_far_as
from identification.validation import validate_model

EffectJson = Mapping[str, Any]


class _Timed(Protocol):
    @property
    def time_s(self) -> float:
        """Time, s."""


def repeatable(effects: Sequence[EffectJson]) -> tuple[EffectJson, ...]:
    """Those effects that act in every recording; drift, contact and their like belong to the one they were found in."""
    return tuple(effect for effect in effects if _library(effect).stage == "repeatable")


def effects_torque(effects: Sequence[EffectJson], motion: Motion) -> FloatArray:
    """(K, S, n) Nm, summed torque of effects in each of the motion's K periods; zero where the motion stops one acting.

    Raises ModelFileError for an effect that the library does not hold or that is not complete.
    """
    torque = np.zeros((motion.start_s.size, motion.samples, motion.n))
    for effect in effects:
        try:
            model = effect["model"]
            place = Place(effect["joint"], effect["link"], model["other_joint"])
            shape = {str(name): float(value) for name, value in model["shape"].items()}
            coefficients = np.array(model["coefficients"], dtype=np.float64)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ModelFileError(
                f"Effect {effect.get('effect')} of the model is not complete ({error!r})", field="effects"
            ) from error
        columns = _library(effect).columns(motion, place, shape)
        if columns is None:
            continue
        joints = list(columns.joints)
        values = columns.values if columns.values_by_period is None else columns.values_by_period
        if coefficients.shape != values.shape[-1:]:
            raise ModelFileError(
                f"Effect {effect['effect']} of the model has {coefficients.size} coefficients, and {values.shape[-1]} "
                "are needed: diagnose the recording again and use the model that this writes",
                field="effects",
            )
        torque[:, :, joints] += values @ coefficients
    return torque


def _torque_beside(effects: Sequence[EffectJson], motion: Motion, class_terms: Mapping[str, Any] | None) -> FloatArray:
    """(K, S, n) Nm of effects and of torque without a name."""
    torque = effects_torque(effects, motion)
    return torque if class_terms is None else torque + terms_torque(class_terms, motion)


def without_effects(
    recording: Recording,
    effects: Sequence[EffectJson],
    regressor: BaseRegressor,
    values: FloatArray,
    low_pass_hz: float | None = None,
    class_terms: Mapping[str, Any] | None = None,
) -> Recording:
    """The recording with the effects' torque taken off each sample that has a place in a period or a stretch.

    values: (p,) base parameters of the regressor, whose torque effects that depend on load see. low_pass_hz: of the
    motion of recordings without periods. class_terms: torque without a name, as in `model.json`. Raises RecordingError
    where the recording cannot be used.
    """
    if not effects and class_terms is None:
        return recording
    torque = recording.torque.copy()
    for evidence in build_evidence(recording, regressor.robot, regressor, DiagnosisSettings(low_pass_hz=low_pass_hz)):
        motion = with_parameters(evidence, regressor, values).motion
        taken = _torque_beside(effects, motion, class_terms)
        if motion.periodic:
            assert recording.period_index is not None
            assert recording.sample_in_period is not None
            first = [int(np.searchsorted(recording.time - recording.time[0], start)) for start in motion.start_s]
            for period, number in enumerate(recording.period_index[first]):
                rows = np.flatnonzero(recording.period_index == number)
                torque[rows] -= taken[period, recording.sample_in_period[rows]]
        else:
            since = recording.time - recording.time[0] - motion.start_s[0]
            rows = np.flatnonzero((since >= motion.time[0]) & (since <= motion.time[-1]))
            for joint in range(recording.n):
                torque[rows, joint] -= np.interp(since[rows], motion.time, taken[0, :, joint])
    return replace(recording, torque=torque)


def acting(model: Model | Path) -> tuple[tuple[EffectJson, ...], Mapping[str, Any] | None]:
    """What a model file predicts in every recording beside its base parameters: repeatable effects, class terms.

    A simulator's file has neither.
    """
    if isinstance(model, Path):
        return (), None
    return repeatable(model.data.get("effects", [])), model.data.get("class_terms")


def left_to_parameters(
    model: Model | Path, recordings: Sequence[Recording], robot: RobotModel | None = None
) -> tuple[Recording, ...]:
    """Recordings as base parameters alone have to explain them: what else a model file predicts is taken off.

    What was found to change within one recording is taken to be absent from others. Of a joint whose torque was not
    measured nothing is taken. robot: overrides the robot the model names. Raises ModelFileError for a model of another
    robot or effects that are not complete, RecordingError where a recording cannot be used.
    """
    effects, terms = acting(model)
    if isinstance(model, Path) or (not effects and terms is None):
        return tuple(recordings)
    regressor = model.regressor(model.load_robot() if robot is None else robot)
    values = model.base_values(regressor)
    band = model.data.get("provenance", {}).get("settings", {}).get("low_pass_hz")
    sign = -1.0 if model.turns_torque else 1.0
    left = []
    for recording in recordings:
        upright = replace(recording, torque=sign * recording.torque)
        low_pass_hz = cutoff_as_far_as(band, recording.sampling_period_s)
        torque = sign * without_effects(upright, effects, regressor, values, low_pass_hz, terms).torque
        measured = np.ptp(recording.torque, axis=0) > 0.0
        left.append(replace(recording, torque=np.where(measured, torque, recording.torque)))
    return tuple(left)


def rows_expected(
    model: Model | Path,
    recordings: Sequence[Recording],
    robot: RobotModel,
    settings: DiagnosisSettings,
    split: Split | None,
) -> FloatArray:
    """(R, n) Nm, all that a model file predicts on the rows to fit of an arm that stands as this robot says.

    Raises as `left_to_parameters`.
    """
    left = left_to_parameters(model, recordings, robot)
    own, values = own_values(model, robot)

    def parts(items: Sequence[Recording]) -> list[Evidence]:
        return [part for item in items for part in build_evidence(item, robot, own, settings, split)]

    pairs = zip(parts(recordings), parts(left), strict=True)
    return np.concatenate([each.torque - rest.torque + each.nominal @ values for each, rest in pairs])


def rows_beside(
    model: Model | Path,
    recordings: Sequence[Recording],
    regressor: BaseRegressor,
    settings: DiagnosisSettings,
    split: Split | None,
) -> FloatArray | None:
    """(R, n) Nm, what a model file predicts on the rows to fit beside its parameters of the regressor; None: nothing.

    That is its effects and classes, and what it has of drives, offsets or another width of friction that the regressor
    has not. Raises as `left_to_parameters`.
    """
    robot, left = regressor.robot, left_to_parameters(model, recordings, regressor.robot)
    own = own_values(model, robot)[0]
    names = set(map(plain_name, regressor.names))
    wider = not names.issuperset(map(plain_name, own.names)) or own.options.coulomb_velocity != (
        regressor.options.coulomb_velocity
    )
    if not wider and all(one is other for one, other in zip(left, recordings, strict=True)):
        return None
    known = baseline_values(model, regressor)[1]
    parts = [part for item in recordings for part in build_evidence(item, robot, regressor, settings, split)]
    expected = rows_expected(model, recordings, robot, settings, split)
    return np.asarray(expected - np.concatenate([part.nominal @ known for part in parts]), dtype=np.float64)


def given_by(
    model: Model | Path,
    recordings: Sequence[Recording],
    regressor: BaseRegressor,
    settings: DiagnosisSettings,
    split: Split | None,
) -> tuple[str, FloatArray, FloatArray | None]:
    """As `baseline_values`, and (R, n) Nm that the model predicts beside these on the rows of recordings to fit."""
    return *baseline_values(model, regressor), rows_beside(model, recordings, regressor, settings, split)


def validate_with_effects(model: Model, recordings: Sequence[Recording]) -> RmsTable:
    """`validate_model` with the model's repeatable effects and class terms in its torque; without any, the same table.

    Raises as `validate_model` and `left_to_parameters` do.
    """
    return validate_model(model, recordings, left_to=left_to_parameters(model, recordings))


def torque_along(
    effects: Sequence[EffectJson],
    regressor: BaseRegressor,
    values: FloatArray,
    time: FloatArray,
    states: tuple[FloatArray, FloatArray, FloatArray],
    class_terms: Mapping[str, Any] | None = None,
) -> Callable[[_Timed], FloatArray]:
    """Effects' torque as a function of a simulated state's time, evaluated along the commanded periodic motion.

    time: (S,) s, uniform over one period. states: q, q̇, q̈ there, each (S, n). values: (p,) base parameters.
    The returned function takes anything with `time_s` and gives (n,) Nm; only repeatable effects are in it.
    """
    full = regressor.ungrouping @ values
    torque = regressor.torque(values, *states)
    width = regressor.options.coulomb_velocity
    motion = Motion(regressor.robot, time, *states, torque, full, True, np.zeros(1), width)
    return _by_time(effects, motion, class_terms)


def torque_along_recording(
    effects: Sequence[EffectJson],
    regressor: BaseRegressor,
    values: FloatArray,
    recording: Recording,
    class_terms: Mapping[str, Any] | None = None,
) -> Callable[[_Timed], FloatArray]:
    """As `torque_along`, along a recording's mean period. Raises RecordingError for one without periods."""
    evidence = build_evidence(recording, regressor.robot, regressor)[0]
    motion = with_parameters(evidence, regressor, values).motion
    if not motion.periodic:
        raise RecordingError(
            "Effects are simulated along periodic motions only; give a recording with periods, or a trajectory",
            file=recording.source.path,
            field="period_s",
        )
    return _by_time(effects, motion, class_terms)


def _by_time(
    effects: Sequence[EffectJson], motion: Motion, class_terms: Mapping[str, Any] | None
) -> Callable[[_Timed], FloatArray]:
    table = _torque_beside(repeatable(effects), motion, class_terms)[0]
    step, samples = motion.sampling_period_s, motion.samples
    return lambda state: np.asarray(table[round(state.time_s / step) % samples], dtype=np.float64)


def _library(effect: EffectJson) -> Any:
    try:
        return effect_named(str(effect.get("effect")))
    except KeyError as error:
        raise ModelFileError(
            f"The model names an effect that is not known: {effect.get('effect')}", field="effects"
        ) from error
