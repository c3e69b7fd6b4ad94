"""The typed messages that the project's processes exchange as JSON files: run requests, reports, worker jobs.

Only data lives here: msgspec structures, JSON-serialisable, unknown fields refused. What travels over ZeroMQ while a
run goes on is in `control_messages`. The supervisor (`service`), the loop process, the recorder, the worker and the
command line import this module; it imports nothing of theirs.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from daemon.errors import ConfigurationError
from daemon.ranges import reason_against
from safety.limits import EXTERNAL_TORQUE_THRESHOLD_NM

LoopOutcome = Literal[
    "completed",  # all periods done, standstill confirmed
    "stopped",  # a stop ramp before the end: guard, operator, lost recorder or supervisor, external torque
    "dropped",  # the robot left COMMANDING_ACTIVE by itself: latched
    "no_robot",  # no monitoring message within start_timeout_s
    "not_started",  # messages came, but the session never reached COMMANDING_ACTIVE
    "version_mismatch",  # datagrams came, none was of the FRI version asked for
    "port_in_use",  # the UDP port could not be bound
    "refused",  # the request itself cannot be run (table, limits, ramp)
    "fault",  # an internal error; `reason` has its text
]
EXIT_CODES: dict[LoopOutcome, int] = {
    "completed": 0,
    "stopped": 1,
    "dropped": 1,
    "no_robot": 69,
    "not_started": 69,
    "port_in_use": 69,
    "version_mismatch": 76,
    "refused": 65,
    "fault": 70,
}
"""Of the process, for each outcome of its loop (contract)."""
RUN_NAME, REPORT_NAME, LAST_SAMPLES_NAME = "run.json", "loop_report.json", "last_samples.json"
"""Files in the folder of a run: its account, the loop's report, the seconds around an end that was not planned."""
AUTO_VERSION = "auto"
"""In place of an FRI version: the supervisor listens to the robot first."""
FitPipeline = Literal["auto", "periodic", "paper", "aperiodic"]
_FitPhase = Literal["queued", "loading", "averaging", "fitting", "validating", "writing"]
WorkerPhase = _FitPhase | Literal["diagnosing", "done", "failed"]


