"""What clients and the long-running service say to each other: one tagged union each way, JSON, checked on both sides.

Here: the structures, their limits and the two decoders. Not here: sockets (`control_socket`) and what is done about a
request (`server`). Every message names the version of this interface; unknown tags, unknown fields, values out of range
and anything longer than `MAXIMUM_REQUEST_BYTES` are refused. No request carries a path: what the service reads and
writes is decided by its configuration alone.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

from daemon.api import Message
from daemon.errors import DaemonError
from daemon.motion.tool import FARTHEST_M, HEAVIEST_KG
from daemon.ranges import LARGEST_AMPLITUDE, SMALLEST_AMPLITUDE
from daemon.words import printable

API_VERSION = 1
MAXIMUM_REQUEST_BYTES = 8 * 1024 * 1024
"""A table of 10 s at 1 kHz as text is some 1.5 MB."""

JobKind = Literal["run", "fit", "investigation"]
JobPhase = Literal[
    "checking",  # its motion is being checked for the first time
    "queued",  # waits for its turn
    "held",  # waits for the operator's `resume`; of an investigation: its next motion does
    "preparing",  # its motion is checked once more
    "running",  # acquisition or fit is under way, an investigation thinks or its motion is driven
    "done",
    "refused",  # found unsafe or unusable, nothing moved
    "stopped",  # the motion ended early; the partial recording is kept
    "failed",
    "interrupted",  # the service ended during the motion; never resumed
    "cancelled",
]

_Name = Annotated[str, Meta(max_length=200, pattern=r"^[^\x00-\x1f\x7f-\x9f]*\Z")]
_JobId = Annotated[str, Meta(pattern=r"^[0-9A-Za-z_-]{1,64}\Z")]
_Mass = Annotated[float, Meta(ge=0.0, le=HEAVIEST_KG)]
_Place = Annotated[float, Meta(ge=-FARTHEST_M, le=FARTHEST_M)]


class _Request(Message, frozen=True, kw_only=True):
    api: Literal[1] = 1


class Ping(_Request, frozen=True, kw_only=True, tag="ping"):
    """Is anybody there."""


class GetStatus(_Request, frozen=True, kw_only=True, tag="status"):
    """What is going on."""


class GetJobs(_Request, frozen=True, kw_only=True, tag="jobs"):
    """The newest jobs, at most `limit` of them, or the one named.

    held: only runs that wait for `resume`, and those that will once their check has ended.
    """

    job_id: _JobId | None = None
    held: bool = False
    limit: Annotated[int, Meta(ge=1, le=500)] = 100


class SubmitRun(_Request, frozen=True, kw_only=True, tag="submit"):
    """Queue one run. trajectory: the file's bytes (none: the shipped excitation) with its kind; periods, amplitude,
    fit: none = as configured.

    confirmed: somebody said that the arm may move when the queue comes to this job, without being asked again.
    """

    trajectory: Annotated[bytes, Meta(max_length=5 * 1024 * 1024)] | None = None
    suffix: Literal[".json", ".npz", ".csv"] = ".json"
    name: _Name = "shipped excitation"
    periods: Annotated[int, Meta(ge=1, le=10_000)] | None = None
    amplitude: Annotated[float, Meta(ge=SMALLEST_AMPLITUDE, le=LARGEST_AMPLITUDE)] | None = None
    fit: bool | None = None
    confirmed: bool = False


class SubmitInvestigation(_Request, frozen=True, kw_only=True, tag="investigate"):
    """Begin an investigation, or go on with one that rests (job_id).

    budget_minutes: of motion; needed to begin. recordings: runs of this service that are at hand, the first to be
    fitted, the second to check names on. settle, done, added_mass (kg, and m from the flange; 0 kg: off again),
    after_drop: as the options of `investigate`. unasked: its motions take their turn without an operator's `resume`;
    on a fake robot only.
    """

    job_id: _JobId | None = None
    budget_minutes: Annotated[float, Meta(gt=0.0, le=600.0)] | None = None
    recordings: Annotated[tuple[_JobId, ...], Meta(max_length=20)] = ()
    settle: Annotated[tuple[Literal["gain", "load"], ...], Meta(max_length=2)] = ()
    done: Literal["turn_tool", "warm_up", "level_base"] | None = None
    added_mass: tuple[_Mass, _Place, _Place, _Place] | None = None
    after_drop: bool = False
    unasked: bool = False


class StopMotion(_Request, frozen=True, kw_only=True, tag="stop"):
    """Ramp down now; whatever waits is held."""


class ResumeQueue(_Request, frozen=True, kw_only=True, tag="resume"):
    """Let held runs take their turn again. confirmed: as for SubmitRun. jobs: these alone; None: all that are held."""

    confirmed: bool = False
    jobs: tuple[_JobId, ...] | None = None


class CancelJob(_Request, frozen=True, kw_only=True, tag="cancel"):
    """Take a job that waits out of the queue."""

    job_id: _JobId


ControlRequest: TypeAlias = (
    Ping | GetStatus | GetJobs | SubmitRun | SubmitInvestigation | StopMotion | ResumeQueue | CancelJob
)


# ---- replies


class _Reply(Message, frozen=True, kw_only=True):
    api: int = API_VERSION


class JobView(Message, frozen=True, kw_only=True):
    """One job as clients see it. folder: where its files are; exit_code: of one that has ended."""

    job_id: str
    kind: JobKind
    phase: JobPhase
    sentence: str
    name: str
    folder: str
    submitted_at: str = ""
    updated_at: str = ""
    periods: int | None = None
    amplitude: float | None = None
    exit_code: int | None = None


class Pong(_Reply, frozen=True, kw_only=True, tag="pong"):
    """Here I am."""

    pid: int
    software_version: str


class StatusReply(_Reply, frozen=True, kw_only=True, tag="status"):
    """What the service does, and the link it serves. moves_an_arm: false on a loopback address, which no cabinet can
    reach; needs_confirmation then says whether submissions have to be confirmed. run, fit: job ids; the numbers belong
    to the run. investigation: job id of the one that thinks. malformed: requests that could not be read, so far.
    """

    state: str
    sentence: str
    pid: int
    software_version: str
    started_at: str
    robot: str
    bind: str
    fri_version: str
    needs_confirmation: bool
    run: str | None = None
    fit: str | None = None
    investigation: str | None = None
    waiting: int = 0
    held: int = 0
    motion_phase: str = ""
    period: int = -1
    periods: int = 0
    samples: int = 0
    missing: int = 0
    lost_in_handover: int = 0
    malformed: int = 0
    recent: tuple[str, ...] = ()


class JobsReply(_Reply, frozen=True, kw_only=True, tag="jobs"):
    """The newest jobs, newest first; total: how many there are."""

    jobs: tuple[JobView, ...]
    total: int


class Submitted(_Reply, frozen=True, kw_only=True, tag="submitted"):
    """The job's number; whether its motion is safe is found out next."""

    job_id: str
    sentence: str


