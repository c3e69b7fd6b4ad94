"""The one way from a recording to evidence, whether its motion repeats or not."""

from __future__ import annotations

from identification.base_parameters import BaseRegressor
from identification.errors import RecordingError
from identification.fitting.settings import Split
from identification.mismatch.aperiodic_evidence import build_aperiodic_evidence
from identification.mismatch.evidence import Evidence, periodic_evidence
from identification.mismatch.settings import DiagnosisSettings
from identification.recordings.recording import Recording
from identification.robots import RobotModel
from identification.signals.periods import period_table


def build_evidence(
    recording: Recording,
    robot: RobotModel,
    regressor: BaseRegressor,
    settings: DiagnosisSettings | None = None,
    split: Split | None = None,
    *,
    held_out: bool = False,
) -> tuple[Evidence, ...]:
    """Reduce a recording: one evidence for a periodic one, one per gap-free stretch for any other.

    split, held_out: which rows of a recording without periods; all of them without a split. `motion.torque` is that of
    the nominal fit to this recording alone; `with_parameters` sets another one. Raises RecordingError where the
    recording cannot be used.
    """
    settings = settings if settings is not None else DiagnosisSettings()
    if recording.repeats:
        try:
            table = period_table(recording)
        except RecordingError as error:
            if error.field != "period_s":
                raise
        else:
            return (periodic_evidence(recording, table, robot, regressor, settings),)
    return build_aperiodic_evidence(recording, robot, regressor, settings, split, held_out=held_out)
