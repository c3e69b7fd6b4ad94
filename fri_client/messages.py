"""The FRI messages as value objects, and the enumerations that belong to them.

Here: what one datagram says, in Python values, named as the wire names its fields (snake_case). Not here: how the
values lie in bytes (`schema`, `codec`), what a client does with them (`session`), JSON (`json_form`).
Everyone who speaks or reads FRI imports this module; it imports nothing of the project but the errors.

The classes are frozen `msgspec.Struct`s: immutable, slotted, compared by value, and built in C. A frozen dataclass of
the ten fields of `MonitorData` takes twenty times as long to build (1.4 µs, not 0.06 µs), and several
are built per millisecond.

Conventions (PROTOCOL section 3): an absent optional field is None, an absent repeated field is an empty tuple.
`JointValues`, `CartesianVector` and the packed arrays are plain tuples of floats. Fields of an enumeration are plain
int, because a value outside the enumeration has to survive decoding; compare them with the IntEnum members.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum

import msgspec

from fri_client.errors import UnknownFriVersion

MONITORING_IDENTIFIER = 0x245142
"""`messageIdentifier` of every monitoring message, robot to client (PROTOCOL section 4)."""

COMMAND_IDENTIFIER = 0x34001
"""`messageIdentifier` of every command message, client to robot (PROTOCOL section 4)."""

JOINT_COUNT = 7
"""Values in every joint array; an array with another number is refused."""


class FriVersion(StrEnum):
    """A version of the FRI wire format; the value is what an operator writes. 1.14, 1.15 and 1.16 are one format."""

    V1_11 = "1.11"
    V1_14 = "1.14"
    V1_15 = "1.15"
    V1_16 = "1.16"
    V2_5 = "2.5"
    V2_7 = "2.7"

    @classmethod
    def parse(cls, text: str) -> FriVersion:
        """The version written as `text`, e.g. "1.15" or "FRI 1.15". Raises UnknownFriVersion."""
        stripped = text.strip().lower().removeprefix("fri").strip().removeprefix("v")
        for version in cls:
            if version.value == stripped:
                return version
        raise UnknownFriVersion(version=text, known=tuple(version.value for version in cls))

    @property
    def major(self) -> int:
        """1 or 2."""
        return int(self.value.split(".")[0])

    @property
    def is_framed(self) -> bool:
        """True where a datagram carries a length and a CRC-32 around the payload (2.7)."""
        return self is FriVersion.V2_7


def name_of(kind: type[IntEnum], value: float | None) -> str:
    """The name of an enumeration's value, the bare number where it has none."""
    if value is None:
        return "not reported"
    try:
        return kind(int(value)).name
    except ValueError:
        return f"{kind.__name__} {int(value)}"


def name_or_number(kind: type[IntEnum], value: float) -> str:
    """The name of an enumeration's value; the number alone where it has none."""
    try:
        return kind(int(value)).name
    except (ValueError, OverflowError):
        return f"{value:g}" if isinstance(value, float) else str(value)


class SessionState(IntEnum):
    """State of the FRI session as the robot sees it."""

    IDLE = 0
    MONITORING_WAIT = 1
    MONITORING_READY = 2
    COMMANDING_WAIT = 3
    COMMANDING_ACTIVE = 4


class ConnectionQuality(IntEnum):
    """The robot's grade of the connection; GOOD and EXCELLENT permit command mode."""

    POOR = 0
    FAIR = 1
    GOOD = 2
    EXCELLENT = 3


class SafetyState(IntEnum):
    """Safety state of the robot. Note the off-by-one: level 0 is 1 on the wire."""

    NORMAL_OPERATION = 0
    SAFETY_STOP_LEVEL_0 = 1
    SAFETY_STOP_LEVEL_1 = 2
    SAFETY_STOP_LEVEL_2 = 3


class OperationMode(IntEnum):
    """T1, T2 or automatic."""

    TEST_MODE_1 = 0
    TEST_MODE_2 = 1
    AUTOMATIC_MODE = 2


class DriveState(IntEnum):
    """State of one joint's drive."""

    OFF = 0
    TRANSITIONING = 1
    ACTIVE = 2


class ControlMode(IntEnum):
    """Controller that is active on the robot."""

    POSITION = 0
    CARTESIAN_IMPEDANCE = 1
    JOINT_IMPEDANCE = 2
    NO_CONTROL = 3


class ClientCommandMode(IntEnum):
    """What the client is asked to command. 1.x calls value 1 POSITION, 2.x calls it JOINT_POSITION; 4 is 2.x only."""

    NO_COMMAND_MODE = 0
    POSITION = 1
    JOINT_POSITION = 1
    WRENCH = 2
    TORQUE = 3
    CARTESIAN_POSE = 4


class OverlayType(IntEnum):
    """Kind of motion overlay the application runs."""

    NO_OVERLAY = 0
    JOINT = 1
    CARTESIAN = 2


FAKE_ROBOT = "iiwa-ident fake robot"
"""What the fake robot that comes with this program announces; in lockstep with `, lockstep` behind it."""


class MessageHeader(msgspec.Struct, frozen=True, gc=False):
    """Identifier and the two uint32 counters every message carries."""

    message_identifier: int
    sequence_counter: int
    reflected_sequence_counter: int


class TimeStamp(msgspec.Struct, frozen=True, gc=False):
    """Robot time: Unix seconds, and nanoseconds since the last second; both uint32."""

    sec: int
    nanosec: int


