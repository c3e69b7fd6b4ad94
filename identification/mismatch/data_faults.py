"""Faults of the data that no physics explains: looked for before any effect is. Called by the diagnosis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from identification.base_parameters import BaseRegressor
from identification.recordings.recording import Recording
from identification.robots import RobotModel


@dataclass(frozen=True, slots=True)
class DataFault:
    """One fault, fields as in diagnosis.json.

    fault: wrong_time_base, inverted_torque_sign, saturated_sensor, lost_samples or garbled_rows. joints: from 1.
    ratio: true rate / stated rate, with its standard deviation ratio_std; None for other faults.
    rows: first row, last row (of the file, from 1) and how many rows are affected; None where all are.
    """

    fault: str
    joints: tuple[int, ...]
    sentence: str
    ratio: float | None = None
    ratio_std: float | None = None
    rows: tuple[int, int, int] | None = None

    def to_json(self) -> dict[str, Any]:
        """The fault as plain JSON types."""
        return {
            "fault": self.fault,
            "joints": list(self.joints),
            "ratio": self.ratio,
            "ratio_std": self.ratio_std,
            "rows": None if self.rows is None else list(self.rows),
            "sentence": self.sentence,
        }


def find_data_faults(recording: Recording, robot: RobotModel, regressor: BaseRegressor) -> tuple[DataFault, ...]:
    """Every fault found in one recording."""
    del recording, robot, regressor
    return ()
