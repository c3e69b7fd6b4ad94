"""Rows of fitted and held-out evidences together, with the columns of every class on every joint beside the base ones.

Here: from motions to Gram matrices. Not here: what they are worth (`evidence`, `selection`).
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
from scipy.special import chdtrc

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.mismatch.evidence import Evidence
from identification.mismatch.prepared import Prepared
from identification.mismatch.problem import BAND_EDGES_HZ, Problem, build_problem, with_torque
from identification.mismatch.settings import FADE, HIDDEN, NOISE_ROWS, PRIOR_COST, VARIANCE_CAP
from identification.mismatch.unknown.angle import AngleBasis
from identification.mismatch.unknown.classes import CLASSES, TOLD_BY_NOISE, Basis
from identification.mismatch.unknown.evidence import FREE, JointGram, products
from identification.mismatch.unknown.inputs import Inputs, Ranges
from identification.mismatch.unknown.stretches import parts_of

WIDE_BANDS_HZ = BAND_EDGES_HZ[1::2]
"""Upper edges of the bands with a noise of their own: every other one of those in which misfit is tested."""


@dataclass(frozen=True, slots=True, eq=False)
class JointRows:
    """One joint. whitened: (R, M) [B F y]. bases: of the groups of B, in order. group: (m,) number of each column.

    shown: of each group (functions, columns), orthonormal: which combination of its functions each of its columns is.
    """

    whitened: FloatArray
    bases: tuple[Basis, ...]
    group: IntArray
    shown: tuple[FloatArray, ...]

    @property
    def columns(self) -> int:
        """Number m of columns of B."""
        return int(self.group.size)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """All joints. part: (R,) 0 … folds − 1 of the fitted rows, from `folds` on of those held out.

    band: (R,). problem: all rows. fitted: ranges of the fitted motions. inputs: of each evidence, the fitted first.
    misfit: (n,) Nm², mean square that the nominal model leaves on the fitted rows. asked: (n,) joints that hold more
    than their noise. samples: behind the fitted and the held-out rows. noise_rows: that a band's noise is worth, 0
    without any; noise_odds: that it is another one. prior: (P,) precision beforehand of what stands in F.
    grams: per joint (parts, bands, M, M) products, and count (n, parts, bands) of their rows; all parts are one where
    the noise is measured, all bands where stretches are predicted (`resolved`: neither). cell: (R,) which of these a
    row is in, part by part; parts · bands where in none. angles: groups of functions that a joint's angle is off by;
    their columns stand in F behind those of the base parameters, in this order.
    """

    problem: Problem
    evidences: tuple[Evidence, ...]
    fitted: Ranges
    inputs: tuple[Inputs, ...]
    joints: tuple[JointRows, ...]
    part: IntArray
    band: IntArray
    folds: int
    prior: FloatArray
    cell: IntArray
    grams: tuple[FloatArray, ...]
    count: FloatArray
    misfit: FloatArray
    asked: BoolArray
    samples: tuple[int, int]
    noise_rows: float
    noise_odds: float
    angles: tuple[AngleBasis, ...] = ()

    @property
    def base(self) -> int:
        """Columns of the base parameters in F, the first ones."""
        return int(self.problem.basis.shape[1])

    @property
    def angle_columns(self) -> list[slice]:
        """Where in F the columns of each of `angles` stand."""
        edges = self.base + np.cumsum([0, *(item.functions for item in self.angles)])
        return [slice(first, last) for first, last in pairwise(edges.tolist())]

    @property
    def heldout(self) -> bool:
        """Whether any row is held out."""
        return bool((self.part >= self.folds).any())

    @property
    def parts(self) -> range:
        """Of the products."""
        return range(self.count.shape[1])

    @property
    def by_band(self) -> bool:
        """Whether each band has products of its own."""
        return bool(self.count.shape[2] == self.band.max() + 1)

    def of(self, parts: Sequence[int]) -> tuple[JointGram, ...]:
        """Gram matrices of some parts together."""
        return tuple(self.of_joint(joint, parts) for joint in range(len(self.joints)))

    def of_joint(self, joint: int, parts: Sequence[int]) -> JointGram:
        """Those of one joint (from 0)."""
        gram, (first, *rest) = self.grams[joint], parts
        total = gram[first] if not rest else gram[first] + gram[rest[0]]
        for part in rest[1:]:
            total += gram[part]
        return JointGram(total, self.count[joint, list(parts)].sum(axis=0), self.joints[joint].group)

    def with_torque(self, torque: Sequence[FloatArray]) -> Rows:
        """The same columns beside another torque, (R, n) Nm of each evidence."""
        problem = with_torque(self.problem, torque)
        residual = problem.residual.reshape(problem.weight.shape)
        joints, grams = [], []
        for joint, gram, values in zip(self.joints, self.grams, residual, strict=True):
            whitened = np.concatenate([joint.whitened[:, :-1], values[:, None]], axis=1)
            changed = gram.copy()
            changed[..., -1] = products(whitened, values[:, None], self.cell, self.count.shape[1:])[..., 0]
            changed[..., -1, :] = changed[..., -1]
            joints.append(replace(joint, whitened=whitened))
            grams.append(changed)
        return replace(
            self, problem=problem, joints=tuple(joints), grams=tuple(grams),
            misfit=_mean_square(problem, self.part < self.folds, self.samples[0]),
            asked=self.asked & worth_asking(problem, self.band),
        )  # fmt: skip

    def with_columns(self, names: Sequence[tuple[FloatArray, FloatArray]]) -> Rows:
        """With columns (n, R, k) Nm beside the base ones, each with its coefficients (k,) as they were found.

        Beforehand each coefficient is as large as makes its torque that of the average one of its name.
        """
        prior = [self.prior]
        for columns, size in names:
            square = ((columns * self.problem.weight[..., None]) ** 2).sum(axis=(0, 1))
            prior.append(np.maximum(square, 1e-300) / max(float(np.mean(square * size**2)), 1e-300))
        added = np.concatenate([columns for columns, _ in names], axis=2) * self.problem.weight[..., None]
        joints, grams = [], []
        for joint, gram, own in zip(self.joints, self.grams, added, strict=True):
            whitened, grown = self._with(joint, gram, own, joint.whitened.shape[1] - 1)
            joints.append(replace(joint, whitened=whitened))
            grams.append(grown)
        return replace(self, joints=tuple(joints), grams=tuple(grams), prior=np.concatenate(prior))

    def with_angle(
        self, bases: Sequence[AngleBasis], columns: Sequence[FloatArray], deviation: Sequence[float]
    ) -> Rows:
        """With groups of functions that a joint's angle is off by, (n, R, m) Nm each. deviation: of each, rad."""
        grown = self.with_columns([(part, np.ones(part.shape[2])) for part in columns])
        own = [np.full(part.shape[2], size**-2.0) for part, size in zip(columns, deviation, strict=True)]
        return replace(grown, prior=np.concatenate([self.prior, *own]), angles=(*self.angles, *bases))

    def without_angles(self) -> Rows:
        """The same without any."""
        if not self.angles:
            return self
        gone = np.arange(self.base, self.angle_columns[-1].stop)
        joints, grams = [], []
        for joint, gram in zip(self.joints, self.grams, strict=True):
            own = joint.columns + gone
            joints.append(replace(joint, whitened=np.delete(joint.whitened, own, axis=1)))
            grams.append(np.delete(np.delete(gram, own, axis=2), own, axis=3))
        return replace(self, joints=tuple(joints), grams=tuple(grams), prior=np.delete(self.prior, gone), angles=())

    def further(self, joint: int, known: dict[Hashable, Found]) -> Found:
        """The further groups of all classes on a joint (from 0), with their whitened columns (R, m).

        known: functions of one joint, before they are whitened, as calls for other joints found them.
        """
        weight, found = self.problem.weight[joint][:, None], []
        for number, item in enumerate(CLASSES):
            for group, functions in enumerate(item.further, start=len(item.groups)):
                key = functions.of_one, joint + functions.offset
                if key not in known:
                    known[key] = functions_of(self.evidences, self.inputs, joint, [(number, group)])
                found += [(replace(basis, group=group, joint=joint), rows * weight) for basis, rows in known[key]]
        return found

    def with_group(self, joint: int, basis: Basis, columns: FloatArray) -> Rows:
        """With one group more on a joint (from 0), behind the others. columns: (R, m) whitened."""
        old, joints, grams = self.joints[joint], list(self.joints), list(self.grams)
        whitened, grams[joint] = self._with(old, grams[joint], columns, old.columns)
        group = np.append(old.group, np.full(columns.shape[1], len(old.bases)))
        joints[joint] = JointRows(whitened, (*old.bases, basis), group, (*old.shown, np.eye(columns.shape[1])))
        return replace(self, joints=tuple(joints), grams=tuple(grams))

    def _with(self, joint: JointRows, gram: FloatArray, own: FloatArray, place: int) -> tuple[FloatArray, FloatArray]:
        """A joint's whitened columns and their products with further columns (R, k) before one of them."""
        whitened = np.concatenate([joint.whitened[:, :place], own, joint.whitened[:, place:]], axis=1)
        new = slice(place, place + own.shape[1])
        before, behind = (slice(place), slice(place)), (slice(place, None), slice(new.stop, None))
        grown = np.empty((*gram.shape[:2], whitened.shape[1], whitened.shape[1]))
        for (old, there), (old_column, column) in product((before, behind), repeat=2):
            grown[:, :, there, column] = gram[:, :, old, old_column]
        grown[..., new] = products(whitened, own, self.cell, self.count.shape[1:])
        grown[:, :, new] = grown[..., new].swapaxes(2, 3)
        return whitened, grown

    def limited(self, chosen: Sequence[Sequence[int]], *, heldout: bool = False) -> Rows:
        """Only some groups of each joint, with products of each part and band; of held-out rows only where asked."""
        joints = []
        for joint, wanted in zip(self.joints, chosen, strict=True):
            own = np.flatnonzero(np.isin(joint.group, list(wanted)))
            places, group = np.unique(joint.group[own], return_inverse=True)
            kept = np.concatenate([own, np.arange(joint.columns, joint.whitened.shape[1])])
            bases, shown = (tuple(values[place] for place in places) for values in (joint.bases, joint.shown))
            joints.append(JointRows(joint.whitened[:, kept], bases, group.astype(np.int64), shown))
        parts, bands = int(self.part.max()) + 1 if heldout else self.folds, int(self.band.max()) + 1
        cell = np.where(self.part < parts, self.part * bands + self.band, parts * bands)
        grams, count = _products(joints, self.problem, cell, (parts, bands))
        return replace(self, joints=tuple(joints), cell=cell, grams=grams, count=count)

    def resolved(self) -> Rows:
        """With products of each part and band."""
        return self.limited([range(len(joint.bases)) for joint in self.joints], heldout=True)


