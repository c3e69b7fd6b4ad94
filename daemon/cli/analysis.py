"""Commands that work on recordings: `fit`, `validate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from daemon.cli.app import app
from daemon.cli.inputs import JointsOption, LogsArgument, ModelArgument, RecordedArm, RobotOption, as_usage
from daemon.cli.option_groups import grouped
from daemon.cli.output import JsonOption, data, data_lines, message, show_table, told_in_words
from daemon.cli.progress import progress_shown
from daemon.cli.protection import in_its_folder, not_a_recording
from daemon.cli.rms_view import show_rms
from identification.fitting.choices import Choice, DelayCorrection, Estimator, Pipeline

if TYPE_CHECKING:
    from identification.recording_fit import FitResult


@app.command()
@grouped
def fit(
    logs: LogsArgument,
    arm: RecordedArm,
    pipeline: Annotated[Pipeline, typer.Option("--pipeline", help="How the signals are processed.")] = "auto",
    low_pass: Annotated[float | None, typer.Option("--low-pass", help="Cutoff without periods, Hz.")] = None,
    hold_out: Annotated[
        str | None,
        typer.Option("--hold-out", help="first:0.6 = fit the first 60 %; blocks:0.5:3 = hold out each third 0.5 s."),
    ] = None,
    estimator: Annotated[Estimator, typer.Option("--estimator", help="How parameters are estimated.")] = "auto",
    delay_correction: Annotated[
        DelayCorrection, typer.Option("--delay-correction", help="Shift the torque by its delay.")
    ] = "no",
    rotor_inertia: Annotated[Choice, typer.Option("--rotor-inertia", help="One parameter more per joint.")] = "auto",
    offset: Annotated[Choice, typer.Option("--offset", help="Constant torque per joint.")] = "auto",
    flip_torque: Annotated[bool, typer.Option("--flip-torque", help="Turn the sign of all torques first.")] = False,
    bounds: Annotated[
        Path | None,
        typer.Option("--bounds", help="Bounds (10b) by name, YAML or JSON, e.g. {mass: [0.5, 8], viscous: [0, 2]}."),
    ] = None,
    full_consistency: Annotated[
        bool, typer.Option("--full-consistency", help="Program (10) with pseudo-inertias positive semidefinite too.")
    ] = False,
    no_physical: Annotated[bool, typer.Option("--no-physical", help="Base parameters only.")] = False,
    folds: Annotated[
        int | None,
        typer.Option("--folds", min=2, help="Also score each recording by fits without it, in so many groups."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the constrained program's starts.")] = 20240607,
    out: Annotated[
        Path | None, typer.Option("--out", help="Model to write; default: beside the log.", callback=not_a_recording)
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Page to write: figures and tables, HTML.", callback=not_a_recording)
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Both solvers on one or several recordings: parameters with σ, RMS per joint, certificate of feasibility.

    Example: iiwa-ident fit runs/first/recording.mcap --out model.json
    """
    from identification.errors import EstimationError
    from identification.model_file import write_model
    from identification.recording_fit import FitSettings, fit_recordings
    from identification.recordings.reader import recording_file

    limits = None if bounds is None else read_bounds(bounds)
    with as_usage(EstimationError):
        settings = FitSettings(
            pipeline=pipeline,
            low_pass_hz=low_pass,
            split=hold_out,
            estimator=estimator,
            delay_correction=delay_correction,
            rotor_inertia=rotor_inertia,
            offset=offset,
            flip_torque=flip_torque,
            physical=not no_physical,
            bounds=limits,
            full_consistency=full_consistency,
            seed=seed,
        )
    inputs = arm.load(logs, fits=True)
    recordings, robot_model = inputs.recordings, inputs.robot

    left_out = None
    if folds is not None:
        from identification.validation import cross_validate

        with progress_shown() as show:
            left_out = cross_validate(recordings, robot_model, settings, folds, progress=show)
    with progress_shown() as show:
        result = fit_recordings(recordings, robot_model, settings, progress=show)
    model = result.to_model_json()
    if left_out is not None:
        model["left_out"] = left_out.to_json()
    target = out or recording_file(logs[0]).with_name("model.json")
    write_model(model, in_its_folder(target))
    if report is not None:
        from identification.report import write_report

        write_report(report, fit=result, model=model)
    if told_in_words(model, json_file):
        show_fit(result)
        if left_out is not None:
            title = f"RMS on recordings that the fit had not seen, {folds} folds"
            show_rms(left_out, title, unit=robot_model.torque_unit)
        data(f"Model written to {target}" + ("" if report is None else f", report to {report}"))


