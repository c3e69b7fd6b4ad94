"""What the doctor says about a link: who sends what, in which state and version, how well, and how it takes answers.

Here: verdicts on an observation, pure. Not here: the listening (`link_observation`), host and network (`doctor`).

The grade, from what the robot's own counter and send period promise:

    A   nothing lost, 99 % of the messages within 1/4 send period of their time
    B   at most 0.1 % lost, 99 % within 1/2 send period
    C   at most 1 % lost, 99 % within one send period
    D   worse, or silent for the last half second
"""

from __future__ import annotations

import statistics
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

from daemon.doctor.host_checks import DoctorCheck
from daemon.doctor.link_observation import LinkObservation, Mirror
from daemon.doctor.load_check import check_load_at_rest
from daemon.words import counted
from fri_client.handover.ring import Disposition
from fri_client.messages import ConnectionQuality, MonitoringMessage, SessionState, name_or_number
from fri_client.session.refusal import Refusal, refusal_sentence
from fri_client.session.session import Session
from fri_client.wire.version_guess import VersionGuess, guess_version

STALE_S = 0.5
"""No send period is longer than 0.1 s; a last message older than this means that the sender stopped."""
FEWEST_TO_GRADE = 10
_NEWEST = 500
_STOPPED_REMEDY = (
    "find out why the robot stopped sending: its application has ended, which it also does where it wants to command "
    "and nobody answers; for this test it should stay in monitoring."
)


@dataclass(frozen=True, slots=True)
class Heard:
    """A datagram: when it came, in s since the start, from which address and port, and what it looks like."""

    at_s: float
    sender: tuple[str, int]
    guess: VersionGuess


def check_link(observation: LinkObservation, host: str, port: int) -> list[DoctorCheck]:
    """Who sends what: source, FRI version, state, age of the last message, regularity and loss, with a grade."""
    if not observation.datagrams:
        return [_silence(observation, host, port)]
    everything = [Heard(at, sender, guess_version(datagram)) for at, sender, datagram in observation.datagrams]
    messages = [each for each in everything if each.guess.candidates]
    if not messages:
        senders = ", ".join(sorted({each.sender[0] for each in everything}))
        sentence = f"{counted(len(everything), 'datagram')} arrived from {senders}, but no FRI monitoring message."
        return [DoctorCheck("robot", "failed", sentence, "find out which program sends to this port.")]
    # As in a run, one address and port is the robot: counters of two have nothing to do with each other.
    robot = Counter(each.sender for each in messages[-_NEWEST:]).most_common(1)[0][0]
    others = sorted({f"{each.sender[0]}:{each.sender[1]}" for each in everything if each.sender != robot})
    messages = [each for each in messages if each.sender == robot]
    guess = messages[-1].guess
    age = observation.duration_s - messages[-1].at_s
    remedy = ""
    if others:
        remedy = "let only one robot send to this port, or name it in the run: --robot-host ADDRESS."
    if age > STALE_S:
        remedy = _STOPPED_REMEDY
    seconds = f"{observation.duration_s:.1f} s"
    sentence = f"{counted(len(messages), 'message')} in {seconds} from {robot[0]}, the last {age:.2f} s ago."
    if others:
        also = ", ".join(others[:3]) + ("" if len(others) <= 3 else f" and {len(others) - 3} more")
        sentence += f" They came from port {robot[1]}; others send here too: {also}."
    checks = [
        DoctorCheck("robot", "warning" if remedy else "ok", sentence, remedy),
        DoctorCheck(
            "FRI version",
            "ok" if len(guess.candidates) == 1 else "warning",
            guess.sentence(),
            "" if len(guess.candidates) == 1 else "look the version up in the robot's Sunrise project.",
        ),
        _state_check(guess, answered=observation.mirror is not None),
        grade_link(messages, observation.duration_s),
    ]
    if observation.mirror is not None:
        checks.append(_answers(observation.mirror))
    usable, trouble = _usable(messages)
    load = check_load_at_rest(usable)
    return [*checks, *(check for check in (trouble, load) if check is not None)]


def _usable(heard: list[Heard]) -> tuple[list[MonitoringMessage], DoctorCheck | None]:
    """Of the newest messages those that a run would use, and what is wrong with others; None where nothing is."""
    session, usable = Session(), []
    known, refused, why = 0, 0, ""
    for each in heard[-_NEWEST:]:
        message = each.guess.message
        if message is None:
            continue
        known += 1
        if session.judge(message, round(each.at_s * 1e9)) != Disposition.REFUSED or session.refusal == Refusal.COUNTER:
            usable.append(message)
            continue
        refused += 1
        why = refusal_sentence(session.refusal or 0, session.refusal_joint, session.refusal_value)
    if not refused:
        return usable, None
    sentence = f"{refused} of the newest {counted(known, 'message')} cannot be used, the last one because {why}."
    return usable, DoctorCheck("messages", "failed", sentence, "look at the cabinet; a run uses no such message.")


