"""Parameters of real bodies that fit the data, with a prior for what the data leave open.

A motion determines base parameters only: how a sum splits into masses, centres and inertias of single links is open,
and so is, nearly, what a motion shows weakly. Any split gives the same torques, but a link of 8 kg with 47 kg m² is no
link. Here the open directions go to a prior: bodies that are given, or a uniform body for each link. What the data
determine stays, within a fraction of its σ.

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

import clarabel
import numpy as np
import scipy.linalg
import scipy.sparse

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import EstimationError, SolverError
from identification.estimators.semidefinite import scaled_triangle
from identification.physical_parameters import INERTIAL_COUNT, PhysicalParameters, pseudo_inertia
from identification.robots.model import Kinematics

_THICKNESS_SHARE = 1.0 / 6.0
"""Radius of a uniform link as a share of the longest stretch between two joints: 0.07 m for an iiwa."""
_RADIUS_WITHOUT_STRETCHES_M = 0.1
_DENSITY = 1000.0
"""kg/m³ of a link so thick, housing and hollow: an iiwa 14 (30 kg) has 1080, a Panda 760, a KUKA KR300 1900."""
_FINEST = 1e-5
"""Of what the prior leaves open of a base parameter, the share that its σ is never below: what exact data would weigh
against the prior is more than a program in double precision can hold."""
_COVARIANCE_FLOOR = 1e-12
_GAP = 1e-10
"""Of the cost, to which the program is solved: the cost is flat at its minimum, so x is known to the root of it."""
_PRIOR_WEIGHT = 0.1
"""Of the divergence: the mass of one body is taken to be known to a factor of about four."""
_BASIS = pseudo_inertia(np.eye(INERTIAL_COUNT))
_LOWER = tuple((row, column) for row in range(4) for column in range(row + 1))


def _cone() -> FloatArray:
    """(36, 20) [[P, Z], [Zᵀ, diag Z]] as Clarabel takes it, per unit of P's parameters and of Z's entries."""
    units = np.zeros((20, 8, 8))
    units[:INERTIAL_COUNT, :4, :4] = _BASIS
    for unit, (row, column) in zip(units[INERTIAL_COUNT:], _LOWER, strict=True):
        unit[row, 4 + column] = 1.0
        unit[4 + row, 4 + row] = row == column
    return scaled_triangle(units)


_CONE = _cone()


@dataclass(frozen=True, slots=True, eq=False)
class BodyPrior:
    """Where the directions go that the data leave open.

    bodies: (n, 4, 4) pseudo-inertias B_l, positive definite, in the link frames. name: for the reader.
    """

    bodies: FloatArray
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class SettledParameters:
    """Parameters of real bodies, and what each of them rests on.

    physical: all pseudo-inertias are positive definite. full: (full,) dynamic parameters in the order of full_names.
    base_values: (p,) their base parameters. from_data: (full,) 0 to 1, the share by which the data narrow a parameter's
    variance below the prior's: 1 determined by the data, 0 left to the prior. misfit: root of the mean square of what
    the base parameters were moved by, in σ: below 1 they were moved within what is known of them. moved: (p,) that of
    each base parameter, with its sign. prior: its name.
    """

    physical: PhysicalParameters
    full: FloatArray
    base_values: FloatArray
    from_data: FloatArray
    misfit: float
    moved: FloatArray
    prior: str


def uniform_bodies(kinematics: Kinematics) -> BodyPrior:
    """A uniform rod for each link, of the density of water and one thickness, between its joint and those it carries.

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
    longest = float(np.linalg.norm(kinematics.translation[kinematics.parent >= 0], axis=1).max(initial=0.0))
    radius = _THICKNESS_SHARE * longest if longest > 0.0 else _RADIUS_WITHOUT_STRETCHES_M
    bodies = np.zeros((kinematics.n, 4, 4))
    for link, each in enumerate(ends):
        for end in each:
            rod, middle = end - place[link], 0.5 * (end + place[link])
            mass = _DENSITY * np.pi * radius**2 * (float(np.linalg.norm(rod)) + 2.0 * radius) / len(each)
            bodies[link] += _body(mass, middle, mass * (np.outer(rod, rod) / 12.0 + 0.25 * radius**2 * np.eye(3)))
    return BodyPrior(bodies, name="uniform bodies")


def _body(mass: float, center: FloatArray, spread: FloatArray) -> FloatArray:
    """(4, 4) pseudo-inertia of a mass with its second moment (3, 3) about its centre, kg m²."""
    point = np.append(center, 1.0)
    result = mass * np.outer(point, point)
    result[:3, :3] += spread
    return np.asarray(result, dtype=np.float64)


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
        bodies[link] = _body(mass, center, root @ (vectors * np.maximum(values, 1.0)) @ vectors.T @ root.T)
    return BodyPrior(bodies, name=name)