def read_bounds(file: Path) -> dict[str, Any]:
    """Bounds of program (10) from a YAML or JSON file. Raises ConfigurationError for one that holds none."""
    import yaml

    from daemon.errors import ConfigurationError
    from identification.errors import EstimationError
    from identification.estimators.feasibility import FeasibilityRules

    try:
        bounds = yaml.safe_load(file.read_text(encoding="utf-8"))
        if not isinstance(bounds, dict):
            raise ConfigurationError("holds no names with bounds, such as 'mass: [0.5, 8]'.", file=str(file))
        FeasibilityRules().with_bounds(bounds)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = f"is neither YAML nor JSON ({' '.join(str(error).split())})."
        raise ConfigurationError(reason, file=str(file)) from error
    except EstimationError as error:
        raise ConfigurationError(f"{error}.", file=str(file)) from error
    return bounds


def show_fit(result: FitResult) -> None:
    """Parameters, RMS and certificate of a fit on stdout."""
    from identification.robots.joint_units import in_units

    units = result.robot.units
    show_parameters(result)
    data(
        f"σ: of the estimator {result.estimator}, with the noise as measured, coloured; beside it the paper's eq. (15) "
        "of the unweighted fit, which takes all residuals as white and alike."
    )
    show_rms(result.rms, "RMS of measured minus modelled torque per joint", unit=result.robot.torque_unit)
    data(result.misfit.sentence)
    if result.constrained is not None:
        show_certificate(result.to_model_json()["certificate"])
    if result.feasibility is not None:
        data(in_units(result.feasibility.sentence(), units))
    data(in_units(result.torque_delay.sentence(), units))
    data_lines(f"note: {in_units(note, units)}" for note in result.notes)


def show_parameters(result: FitResult) -> None:
    """Print base parameters with σ of this fit, σ of eq. (15), and the values of the feasible set."""
    rows = []
    feasible = result.constrained.base_values if result.constrained is not None else None
    for i, name in enumerate(result.names):
        value, std = float(result.values[i]), float(result.std[i])
        rows.append((
            name, f"{value:z.5f}", f"{std:.5f}", f"{100 * std / abs(value):.2f}" if value else "",
            f"{float(result.equation_15_std[i]):.5f}", "" if feasible is None else f"{float(feasible[i]):z.5f}",
            result.regressor.units[i],
        ))  # fmt: skip
    show_table(("parameter", "value", "σ", "σ in %", "σ, eq. (15)", "feasible", "unit"), rows)


def show_certificate(certificate: dict[str, Any]) -> None:
    """What is proven about the feasible set, in sentences."""
    cost, least_squares = certificate["cost"], certificate["least_squares_cost"]
    data(
        f"Feasible set: (10b-d) {'hold exactly' if certificate['feasible'] else 'are VIOLATED'}; its cost is "
        f"{cost / least_squares:.6f} times the least-squares cost, at least "
        f"{certificate['lower_bound'] / least_squares:.6f} is proven necessary for these constraints; "
        f"{'fully physically consistent' if certificate['fully_consistent'] else 'not fully physically consistent'} "
        f"(smallest pseudo-inertia eigenvalue {certificate['smallest_pseudo_inertia_eigenvalue']:.2g})."
    )


@app.command()
def validate(
    model_file: ModelArgument,
    logs: LogsArgument,
    robot: RobotOption = None,
    joints: JointsOption = None,
    json_file: JsonOption = None,
) -> None:
    """RMS per joint of a model on recordings it was not fitted to, its effects included.

    Example: iiwa-ident validate model.json runs/other/recording.mcap
    """
    from identification.audit.mount import notes_on_another_set_up
    from identification.mismatch.prediction import validate_with_effects
    from identification.model_file import no_check, read_model

    model = read_model(model_file)
    arm = model.load_robot()
    recordings = RecordedArm(robot, joints).load(logs, model_robot=arm).recordings
    table = validate_with_effects(model, recordings)
    same = model.fitted_among(recordings)
    own = tuple(f"{name}, " for name in same)
    rows = [{**row, "same_recording": row["label"].startswith(own)} for row in table.to_json()]
    in_words = told_in_words(rows, json_file)
    say = data if in_words else message
    for sentence in (*map(no_check, same), *notes_on_another_set_up(table, recordings, arm)):
        say(sentence)
    if in_words:
        show_rms(table, "RMS of measured minus modelled torque per joint", unit=arm.torque_unit)
