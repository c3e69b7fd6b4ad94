"""Drives a motion of an investigation over FRI, with every guard that `run` has: preflight, ladder, gate, stop ramps.

On a real arm a new motion climbs the commissioning ladder first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from daemon.api import RUN_NAME, RunEvent, RunOutcome
from daemon.errors import DaemonError
from daemon.investigate.account import Motion
from daemon.investigate.loop import Drive
from daemon.investigate.same_arm import Stated
from daemon.json_files import read_json
from daemon.log.parts import state_of_recording
from daemon.motion.preparation import PreparedMotion, prepare_motion, write_run_request
from daemon.motion.tool import FastenedMass, Tool
from daemon.motion.workspace import load_surroundings
from daemon.run.folder import nothing_moved
from daemon.run.ladder import RUNGS
from daemon.run.service import run_acquisition
from daemon.stop_handle import StopHandle
from identification.robots import Installation
from identification.robots.installation import ON_THE_FLOOR


@dataclass(frozen=True, slots=True)
class FriDriver:
    """settings: fields of RunRequest. simulation: a fake robot on loopback, which needs no ladder.
    added_mass: kg, and m from the flange, on top of the tool.

    agree: asks before each rung of the ladder on a real arm.
    """

    robot: str
    workspace: Path | None
    tool: Tool | None
    added_mass: FastenedMass | None
    installation: Installation | None
    settings: dict[str, Any]
    simulation: bool
    observe: Callable[[RunEvent], None]
    agree: Callable[[PreparedMotion, int], bool]

    def objection(self, trajectory: Path) -> str:
        """The preflight's sentence on a motion; empty where it is safe."""
        return self._prepared(trajectory, 1.0).preflight.objection

    def drive(self, motion: Motion, trajectory: Path, folder: Path) -> Drive:
        """On a real arm the lower rungs of the ladder, one period each; then the motion itself.

        All are held against workspace, tool and stand of this very command first: a motion that was planned or broken
        off may have been checked against others. Raises KeyboardInterrupt for a signal that came too late to stop one.
        """
        motions = [self._prepared(trajectory, rung) for rung in (RUNGS[-1:] if self.simulation else RUNGS)]
        for prepared in motions:
            if why := prepared.preflight.objection:
                sentence = f"At amplitude {prepared.amplitude:g} the motion is not safe here: {why} Nothing was moved."
                return Drive("unsafe", None, sentence)
        *rungs, whole = motions
        for prepared in rungs:
            rung = prepared.amplitude
            if not self.agree(prepared, 1):
                return Drive("stopped", None, f"The rung of amplitude {rung:g} was declined; nothing moved.")
            outcome = self._run(prepared, _rung_folder(folder, rung), 1)
            if outcome.outcome != "completed" or outcome.exit_code:
                return _drive_of(outcome)
        if rungs and not self.agree(whole, motion.periods):
            return Drive("stopped", None, "The motion was declined; nothing moved.")
        return _drive_of(self._run(whole, folder, motion.periods))

    def stated(self) -> Stated:
        """As `write_run_request` notes it for the log."""
        around = load_surroundings(self.robot, self.workspace, self.tool, self.added_mass)
        return Stated(self.settings.get("serial") or "", around.tool.describe(), self.installation or ON_THE_FLOOR)

    def ended(self, folder: Path) -> Drive | None:
        """As run.json of the motion says, or of the highest rung that was begun; a completed rung is no end of it."""
        if (last := ended_in(folder)) is not None:
            return last
        for rung in reversed(RUNGS[:-1]):
            if (drive := ended_in(_rung_folder(folder, rung))) is not None:
                return None if drive.outcome == "recorded" else replace(drive, recorded_s=0.0)
        return None

    def _prepared(self, trajectory: Path, amplitude: float) -> PreparedMotion:
        return prepare_motion(
            trajectory,
            robot=self.robot,
            amplitude=amplitude,
            workspace=self.workspace,
            tool=self.tool,
            added_mass=self.added_mass,
            installation=self.installation,
        )

    def _run(self, prepared: PreparedMotion, folder: Path, periods: int) -> RunOutcome:
        request = write_run_request(
            prepared, folder, periods=periods, fit=False, simulation=self.simulation, **self.settings
        )
        stop = StopHandle()
        outcome = run_acquisition(request, observe=self.observe, stop=stop)
        if stop.signals and outcome.outcome == "completed":
            # It came while the motion ended by itself: nothing was stopped, and yet nothing more is to move.
            raise KeyboardInterrupt
        return outcome


def _rung_folder(folder: Path, rung: float) -> Path:
    return folder.with_name(f"{folder.name}-amplitude-{rung:g}")


def ended_in(folder: Path) -> Drive | None:
    """How the run in a folder ended, as its run.json says; None where none began there.

    Unknown where it left a recording and no account, as where all its processes were killed at once.
    """
    try:
        return _drive_of(read_json(folder / RUN_NAME, RunOutcome))
    except DaemonError:
        if state_of_recording(folder) == "none":
            return None
    sentence = (
        "no run.json says how this motion ended (processes of it that are left write one soon), and nobody saw the "
        "arm come to rest: nothing moves again by itself. Look at the arm and the cabinet, then add --after-drop."
    )
    return Drive("unknown", folder, sentence, recorded_s=None)


def _drive_of(outcome: RunOutcome) -> Drive:
    recording = Path(outcome.recordings[0]) if outcome.recordings else None
    sentence = " ".join(outcome.sentences)
    if outcome.outcome == "completed" and not outcome.exit_code:
        return Drive("recorded", recording, sentence)
    how: Literal["dropped", "stopped"] = "dropped" if _has_to_be_looked_at(outcome) else "stopped"
    period_s = 0.0 if outcome.loop is None else (outcome.loop.send_period_ms or 0.0) / 1000.0
    return Drive(how, recording, sentence, outcome.exit_code, outcome.samples_in_periods * period_s)


def _has_to_be_looked_at(outcome: RunOutcome) -> bool:
    """Whether the robot dropped out, or nobody saw the arm come to rest, as after a kill of the loop."""
    unseen = outcome.loop is not None and not outcome.loop.standstill_confirmed and not nothing_moved(outcome)
    return outcome.outcome == "dropped" or (outcome.outcome in ("stopped", "fault") and unseen)