def _silence(observation: LinkObservation, host: str, port: int) -> DoctorCheck:
    sentence = f"No message arrived on {host}:{port} within {observation.duration_s:.1f} s."
    if host.startswith("127."):
        remedy = (
            f"no real robot reaches {host}: for one, give --bind ADDRESS:{port} with this machine's address on the "
            "robot's network. Without a robot: start `iiwa-ident fake-robot` beside this."
        )
    else:
        remedy = (
            f"start the FRI application on the robot and let it send to {host}, port {port}; then look at cable, "
            "address of the robot (`ping`) and firewall."
        )
    return DoctorCheck("robot", "failed", sentence, remedy)


def _state_check(guess: VersionGuess, *, answered: bool) -> DoctorCheck:
    connection = None if guess.message is None else guess.message.connection_info
    if connection is None:
        return DoctorCheck("session", "warning", "The messages carry no session state.", "open the session again.")
    state = name_or_number(SessionState, connection.session_state)
    quality = name_or_number(ConnectionQuality, connection.quality)
    period = f"{connection.send_period} ms" if connection.send_period else "unknown"
    remark = "" if answered else " (nobody answered, so the quality says nothing)"
    sentence = f"State {state}, quality {quality}{remark}, send period {period}."
    if connection.send_period and connection.send_period > 5:
        return DoctorCheck("session", "warning", sentence, "set the send period to 1 ms on the robot.")
    return DoctorCheck("session", "ok", sentence)


def grade_link(heard: list[Heard], duration_s: float) -> DoctorCheck:
    """Grade A to D of the link from loss, regularity of arrival and age (rules: see the module's text).

    heard: messages of one robot, duration_s: how long it was listened to.
    """
    arrivals, counters, periods = [], [], []
    for each in heard:
        message = each.guess.message
        if message is None:
            continue
        arrivals.append(each.at_s)
        counters.append(message.header.sequence_counter)
        if message.connection_info is not None and message.connection_info.send_period:
            periods.append(message.connection_info.send_period * 1e-3)
    if len(arrivals) < FEWEST_TO_GRADE:
        few = f"Only {counted(len(arrivals), 'message')}: too few to grade the link."
        return DoctorCheck("link", "warning", few, "listen for longer: --listen 10.")
    intervals = [after - before for before, after in pairwise(arrivals)]
    steps = [(after - before) % 2**32 for before, after in pairwise(counters)]
    period = statistics.median(periods) if periods else statistics.median(intervals)
    lost = sum(step - 1 for step in steps if 1 < step < 2**31)
    share = lost / (len(arrivals) + lost)
    deviations = sorted(
        abs(interval - period * max(step, 1)) for interval, step in zip(intervals, steps, strict=True) if step < 2**31
    )
    p99 = deviations[min(len(deviations) - 1, int(0.99 * len(deviations)))] if deviations else period
    age = duration_s - arrivals[-1]
    if age > STALE_S:
        grade = "D"
    elif not lost and p99 <= 0.25 * period:
        grade = "A"
    elif share <= 0.001 and p99 <= 0.5 * period:
        grade = "B"
    elif share <= 0.01 and p99 <= period:
        grade = "C"
    else:
        grade = "D"
    silence = f", but silent for the last {age:.1f} s" if age > STALE_S else ""
    sentence = (
        f"Grade {grade}: {len(arrivals)} messages, {lost or 'none'} lost, 99 % within {p99 * 1e3:.2f} ms of their "
        f"time, longest pause {max(intervals) * 1e3:.1f} ms{silence}."
    )
    if grade in "AB":
        return DoctorCheck("link", "ok", sentence)
    if age > STALE_S:
        remedy = _STOPPED_REMEDY
    elif grade == "C":
        remedy = "close other programs and mend the warnings about this machine, then look again."
    else:
        remedy = (
            "use a direct cable from the robot's KONI port to a network card of this machine (no switch, no USB "
            "adapter), a real-time kernel, and close other programs."
        )
    return DoctorCheck("link", "failed" if grade == "D" else "warning", sentence, remedy)


def _answers(mirror: Mirror) -> DoctorCheck:
    """How the robot took the answers: the quality it came to, and how fast they were."""
    name = "answered link"
    if mirror.version is None:
        sentence = "Nothing was answered: the bytes do not tell the FRI version."
        return DoctorCheck(name, "warning", sentence, "name the version: --answer --fri-version 1.15.")
    commanding = (
        f" {counted(mirror.not_answered, 'message')} came in a commanding state, which is not answered here."
        if mirror.not_answered
        else ""
    )
    if not mirror.delays_s:
        sentence = f"No message could be answered as FRI {mirror.version.value}.{commanding}"
        return DoctorCheck(name, "warning", sentence, "look at state and version above.")
    delays = sorted(mirror.delays_s)
    p99 = delays[min(len(delays) - 1, int(0.99 * len(delays)))]
    course = " → ".join(
        f"{name_or_number(ConnectionQuality, quality)} at {at:.1f} s" for at, quality in mirror.qualities[:5]
    )
    sentence = (
        f"{counted(len(delays), 'message')} answered, 99 % within {p99 * 1e3:.2f} ms; the robot's verdict: "
        f"{course}.{commanding}"
    )
    if max(quality for _, quality in mirror.qualities) >= ConnectionQuality.GOOD:
        return DoctorCheck(name, "ok", sentence)
    remedy = "the robot lets nobody command below GOOD: mend the warnings about link and machine, then look again."
    return DoctorCheck(name, "failed", sentence, remedy)
