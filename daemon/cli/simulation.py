"""Commands that take an identified model into simulators, and into our own: `export`, `simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer

from daemon.cli.app import app
from daemon.cli.inputs import ModelArgument, RecordedArm, as_usage
from daemon.cli.output import JsonOption, data, data_lines, message, show_table, told_in_words
from daemon.cli.protection import in_its_folder, is_recording, not_a_recording
from daemon.cli.rms_view import show_rms

if TYPE_CHECKING:
    from identification.export.write import ExportResult
    from identification.model_file import Model

ParametersOption = Annotated[
    Literal["consistent", "physical"],
    typer.Option("--parameters", help="consistent: bodies that exist; physical: the set of program (10)."),
]
MotorInertiaOption = Annotated[
    bool, typer.Option("--motor-inertia", help="Add a prior of motor inertias, for stiff controllers.")
]
_BADLY_FOLLOWED = 0.02
"""rad (m) RMS between simulated and commanded position."""
_EFFECT_STEP_S = 0.001
_FIGURE_SUFFIXES = (".svg", ".png", ".pdf")


@app.command()
def export(
    model_file: ModelArgument,
    form: Annotated[Literal["urdf", "sdf", "mjcf"], typer.Option("--format", help="Which simulator's.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="File to write.", callback=not_a_recording)],
    parameters: ParametersOption = "consistent",
    prior: Annotated[
        Path | None,
        typer.Option(
            "--prior", metavar="FILE.urdf", help="Where the data leave directions open: its bodies, not uniform ones."
        ),
    ] = None,
    motor_inertia: MotorInertiaOption = False,
    json_file: JsonOption = None,
) -> None:
    """Write a simulator model of the identified arm and check it by reading it back.

    What the data leave open goes to uniform bodies, or to those of --prior; the file's head says so per parameter.

    Example: iiwa-ident export model.json --format mjcf --out arm.xml
    """
    from identification.export.write import export_model
    from identification.model_file import read_model
    from identification.robots.joint_units import in_units

    model = read_model(model_file)
    added = motor_prior(model, parameters) if motor_inertia else None
    result = export_model(model, out, form, parameter_set=parameters, prior=prior, motor_inertia=added)
    written = {
        "file": str(result.path),
        "format": form,
        "parameters": parameters,
        "read_back": read_back(result),
        "notes": list(result.notes),
        "origins": None if result.origins is None else result.origins.to_json(),
        "effects_file": None if result.effects_path is None else str(result.effects_path),
    }
    if not told_in_words(written, json_file):
        return
    data(f"Written to {result.path}")
    data_lines(in_units(agreement.sentence(), model.load_robot().units) for agreement in result.agreements)
    if result.origins is not None:
        data_lines(result.origins.sentences())
    data_lines(f"note: {note}" for note in result.notes)
    if result.effects_path is not None:
        data(f"Effects that no simulator model holds are in {result.effects_path}")


def motor_prior(model: Model, parameters: str) -> np.ndarray:
    """(n,) kg m² that the prior of motor inertias adds to a model's parameter set; where they are from is said."""
    from identification.export.effects import with_found_rotors
    from identification.export.parameters import parameters_of
    from identification.simulation.motor_inertia import motor_inertia_of

    identified = with_found_rotors(parameters_of(model, parameters), model)
    values, sentence = motor_inertia_of(model.load_robot(), identified)
    message(sentence)
    return values - identified.rotor_inertia


def read_back(result: ExportResult) -> list[dict[str, Any]]:
    """What other programs read from an exported file, as plain JSON types."""
    return [
        {"program": item.program, "terms": item.covers, "difference_nm": item.difference_nm}
        for item in result.agreements
    ]


