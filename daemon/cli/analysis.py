"""Commands that work on files: `design`, `import`, `fit`, `validate`."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.table import Table

from daemon.cli.app import app
from daemon.cli.output import JsonOption, data, message, show_table, wants_json_on_stdout, write_json
from identification.fit import FitResult, FitSettings, fit_recordings
from identification.recordings import Recording, read_recording, write_recording
from identification.recordings.reader import robot_of
from identification.robots import BUILT_IN_ROBOTS, RobotModel, load_robot

if TYPE_CHECKING:
    from identification.excitation import PredictedDeviations, Trajectory

LogsArgument = Annotated[list[Path], typer.Argument(help="Recordings: .mcap, .npz or .csv.")]
RobotOption = Annotated[str | None, typer.Option("--robot", help="iiwa14, iiwa7, a URDF or an MDH table (CSV).")]


def load_recordings(logs: list[Path], robot: str | None) -> list[Recording]:
    """Read all logs and say on stderr what was found wrong in each."""
    recordings = []
    for log in logs:
        recording = read_recording(log, robot=robot)
        for finding in recording.report.findings:
            message(f"{log}: {finding.sentence}")
        recordings.append(recording)
    return recordings


@app.command("import")
def import_recording(
    files: Annotated[list[Path], typer.Argument(help="Recordings of others: .npz, .csv or ROS 2 .mcap.")],
    robot: RobotOption = None,
    out: Annotated[Path | None, typer.Option("--out", help="Log to write (one file only); default: FILE.mcap.")] = None,
    json_file: JsonOption = None,
) -> None:
    """Bring recordings made by others into this project's log, and report gaps, jitter, repeated and garbled rows.

    Example: iiwa-ident import measured.npz --robot arm.urdf --out measured.mcap
    """
    if out is not None and len(files) > 1:
        raise typer.BadParameter("--out takes one FILE; several files get a name of their own each.")
    results = []
    for file in files:
        target = out or file.with_suffix(".imported.mcap" if file.suffix == ".mcap" else ".mcap")
        recording = read_recording(file, robot=robot)
        if target.resolve() == file.resolve():
            raise typer.BadParameter(f"{file} would overwrite itself; give another name with --out.")
        write_recording(recording, target)
        results.append({"file": str(file), "log": str(target), **recording.report.to_json()})
        if not wants_json_on_stdout(json_file):
            data(
                f"{file}: {recording.samples} samples of {recording.n} joints, {recording.duration_s:.3f} s, "
                f"written to {target}"
            )
            for finding in recording.report.findings:
                data(f"  {finding.sentence}")
    if json_file is not None:
        write_json(json_file, results)


@app.command()
def fit(
    logs: LogsArgument,
    robot: RobotOption = None,
    pipeline: Annotated[str, typer.Option("--pipeline", help="auto, periodic, paper or aperiodic.")] = "auto",
    low_pass: Annotated[float | None, typer.Option("--low-pass", help="Cutoff without periods, Hz.")] = None,
    hold_out: Annotated[
        str | None,
        typer.Option("--hold-out", help="first:0.6 = fit the first 60 %; blocks:0.5:3 = hold out each third 0.5 s."),
    ] = None,
    estimator: Annotated[
        str,
        typer.Option("--estimator", help="auto, ols, weighted, maximum_likelihood, huber or instrumental."),
    ] = "auto",
    delay_correction: Annotated[
        str, typer.Option("--delay-correction", help="Shift the torque by its delay: no, common or per_joint.")
    ] = "no",
    rotor_inertia: Annotated[str, typer.Option("--rotor-inertia", help="auto, yes or no.")] = "auto",
    offset: Annotated[str, typer.Option("--offset", help="Constant torque per joint: auto, yes or no.")] = "auto",
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
    seed: Annotated[int, typer.Option("--seed", help="Of the constrained program's starts.")] = 20240607,
    out: Annotated[Path | None, typer.Option("--out", help="Model to write; default: beside the log.")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Page to write: figures and tables, HTML.")] = None,
    json_file: JsonOption = None,
) -> None:
    """Both solvers on one or several recordings: parameters with σ, RMS per joint, certificate of feasibility.

    Example: iiwa-ident fit runs/first/recording.mcap --out model.json
    """
    settings = FitSettings(
        pipeline=pipeline,  # type: ignore[arg-type]  # FitSettings refuses other texts with a sentence
        low_pass_hz=low_pass,
        split=hold_out,
        estimator=estimator,  # type: ignore[arg-type]
        delay_correction=delay_correction,  # type: ignore[arg-type]
        rotor_inertia=rotor_inertia,  # type: ignore[arg-type]
        offset=offset,  # type: ignore[arg-type]
        flip_torque=flip_torque,
        physical=not no_physical,
        bounds=None if bounds is None else read_bounds(bounds),
        full_consistency=full_consistency,
        seed=seed,
    )
    recordings = load_recordings(logs, robot)
    robot_model = load_robot(robot or robot_of(recordings))

    def show(phase: str, share: float) -> None:
        message(f"[{100 * share:3.0f} %] {phase}")

    left_out = None
    if folds is not None:
        from identification.validation import cross_validate

        left_out = cross_validate(recordings, robot_model, settings, folds, progress=show)
    result = fit_recordings(recordings, robot_model, settings, progress=show)
    model = result.to_model_json()
    if left_out is not None:
        model["left_out"] = left_out.to_json()
    target = out or logs[0].with_name("model.json")
    target.write_text(json.dumps(model, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if report is not None:
        from identification.report import write_report

        write_report(report, fit=result, model=model)
    if json_file is not None:
        write_json(json_file, model)
    if not wants_json_on_stdout(json_file):
        show_fit(result)
        if left_out is not None:
            data(f"RMS on recordings that the fit had not seen, {folds} folds, Nm:")
            data(left_out.text())
        data(f"Model written to {target}" + ("" if report is None else f", report to {report}"))


def read_bounds(file: Path) -> dict[str, Any]:
    """Bounds of program (10) from a YAML or JSON file; names and numbers are judged by the fit."""
    import yaml

    try:
        bounds = yaml.safe_load(file.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise typer.BadParameter(f"{file} is neither YAML nor JSON: {error}") from error
    if not isinstance(bounds, dict):
        raise typer.BadParameter(f"{file} holds no names with bounds, such as 'mass: [0.5, 8]'.")
    return bounds


def show_fit(result: FitResult) -> None:
    """Parameters, RMS and certificate of a fit on stdout."""
    show_table(parameter_table(result))
    data(
        f"σ: of the estimator {result.estimator}, with the noise as measured, coloured; beside it the paper's eq. (15) "
        "of the unweighted fit, which takes all residuals as white and alike."
    )
    data("RMS of measured minus modelled torque per joint, Nm:")
    data(result.rms.text())
    data("the same in % of the RMS torque:")
    data(result.rms.text(percent=True))
    if result.constrained is not None:
        show_certificate(result.to_model_json()["certificate"])
    if result.feasibility is not None:
        data(result.feasibility.sentence())
    data(result.torque_delay.sentence())
    for note in result.notes:
        data(f"note: {note}")


def parameter_table(result: FitResult) -> Table:
    """Base parameters with σ of this fit, σ of eq. (15), and the values of the feasible set."""
    table = Table("parameter", "value", "σ", "σ in %", "σ, eq. (15)", "feasible", "unit")
    feasible = result.constrained.base_values if result.constrained is not None else None
    for i, name in enumerate(result.names):
        value, std = float(result.values[i]), float(result.std[i])
        table.add_row(
            name,
            f"{value:.5f}",
            f"{std:.5f}",
            f"{100 * std / abs(value):.2f}" if value else "",
            f"{float(result.equation_15_std[i]):.5f}",
            "" if feasible is None else f"{float(feasible[i]):.5f}",
            result.regressor.units[i],
        )
    return table


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
    model_file: Annotated[Path, typer.Argument(metavar="MODEL.json", help="A model written by fit.")],
    logs: LogsArgument,
    robot: RobotOption = None,
    json_file: JsonOption = None,
) -> None:
    """RMS per joint of a model on recordings it was not fitted to, its effects included.

    Example: iiwa-ident validate model.json runs/other/recording.mcap
    """
    from identification.mismatch.prediction import validate_with_effects
    from identification.model_file import read_model

    table = validate_with_effects(read_model(model_file), load_recordings(logs, robot))
    if json_file is not None:
        write_json(json_file, table.to_json())
    if not wants_json_on_stdout(json_file):
        data("RMS of measured minus modelled torque per joint, Nm:")
        data(table.text())
        data("the same in % of the RMS torque:")
        data(table.text(percent=True))


@app.command()
def design(
    objective: Annotated[str, typer.Option("--objective", help="cond, d, a, or a mix: cond:1,d:2.")] = "cond",
    harmonics: Annotated[int, typer.Option("--harmonics", min=3)] = 5,
    period: Annotated[float, typer.Option("--period", help="Seconds.")] = 10.0,
    limits: Annotated[str, typer.Option("--limits", help="paper: (14c-g); true: |q|, |dq|, |ddq|.")] = "paper",
    robot: Annotated[str, typer.Option("--robot", help="iiwa14, iiwa7 or a URDF with limits.")] = "iiwa14",
    seed: Annotated[int, typer.Option("--seed")] = 0,
    budget: Annotated[float | None, typer.Option("--budget", help="Seconds; without one, all starts.")] = 170.0,
    table: Annotated[bool, typer.Option("--table", help="Also write the 1 kHz table into the file.")] = False,
    periods: Annotated[int, typer.Option("--periods", min=1, help="Periods of the run that σ is predicted for.")] = 16,
    noise: Annotated[
        str | None, typer.Option("--noise", help="Torque noise of each joint, Nm per sample at 1 kHz: 0.17,0.17,…")
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(
            "--reference",
            help="Instead, a motion to score models on: excitation, sine_series, polynomial_10 or polynomial_20.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Trajectory to write; default: excitation.json.")] = None,
    json_file: JsonOption = None,
) -> None:
    """Design an excitation trajectory, the problem (13)/(14) of the paper, from many seeded starts.

    Example: iiwa-ident design --objective cond --seed 1 --budget 120 --out excitation.json
    """
    from daemon.preparation import is_safe_motion
    from identification.excitation import (
        DesignProgress,
        DesignSettings,
        design_excitation,
        limits_of_robot,
        reference_trajectory,
    )

    def show(step: DesignProgress) -> None:
        message(f"stage {step.stage}/{step.stages}, search {step.done}/{step.planned}: best {step.best:.2f}")

    model = load_robot(robot)
    # Only the built-in arms have a geometry to check self-collision and workspace on.
    acceptable = is_safe_motion if model.name in BUILT_IN_ROBOTS else None
    target = out or Path("excitation.json" if reference is None else f"{reference}.json")
    if reference is not None:
        motion = reference_trajectory(
            reference,  # type: ignore[arg-type]  # refused with a sentence
            limits_of_robot(model),
            seed,
            robot=model,
            acceptable=acceptable,
        )
        document = motion.to_json(table_rate_hz=1000.0 if table else None)
        target.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        if json_file is not None:
            write_json(json_file, document)
        if not wants_json_on_stdout(json_file):
            data(f"Reference motion '{reference}' of {motion.period_s:g} s for {model.name} written to {target}")
        return
    settings = DesignSettings(
        objective=objective,
        harmonics=harmonics,
        period_s=period,
        limits=limits,  # type: ignore[arg-type]  # DesignSettings refuses other texts with a sentence
        seed=seed,
        budget_s=budget,
    )
    result = design_excitation(
        model,
        limits_of_robot(model),
        settings,
        progress=show,
        clock=time.monotonic,
        acceptable=acceptable,
    )
    document = result.trajectory.to_json(table_rate_hz=1000.0 if table else None)
    target.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    predicted = _predicted(model, result.trajectory, noise, periods)
    if json_file is not None:
        rows = [] if predicted is None else zip(predicted.names, predicted.std.tolist(), predicted.units, strict=True)
        promised = [{"name": name, "std": std, "unit": unit} for name, std, unit in rows]
        write_json(json_file, {**document, "predicted_std": promised})
    if not wants_json_on_stdout(json_file):
        data(f"cond(Y_b) = {result.cond:.2f}, log det(Y_b' Y_b) = {result.log_det:.1f}; written to {target}")
        for key, value in result.verified.items():
            data(f"  {key}: {value}")
        if predicted is None:
            data("No σ is predicted: state the torque noise of each joint with --noise.")
            return
        data(f"σ that {periods} periods will give, torque noise {', '.join(f'{x:g}' for x in predicted.noise_nm)} Nm:")
        for name, std, unit in zip(predicted.names, predicted.std, predicted.units, strict=True):
            data(f"  {name:<8} {std:.2g} {unit}")


def _predicted(
    model: RobotModel, trajectory: Trajectory, noise: str | None, periods: int
) -> PredictedDeviations | None:
    """σ before the motion; None where no noise is known for this robot. Raises DesignError for a noise that is none."""
    from identification.base_parameters import BaseRegressor
    from identification.errors import DesignError
    from identification.excitation import predict_deviations

    if noise is None and model.name not in BUILT_IN_ROBOTS:
        return None
    try:
        values = None if noise is None else np.array([float(part) for part in noise.split(",")])
    except ValueError as error:
        raise DesignError(f"--noise '{noise}' is no list of numbers such as 0.17,0.17,0.12") from error
    return predict_deviations(BaseRegressor(model), trajectory, noise_nm=values, periods=periods)
