"""Commands that talk to a robot or prepare for it: `fake-robot`, `check`, `run`, `recover`."""

from __future__ import annotations

import ipaddress
import os
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from typer.core import TyperCommand

from daemon.cli.app import app
from daemon.cli.output import JsonOption, data, message, show_table, wants_json_on_stdout, write_json
from daemon.cli.run_view import run_shown

if TYPE_CHECKING:
    from daemon.preparation import PreparedMotion
    from safety.collision import Clearance

TrajectoryArgument = Annotated[
    Path | None, typer.Argument(help="Trajectory file (.json, .npz, .csv); without one, the shipped excitation.")
]
RobotOption = Annotated[str | None, typer.Option("--robot", help="iiwa14 or iiwa7; default: the trajectory's own.")]
WorkspaceOption = Annotated[
    Path | None,
    typer.Option("--workspace", metavar="FILE.yaml", help="Floor, walls, boxes, tool, margins; default: a floor."),
]
ModelOption = Annotated[
    Path | None,
    typer.Option("--model", metavar="MODEL.json", help="Foresees the torque; default for the iiwa14: Table 3."),
]
AmplitudeOption = Annotated[
    float, typer.Option("--amplitude", min=0.01, max=1.0, help="Fraction of the motion: 0.1, 0.25, 0.5, then 1.")
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


def show_preflight(motion: PreparedMotion) -> None:
    """The preflight's checks, and every pair's distances, as tables on stdout."""
    report = motion.preflight
    table = Table("check", "result", "what was found")
    for check in report.checks:
        table.add_row(check.name.replace("_", " "), "ok" if check.passed else "NOT SAFE", check.sentence)
    show_table(table)
    data("")
    data(motion.foresight_sentence())
    if report.clearances:
        paths = list(dict.fromkeys(each.along for each in report.clearances))
        table = Table("distance between", *(f"{path} (proven)" for path in paths), "required", "result")
        pairs: dict[str, dict[str, Clearance]] = {}
        for each in report.clearances:
            pairs.setdefault(each.pair, {})[each.along] = each
        for pair, found in sorted(pairs.items(), key=lambda item: min(c.guaranteed_m for c in item[1].values())):
            cells = [_distance(found[path]) if path in found else "" for path in paths]
            margin = max(each.margin_m for each in found.values())
            kept = all(each.kept for each in found.values())
            table.add_row(pair, *cells, f"{1e3 * margin:.0f} mm", "ok" if kept else "TOO CLOSE")
        show_table(table)
        data(
            "Row n is n ms into the period. In brackets what is proven between the samples too; negative: overlap. "
            "Stops are planned from every row. The start ramp shown begins in the middle of the motion; `run` "
            "checks the one from where the arm stands."
        )


def _distance(clearance: Clearance) -> str:
    place = "" if clearance.along == "start ramp" else f" row {clearance.row}"
    return f"{1e3 * clearance.distance_m:.0f} mm{place} ({1e3 * clearance.guaranteed_m:.0f})"


@app.command()
def check(
    trajectory: TrajectoryArgument = None,
    robot: RobotOption = None,
    amplitude: AmplitudeOption = 1.0,
    workspace: WorkspaceOption = None,
    model: ModelOption = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="FILE", help="Draw the path into a .png or .svg file.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Preflight of a motion: limits, stops, torque, self-collision, workspace. Exit code 0 only when it is safe.

    Example: iiwa-ident check excitation.json --workspace cell.yaml --picture path.png
    """
    from daemon.preparation import prepare_motion

    motion = prepare_motion(trajectory, robot=robot, amplitude=amplitude, workspace=workspace, model=model)
    if picture is not None:
        from daemon.picture import draw_motion

        draw_motion(motion, picture)
        message(f"The picture is in {picture}.")
    if json_file is not None:
        write_json(json_file, motion.preflight.to_json())
    if not wants_json_on_stdout(json_file):
        show_preflight(motion)
        failures = ", ".join(failure.name.replace("_", " ") for failure in motion.preflight.failures)
        verdict = f"NOT safe, it will not be run ({failures})" if failures else "safe to run"
        data(f"{motion.name}, amplitude {motion.amplitude:g}: {verdict}.")
    if not motion.preflight.safe:
        raise typer.Exit(1)


def parse_bind(text: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`; raises a usage error naming the text."""
    host, _, port = text.rpartition(":")
    try:
        ipaddress.ip_address(host)
        number = int(port)
    except ValueError:
        number = -1
    if not 0 <= number <= 65535:
        raise typer.BadParameter(f"'{text}' is no address: give ADDRESS:PORT, such as 127.0.0.1:30200.")
    return host, number


def confirm_motion(motion: PreparedMotion, host: str, periods: int) -> None:
    """Ask before a real arm may move. No cabinet can reach a loopback address, so there nothing is asked."""
    if ipaddress.ip_address(host).is_loopback:
        return
    if not sys.stdin.isatty():
        raise typer.BadParameter("the arm will move, and nobody can be asked here: add --no-confirm if that is meant.")
    seconds = motion.trajectory.period_s * periods
    message(f"The arm WILL MOVE: {motion.name}, amplitude {motion.amplitude:g}, {periods} periods, {seconds:.0f} s.")
    message("Is the workspace clear, the enabling switch in reach, and the load data of the tool set on the cabinet?")
    typer.confirm("Start", abort=True, err=True)


@app.command()
def run(
    trajectory: TrajectoryArgument = None,
    periods: Annotated[int, typer.Option("--periods", min=1, help="Periods to record.")] = 16,
    bind: Annotated[str, typer.Option("--bind", help="Address and port the robot sends to.")] = "127.0.0.1:30200",
    fri_version: Annotated[str, typer.Option("--fri-version", help="1.11, 1.14, 1.15, 1.16, 2.5 or 2.7.")] = "1.15",
    amplitude: AmplitudeOption = 1.0,
    robot: RobotOption = None,
    workspace: WorkspaceOption = None,
    model: ModelOption = None,
    robot_host: Annotated[
        str | None, typer.Option("--robot-host", help="The robot's address; datagrams of others are ignored.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the run; default: runs/RUN_ID.")] = None,
    no_fit: Annotated[bool, typer.Option("--no-fit", help="Record only.")] = False,
    diagnose: Annotated[
        bool, typer.Option("--diagnose", help="After the fit: name what the model leaves out, into diagnosis/.")
    ] = False,
    heldout: Annotated[
        list[Path] | None,
        typer.Option("--heldout", help="Recording of another motion that checks the names; may be given repeatedly."),
    ] = None,
    no_confirm: Annotated[bool, typer.Option("--no-confirm", help="Do not ask before a real arm moves.")] = False,
    start_timeout: Annotated[float, typer.Option("--start-timeout", help="Seconds to wait for the robot.")] = 30.0,
    seed: Annotated[int | None, typer.Option("--seed", help="Noted in the log.")] = None,
    serial: Annotated[
        str | None, typer.Option("--serial", help="Serial number of the arm, by which its ladder is kept.")
    ] = None,
    ladder: Annotated[
        Path | None, typer.Option("--ladder", metavar="FILE", help="Record of amplitudes done; default: the user's.")
    ] = None,
    skip_ladder: Annotated[
        bool, typer.Option("--skip-ladder", help="Allow an amplitude before its turn; the log will say so.")
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """One acquisition: start ramp, PERIODS periods at 1 kHz, stop ramp; then the fit, in a process of its own.

    Writes recording.mcap and run.json into the folder, then model.json. Ctrl-C brings the arm to rest by a ramp.
    On a real arm a new motion begins at --amplitude 0.1; 0.25, 0.5 and 1 follow as each before was completed.

    Example: iiwa-ident run --periods 1 --out runs/first --no-fit
    """
    from daemon.cli.worker_view import wait_for_worker
    from daemon.commissioning import admit
    from daemon.preparation import new_run_id, prepare_motion, write_run_request
    from daemon.service import run_acquisition
    from fri_client.messages import FriVersion

    host, port = parse_bind(bind)
    if diagnose and no_fit:
        raise typer.BadParameter("--diagnose follows the fit, which --no-fit leaves out.")
    for file in heldout or ():
        if not diagnose or not file.is_file():
            raise typer.BadParameter(f"--heldout {file}: no such file, or nothing to check without --diagnose.")
    try:
        version = FriVersion.parse(fri_version).value
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    motion = prepare_motion(trajectory, robot=robot, amplitude=amplitude, workspace=workspace, model=model)
    if not motion.preflight.safe:
        show_preflight(motion)
        message("The preflight found the motion unsafe; nothing was moved.")
        raise typer.Exit(1)
    run_id = new_run_id()
    settings: dict[str, Any] = {
        "run_id": run_id,
        "periods": periods,
        "bind_host": host,
        "bind_port": port,
        "robot_host": robot_host,
        "fri_version": version,
        "fit": not no_fit,
        "diagnose": diagnose,
        "heldout": tuple(str(file.absolute()) for file in heldout or ()),
        "start_timeout_s": start_timeout,
        "seed": seed,
        "simulation": ipaddress.ip_address(host).is_loopback,
        "serial": serial,
        "ladder_file": None if ladder is None else str(ladder.absolute()),
        "skip_ladder": skip_ladder,
    }
    # Whether it is this amplitude's turn is said before anybody is asked, and before a folder is made.
    with tempfile.TemporaryDirectory() as scratch:
        admit(write_run_request(motion, Path(scratch), **settings))
    if not no_confirm:
        confirm_motion(motion, host, periods)
    request = write_run_request(motion, out or Path("runs") / run_id, **settings)
    with run_shown() as view:
        outcome = run_acquisition(request, observe=view.observe)
    fit = wait_for_worker(Path(outcome.worker_status_file)) if outcome.worker_status_file is not None else None
    if json_file is not None:
        import msgspec

        write_json(json_file, msgspec.to_builtins(outcome))
    if not wants_json_on_stdout(json_file):
        view.show_outcome(outcome.sentences)
        data(f"Everything is in {outcome.out_dir}")
    if outcome.exit_code:
        raise typer.Exit(outcome.exit_code)
    if fit is not None and (fit.phase == "failed" or fit.diagnosis_error is not None):
        raise typer.Exit(fit.exit_code or 1)


@app.command()
def recover(
    log: Annotated[Path, typer.Argument(help="A log that was broken off, or a run's folder with all its parts.")],
    json_file: JsonOption = None,
) -> None:
    """Make a broken-off log whole again as far as its bytes go, and say what is missing. The original is kept.

    A run's folder also gets its run.json where its processes left none.

    Example: iiwa-ident recover runs/first
    """
    from daemon.account import account_for_folder
    from daemon.log.parts import recover as recover_recording

    report = recover_recording(log)
    outcome = account_for_folder(log, report) if log.is_dir() else None
    if json_file is not None:
        write_json(json_file, report.to_json())
    if not wants_json_on_stdout(json_file):
        for sentence in report.sentences:
            data(sentence)
        if outcome is not None:
            data(f"{log / 'run.json'} was missing and is written: {outcome.sentences[0]}")