class Stopped(_Reply, frozen=True, kw_only=True, tag="stopped"):
    """What the stop did. was_moving: a run was under way; already: it had been asked to stop before."""

    was_moving: bool
    already: bool
    run: str | None
    held: int
    sentence: str


class Resumed(_Reply, frozen=True, kw_only=True, tag="resumed"):
    """How many held runs wait for their turn again."""

    released: int
    sentence: str


class Cancelled(_Reply, frozen=True, kw_only=True, tag="cancelled"):
    """The job is out of the queue."""

    job_id: str
    sentence: str


class ErrorReply(_Reply, frozen=True, kw_only=True, tag="error"):
    """Why a request was not done. code: for programs; exit_code: for the command line (CONTRACT)."""

    code: str
    sentence: str
    exit_code: int


ControlReply: TypeAlias = Pong | StatusReply | JobsReply | Submitted | Stopped | Resumed | Cancelled | ErrorReply


class RefusedRequestError(DaemonError):
    """A request that is not done. Carries the reply's code."""

    def __init__(self, code: str, sentence: str, exit_code: int) -> None:
        self.code = code
        self.exit_code = exit_code
        super().__init__(sentence)


class _Header(msgspec.Struct):
    """The part of a message that every version of this interface has."""

    api: int | None = None


_header_decoder = msgspec.json.Decoder(_Header)
_request_decoder: msgspec.json.Decoder[ControlRequest] = msgspec.json.Decoder(ControlRequest)
_reply_decoder: msgspec.json.Decoder[ControlReply] = msgspec.json.Decoder(ControlReply)
_UNREADABLE = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)


def require_length(data: bytes) -> None:
    """Raises RefusedRequestError for a request that no service reads; its socket does not even answer."""
    if len(data) > MAXIMUM_REQUEST_BYTES:
        raise RefusedRequestError(
            "too_long",
            f"The request has {len(data)} bytes; at most {MAXIMUM_REQUEST_BYTES} are read. Is its file a "
            "trajectory? A table of a motion is smaller as .npz.",
            65,
        )


def decode_request(data: bytes) -> ControlRequest:
    """The request behind the bytes. Raises RefusedRequestError, whatever the bytes are."""
    require_length(data)
    try:
        version = _header_decoder.decode(data).api
        if version != API_VERSION:
            raise RefusedRequestError(
                "unsupported_version",
                f"The request names another version of this interface than {API_VERSION}, which is spoken here.",
                76,
            )
        return _request_decoder.decode(data)
    except _UNREADABLE as error:
        raise RefusedRequestError("bad_request", f"The request cannot be read: {printable(str(error))}.", 65) from error


def decode_reply(data: bytes) -> ControlReply:
    """The service's reply. Raises RefusedRequestError (76) for anything that is none of this version."""
    try:
        return _reply_decoder.decode(data)
    except _UNREADABLE as error:
        raise RefusedRequestError(
            "bad_reply", f"What answers there does not speak version {API_VERSION}: {printable(str(error))}.", 76
        ) from error