class RobotInfo(msgspec.Struct, frozen=True, gc=False):
    """State of the robot; drive_state has one entry per joint (at most 7)."""

    number_of_joints: int | None = None
    safety_state: int | None = None
    drive_state: tuple[int, ...] = ()
    operation_mode: int | None = None
    control_mode: int | None = None


class IoValue(msgspec.Struct, frozen=True, gc=False):
    """One input or output: name "Group.Signal" of at most 63 bytes, uint64 or double value (1.14 and later)."""

    name: str
    type: int
    direction: int
    digital_value: int | None = None
    analog_value: float | None = None


class Transformation(msgspec.Struct, frozen=True, gc=False):
    """A named frame in 1.x: matrix is 3 x 4 row-major [R|t], at most 12 values; the unit of t is not published."""

    name: str
    matrix: tuple[float, ...] = ()
    timestamp: TimeStamp | None = None


class QuaternionTransformation(msgspec.Struct, frozen=True, gc=False):
    """A named frame in 2.x: element is [t_x t_y t_z q_w q_x q_y q_z], mm and unit quaternion, at most 7 values."""

    name: str
    element: tuple[float, ...] = ()
    timestamp: TimeStamp | None = None


class RedundancyInformation(msgspec.Struct, frozen=True, gc=False):
    """Redundant degree of freedom of a Cartesian pose (2.x); for E1 the value is the position of joint 3 in rad."""

    strategy: int
    value: float


class Checksum(msgspec.Struct, frozen=True, gc=False):
    """Checksum group of 1.x and 2.5; what it covers is not published."""

    crc32: int | None = None


class EndOfMessageData(msgspec.Struct, frozen=True, gc=False):
    """Closing group of 1.x and 2.5; the vendor's client neither sets nor checks it."""

    message_length: int | None = None
    message_checksum: Checksum | None = None


class MonitorData(msgspec.Struct, frozen=True, gc=False):
    """What the robot measures. Positions in rad, torques in Nm (vendor's sign), each exactly 7 values.

    commanded_joint_position: 1.x only. external_force: 2.7 only, [F_x F_y F_z M_A M_B M_C] in N and Nm.
    measured_cartesian_pose, measured_redundancy_information: 2.x only. read_io_request: 1.14 and later, at most 10.
    """

    measured_joint_position: tuple[float, ...] | None = None
    measured_torque: tuple[float, ...] | None = None
    commanded_joint_position: tuple[float, ...] | None = None
    commanded_torque: tuple[float, ...] | None = None
    external_torque: tuple[float, ...] | None = None
    external_force: tuple[float, ...] | None = None
    read_io_request: tuple[IoValue, ...] = ()
    measured_cartesian_pose: QuaternionTransformation | None = None
    measured_redundancy_information: RedundancyInformation | None = None
    timestamp: TimeStamp | None = None


class ConnectionInfo(msgspec.Struct, frozen=True, gc=False):
    """Session state and connection quality; send_period in ms; a receive_multiplier of 0 and of 1 both mean each."""

    session_state: int
    quality: int
    send_period: int | None = None
    receive_multiplier: int | None = None


class IpoData(msgspec.Struct, frozen=True, gc=False):
    """What the motion interpolator commands; joint_position (rad) is present in the commanding states only."""

    joint_position: tuple[float, ...] | None = None
    cartesian_pose: QuaternionTransformation | None = None
    redundancy_information: RedundancyInformation | None = None
    client_command_mode: int | None = None
    overlay_type: int | None = None
    tracking_performance: float | None = None


class MonitoringMessage(msgspec.Struct, frozen=True, gc=False):
    """One datagram from the robot.

    requested_transformations: Transformation in 1.x, QuaternionTransformation in 2.x; at most 5. announcement: what a
    fake robot says of itself; no cabinet sends the field.
    """

    header: MessageHeader
    robot_info: RobotInfo | None = None
    monitor_data: MonitorData | None = None
    connection_info: ConnectionInfo | None = None
    ipo_data: IpoData | None = None
    requested_transformations: tuple[Transformation | QuaternionTransformation, ...] = ()
    end_of_message_data: EndOfMessageData | None = None
    announcement: str | None = None

    @property
    def is_of_fake_robot(self) -> bool:
        """Whether no arm moves: the sender says so itself, its address says nothing."""
        return (self.announcement or "").startswith(FAKE_ROBOT)

    @property
    def is_simulated_time(self) -> bool:
        """Whether the robot waits for each answer and its time stamps are all the time there is."""
        return (self.announcement or "") == f"{FAKE_ROBOT}, lockstep"


class CommandData(msgspec.Struct, frozen=True, gc=False):
    """What the client commands: joint_position in rad (7), joint_torque in Nm (7), wrench in N and Nm (at most 6)."""

    joint_position: tuple[float, ...] | None = None
    cartesian_wrench_feed_forward: tuple[float, ...] | None = None
    joint_torque: tuple[float, ...] | None = None
    commanded_transformations: tuple[Transformation | QuaternionTransformation, ...] = ()
    write_io_request: tuple[IoValue, ...] = ()
    cartesian_pose: QuaternionTransformation | None = None
    redundancy_information: RedundancyInformation | None = None


class CommandMessage(msgspec.Struct, frozen=True, gc=False):
    """One datagram to the robot."""

    header: MessageHeader
    command_data: CommandData | None = None
    end_of_message_data: EndOfMessageData | None = None
