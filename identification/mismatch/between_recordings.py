"""Does what was fitted hold on the held-out recordings? If not, something differs between them, and this says where.

Two questions to each joint of each held-out recording. Is there misfit: more than its noise and the scatter of the
predicted parameters give? And is it more than on the fitted recordings: then those disagree, whatever both leave out.
Where no noise is measured, only the second can be asked. Not here: what differs.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from scipy.special import fdtrc

from identification.arrays import FloatArray
from identification.mismatch.evidence import Evidence, rows_of_each, rows_to_time
from identification.mismatch.findings import HeldOutMisfit
from identification.mismatch.heldout import Residuals, misfit_probability
from identification.mismatch.names.localisation import best_curve
from identification.mismatch.settings import DiagnosisSettings
from identification.recordings.independence import recording_names

STATES = ("position", "velocity", "torque")
COMMON_BAND = 0.7
"""Share of the narrower band in which both recordings are compared: filters end softly."""


def held_out_misfits(
    left: Residuals,
    evidences: Sequence[Evidence],
    fitted: Residuals,
    fitted_evidences: Sequence[Evidence],
    settings: DiagnosisSettings,
) -> tuple[HeldOutMisfit, ...]:
    """Joints of held-out recordings whose misfit is beyond consistency_probability, largest first.

    left, fitted: what the model leaves on the held-out and on the fitted evidences; noise of the fitted ones: that by
    which the parameters scatter. Only what lies in the band of the motion counts: a hum above it is no matter of the
    arm.
    """
    probability, band = settings.consistency_probability, settings.motion_bandwidth_hz
    names = recording_names([item.recording for item in (*fitted_evidences, *evidences)])
    fitted_to = " and ".join(dict.fromkeys(names[: len(fitted_evidences)]))
    names = names[len(fitted_evidences) :]
    measured = all(item.noise_is_measured for item in (*fitted_evidences, *evidences))
    places = rows_of_each(evidences)
    found = []
    for name in dict.fromkeys(names):
        own = [place for place, other in enumerate(names) if other == name]
        rows = np.concatenate([np.arange(places[place].start, places[place].stop) for place in own])
        own_evidences = [evidences[place] for place in own]
        part = left.rows_of(rows, sum(item.samples for item in own_evidences))
        more = _probability_of_more(*_in_common_band((part, fitted), (own_evidences, fitted_evidences), band))
        wrong = misfit_probability(part, own_evidences, band) if measured else more
        for joint in np.flatnonzero(wrong * left.rows.shape[0] < probability):
            rms, before = float(part.rms_nm[joint]), float(fitted.rms_nm[joint])
            differs = bool(more[joint] * left.rows.shape[0] < probability)
            noise = f", where {part.expected_nm[joint]:.2g} Nm would be noise" if measured else ""
            order = _ordered_by(evidences[own[0]], left.rows[joint, places[own[0]]], int(joint))
            sentence = (
                f"Joint {joint + 1}: {rms:.3g} Nm RMS stay on the held-out {name}{noise}, {before:.3g} Nm on "
                f"{fitted_to}{'' if differs else ', where the same is missing'}; "
                f"a curve over {order} describes them best."
            )
            found.append(HeldOutMisfit(name, int(joint) + 1, rms, before, differs, sentence))
    return tuple(sorted(found, key=lambda item: -item.rms_nm))


def difference_sentence(misfits: Sequence[HeldOutMisfit]) -> str:
    """What joints that disagree mean; empty where none does."""
    names = " and ".join(dict.fromkeys(item.recording for item in misfits if item.differs))
    return names and (
        f"Something differs between the fitted recordings and {names} (a load, the mounting, friction, a sensor), or "
        f"{names} asks for what the fitted motion did not show."
    )


def one_a_line(remaining: str) -> list[str]:
    """What remains, a line for each joint: seven of them in one paragraph nobody reads."""
    return re.split(r"(?<=[.]) (?=Joint \d+: |On the fitted recordings )", remaining)


def _probability_of_more(left: Residuals, fitted: Residuals) -> FloatArray:
    """(n,) chance of so much misfit on a recording where the model leaves as much as on the fitted ones.

    The scatter of the predicted parameters is part of what is expected, in the fitted misfit's own size, and so is what
    the recording has more of noise: a mean of many periods has less than one run. Rows differ in power: the degrees of
    freedom of their sum are those of equally strong rows (Welch and Satterthwaite).
    """
    level = fitted.rms_nm**2
    share = level / np.maximum(fitted.noise_floor_nm**2, 1e-300)
    spread = np.maximum(left.expected_nm**2 - left.noise_floor_nm**2, 0.0)
    noisier = np.maximum(left.noise_floor_nm**2 - fitted.noise_floor_nm**2, 0.0)
    ratio = left.rms_nm**2 / np.maximum(level + share * spread + noisier, 1e-300)
    return np.asarray(fdtrc(left.freedom, fitted.freedom, ratio), dtype=np.float64)


def _in_common_band(
    parts: tuple[Residuals, Residuals], evidences: tuple[Sequence[Evidence], Sequence[Evidence]], band_hz: float
) -> tuple[Residuals, Residuals]:
    frequency = [np.concatenate([item.frequency for item in group]) for group in evidences]
    highest = min(band_hz, *(COMMON_BAND * float(values.max()) for values in frequency))
    first, second = (
        part.rows_of(np.flatnonzero(values <= highest), part.samples)
        for part, values in zip(parts, frequency, strict=True)
    )
    return first, second


def _ordered_by(evidence: Evidence, rows: FloatArray, joint: int) -> str:
    series = rows_to_time(evidence, rows[:, None])[:, 0]
    return best_curve(evidence, joint, series, series, 0.0, names=STATES)[0].coordinate
