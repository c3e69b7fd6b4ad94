"""Parameters of real bodies that fit the data, with a prior for what the data leave open.

A motion determines base parameters only: how a sum splits into masses, centres and inertias of single links is open,
and so is, nearly, what a motion shows weakly. Any split gives the same torques, but a link of 8 kg with 47 kg m² is no
link. Here the open directions go to a prior: bodies that are given, or a uniform body for each link. What the data
determine stays, within a fraction of its σ. Called by the fit and by the exporters.

The problem, in the pseudo-inertias P_l(π) of the links (4 × 4, positive definite exactly for real bodies):

    min ½ ‖C^(−1/2) (K π − π_b)‖² + Σ_l [tr(B_l⁻¹ P_l) − log det P_l]

The first term is the data: base parameters π_b with their covariance C. The second is the divergence between the link
and the prior body B_l, as between two mass distributions; it is least at P_l = B_l, grows without bound towards bodies
that cannot exist, and does not depend on the frame. It weighs as much as knowing each parameter of B_l to about its own
size. Friction and rotor inertia x > 0 have x/x₀ − log x. Source: Lee, Wensing, Park, "Geometric robot dynamic
identification", IEEE T-RO 2020 (the divergence); Wensing, Kim, Slotine, IEEE RA-L 2018 (pseudo-inertia).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg

from identification.base_parameters import BaseRegressor
from identification.errors import EstimationError, SolverError
from identification.estimators.physical import INERTIAL_COUNT, PhysicalParameters, pseudo_inertia
from identification.robots.model import Kinematics

__all__ = ["BodyPrior", "SettledParameters", "prior_of_bodies", "settle_open_directions", "uniform_bodies"]

FloatArray = npt.NDArray[np.float64]

_THICKNESS_SHARE = 1.0 / 6.0
"""Radius of a uniform link as a share of the longest stretch between two joints: 0.07 m for an iiwa."""
_RADIUS_WITHOUT_STRETCHES_M = 0.1
_TYPICAL_OFFSET = 1.0
"""Nm (N): a constant torque is taken to be of this size, which matters only where nothing determines it."""
_COVARIANCE_FLOOR = 1e-12
_STAGE = 100.0
_MOST_STEPS = 200
_CLOSE, _CLOSE_ENOUGH = 1e-12, 1e-2
_RESCALINGS = 3
_BASIS = pseudo_inertia(np.eye(INERTIAL_COUNT))


@dataclass(frozen=True, slots=True, eq=False)
class BodyPrior:
    """Where the directions go that the data leave open.

    bodies: (n, 4, 4) pseudo-inertias B_l, positive definite, in the link frames. scaled: whether all masses share a
    factor that the data choose (bodies whose shape is known, not their density). name: for the reader.
    """

    bodies: FloatArray
    scaled: bool
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class SettledParameters:
    """Parameters of real bodies, and what each of them rests on.

    physical: all pseudo-inertias are positive definite. full: (full,) dynamic parameters in the order of full_names.
    base_values: (p,) their base parameters. from_data: (full,) 0 to 1, the share by which the data narrow a parameter's
    variance below the prior's: 1 determined by the data, 0 left to the prior. misfit: root of the mean square of what
    the base parameters were moved by, in σ (after `widening`). widening: factor, at least 1, by which σ was widened
    because no real body comes nearer (Birge's ratio). prior: its name.
    """

    physical: PhysicalParameters
    full: FloatArray
    base_values: FloatArray
    from_data: FloatArray
    misfit: float
    widening: float
    prior: str


def uniform_bodies(kinematics: Kinematics) -> BodyPrior:
    """A uniform rod for each link, of one density and thickness, between its joint and those it carries.

    A joint may sit anywhere on its axis: where the stretch from the joint before runs along it, it is taken to sit in
    the middle of that part. A link without a further joint ends at its frame's origin.
    """
    along = np.einsum(
        "ji,ji->j", kinematics.axis, -np.einsum("jab,ja->jb", kinematics.rotation, kinematics.translation)
    )
    place = 0.5 * along[:, None] * kinematics.axis
    place_in_parent = kinematics.translation + np.einsum("jab,jb->ja", kinematics.rotation, place)
    ends = [place_in_parent[kinematics.parent == link] for link in range(kinematics.n)]
    ends = [each if len(each) else np.zeros((1, 3)) for each in ends]
    longest = max(float(np.linalg.norm(each - place[link], axis=1).max()) for link, each in enumerate(ends))
    radius = _THICKNESS_SHARE * longest if longest > 0.0 else _RADIUS_WITHOUT_STRETCHES_M
    bodies = np.zeros((kinematics.n, 4, 4))
    for link, each in enumerate(ends):
        for end in each:
            rod, middle = end - place[link], 0.5 * (end + place[link])
            weight = (float(np.linalg.norm(rod)) + 2.0 * radius) / (longest + 2.0 * radius)
            spread = np.outer(rod, rod) / 12.0 + 0.25 * radius**2 * np.eye(3)
            point = np.append(middle, 1.0)
            bodies[link] += weight * np.outer(point, point)
            bodies[link, :3, :3] += weight * spread
    return BodyPrior(bodies, scaled=True, name="uniform bodies")


def prior_of_bodies(inertial: FloatArray, kinematics: Kinematics, name: str) -> BodyPrior:
    """The bodies of given inertial parameters (n, 10), about the link frames.

    What a description gets wrong is mended just so far that a body can have it: moments below a thousandth of those of
    a uniform body of the same mass are lifted to them, and a link without mass gets a thousandth of the mean one's.
    """
    uniform = uniform_bodies(kinematics).bodies
    total = max(float(inertial[:, 0].sum()), 1e-3)
    bodies = pseudo_inertia(inertial)
    for link, body in enumerate(bodies):
        mass = max(float(body[3, 3]), 1e-3 * total / kinematics.n)
        center = body[:3, 3] / mass
        reference = uniform[link] / uniform[link, 3, 3]
        floor = 1e-3 * mass * (reference[:3, :3] - np.outer(reference[:3, 3], reference[:3, 3]))
        root = np.linalg.cholesky(floor)
        about_center = body[:3, :3] - mass * np.outer(center, center)
        values, vectors = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, about_center).T))
        lifted = root @ (vectors * np.maximum(values, 1.0)) @ vectors.T @ root.T
        point = np.append(center, 1.0)
        bodies[link] = mass * np.outer(point, point)
        bodies[link, :3, :3] += lifted
    return BodyPrior(bodies, scaled=False, name=name)


def settle_open_directions(
    base_values: FloatArray, covariance: FloatArray, base: BaseRegressor, prior: BodyPrior | None = None
) -> SettledParameters:
    """Parameters of real bodies near base parameters (p,) with their covariance (p, p); the rest goes to the prior.

    prior: uniform bodies where none is given. Where no real body comes within the covariance, it is widened until the
    nearest does, so that one impossible parameter does not push its link to the edge of what can exist. Raises
    EstimationError for values of another number, SolverError where the program does not end.
    """
    if base_values.shape != (base.size,):
        raise EstimationError(f"{base.robot.name} has {base.size} base parameters, not {len(base_values)}")
    chosen = prior if prior is not None else uniform_bodies(base.robot.kinematics)
    program = _Program(base_values, covariance, base, chosen)
    x, widening = program.path(), 1.0
    for _ in range(_RESCALINGS):
        ratio = program.distance_square(x) / (len(base_values) * widening**2)
        if ratio <= 1.0:
            break
        widening *= float(np.sqrt(ratio))
        x = program.descend(x, widening**-2, _CLOSE)
    full = x.ravel()
    physical = PhysicalParameters.from_dynamic_parameters(
        x[:, :INERTIAL_COUNT], base.extra_of(full, "FV"), base.extra_of(full, "FS")
    )
    misfit = float(np.sqrt(program.distance_square(x) / len(base_values))) / widening
    shares = program.share_of_data(x, widening**-2)
    return SettledParameters(physical, full, base.base_from_full(full), shares, misfit, widening, chosen.name)


class _Program:
    """The cost and its derivatives in x (n, 10 + effects), the dynamic parameters per link."""

    def __init__(self, values: FloatArray, covariance: FloatArray, base: BaseRegressor, prior: BodyPrior) -> None:
        std = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(std, std) + _COVARIANCE_FLOOR * np.eye(len(std))
        whiten = scipy.linalg.solve_triangular(np.linalg.cholesky(correlation), np.diag(1.0 / std), lower=True)
        self._image = whiten @ base.regrouping
        self._target = whiten @ values
        self._inverse = np.linalg.inv(prior.bodies)
        self._bodies, self._scaled, self._scale = prior.bodies, prior.scaled, 1.0
        symbols = base.options.symbols
        self._links, self._stride = base.robot.n, INERTIAL_COUNT + len(symbols)
        self._free = np.zeros((self._links, self._stride), dtype=np.bool_)
        self._free[:, [INERTIAL_COUNT + k for k, symbol in enumerate(symbols) if symbol == "OFF"]] = True
        self._typical = self._typical_effects(values, std, base)

    def _typical_effects(self, values: FloatArray, std: FloatArray, base: BaseRegressor) -> FloatArray:
        """x₀ (n, effects): the estimate, at least its σ; a joint without an estimate of its own has the median's."""
        typical = np.ones((self._links, self._stride - INERTIAL_COUNT))
        for column, symbol in enumerate(base.options.symbols):
            if symbol == "OFF":
                typical[:, column] = _TYPICAL_OFFSET
                continue
            own = {
                joint: max(values[base.names.index(name)], std[base.names.index(name)])
                for joint in range(self._links)
                if (name := f"{symbol}_{joint + 1}") in base.names
            }
            typical[:, column] = float(np.median(list(own.values()))) if own else 1.0
            typical[list(own), column] = list(own.values())
        return typical

    def path(self) -> FloatArray:
        """The minimum, reached from the prior by letting the data weigh in step by step."""
        x = np.empty((self._links, self._stride))
        basis = _BASIS.reshape(INERTIAL_COUNT, -1)
        x[:, :INERTIAL_COUNT] = np.linalg.lstsq(basis.T, self._bodies.reshape(self._links, -1).T, rcond=None)[0].T
        x[:, INERTIAL_COUNT:] = np.where(self._free[:, INERTIAL_COUNT:], 0.0, self._typical)
        weight = 1.0 / max(self.distance_square(x), 1.0)
        while weight < 1.0:
            x = self.descend(x, weight, _CLOSE_ENOUGH)
            weight *= _STAGE
        return self.descend(x, 1.0, _CLOSE)

    def descend(self, x: FloatArray, weight: float, tolerance: float) -> FloatArray:
        """Newton's method with step halving; ends where the next step would gain less than the tolerance."""
        for _ in range(_MOST_STEPS):
            if self._scaled:
                traces = np.einsum("lij,lji->", self._inverse, self._pseudo_inertias(x))
                self._scale = float(traces) / (4.0 * self._links)
            gradient, root = self._barrier(x)
            gradient = gradient + weight * self._image.T @ (self._image @ x.ravel() - self._target)
            # In units of the barrier's own curvature the Hessian is 1 + AᵀA; its square root is never formed.
            image = np.sqrt(weight) * scipy.linalg.solve_triangular(root, self._image.T, lower=True).T
            slope = scipy.linalg.solve_triangular(root, gradient, lower=True)
            _, triangular = np.linalg.qr(np.vstack([image, np.eye(len(slope))]))
            half = scipy.linalg.solve_triangular(triangular, slope, trans="T")
            decrement = float(half @ half)
            if decrement < tolerance:
                return x
            step = -scipy.linalg.solve_triangular(
                root, scipy.linalg.solve_triangular(triangular, half), lower=True, trans="T"
            ).reshape(x.shape)
            x = self._halved(x, step, weight, decrement)
        raise SolverError("The program with a prior does not end.", solver="Newton", status="iteration limit")

    def _halved(self, x: FloatArray, step: FloatArray, weight: float, decrement: float) -> FloatArray:
        before, length = self._cost(x, weight), 1.0
        rounding = 1e-12 * max(1.0, abs(before))
        while length > 1e-12:
            candidate = x + length * step
            if self._cost(candidate, weight) <= before - 0.25 * length * decrement + rounding:
                return candidate
            length *= 0.5
        return x

    def distance_square(self, x: FloatArray) -> float:
        """Squared distance of the base parameters from the estimate, in σ."""
        return float(np.square(self._image @ x.ravel() - self._target).sum())

    def share_of_data(self, x: FloatArray, weight: float) -> FloatArray:
        """(full,) 1 − variance with the data / variance of the prior alone, by the curvature at x."""
        _, root = self._barrier(x)
        inverse = scipy.linalg.solve_triangular(root, np.eye(len(root)), lower=True)  # root⁻¹; prior = its square
        image = np.sqrt(weight) * self._image @ inverse.T
        _, triangular = np.linalg.qr(np.vstack([image, np.eye(len(root))]))
        narrowed = scipy.linalg.solve_triangular(triangular, inverse, trans="T")
        return np.asarray(1.0 - np.square(narrowed).sum(axis=0) / np.square(inverse).sum(axis=0), dtype=np.float64)

    def _pseudo_inertias(self, x: FloatArray) -> FloatArray:
        return pseudo_inertia(x[:, :INERTIAL_COUNT])

    def _cost(self, x: FloatArray, weight: float) -> float:
        """Infinite outside of what can exist."""
        effects, free = x[:, INERTIAL_COUNT:], self._free[:, INERTIAL_COUNT:]
        ratio = effects / self._typical
        matrices = self._pseudo_inertias(x)
        if np.any(ratio[~free] <= 0.0) or np.linalg.eigvalsh(matrices).min() <= 0.0:
            return np.inf
        divergence = float(np.einsum("lij,lji->", self._inverse, matrices)) / self._scale
        divergence -= float(np.linalg.slogdet(matrices)[1].sum())
        drives = float((ratio[~free] - np.log(ratio[~free])).sum() + 0.5 * np.square(ratio[free]).sum())
        return 0.5 * weight * self.distance_square(x) + divergence + drives

    def _barrier(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient (k,) of the prior's terms, and the lower Cholesky factor (k, k) of their Hessian."""
        size = x.size
        gradient, root = np.zeros_like(x), np.zeros((size, size))
        for link, matrix in enumerate(self._pseudo_inertias(x)):
            inverse = np.linalg.inv(matrix)
            turned = np.einsum("ij,ajk->aik", inverse, _BASIS)
            gradient[link, :INERTIAL_COUNT] = np.einsum("ij,aji->a", self._inverse[link] / self._scale, _BASIS)
            gradient[link, :INERTIAL_COUNT] -= np.einsum("aii->a", turned)
            first = link * self._stride
            block = slice(first, first + INERTIAL_COUNT)
            root[block, block] = np.linalg.cholesky(np.einsum("aij,bji->ab", turned, turned))
        effects, free = x[:, INERTIAL_COUNT:], self._free[:, INERTIAL_COUNT:]
        with np.errstate(divide="ignore"):
            barrier = 1.0 / self._typical - 1.0 / effects
            curvature = 1.0 / np.abs(effects)
        gradient[:, INERTIAL_COUNT:] = np.where(free, effects / self._typical**2, barrier)
        diagonal = np.zeros_like(x)
        diagonal[:, INERTIAL_COUNT:] = np.where(free, 1.0 / self._typical, curvature)
        root[np.diag_indices(size)] += diagonal.ravel()
        return gradient.ravel(), root
