"""What a reader should know first of a fit without a diagnosis, and the colour of that."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from identification.report.document import Tone
from identification.report.model_sections import undetermined
from identification.report.numbers import listed, rounded

# From here on the misfit is larger than the noise that it lies in: squares add.
MISFIT_AS_LARGE_AS_NOISE = math.sqrt(2.0)
# How a fit's notes begin that say the recording is not what it states.
WARNING = "WARNING"


def fit_verdict(model: Mapping[str, Any]) -> tuple[str, Tone]:
    """A few sentences of `model.json`: what the fit warns of, is the residual noise, can the parameters be, how many
    are known.
    """
    said, tone = _without_warnings(model)
    notes = (model.get("provenance") or {}).get("notes") or ()
    warnings = [f"{note}." for note in notes if str(note).startswith(WARNING)]
    return (" ".join([*warnings, said]), "attention") if warnings else (said, tone)


def _without_warnings(model: Mapping[str, Any]) -> tuple[str, Tone]:
    items = model.get("base_parameters", ())
    if not items:
        return "This report holds no fitted model.", "neutral"
    known = f"{len(items) - len(undetermined(model))} of {len(items)} base parameters are told apart from zero."
    certificate = model.get("certificate") or {}
    if certificate.get("feasible") is False:
        return f"The physical parameters VIOLATE a constraint; do not simulate with them. {known}", "attention"
    table = model.get("rms_nm") or {}
    left, noise = table.get("fit") or (), table.get("noise_floor") or ()
    if not _span(left, ""):
        return known, "neutral"
    times = [_ratio(value, floor) for value, floor in zip(left, noise, strict=False)]
    told = [value for value in times if value is not None]
    if not told:
        share = _span(((model.get("rms_table") or [{}])[0]).get("percent_of_rms_torque") or (), " %")
        beside = f" ({share})" if share else ""
        return (
            f"The model leaves {_span(left, ' Nm')} RMS of the measured torque{beside}{_per_joint(left)}; how much of "
            f"that is noise, these recordings do not tell. {known}"
        ), "neutral"
    worse = [joint for joint, value in enumerate(times) if value is not None and value > MISFIT_AS_LARGE_AS_NOISE]
    if not worse:
        return (
            f"What the model leaves is mostly noise: {_span(told, '')} times what the noise alone would"
            f"{_per_joint(told)}. {known}"
        ), "good"
    most = max(worse, key=lambda joint: times[joint] or 0.0)
    where = f"joint {most + 1}" if len(worse) == 1 else f"joints {listed([str(joint + 1) for joint in worse])}"
    on_most = "" if len(worse) == 1 else f" on joint {most + 1}"
    return (
        f"The model leaves more than noise on {where}: {rounded(left[most], 2)} Nm{on_most}, {rounded(times[most], 2)} "
        f"times what the noise alone would. A diagnosis says what is missing. {known}"
    ), "attention"


def _ratio(value: float | None, floor: float | None) -> float | None:
    return value / floor if value is not None and floor else None


def _span(values: Sequence[float | None], unit: str) -> str:
    known = [value for value in values if value is not None]
    ends = dict.fromkeys((rounded(min(known), 2), rounded(max(known), 2))) if known else ()
    return " to ".join(ends) + unit if ends else ""


def _per_joint(values: Sequence[float | None]) -> str:
    return ", by joint" if len(values) > 1 else ""
