"""The nominal model of a diagnosis: the fit that the user has of the same recordings, and no other.

Same band, weights, options and values, cited by its digest. What the diagnosis calls "before" is this fit. Called by
the diagnosis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from identification.fit import fit_recordings
from identification.fitting.nominal_model import notes_on_model
from identification.fitting.result import FitResult
from identification.fitting.settings import FitSettings
from identification.mismatch.evidence import Evidence
from identification.mismatch.extension import extend
from identification.mismatch.heldout import Residuals, residuals
from identification.mismatch.library import Library
from identification.mismatch.problem import build_problem
from identification.mismatch.settings import DiagnosisSettings
from identification.recordings.recording import Recording
from identification.robots import RobotModel

FloatArray = npt.NDArray[np.float64]


def nominal_fit(recordings: Sequence[Recording], robot: RobotModel, settings: DiagnosisSettings) -> FitResult:
    """The fit of these recordings as `fit` makes it, without its physical sets. Raises as `fit_recordings` does."""
    return fit_recordings(
        recordings,
        robot,
        FitSettings(
            low_pass_hz=settings.low_pass_hz,
            motion_bandwidth_hz=settings.motion_bandwidth_hz,
            torque_bandwidth_hz=settings.torque_bandwidth_hz,
            check_torque_sign=False,
            physical=False,
        ),
    )


def settings_of_fit(settings: DiagnosisSettings, fit: FitResult, heldout: Sequence[Recording]) -> DiagnosisSettings:
    """The settings with the band of the fit, as far as the rates of what is held out allow.

    Offsets that the data chose are effects of as many joints: what is named beside them is the less an explanation of
    few (an arm of no hidden effect, five joints of which had a constant torque, became bending crosstalk).
    """
    if fit.regressor.options.offset:
        room = max(0, settings.largest_explanation - fit.regressor.robot.n)
        settings = replace(settings, largest_explanation=room)
    band = fit.settings.low_pass_hz
    if band is not None and settings.low_pass_hz is None:
        band = min([band, *(1.0 / recording.sampling_period_s / 8.0 for recording in heldout)])
    return replace(settings, low_pass_hz=band)


def notes_of_fit(fit: FitResult) -> list[str]:
    """What the reader must know of the model that the findings stand beside."""
    band = fit.settings.low_pass_hz
    compared = [] if band is None else [f"Compared up to {band:.3g} Hz, as the fit of these recordings is"]
    return [*compared, *notes_on_model(fit.regressor, fit.settings)]


def residuals_of_fit(fit: FitResult, evidences: Sequence[Evidence], library: Library) -> Residuals:
    """What the fit's own parameters leave on the rows of the diagnosis."""
    nominal = extend(build_problem(evidences), ())
    return residuals(replace(nominal, base=fit.values), evidences, library)


def after_findings(fit: FitResult, before: Residuals, after: Residuals) -> FloatArray:
    """(n,) RMS in Nm that the fit would state with the findings in it: its own less what they take off the rows."""
    own = fit.rms.row("fit, base").rms_nm
    return np.asarray(np.sqrt(np.maximum(own**2 - before.rms_nm**2 + after.rms_nm**2, 0.0)), dtype=np.float64)
