"""Commands beside a run: `fake-robot`, `check`, `recover`, `judge`; and what they share with `run` (module `run`)."""

from __future__ import annotations

import ipaddress
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from daemon.cli.app import app
from daemon.cli.inputs import GravityOption, MountOption, installation_of
from daemon.cli.output import JsonOption, data, data_lines, message, show_table, told_in_words
from daemon.cli.protection import not_a_recording
from daemon.ranges import LARGEST_AMPLITUDE, SMALLEST_AMPLITUDE

if TYPE_CHECKING:
    from daemon.motion.preparation import PreparedMotion
    from daemon.motion.tool import Tool
    from safety.collision import Clearance

TrajectoryArgument = Annotated[
    Path | None, typer.Argument(help="Trajectory file (.json, .npz, .csv); without one, the shipped excitation.")
]


def _existing(robot: str | None) -> str | None:
    """A robot that is there at all: an unknown one is missing for a motion as it is for a fit."""
    if robot is not None:
        from identification.robots import load_robot

        load_robot(robot)
    return robot


RobotOption = Annotated[
    str | None, typer.Option("--robot", help="iiwa14 or iiwa7; default: the trajectory's own.", callback=_existing)
]
WorkspaceOption = Annotated[
    Path | None,
    typer.Option("--workspace", metavar="FILE.yaml", help="Floor, walls, boxes, tool, margins; default: a floor."),
]
ModelOption = Annotated[
    Path | None,
    typer.Option("--model", metavar="MODEL.json", help="Predicts the torque; default for the iiwa14: Table 3."),
]
AmplitudeOption = Annotated[
    float,
    typer.Option(
        "--amplitude",
        min=SMALLEST_AMPLITUDE,
        max=LARGEST_AMPLITUDE,
        help="Fraction of the motion: 0.1, 0.25, 0.5, then 1.",
    ),
]
ToolOption = Annotated[
    str | None,
    typer.Option(
        "--tool",
        metavar="MASS@X,Y,Z",
        help="Tool: kg@m,m,m from the flange, a file tool.yaml, or none; default: the workspace's.",
    ),
]


# The simulator is a process of its own, as a robot is: nothing of it is ever imported here.
_FAKE_ROBOT = (sys.executable, "-m", "fixtures.fake_robot")


class FakeRobotCommand(TyperCommand):
    """Hands over to the fake robot's process, which knows its options, also when a shell asks to complete them."""

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Let the fake robot answer the shell, with the words before its own name taken away."""
        del ctx, incomplete
        environment = dict(os.environ)
        for name in ("COMP_WORDS", "_TYPER_COMPLETE_ARGS"):
            if name in environment:
                before, command, after = environment[name].partition("fake-robot")
                environment[name] = command + after
                place = int(environment.get("COMP_CWORD", 0)) - len(before.split())
                environment["COMP_CWORD"] = str(place)
        os.execve(sys.executable, _FAKE_ROBOT, environment)


@app.command(
    "fake-robot",
    cls=FakeRobotCommand,
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []},
)
def fake_robot(context: typer.Context) -> None:
    """Stand in for the robot. Options and help are the fake robot's own: `fixtures.fake_robot.command_line`."""
    quiet = ["--quiet"] if context.find_root().params["quiet"] else []
    os.execv(sys.executable, [*_FAKE_ROBOT, *quiet, *context.args])


@app.command()
def judge(
    log: Annotated[Path, typer.Argument(help="Recording of a run, or its folder.")],
    json_file: JsonOption = None,
    hidden_answers: Annotated[
        bool, typer.Option("--hidden-answers", help="A wire may have lost answers: a short gap may hide commands.")
    ] = False,
) -> None:
    """Were the commands inside every limit at the robot, in its own cycles? Exit code 0 only when all were.

    Example: iiwa-ident judge runs/first/recording.mcap
    """
    # A program of its own, so that it shares no code with what it judges.
    options = ["--json", str(json_file)] if json_file is not None else []
    options += ["--hidden-answers"] if hidden_answers else []
    os.execv(sys.executable, [sys.executable, "-m", "fixtures.judge", str(log), *options])


