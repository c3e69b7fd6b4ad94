"""The check of the start ramp from where the arm really stands, between the robot's first position and the first
command.

Here: the supervisor's answer to the loop's question (`fri_client.start_gate`). The very motion that the loop will
drive is driven here through its start ramp, command by command, and the path is held against the arm's own shape and
its surroundings. Not here: the distances (`safety.collision`), the margins (`workspace`).
"""

from __future__ import annotations

import numpy as np

from daemon.api import RunRequest
from daemon.loop_process import load_table, motion_of
from daemon.workspace import load_surroundings
from fri_client.errors import FriError
from fri_client.motion import MotionPhase
from fri_client.start_gate import StartGate, StartQuestion
from safety.collision import Clearance, self_clearances, workspace_clearances
from safety.errors import SafetyError
from safety.limits import limits_for

__all__ = ["StartCheck"]


class StartCheck:
    """Answers for one run; construct it before anything moves, since it refuses what it could not judge later.

    Raises MissingInputError, ConfigurationError, LimitsError or GeometryError.
    """

    def __init__(self, request: RunRequest, gate: StartGate) -> None:
        self._request = request
        self._gate = gate
        self._limits = limits_for(request.robot)
        self._table = load_table(request.table_file)
        self._surroundings = load_surroundings(request.robot, request.workspace_file)
        gate.close()

    def poll(self) -> str:
        """Answer the loop's question where there is one; the sentence for the operator, empty where there is none."""
        question = self._gate.question
        if question is None:
            return ""
        try:
            sentence, clear = self._judge(question)
        except (FriError, SafetyError) as error:
            sentence, clear = str(error), False
        self._gate.answer(question.number, "" if clear else sentence)
        return sentence

    def _judge(self, question: StartQuestion) -> tuple[str, bool]:
        path = self._ramp(question)
        around, margins = self._surroundings, self._surroundings.margins
        own = self_clearances(path, around.geometry)
        outer = workspace_clearances(path, around.geometry, around.workspace)
        found = [(clearance, margins.self_collision_m) for clearance in own[:1]]
        found += [(clearance, margins.workspace_m) for clearance in outer[:1]]
        if not found:
            return "The start ramp has nothing to keep a distance from.", True
        nearest, margin = min(found, key=lambda pair: pair[0].guaranteed_m - pair[1])
        if nearest.guaranteed_m >= margin:
            seconds = len(path) * question.command_period_s
            return (
                f"Start ramp from where the arm stands: {seconds:.1f} s, clear ({_distance(nearest)}; "
                f"{margin * 1e3:.0f} mm are required).",
                True,
            )
        return (
            f"The start ramp from where the arm stands is not clear: {_distance(nearest)}, but {margin * 1e3:.0f} mm "
            "are required. Nothing was moved; jog the arm nearer to the middle of the motion and start again.",
            False,
        )

    def _ramp(self, question: StartQuestion) -> np.ndarray:
        """The commands of the start ramp, (N, 7) rad, the arm's position in front."""
        motion = motion_of(
            self._request, self._table, self._limits, question.command_period_s, question.samples_per_command
        )
        motion.begin(question.position)
        path = [question.position]
        while motion.phase == MotionPhase.START_RAMP:
            path.append(tuple(motion.tick(path[-1])))
        if motion.stop_reason is not None:
            raise FriError(f"The start ramp from where the arm stands is refused: {motion.stop_reason.sentence}")
        return np.array(path)


def _distance(clearance: Clearance) -> str:
    if clearance.distance_m < 0.0:
        return f"{clearance.first} and {clearance.second} would overlap by {-clearance.distance_m * 1e3:.0f} mm"
    return f"{clearance.first} and {clearance.second} come as close as {clearance.distance_m * 1e3:.0f} mm"