@app.command()
def simulate(
    model_file: ModelArgument,
    motion: Annotated[
        Path | None, typer.Argument(metavar="[TRAJECTORY|LOG]", help="What to follow; default: the shipped excitation.")
    ] = None,
    controller: Annotated[
        Literal["computed_torque", "position", "impedance"],
        typer.Option("--controller", help="computed_torque is the paper's."),
    ] = "computed_torque",
    bandwidth: Annotated[
        float | None, typer.Option("--bandwidth", help="Hz, critically damped; default: 10 (position: 8).")
    ] = None,
    stiffness: Annotated[float | None, typer.Option("--stiffness", help="Of impedance, Nm/rad; default 300.")] = None,
    parameters: ParametersOption = "physical",
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Fig. 4 of the paper: .svg, .png or .pdf.", callback=not_a_recording)
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Series of motion and torque: .npz or .csv.", callback=not_a_recording)
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Move the identified arm under a controller and compare motion and torque with the recording.

    Example: iiwa-ident simulate model.json runs/first/recording.mcap --figure torques.svg --json -
    """
    from identification.errors import ModelFileError
    from identification.export.parameters import parameters_of, refuse_unmovable
    from identification.mismatch.prediction import repeatable
    from identification.model_file import read_model
    from identification.robots.model import refuse_followers
    from identification.simulation.controllers import controller_named
    from identification.simulation.motor_inertia import motor_inertia_of
    from identification.simulation.simulate import SimulationSettings

    _check_suffix(figure, "--figure", _FIGURE_SUFFIXES)
    _check_suffix(out, "--out", (".npz", ".csv"))
    with as_usage(ModelFileError):
        law = controller_named(controller, bandwidth_hz=bandwidth, stiffness=stiffness)
    model = read_model(model_file)
    robot, chosen = model.load_robot(), parameters_of(model, parameters)
    refuse_followers(robot, "simulate")  # no motion helps, so before one is asked for
    refuse_unmovable(chosen, file=str(model_file))
    motors, sentence = motor_inertia_of(robot, chosen)
    message(sentence)
    effects = repeatable(model.data.get("effects", []))
    if effects:
        names = ", ".join(
            f"{item['effect']}" + (f" (joint {item['joint']})" if item["joint"] else "") for item in effects
        )
        message(f"Effects of the model, taken along the motion to be followed: {names}.")
    if model.data.get("class_terms"):
        from identification.mismatch.unknown.model_terms import range_sentence

        message(range_sentence(model.data["class_terms"]))
    settings = SimulationSettings(
        motor_inertia=motors,
        motor_inertia_in_torque=chosen.rotor_inertia > 0.0,
        offset=chosen.offset,
        coulomb_velocity=model.options.coulomb_velocity,
    )
    comparison = _compare(model, motion, robot, chosen, law, settings, effects)
    if out is not None:
        _write_series(comparison.series(), out)
    if figure is not None:
        _write_figure(comparison, figure, robot)
    result = {**comparison.to_json(), "motor_inertia": motors.tolist(), "motor_note": sentence}
    if not told_in_words(result, json_file):
        return
    data_lines((*comparison.sentences, sentence))
    data("RMS of position differences per joint, mrad (mm):")
    positions = comparison.position_rms()
    show_table(
        ("joint", *(str(joint + 1) for joint in range(len(next(iter(positions.values())))))),
        [(name, *(f"{1e3 * value:.3f}" for value in values)) for name, values in positions.items()],
    )
    if float(positions["simulated minus commanded"].max()) > _BADLY_FOLLOWED:
        message("The simulated arm follows badly: the controller neglects friction. Raise --bandwidth or --stiffness.")
    show_rms(comparison.torque_rms(), "RMS of torque differences per joint", unit=robot.torque_unit, percent=False)
    for name, file in (("Figure", figure), ("Series", out)):
        if file is not None:
            data(f"{name} written to {file}")


def _compare(
    model: Any, motion: Path | None, robot: Any, parameters: Any, law: Any, settings: Any, effects: Any
) -> Any:
    """Against a recording where the file holds torques, else against the plan."""
    from identification.base_parameters import BaseRegressor
    from identification.excitation import default_trajectory, load_trajectory
    from identification.mismatch.prediction import torque_along, torque_along_recording
    from identification.simulation.comparison import compare_with_plan, compare_with_recording
    from identification.validation import as_fitted

    terms = model.data.get("class_terms")
    regressor = BaseRegressor(robot, model.options) if effects or terms else None
    extra = None
    if motion is not None and _is_recording(motion):
        (recording,) = RecordedArm().load([motion], model_robot=robot).recordings
        if regressor is not None:
            extra = torque_along_recording(effects, regressor, model.base_values(regressor), recording, terms)
        noted = model.data.get("provenance", {}).get("settings", {})
        return compare_with_recording(
            recording, robot, parameters, law, settings,
            extra_torque=extra, fitted=as_fitted(noted, recording), torque_shift=model.torque_shift(robot.n),
        )  # fmt: skip
    trajectory = default_trajectory(robot.name) if motion is None else load_trajectory(motion)
    if trajectory.joints != robot.n:
        raise typer.BadParameter(f"{motion} moves {trajectory.joints} joints, {robot.name} has {robot.n}.")
    if regressor is not None:
        time = np.arange(round(trajectory.period_s / _EFFECT_STEP_S), dtype=np.float64) * _EFFECT_STEP_S
        states = trajectory.evaluate(time)
        extra = torque_along(effects, regressor, model.base_values(regressor), time, states, terms)
    return compare_with_plan(trajectory, robot, parameters, law, settings, extra_torque=extra)


def _is_recording(file: Path) -> bool:
    """A log, or a table with torques in it; tables without are trajectories."""
    return file.is_dir() or file.suffix.lower() in (".mcap", ".db3") or is_recording(file)


def _write_series(series: dict[str, np.ndarray], file: Path) -> None:
    """All series in an .npz; a .csv holds the torques' rows, motion interpolated onto them."""
    in_its_folder(file)
    if file.suffix.lower() == ".npz":
        np.savez_compressed(file, **series)  # type: ignore[arg-type]  # the names are ours, none is allow_pickle
        return
    time = series["torque_time"]
    columns, values = ["t"], [time]
    for name, table in series.items():
        if table.ndim == 1:
            continue
        for joint in range(table.shape[1]):
            columns.append(f"{name}_{joint + 1}")
            is_torque = name.endswith("torque")
            values.append(table[:, joint] if is_torque else np.interp(time, series["time"], table[:, joint]))
    np.savetxt(file, np.column_stack(values), delimiter=",", header=",".join(columns), comments="", fmt="%.9g")


def _write_figure(comparison: Any, file: Path, robot: Any) -> None:
    from identification.simulation.figure import draw_comparison, save_figure

    rows = comparison.torque_rms().rows
    subject = "measured minus simulated" if len(rows) > 1 else rows[0].label
    total = next(row.total_nm for row in rows if row.label == subject)
    title = f"{robot.name}: {subject} torque, sum of the joints' RMS {total:.2f} {robot.torque_unit}"
    save_figure(draw_comparison(comparison, title, robot.units), file)


def _check_suffix(file: Path | None, option: str, suffixes: tuple[str, ...]) -> None:
    if file is not None and file.suffix.lower() not in suffixes:
        raise typer.BadParameter(f"{option} writes {', '.join(suffixes)}, not '{file.suffix}'.")
