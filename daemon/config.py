"""The configuration file: YAML, every key known, every mistake named by field and file.

Here: the structure, its checks, and the way into a run request. Not here: what the settings mean to the loop (see
`RunRequest`). The command line and the long-running service read it.

    robot: iiwa14
    fri:
      version: "1.15"
      bind_host: 192.170.10.1
      bind_port: 30200
      robot_host: 192.170.10.2
    run:
      periods: 16
      tool: none
    realtime:
      priority: 80
      cpu: 3
    output: /data/runs
"""

from __future__ import annotations

import ipaddress
import re
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import msgspec

from daemon.api import AUTO_VERSION, FitPipeline
from daemon.endpoints import endpoint_reason
from daemon.errors import ConfigurationError
from daemon.json_files import read_bytes
from daemon.ranges import reason_against
from fri_client.errors import UnknownFriVersion
from fri_client.messages import FriVersion
from safety.errors import LimitsError
from safety.limits import EXTERNAL_TORQUE_THRESHOLD_NM, limits_for

MAXIMUM_BYTES = 1_000_000

_Settings = TypeVar("_Settings", bound=msgspec.Struct)


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all sections: immutable, unknown keys refused."""


class FriSettings(_Section, frozen=True, kw_only=True):
    """The link. bind_host, bind_port: where we listen; robot_host: the only sender accepted (none: the first).

    version: "auto" listens to the robot before each run. real_robot: a cabinet is relayed to a loopback address.
    Timeouts in s, as in RunRequest.
    """

    version: str = "1.15"
    bind_host: str = "127.0.0.1"
    bind_port: int = 30200
    robot_host: str | None = None
    real_robot: bool = False
    receive_timeout_s: float | None = None
    start_timeout_s: float = 30.0
    command_timeout_s: float = 60.0


class RunSettings(_Section, frozen=True, kw_only=True):
    """What is driven and how it is stopped. external_torque_limit: Nm per joint; none = not watched. workspace_file,
    serial, gravity_m_s2: as in RunRequest.
    """

    periods: int = 16
    amplitude: float = 1.0
    lead_in_s: float = 1.0
    tool: str = "none"
    urdf_file: str | None = None
    workspace_file: str | None = None
    serial: str | None = None
    gravity_m_s2: tuple[float, float, float] | None = None
    external_torque_limit: tuple[float, ...] | None = EXTERNAL_TORQUE_THRESHOLD_NM
    maximum_distance_to_measured: float = 0.1
    fit: bool = True
    fit_pipeline: FitPipeline = "auto"


class RealtimeChoice(_Section, frozen=True, kw_only=True):
    """priority: SCHED_FIFO 1 to 90, 0 = none; cpu: the processor kept for the loop; ring_slots: samples buffered."""

    priority: int = 80
    cpu: int | None = None
    ring_slots: int = 16384


class ControlSettings(_Section, frozen=True, kw_only=True):
    """Where the long-running service is spoken to, and by whom.

    endpoint: ipc:///PATH or tcp://ADDRESS:PORT; none: a socket in the user's private folder, named after the UDP port.
    server_key: file of the service's secret key; authorised_clients: folder with the public keys of those it serves.
    Both or none; needed for every address that other machines can reach.
    """

    endpoint: str | None = None
    server_key: str | None = None
    authorised_clients: str | None = None


class ArmSettings(_Section, frozen=True, kw_only=True):
    """What one of several arms has of its own, as in the sections `fri` and `run`; None: as the file says for all."""

    robot: str | None = None
    bind_host: str | None = None
    bind_port: int | None = None
    robot_host: str | None = None
    version: str | None = None
    serial: str | None = None
    tool: str | None = None
    workspace_file: str | None = None
    gravity_m_s2: tuple[float, float, float] | None = None


class DaemonConfig(_Section, frozen=True, kw_only=True):
    """The whole file. arms: several robots by name; what they have in common stands in the other sections."""

    robot: str = "iiwa14"
    fri: FriSettings = FriSettings()
    run: RunSettings = RunSettings()
    realtime: RealtimeChoice = RealtimeChoice()
    control: ControlSettings = ControlSettings()
    output: str = "runs"
    arms: dict[str, ArmSettings] = {}

    def of_arm(self, name: str) -> DaemonConfig:
        """The configuration of one arm of `arms`, which has none of its own any more. Raises KeyError."""
        own = {key: value for key, value in msgspec.structs.asdict(self.arms[name]).items() if value is not None}
        robot = own.pop("robot", self.robot)
        link = {key: own.pop(key) for key in FriSettings.__struct_fields__ if key in own}
        return msgspec.structs.replace(
            self,
            robot=robot,
            fri=msgspec.structs.replace(self.fri, **link),
            run=msgspec.structs.replace(self.run, **own),
            arms={},
        )

    @property
    def is_simulation(self) -> bool:
        """Whether only the fake robot is moved: on a loopback address, unless a cabinet is relayed to it."""
        return ipaddress.ip_address(self.fri.bind_host).is_loopback and not self.fri.real_robot

    def request_fields(self) -> dict[str, Any]:
        """The fields of RunRequest that this configuration decides."""
        link = msgspec.structs.asdict(self.fri)
        del link["real_robot"]
        return {
            "robot": self.robot,
            "fri_version": parse_version(link.pop("version")),
            **link,
            **msgspec.structs.asdict(self.run),
            "realtime_priority": self.realtime.priority,
            "loop_cpu": self.realtime.cpu,
            "ring_slots": self.realtime.ring_slots,
        }


def load_config(path: str | Path, arm: str | None = None) -> DaemonConfig:
    """Read and check a configuration file; of one arm, where it names several, all of which are checked.

    Raises MissingInputError (66), or ConfigurationError (78) naming file and field: no YAML, an unknown key, a value of
    the wrong kind or out of range, an arm that the file does not name, or none where it names several.
    """
    config = read_settings(path, DaemonConfig, "the configuration")
    if arm is None and not config.arms:
        _check(config, str(path))
        return config
    for name in config.arms:
        _check(config.of_arm(name), f"{path}, arm {name}")
    _check_serials(config, str(path))
    if arm not in config.arms:
        names = ", ".join(config.arms) or "none"
        said = "no arm is named" if arm is None else f"there is no arm '{arm}'"
        raise ConfigurationError(f"{said}; the file has {names}: choose with --arm.", file=str(path), field="arms")
    return config.of_arm(arm)


def _check_serials(config: DaemonConfig, file: str) -> None:
    """Raises ConfigurationError where arms at different addresses have one serial number, by which ladders are kept."""
    seen: dict[str, tuple[str, tuple[str | None, str, int]]] = {}
    for name in config.arms:
        own = config.of_arm(name)
        address = (own.fri.robot_host, own.fri.bind_host, own.fri.bind_port)
        if own.run.serial is None:
            continue
        first, known = seen.setdefault(own.run.serial, (name, address))
        if known != address:
            raise ConfigurationError(
                f"arm {first} and arm {name} are at different addresses and have one serial number, "
                f"'{own.run.serial}': what one of them completed would count for the other; give each its own.",
                file=file,
                field=f"arms.{name}.serial",
            )


def parse_version(text: str) -> str:
    """A version of FRI as requests carry it, or "auto": the robot is listened to first. Raises UnknownFriVersion."""
    return AUTO_VERSION if text.strip().lower() == AUTO_VERSION else FriVersion.parse(text).value


def read_settings(path: str | Path, kind: type[_Settings], purpose: str) -> _Settings:
    """A YAML file as a structure that knows all its keys; an empty file gives the defaults. Raises as load_config."""
    file = Path(path)
    data = read_bytes(file, purpose)
    if len(data) > MAXIMUM_BYTES:
        raise ConfigurationError(f"has {len(data)} bytes; that is no configuration file.", file=str(file))
    if not data.strip():
        return kind()
    try:
        settings = msgspec.yaml.decode(data, type=kind)
        twice = _named_twice(data)
    except msgspec.ValidationError as error:
        text, _, place = str(error).partition(" - at `")
        if place.startswith("key` in"):
            text, place = "a key is no text; inside braces a value with commas in it needs quotes", place[8:]
        elif text.startswith("Expected `str") and text.endswith(("`int`", "`float`", "`bool`")):
            text += "; it needs quotes"
        elif text.startswith("Object contains unknown field"):
            text = f"there is no field {text.split()[-1]}; there are {', '.join(_keys_at(place, kind))}"
        place = _with_its_name(place.strip("`$."), data, kind)
        raise ConfigurationError(f"{text}.", file=str(file), field=place or _key_in(text)) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigurationError(f"is no YAML: {' '.join(str(error).split())}.", file=str(file)) from error
    if twice is not None:
        key, line = twice
        raise ConfigurationError(
            f"the key stands there twice, again in line {line}; what stands under the first would not count.",
            file=str(file),
            field=key,
        )
    return settings


def _with_its_name(place: str, data: bytes, kind: type[Any]) -> str:
    """A place in the file with the name of the entry in place of the dots that stand for any of them."""
    section, dots, rest = place.partition("[...]")
    entries = msgspec.yaml.decode(data).get(section) if dots else None
    for name, entry in entries.items() if isinstance(entries, dict) else ():
        try:
            msgspec.convert({section: {name: entry}}, type=kind)
        except msgspec.ValidationError:
            return f"{section}.{name}{rest}"
    return place


def _keys_at(place: str, kind: type[Any]) -> tuple[str, ...]:
    """The keys of the section at a place of the file, which msgspec calls as in `$.arms[...]` or `$.walls[0]`."""
    for name in re.findall(r"[a-z]\w*", place):
        hint = get_type_hints(kind)[name]
        kind = next(part for part in (*get_args(hint), hint) if hasattr(part, "__struct_fields__"))
    return tuple(kind.__struct_fields__)


def _named_twice(data: bytes) -> tuple[str, int] | None:
    """The first key that a mapping of a YAML file names again, with its line from 1; the reader would take the last."""
    import yaml

    left, seen = [yaml.compose(data, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))], set()
    while left:
        node = left.pop()
        if not isinstance(node, yaml.CollectionNode) or id(node) in seen:
            continue
        seen.add(id(node))
        if not isinstance(node, yaml.MappingNode):
            left.extend(node.value)
            continue
        keys: set[str] = set()
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in keys:
                    return key.value, key.start_mark.line + 1
                keys.add(key.value)
            left.append(value)
    return None


def _key_in(text: str) -> str | None:
    """The key between backquotes in a message about the file's top level."""
    parts = text.split("`")
    return parts[1] if len(parts) > 2 and "field" in parts[0] else None


