"""Scores one diagnosis against the opened label of its case. Pure: two JSON objects in, one `CaseScore` out.

What counts as right is decided here and nowhere else. ``prove_table`` sums the scores up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from daemon.proof.classes import Json, class_answer, excess_removed

_IN_SI = {"%": (0.01, "1"), "mrad": (1e-3, "rad"), "ms": (1e-3, "s"), "°": (math.pi / 180.0, "rad")}
# On an iiwa the axis after these joints crosses theirs, so its torque is one of their bending moments.
_BENT_BY_NEXT_JOINT = (1, 3, 5, 6)
_BETWEEN_PERIODS = ("external_contact", "payload_change", "torque_sensor_drift", "thermal_friction")


@dataclass(frozen=True, slots=True)
class EffectScore:
    """How one hidden effect fared.

    named: the finding's own name and place are right. in_set: or one of its alternatives is. placed: some finding sits
    at the right place, whatever its name. amplitude_error: |estimate - truth| / |truth|, None where nothing compares;
    covered: whether the 95 % interval holds the truth, None without one.
    """

    family: str
    form: str
    visibility: float
    partial_visibility: float
    share: float | None
    named: bool
    in_set: bool
    placed: bool
    amplitude_error: float | None = None
    covered: bool | None = None


@dataclass(frozen=True, slots=True)
class CaseScore:
    """How one case fared.

    claimed: effect names of all findings, best first; set_sizes: how many names each leaves open. extras: findings that
    answer no hidden effect; misnamed: how many of them stand for one that got no answer, the others are spurious.
    detected: whether any misfit was reported. right: for structural cases and common lags, whether the answer was the
    only right one. removed: share of the held-out excess energy that the findings removed, None where there is none.
    failed: why there is no diagnosis; such a case is wrong in every count. classes, class_right, class_right_by_share,
    classes_elsewhere: what the torque is said to depend on (`classes.ClassAnswer`); removed_by_classes: as removed, by
    the classes without names. recording: of a case that is a real recording with an effect added.
    """

    group: str
    kind: str
    excitation: str
    effects: tuple[EffectScore, ...]
    claimed: tuple[str, ...]
    claimed_joints: tuple[int | None, ...]
    set_sizes: tuple[int, ...]
    extras: int
    misnamed: int
    detected: bool
    right: bool | None
    removed: float | None
    seconds: float
    failed: str | None = None
    verdict: str | None = None
    classes: tuple[str, ...] = ()
    class_right: bool | None = None
    class_right_by_share: bool | None = None
    classes_elsewhere: int = 0
    removed_by_classes: float | None = None
    recording: str | None = None


def score_case(
    label: Json, diagnosis: Json | None, seconds: float, failed: str | None = None, bare: Json | None = None
) -> CaseScore:
    """Score of one case. diagnosis: contract §6, or None with the sentence of why there is none.

    bare: diagnosis of the same real recording without the effect. What it names there is the recording's own, and no
    extra where it is named again.
    """
    findings: Sequence[Json] = sorted(
        diagnosis["findings"] if diagnosis else (), key=lambda finding: -float(finding.get("score") or 0.0)
    )
    truths: Sequence[Json] = label["effects"]
    matches = _matches(truths, findings)
    scores = []
    for truth, match in zip(truths, matches, strict=True):
        error, covered = _amplitude(truth, match)
        named = match is not None and _is_named(truth, match)
        scores.append(
            EffectScore(
                family=truth["family"],
                form=truth["form"],
                visibility=float(truth["lambda"]),
                partial_visibility=float(truth["partial_lambda"]),
                share=truth.get("share"),
                named=named,
                in_set=named or match is not None,
                placed=any(_is_placed(truth, finding) for finding in findings),
                amplitude_error=error if named else None,
                covered=covered if named else None,
            )
        )
    used = {id(match) for match in matches if match is not None}
    own = [(finding["effect"], finding.get("joint")) for finding in (bare or {}).get("findings", ())]
    extras = sum(
        id(finding) not in used
        and not any(_covers(truth, finding) for truth in truths)
        and (finding["effect"], finding.get("joint")) not in own
        for finding in findings
    )
    depends = class_answer(truths, diagnosis, bare)
    return CaseScore(
        group=label["group"],
        kind=label["kind"],
        excitation=label["motions"]["A"][0],
        effects=tuple(scores),
        claimed=tuple(finding["effect"] for finding in findings),
        claimed_joints=tuple(finding.get("joint") for finding in findings),
        set_sizes=tuple(1 + len(finding.get("alternatives", ())) for finding in findings),
        extras=extras,
        misnamed=min(extras, sum(match is None for match in matches)),
        detected=bool(findings) or (diagnosis is not None and any(diagnosis["baseline"]["detected"])),
        right=_is_structurally_right(label, diagnosis, findings, extras),
        removed=_removed(label, diagnosis, bare, "heldout", ("rms_before_nm", "rms_after_nm")),
        seconds=seconds,
        failed=failed,
        verdict=None if diagnosis is None else diagnosis.get("verdict"),
        classes=depends.claims,
        class_right=depends.right,
        class_right_by_share=depends.right_by_share,
        classes_elsewhere=depends.elsewhere,
        removed_by_classes=None
        if diagnosis is not None and not diagnosis.get("class_model")
        else _removed(label, diagnosis, bare, "class_model", ("heldout_before_nm", "heldout_after_nm")),
        recording=label.get("recording"),
    )


def _matches(truths: Sequence[Json], findings: Sequence[Json]) -> list[Json | None]:
    """The finding that answers each truth: its own name first, then a set that holds it; each finding once."""
    matches: list[Json | None] = [None] * len(truths)
    for accepts in (_is_own_name, _is_in_set):
        for i, truth in enumerate(truths):
            for finding in findings:
                free = all(finding is not match for match in matches)
                if matches[i] is None and free and accepts(truth, finding):
                    matches[i] = finding
    for i, truth in enumerate(truths):
        if matches[i] is None:
            matches[i] = next((finding for finding in findings if _covers(truth, finding)), None)
    return matches


def _is_named(truth: Json, finding: Json) -> bool:
    return _covers(truth, finding) or _is_own_name(truth, finding)


def _is_own_name(truth: Json, finding: Json) -> bool:
    if finding["effect"] in truth["acceptable"]:
        return _is_placed(truth, finding)
    return _is_same_torque(truth, finding["effect"], finding.get("joint"))


def _is_in_set(truth: Json, finding: Json) -> bool:
    return any(
        (other["effect"] in truth["acceptable"] and _is_placed(truth, {**finding, **other, "link": None}))
        or _is_same_torque(truth, other["effect"], other.get("joint"))
        for other in finding.get("alternatives", ())
    )


def _covers(truth: Json, finding: Json) -> bool:
    return finding["effect"] in truth.get("covered_by", ()) and finding.get("joint") == truth["joint"]


def _is_placed(truth: Json, finding: Json) -> bool:
    """Joint for joint, link for link. A force whose torque on the last joints drowns in noise may sit before them."""
    if truth["link"] is not None and truth["effect"] == "external_contact":
        link = finding.get("link")
        return link is None or max(truth["visible_joints"], default=1) <= link <= truth["link"]
    if truth["link"] is not None:
        return finding.get("link") in (None, truth["link"])
    if truth["joint"] is None and truth["family"] != "delayall":
        return finding.get("joint") is None or finding["effect"] not in truth["acceptable"]
    return bool(finding.get("joint") == truth["joint"])


def _is_same_torque(truth: Json, effect: str, joint: int | None) -> bool:
    """Bending crosstalk of a joint and crosstalk from the joint after it, where the two axes cross."""
    if joint != truth["joint"] or joint not in _BENT_BY_NEXT_JOINT:
        return False
    if truth["effect"] == "joint_crosstalk":
        return bool(effect == "bending_crosstalk" and truth["other_joint"] == joint + 1)
    return bool(truth["effect"] == "bending_crosstalk" and effect == "joint_crosstalk")


def _amplitude(truth: Json, finding: Json | None) -> tuple[float | None, bool | None]:
    wanted = truth.get("amplitude")
    if finding is None or not wanted or finding["effect"] != truth["effect"]:
        return None, None
    parameter = finding["parameters"].get(wanted["name"])
    if parameter is None or not isinstance(parameter.get("value"), (int, float)):
        return None, None
    scale, unit = _IN_SI.get(parameter["unit"], (1.0, parameter["unit"]))
    if unit != wanted["unit"]:
        raise ValueError(f"{finding['effect']}'s {wanted['name']} is in {unit}, its truth in {wanted['unit']}")
    distance = abs(scale * parameter["value"] - wanted["value"])
    std = parameter.get("std")
    covered = distance <= 1.96 * scale * std if isinstance(std, (int, float)) and math.isfinite(std) else None
    return distance / abs(wanted["value"]), covered


def _is_structurally_right(label: Json, diagnosis: Json | None, findings: Sequence[Json], extras: int) -> bool | None:
    """Whether the only right answer was given, where there is one: a set with its experiment, or "not identifiable"."""
    kind = label["kind"]
    if label["group"] != "structural" and kind != "common_lag":
        return None
    if diagnosis is None or extras:
        return False
    if kind in ("constant_payload", "zero_first", "zero_last"):
        effect, joint = {
            "constant_payload": ("payload", None),
            "zero_first": ("joint_zero_offset", 1),
            "zero_last": ("joint_zero_offset", 7),
        }[kind]
        said = diagnosis.get("not_identifiable_here", ())
        return not findings and any(
            item["effect"] == effect and (joint is None or item["joint"] == joint) for item in said
        )
    if len(findings) != 1:
        return False
    finding, (truth,) = findings[0], label["effects"]
    if kind == "common_lag":
        return bool(finding["effect"] == "torque_delay" and finding["joint"] is None)
    told = finding.get("separating_experiment") is not None
    if kind == "asymmetric_coulomb":  # the contract has one name for both halves of this set
        return told and (_is_named(truth, finding) or _is_in_set(truth, finding))
    names = {(finding["effect"], finding["joint"])}
    names |= {(other["effect"], other["joint"]) for other in finding.get("alternatives", ())}
    return told and {("bending_crosstalk", 1), ("joint_crosstalk", 1)} <= names


def _removed(
    label: Json, diagnosis: Json | None, bare: Json | None, table: str, names: tuple[str, str]
) -> float | None:
    """`excess_removed` on the held-out recording, on the joints affected, by one table of the diagnosis.

    Joints that the effects are visible on: the others hold nothing but noise, of only few periods. The floor is the
    noise, or what the plain fit leaves of the same real recording without the effect. None for effects between periods,
    as those of the held-out recording are its own and are found there.
    """
    truths = label["effects"]
    if not truths or any(truth["effect"] in _BETWEEN_PERIODS or "time" in truth.get("classes", ()) for truth in truths):
        return None
    if diagnosis is None:
        return 0.0
    heldout = diagnosis.get("heldout") or {}
    floors = heldout.get("noise_floor_nm") or ()
    if bare is not None:
        floors = (bare.get("heldout") or {}).get("rms_before_nm") or ()
    joints = sorted({joint - 1 for truth in truths for joint in truth["visible_joints"] if joint <= len(floors)})
    values = [(diagnosis.get(table) or {}).get(name) or () for name in names]
    if not joints or any(len(row) <= joints[-1] for row in values):
        return None
    before, after = ([row[joint] for joint in joints] for row in values)
    return excess_removed(before, after, [floors[joint] for joint in joints])
