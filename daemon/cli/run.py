"""The command `run`: one acquisition in the foreground, from the settings to the fit's last word."""

from __future__ import annotations

import ipaddress
import sys
import tempfile
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from daemon.cli.acquisition import (
    ModelOption,
    RobotOption,
    ToolOption,
    TrajectoryArgument,
    WorkspaceOption,
    parse_bind,
    show_preflight,
    tool_from,
)
from daemon.cli.app import app
from daemon.cli.inputs import ArmOption, GravityOption, MountOption, as_usage, installation_of, settings_of
from daemon.cli.live_view import LiveOptions, live_served
from daemon.cli.option_groups import grouped
from daemon.cli.output import JsonOption, data, message, told_in_words
from daemon.cli.protection import folder_to_write, not_a_recording
from daemon.cli.questions import agreed
from daemon.cli.run_view import run_shown
from daemon.errors import ConfigurationError, MissingInputError
from daemon.ranges import LARGEST_AMPLITUDE, SMALLEST_AMPLITUDE
from daemon.words import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from daemon.api import RunOutcome, WorkerStatus
    from daemon.cli.run_view import RunView
    from daemon.motion.preparation import PreparedMotion


RobotHostOption = Annotated[
    str | None, typer.Option("--robot-host", help="The robot's address; datagrams of others are ignored.")
]


def address_of(host: str | None) -> str | None:
    """The address of `--robot-host`; raises a usage error for one that is none."""
    from daemon.endpoints import is_ipv4

    if host is not None and not is_ipv4(host):
        raise typer.BadParameter(f"--robot-host '{host}' is no IPv4 address, such as 192.170.10.2.")
    return host


def version_of(text: str | None) -> str | None:
    """The FRI version of an option, or "auto". Raises a usage error for one that there is not."""
    from daemon.config import parse_version

    with as_usage(ValueError):
        return None if text is None else parse_version(text)


def confirm_motion(motion: PreparedMotion, periods: int) -> None:
    """Ask before a real arm may move."""
    if not sys.stdin.isatty():
        raise typer.BadParameter("the arm will move, and nobody can be asked here: add --no-confirm if that is meant.")
    seconds = motion.trajectory.period_s * periods
    message(
        f"The arm WILL MOVE: {motion.name}, amplitude {motion.amplitude:g}, {counted(periods, 'period')}, "
        f"{seconds:.0f} s."
    )
    message(motion.speed_sentence())
    tool = motion.surroundings.tool.describe()
    message(f"Tool: {tool}. Are the load data on the cabinet those of this tool?")
    message("Is the workspace clear, and the enabling switch in reach?")
    agreed("Start", abort=True)


