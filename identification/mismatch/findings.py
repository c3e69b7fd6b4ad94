"""What a diagnosis says: findings and the verdict, as value objects and as `diagnosis.json`.

Here: the shapes and their JSON (contract §6). Not here: arrays for figures (`figures`); how anything was decided
(`search`, `verdict`). Read by the command line, the worker and the report.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.audit.difference import Audit, Difference
from identification.audit.reading import Reading, read_so
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.json_values import json_list, number, plain
from identification.mismatch.baseline import ModelComparison
from identification.mismatch.effects.base import Parameter, Place
from identification.mismatch.figures import Curve, Spectrum, TimeSeries
from identification.mismatch.second_encoder import EncoderDifference
from identification.mismatch.unknown.claims import ClassClaim, ClassModel, Offer
from identification.model_file import MODEL_FORMAT
from identification.recordings.recording import Recording
from identification.robots import RobotModel

DIAGNOSIS_FORMAT = "iiwa-ident/diagnosis/1"

Verdict = Literal["no_mismatch", "explained", "partly_explained", "unexplained", "undecided"]


@dataclass(frozen=True, slots=True)
class Alternative:
    """A name, with its joint (from 1, or None), that this data cannot rule out, or that is too weak here to be told."""

    effect: str
    joint: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """One claim: an effect at a place, how large, how sure, and what else it could be.

    where: joint, bands, time windows, state region, periods (contract §6). absorbed_fraction: share of the effect's
    energy that base parameters would swallow. score: log-likelihood units; significance: probability of such a gain by
    noise alone, all candidates counted. heldout_gain_nm: (n,) Nm, RMS before minus RMS after on held-out recordings;
    empty without them. confirmed: whether held-out data support it, None without any. coefficients, shape: what
    evaluates the effect again. share_removed: share of the excess misfit energy on its joints that it removes.
    """

    effect: str
    place: Place
    parameters: tuple[Parameter, ...]
    coefficients: FloatArray
    covariance: FloatArray
    shape: Mapping[str, float]
    absorbed_fraction: float
    score: float
    significance: float
    sentence: str
    where: Mapping[str, Any] = field(default_factory=dict)
    heldout_gain_nm: FloatArray = field(default_factory=lambda: np.zeros(0))
    confirmed: bool | None = None
    alternatives: tuple[Alternative, ...] = ()
    separating_experiment: str | None = None
    share_removed: float = float("nan")
    curve: Curve | None = None

    def to_json(self) -> dict[str, Any]:
        """The finding as plain JSON types, with what is needed to evaluate the effect again under `model`."""
        return {
            "effect": self.effect,
            "joint": self.place.joint,
            "link": self.place.link,
            "where": plain(dict(self.where)),
            "parameters": {
                item.name: {"value": number(item.value), "std": number(item.std), "unit": item.unit}
                for item in self.parameters
            },
            "absorbed_fraction": number(self.absorbed_fraction),
            "score": number(self.score),
            "significance": number(self.significance),
            "heldout_gain_nm": json_list(self.heldout_gain_nm),
            "confirmed": self.confirmed,
            "alternatives": [{"effect": other.effect, "joint": other.joint} for other in self.alternatives],
            "separating_experiment": self.separating_experiment,
            "share_removed": number(self.share_removed),
            "sentence": self.sentence,
            "model": {
                "other_joint": self.place.other_joint,
                "coefficients": json_list(self.coefficients),
                "shape": {name: number(value) for name, value in self.shape.items()},
            },
        }


@dataclass(frozen=True, slots=True)
class DataFault:
    """A fault of the data, not of the robot; fields as in diagnosis.json.

    fault: wrong_time_base, inverted_torque_sign, saturated_sensor, lost_samples or garbled_rows. joints: from 1.
    ratio: true rate / stated rate, with its standard deviation ratio_std; None for other faults and of
    stamps that hide missing rows.
    rows: first row, last row (of the file, from 1) and how many rows are affected; None where all are. recording: the
    file, with as many of its folders as tell it from the others.
    """

    fault: str
    joints: tuple[int, ...]
    sentence: str
    ratio: float | None = None
    ratio_std: float | None = None
    rows: tuple[int, int, int] | None = None
    recording: str = ""

    @classmethod
    def of(cls, difference: Difference) -> DataFault:
        """A difference against the recording."""
        ratio = next((item for item in difference.numbers if item.name == "ratio"), None)
        value, std = (None, None) if ratio is None else (ratio.value, ratio.std)
        return cls(difference.effect, difference.joints, difference.sentence, value, std)


@dataclass(frozen=True, slots=True)
class NotIdentifiable:
    """An effect that this motion cannot show at a place, with the reason in words."""

    effect: str
    place: Place
    reason: str

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types; joint from 1."""
        return {"effect": self.effect, "joint": self.place.joint, "reason": self.reason}