def settle_open_directions(
    base_values: FloatArray, covariance: FloatArray, base: BaseRegressor, prior: BodyPrior | None = None
) -> SettledParameters:
    """Parameters of real bodies near base parameters (p,) with their covariance (p, p); the rest goes to the prior.

    prior: uniform bodies where none is given. Raises EstimationError for values of another number, SolverError where
    the program does not end.
    """
    if base_values.shape != (base.size,):
        raise EstimationError(f"{base.robot.name} has {base.size} base parameters, not {len(base_values)}")
    chosen = prior if prior is not None else uniform_bodies(base.robot.kinematics)
    program = _Program(base_values, covariance, base, chosen)
    x = program.minimum()
    full = x.ravel()
    physical = PhysicalParameters.from_dynamic_parameters(
        x[:, :INERTIAL_COUNT], base.extra_of(full, "FV"), base.extra_of(full, "FS")
    )
    misfit = float(np.sqrt(program.distance_square(x) / len(base_values)))
    values = base.base_from_full(full)
    moved = (values - base_values) / np.sqrt(np.diag(covariance))
    return SettledParameters(physical, full, values, program.share_of_data(x), misfit, moved, chosen.name)


def _lower_root(correlation: FloatArray) -> FloatArray:
    """Cholesky's root of a correlation (p, p); of a motion that leaves directions open round-off makes it indefinite,
    and the floor is raised until it is not.
    """
    floor = _COVARIANCE_FLOOR
    while True:
        try:
            return np.asarray(np.linalg.cholesky(correlation + floor * np.eye(len(correlation))), dtype=np.float64)
        except np.linalg.LinAlgError:
            floor *= 10.0
            if not floor <= 1.0:  # also where a number is not finite
                raise


