"""From Python: `import identification as ident`, then from a recording to parameters, a check and a diagnosis.

Here: five functions with the defaults of the commands of the same name, and value objects that print as tables, in a
notebook too. Not here: any computation. Nothing is printed and nothing is written unless `save` is called.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from identification.audit.between import model_of_fit
from identification.audit.mount import notes_on_another_set_up, require_stated_stand
from identification.errors import DesignError, ModelFileError, RecordingError
from identification.excitation.design import DesignResult
from identification.excitation.design import design_excitation as search_excitation
from identification.excitation.limits import limits_of_robot
from identification.excitation.local_search import DesignSettings
from identification.excitation.nominal import nominal_parameters
from identification.fitting.misfit import notes_on_models_contradicted
from identification.fitting.result import FitResult
from identification.fitting.rms import RmsTable
from identification.fitting.settings import FitSettings
from identification.mismatch.diagnosis import diagnose as diagnose_recordings
from identification.mismatch.extended_model import extended_model
from identification.mismatch.findings import Diagnosis
from identification.mismatch.prediction import validate_with_effects
from identification.mismatch.settings import DiagnosisSettings
from identification.model_file import Model, no_check, read_model, write_model
from identification.printing import Printed, Table
from identification.recording_fit import fit_recordings
from identification.recordings.independence import seen_among
from identification.recordings.reader import Inputs, inputs_of, read_recording
from identification.recordings.recording import Recording
from identification.recordings.units import check_units
from identification.report.diagnosis_sections import verdict_sentence
from identification.robots import RobotModel, load_robot
from identification.robots.installation import ON_THE_FLOOR
from identification.validation import validate_model
from identification.whole_file import write_whole

__all__ = [
    "Answer",
    "Excitation",
    "Fit",
    "Table",
    "Validation",
    "design_excitation",
    "diagnose",
    "fit",
    "read_recording",
    "validate",
]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

Source = Recording | str | Path
"""A recording, or the path of one: .mcap, .npz, .csv, .db3, the folder of a run or of a ROS 2 bag."""


@dataclass(frozen=True, slots=True, repr=False)
class Fit(Printed):
    """A fitted model. result: everything that the fit hands back (`identification.fitting.result`)."""

    result: FitResult

    @property
    def table(self) -> Table:
        """Base parameters with σ, as Table 2 of the paper."""
        result = self.result
        rows = tuple(
            (name, f"{value:z.5f}", f"{std:.5f}", unit)
            for name, value, std, unit in zip(
                result.names, result.values, result.std, result.regressor.units, strict=True
            )
        )
        return Table(("parameter", "value", "σ", "unit"), rows, (result.misfit.sentence, *result.notes))

    @property
    def rms(self) -> Validation:
        """RMS per joint on the rows that were fitted and on those that were held out."""
        return Validation(self.result.rms, (), notes_on_models_contradicted(self.result.rms))

    def save(self, path: str | Path) -> Path:
        """Write it as model.json, which every command reads. Raises OSError."""
        return write_model(self.result.to_model_json(), path)


@dataclass(frozen=True, slots=True, repr=False)
class Validation(Printed):
    """RMS of measured minus modelled torque, as Table 4 of the paper. result: the numbers.

    fitted_to: names of those recordings that the model was fitted to, as far as it is known: they are no check of it.
    notes: warnings of recordings that contradict the model.
    """

    result: RmsTable
    fitted_to: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def table(self) -> Table:
        """One line per set of parameters and recording, one column per joint (Nm; N of a prismatic joint)."""
        lines = self.result.rows
        joints = len(lines[0].rms_nm) if lines else 0
        rows = tuple((line.label, *(f"{x:.4f}" for x in line.rms_nm), f"{line.total_nm:.4f}") for line in lines)
        said = (*map(no_check, self.fitted_to), *self.notes)
        return Table(("RMS", *(f"joint {joint}" for joint in range(1, joints + 1)), "sum"), rows, said)


@dataclass(frozen=True, slots=True, repr=False)
class Answer(Printed):
    """A diagnosis. result: all that it says (`identification.mismatch.findings`). fitted: what it was made of."""

    result: Diagnosis
    fitted: Inputs

    @property
    def verdict(self) -> str:
        """no_mismatch, explained, partly_explained, unexplained or undecided."""
        return self.result.verdict

    @property
    def table(self) -> Table:
        """The verdict and each finding as a sentence; RMS per joint before and after, and of the noise."""
        result = self.result
        lines = {
            "before": result.baseline.rms_nm,
            "after": result.rms_after_nm,
            "noise": result.baseline.noise_floor_nm,
        }
        joints = len(result.baseline.rms_nm)
        rows = tuple((name, *(f"{x:.4f}" for x in values)) for name, values in lines.items() if len(values))
        said = (
            *(() if result.model_comparison is None else result.model_comparison.no_check),
            verdict_sentence(result),
            *(fault.sentence for fault in result.data_faults),
            *(finding.sentence for finding in result.findings),
            *(claim.sentence for claim in result.unnamed),
            result.remaining,
        )
        head = (f"RMS, {self.fitted.robot.torque_unit}", *(f"joint {joint}" for joint in range(1, joints + 1)))
        return Table(head, rows, tuple(filter(None, said)))

    def save_model(self, path: str | Path) -> Path:
        """Write the model with what was found in it. Raises OSError."""
        return write_model(extended_model(self.result, self.fitted.recordings, self.fitted.robot), path)


@dataclass(frozen=True, slots=True, repr=False)
class Excitation(Printed):
    """A motion. result: its figures and how it was found."""

    result: DesignResult

    @property
    def table(self) -> Table:
        """What its base regressor tells, and how near each joint comes to its limits at 1 kHz, in percent of them."""
        verified = self.result.verified
        names = ("position", "velocity", "acceleration", "torque", "paper")
        shares = {name: verified[name] for name in names if name in verified}
        # A joint that moves has more than 0 % of any limit that there is.
        rows = tuple(
            (name, *(f"{100.0 * share:.1f}" if share else "no limit" for share in joints))
            for name, joints in shares.items()
        )
        joints = range(1, len(verified["paper"]) + 1)
        true, paper = ("yes" if verified[f"within_{which}limits"] else "NO" for which in ("", "paper_"))
        said = (
            f"cond(Y_b) = {self.result.cond:.2f}, log det(Y_b' Y_b) = {self.result.log_det:.1f}.",
            f"Inside the limits of the arm: {true}; inside (14) of the paper, at rest at the start: {paper}.",
        )
        return Table(("% of the limit, 1 kHz", *(f"joint {joint}" for joint in joints)), rows, said)

    def save(self, path: str | Path) -> Path:
        """Write the trajectory, for `iiwa-ident check` and `run`. Raises OSError."""
        path = Path(path)
        write_whole(path, json.dumps(self.result.trajectory.to_json(), indent=1, allow_nan=False) + "\n")
        return path


def _on_one_thread(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """The same with BLAS on one thread while it runs, and as it was afterwards.

    Matrices here are small: a second thread gains nothing, and where another program keeps the cores busy the threads
    wait for each other. A diagnosis of 19 s has taken over ten minutes.
    """

    @wraps(function)
    def limited(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*arguments, **named)

    return limited


@_on_one_thread
def fit(*recordings: Source, robot: str | Path | None = None, **settings: Any) -> Fit:
    """Identify a robot from one or several recordings together, as `iiwa-ident fit`.

    robot: iiwa14, iiwa7, a URDF or an MDH table, over what the recordings name. settings: fields of `FitSettings`, such
    as split="first:0.6". Raises RecordingError, RobotError and EstimationError; each says what to do.
    """
    inputs = _read(recordings, robot)
    require_stated_stand(inputs.recordings, inputs.robot)
    return Fit(fit_recordings(inputs.recordings, inputs.robot, FitSettings(**settings)))


@_on_one_thread
def validate(model: Fit | Model | str | Path, *recordings: Source) -> Validation:
    """RMS per joint of a model on recordings it was not fitted to, its effects included.

    Raises ModelFileError if the model is of another robot, RecordingError if a recording cannot be used.
    """
    if isinstance(model, (str, Path)):
        model = read_model(model)
    if not isinstance(model, (Fit, Model)):
        raise ModelFileError("The model comes first, a fit or the path of its file: validate(model, recording)")
    if isinstance(model, Fit):
        read = _read(recordings, None, model.result.robot).recordings
        result, same = validate_model(model.result, read), seen_among(model.result.recordings, read)
        return Validation(result, same, notes_on_another_set_up(result, read, model.result.robot))
    robot = model.load_robot()
    read = _read(recordings, None, robot).recordings
    result = validate_with_effects(model, read)
    return Validation(result, model.fitted_among(read), notes_on_another_set_up(result, read, robot))


@_on_one_thread
def diagnose(
    *recordings: Source,
    heldout: Source | Sequence[Source] = (),
    robot: str | Path | None = None,
    model: Fit | Model | str | Path | None = None,
    **settings: Any,
) -> Answer:
    """Locate what the model leaves out, name it, and check it on `heldout`, as `iiwa-ident diagnose`.

    model: a fit, a model.json or a simulator's file to diagnose against, None for a nominal fit. settings: fields of
    `DiagnosisSettings`. Raises what `fit` raises, and ModelFileError.
    """
    if isinstance(model, Fit):
        model = model_of_fit(model.result, "the fit")
    given = Path(model) if isinstance(model, str) else model
    if not isinstance(given, (Model, Path, type(None))):
        raise ModelFileError(f"The model is a fit or the path of its file, no {type(model).__name__}")
    if isinstance(given, Path) and given.suffix == ".json":
        given = read_model(given)
    of_model = given.load_robot() if isinstance(given, Model) and robot is None else None
    others = tuple(heldout) if isinstance(heldout, Sequence) and not isinstance(heldout, str) else (heldout,)
    inputs = _read((*recordings, *others), robot, of_model)
    if given is None:
        require_stated_stand(inputs.recordings, inputs.robot)
    fitted, unseen = inputs.recordings[: len(recordings)], inputs.recordings[len(recordings) :]
    found = diagnose_recordings(
        fitted, inputs.robot, heldout=unseen, settings=DiagnosisSettings(**settings), model=given
    )
    return Answer(found, Inputs(fitted, found.standing(inputs.robot)))


@_on_one_thread
def design_excitation(
    robot: str | Path = "iiwa14", *, seed: int = 0, clock: Callable[[], float] | None = None, **settings: Any
) -> Excitation:
    """Search a motion that shows the parameters, inside the limits of the arm. settings: fields of `DesignSettings`,
    such as starts: so many, on two processes, decide how long it takes. clock: of seconds, such as time.monotonic, by
    which budget_s ends it.

    Distances to floor, walls and the arm itself are not looked at here: `iiwa-ident check` does before anything moves.
    Raises DesignError.
    """
    arm = load_robot(robot, ON_THE_FLOOR)
    wanted = DesignSettings(seed=seed, **settings)
    if wanted.budget_s is not None and clock is None:
        raise DesignError("budget_s is counted by a clock: give clock=time.monotonic with it, or starts in its place.")
    nominal = nominal_parameters(arm, None)
    return Excitation(search_excitation(arm, limits_of_robot(arm), wanted, clock=clock, nominal=nominal))


def _read(sources: Sequence[Source], robot: str | Path | None, of_model: RobotModel | None = None) -> Inputs:
    """The recordings and their robot: the one given, else the model's, else the one that all recordings name."""
    if not sources:
        raise RecordingError("No recording was given")
    if not all(isinstance(item, (Recording, str, Path)) for item in sources):
        raise RecordingError("Recordings are given one after the other, not in a list: fit(first, second)")
    read = [
        item if isinstance(item, Recording) else read_recording(item, robot=robot, model_robot=of_model)
        for item in sources
    ]
    inputs = inputs_of(read, robot=robot, model_robot=of_model)
    return Inputs(tuple(_judged(item, inputs.robot) for item in inputs.recordings), inputs.robot)


def _judged(recording: Recording, robot: RobotModel) -> Recording:
    """As where a file is read: who makes a recording by hand, or takes rows of one, may have degrees."""
    path, step = recording.source.path, recording.sampling_period_s
    if recording.samples < 2:
        raise RecordingError.named(path, "holds no motion: it has no rows, or one")
    rows = float(np.median(np.diff(recording.time)))
    if not 0.5 < step / rows < 2.0:
        raise RecordingError.named(
            path, f"sampling_period_s is {step:.4g} s, and its rows are {rows:.4g} s apart", field="sampling_period_s"
        )
    return check_units(recording, robot)
