"""Motor encoder against link encoder: is their difference a wind-up under load, a delay between them, or both?

Δ = q − q_link is regressed on what each claim says (τ/K for elasticity, d·q̇ for a delay) and each is judged by the
share of Δ it leaves on a recording that was not used. Torque is not asked: a difference of a milliradian moves it too
little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.settings import MOST
from identification.recordings.recording import Recording
from identification.signals.aperiodic import cutoff_of, sixth_order_difference, zero_phase_low_pass

CLAIMS = {"delay": (0,), "elasticity": (1,), "delay and elasticity": (0, 1)}
"""Columns of q̇ and τ that each claim uses beside a constant."""
WORTH_A_SECOND = 0.8
"""Both claims together are made only if they leave less than this share of what the better one alone leaves."""


@dataclass(frozen=True, slots=True)
class EncoderDifference:
    """One joint, counted from 1. rms_rad: of the difference off its mean, on the unseen data.

    left: share of it that each claim leaves there. delay_s, compliance: of the claim made (rad/Nm); 0 where not part.
    """

    joint: int
    claim: str
    rms_rad: float
    left: dict[str, float]
    delay_s: float
    compliance: float

    @property
    def sentence(self) -> str:
        """For the operator."""
        shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in self.left.items())
        parts = []
        if self.delay_s:
            parts.append(f"the link encoder is {1e3 * self.delay_s:.2f} ms late")
        if self.compliance:
            parts.append(f"the joint winds up with {1.0 / self.compliance:.2g} Nm/rad")
        return (
            f"Joint {self.joint}: motor and link encoder differ by {1e3 * self.rms_rad:.2g} mrad RMS: "
            f"{' and '.join(parts) if parts else 'neither delay nor wind-up'} (left on unseen data: {shares})."
        )

    def to_json(self) -> dict[str, Any]:
        """One entry of `encoder_difference` in diagnosis.json."""
        return {
            "joint": self.joint,
            "claim": self.claim,
            "rms_rad": self.rms_rad,
            "share_left_unseen": self.left,
            "delay_s": self.delay_s,
            "compliance_rad_per_nm": self.compliance,
            "sentence": self.sentence,
        }


def compare_encoders(fitted: Sequence[Recording], unseen: Sequence[Recording]) -> tuple[EncoderDifference, ...]:
    """Joints whose link encoder moves in every recording, each with the simplest claim that unseen data bear out.

    Without unseen recordings the second half of each fitted one is. A wind-up with a negative stiffness is no claim.
    """
    both = [*fitted, *unseen]
    if not fitted or any(item.link_position is None for item in both):
        return ()
    parts = [_columns(item) for item in fitted]
    others = [_columns(item) for item in unseen]
    if not others:
        halves = [[np.array_split(array, 2) for array in part] for part in parts]
        others = [(a[1], b[1], c[1]) for a, b, c in halves]
        parts = [(a[0], b[0], c[0]) for a, b, c in halves]
    return tuple(
        _judged(joint, parts, others)
        for joint in range(fitted[0].n)
        if all(np.isfinite(part[0][:, joint]).all() and np.ptp(part[0][:, joint]) > 0.0 for part in (*parts, *others))
    )


_Part = tuple[FloatArray, FloatArray, FloatArray]


def _columns(recording: Recording) -> _Part:
    """Difference, velocity and torque (S, n), low-passed alike, ends cut."""
    step = recording.sampling_period_s
    cutoff = cutoff_of(None, step)
    edge = round(2.0 / cutoff / step)
    assert recording.link_position is not None
    smooth = [
        zero_phase_low_pass(values, step, cutoff)
        for values in (recording.position - recording.link_position, recording.position, recording.torque)
    ]
    kept = slice(edge, len(recording.time) - edge)
    return smooth[0][kept], sixth_order_difference(smooth[1], step)[kept], smooth[2][kept]


def _design(part: _Part, joint: int, columns: tuple[int, ...]) -> FloatArray:
    chosen = [part[1 + column][:, joint] for column in columns]
    return np.column_stack([np.ones(len(part[0])), *chosen])


def _judged(joint: int, parts: Sequence[_Part], others: Sequence[_Part]) -> EncoderDifference:
    # The zero between two encoders is no claim: it is taken off each recording.
    target = np.concatenate([part[0][:, joint] - part[0][:, joint].mean() for part in others])
    left, values = {}, {}
    for claim, columns in CLAIMS.items():
        design = np.concatenate([_design(part, joint, columns) for part in parts])
        solution = np.linalg.lstsq(design, np.concatenate([part[0][:, joint] for part in parts]), rcond=None)[0]
        rest = [part[0][:, joint] - _design(part, joint, columns) @ solution for part in others]
        left[claim] = float(
            np.sqrt(np.mean(np.concatenate([item - item.mean() for item in rest]) ** 2) / np.mean(target**2))
        )
        values[claim] = dict(zip(columns, solution[1:].tolist(), strict=True))
    possible = [claim for claim in CLAIMS if values[claim].get(1, 1.0) > 0.0]
    best = min((claim for claim in possible if claim != "delay and elasticity"), key=lambda claim: left[claim])
    if "delay and elasticity" in possible and left["delay and elasticity"] < WORTH_A_SECOND * left[best]:
        best = "delay and elasticity"
    # A claim that leaves most of the difference on unseen data is none.
    claim = best if left[best] < MOST else "neither"
    made = values.get(claim, {})
    return EncoderDifference(
        joint + 1, claim, float(np.sqrt(np.mean(target**2))), left, made.get(0, 0.0), made.get(1, 0.0)
    )
