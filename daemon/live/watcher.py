"""What a watcher knows of a run: its newest frame, beside the limits and the model that stand in the run's folder."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import msgspec

from daemon.api import RunRequest
from daemon.errors import DaemonError
from daemon.json_files import read_json
from daemon.live.frame import LiveFrame
from daemon.live.residual import LiveResidual, Modelled, noise_sentence
from daemon.live.screen import Screen
from daemon.motion.torque_foresight import foresight_of_run
from identification.arrays import FloatArray
from safety.errors import LimitsError
from safety.limits import EXTERNAL_TORQUE_THRESHOLD_NM, limits_for


class Watcher:
    """Frames in, screens out; takes up a new run on the same port by itself."""

    def __init__(self) -> None:
        self.newest: LiveFrame | None = None
        self._run_id = ""
        self._residual = LiveResidual(None)
        self._external_limit: tuple[float, ...] | None = EXTERNAL_TORQUE_THRESHOLD_NM
        self._modelled: Modelled | None = None
        self._heard = time.monotonic()

    def take(self, frames: Sequence[LiveFrame]) -> list[Modelled]:
        """What came since the last call; the frames with a motion, and with a torque where there is a model."""
        if not frames:
            return []
        self._heard = time.monotonic()
        if frames[-1].run_id != self._run_id:
            self._begin(frames[-1])
        known = self._residual.take([frame for frame in frames if frame.run_id == self._run_id])
        if known:
            self._modelled = known[-1]
        self.newest = frames[-1]
        return known

    @property
    def ratio(self) -> FloatArray | None:
        """See `LiveResidual.ratio`."""
        return self._residual.ratio

    @property
    def remark(self) -> str:
        """How the run compares with its model, in one sentence; empty while that is not known."""
        return noise_sentence(self._residual.ratio)

    def screen(self, *, width: int = 120, ascii_only: bool = False) -> Screen | None:
        """The newest state; None before the first frame, and for an arm whose limits nobody knows."""
        frame, known = self.newest, self._modelled
        if frame is None:
            return None
        try:
            limits = limits_for(frame.robot)
        except LimitsError:
            return None
        if frame.position is None and known is not None:
            # A frame without samples has the newest counts; the joints stand where they were last seen.
            last = known.frame
            frame = msgspec.structs.replace(
                frame, position=last.position, command=last.command, torque=last.torque,
                external_torque=last.external_torque,
            )  # fmt: skip
        return Screen(
            frame,
            limits,
            self._external_limit,
            None if known is None else known.velocity,
            None if known is None else known.modelled,
            self._residual.ratio,
            self.remark,
            time.monotonic() - self._heard,
            width=width,
            ascii_only=ascii_only,
        )

    def _begin(self, frame: LiveFrame) -> None:
        self._run_id = frame.run_id
        self._modelled = None
        request = _request_of(frame)
        self._external_limit = EXTERNAL_TORQUE_THRESHOLD_NM if request is None else request.external_torque_limit
        self._residual = LiveResidual(None if request is None else foresight_of_run(request))


def _request_of(frame: LiveFrame) -> RunRequest | None:
    try:
        return read_json(Path(frame.folder) / "request.json", RunRequest)
    except DaemonError:
        return None
