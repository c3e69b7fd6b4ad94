"""What is asked of physical parameters: the bounds (10b) and the rules (10c), (10d), corrected, as numbers.

Here: the rules as one configurable value object, as linear inequalities for the programs, and as an exact check of a
finished set. Not here: solving (`semidefinite`, `constrained`).

In y = (m, h = m·l_C, I_C, F) every one of these rules is linear once max and min are written out. Two misprints of
(10d) are corrected: the off-diagonal row means I_ixz (not I_izz), and the friction bound is on F_iv. (10c) follows from
(10d): off-diagonal entries of at most a tenth of the smallest diagonal one leave the tensor diagonally dominant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.errors import EstimationError
from identification.physical_parameters import INERTIAL_COUNT, PhysicalParameters
from identification.robots.model import RobotModel

_DIAGONAL = (4, 7, 9)  # I_xx, I_yy, I_zz in a link's ten entries of y
_OFF_DIAGONAL = (5, 6, 8)  # I_xy, I_xz, I_yz
_AXIS = "xyz"


@dataclass(frozen=True, slots=True)
class FeasibilityRules:
    """Bounds (10b) and the rules (10d). The paper never published its bounds; these defaults are ours for an iiwa.

    Where they come from: Table 3's links weigh 0.35 to 4.5 kg and the whole arm 30 kg; its centres of mass lie within
    0.21 m of their frames, and no housing reaches 0.3 m; 0.2 kg m² is 10 kg at 0.14 m, four times Table 3's largest
    entry; 1e-4 kg m² and 0.1 Nm s/rad are printed in (10d); friction of 2 is five times Table 3's largest.

    mass, diagonal_inertia, viscous, coulomb, rotor_inertia: (lower, upper) in kg, kg m², Nm s/rad, Nm, kg m².
    center_of_mass: largest |coordinate| in the link frame, m. largest_ratio: of two diagonal inertia entries of one
    link. off_diagonal: largest |off-diagonal entry| as a share of the smallest diagonal one. slender_axis: per link the
    axis (0 x, 1 y, 2 z) parallel to the link's length, whose diagonal entry is at most `slender_share` of the others;
    None for none. radius_of_gyration: largest √(I_kk/m) of a link, m; inf for no such rule (the paper has none).
    lightest: whether, of sets that fit equally well, the lightest is wanted; where the bounds on mass are wide, a mass
    that no torque depends on would otherwise end in their middle.
    """

    mass: tuple[float, float] = (0.1, 10.0)
    center_of_mass: float = 0.3
    diagonal_inertia: tuple[float, float] = (1e-4, 0.2)
    viscous: tuple[float, float] = (0.1, 2.0)
    coulomb: tuple[float, float] = (0.0, 2.0)
    rotor_inertia: tuple[float, float] = (0.0, np.inf)
    largest_ratio: float = 100.0
    off_diagonal: float = 0.1
    slender_axis: tuple[int | None, ...] = ()
    slender_share: float = 1.0 / 3.0
    radius_of_gyration: float = np.inf
    lightest: bool = False

    def with_bounds(self, bounds: Mapping[str, Any] | None) -> FeasibilityRules:
        """These rules with some entries replaced, as an operator writes them: {"mass": [0.5, 8.0]}.

        Pairs are (lower, upper), null for no limit. Raises EstimationError naming an entry that is not known or is no
        number, or a lower bound above its upper one.
        """
        changes: dict[str, Any] = {}
        for name, value in (bounds or {}).items():
            present = getattr(self, name, None) if name in self.__dataclass_fields__ else None
            if name not in self.__dataclass_fields__:
                known = ", ".join(self.__dataclass_fields__)
                raise EstimationError(f"'{name}' is no bound of program (10); known are {known}")
            try:
                changes[name] = _like(present, value)
            except (TypeError, ValueError) as error:
                raise EstimationError(f"The bound '{name}' cannot be {value!r}: {error}") from error
        return replace(self, **changes)

    def axis_of(self, link: int) -> int | None:
        """Axis along the link's length (link counted from 0), None without such a rule."""
        return self.slender_axis[link] if link < len(self.slender_axis) else None


