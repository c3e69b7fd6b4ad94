"""Scores what a diagnosis says that a torque depends on: `classes` of diagnosis.json against the label's classes.

Pure. Reads nothing but the two JSON objects, so that the judge shares no code with what it judges.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import log1p
from typing import Any

Json = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ClassAnswer:
    """claims: 'own_position J3', strongest first. right: whether the strongest is on the right joint and of a right
    class, or leaves a right one open; None where the diagnosis has no classes. right_by_share: the same where claims
    count by the share of their joint's held-out error that they take, not by nats. elsewhere: how many claims lie on
    joints that the hidden effects do not reach.
    """

    claims: tuple[str, ...] = ()
    right: bool | None = None
    right_by_share: bool | None = None
    elsewhere: int = 0


def class_answer(truths: Sequence[Json], diagnosis: Json | None, bare: Json | None) -> ClassAnswer:
    """The answer of one case. bare: diagnosis of the same recording without the effect, where it is a real one.

    A claim counts by the nats, or the share of held-out error, that it has more than on the bare recording: what was
    there before is no answer. Where nothing is hidden the right answer is none.
    """
    if diagnosis is None:
        return ClassAnswer(right=False, right_by_share=False)
    if "classes" not in diagnosis:
        return ClassAnswer()
    new, by_share = (_gained(measure, diagnosis, bare or {}) for measure in (_nats, _share))
    joints = {joint for truth in truths for joint in (truth["joint"], *truth["visible_joints"])}
    return ClassAnswer(
        claims=tuple(f"{claim['class']} J{claim['joint']}" for claim in new),
        right=_right(new, truths),
        right_by_share=_right(by_share, truths),
        elsewhere=sum(claim["joint"] not in joints for claim in new),
    )


def _gained(measure: Callable[[Json, Json], float], diagnosis: Json, bare: Json) -> list[Json]:
    """Claims that count for more than on the bare recording, those that gained most first."""
    before = {_key(claim): measure(claim, bare) for claim in bare.get("classes", ())}
    gains = [(measure(claim, diagnosis) - before.get(_key(claim), 0.0), claim) for claim in diagnosis["classes"]]
    return [claim for gain, claim in sorted(gains, key=lambda pair: -pair[0]) if gain > 0.0]


def _right(new: Sequence[Json], truths: Sequence[Json]) -> bool:
    return any(_answers(new[0], truth) for truth in truths) if new and truths else not (new or truths)


def _key(claim: Json) -> tuple[Any, Any]:
    return claim["class"], claim["joint"]


def _nats(claim: Json, diagnosis: Json) -> float:
    del diagnosis
    return float(claim.get("significance") or 0.0)


def _share(claim: Json, diagnosis: Json) -> float:
    """Logarithm of how many times larger its joint's held-out RMS is without it; 0 without held-out rows."""
    after, gain = (diagnosis.get("class_model") or {}).get("heldout_after_nm"), claim.get("heldout_gain_nm")
    if not after or not gain:
        return 0.0
    place = claim["joint"] - 1
    return log1p(max(gain[place], 0.0) / after[place])


def _answers(claim: Json, truth: Json) -> bool:
    said = {claim["class"], *claim.get("alternatives", ())}
    return claim["joint"] in (truth["joint"], *truth["visible_joints"]) and bool(said & set(truth["classes"]))


def excess_removed(before: Sequence[float], after: Sequence[float], floor: Sequence[float]) -> float | None:
    """1 - E₁/E₀, E the mean square error beyond a floor, all joints together; RMS in, Nm.

    None where the excess does not exceed the floor itself, as there is then nothing that could be told from it.
    """
    noise = sum(value**2 for value in floor)
    first, last = (sum(value**2 for value in values) - noise for values in (before, after))
    return min(1.0, 1.0 - last / first) if first > noise else None
