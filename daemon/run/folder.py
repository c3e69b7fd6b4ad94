"""The folder of a run before anything is started: room in it, inputs copied, paths absolute, port free.

The supervisor calls `prepare_folder`; the command line `make_room` before it writes the inputs there, and
`kept_once_begun` around both.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import msgspec

from daemon.api import LAST_SAMPLES_NAME, REPORT_NAME, RUN_NAME, RunOutcome, RunRequest
from daemon.errors import ConfigurationError, DaemonError, LogIOError, MissingInputError
from daemon.folders import make_folder
from daemon.json_files import read_json, write_json
from daemon.log.cdr import JOINT_NAMES
from daemon.log.parts import RECORDING_NAME, state_of_recording
from daemon.run.log_inputs import DESCRIPTION_NAME
from daemon.run.loop_process import bind
from daemon.run.spare_folder import set_earlier_aside
from fri_client.loop.channel import UdpChannel
from identification.export.kinematic_urdf import kinematic_urdf
from identification.robots import BUILT_IN_ROBOTS, load_robot

_BEFORE_MOTION = ("no_robot", "not_started", "version_mismatch", "port_in_use", "refused")
_AT_REST = ("WAITING", "LATCHED", "DONE")
_WRITTEN = ("trajectory.json", "workspace.yaml", "model.json")
"""Files of a run that an operator may have under the same names; model.json is the fit's."""
_RESULTS = (REPORT_NAME, LAST_SAMPLES_NAME, RUN_NAME)


def prepare_folder(request: RunRequest) -> RunRequest:
    """Copy the inputs into the run's folder, describe a built-in arm in a URDF, make all paths absolute, write
    request.json; the resolved request.

    Raises ConfigurationError (also for a folder that holds a run already), MissingInputError, PortInUseError,
    LogIOError.
    """
    # Whether the port is free is said before anything is written or started.
    with UdpChannel() as probe:
        bind(probe, request.bind_host, request.bind_port)
    folder = Path(request.out_dir).absolute()
    make_room(folder)
    changes: dict[str, str] = {"out_dir": str(folder)}
    sources = {}
    if not request.monitor_only:
        sources = {"table_file": request.table_file, "trajectory_file": request.trajectory_file}
    if request.urdf_file is not None:
        sources["urdf_file"] = request.urdf_file
    for field, file in sources.items():
        source = Path(file).absolute()
        if not source.is_file():
            raise MissingInputError(str(source), field.removesuffix("_file"))
        changes[field] = str(folder / source.name)
    try:
        make_folder(folder)
        for field, file in sources.items():
            if Path(file).absolute() != Path(changes[field]):
                shutil.copyfile(file, changes[field])
        if request.urdf_file is None and request.robot in BUILT_IN_ROBOTS:
            urdf = kinematic_urdf(load_robot(request.robot), joint_names=JOINT_NAMES)
            (folder / DESCRIPTION_NAME).write_text(urdf, encoding="utf-8")
        resolved = msgspec.structs.replace(request, **changes)
        set_earlier_aside(resolved)
        write_json(folder / "request.json", resolved)
    except OSError as error:
        raise LogIOError(str(folder), error) from error
    return resolved


@contextlib.contextmanager
def kept_once_begun(folder: Path) -> Iterator[None]:
    """Take back what the block put into a run's folder, and the folder, where it fails and left no run in it.

    A start that got so far that it left a recording or an account keeps it: `make_room` knows what to do with both.
    """
    folder = folder.absolute()
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    before = set() if missing else set(folder.iterdir())
    try:
        yield
    except BaseException:
        if state_of_recording(folder) == "none" and not (folder / RUN_NAME).exists():
            with contextlib.suppress(OSError):
                for file in set(folder.iterdir()) - before:
                    file.unlink()
                for place in missing:
                    place.rmdir()
        raise


def make_room(folder: Path) -> None:
    """See to it that a run may write into the folder, before anything is written there.

    A folder is for one run. What a start left at which nothing moved (a silent robot, another FRI version, a stop while
    waiting) is moved into failed-start-N within it, so that the same command can be given again. Raises
    ConfigurationError, which says what to do about a run that was broken off, and LogIOError.
    """
    state = state_of_recording(folder)
    if state == "recording":
        raise ConfigurationError(
            f"{folder} holds a run that is being recorded; choose another folder.", field="out_dir"
        )
    if _nothing_moved_in(folder):
        _set_aside(folder)
        return
    if state == "broken":
        raise ConfigurationError(
            f"{folder} holds a run that was broken off; `iiwa-ident recover {shlex.quote(str(folder))}` makes its "
            "recording whole. Choose another folder for the new run.",
            field="out_dir",
        )
    for name in (RECORDING_NAME, RUN_NAME):
        if (folder / name).exists():
            raise ConfigurationError(f"{folder} holds a run already ({name}); choose another folder.", field="out_dir")


def keep_inputs(folder: Path, *inputs: Path | None) -> None:
    """Raise ConfigurationError where the run would write over a file that it is given: a cell would lose its tool."""
    own = {os.path.realpath(folder / name) for name in _WRITTEN}
    for file in inputs:
        if file is not None and os.path.realpath(file) in own:
            raise ConfigurationError(
                f"the run would write its own {file.name} over it; choose another folder with --out.", file=str(file)
            )


def nothing_moved(outcome: RunOutcome) -> bool:
    """True where a run's account says that no command of a motion was sent, and nothing was to be watched."""
    loop, request = outcome.loop, outcome.request
    if request is not None and request.monitor_only and outcome.samples:
        return False  # whatever led the arm: it is in the recording
    if loop is None or outcome.outcome in _BEFORE_MOTION:
        return outcome.outcome in _BEFORE_MOTION
    only_waited = bool(loop.phases) and all(span.phase in _AT_REST for span in loop.phases)
    return not loop.answered or (outcome.outcome == "stopped" and only_waited)


def _nothing_moved_in(folder: Path) -> bool:
    try:
        return nothing_moved(read_json(folder / RUN_NAME, RunOutcome))
    except DaemonError:
        return False


def _set_aside(folder: Path) -> None:
    number = 1 + len(list(folder.glob("failed-start-*")))
    aside = folder / f"failed-start-{number}"
    try:
        aside.mkdir()
        # run.json last: while it stands there, the rest can be moved again.
        for file in (*folder.glob("recording*.mcap"), *folder.glob("*.log"), *(folder / name for name in _RESULTS)):
            if file.is_file():
                file.rename(aside / file.name)
    except OSError as error:
        raise LogIOError(str(aside), error) from error