def show_preflight(motion: PreparedMotion) -> None:
    """The preflight's checks, and every pair's distances, as tables on stdout."""
    report = motion.preflight
    show_table(
        ("check", "result", "what was found"),
        [
            (check.name.replace("_", " "), "ok" if check.passed else "NOT SAFE", check.sentence)
            for check in report.checks
        ],
    )
    data("")
    data(motion.foresight_sentence())
    data(motion.speed_sentence())
    if report.clearances:
        paths = list(dict.fromkeys(each.along for each in report.clearances))
        rows = []
        pairs: dict[str, dict[str, Clearance]] = {}
        for each in report.clearances:
            pairs.setdefault(each.pair, {})[each.along] = each
        for pair, found in sorted(pairs.items(), key=lambda item: min(c.guaranteed_m for c in item[1].values())):
            cells = [_distance(found[path]) if path in found else "" for path in paths]
            margin = max(each.margin_m for each in found.values())
            kept = all(each.kept for each in found.values())
            rows.append((pair, *cells, f"{1e3 * margin:.0f} mm", "ok" if kept else "TOO CLOSE"))
        show_table(("distance between", *(f"{path} (proven)" for path in paths), "required", "result"), rows)
        data(
            "Row n is n ms into the period. In brackets what is proven between the samples too; negative: overlap. "
            "Stops are planned from every row. The start ramp shown begins in the middle of the motion; `run` "
            "checks the one from where the arm stands."
        )


def _distance(clearance: Clearance) -> str:
    place = "" if clearance.along == "start ramp" else f" row {clearance.row}"
    return f"{1e3 * clearance.distance_m:.0f} mm{place} ({1e3 * clearance.guaranteed_m:.0f})"


def _can_be_drawn(picture: Path | None) -> Path | None:
    """The file, where it can be a picture and be written; raises a usage error or OSError."""
    if picture is not None and picture.suffix.lower() not in (".png", ".svg"):
        raise typer.BadParameter(f"{picture}: a picture is a .png or .svg file.")
    return not_a_recording(picture)


@app.command()
def check(
    trajectory: TrajectoryArgument = None,
    robot: RobotOption = None,
    amplitude: AmplitudeOption = 1.0,
    workspace: WorkspaceOption = None,
    model: ModelOption = None,
    tool: ToolOption = None,
    mount: MountOption = None,
    gravity: GravityOption = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture", metavar="FILE", help="Draw the path into a .png or .svg file.", callback=_can_be_drawn
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Preflight of a motion: limits, stops, torque, self-collision, workspace. Exit code 0 only when it is safe.

    Example: iiwa-ident check excitation.json --workspace cell.yaml --picture path.png
    """
    from daemon.motion.preparation import prepare_motion

    carried = tool_from(tool)
    motion = prepare_motion(
        trajectory, robot=robot, amplitude=amplitude, workspace=workspace, model=model, tool=carried,
        installation=installation_of(gravity, mount, None),
    )  # fmt: skip
    if picture is not None:
        from daemon.motion.picture import draw_motion

        draw_motion(motion, picture)
        message(f"The picture is in {picture}.")
    if told_in_words(motion.preflight.to_json(), json_file):
        show_preflight(motion)
        failures = ", ".join(failure.name.replace("_", " ") for failure in motion.preflight.failures)
        verdict = f"NOT safe, it will not be run ({failures})" if failures else "safe to run"
        data(f"{motion.name}, amplitude {motion.amplitude:g}: {verdict}.")
    if not motion.preflight.safe:
        raise typer.Exit(1)


def tool_from(text: str | None) -> Tool | None:
    """The tool of `--tool`, an empty one for "none", None where nothing is said.

    Raises a usage error for words that describe no tool, ConfigurationError for a file.
    """
    from daemon.errors import ConfigurationError
    from daemon.motion.tool import Tool, read_tool

    try:
        return None if text is None else read_tool(text) or Tool()
    except ConfigurationError as error:
        if error.file is not None:
            raise
        raise typer.BadParameter(error.reason) from error


def parse_bind(text: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`; raises a usage error naming the text."""
    host, _, port = text.rpartition(":")
    try:
        ipaddress.IPv4Address(host)
        number = int(port)
    except ValueError:
        number = -1
    if not 0 <= number <= 65535:
        raise typer.BadParameter(f"'{text}' is no address: give ADDRESS:PORT, such as 127.0.0.1:30200.")
    return host, number


@app.command()
def recover(
    log: Annotated[Path, typer.Argument(help="A log that was broken off, or a run's folder with all its parts.")],
    json_file: JsonOption = None,
) -> None:
    """Make a broken-off log whole again as far as its bytes go, and say what is missing. The original is kept.

    A run's folder also gets its run.json where its processes left none.

    Example: iiwa-ident recover runs/first
    """
    from daemon.cli.worker_view import settle_fit
    from daemon.log.parts import recover as recover_recording
    from daemon.run.account import account_for_folder, kept_elsewhere

    report = recover_recording(log)
    outcome = account_for_folder(log, report) if log.is_dir() else None
    fit = settle_fit(log) if log.is_dir() else ""
    if told_in_words(report.to_json(), json_file):
        data_lines(report.sentences)
        if outcome is not None:
            data(f"{log / 'run.json'} was missing and is written: {outcome.sentences[0]}")
        if log.is_dir() and (elsewhere := kept_elsewhere(log)):
            data(elsewhere)
        if fit:
            data(fit)
