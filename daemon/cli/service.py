"""The long-running service and its clients: `daemon`, `submit`, `submit-investigation`, `status`, `jobs`, `resume`,
`cancel`, `ping`, `keys`. `stop` has a module of its own.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
import typer

from daemon.cli.app import app
from daemon.cli.inputs import ArmOption, settings_of
from daemon.cli.operator_actions import AddedMassOption, AfterDropOption, DoneOption, SettleOption, YesOption, mass_of
from daemon.cli.option_groups import grouped
from daemon.cli.output import JsonOption, data, data_lines, message, told_in_words
from daemon.cli.questions import agreed
from daemon.errors import DaemonError, LogIOError, MissingInputError
from daemon.queue import control_api as api
from daemon.ranges import LARGEST_AMPLITUDE, SMALLEST_AMPLITUDE
from daemon.words import counted, printable

ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="Configuration file (YAML); default: for a fake robot.")
]
ConfirmOption = Annotated[
    bool, typer.Option("--confirm", help="The arm may move when the queue comes to it; nobody is asked again.")
]
USUAL_PORT = 30200
"""UDP port of a service for which nothing else is said; that of KUKA's own examples."""
_CHECK_POLL_S = 0.3
_CHECK_ALLOWANCE_S = 330.0

Reply = TypeVar("Reply", bound=api.ControlReply)


class _UnexpectedReplyError(DaemonError):
    exit_code = 76


@dataclass(frozen=True, slots=True)
class Connection:
    """Where the service is, and with which keys to speak to it."""

    endpoint: Annotated[
        str | None,
        typer.Option("--endpoint", envvar="IIWA_IDENT_ENDPOINT", help="ipc:///PATH or tcp://HOST:PORT of the service."),
    ] = None
    port: Annotated[
        int | None,
        typer.Option(
            "--port", help=f"UDP port whose service is meant, on this machine; default: {USUAL_PORT}, for `stop` all."
        ),
    ] = None
    key: Annotated[
        Path | None, typer.Option("--key", envvar="IIWA_IDENT_KEY", help="Own secret key (NAME.key_secret).")
    ] = None
    server_key: Annotated[
        Path | None,
        typer.Option("--server-key", envvar="IIWA_IDENT_SERVER_KEY", help="The service's public key (server.key)."),
    ] = None

    def ask(self, request: api.ControlRequest, kind: type[Reply]) -> Reply:
        """The service's answer. Raises ServiceUnreachableError (69), RefusedRequestError."""
        from daemon.queue.control_socket import ask
        from daemon.runtime_folder import default_endpoint

        endpoint = self.endpoint or default_endpoint(USUAL_PORT if self.port is None else self.port)
        reply = ask(endpoint, request, key_file=self.key, server_key_file=self.server_key)
        if not isinstance(reply, kind):
            raise _UnexpectedReplyError(f"The service at {endpoint} answered with {type(reply).__name__}.")
        return reply


def show(reply: msgspec.Struct, json_file: Path | None, text: str) -> None:
    """The reply as JSON where asked for, as text otherwise."""
    if told_in_words(msgspec.to_builtins(reply), json_file):
        data(text)


@app.command()
def daemon(config: ConfigOption = None, arm: ArmOption = None) -> None:
    """Serve one robot: keep the queue of runs and investigations, run one after the other, obey `stop` at any time.

    Ends on SIGTERM or Ctrl-C, after a stop ramp where the arm moves. Jobs stand on the disk and outlive it.

    Example: iiwa-ident daemon --config lab.yaml
    """
    from daemon.queue.server import Service

    Service(settings_of(config, arm), tell=message).run()


