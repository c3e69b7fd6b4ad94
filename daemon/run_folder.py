"""The folder of a run before anything is started: inputs copied, paths absolute, port free. The supervisor calls it."""

from __future__ import annotations

import errno
import shutil
import socket
from pathlib import Path

import msgspec

from daemon.api import RunRequest
from daemon.errors import ConfigurationError, LogIOError, MissingInputError, PortInUseError
from daemon.json_files import write_json
from daemon.log.cdr import JOINT_NAMES
from daemon.log.parts import RECORDING_NAME, state_of_recording
from daemon.log_inputs import DESCRIPTION_NAME
from identification.export import kinematic_urdf
from identification.robots import BUILT_IN_ROBOTS, load_robot

__all__ = ["prepare_folder"]


def prepare_folder(request: RunRequest) -> RunRequest:
    """Copy the inputs into the run's folder, describe a built-in arm in a URDF, make all paths absolute, write
    request.json; the resolved request.

    Raises ConfigurationError (also for a folder that holds a run already), MissingInputError, PortInUseError,
    LogIOError.
    """
    folder = Path(request.out_dir).absolute()
    _refuse_used(folder)
    changes: dict[str, str] = {"out_dir": str(folder)}
    sources = {"table_file": request.table_file, "trajectory_file": request.trajectory_file}
    if request.urdf_file is not None:
        sources["urdf_file"] = request.urdf_file
    for field, file in sources.items():
        source = Path(file).absolute()
        if not source.is_file():
            raise MissingInputError(str(source), field.removesuffix("_file"))
        changes[field] = str(folder / source.name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for field, file in sources.items():
            if Path(file).absolute() != Path(changes[field]):
                shutil.copyfile(file, changes[field])
        if request.urdf_file is None and request.robot in BUILT_IN_ROBOTS:
            urdf = kinematic_urdf(load_robot(request.robot), joint_names=JOINT_NAMES)
            (folder / DESCRIPTION_NAME).write_text(urdf, encoding="utf-8")
        resolved = msgspec.structs.replace(request, **changes)
        write_json(folder / "request.json", resolved)
    except OSError as error:
        raise LogIOError(str(folder), error) from error
    _check_port(request)
    return resolved


def _refuse_used(folder: Path) -> None:
    """A folder is for one run. Raises ConfigurationError, which says what to do about one that was broken off."""
    state = state_of_recording(folder)
    if state == "recording":
        raise ConfigurationError(
            f"{folder} holds a run that is being recorded; choose another folder.", field="out_dir"
        )
    if state == "broken":
        raise ConfigurationError(
            f"{folder} holds a run that was broken off; `iiwa-ident recover {folder}` makes its recording whole. "
            "Choose another folder for the new run.",
            field="out_dir",
        )
    for name in (RECORDING_NAME, "run.json"):
        if (folder / name).exists():
            raise ConfigurationError(f"{folder} holds a run already ({name}); choose another folder.", field="out_dir")


def _check_port(request: RunRequest) -> None:
    """Find out before any process is started whether the port is free. Raises PortInUseError, ConfigurationError."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((request.bind_host, request.bind_port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise PortInUseError(request.bind_host, request.bind_port) from error
            raise ConfigurationError(
                f"UDP {request.bind_host}:{request.bind_port} cannot be bound: {error.strerror}.", field="bind_host"
            ) from error
