"""Was the torque filtered before it was recorded, and the motion was not? A linear filter common to all joints is asked
of a recording alone: a low-pass in phase, a one-sided one, and a mere delay.

What is filtered on one side must be filtered on the other: the columns of the rigid body go through the same filter.
Pure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import BoolArray, ComplexArray, FloatArray
from identification.audit.held_out import Asked, Score
from identification.audit.rows import BLOCK_S, WIDEST_HZ, Rows

CORNERS_HZ = np.geomspace(0.5 / BLOCK_S, WIDEST_HZ, 7)
"""From half a wave in a block of rows to the band of the rows."""
DELAYS_S = np.array([0.03, 0.2])
FIRST_ORDER, OTHER_ORDERS = 2, (1, 4)
SMALLEST_STEP = 1e-3
"""Of a value's logarithm: nearer than asked."""


@dataclass(frozen=True, slots=True)
class Filter:
    """kind: "in phase", "one-sided" or "late". value: corner in Hz, at which half of the power comes out (in phase: a
    quarter), or by how many s the torque is late. order: of the Butterworth low-pass, run once, or there and back.
    """

    kind: str
    value: float
    order: int = FIRST_ORDER

    def response(self, hz: FloatArray) -> ComplexArray:
        """(F,) of the torque's to that of the motion."""
        if self.kind == "late":
            return np.asarray(np.exp(-2j * np.pi * hz * self.value))
        if self.kind == "in phase":
            return (1.0 / (1.0 + (hz / self.value) ** (2 * self.order))).astype(np.complex128)
        angle = np.pi * (2.0 * np.arange(1, self.order + 1) + self.order - 1.0) / (2.0 * self.order)
        poles = np.exp(1j * angle)[:, None]
        return np.asarray(np.prod(-poles / (1j * hz / self.value - poles), axis=0))

    @property
    def sentence(self) -> str:
        """What an operator reads."""
        if self.kind == "late":
            return (
                f"All torques are {1e3 * self.value:.0f} ms later than the positions: taken earlier, the recording "
                "goes far better with one rigid body. Give --delay-correction common"
            )
        how = "forwards and backwards" if self.kind == "in phase" else "so that they are late, too"
        less = f"; without periods, --low-pass {0.5 * self.value:.2g} takes most of it away"
        return (
            f"All torques were low-passed before they were recorded, at {self.value:.2g} Hz ({how}), and the "
            "positions were not: with the arm's torque filtered alike, the recording goes far better with one rigid "
            "body. Every parameter is off by that. Record the torques unfiltered"
            f"{less if self.kind == 'in phase' else ''}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Mirrored:
    """Columns (R, n, K) of stretches as frequencies, so that each filter costs one transform and not two; at its ends a
    stretch is taken to turn back. live: which columns are not zero. spectra: of each stretch, with its rows.
    """

    live: BoolArray
    spectra: tuple[tuple[slice, ComplexArray], ...]
    spacing_s: float

    @classmethod
    def of(cls, asked: Asked, columns: FloatArray) -> _Mirrored:
        """Of the rows asked of."""
        live, spectra, first = np.asarray(columns.any(axis=0)), [], 0
        for stretch in asked.rows.smooth:
            here = slice(first, first + len(stretch.samples))
            own = columns[here][:, live]
            spectra.append((here, np.fft.rfft(np.concatenate([own[::-1], own]), axis=0)))
            first = here.stop
        return cls(live, tuple(spectra), asked.rows.spacing_s)

    def through(self, by: Filter) -> FloatArray:
        """The columns behind a filter."""
        last = self.spectra[-1][0].stop
        result = np.zeros((last, *self.live.shape))
        for here, spectrum in self.spectra:
            length = here.stop - here.start
            response = by.response(np.fft.rfftfreq(2 * length, self.spacing_s).astype(np.float64))
            passed = np.fft.irfft(spectrum * response[:, None], n=2 * length, axis=0)
            result[here, self.live] = passed[length:]
        return result


def within_stretches(rows: Rows) -> Rows:
    """Rows without the first and the last block of each stretch: what a filter saw before nobody knows."""
    inside, first = np.zeros(len(rows.block), dtype=np.bool_), 0
    for stretch in rows.smooth:
        own = rows.block[first : first + len(stretch.samples)]
        inside[first : first + len(own)] = (own > own[0]) & (own < own[-1])
        first += len(own)
    return replace(rows, used=rows.used & inside[:, None])


def likeliest_filter(asked: Asked, stated: Score, least_gain: float) -> tuple[Filter, Score] | None:
    """The filter that makes a recording likeliest, None where none gains so many nats. asked: rows without a gap."""
    near: dict[str, tuple[float, ...]] = {
        "late": (*-DELAYS_S, *DELAYS_S), "in phase": tuple(CORNERS_HZ), "one-sided": tuple(CORNERS_HZ)
    }  # fmt: skip
    mirrored, least = _Mirrored.of(asked, asked.columns), stated.nats + least_gain
    found: list[tuple[Filter, Score]] = []
    for kind, values in near.items():
        filters = [Filter(kind, float(value)) for value in values]
        tried = [(item, asked.of_reading(mirrored.through(item), least=least)) for item in filters]
        first, score = max(tried, key=lambda item: item[1].nats)
        if score.nats > least:
            found.append(_settled(asked, mirrored, first))
    if not found:
        return None
    best = max(found, key=lambda item: item[1].nats)
    if best[0].kind != "late":
        found += [_settled(asked, mirrored, replace(best[0], order=order)) for order in OTHER_ORDERS]
    return max(found, key=lambda item: item[1].nats)


def _settled(asked: Asked, mirrored: _Mirrored, near: Filter) -> tuple[Filter, Score]:
    """The filter of that kind and order that leaves least, by tangents in the logarithm of its value."""

    def further(log: float) -> Filter:
        return replace(near, value=near.value * float(np.exp(log)))

    def at(log: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        columns = mirrored.through(further(log[0]))
        values = asked.values(asked.products(columns, asked.rows.torque), asked.widths())
        torque = _Mirrored.of(asked, (asked.columns @ values)[..., None])
        ahead, back = (torque.through(further(log[0] + step)) for step in (SMALLEST_STEP, -SMALLEST_STEP))
        return columns, (ahead - back) / (2.0 * SMALLEST_STEP), asked.rows.torque

    found = further(asked.settled(np.zeros(1), at, 1.0, SMALLEST_STEP)[0])
    return found, asked.of_reading(mirrored.through(found))