class _Program:
    """The program in x (n, 10 + effects), the dynamic parameters per link, and its curvature."""

    def __init__(self, values: FloatArray, covariance: FloatArray, base: BaseRegressor, prior: BodyPrior) -> None:
        symbols = base.options.symbols
        self._links, self._stride = base.robot.n, INERTIAL_COUNT + len(symbols)
        self._typical = self._typical_effects(values, np.sqrt(np.diag(covariance)), base)
        self._free = np.tile(np.array([symbol == "OFF" for symbol in symbols], dtype=np.bool_), (self._links, 1))
        # π of a link whose pseudo-inertia is L P̃ Lᵀ, B = L Lᵀ: the program counts in units of the prior body.
        basis = _BASIS.reshape(INERTIAL_COUNT, -1)
        self._units = np.zeros((self._links, self._stride, self._stride))
        for link, root in enumerate(np.linalg.cholesky(prior.bodies)):
            scaled = np.einsum("ij,ajk,lk->ail", root, _BASIS, root).reshape(INERTIAL_COUNT, -1)
            self._units[link, :INERTIAL_COUNT, :INERTIAL_COUNT] = np.linalg.lstsq(basis.T, scaled.T, rcond=None)[0]
            self._units[link, INERTIAL_COUNT:, INERTIAL_COUNT:] = np.diag(self._typical[link])
        in_units = np.einsum("ple,lef->plf", base.regrouping.reshape(-1, self._links, self._stride), self._units)
        finest = _FINEST**2 * np.square(in_units).sum(axis=(1, 2))
        covariance = covariance + np.diag(np.maximum(finest - np.diag(covariance), 0.0))
        std = np.sqrt(np.diag(covariance))
        root = _lower_root(covariance / np.outer(std, std))
        whiten = scipy.linalg.solve_triangular(root, np.diag(1.0 / std), lower=True)
        self._image = whiten @ base.regrouping
        self._target = whiten @ values

    def _typical_effects(self, values: FloatArray, std: FloatArray, base: BaseRegressor) -> FloatArray:
        """x₀ (n, effects): the estimate, at least its σ; a joint without an estimate of its own has the median's.

        An offset is friction that differs by direction, so that its size is the Coulomb friction's.
        """
        typical = np.ones((self._links, self._stride - INERTIAL_COUNT))
        for column, symbol in enumerate(base.options.symbols):
            if symbol == "OFF":
                continue
            own = {
                joint: max(values[base.names.index(name)], std[base.names.index(name)])
                for joint in range(self._links)
                if (name := f"{symbol}_{joint + 1}") in base.names
            }
            typical[:, column] = float(np.median(list(own.values()))) if own else 1.0
            typical[list(own), column] = list(own.values())
        if {"OFF", "FS"} <= set(base.options.symbols):
            offset, coulomb = (base.options.symbols.index(symbol) for symbol in ("OFF", "FS"))
            typical[:, offset] = typical[:, coulomb]
        return typical

    def minimum(self) -> FloatArray:
        """The x of smallest cost: a program of semidefinite and exponential cones. Raises SolverError.

        log det P is the largest Σ log Z_kk over lower triangular Z with [[P, Z], [Zᵀ, diag Z]] ⪰ 0.
        """
        links, stride = self._links, self._stride
        size, rows = links * stride, len(self._target)
        image = np.hstack(
            [self._image[:, link * stride : (link + 1) * stride] @ self._units[link] for link in range(links)]
        )
        logarithms = [(link, k) for link in range(links) for k in range(4)]
        positive = [(link, k) for link in range(links) for k in np.flatnonzero(~self._free[link])]
        # variables: x̃ (size), the deviation in σ (rows), Z (10 a link), the logarithms
        first_z, first_log = size + rows, size + rows + 10 * links
        count = first_log + len(logarithms) + len(positive)
        quadratic, linear = np.zeros(count), np.zeros(count)
        quadratic[size:first_z] = 1.0
        linear[first_log:] = -_PRIOR_WEIGHT
        for link in range(links):
            first = link * stride
            linear[first : first + INERTIAL_COUNT] = _PRIOR_WEIGHT * np.trace(_BASIS, axis1=1, axis2=2)
            effects = slice(first + INERTIAL_COUNT, first + stride)
            linear[effects] = np.where(self._free[link], 0.0, _PRIOR_WEIGHT)
            quadratic[effects] = np.where(self._free[link], _PRIOR_WEIGHT, 0.0)
        data = np.zeros((rows, count))
        data[:, :size], data[:, size:first_z] = image, -np.eye(rows)
        blocks, bounds, cones = [data], [self._target], [clarabel.ZeroConeT(rows)]
        for link in range(links):
            block = np.zeros((36, count))
            block[:, link * stride : link * stride + INERTIAL_COUNT] = _CONE[:, :INERTIAL_COUNT]
            block[:, first_z + 10 * link : first_z + 10 * (link + 1)] = _CONE[:, INERTIAL_COUNT:]
            blocks.append(-block)
            bounds.append(np.zeros(36))
            cones.append(clarabel.PSDTriangleConeT(8))
        arguments = [first_z + 10 * link + _LOWER.index((k, k)) for link, k in logarithms]
        arguments += [link * stride + INERTIAL_COUNT + int(k) for link, k in positive]
        for number, argument in enumerate(arguments):
            block = np.zeros((3, count))
            block[0, first_log + number], block[2, argument] = -1.0, -1.0
            blocks.append(block)
            bounds.append(np.array([0.0, 1.0, 0.0]))
            cones.append(clarabel.ExponentialConeT())
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_threads = False, 1
        settings.tol_gap_abs = settings.tol_gap_rel = _GAP
        solution = clarabel.DefaultSolver(
            scipy.sparse.diags_array(quadratic).tocsc(), linear, scipy.sparse.csc_matrix(np.vstack(blocks)),
            np.concatenate(bounds), cones, settings,
        ).solve()  # fmt: skip
        x = np.einsum("lij,lj->li", self._units, np.array(solution.x[:size]).reshape(links, stride))
        status = str(solution.status)
        if status not in ("Solved", "AlmostSolved") or not self._exists(x):
            raise SolverError(f"The program with a prior has no solution ({status}).", solver="Clarabel", status=status)
        return np.asarray(x, dtype=np.float64)

    def _exists(self, x: FloatArray) -> bool:
        bodies = np.linalg.eigvalsh(pseudo_inertia(x[:, :INERTIAL_COUNT])).min() > 0.0
        return bool(bodies and np.all(x[:, INERTIAL_COUNT:][~self._free] > 0.0))

    def distance_square(self, x: FloatArray) -> float:
        """Squared distance of the base parameters from the estimate, in σ."""
        return float(np.square(self._image @ x.ravel() - self._target).sum())

    def share_of_data(self, x: FloatArray) -> FloatArray:
        """(full,) 1 − variance with the data / variance of the prior alone, by the curvature at x."""
        root = self._prior_curvature(x)
        inverse = scipy.linalg.solve_triangular(root, np.eye(len(root)), lower=True)
        _, triangular = np.linalg.qr(np.vstack([self._image @ inverse.T, np.eye(len(root))]))
        narrowed = scipy.linalg.solve_triangular(triangular, inverse, trans="T")
        return np.asarray(1.0 - np.square(narrowed).sum(axis=0) / np.square(inverse).sum(axis=0), dtype=np.float64)

    def _prior_curvature(self, x: FloatArray) -> FloatArray:
        """(k, k) lower Cholesky factor of the Hessian of the prior's terms; of −log det P it is tr(P⁻¹E_a P⁻¹E_b).

        By QR of the factors P^(−½)E_a P^(−½): their products lose the sign of a body that is all but flat.
        """
        root = np.zeros((x.size, x.size))
        for link, matrix in enumerate(pseudo_inertia(x[:, :INERTIAL_COUNT])):
            values, vectors = np.linalg.eigh(matrix)
            white = vectors / np.sqrt(values)
            factors = np.einsum("ik,aij,jl->akl", white, _BASIS, white).reshape(INERTIAL_COUNT, -1)
            first = link * self._stride
            block = slice(first, first + INERTIAL_COUNT)
            root[block, block] = np.linalg.qr(factors.T)[1].T
        diagonal = np.zeros_like(x)
        diagonal[:, INERTIAL_COUNT:] = 1.0 / np.where(self._free, self._typical, np.abs(x[:, INERTIAL_COUNT:]))
        root[np.diag_indices(x.size)] += diagonal.ravel()
        return np.asarray(np.sqrt(_PRIOR_WEIGHT) * root, dtype=np.float64)
