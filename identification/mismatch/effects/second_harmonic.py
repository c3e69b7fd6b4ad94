"""A wave over the angle that may carry its second harmonic, as two parameters that are zero in the textbook."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, ShapeParameter

REAL, IMAGINARY = "second_harmonic_real", "second_harmonic_imaginary"
LARGEST = 0.5
"""Of w, real and imaginary part: beyond it the second harmonic is an order of its own."""


def second_harmonic() -> tuple[ShapeParameter, ...]:
    """The complex w of A Im[(e^ix + w e^2ix) e^iφ], zero in the textbook."""
    return tuple(
        ShapeParameter(name, "1", (0.0,), -LARGEST, LARGEST, logarithmic=False, textbook=0.0)
        for name in (REAL, IMAGINARY)
    )


def waves(angle: FloatArray, shape: Mapping[str, float]) -> FloatArray:
    """Columns (S, 2) of a in a sin x + b cos x with their second harmonics; angle: x (S,)."""
    wave = np.exp(1j * angle)
    wave = wave + complex(shape.get(REAL, 0.0), shape.get(IMAGINARY, 0.0)) * wave**2
    return np.column_stack([wave.imag, wave.real])


def harmonic_share(estimate: Estimate) -> tuple[Parameter, ...]:
    """|w|, the second harmonic's share of the first, as a parameter; none in the textbook form."""
    value = complex(estimate.shape.get(REAL, 0.0), estimate.shape.get(IMAGINARY, 0.0))
    if value == 0.0:
        return ()
    deviation = max(estimate.shape_std.get(name, math.nan) for name in (REAL, IMAGINARY))
    return (Parameter("second_harmonic", abs(value), deviation, "1"),)