@app.command()
@grouped
def submit(
    trajectory: Annotated[Path | None, typer.Argument(help="Trajectory file; without one, the shipped motion.")] = None,
    *,
    periods: Annotated[
        int | None, typer.Option("--periods", min=1, help="Periods to record; default: the service's.")
    ] = None,
    amplitude: Annotated[
        float | None,
        typer.Option(
            "--amplitude", min=SMALLEST_AMPLITUDE, max=LARGEST_AMPLITUDE, help="Fraction; default: the service's."
        ),
    ] = None,
    no_fit: Annotated[bool, typer.Option("--no-fit", help="Record only.")] = False,
    confirm: ConfirmOption = False,
    service: Connection,
    json_file: JsonOption = None,
) -> None:
    """Queue one run and wait for the verdict on its motion; exit code 1 when it is found unsafe.

    Where a real arm would move, you are asked here and now, or say `--confirm`; nobody is asked when its turn comes.

    Example: iiwa-ident submit excitation.json --periods 16
    """
    content = None if trajectory is None else _content(trajectory)
    suffix = ".json" if trajectory is None else trajectory.suffix.lower()
    if suffix not in (".json", ".npz", ".csv"):
        raise typer.BadParameter(f"a trajectory is a .json, .npz or .csv file, not '{suffix}'.")
    status = service.ask(api.GetStatus(), api.StatusReply)
    if status.needs_confirmation and not confirm:
        _confirm_motion(status)
    accepted = service.ask(
        api.SubmitRun(
            trajectory=content,
            suffix=suffix,  # type: ignore[arg-type]  # one of the three, see above
            name="shipped excitation" if trajectory is None else printable(trajectory.name, 200),
            periods=periods,
            amplitude=amplitude,
            fit=False if no_fit else None,
            confirmed=status.needs_confirmation,
        ),
        api.Submitted,
    )
    message(accepted.sentence)
    job = _wait_for_check(service, accepted.job_id)
    show(job, json_file, f"{job.job_id}: {job.phase}. {job.sentence}")
    if job.phase == "refused":
        raise typer.Exit(job.exit_code or 1)


@app.command("submit-investigation")
@grouped
def submit_investigation(
    *,
    go_on: Annotated[
        str | None, typer.Option("--go-on", metavar="JOB", help="Go on with this investigation, which rests.")
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(
            "--budget", metavar="MINUTES", min=0.1, help="Minutes of recorded motion at most; needed to begin."
        ),
    ] = None,
    given: Annotated[
        list[str] | None, typer.Option("--from", metavar="JOB", help="Run of the service at hand; may be repeated.")
    ] = None,
    settle: SettleOption = None,
    done: DoneOption = None,
    added_mass: AddedMassOption = None,
    after_drop: AfterDropOption = False,
    yes: YesOption = False,
    service: Connection,
    json_file: JsonOption = None,
) -> None:
    """Have the service investigate: it thinks by itself, and each motion waits in the queue for `resume`.

    `jobs` shows what the next motion is for; `cancel` of that motion declines it, `stop` ends it.

    Example: iiwa-ident submit-investigation --budget 4
    """
    mass = mass_of(added_mass)
    accepted = service.ask(
        api.SubmitInvestigation(
            job_id=go_on,
            budget_minutes=budget,
            recordings=tuple(given or ()),
            settle=tuple(dict.fromkeys(item.value for item in settle or ())),
            done=done,
            added_mass=None if mass is None else (mass.mass_kg, *mass.place_m),
            after_drop=after_drop,
            unasked=yes,
        ),
        api.Submitted,
    )
    show(accepted, json_file, f"{accepted.job_id}: {accepted.sentence}")


def _content(trajectory: Path) -> bytes:
    try:
        return trajectory.read_bytes()
    except FileNotFoundError as error:
        raise MissingInputError(str(trajectory), "the trajectory") from error
    except OSError as error:
        raise LogIOError(str(trajectory), error) from error


def _confirm_motion(status: api.StatusReply, what: str = "this run") -> None:
    if not sys.stdin.isatty():
        raise typer.BadParameter("the arm will move, and nobody can be asked here: add --confirm if that is meant.")
    message(f"The arm behind {status.bind} WILL MOVE as soon as the queue comes to {what} without being asked again.")
    message("Is the workspace clear, the enabling switch in reach, and the load data of the tool set on the cabinet?")
    agreed("Queue it", abort=True)


def _wait_for_check(service: Connection, job_id: str) -> api.JobView:
    deadline = time.monotonic() + _CHECK_ALLOWANCE_S
    while True:
        job = service.ask(api.GetJobs(job_id=job_id), api.JobsReply).jobs[0]
        if job.phase != "checking" or time.monotonic() > deadline:
            return job
        time.sleep(_CHECK_POLL_S)


@app.command()
@grouped
def status(service: Connection, json_file: JsonOption = None) -> None:
    """What the service does right now.

    Example: iiwa-ident status --json -
    """
    reply = service.ask(api.GetStatus(), api.StatusReply)
    lines = [f"{reply.state}: {reply.sentence}", f"{reply.robot} on UDP {reply.bind}, FRI {reply.fri_version}"]
    show(reply, json_file, "\n".join([*lines, *(f"  {line}" for line in reply.recent)]))