class Message(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all: immutable, keywords only, unknown fields refused."""


# ---- what to do ------------------------------------------------------------------------------------------------------


class RunRequest(Message, frozen=True, kw_only=True):
    """Everything one acquisition needs; written as `request.json` into the run's folder and into the log.

    table_file: `.npy`, (N, 7) float64, rad: one period of commanded joint positions on the grid `table_period_s`, with
    `amplitude` ALREADY applied (it is recorded, not applied again). trajectory_file: JSON of the trajectory behind the
    table. Files are absolute paths once `run_acquisition` has copied them into `out_dir`.
    lead_in_s: the last seconds of the period that are driven before the first recorded period, s.
    receive_timeout_s: silence that counts as a lost session, s; None: 0.5 s, and 10 s where the robot's time is
    simulated. start_timeout_s: longest wait for the first monitoring message, s; command_timeout_s: longest wait from
    there to COMMANDING_ACTIVE, s.
    external_torque_limit: Nm per joint, |external torque| beyond it stops the motion; None = not watched. By default
    generous: a run that pushes against something ends, a quick motion with the right load data does not.
    maximum_distance_to_measured: rad, guard on |command − measured position|.
    robot_host: only datagrams of this address are taken; None = the first sender is taken and kept.
    fri_version: "auto" until the supervisor has heard the robot.
    supervisor_timeout_s: the loop stops by ramp when the supervisor's heartbeat is older, s; 0 = not watched.
    workspace_file: YAML with floor, walls, boxes, tool and margins; None = a floor at the mounting face alone.
    ladder_file: record of the amplitudes done (None: the user's own); serial: which arm it is, where addresses do not
    tell arms apart; skip_ladder: an amplitude may be skipped, which the log then says.
    simulation: only a robot that says it is the fake one is moved; nobody is asked, and there is no ladder.
    model_file: model.json that predicted the torque, None = what is taken to be known of the arm; live views show it.
    diagnose: the fit is followed by a diagnosis; heldout: recordings of other motions that check its names.
    gravity_m_s2: in the frame of the base, None: the arm stands on a floor.
    monitor_only: nothing is commanded, table_file and trajectory_file are empty, and the run lasts until somebody ends
    it, the robot ends its session or is silent for receive_timeout_s.
    test_mode_only: the motion begins in T1 alone; set by the supervisor for the first rung of the ladder.
    too_fast_for_t1: why it does not begin in T1, as a clause; set by the supervisor, empty: it may.
    """

    run_id: str
    robot: str
    table_file: str
    trajectory_file: str
    out_dir: str
    table_period_s: float = 0.001
    periods: int = 16
    lead_in_s: float = 1.0
    amplitude: float = 1.0
    bind_host: str = "127.0.0.1"
    bind_port: int = 30200
    robot_host: str | None = None
    fri_version: str = "1.15"
    receive_timeout_s: float | None = None
    start_timeout_s: float = 30.0
    command_timeout_s: float = 60.0
    supervisor_timeout_s: float = 2.0
    external_torque_limit: tuple[float, ...] | None = EXTERNAL_TORQUE_THRESHOLD_NM
    maximum_distance_to_measured: float = 0.1
    urdf_file: str | None = None
    tool: str = "none"
    seed: int | None = None
    fit: bool = True
    fit_pipeline: FitPipeline = "auto"
    diagnose: bool = False
    heldout: tuple[str, ...] = ()
    ring_slots: int = 16384
    realtime_priority: int = 80
    loop_cpu: int | None = None
    simulation: bool = False
    workspace_file: str | None = None
    ladder_file: str | None = None
    skip_ladder: bool = False
    serial: str | None = None
    model_file: str | None = None
    gravity_m_s2: tuple[float, float, float] | None = None
    monitor_only: bool = False
    test_mode_only: bool = False
    too_fast_for_t1: str = ""

    def __post_init__(self) -> None:
        """Raise ConfigurationError naming the first field that cannot be right."""
        for name in self.__struct_fields__:
            if (reason := reason_against(name, getattr(self, name))) is not None:
                raise ConfigurationError(reason, field=name)


class RecorderJob(Message, frozen=True, kw_only=True):
    """What one recorder process writes: `part` 0 is recording.mcap, 1 that of its replacement."""

    request: RunRequest
    path: str
    part: int = 0


class WorkerJob(Message, frozen=True, kw_only=True):
    """One detached fit: recordings in, model.json out, `status_file` rewritten atomically on the way.
    diagnosis_folder: where a diagnosis goes after the fit, None for none; heldout: recordings that check its names.
    progress_endpoint: read from older runs, and not used.
    """

    job_id: str
    recordings: tuple[str, ...]
    robot: str
    model_file: str
    status_file: str
    pipeline: FitPipeline = "auto"
    diagnosis_folder: str | None = None
    heldout: tuple[str, ...] = ()
    progress_endpoint: str | None = None


# ---- what happened ---------------------------------------------------------------------------------------------------


class PhaseSpan(Message, frozen=True, kw_only=True):
    """One motion phase: its name (`MotionPhase`), period (0-based, −1 outside excitation), first and last tick."""

    phase: str
    period: int = -1
    first_tick: int = -1
    last_tick: int = -1


class Histogram(Message, frozen=True, kw_only=True):
    """Counts per bin; bin i holds edges[i] <= x < edges[i+1], the last bin is open. edges in µs."""

    edges_us: tuple[float, ...] = ()
    counts: tuple[int, ...] = ()


class LoopReport(Message, frozen=True, kw_only=True):
    """What the loop process saw and did; written as `loop_report.json` into the run's folder.

    received: monitoring datagrams decoded; answered: commands sent; late: answered after the send period; held_back:
    answers of the motion that did not go out, since two commands could have reached one cycle of the robot;
    message_spacing_ms: mean time from one message to the next, by the robot's counter, null in simulated time;
    missing: gaps in the robot's sequence counter; duplicates, stale (older than one already seen), refused (decoded,
    but not usable: non-finite position, too few joints), undecodable; foreign: datagrams of another sender;
    lost_in_handover: samples that found the ring full. Peaks per joint of what was commanded: rad, rad/s, rad/s²,
    rad/s³; not in loop_report.json, since the judge of the finished recording tells them (run.json).
    reason: machine-readable cause (name of an EventCode, or the outcome); criterion: the guard's, where it was one.
    sentence: for the operator. stop_kind: the stop kept to the "path", slowed, or was one of each joint on its own
    ("joint_space"); stop_duration_s: from the last command of the motion to the first at rest; overruled: commands of
    the stop that the guard objected to, because the arm did not follow. last_samples: rows in last_samples.json.
    """

    outcome: LoopOutcome
    reason: str
    sentence: str
    joint: int | None = None
    value: float | None = None
    limit: float | None = None
    tick: int | None = None
    criterion: str = ""
    stop_kind: Literal["path", "joint_space"] | None = None
    stop_duration_s: float = 0.0
    overruled: int = 0
    last_samples: int = 0
    standstill_confirmed: bool = False
    received: int = 0
    answered: int = 0
    late: int = 0
    held_back: int = 0
    message_spacing_ms: float | None = None
    missing: int = 0
    duplicates: int = 0
    stale: int = 0
    refused: int = 0
    undecodable: int = 0
    foreign: int = 0
    lost_in_handover: int = 0
    send_period_ms: float | None = None
    turn_around: Histogram = Histogram()
    jitter: Histogram = Histogram()
    peak_command_position: tuple[float, ...] = ()
    peak_command_velocity: tuple[float, ...] = ()
    peak_command_acceleration: tuple[float, ...] = ()
    peak_command_jerk: tuple[float, ...] = ()
    phases: tuple[PhaseSpan, ...] = ()
    periods_completed: int = 0
    duration_s: float = 0.0
    realtime: dict[str, Any] = {}
    link: dict[str, Any] = {}


class FileDigest(Message, frozen=True, kw_only=True):
    """A file of the run folder: name relative to it, size and SHA-256."""

    name: str
    bytes: int
    sha256: str


class RunOutcome(Message, frozen=True, kw_only=True):
    """The result of one acquisition, also written as `run.json`. exit_code as in the contract; sentences for people.

    judgement: what `iiwa-ident judge` says of the recording; empty where it could not be judged.
    """

    run_id: str
    outcome: LoopOutcome
    exit_code: int
    sentences: tuple[str, ...]
    out_dir: str
    recordings: tuple[str, ...] = ()
    samples: int = 0
    samples_in_periods: int = 0
    sequence_gaps: int = 0
    handover_gaps: int = 0
    loop: LoopReport | None = None
    files: tuple[FileDigest, ...] = ()
    software: dict[str, str] = {}
    request: RunRequest | None = None
    started_at: str = ""
    finished_at: str = ""
    worker_pid: int | None = None
    worker_status_file: str | None = None
    commissioning: dict[str, str] = {}
    judgement: dict[str, Any] = {}


class RunEvent(Message, frozen=True, kw_only=True):
    """One thing worth telling the operator while the run goes on.

    kind: "starting", "waiting", "preflight", "session", "phase", "progress", "warning", "stopping", "finished" or
    "worker".
    period and periods are filled for "progress" and "phase"; missing counts sequence gaps so far.
    port: UDP port of the run, under which its live view is found; 0: not known.
    """

    kind: str
    sentence: str
    phase: str = ""
    period: int = -1
    periods: int = 0
    samples: int = 0
    missing: int = 0
    lost_in_handover: int = 0
    port: int = 0


class WorkerStatus(Message, frozen=True, kw_only=True):
    """State of a fit job as it stands in its status file.

    diagnosis_error: why the diagnosis after a fit that succeeded gave nothing; the job is "done" all the same.
    """

    job_id: str
    phase: WorkerPhase
    sentence: str
    fraction: float = 0.0
    pid: int = 0
    started_at: str = ""
    updated_at: str = ""
    model_file: str | None = None
    exit_code: int | None = None
    diagnosis_error: str | None = None