@dataclass(frozen=True, slots=True)
class Detectable:
    """The smallest size of an effect that this recording would have shown at a place, and the share absorbed."""

    effect: str
    place: Place
    size: float
    unit: str
    absorbed_fraction: float

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types; joint from 1."""
        return {
            "effect": self.effect,
            "joint": self.place.joint,
            "size": number(self.size),
            "unit": self.unit,
            "absorbed_fraction": number(self.absorbed_fraction),
        }


@dataclass(frozen=True, slots=True, eq=False)
class Baseline:
    """The nominal fit, per joint (n,): RMS and noise floor over time in Nm, excess misfit with interval, detection.

    excess_nm: square root of mean square residual minus noise. excess_low_nm, excess_high_nm: its 95 % interval.
    noise_is_measured: whether periods tell the noise. Where not, the noise floor is a mere weight, and a joint counts
    as detected only where something explains rows that were not fitted.
    """

    rms_nm: FloatArray
    noise_floor_nm: FloatArray
    excess_nm: FloatArray
    excess_low_nm: FloatArray
    excess_high_nm: FloatArray
    detected: BoolArray
    noise_is_measured: bool = True

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types, one entry per joint."""
        return {
            "rms_nm": json_list(self.rms_nm),
            "noise_floor_nm": json_list(self.noise_floor_nm),
            "excess_nm": json_list(self.excess_nm),
            "excess_ci95_nm": json_list(np.column_stack([self.excess_low_nm, self.excess_high_nm])),
            "detected": [bool(value) for value in self.detected],
            "noise_is_measured": self.noise_is_measured,
        }


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """The held-out recordings, per joint: RMS before and after in Nm, 95 % interval of the latter (n, 2), noise floor.

    Coefficients and base parameters come from the fitted recordings only. excess_before, excess_after: Nm, without the
    noise and the scatter of the predicted parameters. misfits: what of it is more than these, by recording and joint.
    """

    rms_before_nm: FloatArray
    rms_after_nm: FloatArray
    ci95_after_nm: FloatArray
    noise_floor_nm: FloatArray
    excess_before_nm: FloatArray
    excess_after_nm: FloatArray
    misfits: tuple[HeldOutMisfit, ...] = ()


@dataclass(frozen=True, slots=True)
class HeldOutMisfit:
    """What a model leaves on one joint (from 1) of a held-out recording beyond what it should.

    rms_nm: RMS there. fitted_nm: on the fitted recordings. differs: whether the recordings disagree; else the same is
    wrong in both.
    """

    recording: str
    joint: int
    rms_nm: float
    fitted_nm: float
    differs: bool
    sentence: str


