"""The entry point: recordings in, one `Diagnosis` out."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from identification.mismatch.findings import Diagnosis
from identification.mismatch.settings import DiagnosisSettings
from identification.model_file import Model
from identification.recordings.recording import Recording
from identification.robots import RobotModel

Progress = Callable[[str, float], None]


def diagnose(
    recordings: Sequence[Recording],
    robot: RobotModel,
    *,
    heldout: Sequence[Recording] = (),
    settings: DiagnosisSettings | None = None,
    model: Model | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Locate and name what the nominal model leaves out."""
    raise NotImplementedError