def build_rows(fitted: Prepared, unseen: Prepared | None, named: Collection[int] = ()) -> Rows:
    """The rows of both roles, base parameters common, what changes between the periods of each kept free.

    All classes on the joints that hold more than their noise, and on those (from 0) that a name is proposed for; their
    functions are fixed by all motions, so that what a class is worth is judged on all rows.
    """
    roles = [fitted] if unseen is None else [fitted, unseen]
    evidences = tuple(item for role in roles for item in role.evidences)
    nuisance, first = [], 0
    for role in roles:
        nuisance += [(first + number, rows) for number, rows in role.nuisance]
        first += len(role.evidences)
    problem = build_problem(evidences, [rows for role in roles for rows in role.torque], nuisance)
    every = Ranges.of([item.motion for item in evidences])
    inputs = tuple(Inputs(item.motion, every, 2.0 * FADE) for item in evidences)
    part, folds = parts_of(evidences, len(fitted.evidences), problem.noise_is_measured)
    band = np.searchsorted(WIDE_BANDS_HZ, problem.frequency)
    asked = worth_asking(problem, band)
    asked[list(named)] = True
    samples = (
        sum(item.samples for item in fitted.evidences),
        0 if unseen is None else sum(item.samples for item in unseen.evidences),
    )
    misfit = _mean_square(problem, part < folds, samples[0])
    joints = _joints(problem, evidences, inputs, asked, misfit)
    # Predicted stretches have one noise in all bands; where it is measured, rows held out stand beside those fitted.
    parts = 1 if problem.noise_is_measured else int(part.max()) + 1
    cell, bands = (part, 1) if parts > 1 else (band, int(band.max()) + 1)
    grams, count = _products(joints, problem, cell, (parts, bands))
    return Rows(
        problem=problem,
        evidences=evidences,
        fitted=Ranges.of([item.motion for item in fitted.evidences]),
        inputs=inputs,
        joints=joints,
        part=part,
        band=band,
        folds=folds,
        prior=np.full(problem.basis.shape[1], FREE),
        cell=cell,
        grams=grams,
        count=count,
        misfit=misfit,
        asked=asked,
        samples=samples,
        noise_rows=NOISE_ROWS if problem.noise_is_measured else 0.0,
        noise_odds=float(np.exp(-PRIOR_COST)),
    )


