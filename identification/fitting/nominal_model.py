"""The nominal model of a fit: what settings leave open, the data choose, before any parameter is settled.

The band of recordings without periods, rotor inertias, offsets and the width of friction; then the rows of the fit and
the estimator on them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import EstimationError, RecordingError, UndeterminedParametersError
from identification.estimators.least_squares import LeastSquaresResult
from identification.fitting.band import BandChoice, choose_low_pass, velocity_noise_of
from identification.fitting.blocks import Block, build_block
from identification.fitting.choice import Rival, with_choice
from identification.fitting.delay import SMALL_DELAY_S, earlier, estimate_delay, torque_rate
from identification.fitting.drives import choose_drive_parameters, offsets_are_clear
from identification.fitting.estimate import (
    Estimate,
    default_estimator,
    estimate_parameters,
    estimate_with_bounded_outliers,
)
from identification.fitting.friction_width import FrictionWidth, friction_width, held_out_friction_width, width_sentence
from identification.fitting.instruments import estimate_with_instruments, instrument_pairs
from identification.fitting.processing import (
    Processed,
    process_stretches,
    process_whole_periods,
    process_without_periods,
)
from identification.fitting.settings import FitSettings, Progress, Split
from identification.recordings.recording import Recording
from identification.robots import BUILT_IN_ROBOTS, RobotModel

DELAYS_TAKEN_OFF = 3
"""Times that the delay is taken off before the width of friction is believed: each leaves a fraction of the last."""


def process_all(
    recordings: Sequence[Recording], robot: RobotModel, settings: FitSettings, report: Progress
) -> tuple[list[Processed], BandChoice | None]:
    """Every recording through its pipeline; the band of those without periods is chosen once, for all of them."""
    found: list[Processed | None] = []
    for number, recording in enumerate(recordings):
        report(f"processing {Path(recording.source.path).name}", 0.25 * number / len(recordings))
        found.append(process_whole_periods(recording, settings))
    others = [recording for recording, item in zip(recordings, found, strict=True) if item is None]
    band = None
    if others and settings.low_pass_hz is None:
        report("processing: which band to compare", 0.25)
        band = choose_low_pass(others, BaseRegressor(robot, _options(_asked(robot, settings), settings)))
        settings = replace(settings, low_pass_hz=band.low_pass_hz)
    processed = [
        process_without_periods(recording, settings) if item is None else item
        for recording, item in zip(recordings, found, strict=True)
    ]
    return processed, band


def build_blocks(processed: list[Processed], regressor: BaseRegressor, settings: FitSettings) -> list[Block]:
    """The rows of every stretch. Raises RecordingError where none is left to fit, or a split holds none out."""
    split = None if settings.split is None else Split.parse(settings.split)
    blocks = []
    for number, item in enumerate(processed):
        start, duration = float(item.recording.time[0]), item.recording.duration_s
        for stretch in item.stretches:
            block = build_block(stretch, regressor, split, start, duration)
            if block is not None:
                blocks.append(replace(block, recording=number))
    if not any(block.fitted.any() for block in blocks):
        raise RecordingError(
            "No row is left to fit: the robot stands still in all of the recording, or all is held out"
        )
    if split is not None and not any(block.held_out.any() for block in blocks):
        longest = max(item.recording.duration_s for item in processed)
        raise RecordingError(
            f"'{settings.split}' holds out no row of what lasts {longest:.4g} s at most; choose shorter blocks, or "
            "'first:0.6'",
            field="split",
        )
    return blocks


def blocks_as(
    blocks: list[Block], old: BaseRegressor, new: BaseRegressor, processed: list[Processed], settings: FitSettings
) -> list[Block]:
    """The rows of another regressor, from those there are as far as they have its columns."""
    changed = [block.with_regressor(old, new) for block in blocks]
    known = [block for block in changed if block is not None]
    return known if len(known) == len(changed) else build_blocks(processed, new, settings)


@dataclass(frozen=True, slots=True, eq=False)
class NominalModel:
    """regressor, blocks: of the model that was chosen. facts: for the provenance.

    left_out: larger models considered and not taken, each with its log-likelihood against the chosen one, or None
    where only its estimate tells it. largest: regressor and blocks of all that was considered but for the width.
    """

    regressor: BaseRegressor
    blocks: list[Block]
    facts: dict[str, Any]
    left_out: tuple[tuple[RegressorOptions, float | None], ...]
    largest: tuple[BaseRegressor, list[Block]]


def choose_nominal_model(processed: list[Processed], robot: RobotModel, settings: FitSettings) -> NominalModel:
    """Regressor and blocks with the rotor inertias, offsets and width of friction that settings or data ask for."""
    asked = _asked(robot, settings)
    facts: dict[str, Any] = {}
    left_out: list[tuple[RegressorOptions, float | None]] = []
    regressor = BaseRegressor(robot, _options(asked, settings))
    blocks = build_blocks(processed, regressor, settings)
    largest = regressor, blocks
    known = all(block.signals.row_noise is not None for block in blocks)
    of_periods = all(block.signals.row_time is None for block in blocks)
    offsets_are_open = of_periods and asked["offset"] is None
    rotors_are_open = asked["rotor_inertia"] is None
    if None in asked.values():
        chosen = regressor.options
        if offsets_are_open:
            estimate = estimate_with(blocks, regressor, processed, settings)[1].least_squares
            clear = offsets_are_clear(estimate.values, estimate.std, regressor)
            asked["offset"], chosen = clear, replace(chosen, offset=clear)
        if None in asked.values():
            decision = choose_drive_parameters(blocks, regressor, **asked)
            facts["drive_choice_held_out_cost"] = decision.scores
            chosen = replace(chosen, rotor_inertia=decision.rotor_inertia, offset=decision.offset)
        if chosen != regressor.options:
            regressor = BaseRegressor(robot, chosen)
            blocks = blocks_as(largest[1], largest[0], regressor, processed, settings)
    without_periods = any(block.signals.pipeline == "aperiodic" for block in blocks)
    if settings.coulomb_velocity is None and (known or without_periods):
        width = _friction_width(blocks, regressor, processed, settings)
        wide = replace(regressor.options, coulomb_velocity=width.velocity)
        if width.clear:
            facts["friction_width_gain"] = width.gain.tolist()
            narrow, regressor = regressor, BaseRegressor(robot, wide)
            blocks = blocks_as(blocks, narrow, regressor, processed, settings)
        elif known and wide.turns_gently:
            left_out.append((wide, float(width.gain.sum())))
    if offsets_are_open and not regressor.options.offset:
        left_out.append((replace(regressor.options, offset=True), None))
    if known and rotors_are_open and not regressor.options.rotor_inertia:
        left_out.append((replace(regressor.options, rotor_inertia=True), None))
    return NominalModel(regressor, blocks, facts, tuple(left_out), largest)


def estimate_nominal(model: NominalModel, processed: list[Processed], settings: FitSettings) -> tuple[str, Estimate]:
    """The estimator by name and what it finds, its covariance with what the choice of the model adds."""
    estimator, estimate = estimate_with(model.blocks, model.regressor, processed, settings)
    rivals = []
    for options, gain in model.left_out:
        regressor = BaseRegressor(model.regressor.robot, options)
        try:
            blocks = blocks_as(model.largest[1], model.largest[0], regressor, processed, settings)
            other = estimate_with(blocks, regressor, processed, settings)[1].least_squares
        except UndeterminedParametersError:
            continue
        rivals.append(Rival(other, _gain_of_more(other, estimate.least_squares) if gain is None else gain - 1.0))
    return estimator, replace(estimate, least_squares=with_choice(estimate.least_squares, rivals))


def notes_on_model(regressor: BaseRegressor, settings: FitSettings) -> list[str]:
    """What the data chose of the nominal model."""
    notes = []
    if regressor.options.offset and settings.offset == "auto":
        notes.append("Each joint has a constant torque besides (offset): the data ask for it on the arm as a whole")
    if regressor.options.turns_gently and settings.coulomb_velocity is None:
        notes.append(width_sentence(regressor.options.coulomb_velocity, regressor.robot))
    return notes


def estimate_with(
    blocks: list[Block], regressor: BaseRegressor, processed: list[Processed], settings: FitSettings
) -> tuple[str, Estimate]:
    """The estimator that the settings name, by name, and what it finds."""
    estimator: str = settings.estimator
    if estimator == "auto":
        estimator = default_estimator({item.pipeline for item in processed})
    if estimator == "huber":
        return estimator, estimate_with_bounded_outliers(blocks, regressor)
    if estimator == "instrumental":
        if settings.split is not None:
            raise EstimationError(
                "The instrumental estimator fits whole recordings; hold out another recording instead"
            )
        pairs = [
            pair
            for item in processed
            for pair in instrument_pairs(
                item.recording, item.stretches, regressor, lambda half: process_stretches(half, settings)
            )
        ]
        if len(pairs) != len(blocks):
            raise EstimationError("A stretch without usable rows leaves the instruments without their counterpart")
        return estimator, estimate_with_instruments(blocks, pairs, regressor.names)
    return estimator, estimate_parameters(blocks, regressor.names, estimator)


def _gain_of_more(larger: LeastSquaresResult, chosen: LeastSquaresResult) -> float:
    """Log-likelihood that what a larger model has more gains by its own covariance, less one for each parameter."""
    own = [index for index, name in enumerate(larger.names) if name not in chosen.names]
    values, covariance = larger.values[own], larger.covariance[np.ix_(own, own)]
    return 0.5 * float(values @ np.linalg.solve(covariance, values)) - len(own)


def _asked(robot: RobotModel, settings: FitSettings) -> dict[str, bool | None]:
    """Whether each joint gets a rotor inertia and an offset; None: as the data say."""
    asked = {
        name: None if getattr(settings, name) == "auto" else getattr(settings, name) == "yes"
        for name in ("rotor_inertia", "offset")
    }
    if robot.name in BUILT_IN_ROBOTS:
        if asked["rotor_inertia"] is None:
            asked["rotor_inertia"] = False  # their torque sensors sit behind the gear
        if asked["offset"] is None and settings.pipeline == "paper":
            asked["offset"] = False  # eq. (1) has none
    return asked


def _options(asked: dict[str, bool | None], settings: FitSettings) -> RegressorOptions:
    """The largest model that may be wanted."""
    wanted = {name: choice is not False for name, choice in asked.items()}
    return RegressorOptions(**wanted, coulomb_velocity=settings.coulomb_velocity or 0.0)


def _velocity_noise(processed: Sequence[Processed]) -> FloatArray:
    """(n,) rad/s (m/s), the largest noise of each joint's velocity among recordings without periods."""
    every = [
        velocity_noise_of(item.recording, float(stretch.facts["low_pass_hz"]))
        for item in processed
        for stretch in item.stretches
        if "low_pass_hz" in stretch.facts
    ]
    return np.asarray(np.max(every, axis=0))


