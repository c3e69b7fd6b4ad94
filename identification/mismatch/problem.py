"""The least-squares problem of the diagnosis: whitened rows of all evidences, and the space the base parameters span.

Every column that enters a comparison is taken off that space first (Frisch, Waugh, Lovell), which is the same as
fitting all base parameters again with it. Rows run joint by joint, within a joint evidence by evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.mismatch.evidence import Evidence, rows_of_each
from identification.mismatch.settings import ROUNDING

# Upper edges (Hz) of the bands in which misfit is tested: line 0 alone, then about half an octave to an octave each.
BAND_EDGES_HZ = (0.01, 0.25, 0.55, 0.95, 1.55, 2.55, 4.05, 6.55, 10.05, 16.05, 25.05, 40.05)
# Of columns scaled to one: directions below this share of the largest are not determined by normal equations.
QUICK_RANK_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Rows of the diagnosis, (n · R,) flattened joint by joint.

    weight: (n, R) 1/Nm, one over the noise times the factor of `background`; 0 for rows that do not count. noise:
    (n, R) Nm. freedom: (n, R) degrees of freedom of the noise. band: (R,) index of the band. evidence: (R,) which
    evidence. frequency: (R,) Hz. torque: (n R,) whitened. nominal: (n, R, p) Nm
    per unit, base parameters first, then nuisances. basis: (n R, p') orthonormal basis of the nominal columns,
    whitened. residual: (n R,) torque off the basis. noise_is_measured: in every evidence; else nothing proves that
    only noise is left. unnamed: per joint, where rows are weighted beside torque of no known form (`beside`),
    orthonormal directions (R, k) that it spreads along, and the share (k,) along each that stays of the rows.
    """

    n: int
    weight: FloatArray
    noise: FloatArray
    freedom: FloatArray
    band: IntArray
    evidence: IntArray
    frequency: FloatArray
    torque: FloatArray
    nominal: FloatArray
    basis: FloatArray
    residual: FloatArray
    noise_is_measured: bool = True
    unnamed: tuple[tuple[FloatArray, FloatArray], ...] = ()

    def whitened(self, rows: FloatArray, joints: Sequence[int]) -> FloatArray:
        """Torque rows (len(joints), R, m) Nm in units of all that is not modelled, the same shape."""
        result = rows * self.weight[list(joints)][..., None]
        for place, joint in enumerate(joints if self.unnamed else ()):
            along, stays = self.unnamed[joint]
            result[place] -= along @ ((1.0 - stays)[:, None] * (along.T @ result[place]))
        return np.asarray(result, dtype=np.float64)

    def whitened_unnamed(self, rows: FloatArray, joint: int) -> FloatArray:
        """(n R, m) of rows (R, m) Nm of one joint that are part of `unnamed`: `whitened` would lose their digits."""
        along, stays = self.unnamed[joint]
        result = np.zeros((self.n, self.rows, rows.shape[1]))
        result[joint] = along @ (stays[:, None] * (along.T @ (rows * self.weight[joint][:, None])))
        return result.reshape(self.n * self.rows, -1)

    @property
    def rows(self) -> int:
        """Rows R of one joint."""
        return int(self.frequency.size)

    @property
    def bands(self) -> int:
        """Number of bands."""
        return len(BAND_EDGES_HZ) + 1


def build_problem(
    evidences: Sequence[Evidence],
    torque: Sequence[FloatArray] | None = None,
    nuisance: Sequence[tuple[int, FloatArray]] = (),
) -> Problem:
    """The problem of several evidences with common base parameters, weighted by the noise alone.

    torque: per evidence (R, n) Nm to take instead of the measured mean (what remains after changes between periods).
    nuisance: (evidence, (R, n, m) rows) of further columns of one evidence that are fitted beside the base parameters.
    """
    n = evidences[0].n
    noise = np.concatenate([item.noise for item in evidences]).T
    used = np.concatenate([item.used for item in evidences]).T
    frequency = np.concatenate([item.frequency for item in evidences])
    measured = np.concatenate([item.torque for item in evidences] if torque is None else list(torque)).T
    nominal = np.concatenate([item.nominal for item in evidences]).transpose(1, 0, 2)
    places = rows_of_each(evidences)
    for index, rows in nuisance:
        block = np.zeros((n, frequency.size, rows.shape[2]))
        block[:, places[index]] = rows.transpose(1, 0, 2)
        nominal = np.concatenate([nominal, block], axis=2)
    weight = np.where(used, 1.0 / noise, 0.0)
    empty = np.zeros(0)
    problem = Problem(
        n=n,
        weight=weight,
        noise=noise,
        freedom=np.concatenate([item.noise_freedom for item in evidences]).T,
        band=np.searchsorted(BAND_EDGES_HZ, frequency, side="left").astype(np.int64),
        evidence=np.concatenate([np.full(item.frequency.size, index) for index, item in enumerate(evidences)]),
        frequency=frequency,
        torque=(measured * weight).ravel(),
        nominal=nominal,
        basis=empty,
        residual=empty,
        noise_is_measured=all(item.noise_is_measured for item in evidences),
    )
    return _with_basis(problem)


