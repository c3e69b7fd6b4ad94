"""An investigation whose mathematics and motions are scripted: for claims about the loop alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np

from daemon.investigate.account import Account, Motion, Recorded, save
from daemon.investigate.loop import Drive, Driver, Investigation
from identification.excitation import iiwa_limits
from identification.investigation.choice import Choice, Design
from identification.investigation.experiments import Room, experiment
from identification.investigation.forecast import Forecast
from identification.investigation.hypotheses import NOTHING

ROOM = Room(iiwa_limits("iiwa14"), np.zeros(7))


class ScriptedDriver:
    """Drives nothing: each motion ends as the script says, and leaves a file."""

    def __init__(self, *outcomes: str, objection: str = "") -> None:
        self.outcomes, self.driven, self._objection = list(outcomes), 0, objection

    def objection(self, trajectory: Path) -> str:
        assert trajectory.is_file()
        return self._objection

    def drive(self, motion: Motion, trajectory: Path, folder: Path) -> Drive:
        del motion, trajectory
        self.driven += 1
        outcome = self.outcomes.pop(0) if self.outcomes else "recorded"
        if outcome == "kill":
            raise KeyboardInterrupt
        folder.mkdir(parents=True)
        (folder / "recording.npz").write_bytes(b"")
        return Drive(outcome, folder / "recording.npz", f"It was {outcome}.")  # type: ignore[arg-type]

    def stated(self) -> None:
        return None

    def ended(self, folder: Path) -> Drive | None:
        file = folder / "recording.npz"
        if (folder / "dropped").is_file():
            return Drive("dropped", file, "It was dropped.")
        return Drive("recorded", file, "It was whole.") if file.is_file() else None


def scripted_study(settled_after: int) -> Any:
    """A study that is settled once there are so many recordings."""

    def of(self: Investigation) -> Any:
        count = len(self.account.recordings)
        found = experiment(np.random.default_rng(1), ROOM, "two_speeds", 3)
        choice = Choice(found, 4, Forecast(0.9, 0.1, None, np.zeros((1, 1))))
        open_ = count < settled_after
        return SimpleNamespace(
            settled=not open_,
            answer="An answer.",
            agreements=(("a spring", 0.4), ("a delay", 1e-5)),
            day_terms=(SimpleNamespace(sentence="Joint 2: friction fell."),),
            questions=(SimpleNamespace(sentence="A or B?"),) if open_ else (),
            assessment=SimpleNamespace(alive=(replace(NOTHING, probability=1.0),)),
            diagnosis=SimpleNamespace(verdict="explained", findings=(), remaining="", classes=()),
            chooser=SimpleNamespace(choose=lambda *given, **_: Design((choice,) if given[2] >= 40.0 else (), ())),
        )

    return of


def begun(folder: Path, **changes: Any) -> Account:
    given = (Recorded(file="a.npz"), Recorded(file="b.npz"))
    account = Account(robot="iiwa14", seed=1, budget_s=120.0, recordings=given)
    return save(folder, msgspec.structs.replace(account, **changes))


def investigation(folder: Path, account: Account, driver: Driver, **options: Any) -> Investigation:
    options = {"ask": lambda *_: True, "tell": lambda *_: None, "progress": lambda *_: None} | options
    return Investigation(folder, account, driver, **options)