def _friction_width(
    blocks: list[Block], regressor: BaseRegressor, processed: list[Processed], settings: FitSettings
) -> FrictionWidth:
    """Measured with the weights of the fit with sign(q̇); again on the torque moved by its delay, where one is wide.

    A delay of many samples is no small change of the torque: taken off, it must leave the friction as wide as before.
    """
    blocks = [block for block in blocks if block.fitted.any()]
    width = FrictionWidth(0.0, np.zeros(regressor.robot.n), False)
    for turn in range(1 + DELAYS_TAKEN_OFF):
        estimate = estimate_with(blocks, regressor, processed, replace(settings, estimator="maximum_likelihood"))[1]
        values = estimate.least_squares.values
        delays = [block.signals.project(torque_rate(block, regressor, values)) for block in blocks]
        if all(block.signals.row_noise is not None for block in blocks):
            width = friction_width(estimate.blocks, delays, estimate.least_squares.weights, regressor)
        else:
            width = held_out_friction_width(blocks, delays, _velocity_noise(processed), regressor)
        if not width.clear or turn == DELAYS_TAKEN_OFF:
            break
        late = estimate_delay(blocks, values, regressor, "maximum_likelihood").common
        if abs(late) < SMALL_DELAY_S:
            break
        moved = [earlier(block.signals, np.full(block.signals.n, late)) for block in blocks]
        blocks = [
            replace(block, signals=signals, torque=signals.project(signals.torque))
            for block, signals in zip(blocks, moved, strict=True)
        ]
    return width
