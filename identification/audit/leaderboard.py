"""Which model of an arm foretells its torque best, nothing fitted, and what is wrong in each of them.

Every model is asked for the torque of the same rows in the same band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.audit.audit import audit
from identification.audit.columns import Geometry
from identification.audit.difference import Audit
from identification.audit.foretold import foretold
from identification.audit.rows import COULOMB_VELOCITY, rows_of
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import ModelFileError, RobotError, RobotNotFoundError
from identification.fitting.rms import RmsRow
from identification.model_file import Model, no_check, read_model
from identification.recordings.independence import refuse_repeated
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel
from identification.robots.simulator_models import read_simulator_model


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """One model. rms: its line of the table. offsets: (n,) Nm taken off each joint, None where nothing is fitted.
    audit: what is wrong in it. refusal: why it can have no line; then the rest is None. fitted_to: those of the
    recordings that it was fitted to, which are no check of it.
    """

    name: str
    rms: RmsRow | None
    offsets: FloatArray | None
    audit: Audit | None
    refusal: str | None = None
    fitted_to: tuple[str, ...] = ()

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is wrong in it, in words."""
        if self.audit is None:
            return (self.refusal or "",)
        own = tuple(no_check(name) for name in self.fitted_to)
        return own + (tuple(item.sentence for item in self.audit.differences) or (self.audit.sentence,))

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
    """The models, best first by the sum of RMS over the joints; those of another arm last.

    offsets: whether one constant a joint is fitted, as a torque sensor's zero; the line then says so. Raises
    RobotNotFoundError for a file that is not there, RecordingError for recordings too short or at rest, or given twice.
    """
    refuse_repeated(recordings)
    standings = [_standing(path, recordings, robot, offsets) for path in models]
    return tuple(sorted(standings, key=lambda item: np.inf if item.rms is None else item.rms.total_nm))


def _standing(path: Path, recordings: Sequence[Recording], robot: RobotModel, offsets: bool) -> Standing:
    try:
        model = read_model(path) if path.suffix == ".json" else path
        options = model.options if isinstance(model, Model) else RegressorOptions()
        regressor = BaseRegressor(robot, options)
        values = model.base_values(regressor) if isinstance(model, Model) else read_simulator_model(path, regressor)
    except RobotNotFoundError:
        raise
    except (ModelFileError, RobotError) as error:
        return Standing(str(path), None, None, None, str(error))
    rows = rows_of(recordings, options.coulomb_velocity or COULOMB_VELOCITY)
    left = np.where(rows.used, rows.torque - foretold(Geometry(robot, rows), regressor, values), np.nan)
    found = np.nanmean(left, axis=0) if offsets else None
    torque = np.where(rows.used, rows.torque, np.nan)
    if found is not None:
        left, torque = left - found, torque - np.nanmean(torque, axis=0)
    rms, size = (np.sqrt(np.nanmean(item**2, axis=0)) for item in (left, torque))
    line = RmsRow(path.name, rms, size, np.full(robot.n, np.nan))
    own = model.fitted_among(recordings) if isinstance(model, Model) else ()
    return Standing(str(path), line, found, audit(recordings, robot, model), fitted_to=own)