def _like(present: Any, value: Any) -> Any:
    """The value in the form of the present entry: a number, a switch, (lower, upper), or axes of the links."""
    if isinstance(present, bool):
        if not isinstance(value, bool):
            raise ValueError("it is true or false")
        return value
    if isinstance(present, float):
        number = np.inf if value is None else float(value)
        if not number > 0.0:
            raise ValueError("it must be positive")
        return number
    entries = tuple(value)
    if len(present) == 2 and isinstance(present[0], float):
        lower, upper = entries
        pair = (0.0 if lower is None else float(lower), np.inf if upper is None else float(upper))
        if not 0.0 <= pair[0] <= pair[1]:
            raise ValueError("the lower bound must be at least zero and at most the upper one")
        return pair
    if any(axis not in (0, 1, 2, None) for axis in entries):
        raise ValueError("an axis is 0, 1, 2 or null")
    return entries


@dataclass(frozen=True, slots=True)
class Violation:
    """One rule that does not hold: which, for which link (from 1), the value and what it may be at most."""

    rule: str
    link: int
    value: float
    limit: float


def rules_for(robot: RobotModel) -> FeasibilityRules:
    """Default rules of a robot.

    An iiwa: those of the paper, links 1, 3, 5 slender along z and 2, 4 along y. Any other: wide bounds that only keep
    numbers sane (its masses and friction are unknown), no slender axis, radii of gyration no longer than the longest
    link, and the lightest of equally good sets.
    """
    if robot.name in ("iiwa14", "iiwa7"):
        return FeasibilityRules(slender_axis=(2, 1, 2, 1, 2, None, None))
    reach = float(np.linalg.norm(robot.kinematics.translation, axis=1).max(initial=0.0))
    return FeasibilityRules(
        mass=(1e-2, 2000.0),
        center_of_mass=max(0.3, reach),
        diagonal_inertia=(1e-4, 2000.0),
        viscous=(0.0, np.inf),
        coulomb=(0.0, np.inf),
        radius_of_gyration=max(0.3, reach),
        lightest=True,
    )


def rules_of_matter() -> FeasibilityRules:
    """What any body keeps: positive mass and inertia, friction that takes energy out; no size, no weight, no shape."""
    unbounded = (0.0, np.inf)
    return FeasibilityRules(
        mass=unbounded,
        center_of_mass=np.inf,
        diagonal_inertia=unbounded,
        viscous=unbounded,
        coulomb=unbounded,
        lightest=True,
    )


