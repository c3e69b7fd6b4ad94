"""What an audit says: each difference with its numbers, its interval, what it explains, and a sentence. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from identification.audit.reading import Reading
from identification.json_values import json_list, number


@dataclass(frozen=True, slots=True)
class Number:
    """A number of a difference with its standard deviation, all terms counted."""

    name: str
    value: float
    std: float
    unit: str

    @property
    def interval(self) -> tuple[float, float]:
        """(low, high), 95 %."""
        return self.value - 1.96 * self.std, self.value + 1.96 * self.std

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types."""
        value, std = number(self.value), number(self.std)
        return {"value": value, "std": std, "unit": self.unit, "ci95": json_list(self.interval)}


def numbers_of(
    names: Iterable[str], values: Iterable[float], deviations: Iterable[float], units: Iterable[str]
) -> tuple[Number, ...]:
    """Several numbers at once."""
    each = zip(names, values, deviations, units, strict=True)
    return tuple(Number(name, float(value), float(deviation), unit) for name, value, deviation, unit in each)


def with_interval(number: Number, factor: float = 1.0, unit: str | None = None) -> str:
    """As 2.80 ± 0.11 kg: ± half of the 95 % interval, two digits of it."""
    half = 1.96 * number.std * abs(factor)
    digits = 2 if half <= 0.0 else max(0, min(6, 1 - math.floor(math.log10(half))))
    text = f"{number.value * factor:z.{digits}f} ± {half:.{digits}f}"
    return f"{text} {number.unit if unit is None else unit}".rstrip()


def by_so_much(numbers: Sequence[Number]) -> str:
    """What is added to each number of friction, with its sign: viscous +0.22 ± 0.02 Nm s/rad, coulomb …"""
    return ", ".join(f"{item.name} {'+' if item.value > 0.0 else ''}{with_interval(item)}" for item in numbers)


@dataclass(frozen=True, slots=True)
class Difference:
    """One thing that is different. effect: its name (contract §7). joint, link: from 1, None where it has none; joints:
    all of them, where they are several.

    numbers: the first is what the sentence is about. explained: share of the difference of torque that it takes away,
    of each part of the recording by the numbers of the others. log_odds: nats against its absence. against: "model"
    where the arm is another than the model says, "recording" where the data are at fault. alternatives: what these rows
    cannot tell from it.
    """

    effect: str
    joint: int | None
    link: int | None
    numbers: tuple[Number, ...]
    explained: float
    log_odds: float
    against: str
    sentence: str
    alternatives: tuple[tuple[str, int | None], ...] = ()
    joints: tuple[int, ...] = ()

    @property
    def may_be_none(self) -> bool:
        """Whether no number is clear of none by its interval: parts of the recording then disagree about it."""
        none = 1.0 if self.effect in ("torque_sensor_gain", "wrong_time_base") else 0.0
        return bool(self.numbers) and all(item.interval[0] <= none <= item.interval[1] for item in self.numbers)

    def to_finding_json(self) -> dict[str, Any]:
        """The entry of `findings` in diagnosis.json, contract §6; what an audit does not know is null."""
        entry = self.to_json()
        kept = ("effect", "joint", "link", "where", "parameters", "score", "explained", "against", "alternatives")
        return {
            **{name: entry[name] for name in kept},
            "absorbed_fraction": None,
            "significance": math.exp(-self.log_odds) if self.log_odds < 700.0 else 0.0,
            "heldout_gain_nm": [],
            "separating_experiment": None,
            "sentence": self.sentence,
        }

    def to_json(self) -> dict[str, Any]:
        """The entry of `differences` in diagnosis.json."""
        first = self.numbers[0] if self.numbers else None
        return {
            "kind": self.effect,
            "effect": self.effect,
            "joint": self.joint,
            "link": self.link,
            "where": {"joint": self.joint, "link": self.link, "joints": list(self.joints)},
            "number": None if first is None else number(first.value),
            "unit": None if first is None else first.unit,
            "interval": None if first is None else json_list(first.interval),
            "parameters": {item.name: item.to_json() for item in self.numbers},
            "explained": number(self.explained),
            "score": number(self.log_odds),
            "against": self.against,
            "alternatives": [{"effect": effect, "joint": joint} for effect, joint in self.alternatives],
            "sentence": self.sentence,
        }


@dataclass(frozen=True, slots=True)
class Audit:
    """A model against recordings. differences: the fewest that explain it. verdict: "nothing" where the model holds,
    "named", "partly", "unexplained", or "model_too_wide". source: the model's name. rms_before, rms_after: (n,) Nm on
    rows that were not used, with the differences and without. sentence: the answer as a whole. holds: whether the model
    leaves no more than of its own recordings once the differences are put in. reading: how the recordings are to be
    read, None where that was not asked.
    """

    source: str
    verdict: str
    differences: tuple[Difference, ...]
    rms_before: tuple[float, ...]
    rms_after: tuple[float, ...]
    sentence: str
    holds: bool = False
    reading: Reading | None = None

    def to_json(self) -> dict[str, Any]:
        """The entry `audit` of diagnosis.json."""
        return {
            "source": self.source,
            "verdict": self.verdict,
            "sentence": self.sentence,
            "rms_before_nm": json_list(self.rms_before),
            "rms_after_nm": json_list(self.rms_after),
        }

    @property
    def settles(self) -> bool:
        """Whether it says what differs, or that nothing does; else wrong links may."""
        return self.verdict in ("nothing", "named", "partly")

    @property
    def makes_names_worthless(self) -> bool:
        """Whether a fit of the recordings as they are read is still of another arm: a clock that a model tells is not
        exact. Columns and units are put right.
        """
        return any(item.effect == "wrong_time_base" for item in self.differences)
