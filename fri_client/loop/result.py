"""What goes into the loop and what comes out of it: settings, the phases it went through, how it ended.

Value objects, and the sentence that explains an end. The loop process fills the settings from its request and turns
the result into its report.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from fri_client.handover.last_samples import LastSamples
from fri_client.messages import SessionState
from fri_client.motion.program import MotionProgram, StopKind
from fri_client.session.refusal import refusal_sentence
from fri_client.session.session import Session

Outcome = Literal["completed", "stopped", "dropped", "no_robot", "not_started", "version_mismatch", "refused", "fault"]
"""How a run of the loop ended."""


SILENCE_S = 0.5
SIMULATED_SILENCE_S = 10.0
"""A robot that waits for each answer is silent for as long as a busy machine keeps its process waiting."""


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """Time-outs in s and whom to listen to.

    receive_timeout_s: silence that drops a moving session; None: see `silence_s`. start_timeout_s: wait for the first
    message. command_timeout_s: from there to COMMANDING_ACTIVE, in the robot's own time where that is simulated.
    supervisor_timeout_s: age of the supervisor's heartbeat that stops the motion, 0: not watched. robot_host: the only
    address listened to; None: that of the first message. expected_period_s: command period the motion is prepared for
    before the robot has said its own. fake_robot_only: no motion begins unless the robot says of itself that it is the
    fake one; nobody was asked whether an arm may move.
    monitor_only: no motion begins at all; the run lasts until somebody ends it or the robot leaves. test_mode_only: no
    motion begins while the robot says that it is in T2 or AUT. too_fast_for_t1: why none begins while it says that it
    is in T1, as a clause; empty where one may.
    """

    receive_timeout_s: float | None = None
    start_timeout_s: float = 30.0
    command_timeout_s: float = 60.0
    supervisor_timeout_s: float = 2.0
    robot_host: str | None = None
    expected_period_s: float = 0.001
    maximum_ipo_distance_rad: float = 0.1
    fake_robot_only: bool = False
    monitor_only: bool = False
    test_mode_only: bool = False
    too_fast_for_t1: str = ""

    def silence_s(self, *, simulated: bool) -> float:
        """Wall-clock silence that drops a session. simulated: the robot's time is, so that it may pause unharmed."""
        usual = SIMULATED_SILENCE_S if simulated else SILENCE_S
        return usual if self.receive_timeout_s is None else self.receive_timeout_s


@dataclass(slots=True)
class PhaseTicks:
    """A stretch of ticks (handed-over records of fresh samples) in one phase and period."""

    phase: int
    period: int
    first_tick: int
    last_tick: int


@dataclass(slots=True)
class LoopResult:
    """How the loop ended: outcome, the event behind it, one sentence, its joint (from 1) and numbers.

    criterion: of the guard's, where it was one. stop_kind, stop_duration_s: how the arm was brought to rest; overruled:
    commands of the stop that the guard objected to, because the arm did not follow. last_samples: the two seconds
    before an end that was not the planned one. held_back: answers of a motion that did not go out, since two commands
    could have reached one cycle of the robot. message_spacing_ms: see `LinkStatistics`, None in simulated time.
    """

    outcome: Outcome
    reason: str
    sentence: str
    joint: int | None = None
    value: float | None = None
    limit: float | None = None
    tick: int | None = None
    criterion: str = ""
    stop_kind: StopKind | None = None
    stop_duration_s: float = 0.0
    overruled: int = 0
    last_samples: LastSamples | None = None
    standstill_confirmed: bool = False
    late: int = 0
    held_back: int = 0
    message_spacing_ms: float | None = None
    foreign: int = 0
    undecodable: int = 0
    duration_s: float = 0.0
    phases: list[PhaseTicks] = field(default_factory=list)

    def keep_last_samples(self, last: LastSamples) -> None:
        """Take the two seconds before the end, and write into them why it came."""
        last.reason, last.sentence, last.criterion = self.reason, self.sentence, self.criterion
        last.joint, last.value, last.limit, last.tick = self.joint, self.value, self.limit, self.tick
        self.last_samples = last


def explain(
    outcome: Outcome,
    motion: MotionProgram,
    session: Session,
    settings: LoopSettings,
    *,
    hindrance: str,
    refused: Exception | None,
    version: str,
) -> LoopResult:
    """The event behind an outcome, and one sentence with joint and numbers.

    hindrance: why no motion began in COMMANDING_ACTIVE. refused: the error that made the motion impossible. version:
    the sentence of `VersionEvidence`.
    """
    reason, drop = motion.stopping.reason, session.drop
    if settings.monitor_only and outcome in ("completed", "dropped"):
        left = "The robot ended its session." if session.state == SessionState.IDLE else _unheard(session)
        ended = left if reason is None else reason.sentence
        heard = session.counts.fresh
        sentence = f"{ended} {heard} message{'s' * (heard != 1)} came, and no motion was commanded."
        return LoopResult(outcome, outcome if reason is None else reason.code.name, sentence)
    if outcome == "completed":
        driven = motion.periods_completed
        what = "The one period was" if driven == 1 else f"All {driven} periods were"
        sentence = f"{what} driven; the arm was stopped by ramp{_how(motion)}."
        return LoopResult(outcome, outcome, sentence)
    if outcome == "dropped" and drop is not None:
        return LoopResult(outcome, drop.reason.name, drop.sentence(), drop.joint or None, drop.value, drop.limit)
    if refused is not None:
        return LoopResult(outcome, type(refused).__name__, str(refused))
    if reason is not None:
        waited = f"Nothing had moved: {hindrance}." if hindrance else "Nothing had moved."
        after = f"The arm was stopped by ramp{_how(motion)}." if motion.commanded else waited
        if settings.monitor_only:
            after = "No motion was commanded."
        return LoopResult(
            outcome, reason.code.name, f"{reason.sentence} {after}", reason.joint or None, reason.value, reason.limit
        )
    if outcome == "version_mismatch":
        return LoopResult(outcome, outcome, version)
    if outcome == "not_started":
        why = hindrance or f"the session stands in {SessionState(session.state).name}"
        if session.left:
            why += f"; {session.left}"
        waited = f"{settings.command_timeout_s:g} s"
        return LoopResult(outcome, outcome, f"The robot let no motion begin within {waited}: {why}.")
    sentence = (
        f"No FRI message arrived within {settings.start_timeout_s:g} s: "
        "start the FRI application on the robot and check the address it sends to."
    )
    if session.refusal is not None:
        why = refusal_sentence(session.refusal, session.refusal_joint, session.refusal_value)
        sentence = (
            f"FRI messages arrive, but within {settings.start_timeout_s:g} s none could be used: the last one was "
            f"refused because {why}."
        )
    return LoopResult(outcome, outcome, sentence)


def _unheard(session: Session) -> str:
    """How a session ended that nobody closed."""
    sentence = "No message that can be used came from the robot any more."
    if session.refusal is None:
        return sentence
    why = refusal_sentence(session.refusal, session.refusal_joint, session.refusal_value)
    return f"{sentence} {session.counts.refused} were refused, the last one because {why}."


def _how(motion: MotionProgram) -> str:
    if motion.stopping.kind is None:
        return ""
    where = "along its path" if motion.stopping.kind == "path" else "each joint on its own"
    return f", {where}, in {motion.stopping.duration_s:.2f} s"