def _mean_square(problem: Problem, chosen: BoolArray, samples: int) -> FloatArray:
    """(n,) Nm² that the nominal model leaves on some rows."""
    residual = problem.residual.reshape(problem.weight.shape)
    left = np.where(problem.weight > 0.0, residual * problem.noise, 0.0)
    return np.asarray((left[:, chosen] ** 2).sum(axis=1) / samples)


def worth_asking(problem: Problem, band: IntArray) -> BoolArray:
    """(n,) joints whose rows below some frequency hold more than noise, beyond the odds against a class."""
    if not problem.noise_is_measured:
        return np.ones(problem.n, dtype=np.bool_)
    used = problem.weight > 0.0
    squares = np.where(used, problem.residual.reshape(used.shape) ** 2, 0.0)
    freedom = used - (problem.basis.reshape(*used.shape, -1) ** 2).sum(axis=2)
    edges = range(int(band.max()) + 1)
    rest, count = (np.stack([values[:, band <= edge].sum(axis=1) for edge in edges]) for values in (squares, freedom))
    chance = chdtrc(np.maximum(count, 1.0), rest)
    return np.asarray(chance.min(axis=0) < np.exp(-PRIOR_COST))


def _joints(
    problem: Problem, evidences: Sequence[Evidence], inputs: Sequence[Inputs], asked: BoolArray, misfit: FloatArray
) -> tuple[JointRows, ...]:
    """Columns of all classes on the joints that are asked, beside the base columns and the torque.

    misfit: as in `Rows`.
    """
    common: list[tuple[Basis, FloatArray]] = []
    measured = problem.noise_is_measured
    shared = [place for place in usual_groups(measured=measured) if CLASSES[place[0]].shared]
    particular = [place for place in usual_groups(measured=measured) if not CLASSES[place[0]].shared]
    result = []
    for joint in range(problem.n):
        own = []
        if asked[joint]:
            if not common:
                common = functions_of(evidences, inputs, joint, shared)
            own = functions_of(evidences, inputs, joint, particular)
            own += [(replace(basis, joint=joint), rows) for basis, rows in common]
        columns = [rows * problem.weight[joint][:, None] for _, rows in own]
        shown = [_shown(rows, VARIANCE_CAP * misfit[joint] if measured else None) for rows in columns]
        whitened = [
            *(rows @ combined for rows, combined in zip(columns, shown, strict=True)),
            problem.basis.reshape(problem.n, problem.rows, -1)[joint],
            problem.residual.reshape(problem.n, problem.rows)[joint][:, None],
        ]
        sizes = [combined.shape[1] for combined in shown]
        group = np.repeat(np.arange(len(own)), np.array(sizes, dtype=np.int64)).astype(np.int64)
        bases = tuple(basis for basis, _ in own)
        result.append(JointRows(np.concatenate(whitened, axis=1), bases, group, tuple(shown)))
    return tuple(result)


