"""The model that a diagnosis leaves behind: nominal parameters, physical ones too, with the findings as effects.

Here: joining the diagnosis with a fit on recordings whose torque has the effects taken off, and what the findings
leave of these. Not here: either of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import IdentificationError
from identification.estimators.feasibility import rules_for
from identification.fitting.processing import process
from identification.fitting.result import FitResult
from identification.fitting.rms import rms_of_rows
from identification.json_values import json_list
from identification.mismatch.claims import Claims
from identification.mismatch.data_faults.faults import all_upright
from identification.mismatch.findings import Diagnosis, Finding
from identification.mismatch.heldout import Residuals
from identification.mismatch.nominal import Nominal, after_findings
from identification.mismatch.prediction import without_effects
from identification.mismatch.unknown.model_terms import with_friction
from identification.recording_fit import FitSettings, Progress, fit_recordings
from identification.recordings.independence import is_called
from identification.recordings.recording import Recording
from identification.robots import RobotModel
from identification.validation import torque_left


def extended_model(
    diagnosis: Diagnosis, recordings: Sequence[Recording], robot: RobotModel, *, progress: Progress | None = None
) -> dict[str, Any]:
    """`model.json` (contract §5) of a diagnosis, as `fit` writes it, with `effects`. recordings: as they were given.

    Base parameters and their deviations come from the joint fit with the effects; physical and consistent sets and the
    certificate from programs on the torque that the effects leave. Where those programs cannot be solved on these
    recordings, the model holds base parameters only and a note says why.
    """
    extended = diagnosis.extended_model_json()
    regressor = diagnosis.nominal_model(robot)
    known = {item["name"]: item["value"] for item in extended["base_parameters"]}
    terms = extended.get("class_terms")
    if terms is not None:
        rules = rules_for(robot)
        terms, known = with_friction(terms, known, {"FV": rules.viscous, "FS": rules.coulomb})
        extended["class_terms"] = terms
        for item in extended["base_parameters"]:
            item["value"] = known[item["name"]]
        for item in extended["friction"]:
            item |= {"viscous": known.get(f"FV_{item['joint']}"), "coulomb": known.get(f"FS_{item['joint']}")}
    values = np.array([known[name] for name in regressor.names])
    settings = FitSettings(
        rotor_inertia="yes" if regressor.options.rotor_inertia else "no",
        offset="yes" if regressor.options.offset else "no",
        coulomb_velocity=regressor.options.coulomb_velocity,
        low_pass_hz=diagnosis.provenance["low_pass_hz"],
        check_torque_sign=False,
    )
    try:
        turned = all_upright(diagnosis.as_read(recordings, robot), diagnosis.data_faults)
        band, named = settings.low_pass_hz, diagnosis.findings
        remaining = [_without_findings(item, named, regressor, values, band, terms) for item in turned]
        fit = fit_recordings(remaining, robot, settings, progress=progress)
        model = fit.to_model_json()
        rms = {**model["rms_nm"], **extended["rms_nm"]}
        if terms is not None:
            # The classes were chosen on rows of the diagnosis, which are not those of a fit.
            rms["fit"] = json_list(_rms_left(remaining, fit, values))
    except IdentificationError as error:
        note = f"Base parameters only: {error}"
        return {**extended, **robot.to_json(), "provenance": {**extended["provenance"], "notes": [note]}}
    return {
        **model,
        "base_parameters": extended["base_parameters"],
        "base_covariance": _with_deviations(
            model["base_covariance"], [item["std"] for item in extended["base_parameters"]]
        ),
        "effects": extended["effects"],
        **({} if terms is None else {"class_terms": terms}),
        "rms_nm": rms,
        "provenance": {**model["provenance"], "diagnosis": extended["provenance"]},
    }


def rms_with_findings(
    fit: FitResult | None, recordings: Sequence[Recording], claims: Claims, nominal: Nominal, plain: Residuals
) -> FloatArray:
    """(n,) RMS in Nm that the fitted recordings keep with the findings, on the samples of the fit.

    As the fit states it of its own parameters, and `validate` of the extended model. The rows of the diagnosis do not
    tell it: of a motion that repeats they end at 60 Hz, and a ripple need not. fit: None where there is none, or where
    it has samples that are held out; then what is taken off the rows is taken off its figure. plain: what it leaves.
    """
    if not claims.findings:
        return nominal.rms_nm
    if fit is None:
        return after_findings(nominal.rms_nm, plain.rms_nm, claims.after.rms_nm)
    values, band = claims.extension.base[: nominal.regressor.size], fit.settings.low_pass_hz
    left = [_without_findings(item, claims.findings, fit.regressor, values, band) for item in recordings]
    return _rms_left(left, fit, values)


def _rms_left(recordings: Sequence[Recording], fit: FitResult, values: FloatArray) -> FloatArray:
    """(n,) RMS in Nm that base parameters (p,) leave of recordings, on the samples of a fit to them."""
    stretches = [part for item in recordings for part in process(item, fit.robot, fit.settings).stretches]
    return rms_of_rows(torque_left(stretches, fit.regressor, [values], fit.torque_shift)[0])


def _without_findings(
    recording: Recording,
    findings: Sequence[Finding],
    regressor: BaseRegressor,
    values: FloatArray,
    low_pass_hz: float | None,
    class_terms: Mapping[str, Any] | None = None,
) -> Recording:
    """As `without_effects`, of the findings that act in this recording."""
    present = [
        finding.to_json()
        for finding in findings
        if is_called(recording, finding.where.get("recording", recording.source.path))
    ]
    return without_effects(recording, present, regressor, values, low_pass_hz, class_terms)


def _with_deviations(rows: Sequence[Sequence[float]], std: Sequence[float | None]) -> list[list[float]]:
    """Rows of the lower triangle with these deviations, correlations as they are: a fit to what the effects leave takes
    these for known, and parameters that an effect trades with are less sure than it says.
    """
    wanted = np.array([own or 0.0 for own in std])
    stated = np.sqrt([row[-1] for row in rows])
    scale = np.divide(wanted, stated, out=np.ones_like(wanted), where=(wanted > 0.0) & (stated > 0.0))
    return [(scale[place] * scale[: place + 1] * np.array(row)).tolist() for place, row in enumerate(rows)]
