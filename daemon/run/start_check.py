"""The check of the start ramp from where the arm really stands, between the robot's first position and the first
command.

Here: the supervisor's answer to the loop's question (`start_gate`). The very motion that the loop will drive is
driven here through its start ramp, command by command, and the path is held against the arm's own shape and
its surroundings, and so are the stops from it. Not here: the distances (`safety.collision`), the margins (`workspace`).
"""

from __future__ import annotations

import numpy as np

from daemon.api import RunRequest
from daemon.doctor.load_check import load_before_motion
from daemon.motion.tip_speed import T1_SPEED_M_S, path_speed, rounded_up
from daemon.motion.torque_foresight import foresight_of_run
from daemon.motion.workspace import load_surroundings
from daemon.run.loop_process import load_table, motion_of
from fri_client.errors import FriError
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import Disposition, HandoverRing
from fri_client.handover.start_gate import StartGate, StartQuestion
from fri_client.messages import FriVersion, OperationMode
from fri_client.wire.codec import Codec
from identification.errors import IdentificationError
from safety.errors import SafetyError
from safety.limits import limits_for
from safety.preflight import RAMP_SAMPLES_S, stops_on_path
from safety.preflight_distance import SampledPath

_MESSAGES, _RECORDS = 100, 2000
STOP_STRIDE_S = 0.01
"""Stops on the ramp are planned from commands so far apart at first."""


class StartCheck:
    """Answers for one run; construct it before anything moves, since it refuses what it could not judge later.

    Raises MissingInputError, ConfigurationError, LimitsError or GeometryError.
    """

    def __init__(self, request: RunRequest, gate: StartGate) -> None:
        self._request = request
        self._gate = gate
        self._limits = limits_for(request.robot)
        self._table = load_table(request.table_file)
        surroundings = load_surroundings(request.robot, request.workspace_file)
        self._geometry, self._distances = surroundings.geometry, surroundings.distances(self._limits)
        gate.close()

    def poll(self, ring: HandoverRing | None = None) -> str:
        """Answer the loop's question where there is one; the sentence for the operator, empty where there is none.

        ring: what the robot says of its mode is in it.
        """
        question = self._gate.question
        if question is None:
            return ""
        try:
            sentence, clear = self._judge(question, is_t1=self._request.test_mode_only or self._is_in_t1(ring))
        except (FriError, SafetyError) as error:
            sentence, clear = str(error), False
        self._gate.answer(question.number, "" if clear else sentence)
        return sentence

    def load_remark(self, ring: HandoverRing) -> str:
        """What the torque of the standing arm says of the declared tool, in one sentence; empty where it fits.

        Called once the loop has its answer, so that the robot waits for nothing. The loop goes on pushing meanwhile:
        copies of the newest records are whole, since their slots are taken again a ring's length later.
        """
        waited = [
            each
            for each in ring.newest(_RECORDS)
            if each.disposition == Disposition.FRESH and each.phase == MotionPhase.WAITING
        ]
        codec = Codec(FriVersion.parse(self._request.fri_version))
        try:
            heard = [codec.decode_monitoring(each.monitoring).monitor_data for each in waited[-_MESSAGES:]]
            known = [each for each in heard if each is not None and each.measured_torque is not None]
            foresight = foresight_of_run(self._request) if known else None
            if foresight is None:
                return ""
            positions = np.array([each.measured_joint_position for each in known], dtype=np.float64)
            torques = np.array([each.measured_torque for each in known], dtype=np.float64)
            return load_before_motion(positions, torques, self._request, foresight)
        except (FriError, IdentificationError, ValueError):
            return ""  # a remark is worth no run

    def _is_in_t1(self, ring: HandoverRing | None) -> bool:
        """Whether the robot's newest message says so."""
        codec = Codec(FriVersion.parse(self._request.fri_version))
        records = [] if ring is None else ring.newest(_MESSAGES)
        newest = [each for each in records if each.disposition == Disposition.FRESH][-1:]
        robots = [codec.decode_monitoring(each.monitoring).robot_info for each in newest]
        return any(robot is not None and robot.operation_mode == OperationMode.TEST_MODE_1 for robot in robots)

    def _judge(self, question: StartQuestion, *, is_t1: bool) -> tuple[str, bool]:
        path = self._ramp(question)
        ramp = SampledPath(path, question.command_period_s)
        checks, _ = self._distances.check([ramp], "start ramp")
        unsafe = [check.sentence for check in checks if not check.passed]
        if not unsafe and is_t1:
            speed = path_speed(self._geometry, path, ramp.period_s)
            if speed > T1_SPEED_M_S:
                reaches = f"On its way to the motion the end-effector would reach {rounded_up(speed):.3f} m/s"
                unsafe = [f"{reaches}; T1, in which this run is driven, allows {T1_SPEED_M_S:g} m/s."]
        if not unsafe:
            unsafe = self._unsafe_stops(path, ramp.period_s)
        if unsafe:
            return (
                f"The arm cannot start from where it stands. {' '.join(unsafe)} Nothing was moved; jog the arm nearer "
                "to the middle of the motion and start again.",
                False,
            )
        nearest = min(checks, key=lambda check: check.value - check.limit)
        return f"Start from where the arm stands, {len(path) * ramp.period_s:.1f} s: {nearest.sentence}", True

    def _unsafe_stops(self, path: np.ndarray, period_s: float) -> list[str]:
        """What speaks against the stops from the ramp; empty where all are clear.

        On the ramp each joint stops on its own and so leaves the path. A few stops settle it where there is room; where
        there is little, one is planned from every command.
        """
        coarse = max(1, round(STOP_STRIDE_S / period_s))
        for stride in (coarse, 1):
            planned, stops = stops_on_path(path, period_s, self._limits, stride)
            if stops is None:
                return [planned.sentence]
            checks, _ = self._distances.check_stops(
                stops, RAMP_SAMPLES_S, "stop on the start ramp", every_row=stride == 1
            )
            unsafe = [check.sentence for check in checks if not check.passed]
            if not unsafe:
                break
        return unsafe

    def _ramp(self, question: StartQuestion) -> np.ndarray:
        """The commands of the start ramp, (N, 7) rad, the arm's position in front."""
        motion = motion_of(
            self._request, self._table, self._limits, question.command_period_s, question.samples_per_command
        )
        motion.begin(question.position)
        path = [question.position]
        while motion.phase == MotionPhase.START_RAMP:
            path.append(tuple(motion.tick(path[-1])))
        if motion.stopping.reason is not None:
            raise FriError(f"The start ramp from where the arm stands is refused: {motion.stopping.reason.sentence}")
        return np.array(path)