def _shown(rows: FloatArray, largest: float | None) -> FloatArray:
    """(m, k) orthonormal combinations of functions, whitened (R, m), but for those that no hypothesis tells from noise.

    largest: Nm², most that the variance of a weight may be; None where the noise is not known, and all may show.
    Independent weights of the functions are independent weights of combinations.
    """
    if largest is None:
        return np.eye(rows.shape[1])
    values, vectors = np.linalg.eigh(rows.T @ rows)
    kept = values * largest > HIDDEN
    kept[-1] = True
    return np.eye(kept.size) if kept.all() else np.asarray(vectors[:, kept])


Place = tuple[int, int]
"""Number of a class in CLASSES, and number of one of its groups."""
Found = list[tuple[Basis, FloatArray]]
"""Groups of functions with their columns (R, m)."""


def usual_groups(*, measured: bool) -> list[Place]:
    """All groups but the further ones. measured: whether the noise is."""
    return [
        (number, group)
        for number, item in enumerate(CLASSES)
        for group, functions in enumerate(item.groups)
        if measured or functions not in TOLD_BY_NOISE
    ]


def functions_of(
    evidences: Sequence[Evidence], inputs: Sequence[Inputs], joint: int, places: Sequence[Place]
) -> list[tuple[Basis, FloatArray]]:
    """Some groups of functions of a joint (from 0), with their rows (R, m) Nm; none where the inputs do not move."""
    found = []
    for number, group in places:
        parts = [CLASSES[number].functions(group)(each, joint) for each in inputs]
        basis = Basis.of(number, group, joint, parts)
        if basis.scale > 0.0:
            # One group at a time: all of them together are too large for a processor's memory near by.
            rows = [each.project(basis.scaled(part)) for each, part in zip(evidences, parts, strict=True)]
            found.append((basis, np.concatenate(rows)))
    return found


def _products(
    joints: Sequence[JointRows], problem: Problem, cell: IntArray, shape: tuple[int, int]
) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """`Rows.grams` and `Rows.count` of cells. shape: (parts, bands)."""
    size = shape[0] * shape[1]
    count = [np.bincount(cell, weights=row > 0.0, minlength=size)[:size].reshape(shape) for row in problem.weight]
    return tuple(products(item.whitened, item.whitened, cell, shape) for item in joints), np.stack(count)
