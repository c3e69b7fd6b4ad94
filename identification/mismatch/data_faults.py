"""Faults of the data that no physics explains: looked for before any effect is. Called by the diagnosis."""

from __future__ import annotations

from identification.base_parameters import BaseRegressor
from identification.mismatch.findings import DataFault
from identification.recordings.recording import Recording
from identification.robots import RobotModel


def find_data_faults(recording: Recording, robot: RobotModel, regressor: BaseRegressor) -> tuple[DataFault, ...]:
    """Every fault found in one recording."""
    del recording, robot, regressor
    return ()
