"""The fit: recordings of a robot in, base parameters with σ and feasible physical parameters out.

recordings → one pipeline each → regressor columns through the same operator → one compressed observation → least
squares (weighted) → sign of the torque → programs with physical constraints → RMS tables. The parts live in
`identification.fitting`, `signals` and `estimators`; this module only joins them. Called by the command line and the
detached worker.
"""

from __future__ import annotations

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
from identification.fitting.blocks import Block, Evaluation, build_block, rms_over
from identification.fitting.delay import TorqueDelay, earlier, estimate_delay
from identification.fitting.drives import choose_drive_parameters
from identification.fitting.estimate import (
    Estimate,
    default_estimator,
    estimate_parameters,
    estimate_with_bounded_outliers,
)
from identification.fitting.instruments import estimate_with_instruments, instrument_pairs
from identification.fitting.processing import Processed, process, process_stretches
from identification.fitting.result import FitResult
from identification.fitting.rms import RmsRow, RmsTable
from identification.fitting.settings import FitSettings, Split
from identification.fitting.torque_sign import TorqueSign, judge_torque_sign
from identification.recordings.independence import refuse_repeated
from identification.recordings.recording import Recording
from identification.robots import BUILT_IN_ROBOTS, RobotModel

__all__ = ["FitResult", "FitSettings", "Progress", "Split", "fit_recordings"]

FloatArray = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]
"""Called with what is being done and the share of the whole that is done, 0 to 1."""

MOST_STATES = 2000
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
    processed = []
    for number, recording in enumerate(recordings):
        report(f"processing {Path(recording.source.path).name}", 0.3 * number / len(recordings))
        processed.append(process(recording, robot, settings))

    report("regressor", 0.3)
    regressor, blocks, facts = _blocks_with_drives(processed, robot, settings)
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
    unsettled = ""
    feasibility: FeasibilityAnswer | None = None
    if settings.physical:
        report("parameters of real bodies", 0.6)
        rules = rules_for(robot).with_bounds(settings.bounds)
        try:
            consistent = settle_open_directions(least_squares.values, least_squares.covariance, regressor)
        except SolverError as error:  # exact data, weighed a million million times against the prior
            unsettled = f"No set of real bodies for simulators was found: {error}"
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
        torque_sign=sign,
        pipelines=tuple(item.pipeline for item in processed),
        recordings=tuple(recordings),
        notes=(
            *(f"{Path(item.recording.source.path).name}: {note}" for item in processed for note in item.notes),
            *((unsettled,) if unsettled else ()),
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


def _blocks_with_drives(
    processed: list[Processed], robot: RobotModel, settings: FitSettings
) -> tuple[BaseRegressor, list[Block], dict[str, Any]]:
    """Regressor and blocks with the drive parameters that the settings or the data ask for."""
    choices: dict[str, bool | None] = {}
    for name in ("rotor_inertia", "offset"):
        choice = getattr(settings, name)
        choices[name] = choice == "yes" if choice != "auto" else (False if robot.name in BUILT_IN_ROBOTS else None)
    wanted = {name: choice is not False for name, choice in choices.items()}
    velocity = settings.coulomb_velocity or 0.0
    regressor = BaseRegressor(robot, RegressorOptions(**wanted, coulomb_velocity=velocity))
    blocks = _build_blocks(processed, regressor, settings)
    if None not in choices.values():
        return regressor, blocks, {}
    decision = choose_drive_parameters(blocks, regressor, **choices)
    chosen = replace(regressor.options, rotor_inertia=decision.rotor_inertia, offset=decision.offset)
    if chosen != regressor.options:
        regressor = BaseRegressor(robot, chosen)
        blocks = _build_blocks(processed, regressor, settings)
    return regressor, blocks, {"drive_choice_held_out_cost": decision.scores}


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
        "seed": settings.seed,
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in LIBRARIES}},
        **facts,
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