def _check(config: DaemonConfig, file: str) -> None:
    fri, run = config.fri, config.run

    def refuse(field: str, reason: str) -> ConfigurationError:
        return ConfigurationError(reason, file=file, field=field)

    sections = {f"{name}.": msgspec.structs.asdict(getattr(config, name)) for name in ("fri", "run", "control")}
    for section, values in {"": {"output": config.output}, **sections}.items():
        for name, value in values.items():
            if value == "":
                raise refuse(f"{section}{name}", "is empty; leave the key out where there is none.")
            if isinstance(value, str) and "\0" in value:
                raise refuse(f"{section}{name}", "holds a zero byte, which no name of a file has.")
    try:
        limits_for(config.robot)
    except LimitsError as error:
        raise refuse("robot", str(error)) from error
    try:
        parse_version(fri.version)
    except UnknownFriVersion as error:
        raise refuse("fri.version", str(error)) from error
    for section in ("fri", "run", "realtime"):
        for name, value in msgspec.structs.asdict(getattr(config, section)).items():
            if (wrong := reason_against(name, value)) is not None:
                raise refuse(f"{section}.{name}", wrong)
    if fri.robot_host is None and not config.is_simulation:
        raise refuse(
            "fri.robot_host",
            f"through {fri.bind_host} a real arm is moved: name the address that its messages come from, the only one "
            "listened to.",
        )
    if (config.control.server_key is None) != (config.control.authorised_clients is None):
        raise refuse("control.server_key", "control.server_key and control.authorised_clients belong together.")
    if config.control.endpoint is not None:
        reason = endpoint_reason(config.control.endpoint, with_keys=config.control.server_key is not None)
        if reason:
            raise refuse("control.endpoint", reason)
    if run.gravity_m_s2 is not None:
        from identification.errors import RobotError
        from identification.robots.installation import Installation

        try:
            Installation(run.gravity_m_s2)
        except RobotError as error:
            raise refuse("run.gravity_m_s2", str(error)) from error
