"""What stands on one joint: the groups of its classes with their variances, and what is said of each class."""

from __future__ import annotations

from dataclasses import dataclass, field

from identification.mismatch.unknown.evidence import Hyper, JointGram, Marginal


@dataclass(frozen=True, slots=True)
class Held:
    """A class that stands on a joint (from 0), with nats lost without it and the classes as good in its place."""

    number: int
    joint: int
    loss: float
    alternatives: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """One joint with the classes that it holds. groups: numbers of its groups in `JointRows.bases`.

    gram, part: of all rows that are fitted. grams, elsewhere: the same of other worlds, as far as they were asked for;
    states of the same groups share the former.
    """

    groups: tuple[int, ...]
    gram: JointGram
    hyper: Hyper
    part: Marginal
    elsewhere: dict[int, Marginal] = field(default_factory=dict)
    grams: dict[int, JointGram] = field(default_factory=dict)
