"""The model that a diagnosis leaves behind: nominal parameters, physical ones too, with the findings as effects.

Here: joining the diagnosis with a fit on recordings whose torque has the effects taken off. Not here: either of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import IdentificationError
from identification.mismatch.data_faults.faults import upright
from identification.mismatch.findings import Diagnosis
from identification.mismatch.prediction import without_effects
from identification.recording_fit import FitSettings, Progress, fit_recordings
from identification.recordings.independence import is_called
from identification.recordings.recording import Recording
from identification.robots import RobotModel


def extended_model(
    diagnosis: Diagnosis, recordings: Sequence[Recording], robot: RobotModel, *, progress: Progress | None = None
) -> dict[str, Any]:
    """`model.json` (contract §5) of a diagnosis, as `fit` writes it, with `effects`.

    Base parameters and their deviations come from the joint fit with the effects; physical and consistent sets and the
    certificate from programs on the torque that the effects leave. Where those programs cannot be solved on these
    recordings, the model holds base parameters only and a note says why.
    """
    extended = diagnosis.extended_model_json()
    regressor = BaseRegressor(robot, RegressorOptions.from_json(diagnosis.provenance["regressor"]))
    known = {item["name"]: item["value"] for item in extended["base_parameters"]}
    terms = extended.get("class_terms")
    values = np.array([known[name] for name in regressor.names])
    settings = FitSettings(
        rotor_inertia="yes" if regressor.options.rotor_inertia else "no",
        offset="yes" if regressor.options.offset else "no",
        coulomb_velocity=regressor.options.coulomb_velocity,
        low_pass_hz=diagnosis.provenance["low_pass_hz"],
        check_torque_sign=False,
    )
    try:
        remaining = []
        for recording in recordings:
            present = [
                finding.to_json()
                for finding in diagnosis.findings
                if is_called(recording, finding.where.get("recording", recording.source.path))
            ]
            faults = [fault for fault in diagnosis.data_faults if is_called(recording, fault.recording)]
            remaining.append(
                without_effects(upright(recording, faults), present, regressor, values, settings.low_pass_hz, terms)
            )
        model = fit_recordings(remaining, robot, settings, progress=progress).to_model_json()
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
        "rms_nm": {**model["rms_nm"], **extended["rms_nm"]},
        "provenance": {**model["provenance"], "diagnosis": extended["provenance"]},
    }


def _with_deviations(rows: Sequence[Sequence[float]], std: Sequence[float | None]) -> list[list[float]]:
    """Rows of the lower triangle with these deviations, correlations as they are: a fit to what the effects leave takes
    these for known, and parameters that an effect trades with are less sure than it says.
    """
    wanted = np.array([own or 0.0 for own in std])
    stated = np.sqrt([row[-1] for row in rows])
    scale = np.divide(wanted, stated, out=np.ones_like(wanted), where=(wanted > 0.0) & (stated > 0.0))
    return [(scale[place] * scale[: place + 1] * np.array(row)).tolist() for place, row in enumerate(rows)]
