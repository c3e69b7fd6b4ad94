"""The fit: recordings of a robot in, base parameters with σ and feasible physical parameters out.

recordings → one pipeline each → regressor columns through the same operator → one compressed observation → least
squares (weighted) → sign of the torque → programs with physical constraints → RMS tables. The parts live in
`identification.fitting`, `signals` and `estimators`; this module only joins them. Called by the command line and the
detached worker.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import EstimationError, RecordingError, SolverError, UndeterminedParametersError
from identification.estimators.constrained import ConstrainedResult, solve_constrained
from identification.estimators.feasibility import rules_for
from identification.estimators.least_squares import LeastSquaresResult
from identification.estimators.nearest import FeasibilityAnswer, nearest_physical
from identification.estimators.prior import SettledParameters, settle_open_directions
from identification.fitting.band import BandChoice, choose_low_pass
from identification.fitting.blocks import Block, Evaluation, build_block, rms_over
from identification.fitting.delay import TorqueDelay, earlier, estimate_delay, torque_rate
from identification.fitting.drives import choose_drive_parameters, offsets_are_clear
from identification.fitting.estimate import (
    Estimate,
    default_estimator,
    estimate_parameters,
    estimate_with_bounded_outliers,
)
from identification.fitting.friction_width import FrictionWidth, friction_width, width_sentence
from identification.fitting.instruments import estimate_with_instruments, instrument_pairs
from identification.fitting.misfit import misfit_over_noise
from identification.fitting.processing import (
    Processed,
    check_recording,
    process_stretches,
    process_whole_periods,
    process_without_periods,
)
from identification.fitting.result import FitResult
from identification.fitting.rms import RmsRow, RmsTable
from identification.fitting.settings import FitSettings, Split
from identification.fitting.torque_sign import TorqueSign, judge_torque_sign
from identification.recordings.independence import refuse_repeated
from identification.recordings.joint_choice import for_robot
from identification.recordings.recording import Recording
from identification.robots import BUILT_IN_ROBOTS, RobotModel

__all__ = ["FitResult", "FitSettings", "Progress", "Split", "fit_recordings"]

FloatArray = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]
"""Called with what is being done and the share of the whole that is done, 0 to 1."""

MOST_STATES = 2000
SMALL_DELAY_S = 1e-3
"""A common delay up to this is a small change of the torque, which one column describes."""
DELAYS_TAKEN_OFF = 3
"""Times that the delay is taken off before the width of friction is believed: each leaves a fraction of the last."""
WITHOUT_PART_IN_THE_BASE = ("physical", "bounds", "full_consistency", "starts", "seed", "check_torque_sign")
"""Settings that only the programs with constraints ask for, or none."""
LIBRARIES = ("iiwa-ident", "numpy", "scipy", "pin", "clarabel")


def fit_recordings(
    recordings: Sequence[Recording],
    robot: RobotModel,
    settings: FitSettings | None = None,
    *,
    progress: Progress | None = None,
) -> FitResult:
    """Identify a robot from one or several recordings together.

    Raises RecordingError for a recording that does not fit the robot or whose torque has the wrong sign (see
    FitSettings.flip_torque), UndeterminedParametersError when the motion leaves parameters undetermined, SolverError
    when a program with constraints has no solution.
    """
    settings = settings if settings is not None else FitSettings()
    report = progress if progress is not None else _silent
    if not recordings:
        raise EstimationError("No recording was given to fit")
    refuse_repeated(recordings)
    recordings = [for_robot(recording, robot) for recording in recordings]
    for recording in recordings:
        check_recording(recording)
    processed, band = _process_all(recordings, robot, settings, report)
    if band is not None:
        settings = replace(settings, low_pass_hz=band.low_pass_hz)
    report("regressor", 0.3)
    regressor, blocks, facts = _nominal_model(processed, robot, settings)
    report("least squares", 0.5)
    estimator, estimate = _estimate(blocks, regressor, processed, settings)
    delay = _delay(blocks, regressor, estimate, estimator)
    if settings.delay_correction != "no":
        shift = delay.of(settings.delay_correction)
        processed = [
            replace(item, stretches=tuple(earlier(stretch, shift) for stretch in item.stretches)) for item in processed
        ]
        blocks = _build_blocks(processed, regressor, settings)
        estimator, estimate = _estimate(blocks, regressor, processed, settings)
    least_squares = estimate.least_squares
    sign = _torque_sign(regressor, least_squares, blocks)
    if settings.check_torque_sign:
        _refuse_wrong_sign(sign, processed)

    constrained: ConstrainedResult | None = None
    consistent: SettledParameters | None = None
    feasibility: FeasibilityAnswer | None = None
    if settings.physical:
        report("parameters of real bodies", 0.6)
        rules = rules_for(robot).with_bounds(settings.bounds)
        consistent = settle_open_directions(least_squares.values, least_squares.covariance, regressor)
        report("feasible parameters (program 10)", 0.7)
        constrained = solve_constrained(
            least_squares.reduced,
            regressor,
            rules,
            starts=settings.starts,
            seed=settings.seed,
            full_consistency=settings.full_consistency,
        )
        feasibility = _feasibility(blocks, regressor, least_squares)
    report("validation", 0.95)
    noise_floor = _noise_floor(blocks)
    sets = {"base": least_squares.values}
    if constrained is not None:
        sets["physical"] = constrained.base_values
    result = FitResult(
        robot=robot,
        regressor=regressor,
        settings=settings,
        least_squares=least_squares,
        estimator=estimator,
        equation_15_std=estimate.ordinary.std,
        torque_delay=delay,
        constrained=constrained,
        consistent=consistent,
        feasibility=feasibility,
        rms=_rms_table(blocks, sets, noise_floor),
        noise_floor_nm=noise_floor,
        misfit=misfit_over_noise([block for block in blocks if block.fitted.any()], least_squares.values),
        torque_sign=sign,
        pipelines=tuple(item.pipeline for item in processed),
        recordings=tuple(recordings),
        notes=(
            *(f"{Path(item.recording.source.path).name}: {note}" for item in processed for note in item.notes),
            *([] if band is None else [band.sentence]),
            *_notes_on_model(regressor, settings),
        ),
        provenance=_provenance(processed, robot, regressor, settings, facts),
    )
    report("done", 1.0)
    return result


def _silent(phase: str, share: float) -> None:
    """Progress that nobody watches."""


def _build_blocks(processed: list[Processed], regressor: BaseRegressor, settings: FitSettings) -> list[Block]:
    split = None if settings.split is None else Split.parse(settings.split)
    blocks = []
    for item in processed:
        start, duration = float(item.recording.time[0]), item.recording.duration_s
        for stretch in item.stretches:
            block = build_block(stretch, regressor, split, start, duration)
            if block is not None:
                blocks.append(block)
    if not any(block.fitted.any() for block in blocks):
        raise RecordingError(
            "No row is left to fit: the robot stands still in all of the recording, or all is held out"
        )
    return blocks


def _process_all(
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


def _nominal_model(
    processed: list[Processed], robot: RobotModel, settings: FitSettings
) -> tuple[BaseRegressor, list[Block], dict[str, Any]]:
    """Regressor and blocks with the rotor inertias, offsets and width of friction that settings or data ask for."""
    asked = _asked(robot, settings)
    facts: dict[str, Any] = {}
    regressor = BaseRegressor(robot, _options(asked, settings))
    blocks = _build_blocks(processed, regressor, settings)
    known = all(block.signals.row_noise is not None for block in blocks)
    if None in asked.values():
        chosen = regressor.options
        if known and asked["offset"] is None:
            estimate = _estimate(blocks, regressor, processed, settings)[1].least_squares
            clear = offsets_are_clear(estimate.values, estimate.std, regressor)
            asked["offset"], chosen = clear, replace(chosen, offset=clear)
        if None in asked.values():
            decision = choose_drive_parameters(blocks, regressor, **asked)
            facts["drive_choice_held_out_cost"] = decision.scores
            chosen = replace(chosen, rotor_inertia=decision.rotor_inertia, offset=decision.offset)
        if chosen != regressor.options:
            regressor = BaseRegressor(robot, chosen)
            blocks = _build_blocks(processed, regressor, settings)
    if settings.coulomb_velocity is None and known:
        width = _friction_width(blocks, regressor, processed, settings)
        if width.velocity > 0.0:
            facts["friction_width_gain"] = width.gain.tolist()
            regressor = BaseRegressor(robot, replace(regressor.options, coulomb_velocity=width.velocity))
            blocks = _build_blocks(processed, regressor, settings)
    return regressor, blocks, facts


def _notes_on_model(regressor: BaseRegressor, settings: FitSettings) -> list[str]:
    """What the data chose of the nominal model."""
    notes = []
    if regressor.options.offset and settings.offset == "auto":
        notes.append("Each joint has a constant torque besides (offset): the data ask for it on the arm as a whole")
    if regressor.options.coulomb_velocity > 0.0 and settings.coulomb_velocity is None:
        notes.append(width_sentence(regressor.options.coulomb_velocity))
    return notes


def _friction_width(
    blocks: list[Block], regressor: BaseRegressor, processed: list[Processed], settings: FitSettings
) -> FrictionWidth:
    """Measured with the weights of the fit with sign(q̇); again on the torque moved by its delay, where one is wide.

    A delay of many samples is no small change of the torque: taken off, it must leave the friction as wide as before.
    """
    blocks = [block for block in blocks if block.fitted.any()]
    width = FrictionWidth(0.0, np.zeros(regressor.robot.n))
    for turn in range(1 + DELAYS_TAKEN_OFF):
        estimate = _estimate(blocks, regressor, processed, replace(settings, estimator="maximum_likelihood"))[1]
        values = estimate.least_squares.values
        delays = [block.signals.project(torque_rate(block.signals, regressor, values)) for block in blocks]
        width = friction_width(estimate.blocks, delays, estimate.least_squares.weights, regressor)
        if width.velocity == 0.0 or turn == DELAYS_TAKEN_OFF:
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


def _estimate(
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


def _delay(blocks: list[Block], regressor: BaseRegressor, estimate: Estimate, estimator: str) -> TorqueDelay:
    plain = estimator if estimator in ("ols", "weighted") else "maximum_likelihood"
    return estimate_delay(blocks, estimate.least_squares.values, regressor, plain)


def _feasibility(
    blocks: list[Block], regressor: BaseRegressor, estimate: LeastSquaresResult
) -> FeasibilityAnswer | None:
    """Can a robot have these base parameters, asked on the fitted motion; None if the program has no answer."""
    signals = [block.signals for block in blocks]
    motion = tuple(
        np.concatenate([getattr(item, name) for item in signals]) for name in ("position", "velocity", "acceleration")
    )
    chosen = np.linspace(0, len(motion[0]) - 1, min(MOST_STATES, len(motion[0]))).astype(int)
    states = (motion[0][chosen], motion[1][chosen], motion[2][chosen])
    try:
        return nearest_physical(estimate.values, regressor, states, std=estimate.std)
    except (SolverError, UndeterminedParametersError):
        return None


def _torque_sign(regressor: BaseRegressor, estimate: LeastSquaresResult, blocks: list[Block]) -> TorqueSign:
    signals = [block.signals for block in blocks]
    return judge_torque_sign(
        regressor,
        estimate.values,
        estimate.covariance,
        np.concatenate([item.position for item in signals]),
        np.concatenate([item.velocity for item in signals]),
        np.concatenate([item.torque for item in signals]),
    )


def _refuse_wrong_sign(sign: TorqueSign, processed: list[Processed]) -> None:
    if not sign.inverted:
        return
    path = processed[0].recording.source.path
    joints = ", ".join(str(joint) for joint in sign.inverted_joints) or "several joints together"
    gravity = (
        ""
        if np.isnan(sign.gravity_correlation)
        else f"; at low speed gravity correlates {sign.gravity_correlation:+.2f}"
    )
    raise RecordingError(
        f"{Path(path).name}: the torque has the opposite sign of the inverse dynamics: as it stands, inertia or "
        f"friction of joint {joints} would be negative{gravity}. Import it with the sign turned (flip_torque)",
        file=path,
        field="tau",
        joint=next(iter(sign.inverted_joints), None),
    )


def _noise_floor(blocks: list[Block]) -> FloatArray:
    """(n,) RMS of the noise over all evaluated rows; nan if any stretch does not know its noise."""
    counts = np.array([block.evaluation.counts for block in blocks], dtype=np.float64)
    squares = np.array([block.signals.noise_floor_nm**2 for block in blocks])
    return np.asarray(np.sqrt((counts * squares).sum(axis=0) / np.maximum(counts.sum(axis=0), 1.0)), dtype=np.float64)


def _rms_table(blocks: list[Block], sets: dict[str, FloatArray], noise_floor: FloatArray) -> RmsTable:
    parts = {"fit": [block.evaluation for block in blocks if block.fitted.any()]}
    held_out: list[Evaluation] = [
        block.evaluation_held_out for block in blocks if block.evaluation_held_out is not None
    ]
    if held_out:
        parts["held out"] = held_out
    return RmsTable(
        tuple(
            RmsRow(f"{data}, {name}", rms_over(chosen, values), rms_over(chosen, None), noise_floor)
            for data, chosen in parts.items()
            for name, values in sets.items()
        )
    )


def _provenance(
    processed: list[Processed],
    robot: RobotModel,
    regressor: BaseRegressor,
    settings: FitSettings,
    facts: dict[str, Any],
) -> dict[str, Any]:
    return {
        "inputs": [
            {
                "file": Path(item.recording.source.path).name,
                "sha256": item.recording.source.sha256,
                "kind": item.recording.source.kind,
                "samples": item.recording.samples,
                "pipeline": item.pipeline,
                "import_report": item.recording.report.to_json(),
                "stretches": [
                    {name: value for name, value in stretch.facts.items() if name != "notes"}
                    for stretch in item.stretches
                ],
            }
            for item in processed
        ],
        "robot": {"name": robot.name, "source": Path(robot.source).name, "digest": robot.digest},
        "regressor": regressor.options.to_json(),
        "settings": settings.to_json(),
        "digest": _digest(processed, robot, regressor, settings),
        "seed": settings.seed,
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in LIBRARIES}},
        **facts,
    }


def _digest(processed: list[Processed], robot: RobotModel, regressor: BaseRegressor, settings: FitSettings) -> str:
    """SHA-256 of all that the base parameters follow from: inputs, robot, options and settings, but for rounding."""
    told = {name: value for name, value in settings.to_json().items() if name not in WITHOUT_PART_IN_THE_BASE}
    options = {**regressor.options.to_json(), "coulomb_velocity": f"{regressor.options.coulomb_velocity:.4g}"}
    inputs = [item.recording.source.sha256 for item in processed]
    text = json.dumps([inputs, robot.digest, options, told], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
