"""The fit: recordings of a robot in, base parameters with σ and feasible physical parameters out.

recordings → one pipeline each → regressor columns through the same operator → one compressed observation → least
squares (weighted) → sign of the torque → programs with physical constraints → RMS tables. The parts live in
`identification.fitting`, `signals` and `estimators`; this module only joins them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from identification.arrays import FloatArray, evenly
from identification.base_parameters import BaseRegressor
from identification.errors import EstimationError, RecordingError, SolverError, UndeterminedParametersError
from identification.estimators.constrained import ConstrainedResult, solve_constrained
from identification.estimators.feasibility import friction_beyond, rules_for
from identification.estimators.least_squares import LeastSquaresResult
from identification.estimators.nearest import FeasibilityAnswer, nearest_physical
from identification.estimators.prior import SettledParameters, settle_open_directions
from identification.fitting.agreement import notes_on_agreement, notes_on_arms
from identification.fitting.band import BandChoice
from identification.fitting.blocks import Block, Evaluation, rms_over
from identification.fitting.delay import TorqueDelay, earlier, estimate_delay
from identification.fitting.estimate import Estimate
from identification.fitting.misfit import Misfit, misfit_over_noise, notes_on_joints_missed
from identification.fitting.nominal_model import (
    NominalModel,
    blocks_as,
    build_blocks,
    choose_nominal_model,
    estimate_nominal,
    notes_on_model,
    process_all,
)
from identification.fitting.processing import Processed, check_recording, naming_joints_at_rest
from identification.fitting.provenance import provenance
from identification.fitting.result import FitResult
from identification.fitting.rms import RmsRow, RmsTable
from identification.fitting.settings import FitSettings, Progress, Split, silent
from identification.fitting.torque_sign import TorqueSign, judge_torque_sign, notes_on_signs
from identification.recordings.independence import recording_names, refuse_repeated
from identification.recordings.joint_choice import for_robot
from identification.recordings.recording import Recording
from identification.recordings.standing import standing_values
from identification.recordings.units import wrong_torque_unit
from identification.robots import RobotModel
from identification.signals.processed import ProcessedSignals

__all__ = ["FitResult", "FitSettings", "Progress", "Split", "fit_recordings"]

MOST_STATES = 2000


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
    report = progress if progress is not None else silent
    if not recordings:
        raise EstimationError("No recording was given to fit")
    refuse_repeated(recordings)
    recordings = [for_robot(recording, robot) for recording in recordings]
    for recording in recordings:
        check_recording(recording, robot)
    processed, band = process_all(recordings, robot, settings, report)
    if band is not None:
        settings = replace(settings, low_pass_hz=band.low_pass_hz)
    model, estimator, estimate = _nominal(processed, robot, settings, report)
    regressor = model.regressor
    delay = _delay(model.blocks, regressor, estimate, estimator)
    shift = delay.of(settings.delay_correction)
    if settings.delay_correction != "no":
        processed, model = _with_torque_earlier(processed, model, shift, settings)
        estimator, estimate = estimate_nominal(model, processed, settings)
        estimate = estimate.wider(delay.spread(settings.delay_correction))
    blocks, least_squares = model.blocks, estimate.least_squares
    sign = _torque_sign(regressor, least_squares, blocks)
    if settings.check_torque_sign:
        _refuse_wrong_sign(sign, processed)

    misfit = misfit_over_noise([block for block in blocks if block.fitted.any()], least_squares.values)
    together = notes_on_agreement(blocks, least_squares.values, recording_names(recordings))
    own = [item.recording for item in processed]
    misread = cache(lambda: _Misread.of(own, regressor, sign, misfit, apart=bool(together)))
    with _blamed_for_no_solution(misread, own[0]):
        real = _real_bodies(blocks, robot, regressor, least_squares, settings, report)
    report("validation", 0.95)
    noise_floor = _noise_floor(blocks)
    sets = {"base": least_squares.values}
    if real.constrained is not None:
        sets["physical"] = real.constrained.base_values
    rms = _rms_table(blocks, sets, noise_floor)
    known = _notes(rms, processed, band, [*together, *_notes_on_estimate(regressor, least_squares, settings)])
    result = FitResult(
        robot=robot,
        regressor=regressor,
        settings=settings,
        least_squares=least_squares,
        estimator=estimator,
        equation_15_std=estimate.ordinary.std,
        torque_delay=delay,
        torque_shift=shift,
        constrained=real.constrained,
        consistent=real.consistent,
        feasibility=real.feasibility,
        rms=rms,
        noise_floor_nm=noise_floor,
        misfit=misfit,
        torque_sign=sign,
        pipelines=tuple(item.pipeline for item in processed),
        recordings=tuple(recordings),
        told=cache(lambda: _spoiling_first([*notes_on_signs(sign), *misread().notes, *known])),
        provenance=provenance(processed, robot, regressor, settings, model.facts),
    )
    report("done", 1.0)
    return result


def _nominal(
    processed: list[Processed], robot: RobotModel, settings: FitSettings, report: Progress
) -> tuple[NominalModel, str, Estimate]:
    """The nominal model, and the estimator by name with what it finds."""
    with naming_joints_at_rest([item.recording for item in processed], robot):
        report("regressor", 0.3)
        model = choose_nominal_model(processed, robot, settings)
        report("least squares", 0.5)
        return model, *estimate_nominal(model, processed, settings)


@dataclass(frozen=True, slots=True)
class _Misread:
    """What recordings are that they do not state. wrong_unit: why the torques are of no arm of that size, empty where
    they may be. misplaced: which torques or positions are not those of their joint, or count the other way, in words.
    stand: why the base hardly stands as stated, empty where it may. others: as what else each has to be read, in words.
    """

    wrong_unit: str
    misplaced: str
    stand: str
    others: tuple[str, ...]

    @classmethod
    def of(
        cls,
        recordings: Sequence[Recording],
        regressor: BaseRegressor,
        sign: TorqueSign,
        misfit: Misfit,
        *,
        apart: bool = False,
    ) -> _Misread:
        """Of what is fitted; where nothing but noise is left, no joint is misplaced and none changes.

        apart: whether the recordings do not go together; then each is asked alone, too.
        """
        robot = regressor.robot
        unstated = [item for item in recordings if "tau" not in item.units_stated]
        largest = [float(np.abs(item.torque).max()) for item in unstated]
        gravity_acts = bool(np.isfinite(sign.gravity_correlation))
        wrong_unit = wrong_torque_unit(max(largest), robot, gravity_acts=gravity_acts) if largest else ""
        if not misfit.may_be_more_than_noise:
            return cls(wrong_unit, "", "", ())
        # Slow to load, and most fits leave nothing but noise.
        from identification.audit.mount import misplaced, stand_in_doubt
        from identification.audit.otherwise import may_be_read_otherwise, other_readings
        from identification.mismatch.data_faults.faults import find_data_faults

        where = misplaced(recordings, robot)
        if where:  # joints that are out of place look like much else
            return cls(wrong_unit, where, "", ())
        faults = find_data_faults(recordings, regressor)
        turned = [any(each.fault == "inverted_torque_sign" for each in own) for own in faults]
        read = other_readings(recordings, robot, turned, large=may_be_read_otherwise(misfit.over_noise))
        others = []
        for recording, name, reading, own in zip(recordings, recording_names(recordings), read, faults, strict=True):
            elsewhere = misplaced([recording], robot) if apart else ""
            if elsewhere:
                others.append(f"{name}: {elsewhere.rstrip('.')}")
                continue
            clock = [each.sentence.rstrip(".") for each in own if each.fault == "wrong_time_base"]
            if clock and (reading is None or reading.kind == "clock"):
                others += clock
            elif reading is not None:
                others.append(reading.sentence)
        return cls(wrong_unit, "", stand_in_doubt(recordings, robot), tuple(others))

    @property
    def notes(self) -> list[str]:
        """A warning for each."""
        unit = [f"{self.wrong_unit} Every parameter scales with them"] if self.wrong_unit else []
        others = (each.rstrip(".") for each in (self.misplaced, self.stand) if each)
        return [f"WARNING, {each}" for each in (*unit, *others, *self.others)]


@contextmanager
def _blamed_for_no_solution(misread: Callable[[], _Misread], recording: Recording) -> Iterator[None]:
    """A program that has no solution in such numbers is their fault, which is said."""
    try:
        yield
    except SolverError as error:
        path, found = recording.source.path, misread()
        if found.misplaced:
            raise RecordingError.named(path, found.misplaced.rstrip("."), field="q") from error
        if found.wrong_unit:
            raise RecordingError.named(path, found.wrong_unit, field="tau") from error
        raise


def _notes(
    rms: RmsTable, processed: Sequence[Processed], band: BandChoice | None, on_fit: Sequence[str]
) -> tuple[str, ...]:
    """What is said of a fit beside signs and what else its recordings may be."""
    return (
        *notes_on_arms([item.recording for item in processed]),
        *notes_on_joints_missed(rms),
        *_notes_on_standing([item.recording for item in processed]),
        *(f"{Path(item.recording.source.path).name}: {note}" for item in processed for note in item.notes),
        *([] if band is None else [band.sentence]),
        *on_fit,
    )


def _spoiling_first(notes: Sequence[str]) -> tuple[str, ...]:
    """All that is said of a fit, what spoils it first."""
    return tuple(sorted(notes, key=lambda note: not note.startswith("WARNING")))


def _notes_on_standing(recordings: Sequence[Recording]) -> list[str]:
    """A warning for each sensor that stands while it should change: the parameters of all joints bend to it."""
    return [
        f"WARNING, {name}: {finding.sentence}; every parameter bends to that: leave these rows out, or record anew"
        for recording, name in zip(recordings, recording_names(recordings), strict=True)
        for finding in standing_values(recording)
    ]


def _notes_on_estimate(regressor: BaseRegressor, estimate: LeastSquaresResult, settings: FitSettings) -> list[str]:
    """What the data chose of the model, and that program (10), where it was solved, was not free to keep the measured
    friction.
    """
    rules = rules_for(regressor.robot).with_bounds(settings.bounds)
    said = friction_beyond(rules, regressor.names, estimate.values, estimate.std, regressor.units)
    return [*([said] if settings.physical and said else []), *notes_on_model(regressor, settings)]


def _with_torque_earlier(
    processed: list[Processed], model: NominalModel, shift: FloatArray, settings: FitSettings
) -> tuple[list[Processed], NominalModel]:
    """The recordings with their torques (n,) s earlier, and the model's rows made of them anew."""
    moved = [
        replace(item, stretches=tuple(earlier(stretch, shift) for stretch in item.stretches)) for item in processed
    ]
    whole = model.largest[0]
    largest = whole, build_blocks(moved, whole, settings)
    blocks = blocks_as(largest[1], whole, model.regressor, moved, settings)
    return moved, replace(model, blocks=blocks, largest=largest)