@dataclass(frozen=True, slots=True)
class ParameterShift:
    """One base parameter without and with the findings; std of the latter."""

    name: str
    before: float
    after: float
    std: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """All that a diagnosis says. `to_json` is contract §6, `extended_model_json` contract §5.

    mode: "complete" where the findings leave nothing but noise, "background" where unknown model error remains.
    spectra, series: one per fitted stretch, for figures; heldout_series: one per held-out stretch. curves: residual
    curves of what is not explained. notes: sentences on how the data were handled.
    model_comparison: of the model that the diagnosis was asked to start from, if any. encoders: motor against link
    encoder, where there are two. torque_units: of each joint, where one is prismatic ("Nm", "N"); empty: all Nm.
    classes: what joints' torques depend on where no name is needed; class_model: what
    they are worth together; offer: what of them goes into the extended model. gravity: (3,) m/s² in the frame of the
    base that all this is under, where the recordings show another than is stated; else empty. reading: how recordings
    were read for all this, where a given model shows that their data are not as stated; else None.
    """

    robot: str
    verdict: Verdict
    mode: Literal["complete", "background"]
    baseline: Baseline
    findings: tuple[Finding, ...]
    data_faults: tuple[DataFault, ...]
    not_identifiable: tuple[NotIdentifiable, ...]
    minimum_detectable: tuple[Detectable, ...]
    heldout: HeldOut | None
    parameter_shift: tuple[ParameterShift, ...]
    remaining: str
    curves: tuple[Curve, ...] = ()
    spectra: tuple[Spectrum, ...] = ()
    series: tuple[TimeSeries, ...] = ()
    heldout_series: tuple[TimeSeries, ...] = ()
    rms_after_nm: FloatArray = field(default_factory=lambda: np.zeros(0))
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    torque_units: tuple[str, ...] = ()
    model_comparison: ModelComparison | None = None
    encoders: tuple[EncoderDifference, ...] = ()
    audit: Audit | None = None
    classes: tuple[ClassClaim, ...] = ()
    class_model: ClassModel | None = None
    offer: Offer | None = None
    too_weak: tuple[Alternative, ...] = ()
    gravity: tuple[float, ...] = ()
    reading: Reading | None = None

    def as_read(self, recordings: Sequence[Recording], robot: RobotModel) -> list[Recording]:
        """The recordings as this was made of them."""
        return read_so(self.reading, recordings, robot)

    def standing(self, robot: RobotModel) -> RobotModel:
        """The robot under the gravity that this was made under."""
        return replace(robot, gravity=np.array(self.gravity)) if self.gravity else robot

    def nominal_model(self, robot: RobotModel) -> BaseRegressor:
        """The regressor that the findings stand beside, with what the data chose of it: offsets, drives, friction."""
        return BaseRegressor(self.standing(robot), RegressorOptions.from_json(self.provenance["regressor"]))

    @property
    def every_fault(self) -> tuple[DataFault, ...]:
        """Of the data, with those that an audit found: these are put right before the data are asked for others."""
        # An audit asks for the order of torques, the faults of the data for that of velocities.
        known = {fault.fault for fault in self.data_faults} - {"wrong_joint_order"}
        differences = () if self.audit is None else self.audit.differences
        seen = [item for item in differences if item.against == "recording" and item.effect not in known]
        return (*self.data_faults, *map(DataFault.of, seen))

    @property
    def unnamed(self) -> tuple[ClassClaim, ...]:
        """The classes of which the names leave something."""
        return tuple(item for item in self.classes if not item.named)

    def to_json(self) -> dict[str, Any]:
        """`diagnosis.json`, contract §6. Numbers that are not known are null.

        What has no `to_json` of its own goes in by the names of its fields.
        """
        differences = () if self.audit is None else self.audit.differences
        return {
            "format": DIAGNOSIS_FORMAT,
            "verdict": self.verdict,
            "mode": self.mode,
            "robot": self.robot,
            "baseline": {**self.baseline.to_json(), "rms_after_nm": json_list(self.rms_after_nm)},
            "findings": [
                *(item.to_finding_json() for item in differences if item.against == "model"),
                *(finding.to_json() for finding in self.findings),
            ],
            "data_faults": plain(self.every_fault),
            "too_weak": plain(self.too_weak),
            "not_identifiable_here": [item.to_json() for item in self.not_identifiable],
            "minimum_detectable": [item.to_json() for item in self.minimum_detectable],
            "heldout": plain(self.heldout),
            "parameter_shift": plain(self.parameter_shift),
            "classes": [item.to_json() for item in self.classes],
            **({} if self.class_model is None else {"class_model": plain(self.class_model)}),
            "remaining": self.remaining,
            "curves": plain(self.curves),
            "notes": list(self.notes),
            "provenance": plain(dict(self.provenance)),
            **({} if self.audit is None else {"audit": self.audit.to_json()}),
            **({} if self.audit is None else {"differences": [item.to_json() for item in differences]}),
            **({} if self.model_comparison is None else {"model_comparison": self.model_comparison.to_json()}),
            **({"encoder_difference": [item.to_json() for item in self.encoders]} if self.encoders else {}),
        }

    def extended_model_json(self) -> dict[str, Any]:
        """`model.json`, contract §5: base parameters, the findings as effects, torque without a name as class terms."""
        shifts = self.parameter_shift
        if self.offer is not None:
            fitted = zip(shifts, self.offer.base.tolist(), self.offer.std.tolist(), strict=True)
            shifts = tuple(replace(item, after=value, std=std) for item, value, std in fitted)
        values = {item.name: item for item in shifts}
        joints = self.baseline.rms_nm.size
        friction = [
            {
                "joint": joint,
                "viscous": number(values[f"FV_{joint}"].after) if f"FV_{joint}" in values else None,
                "coulomb": number(values[f"FS_{joint}"].after) if f"FS_{joint}" in values else None,
            }
            for joint in range(1, joints + 1)
        ]
        fit = self.rms_after_nm
        heldout = np.zeros(0) if self.heldout is None else self.heldout.rms_after_nm
        if self.offer is not None:
            fit, heldout = self.offer.fitted_rms, self.offer.heldout_rms
        return {
            "format": MODEL_FORMAT,
            "robot": self.robot,
            "base_parameters": [
                {"name": item.name, "value": number(item.after), "std": number(item.std), "unit": item.unit}
                for item in values.values()
            ],
            "physical_parameters": [],
            "friction": friction,
            "effects": [finding.to_json() for finding in self.findings],
            **({} if self.offer is None else {"class_terms": plain(dict(self.offer.terms))}),
            "rms_nm": {"fit": json_list(fit), "heldout": json_list(heldout)},
            "certificate": {},
            "provenance": plain(dict(self.provenance)),
        }
