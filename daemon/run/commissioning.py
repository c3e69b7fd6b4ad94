"""The commissioning ladder: a motion is driven on a real arm at 0.1 in T1, then at 0.25, 0.5 and its full amplitude.

Here: which amplitude may be driven next, the record of those done, and what a log says about it. A record belongs to
one arm, one trajectory (before the amplitude was applied) and one workspace; a change of any of them begins at the
bottom. Not here: the runs themselves (`service` asks before a run and tells of its end). A robot on a loopback address
is a simulated one and needs no ladder.

FRI does not say which arm it is: an arm is known by the serial number the operator gives, or else by addresses.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import msgspec

from daemon.api import RunOutcome, RunRequest
from daemon.errors import ConfigurationError, DaemonError, LadderError, LogIOError, TooFastForT1Error
from daemon.json_files import read_bytes
from daemon.motion.tip_speed import T1_SPEED_M_S, rounded_up, tip_speed
from daemon.motion.workspace import load_surroundings
from daemon.run.ladder import highest_allowed, needs_ladder
from daemon.run.loop_process import load_table
from daemon.times import now_text


class Rung(msgspec.Struct, frozen=True, kw_only=True):
    """One amplitude of one trajectory on one arm in one workspace; a line of the record once it was completed."""

    arm: str
    trajectory_sha256: str
    workspace_sha256: str
    amplitude: float
    run_id: str = ""
    finished_at: str = ""

    @property
    def ladder(self) -> tuple[str, str, str]:
        """What rungs of one ladder have in common."""
        return self.arm, self.trajectory_sha256, self.workspace_sha256


def rung_of(request: RunRequest) -> Rung:
    """The rung a request stands on. Raises MissingInputError, ConfigurationError for its files."""
    file = Path(request.trajectory_file)
    try:
        # Parsed and written anew: two files of the same motion are the same motion, whatever their layout.
        content = json.dumps(json.loads(read_bytes(file, "trajectory")), sort_keys=True).encode()
    except ValueError as error:
        raise ConfigurationError(f"is no JSON: {error}.", file=str(file), field="trajectory_file") from error
    return Rung(
        arm=f"{request.robot} {request.serial or _address(request)}",
        trajectory_sha256=hashlib.sha256(content).hexdigest(),
        workspace_sha256=_workspace_digest(request),
        amplitude=request.amplitude,
    )


def _workspace_digest(request: RunRequest) -> str:
    """Of the surroundings; an arm on a wall or ceiling stands in others, whatever their file."""
    digest = load_surroundings(request.robot, request.workspace_file).digest
    gravity = request.gravity_m_s2
    return digest if gravity is None else hashlib.sha256(f"{digest} {gravity!r}".encode()).hexdigest()


def is_first_rung(request: RunRequest) -> bool:
    """Whether nothing of this ladder was completed, so that this run is driven in T1. Raises as `admit` does."""
    return needs_ladder(request) and not request.skip_ladder and not _done(request, rung_of(request))


def held_to_modes(request: RunRequest) -> RunRequest:
    """The request with the operation modes in which its motion may not begin. Raises as `admit` does."""
    if request.monitor_only:
        return request
    speed, too_fast = _speed(request), ""
    if speed > T1_SPEED_M_S:
        too_fast = (
            f"the end-effector would reach {rounded_up(speed):.3f} m/s, and the robot is in T1, which allows "
            f"{T1_SPEED_M_S:g} m/s: drive this amplitude in T2 or AUT, or a smaller one"
        )
    return msgspec.structs.replace(request, test_mode_only=is_first_rung(request), too_fast_for_t1=too_fast)


def _done(request: RunRequest, rung: Rung) -> float:
    """The largest amplitude that was completed on the ladder; 0: none yet."""
    return max((line.amplitude for line in _read(ladder_file(request)) if line.ladder == rung.ladder), default=0.0)


def admit(request: RunRequest) -> str:
    """What the operator should know about the ladder before this run; empty where none is needed.

    Raises LadderError (1) for an amplitude whose turn has not come, and TooFastForT1Error (1) for a first one that is
    too fast for T1, unless the request says to skip the ladder.
    """
    if not needs_ladder(request):
        return ""
    rung = rung_of(request)
    done = _done(request, rung)
    allowed = highest_allowed(done)
    if rung.amplitude <= allowed + 1e-9:
        if not done and not request.skip_ladder:
            _check_speed(request)
            return (
                f"Commissioning: amplitude {rung.amplitude:g}, the first run of this motion on this arm: in T1, with "
                "the enabling switch held; the arm does not move in another mode."
            )
        return f"Commissioning: amplitude {rung.amplitude:g}; so far {done:g} was completed on this arm."
    if request.skip_ladder:
        so_far = f"only {done:g}" if done else "nothing yet"
        return f"Commissioning: amplitude {rung.amplitude:g} although {so_far} was completed; the log says so."
    raise LadderError(rung.arm, rung.amplitude, done, allowed)


def _speed(request: RunRequest) -> float:
    """Of the end of the tool along the motion, m/s; 0 for a table that the loop will refuse."""
    table = load_table(request.table_file)
    geometry = load_surroundings(request.robot, request.workspace_file).geometry
    return tip_speed(geometry, table, request.table_period_s) if table.shape[1:] == (7,) else 0.0


def _check_speed(request: RunRequest) -> None:
    speed = _speed(request)
    if speed > T1_SPEED_M_S:
        raise TooFastForT1Error(request.amplitude, rounded_up(speed), T1_SPEED_M_S)


def remember(request: RunRequest, outcome: RunOutcome) -> str:
    """Write down an amplitude that was completed; the sentence for the operator, empty where nothing was to be done.

    outcome: of the motion; a fit that could not be started takes nothing from it.
    """
    if not needs_ladder(request) or outcome.outcome != "completed" or outcome.exit_code:
        return ""
    try:
        rung = msgspec.structs.replace(rung_of(request), run_id=request.run_id, finished_at=now_text())
    except DaemonError as error:
        return f"Commissioning: {error} So this amplitude counts as not done."
    file = ladder_file(request)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        # One line by one write at the end of the file: two runs that end together do not overwrite each other.
        descriptor = os.open(file, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            os.write(descriptor, b"\n" + msgspec.json.encode(rung) + b"\n")
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        return f"Commissioning: {file} cannot be written ({error.strerror}), so this amplitude counts as not done."
    following = highest_allowed(rung.amplitude)
    onward = f"; {following:g} may follow" if rung.amplitude < following else ""
    return f"Commissioning: amplitude {rung.amplitude:g} is completed on this arm{onward}."


def ladder_file(request: RunRequest) -> Path:
    """The record: the request's own, or the user's (XDG_STATE_HOME)."""
    if request.ladder_file is not None:
        return Path(request.ladder_file)
    state = os.environ.get("XDG_STATE_HOME")
    return (Path(state) if state else Path.home() / ".local" / "state") / "iiwa-ident" / "ladder.jsonl"


def _address(request: RunRequest) -> str:
    here = f"{request.bind_host}:{request.bind_port}"
    return f"{request.robot_host} -> {here}" if request.robot_host else f"at {here}"


def _read(file: Path) -> list[Rung]:
    """Completed rungs; a line that cannot be read counts for nothing, which can only forbid."""
    try:
        lines = file.read_bytes().splitlines()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise LogIOError(str(file), error) from error
    rungs = []
    for line in lines:
        try:
            rung = msgspec.json.decode(line, type=Rung)
        except msgspec.DecodeError:
            continue
        if 0.0 < rung.amplitude <= 1.0:
            rungs.append(rung)
    return rungs
