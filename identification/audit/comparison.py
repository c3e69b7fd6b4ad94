"""One recording against one model, for any set-up: columns, the difference of torque, and what its noise is.

Here: the rows of a set-up turned into products. Not here: what is tried (`search`). Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.audit.columns import GRAVITY, Geometry, SetUp, across
from identification.audit.evidence import Products, posterior, products_of, repeated_rows
from identification.audit.given import GivenModel, Sizes, wide_open
from identification.audit.hypotheses import Layout
from identification.audit.rows import Rows

PARTS = 8
USED, REPORT, ALL = (0, 1, 2, 4, 5, 6), (3, 7), tuple(range(PARTS))
"""Blocks in turns. Each of those in use accepts what the others fitted; those that report are used for neither."""

LEAST_SIGMAS = 5.0
"""Deviations that what is said to be different is away from none."""
LEAST_GAIN = 20.0
"""Nats that another reading of a recording alone must gain: a recording's own misfit makes some."""
MOST_NOISE = 2.0
"""Of what a model leaves of its own recordings."""


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """std: (n,) Nm, what all parameters fitted anew leave. repeated: (n,) rows that count as one."""

    std: FloatArray
    repeated: FloatArray

    @property
    def loudness(self) -> float:
        """Nats that a row costs: log of the deviations together."""
        return float(np.log(self.std).sum())

    @property
    def weight(self) -> FloatArray:
        """(n,) of a row's square."""
        return np.asarray(1.0 / (self.std**2 * self.repeated))


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A set-up's products. geometry: of its rows. expected: (R, n) Nm the model's torque; target: what is left. slopes:
    (R, n, n) Nm/rad, how the expected torque changes with the zero of each joint.
    """

    set_up: SetUp
    geometry: Geometry
    products: Products
    expected: FloatArray
    target: FloatArray
    slopes: FloatArray


def torque_as_read(geometry: Geometry, set_up: SetUp) -> FloatArray:
    """(R, n) the measured torque with its signs turned and its delay taken off."""
    return np.asarray(set_up.signs * geometry.rows.torque_after(set_up.delay_s)[0])


def stretches_of(rows: Rows) -> IntArray:
    """(R,) which of PARTS stretches of time, one behind the other, a row is in."""
    order = np.unique(rows.block, return_inverse=True)[1]
    return np.asarray(order * PARTS // (order.max() + 1))


def compare(
    geometry: Geometry, set_up: SetUp, model: GivenModel, slopes: FloatArray | None = None, part: IntArray | None = None
) -> Comparison:
    """The products of every column with the difference. slopes: (R, n, n) of the zeros, computed where not given.

    part: (R,) which of PARTS parts a row is in; default: blocks in turns.
    """
    geometry = geometry.at(set_up.zeros)
    rows, layout = geometry.rows, Layout(geometry.robot.n)
    n, count = layout.n, len(rows.block)
    columns = np.zeros((count, n, layout.width))
    columns[..., layout.base] = geometry.columns(set_up.gravity, set_up.ratio)
    expected = columns[..., layout.base] @ model.values
    torque, rate = rows.torque_after(set_up.delay_s)
    columns[:, np.arange(n), layout.gain + np.arange(n)] = expected
    columns[..., layout.gain + n] = expected
    size = float(np.linalg.norm(set_up.gravity))
    columns[..., layout.tilt : layout.tilt + 2] = (
        geometry.weight(model.values) @ ((size if size > 0.0 else GRAVITY) * across(set_up.gravity)).T
        if size > 0.0
        else 0.0
    )
    columns[..., layout.clock] = geometry.by_ratio(model.values, set_up.ratio)
    columns[..., layout.delay] = -set_up.signs * rate
    if slopes is None:
        slopes = geometry.by_zero(model.values, set_up.gravity, set_up.ratio)
    columns[..., layout.zero :] = slopes
    target = set_up.signs * torque - expected
    part = rows.block % PARTS if part is None else part
    products = products_of(columns, target, rows.used, part, PARTS)
    return Comparison(set_up, geometry, products, expected, target, slopes)


def noise_of(
    geometry: Geometry, set_up: SetUp, sizes: Sizes, model: GivenModel, beside: FloatArray | None = None
) -> Noise:
    """What fourteen free parameters a link leave of the torque as it is read, weighted by itself.

    beside: (R, n, m) Nm of what is free besides, of the size of the torque. Where that is many times what the model
    left of its own recordings, it is no noise but what is wrong here.
    """
    std, left, used = _left_by_all(geometry, set_up, sizes, beside)
    usual = np.where(np.isfinite(model.left), MOST_NOISE * model.left, np.inf)
    return Noise(np.minimum(std, np.maximum(usual, sizes.least_noise)), repeated_rows(left, used))


def _left_by_all(
    geometry: Geometry, set_up: SetUp, sizes: Sizes, beside: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """(n,) Nm RMS, and (R, n) Nm, that all parameters leave; (R, n) of which rows. beside: as of `noise_of`."""
    geometry = geometry.at(set_up.zeros)
    rows = geometry.rows
    columns = geometry.columns(set_up.gravity, set_up.ratio)
    measured = torque_as_read(geometry, set_up)
    widths = wide_open(sizes)
    if beside is not None:
        columns = np.concatenate([columns, beside], axis=2)
        widths = np.concatenate([widths, np.ones(beside.shape[2])])
    everything = products_of(columns, measured, rows.used, np.zeros_like(rows.block), 1)
    std = sizes.first_noise
    left = measured
    for _ in range(3):
        gram, right = everything.summed((0,), 1.0 / std**2)
        values = posterior(gram, right, widths).values
        left = np.where(rows.used, measured - columns @ values, 0.0)
        std = np.sqrt((left**2).sum(axis=0) / np.maximum(rows.used.sum(axis=0), 1))
        std = np.maximum(std, sizes.least_noise)
    return std, left, rows.used


def as_friction_turns_over(geometries: Sequence[Geometry], set_up: SetUp, sizes: Sizes) -> list[Geometry]:
    """Rows with friction of each joint that turns over at once, or gently: as all parameters fitted anew leave less.

    A width that is wrong misfits at every reversal, most of all on a slow joint, and what it leaves hides a change, or
    looks like one.
    """
    gently, at_once = (
        sum(np.log(_left_by_all(each, set_up, sizes)[0]) for each in asked)
        for asked in (geometries, [each.turning_over(each.rows.sharp) for each in geometries])
    )
    return [each.turning_over(np.where(at_once < gently, each.rows.sharp, each.rows.direction)) for each in geometries]


def turned(set_up: SetUp, layout: Layout, place: int, values: FloatArray) -> SetUp:
    """The set-up after a step (m,) of the columns from `place` on."""
    if place == layout.tilt:
        size = float(np.linalg.norm(set_up.gravity))
        gravity = set_up.gravity + size * values @ across(set_up.gravity)
        return replace(set_up, gravity=gravity * size / np.linalg.norm(gravity))
    if place == layout.clock:
        return replace(set_up, ratio=set_up.ratio * float(np.exp(values[0])))
    if place == layout.delay:
        return replace(set_up, delay_s=set_up.delay_s + float(values[0]))
    zeros = set_up.zeros.copy()
    zeros[place - layout.zero] += float(values[0])
    return replace(set_up, zeros=zeros)
