"""One local search for an excitation trajectory: what is asked for, and SLSQP from one start.

Here: the settings, the problem as a worker process receives it, and the descent. Not here: the tournament of many
starts (`design`, the only caller), the objective and the constraints.

The search runs in the coefficients divided by the joint's velocity limit, in the null space of the corrected (14c).
What SLSQP leaves slightly outside is repaired exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.optimize import minimize

from identification.arrays import FloatArray
from identification.errors import DesignError
from identification.excitation.constraints import (
    Constraints,
    PaperConstraints,
    TrueConstraints,
    repaired,
    rest_null_space,
)
from identification.excitation.detectability_term import DetectabilityTerm, bounded_condition
from identification.excitation.limits import LONGEST_PERIOD_S, ExcitationLimits
from identification.excitation.nominal import TorqueLimit
from identification.excitation.objective import (
    DETECTABILITY,
    PAYLOAD,
    SIGN_WIDTH_RAD_S,
    BaseMatrix,
    FourierObjective,
    Term,
    mixture_weights,
    terms_of,
)
from identification.excitation.payload_term import PayloadTerm

_HOPELESS = 1.0e3
"""Value of the objective where the regressor has lost rank; far above any log cond that can be computed."""


@dataclass(frozen=True, slots=True)
class Descent:
    """SLSQP iterations of one descent. samples: how much finer than the settings' samples it looks; the sign of the
    velocity is sharpened alike. sharpness: of the condition number that it sees (`log_condition_number`), None: as it
    is; what a motion is worth is told by the condition number as it is.
    """

    iterations: int
    samples: int = 1
    sharpness: float | None = None


@dataclass(frozen=True, slots=True)
class Stage:
    """One round of the tournament: the part of all starts that takes part, the descent each one gets (see `Descent`),
    and the share of the time budget after which no further search of this round begins.
    """

    part: float
    iterations: int
    budget_share: float
    samples: int = 1
    sharpness: float | None = None

    @property
    def descent(self) -> Descent:
        """What each start of the round gets."""
        return Descent(self.iterations, self.samples, self.sharpness)


STAGES = (Stage(1.0, 60, 0.3, 1, 4.0), Stage(0.3, 60, 0.4, 1, 12.0), Stage(0.1, 60, 0.5, 2, 32.0))
HOP = (Descent(40, 1, 8.0), Descent(60, 2, 32.0))
POLISH = Descent(150, 4, 128.0)


@dataclass(frozen=True, slots=True)
class DesignSettings:
    """What to design.

    objective: "cond", "d", "a", "detectability", "payload" or a mix such as "cond:1,d:2". limits: "paper" =
    (14c-g), corrected; "true" = |q|, |q̇|, |q̈| along the path, and |τ| where a prior of the arm foresees it.
    budget_s: time for search, ranking and verification together (needs a clock); without it all starts run, and the
    result depends on seed and starts alone. samples: of the search, per period; figures are reported at 100 Hz.
    offset_rad: centre of each joint's motion, by default the middle of its range. noise_nm: torque noise of each joint
    per sample at 1 kHz, by which D, A and detectability weigh the rows; None weighs all alike. periods: of the run
    effects shall show in. hop: what each disturbed motion goes through, polish: what the best ones get at last, within
    a budget.
    """

    objective: str = "cond"
    harmonics: int = 5
    period_s: float = 10.0
    limits: Literal["paper", "true"] = "paper"
    seed: int = 0
    budget_s: float | None = None
    starts: int = 96
    processes: int = 2
    samples: int = 64
    offset_rad: tuple[float, ...] | None = None
    noise_nm: tuple[float, ...] | None = None
    periods: int = 16
    stages: tuple[Stage, ...] = STAGES
    hop: tuple[Descent, ...] = HOP
    polish: Descent = POLISH

    def __post_init__(self) -> None:
        """Refuse settings nothing can be designed for."""
        mixture_weights(self.objective)
        if self.limits not in ("paper", "true"):
            raise DesignError(f"Unknown limits '{self.limits}'; known are paper, true.")
        if not 0.0 < self.period_s <= LONGEST_PERIOD_S:
            raise DesignError(
                f"The period must be a positive number of seconds, at most {LONGEST_PERIOD_S:g}, not {self.period_s}."
            )
        if self.budget_s is not None and not 0.0 < self.budget_s < np.inf:
            raise DesignError(f"The budget must be a positive number of seconds, not {self.budget_s}.")
        if self.seed < 0:
            raise DesignError(f"The seed must not be negative, as {self.seed} is.")
        if self.harmonics < 3 or self.starts < 1 or self.processes < 1:
            raise DesignError("A design needs at least 3 harmonics, one start and one process.")
        if self.noise_nm is not None and not all(np.isfinite(x) and x > 0.0 for x in self.noise_nm):
            raise DesignError("The torque noise needs one positive number for each joint, Nm.")
        if self.samples < 4 * self.harmonics:
            raise DesignError(f"{self.samples} samples cannot resolve {self.harmonics} harmonics; take more.")


@dataclass(frozen=True, slots=True)
class Problem:
    """All a worker process needs, small and picklable. room: a penalty on coming near to things, from the caller."""

    base: BaseMatrix
    limits: ExcitationLimits
    settings: DesignSettings
    offset: FloatArray
    detectability: DetectabilityTerm | None = None
    payload: PayloadTerm | None = None
    torque: TorqueLimit | None = None
    room: Term | None = None

    def terms(self, sharpness: float | None = None) -> tuple[Term, ...]:
        """What is minimised: the objective, and what keeps torque, condition number and distances within bounds."""
        noise = None if self.settings.noise_nm is None else np.array(self.settings.noise_nm)
        others = {DETECTABILITY: self.detectability, PAYLOAD: self.payload}
        terms = terms_of(self.settings.objective, noise, others, sharpness)
        if self.detectability is not None:
            terms += (bounded_condition,)
        return (*terms, *(term for term in (self.torque, self.room) if term is not None))

    def constraints(self) -> Constraints:
        """The set (14) or the true limits, for this problem."""
        frequency, harmonics = 1.0 / self.settings.period_s, self.settings.harmonics
        if self.settings.limits == "paper":
            return PaperConstraints(self.limits, self.offset, frequency, harmonics)
        return TrueConstraints(self.limits, self.offset, frequency, harmonics, 10 * harmonics)


class _TimeIsUpError(Exception):
    """Raised inside SLSQP, which knows no other way to be stopped."""


class LocalSearch:
    """SLSQP from one start: `random_start` draws one, `improve` walks downhill; both return (n, 2 L) coefficients."""

    def __init__(self, problem: Problem) -> None:
        settings = problem.settings
        self._constraints = problem.constraints()
        self._basis = rest_null_space(settings.harmonics)
        self._scale = problem.limits.velocity[:, None]
        self._offset = problem.offset
        self._problem = problem
        descents = [*(stage.descent for stage in settings.stages), *settings.hop, settings.polish]
        self._figure = self._seen_by(Descent(0, max(descent.samples for descent in descents)))
        self._objective = self._figure
        self._spread = PaperConstraints(problem.limits, problem.offset, 1.0 / settings.period_s, settings.harmonics).box
        rows = self._constraints.linear_rows() @ self._basis * self._scale[:, :, None]
        self._linear = _on_own_joint(rows)
        self._shape = (rows.shape[0], rows.shape[2])

    def _seen_by(self, descent: Descent) -> FourierObjective:
        settings = self._problem.settings
        return FourierObjective(
            self._problem.base,
            self._problem.terms(descent.sharpness),
            1.0 / settings.period_s,
            settings.harmonics,
            settings.samples * descent.samples,
            SIGN_WIDTH_RAD_S / descent.samples,
        )

    def random_start(self, generator: np.random.Generator) -> FloatArray:
        """Random coefficients at rest at the start, each joint using 60 to 100 % of what its limits allow."""
        coefficients = generator.normal(size=self._spread.shape) * self._spread
        coefficients = coefficients @ self._basis @ self._basis.T
        use = generator.uniform(0.6, 1.0, size=len(coefficients)) / self._constraints.excess(coefficients)
        return np.asarray(coefficients * use[:, None])

    def improve(
        self, coefficients: FloatArray, descent: Descent, time_is_up: Callable[[], bool] | None = None
    ) -> tuple[float, FloatArray]:
        """Value and coefficients after one descent, exactly inside the constraints.

        The value is of the objective as it is, at the most samples that any descent of the settings has. time_is_up:
        asked after each iteration; the search then ends with what it has, if that is better.
        """
        self._objective = self._seen_by(descent)
        start = (coefficients / self._scale) @ self._basis
        reached = start.ravel()
        inequality: Any = {"type": "ineq", "fun": self._inequalities, "jac": self._inequality_slopes}

        def look(point: FloatArray) -> None:
            nonlocal reached
            reached = point.copy()
            if time_is_up is not None and time_is_up():
                raise _TimeIsUpError

        callback: Any = look  # SciPy's types know other callbacks only
        with suppress(_TimeIsUpError):
            reached = minimize(
                self._value,
                reached,
                jac=True,
                method="SLSQP",
                constraints=inequality,
                options={"maxiter": descent.iterations, "ftol": 1e-6},
                callback=callback,
            ).x
        ends = [repaired(self._coefficients(reached), self._constraints, self._basis)]
        if time_is_up is not None and time_is_up():  # on the way an iterate may be worse than where it began
            ends.append(coefficients)
        values = [float(self._figure(end, self._offset)[0]) for end in ends]
        best = int(np.argmin(values))
        return values[best], ends[best]

    def _coefficients(self, point: FloatArray) -> FloatArray:
        return (point.reshape(self._shape) @ self._basis.T) * self._scale

    def _value(self, point: FloatArray) -> tuple[float, FloatArray]:
        value, gradient, _ = self._objective(self._coefficients(point), self._offset)
        if not np.isfinite(value):
            return _HOPELESS, np.zeros_like(point)
        return value, ((gradient * self._scale) @ self._basis).ravel()

    def _inequalities(self, point: FloatArray) -> FloatArray:
        values, _ = self._constraints.values(self._coefficients(point))
        linear = self._linear @ point
        return np.concatenate([values.ravel(), 1.0 - linear, 1.0 + linear])

    def _inequality_slopes(self, point: FloatArray) -> FloatArray:
        _, slopes = self._constraints.values(self._coefficients(point))
        own = _on_own_joint((slopes * self._scale[:, None, :]) @ self._basis)
        return np.concatenate([own, -self._linear, self._linear])


def _on_own_joint(rows: FloatArray) -> FloatArray:
    """(n, c, m) rows of each joint's own variables as rows (n c, n m) of all variables."""
    joints, count, width = rows.shape
    full = np.zeros((joints, count, joints, width))
    full[np.arange(joints), :, np.arange(joints)] = rows
    return full.reshape(joints * count, joints * width)
