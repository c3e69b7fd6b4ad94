"""The commands `compare` and `leaderboard`: what changed between recordings of one arm, and which model fits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.cli.app import app
from daemon.cli.inputs import RecordedArm, as_usage
from daemon.cli.lists import AFTER, TwoLists
from daemon.cli.option_groups import grouped
from daemon.cli.output import JsonOption, data, data_lines, message, show_table, told_in_words
from daemon.cli.protection import folder_to_write
from daemon.folders import make_folder

if TYPE_CHECKING:
    from identification.audit.between import Change
    from identification.audit.leaderboard import Standing
    from identification.audit.trend import Trend
    from identification.model_file import Model
    from identification.recordings import Recording
    from identification.robots import RobotModel

SHOWN = 8
MODELS = (".json", ".urdf", ".xml", ".sdf")


@app.command(cls=TwoLists)
@grouped
def compare(
    ctx: typer.Context,
    files: Annotated[
        list[Path],
        typer.Argument(metavar="A B…", help="Recordings, each compared with the first, which may be a model.json."),
    ],
    *,
    models: Annotated[
        bool, typer.Option("--models", help="Instead: MODEL… -- LOG…: the models by how well they predict the torque.")
    ] = False,
    offsets: Annotated[
        bool, typer.Option("--offsets", help="With --models: fit one constant torque a joint; nothing else is fitted.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Of four recordings or more: a page of their friction.",
            callback=folder_to_write,
        ),
    ] = None,
    hours: Annotated[
        str | None,
        typer.Option("--hours", metavar="H,H,…", help="Of four or more: the arm's hours of operation at each."),
    ] = None,
    arm: RecordedArm,
    json_file: JsonOption = None,
) -> None:
    """What changed between two dates, arms or tools: the fewest causes, then parameter by parameter in σ.

    --models: RMS of measured minus predicted torque of every model, best first, and what is wrong in each.
    Four recordings or more are a series: friction by date (of the runs, else as given), and when it changed at once.
    Exit code 0 whatever the answer; 1 where a model cannot be used, as one of another arm.
    Example: iiwa-ident compare runs/may/recording.mcap runs/june/recording.mcap
    """
    if models:
        after = ctx.meta[AFTER]
        known = files[:-after] if after else [file for file in files if file.suffix in MODELS]
        logs = [file for file in files if file not in known]
        if not known or not logs:
            raise typer.BadParameter("Give the models (.json, .urdf, .xml, .sdf), then --, then recordings.")
        _leaderboard(known, logs, arm, offsets, json_file)
        return
    if offsets:
        raise typer.BadParameter("--offsets belongs to --models.")
    if len(files) < 2:
        raise typer.BadParameter("Give two recordings or more, or a model.json and recordings.")
    _changes(files[0], files[1:], arm, _numbers(hours), out, json_file)


@app.command(name="leaderboard")
@grouped
def leaderboard_command(
    models: Annotated[list[Path], typer.Argument(metavar="MODEL…", help="model.json, URDF, MJCF or SDF of the arm.")],
    on: Annotated[list[Path], typer.Option("--on", metavar="LOG", help="Recording; may be given repeatedly.")],
    *,
    offsets: Annotated[
        bool, typer.Option("--offsets", help="Fit one constant torque a joint; nothing else is fitted.")
    ] = False,
    arm: RecordedArm,
    json_file: JsonOption = None,
) -> None:
    """Models of one arm against recordings: RMS per joint, best first, and what is wrong in each. Nothing is fitted.

    The same as `compare --models`. Exit code 0 whatever the answer; 1 where a model cannot be used.
    Example: iiwa-ident leaderboard arm.urdf runs/may/model.json --on runs/june/recording.mcap
    """
    _leaderboard(models, on, arm, offsets, json_file)


def _changes(
    first: Path, others: Sequence[Path], arm: RecordedArm, hours: Sequence[float] | None, out: Path | None,
    json_file: Path | None,
) -> None:  # fmt: skip
    from identification.audit.between import changes_between
    from identification.audit.reading import read_so
    from identification.audit.trend import LEAST, trend_of, with_hours
    from identification.errors import RecordingError
    from identification.model_file import no_check, read_model
    from identification.recordings.independence import refuse_repeated
    from identification.report.series_notes import notes_on_order, notes_on_temperature, notes_on_the_first
    from identification.report.trend_page import trend_order

    known = read_model(first) if first.suffix == ".json" else None
    inputs = arm.load(
        others if known is not None else [first, *others], model_robot=None if known is None else known.load_robot()
    )
    refuse_repeated(inputs.recordings)
    is_series = len(inputs.recordings) >= LEAST
    for option, given in (("--out is the page of", out), ("--hours belongs to", hours)):
        if given is not None and not is_series:
            raise typer.BadParameter(f"{option} a series: give {LEAST} recordings or more.")
    of_series = notes_on_order(inputs.recordings) if is_series else ()
    notes = (*(notes_on_the_first(inputs.recordings) if known is None else ()), *of_series)
    for note in notes:
        message(f"note: {note}")
    for name in () if known is None else known.fitted_among(inputs.recordings):
        message(no_check(name))
    model = known if known is not None else _model_of(inputs.recordings[0], inputs.robot)
    recordings = inputs.recordings if known is not None else inputs.recordings[1:]
    # Every run's recording has the same file name: it is called as the user called it.
    changes = [changes_between(model, recording, inputs.robot, str(first)) for recording in recordings]
    series = list(inputs.recordings[:1]) if known is None else []
    for change, recording in zip(changes, recordings, strict=True):
        series += read_so(change.audit.reading, [recording], inputs.robot)
    with as_usage(RecordingError):
        series = series if hours is None else with_hours(series, hours)
    trend = trend_of(series, inputs.robot) if is_series else None
    warm = () if trend is None else notes_on_temperature(trend)
    page = None
    if trend is not None and out is not None:
        page = _write_page(trend, inputs.robot.name, out, of_series)
    result = {"format": "iiwa-ident/comparison/1", "with": str(first), "notes": [*notes, *warm], "changes": [
        {"recording": str(file), **change.to_json()} for file, change in zip(others, changes, strict=True)
    ], **({} if trend is None else {"trend": trend.to_json()})}  # fmt: skip
    if told_in_words(result, json_file):
        for file, change in zip(others, changes, strict=True):
            show_change(f"{first} → {file}", change)
        if trend is not None:
            data(f"The series, {trend_order(trend)}:")
            data_lines(f"  {sentence}" for sentence in (*trend.sentences, *warm))
        if page is not None:
            data(f"Written to {page}")


def _model_of(recording: Recording, robot: RobotModel) -> Model:
    """What later recordings are compared with; what spoils it is said."""
    from identification.audit.between import fitted_to, model_of_fit
    from identification.audit.mount import require_stated_stand
    from identification.audit.signs import require_stated_signs
    from identification.fitting.result import warnings_of

    require_stated_stand([recording], robot)
    require_stated_signs([recording], robot, "nothing can be compared with it")
    fit = fitted_to(recording, robot)
    for warning in warnings_of(fit.notes):
        message(warning)
    return model_of_fit(fit, Path(recording.source.path).name)


def _numbers(text: str | None) -> list[float] | None:
    try:
        numbers = None if text is None else [float(item) for item in text.split(",")]
    except ValueError:
        numbers = [math.nan]
    if numbers is not None and not all(0.0 <= number < math.inf for number in numbers):
        raise typer.BadParameter(f"--hours takes numbers from 0 with commas between them, not '{text}'.")
    return numbers


def _write_page(trend: Trend, robot: str, out: Path, notes: Sequence[str]) -> Path:
    from identification.report.trend_page import write_trend

    make_folder(out)
    page = out / "trend.html"
    write_trend(page, trend, robot, notes)
    return page


def _leaderboard(
    models: Sequence[Path], logs: Sequence[Path], arm: RecordedArm, offsets: bool, json_file: Path | None
) -> None:
    from daemon.cli.protection import is_recording
    from identification.audit.leaderboard import leaderboard
    from identification.audit.rows import band_of

    for file in filter(is_recording, models):
        raise typer.BadParameter(
            f"{file} is a recording and no model: --on goes before each of several recordings; in `compare --models` "
            "they stand behind --."
        )
    inputs = arm.load(logs, model_robot=_robot_of(models))
    standings = leaderboard(models, inputs.recordings, inputs.robot, offsets=offsets)
    band = band_of(inputs.recordings)
    result = {"format": "iiwa-ident/leaderboard/1", "offsets_fitted": offsets, "up_to_hz": band,
              "recordings": list(map(str, logs)), "models": [item.to_json() for item in standings]}  # fmt: skip
    if told_in_words(result, json_file):
        show_leaderboard(standings, offsets, inputs.robot.torque_unit, band)
    if any(item.rms is None for item in standings):
        raise typer.Exit(1)


def _robot_of(models: Sequence[Path]) -> RobotModel | None:
    """The robot of the first model.json that can be used; of the others the table says why they cannot."""
    from identification.errors import ModelFileError, ModelFileNotFoundError, RobotError
    from identification.model_file import read_model

    for file in models:
        try:
            if file.suffix == ".json":
                return read_model(file).load_robot()
        except ModelFileNotFoundError:
            raise
        except (ModelFileError, RobotError):
            continue
    return None


OTHER_ROWS = (
    "An RMS in the sentences below is of a quarter of the rows, in which nothing was looked for, beside what the model "
    "leaves open (its σ; of a file friction and offsets): the table's, of all rows, is larger."
)


def show_leaderboard(standings: Sequence[Standing], offsets: bool, unit: str, up_to_hz: float) -> None:
    """The table of RMS, best first, then what is wrong in each model. up_to_hz: of what is compared."""
    from daemon.cli.rms_view import show_rms
    from identification.fitting.rms import RmsTable

    fitted = "one constant a joint fitted" if offsets else "nothing fitted"
    lines = tuple(item.rms for item in standings if item.rms is not None)
    if lines:
        show_rms(
            RmsTable(lines),
            f"RMS of measured minus predicted torque per joint up to {up_to_hz:.3g} Hz, {fitted}",
            unit=unit,
        )
        if any(item.quotes_rms for item in standings):
            data(OTHER_ROWS)
    for item in standings:
        data(f"{item.name}:")
        data_lines(f"  {sentence}" for sentence in item.sentences)


def show_change(title: str, change: Change) -> None:
    """What is wrong with the recording, the causes in sentences, then the parameters that differ most."""
    data(title)
    data_lines(f"  {warning}" for warning in change.warnings)
    for sentence in [item.sentence for item in change.audit.differences] or [change.audit.sentence]:
        data(f"  {sentence}")
    show_table(
        ("parameter", "before", "after", "unit", "difference in σ"),
        [
            (item.name, f"{item.before:.4g}", f"{item.after:.4g}", item.unit, f"{item.sigmas:+.1f}")
            for item in change.parameters[:SHOWN]
        ],
    )