@dataclass(frozen=True, slots=True)
class _RealBodies:
    """What is said of real bodies: the solution of program (10), a consistent set, whether any body can be so."""

    constrained: ConstrainedResult | None = None
    consistent: SettledParameters | None = None
    feasibility: FeasibilityAnswer | None = None


def _real_bodies(
    blocks: list[Block],
    robot: RobotModel,
    regressor: BaseRegressor,
    estimate: LeastSquaresResult,
    settings: FitSettings,
    report: Progress,
) -> _RealBodies:
    if not settings.physical:
        return _RealBodies()
    report("parameters of real bodies", 0.6)
    consistent = settle_open_directions(estimate.values, estimate.covariance, regressor)
    report("feasible parameters (program 10)", 0.7)
    constrained = solve_constrained(
        estimate.reduced,
        regressor,
        rules_for(robot).with_bounds(settings.bounds),
        starts=settings.starts,
        seed=settings.seed,
        full_consistency=settings.full_consistency,
    )
    return _RealBodies(constrained, consistent, _feasibility(blocks, regressor, estimate))


def _delay(blocks: list[Block], regressor: BaseRegressor, estimate: Estimate, estimator: str) -> TorqueDelay:
    plain = estimator if estimator in ("ols", "weighted") else "maximum_likelihood"
    return estimate_delay(blocks, estimate.least_squares.values, regressor, plain)


def _feasibility(
    blocks: list[Block], regressor: BaseRegressor, estimate: LeastSquaresResult
) -> FeasibilityAnswer | None:
    """Can a robot have these base parameters, asked on the fitted motion; None if the program has no answer."""
    states = states_of([block.signals for block in blocks])
    try:
        return nearest_physical(estimate.values, regressor, states, std=estimate.std)
    except (SolverError, UndeterminedParametersError):
        return None


def states_of(stretches: Sequence[ProcessedSignals]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities, accelerations (S, n) of some stretches, at most MOST_STATES, spread evenly."""
    q, dq, ddq = (
        np.concatenate([getattr(item, name) for item in stretches]) for name in ("position", "velocity", "acceleration")
    )
    chosen = evenly(len(q), MOST_STATES)
    return q[chosen], dq[chosen], ddq[chosen]


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
    raise RecordingError.named(
        path,
        f"the torque has the opposite sign of the inverse dynamics: as it stands, inertia or "
        f"friction of joint {joints} would be negative{gravity}. Turn it with --flip-torque, of `fit` or of `import`",
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
