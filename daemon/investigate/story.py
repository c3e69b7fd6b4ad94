"""The story of an investigation as a page: what was known, what was asked and why, what came of it; the verdict on top.

Value objects in, a document out (`identification.report.document`); nothing is decided here. Written after each rest.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from daemon.investigate.account import Account, Alive, Named, Recorded, Step
from daemon.investigate.motions import prediction_of
from daemon.investigate.states import State
from daemon.json_files import write_bytes_atomically
from daemon.words import counted
from identification.investigation.equivalences import unasked
from identification.investigation.hypotheses import NOTHING, describe
from identification.mismatch.between_recordings import one_a_line
from identification.mismatch.effects.base import Place
from identification.report.document import Block, Document, Facts, Figure, Line, Panel, Paragraph, Section, Table, Tone
from identification.report.page import render

NAME = "story.html"
TITLES: dict[State, str] = {
    State.SETTLED: "Settled",
    State.NEEDS_ACTION: "No motion settles this: something about the arm has to change",
    State.UNDECIDED: "Open: no motion of this arm would tell more",
    State.OUT_OF_BUDGET: "Open: the time is used",
    State.BLOCKED: "Open: no motion that would tell more is safe here",
    State.DECLINED: "Open: the motion was declined",
    State.PLANNED: "Planned, not driven",
    State.INTERRUPTED: "Broken off; everything recorded is kept",
    State.DROPPED: "The robot dropped out, or its standstill is unconfirmed; nothing moves until somebody says so",
}
_SHOWN, _PANELS = 6, 3
_BOX, _TICKED = "☐", "☑"
_AGREES = 1e-3
"""Chance from which on sizes of several recordings count as one, as in the diagnosis."""


def write_story(folder: Path, account: Account) -> Path:
    """Write the page beside the account."""
    file = folder / NAME
    write_bytes_atomically(str(file), render(story_of(account)).encode())
    return file


def story_of(account: Account) -> Document:
    """The page of an account."""
    title = TITLES.get(account.state, account.state.value.replace("_", " ").capitalize())
    tone: Tone = "good" if account.state is State.SETTLED else "attention"
    sections = [_now(account), *(_chapter(account, number) for number in range(len(account.recordings)))]
    if account.steps:
        sections.append(_unasked(account))
    if any(item.motion is not None and item.motion.forecast is not None for item in account.recordings):
        sections.append(_reckoning(account))
    return Document("Investigation", title, tuple(sections), tone)


def _now(account: Account) -> Section:
    blocks: list[Block] = []
    if account.sentence:
        blocks.append(Paragraph(account.sentence, "lead"))
    blocks += [Paragraph(f"{_BOX} {text}", "warning") for text in account.actions]
    if account.pending is not None and account.state not in (State.SETTLED, State.PLANNED):
        blocks.append(Paragraph(f"Next: {account.pending.purpose}, {account.pending.seconds:.0f} s."))
    blocks.append(
        Facts(
            (
                ("Motion recorded", f"{account.used_s / 60.0:.1f} of {account.budget_s / 60.0:.1f} minutes"),
                ("Recordings", str(len(account.recordings))),
                ("Robot", account.robot),
                ("Seed", str(account.seed)),
            )
        )
    )
    if len(account.steps) > 1:
        blocks.append(_course(account))
    return Section("verdict", "Verdict", tuple(blocks))


def _unasked(account: Account) -> Section:
    """What no motion shows: settled by an action, or a box to tick."""
    blocks = [Paragraph(f"{_TICKED} {item.sentence}", "note") for item in account.told if item.settled]
    blocks += [Paragraph(f"{_BOX} {text}", "note") for text in unasked(account.wanted)]
    return Section("no-motion", "What no motion shows", tuple(blocks))


def _course(account: Account) -> Figure:
    """Probability of each hypothesis that ever led or was named, over the recordings; 1 once it is named alone."""
    recordings = np.array([step.recordings for step in account.steps], dtype=np.float64)
    courses = [_probabilities(step) for step in account.steps]
    led = [_words(step.alive[0]) for step in account.steps]
    named = [_words(item) for step in account.steps for item in step.findings]
    # "Nothing more" is said beside whatever has a name: it is drawn where nothing ever had one.
    every = dict.fromkeys([*named, *led])
    words = [name for name in every if name != NOTHING.name] or list(every)
    panels = []
    for name in sorted(words, key=lambda name: -max(course.get(name, 0.0) for course in courses))[:_PANELS]:
        course = np.array([each.get(name, 0.0) for each in courses])
        text = ", ".join(f"{value:.2f} after {count:.0f}" for value, count in zip(course, recordings, strict=True))
        lines = tuple(Line("fitted", recordings, course, marks=marks) for marks in ("dots", "line"))
        title = name[:1].upper() + name[1:]
        panels.append(Panel(title, "recordings", "probability", lines, f"{name}: {text}", chances=True))
    return Figure(
        "Probability of whatever led or was named, after each recording; a name that stands alone counts as one.",
        tuple(panels),
    )


def _probabilities(step: Step) -> dict[str, float]:
    """Of each hypothesis by its words after a step."""
    alive = {_words(item): item.probability for item in reversed(step.alive)}
    return alive | {_words(item): 1.0 for item in step.findings if not item.alternatives}


def _words(item: Alive | Named) -> str:
    """An effect with its joint; without one, the name less the joints in brackets, which find no room over a panel."""
    if isinstance(item, Alive) and item.effect is None:
        return item.name.split(" (")[0]
    return describe(item.effect, Place(item.joint))


def _chapter(account: Account, number: int) -> Section:
    """One recording: why it was made, and what was known after it."""
    recorded = account.recordings[number]
    step = next((item for item in account.steps if item.recordings == number + 1), None)
    blocks: list[Block] = [Paragraph(_why(recorded))]
    if recorded.action is not None:
        # The diagnosis is of the arm as it was before, so that it says nothing new.
        told = [item.sentence for item in account.told if item.recording == number + 1]
        blocks += [Paragraph(text) for text in told]
    elif step is not None:
        blocks += _known(step, last=step is account.steps[-1])
    elif number == 0:
        blocks.append(Paragraph("A second motion is needed before a name can be checked.", "note"))
    title = "given" if recorded.motion is None else recorded.motion.purpose
    return Section(f"recording-{number + 1}", f"Recording {number + 1}: {title}", tuple(blocks))


def _why(recorded: Recorded) -> str:
    motion = recorded.motion
    if motion is None:
        return f"Given: {recorded.file}."
    text = f"{counted(motion.periods, 'period')}, {motion.seconds:.0f} s of motion."
    if motion.forecast is not None:
        text += f" {prediction_of(motion)}"
    return text


def _known(step: Step, *, last: bool) -> list[Block]:
    first = step.alive[0].log_odds
    rows = tuple(
        (item.name.capitalize(), f"{100 * item.probability:.1f} %", f"{first - item.log_odds:z.1f}")
        for item in step.alive[:_SHOWN]
    )
    blocks: list[Block] = [
        Paragraph(step.answer),
        Table("Hypotheses alive beside what is settled", ("hypothesis", "probability", "nats behind the first"), rows),
    ]
    blocks += [Paragraph(f"Open: {text}", "note") for text in step.questions]
    if last and step.verdict != "explained":
        blocks += [Paragraph(text, "note") for text in one_a_line(step.remaining)]
    blocks += [Paragraph(text, "note") for text in step.day_terms]
    blocks += [Paragraph(_agreement(name, chance), "note") for name, chance in step.agreements]
    return blocks


def _agreement(name: str, chance: float) -> str:
    if chance >= _AGREES:
        return f"The size of {name} agrees between the recordings (chance {chance:.2g})."
    return (
        f"The size of {name} DIFFERS between the recordings (chance {chance:.1g}): it changes with time or "
        "temperature, the torque has another form, or the recordings are not of one arm."
    )


def _reckoning(account: Account) -> Section:
    """Forecast against outcome."""
    rows = []
    for number, recorded in enumerate(account.recordings, start=1):
        motion = recorded.motion
        step = next((item for item in account.steps if item.recordings == number), None)
        if motion is None or motion.forecast is None or step is None:
            continue
        outcome = f"{step.alive[0].name} stands out" if step.stands_out else "not told apart"
        if named := [f"{item.effect.replace('_', ' ')} named" for item in step.findings if not item.alternatives]:
            outcome = ", ".join(named)
        elif step.stands_out and step.alive[0].effect is not None:
            outcome += ", not named yet"
        rows.append((str(number), motion.kind.replace("_", " "), f"{motion.seconds:.0f} s",
                     f"{100 * motion.forecast:.0f} %", outcome))  # fmt: skip
    head = ("recording", "motion", "time", "predicted", "came out")
    table = Table("Forecast against outcome", head, tuple(rows), "words")
    return Section("forecasts", "Forecasts and what came of them", (table,))
