"""The nominal model of a diagnosis: the fit that the user has of the same recordings, and no other.

Same band, weights, options and values, cited by its digest. What the diagnosis calls "before" is this fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import UndeterminedParametersError
from identification.fitting.band import within_rate
from identification.fitting.nominal_model import notes_on_model
from identification.fitting.result import FitResult, warnings_of
from identification.fitting.settings import FitSettings
from identification.mismatch.evidence import Evidence
from identification.mismatch.heldout import Residuals, residuals
from identification.mismatch.problem import build_problem
from identification.mismatch.search.extension import extend
from identification.mismatch.search.library import Library
from identification.mismatch.settings import DiagnosisSettings
from identification.recording_fit import fit_recordings
from identification.recordings.recording import Recording
from identification.robots import RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """What the findings stand beside. values, std: (p,) base parameters of the regressor. rms_nm, noise_floor_nm: (n,).

    digest: of the fit, None where a motion that leaves parameters open has none.
    """

    regressor: BaseRegressor
    values: FloatArray
    std: FloatArray
    rms_nm: FloatArray
    noise_floor_nm: FloatArray
    digest: str | None
    notes: tuple[str, ...]


def nominal_fit(recordings: Sequence[Recording], robot: RobotModel, settings: DiagnosisSettings) -> FitResult | None:
    """The fit of these recordings as `fit` makes it, without its physical sets. Raises as `fit_recordings` does.

    None where the motion leaves parameters open (one joint moves, say): `fit` refuses it, but much can be told of it.
    """
    try:
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
    except UndeterminedParametersError:
        return None


def nominal_of(fit: FitResult | None, regressor: BaseRegressor, evidences: Sequence[Evidence]) -> Nominal:
    """The fit's own numbers; without one, those of the shortest parameters that explain the rows."""
    if fit is not None:
        return Nominal(
            regressor,
            fit.values,
            fit.std,
            fit.rms.row("fit, base").rms_nm,
            fit.noise_floor_nm,
            str(fit.provenance["digest"]),
            tuple(notes_of_fit(fit)),
        )
    plain = extend(build_problem(evidences), ())
    left = residuals(plain, evidences, Library((), evidences))
    return Nominal(
        regressor,
        plain.base,
        np.sqrt(np.maximum(np.diag(plain.covariance), 0.0)),
        left.rms_nm,
        left.noise_floor_nm,
        None,
        ("The motion leaves parameters open, which `fit` refuses: the shortest ones that explain it are taken",),
    )


def settings_of_fit(
    settings: DiagnosisSettings, fit: FitResult | None, heldout: Sequence[Recording]
) -> DiagnosisSettings:
    """The settings with the band of the fit, as far as the rates of what is held out allow.

    Offsets that the data chose are effects of as many joints: what is named beside them is the less an explanation of
    few (an arm of no hidden effect, five joints of which had a constant torque, became bending crosstalk).
    """
    if fit is None:
        return settings
    if fit.regressor.options.offset:
        room = max(0, settings.largest_explanation - fit.regressor.robot.n)
        settings = replace(settings, largest_explanation=room)
    band = fit.settings.low_pass_hz
    if band is not None and settings.low_pass_hz is None:
        band = min([band, *(within_rate(band, recording) for recording in heldout)])
    return replace(settings, low_pass_hz=band)


def notes_of_fit(fit: FitResult) -> list[str]:
    """What the reader must know of the model that the findings stand beside, what spoils it first."""
    band = fit.settings.low_pass_hz
    compared = [] if band is None else [f"Compared up to {band:.3g} Hz, as the fit of these recordings is"]
    return [*warnings_of(fit.notes), *compared, *notes_on_model(fit.regressor, fit.settings)]


def residuals_of(nominal: Nominal, evidences: Sequence[Evidence], library: Library) -> Residuals:
    """What the nominal parameters leave on the rows of the diagnosis."""
    plain = extend(build_problem(evidences), ())
    return residuals(replace(plain, base=nominal.values), evidences, library)


def after_findings(nominal: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """(n,) RMS in Nm that the fit would state with the findings in it.

    nominal: (n,) of the fit. before, after: (n,) on the rows of the diagnosis, of the fit's parameters and with the
    findings. What is taken off those is off the fit's own, at most in the same share: the rows are not always the same.
    """
    share = np.minimum(1.0, (nominal / np.maximum(before, 1e-300)) ** 2)
    return np.asarray(np.sqrt(np.maximum(nominal**2 - share * (before**2 - after**2), 0.0)), dtype=np.float64)