def linear_inequalities(rules: FeasibilityRules, links: int, extras: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
    """(10b) and (10d) as A y ≤ b for y (links, 10 + extras) raveled, rows scaled to compare like with like.

    extras: symbols after the ten inertial entries of every link (FV, FS, IA, OFF); offsets are free.
    """
    stride = INERTIAL_COUNT + len(extras)
    rows: list[FloatArray] = []
    bounds: list[float] = []
    bounds_of_extra = {"FV": rules.viscous, "FS": rules.coulomb, "IA": rules.rotor_inertia}

    def at_most(link: int, terms: dict[int, float], limit: float = 0.0) -> None:
        if np.isinf(limit) or np.any(np.isinf(list(terms.values()))):
            return
        row = np.zeros((links, stride))
        for entry, factor in terms.items():
            row[link, entry] += factor
        rows.append(row.ravel())
        bounds.append(limit)

    for link in range(links):
        at_most(link, {0: -1.0}, -rules.mass[0])
        at_most(link, {0: 1.0}, rules.mass[1])
        for entry in (1, 2, 3):
            at_most(link, {entry: 1.0, 0: -rules.center_of_mass})
            at_most(link, {entry: -1.0, 0: -rules.center_of_mass})
        for place, entry in enumerate(_DIAGONAL):
            first, second = (other for other in _DIAGONAL if other != entry)
            at_most(link, {entry: -1.0}, -rules.diagonal_inertia[0])
            at_most(link, {entry: 1.0}, rules.diagonal_inertia[1])
            if np.isfinite(rules.radius_of_gyration):
                at_most(link, {entry: 1.0, 0: -(rules.radius_of_gyration**2)})
            at_most(link, {entry: 1.0, first: -1.0, second: -1.0})
            for other in (first, second):
                at_most(link, {entry: 1.0, other: -rules.largest_ratio})
                if rules.axis_of(link) == place:
                    at_most(link, {entry: 1.0, other: -rules.slender_share})
            for off_diagonal in _OFF_DIAGONAL:
                at_most(link, {off_diagonal: 1.0, entry: -rules.off_diagonal})
                at_most(link, {off_diagonal: -1.0, entry: -rules.off_diagonal})
        for entry, extra in enumerate(extras, start=INERTIAL_COUNT):
            if extra in bounds_of_extra:
                lower, upper = bounds_of_extra[extra]
                at_most(link, {entry: -1.0}, -lower)
                at_most(link, {entry: 1.0}, upper)
    return np.array(rows), np.array(bounds)


def friction_beyond(
    rules: FeasibilityRules, names: Sequence[str], values: FloatArray, std: FloatArray, units: Sequence[str]
) -> str:
    """Which friction of a fit, values and std (p,), no set inside (10b) can have, by more than 2 σ; empty for none."""
    bounds = {f"{symbol}_": pair for symbol, pair in (("FV", rules.viscous), ("FS", rules.coulomb))}
    beyond = []
    for name, value, spread, unit in zip(names, values, std, units, strict=True):
        lower, upper = bounds.get(name[:3], (-np.inf, np.inf))
        nearest = min(max(value, lower), upper)
        if abs(value - nearest) > 2.0 * spread:
            side = "most" if value > upper else "least"
            beyond.append(f"{name} = {value:.3g} ± {spread:.2g} {unit} (at {side} {nearest:g})")
    if not beyond:
        return ""
    return (
        f"No set inside the bounds (10b) has the friction that was measured: {', '.join(beyond)}. So the feasible "
        "values and 'fit, physical' are not this arm's; widen the bounds viscous and coulomb (--bounds)"
    )


def violations(
    rules: FeasibilityRules, physical: PhysicalParameters, extras: tuple[str, ...] = ("FV", "FS")
) -> tuple[Violation, ...]:
    """Every rule of (10b), (10c), (10d) that the set breaks, compared exactly, without any tolerance.

    extras: which friction symbols were fitted; friction that was not is not judged.
    """
    found: list[Violation] = []

    def judge(rule: str, link: int, value: float, limit: float) -> None:
        if not value <= limit:
            found.append(Violation(rule, link + 1, float(value), float(limit)))

    for link in range(physical.n):
        mass, inertia = physical.mass[link], physical.inertia[link]
        judge("(10b) mass, lower", link, -mass, -rules.mass[0])
        judge("(10b) mass, upper", link, mass, rules.mass[1])
        for axis in range(3):
            coordinate = abs(physical.center_of_mass[link, axis])
            judge(f"(10b) centre of mass {_AXIS[axis]}", link, coordinate, rules.center_of_mass)
        diagonal = np.diag(inertia)
        smallest, largest = float(diagonal.min()), float(diagonal.max())
        off_diagonal = float(np.abs(inertia[np.triu_indices(3, 1)]).max())
        judge("(10b) inertia, upper", link, largest, rules.diagonal_inertia[1])
        judge("(10b) radius of gyration", link, largest, rules.radius_of_gyration**2 * mass)
        judge("(10c) positive mass", link, -mass, -np.finfo(np.float64).tiny)
        judge("(10c) positive inertia", link, -float(np.linalg.eigvalsh(inertia)[0]), -np.finfo(np.float64).tiny)
        for axis in range(3):
            first, second = (other for other in range(3) if other != axis)
            judge(f"(10d) triangle {_AXIS[axis]}", link, diagonal[axis], diagonal[first] + diagonal[second])
            if rules.axis_of(link) == axis:
                limit = rules.slender_share * min(diagonal[first], diagonal[second])
                judge(f"(10d) slender along {_AXIS[axis]}", link, diagonal[axis], limit)
        judge("(10d) ratio of diagonal entries", link, largest, rules.largest_ratio * smallest)
        judge("(10d) off-diagonal entries", link, off_diagonal, rules.off_diagonal * smallest)
        judge("(10d) smallest diagonal entry", link, -smallest, -rules.diagonal_inertia[0])
        if "FV" in extras:
            judge("(10d) viscous friction, lower", link, -physical.viscous[link], -rules.viscous[0])
            judge("(10b) viscous friction, upper", link, physical.viscous[link], rules.viscous[1])
        if "FS" in extras:
            judge("(10b) Coulomb friction, lower", link, -physical.coulomb[link], -rules.coulomb[0])
            judge("(10b) Coulomb friction, upper", link, physical.coulomb[link], rules.coulomb[1])
    return tuple(found)