@app.command()
@grouped
def jobs(
    *,
    limit: Annotated[int, typer.Option("--limit", min=1, max=500, help="How many, newest first.")] = 100,
    service: Connection,
    json_file: JsonOption = None,
) -> None:
    """The queue, and what became of earlier runs and investigations.

    Example: iiwa-ident jobs
    """
    reply = service.ask(api.GetJobs(limit=limit), api.JobsReply)
    if told_in_words(msgspec.to_builtins(reply), json_file):
        show_jobs(reply.jobs)


def show_jobs(listed: Sequence[api.JobView]) -> None:
    """Jobs in columns of plain text, one line a job with the folder last.

    On a terminal, sentence and folder stand below the line: a whole folder can then be copied.
    """
    beside = not sys.stdout.isatty()
    heads = ("job", "kind", "phase", "periods", "motion", *(("what happened", "folder") if beside else ()))
    rows = [
        (job.job_id, job.kind, job.phase, "-" if job.periods is None else str(job.periods), job.name)
        + ((job.sentence, job.folder) if beside else ())
        for job in listed
    ]
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    for index, row in enumerate((heads, *rows)):
        data("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
        if not beside and index:
            data(f"  {listed[index - 1].sentence}")
            data(f"  {listed[index - 1].folder}")


@app.command()
@grouped
def resume(
    job: Annotated[list[str] | None, typer.Argument(help="Numbers of held runs; default: all that are held.")] = None,
    *,
    confirm: ConfirmOption = False,
    service: Connection,
    json_file: JsonOption = None,
) -> None:
    """Let runs that are held after a stop, a failed run or a restart take their turn again; it says which first.

    Example: iiwa-ident resume
    """
    state = service.ask(api.GetStatus(), api.StatusReply)
    listed = reversed(service.ask(api.GetJobs(limit=500, held=True), api.JobsReply).jobs)
    waiting = {each.job_id: each for each in listed}
    for number in job or ():
        if number not in waiting:
            raise typer.BadParameter(f"no run {number} is held here; `iiwa-ident jobs` lists those that are.")
    meant = [each for each in waiting.values() if not job or each.job_id in job]
    for each in meant:
        message(f"{each.job_id}: {each.name}, amplitude {each.amplitude:g}, {counted(each.periods or 0, 'period')}.")
    if meant and state.needs_confirmation and not confirm:
        _confirm_motion(state, f"these {len(meant)} runs, one after the other," if len(meant) > 1 else "this run")
    # What was shown, and nothing that was held in the meantime.
    numbers = tuple(each.job_id for each in meant)
    reply = service.ask(api.ResumeQueue(confirmed=state.needs_confirmation, jobs=numbers), api.Resumed)
    show(reply, json_file, reply.sentence)


@app.command()
@grouped
def cancel(
    job: Annotated[str, typer.Argument(help="Number of a job that waits.")],
    service: Connection,
    json_file: JsonOption = None,
) -> None:
    """Take a waiting job out of the queue.

    Example: iiwa-ident cancel 20261121T103000123Z
    """
    reply = service.ask(api.CancelJob(job_id=job), api.Cancelled)
    show(reply, json_file, f"{reply.job_id}: {reply.sentence}")


@app.command()
@grouped
def ping(service: Connection, json_file: JsonOption = None) -> None:
    """Whether the service answers; exit code 69 when not.

    Example: iiwa-ident ping
    """
    reply = service.ask(api.Ping(), api.Pong)
    show(reply, json_file, f"The service answers (process {reply.pid}, version {reply.software_version}).")


@app.command()
def keys(
    out: Annotated[Path, typer.Option("--out", help="Folder for the keys.")],
    client: Annotated[str, typer.Option("--client", help="Name of the client that is to be served.")] = "operator",
    json_file: JsonOption = None,
) -> None:
    """Keys for a service that other machines may reach: the service's pair, once, and one for a client.

    Example: iiwa-ident keys --out keys --client office
    """
    from daemon.queue.keys import create_keys

    made = create_keys(out, client)
    if told_in_words([str(file) for file in made], json_file):
        data_lines(str(file) for file in made)
        message(f"Give {client}.key_secret and server.key to that client alone; everything else stays here.")
