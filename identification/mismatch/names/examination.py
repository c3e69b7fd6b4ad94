"""What a set of effects leaves on the fitted and on the held-out recordings, and effects and places in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.evidence import Evidence
from identification.mismatch.heldout import Residuals, residuals
from identification.mismatch.problem import Problem
from identification.mismatch.search.extension import Extension, extend
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member
from identification.mismatch.search.screening import Screen, build_screen
from identification.mismatch.search.search import SearchResult
from identification.mismatch.search.trial import Trial
from identification.mismatch.settings import CAPTURE, DiagnosisSettings
from identification.mismatch.unknown.named import shown_on


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Evidences of one role, and their torque (R, n) Nm each without what changes between periods."""

    evidences: tuple[Evidence, ...]
    torque: tuple[FloatArray, ...]
    library: Library


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """A set of members fitted, and what it leaves on the fitted and on the held-out recordings."""

    extension: Extension
    after: Residuals
    heldout_after: Residuals | None


@dataclass(frozen=True, eq=False)
class Examination:
    """What members are examined with: search result, fitted and held-out rows, thresholds.

    problem: in which members are fitted, that of the result. Not slotted, as what is asked often is computed once.
    """

    problem: Problem
    result: SearchResult
    rows: Rows
    unseen: Rows | None
    settings: DiagnosisSettings

    @property
    def plain(self) -> Problem:
        """The fitted rows weighted by the noise alone, no torque without a name beside them."""
        return self.result.before.nominal

    @cached_property
    def screen(self) -> Screen:
        """All candidates, beside the base parameters alone."""
        return build_screen(self.problem, self.result.candidates)

    def check(self, members: Sequence[Member]) -> Check:
        """What a set of members leaves, fitted beside the base parameters."""
        return self.left_by(extend(self.problem, members))

    def left_by(self, extension: Extension) -> Check:
        """What an extended model leaves on the rows of both roles."""
        after, unseen = (
            None if rows is None else residuals(extension, rows.evidences, rows.library, rows.torque)
            for rows in (self.rows, self.unseen)
        )
        assert after is not None
        return Check(extension, after, unseen)


def joints_shown(trial: Trial) -> frozenset[int]:
    """Joints (from 0) on which members of a trial show (`shown_on`)."""
    fitted = extend(trial.nominal, trial.members).coefficients
    torque = [torque_of(*pair, trial.nominal.n) for pair in zip(trial.members, fitted, strict=True)]
    return frozenset(joint for own in torque for joint in shown_on(trial.nominal, own))


def torque_of(member: Member, coefficients: FloatArray, n: int) -> FloatArray:
    """Torque rows (n, R) Nm of a member."""
    rows = np.zeros((n, member.rows.rows.shape[1]))
    rows[list(member.rows.joints)] = member.rows.rows @ coefficients
    return rows


def joints_of(member: Member, torque: FloatArray) -> list[int]:
    """Joints (from 0) on which a member's torque (n, R) matters: those with at least a tenth of its largest energy."""
    energy = (torque**2).sum(axis=1)
    if len(member.rows.joints) == 1:
        return list(member.rows.joints)
    return [joint for joint in member.rows.joints if energy[joint] >= CAPTURE * energy.max()]


def name_of(effect: str, joint: int | None) -> str:
    """An effect and its place in words."""
    words = effect.replace("_", " ")
    return words if joint is None else f"{words} of joint {joint}"