def reweighted(problem: Problem, inflation: FloatArray) -> Problem:
    """The same problem, with all that is fitted, the noise's deviation in each joint and row times inflation (n, R)."""
    share = 1.0 / inflation.ravel()
    basis = _quick_basis(problem.basis * share[:, None])
    return replace(
        problem,
        weight=problem.weight / inflation,
        torque=problem.torque * share,
        basis=basis,
        residual=off(basis, problem.residual * share),
    )


def beside(problem: Problem, spread_by: Sequence[FloatArray], inflation: FloatArray) -> Problem:
    """The same rows where each joint holds torque of no known form besides, a Gaussian process of the state.

    spread_by: per joint columns (R, k) Nm whose product with their own transpose is its covariance. inflation: (n, R)
    factor on the noise's deviation.
    """
    weight = problem.weight / inflation
    unnamed = []
    for columns, scale in zip(spread_by, weight, strict=True):
        along, size, _ = np.linalg.svd(columns * scale[:, None], full_matrices=False)
        unnamed.append((along, 1.0 / np.sqrt(1.0 + size**2)))
    changed = replace(problem, weight=weight, noise=problem.noise * inflation, unnamed=tuple(unnamed))
    size = problem.basis.shape[1]
    rows = np.column_stack([problem.basis, problem.torque]).reshape(problem.n, problem.rows, -1)
    rows = rows / np.where(problem.weight > 0.0, problem.weight, np.inf)[..., None]
    white = changed.whitened(rows, range(problem.n)).reshape(-1, size + 1)
    basis = _quick_basis(white[:, :size])
    return replace(changed, torque=white[:, size], basis=basis, residual=off(basis, white[:, size]))


def with_torque(problem: Problem, torque: Sequence[FloatArray]) -> Problem:
    """The same problem for another torque, (R, n) Nm of each evidence."""
    rows = np.concatenate(list(torque)).T[..., None]
    whitened = problem.whitened(rows, range(problem.n)).ravel()
    return replace(problem, torque=whitened, residual=off(problem.basis, whitened))


def _with_basis(problem: Problem) -> Problem:
    columns = problem.whitened(problem.nominal, range(problem.n))
    basis = orthonormal(columns.reshape(-1, problem.nominal.shape[2]))
    return replace(problem, basis=basis, residual=off(basis, problem.torque))


def _quick_basis(columns: FloatArray) -> FloatArray:
    """As `orthonormal`, from the normal equations: several times faster, good for directions above a millionth."""
    norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    scaled = columns / norms
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > QUICK_RANK_TOLERANCE**2 * values[-1]
    return np.asarray(scaled @ (vectors[:, kept] / np.sqrt(values[kept])), dtype=np.float64)


def orthonormal(columns: FloatArray, tolerance: float = ROUNDING) -> FloatArray:
    """Orthonormal basis of the space the columns span, each scaled to one, directions below the tolerance left out."""
    norms = np.linalg.norm(columns, axis=0)
    present = norms > 0.0
    factor, triangle = np.linalg.qr(columns[:, present] / norms[present])
    left, singular, _ = np.linalg.svd(triangle)
    return np.asarray(factor @ left[:, singular > tolerance * singular.max(initial=0.0)], dtype=np.float64)


def off(basis: FloatArray, values: FloatArray) -> FloatArray:
    """The values (rows, …) without their part in the space of the basis; twice, so that only rounding is left."""
    once = values - basis @ (basis.T @ values)
    return np.asarray(once - basis @ (basis.T @ once), dtype=np.float64)


def extended(problem: Problem, columns: FloatArray) -> Problem:
    """The problem with further columns (n R, m), already off the basis, fitted along; swallowed directions left out.

    They are in its basis, which follows that of the problem before; `nominal` stays as it is.
    """
    added = orthonormal(columns, tolerance=1e-7)
    return replace(problem, basis=np.concatenate([problem.basis, added], axis=1), residual=off(added, problem.residual))


def spread(problem: Problem, joints: Sequence[int], rows: FloatArray) -> FloatArray:
    """Torque rows (len(joints), R, m) Nm as whitened columns over all joints (n R, m)."""
    columns = np.zeros((problem.n, problem.rows, rows.shape[2]))
    columns[list(joints)] = problem.whitened(rows, joints)
    return columns.reshape(problem.n * problem.rows, -1)