@app.command()
@grouped
def run(
    context: typer.Context,
    trajectory: TrajectoryArgument = None,
    *,
    periods: Annotated[int | None, typer.Option("--periods", min=1, help="Periods to record; default: 16.")] = None,
    bind: Annotated[
        str | None, typer.Option("--bind", help="Address and port the robot sends to; default: 127.0.0.1:30200.")
    ] = None,
    fri_version: Annotated[
        str | None,
        typer.Option("--fri-version", help="1.11, 1.14, 1.15, 1.16, 2.5, 2.7, or auto: ask the robot; default: 1.15."),
    ] = None,
    amplitude: Annotated[
        float | None,
        typer.Option(
            "--amplitude",
            min=SMALLEST_AMPLITUDE,
            max=LARGEST_AMPLITUDE,
            help="Fraction of the motion, default: 1; on a new arm 0.1, 0.25, 0.5 first.",
        ),
    ] = None,
    robot: RobotOption = None,
    workspace: WorkspaceOption = None,
    model: ModelOption = None,
    tool: ToolOption = None,
    mount: MountOption = None,
    gravity: GravityOption = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="Settings as of `daemon`; options given here stand before them."),
    ] = None,
    arm: ArmOption = None,
    robot_host: RobotHostOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the run; default: runs/RUN_ID.", callback=folder_to_write)
    ] = None,
    no_fit: Annotated[bool, typer.Option("--no-fit", help="Record only.")] = False,
    diagnose: Annotated[
        bool, typer.Option("--diagnose", help="After the fit: name what the model leaves out, into diagnosis/.")
    ] = False,
    heldout: Annotated[
        list[Path] | None,
        typer.Option("--heldout", help="Recording of another motion that checks the names; may be given repeatedly."),
    ] = None,
    real_robot: Annotated[
        bool, typer.Option("--real-robot", help="A cabinet is relayed to this loopback address: ask, keep the ladder.")
    ] = False,
    no_confirm: Annotated[bool, typer.Option("--no-confirm", help="Do not ask before a real arm moves.")] = False,
    start_timeout: Annotated[
        float | None, typer.Option("--start-timeout", help="Seconds to wait for the robot; default: 30.")
    ] = None,
    live: LiveOptions,
    seed: Annotated[int | None, typer.Option("--seed", help="Noted in the log.")] = None,
    serial: Annotated[
        str | None, typer.Option("--serial", help="Serial number of the arm, by which its ladder is kept.")
    ] = None,
    ladder: Annotated[
        Path | None,
        typer.Option(
            "--ladder",
            metavar="FILE",
            help="Record of amplitudes done; default: the user's.",
            callback=not_a_recording,
        ),
    ] = None,
    skip_ladder: Annotated[
        bool, typer.Option("--skip-ladder", help="Allow an amplitude before its turn; the log will say so.")
    ] = False,
    monitor_only: Annotated[
        bool,
        typer.Option("--monitor-only", help="Answer and record, command nothing, until Ctrl-C or the robot's end."),
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """One acquisition: start ramp, PERIODS periods at 1 kHz, stop ramp; then the fit, in a process of its own.

    Writes recording.mcap and run.json into the folder, then model.json. Ctrl-C brings the arm to rest by a ramp.
    On a real arm a new motion begins at --amplitude 0.1; 0.25, 0.5 and 1 follow as each before was completed.
    With --monitor-only the arm is led by hand or by the robot's own program, and only recorded.

    Example: iiwa-ident run --config lab.yaml --tool 2.5@0,0,0.06 --amplitude 0.1
    """
    from daemon.cli.worker_view import wait_for_worker
    from daemon.motion.preparation import prepare_motion, write_monitor_request, write_run_request
    from daemon.motion.tool import read_tool
    from daemon.motion.workspace import load_surroundings
    from daemon.run.folder import keep_inputs, kept_once_begun, make_room
    from daemon.run.service import run_acquisition
    from daemon.runtime_folder import lock_folder
    from daemon.times import new_job_id
    from identification.recordings.reader import recording_file
    from identification.robots import Installation
    from identification.robots.installation import ON_THE_FLOOR

    lab = settings_of(config, arm)
    host, port = (lab.fri.bind_host, lab.fri.bind_port) if bind is None else parse_bind(bind)
    # Nothing is asked on a loopback address, so only a robot is moved there that says it is the fake one.
    simulation = ipaddress.ip_address(host).is_loopback and not (real_robot or lab.fri.real_robot)
    if monitor_only and (trajectory is not None or periods is not None or amplitude is not None or diagnose):
        raise typer.BadParameter("--monitor-only drives nothing: leave trajectory, --periods, --amplitude out.")
    _refuse_check_of_nothing(diagnose, heldout or (), fits=lab.run.fit and not no_fit)
    settings = lab.request_fields() | _stated(
        periods=periods,
        bind_host=host,
        bind_port=port,
        robot_host=address_of(robot_host),
        fri_version=version_of(fri_version),
        start_timeout_s=start_timeout,
        serial=serial,
        amplitude=amplitude,
        workspace_file=workspace,
        fit=False if no_fit else None,
    )
    named, noted = settings.pop("robot"), settings.pop("tool")
    carried = read_tool(noted, is_name=True) if tool is None else tool_from(tool)
    around, noted_gravity = settings.pop("workspace_file"), settings.pop("gravity_m_s2")
    cell = None if around is None else Path(around)
    stand = installation_of(gravity, mount, None) or (None if noted_gravity is None else Installation(noted_gravity))
    named_by = config if robot is None else None
    robot = robot or (None if config is None else named)
    run_id = new_job_id(())
    settings.update(
        run_id=run_id,
        diagnose=diagnose,
        heldout=tuple(str(recording_file(file).absolute()) for file in heldout or ()),
        seed=seed,
        simulation=simulation,
        ladder_file=None if ladder is None else str(ladder.absolute()),
        skip_ladder=skip_ladder,
        model_file=None if model is None else str(model.absolute()),
    )
    viewers = live.server()
    out = Path(lab.output) / run_id if out is None else out
    keep_inputs(out, trajectory, cell, model)
    context.with_resource(lock_folder(out))
    if monitor_only:
        make_room(out)
        surroundings = load_surroundings(robot or "iiwa14", cell, carried)
        write_request = partial(
            write_monitor_request, robot or "iiwa14", surroundings, stand or ON_THE_FLOOR, out, **settings
        )
        message("Nothing will be commanded. The arm moves only if you or the robot's own program move it.")
    else:
        amplitude, lead_in_s = settings.pop("amplitude"), settings.pop("lead_in_s")
        motion = prepare_motion(
            trajectory, robot=robot, amplitude=amplitude, workspace=cell, model=model, tool=carried,
            lead_in_s=lead_in_s, installation=stand,
        )  # fmt: skip
        _require_safe(motion, named_by)
        make_room(out)
        _admit(motion, settings)
        if not no_confirm and not simulation:
            confirm_motion(motion, settings["periods"])
        write_request = partial(write_run_request, motion, out, **settings)
    with _interrupted_in_words(out):
        with live_served(port, viewers), run_shown() as view, kept_once_begun(out):
            outcome = run_acquisition(write_request(), observe=view.observe)
        fit = wait_for_worker(Path(outcome.out_dir), outcome.worker_pid) if outcome.worker_pid is not None else None
    _show(view, outcome, fit, json_file)
    if outcome.exit_code:
        raise typer.Exit(outcome.exit_code)
    if fit is not None and (fit.phase == "failed" or fit.diagnosis_error is not None):
        raise typer.Exit(fit.exit_code or 1)


@contextmanager
def _interrupted_in_words(out: Path) -> Iterator[None]:
    """Where an interrupt comes after the motion, say that run and recording are whole, and that the fit goes on without
    this command.
    """
    from daemon.api import RUN_NAME, RunOutcome
    from daemon.json_files import read_json

    try:
        yield
    except KeyboardInterrupt:
        if (out / RUN_NAME).is_file():
            outcome = read_json(out / RUN_NAME, RunOutcome)
            message(f"Interrupted after the motion. {outcome.sentences[0]} Everything is in {outcome.out_dir}.")
            if outcome.worker_pid is not None:
                message(f"The fit goes on by itself; {outcome.worker_status_file} says how far it is.")
        raise


def _refuse_check_of_nothing(diagnose: bool, heldout: Sequence[Path], *, fits: bool) -> None:
    if diagnose and not fits:
        raise typer.BadParameter("--diagnose follows the fit, which --no-fit leaves out.")
    for file in heldout:
        if not diagnose:
            raise typer.BadParameter(f"--heldout {file} checks nothing without --diagnose.")
        if not file.exists():
            raise MissingInputError(str(file), "the held-out recording")


def _stated(**options: object) -> dict[str, Any]:
    """The options that were given: they stand before those of the configuration."""
    return {name: each for name, each in options.items() if each is not None}


def _show(view: RunView, outcome: RunOutcome, fit: WorkerStatus | None, json_file: Path | None) -> None:
    import msgspec

    from daemon.run.next_step import moved_away, next_step

    if told_in_words(msgspec.to_builtins(outcome), json_file):
        view.show_outcome(outcome.sentences)
        if not Path(outcome.out_dir).is_dir():
            data(moved_away(outcome))
            return
        data(f"Everything is in {outcome.out_dir}")
        data(next_step(outcome, fit))


def _require_safe(motion: PreparedMotion, named_by: Path | None) -> None:
    """Show what the preflight found of a motion that is not safe, and end the command.

    named_by: the configuration that names the robot, where no option does: then the trajectory has to be for it.
    """
    meant_for = motion.trajectory.robot
    if named_by is not None and meant_for not in ("", motion.robot):
        raise ConfigurationError(f"{motion.name} was made for {meant_for}; --robot says otherwise.", file=str(named_by))
    if not motion.preflight.safe:
        show_preflight(motion)
        message("The preflight found the motion unsafe; nothing was moved.")
        raise typer.Exit(1)


def _admit(motion: PreparedMotion, settings: dict[str, Any]) -> None:
    """Whether it is this amplitude's turn is said before anybody is asked, and before a folder is made."""
    from daemon.motion.preparation import write_run_request
    from daemon.run.commissioning import admit

    with tempfile.TemporaryDirectory() as scratch:
        admit(write_run_request(motion, Path(scratch), **settings))
