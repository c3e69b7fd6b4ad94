"""Which model of an arm predicts its torque best, nothing fitted, and what is wrong in each of them.

Every model is asked for the torque of the same rows in the same band, as `validate` asks it: with the effects and class
terms of a `model.json`. What is wrong is told of its base parameters, from what these leave.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.audit.audit import audit
from identification.audit.difference import Audit
from identification.audit.rows import band_of
from identification.base_parameters import BaseRegressor
from identification.errors import (
    EstimationError,
    ModelFileError,
    ModelFileNotFoundError,
    RobotError,
    RobotNotFoundError,
)
from identification.fitting.processing import process_without_periods
from identification.fitting.rms import RmsRow, rms_of_rows
from identification.fitting.settings import FitSettings
from identification.mismatch.prediction import acting, left_to_parameters
from identification.model_file import Model, no_check, read_model
from identification.recordings.independence import names_apart, refuse_repeated
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel
from identification.robots.simulator_models import read_with_drives
from identification.signals.processed import ProcessedSignals
from identification.validation import measured_torque, torque_left

OF_PARAMETERS = (
    "The RMS has the torque of its effects, and its torque without a name. What is wrong is told from what these leave."
)


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """One model. rms: its line of the table. offsets: (n,) Nm taken off each joint, None where nothing is fitted.
    audit: what is wrong in it. refusal: why it can have no line; then the rest is None. fitted_to: those of the
    recordings that it was fitted to, which are no check of it. extended: whether effects or class terms act in it.
    """

    name: str
    rms: RmsRow | None
    offsets: FloatArray | None
    audit: Audit | None
    refusal: str | None = None
    fitted_to: tuple[str, ...] = ()
    extended: bool = False

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is wrong in it, in words."""
        if self.audit is None:
            return (self.refusal or "",)
        own = (*(no_check(name) for name in self.fitted_to), *((OF_PARAMETERS,) if self.extended else ()))
        return own + (tuple(item.sentence for item in self.audit.differences) or (self.audit.sentence,))

    @property
    def quotes_rms(self) -> bool:
        """Whether the sentences state an RMS, which is of other rows than the table's."""
        return self.audit is not None and self.audit.verdict in ("nothing", "unexplained")

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "model": self.name,
            **({} if self.rms is None else self.rms.to_json()),
            "offsets_nm": None if self.offsets is None else self.offsets.tolist(),
            "audit": None if self.audit is None else self.audit.to_json(),
            "differences": [] if self.audit is None else [item.to_json() for item in self.audit.differences],
            "refusal": self.refusal,
            "fitted_to": list(self.fitted_to),
        }


def leaderboard(
    models: Sequence[Path], recordings: Sequence[Recording], robot: RobotModel, *, offsets: bool = False
) -> tuple[Standing, ...]:
    """The models, best first by the sum of RMS over the joints; those that cannot be used last, with the reason.

    offsets: whether one constant a joint is fitted, as a torque sensor's zero; the line then says so. Raises
    RobotNotFoundError or ModelFileNotFoundError for a file that is not there, RecordingError for recordings too short
    or at rest, or given twice.
    """
    refuse_repeated(recordings)
    standings = [
        _standing(path, name, recordings, robot, offsets)
        for path, name in zip(models, names_apart(models), strict=True)
    ]
    return tuple(sorted(standings, key=lambda item: np.inf if item.rms is None else item.rms.total_nm))


def _standing(path: Path, name: str, recordings: Sequence[Recording], robot: RobotModel, offsets: bool) -> Standing:
    try:
        model = read_model(path) if path.suffix == ".json" else _of_simulator(path, robot)
        regressor = BaseRegressor(robot, model.options)
        values, shift = model.base_values(regressor), model.torque_shift(robot.n)
        left_to = left_to_parameters(model, recordings, robot)
        sign = -1.0 if model.turns_torque else 1.0
        given, left_to = (
            tuple(replace(each, torque=sign * each.torque) for each in some) for some in (recordings, left_to)
        )
        audited = audit(left_to, robot, model if path.suffix == ".json" else path, name)
    except (RobotNotFoundError, ModelFileNotFoundError):
        raise
    except (ModelFileError, RobotError, EstimationError) as error:
        return Standing(str(path), None, None, None, str(error))
    settings = FitSettings(pipeline="aperiodic", low_pass_hz=band_of(recordings))
    torque = _over_time(given, given, settings, lambda stretches: measured_torque(stretches, robot, shift))
    left = _over_time(left_to, given, settings, lambda stretches: torque_left(stretches, regressor, [values], shift)[0])
    zero = None
    if offsets:
        zero = _mean(left)
        left, torque = left - zero, torque - _mean(torque)
    return Standing(
        str(path),
        RmsRow(name, rms_of_rows(left), rms_of_rows(torque), np.full(robot.n, np.nan)),
        None if zero is None else sign * zero,
        audited,
        fitted_to=model.fitted_among(recordings),
        extended=acting(model) != ((), None),
    )


def _of_simulator(path: Path, robot: RobotModel) -> Model:
    """What a simulator's file predicts, as a model without deviations."""
    nothing = np.zeros(robot.n)
    regressor, values = read_with_drives(path, robot)
    return Model(
        robot.spec, regressor.names, values, np.zeros_like(values), regressor.units, None, nothing, nothing,
        regressor.options, str(path),
    )  # fmt: skip


def _over_time(
    recordings: Sequence[Recording],
    measured: Sequence[Recording],
    settings: FitSettings,
    torque_of: Callable[[Sequence[ProcessedSignals]], FloatArray],
) -> FloatArray:
    """(E, n) Nm of all recordings, nan for a joint whose torque was not measured: it never changes."""
    parts = []
    for recording, own in zip(recordings, measured, strict=True):
        torque = torque_of(process_without_periods(recording, settings).stretches)
        parts.append(np.where(np.ptp(own.torque, axis=0) > 0.0, torque, np.nan))
    return np.concatenate(parts)


def _mean(values: FloatArray) -> FloatArray:
    """(n,) mean over rows (R, n) without those that are nan; nan for a joint without any other."""
    counts = np.isfinite(values).sum(axis=0)
    return np.asarray(np.nansum(values, axis=0) / np.where(counts > 0, counts, np.nan), dtype=np.float64)
