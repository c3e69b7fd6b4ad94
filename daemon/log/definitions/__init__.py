"""The message definitions of the log: the `.msg` texts beside this file, and how they are joined into MCAP schemas.

A schema of encoding `ros2msg` is the text of the message followed by the texts of everything it refers to, each behind
a line of 80 `=` and a line `MSG: package/Name`. The texts of the standard messages are written out here as their
packages define them, so that the log can be read where no ROS is installed. `cdr` packs according to these texts, the
tests decode with two independent libraries.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files

__all__ = ["DIAGNOSTIC_ARRAY", "FRI_COMMAND", "FRI_STATE", "JOINT_STATE", "RUN_EVENT", "STRING", "schema_text"]

FRI_STATE = "iiwa_ident_msgs/msg/FriState"
FRI_COMMAND = "iiwa_ident_msgs/msg/FriCommand"
RUN_EVENT = "iiwa_ident_msgs/msg/RunEvent"
JOINT_STATE = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"

_DEPENDENCIES: dict[str, tuple[str, ...]] = {
    FRI_STATE: ("iiwa_ident_msgs/msg/IoValue", "iiwa_ident_msgs/msg/Transformation"),
    FRI_COMMAND: ("iiwa_ident_msgs/msg/IoValue", "iiwa_ident_msgs/msg/Transformation"),
    RUN_EVENT: (),
    JOINT_STATE: ("std_msgs/msg/Header", "builtin_interfaces/msg/Time"),
    STRING: (),
    DIAGNOSTIC_ARRAY: (
        "std_msgs/msg/Header",
        "builtin_interfaces/msg/Time",
        "diagnostic_msgs/msg/DiagnosticStatus",
        "diagnostic_msgs/msg/KeyValue",
    ),
}


def _text(name: str) -> str:
    return files(__name__).joinpath(name.rsplit("/", 1)[-1] + ".msg").read_text(encoding="utf-8")


@cache
def schema_text(name: str) -> str:
    """Schema text of one message with all texts it depends on. Raises KeyError for a message not known here."""
    parts = [_text(name)]
    for dependency in _DEPENDENCIES[name]:
        package, _, short = dependency.split("/")
        parts.append(f"{'=' * 80}\nMSG: {package}/{short}\n{_text(dependency)}")
    return "".join(parts)
