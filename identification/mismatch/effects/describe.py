"""Numbers and words that the effects' parameters and sentences share."""

from __future__ import annotations

import math

from identification.mismatch.effects.base import Estimate, Parameter


def linear(name: str, estimate: Estimate, unit: str, *, index: int = 0, scale: float = 1.0) -> Parameter:
    """A coefficient as a parameter; scale: what one unit of the coefficient is in `unit`."""
    std = deviation(estimate, index)
    return Parameter(name, scale * float(estimate.coefficients[index]), abs(scale) * std, unit)


def shaped(name: str, estimate: Estimate, unit: str, *, scale: float = 1.0, called: str = "") -> Parameter:
    """A nonlinear parameter, by its own name or another; its standard deviation is nan where the search gives none."""
    value, std = (scale * float(each) for each in (estimate.shape[name], estimate.shape_std.get(name, math.nan)))
    return Parameter(called or name, value, std, unit)


def deviation(estimate: Estimate, index: int) -> float:
    """Standard deviation of one coefficient."""
    return float(estimate.std[index])


def harmonic(
    estimate: Estimate, unit: str = "Nm", *, scale: float = 1.0, called: str = "amplitude"
) -> tuple[Parameter, Parameter]:
    """Of coefficients a, b: amplitude A ≥ 0 and phase φ, rad, of A sin(x + φ) = a sin x + b cos x, std of first order.

    scale: what one unit of the coefficients is in `unit`.
    """
    a, b = (float(value) for value in estimate.coefficients[:2])
    amplitude = math.hypot(a, b)
    if amplitude == 0.0:
        return Parameter(called, 0.0, scale * deviation(estimate, 0), unit), Parameter("phase", 0.0, math.nan, "rad")
    along = (a / amplitude, b / amplitude)
    across = (-b / amplitude, a / amplitude)
    block = ((0, along[0], across[0]), (1, along[1], across[1]))
    variance = sum(p[1] * r[1] * float(estimate.covariance[p[0], r[0]]) for p in block for r in block)
    turned = sum(p[2] * r[2] * float(estimate.covariance[p[0], r[0]]) for p in block for r in block)
    return (
        Parameter(called, scale * amplitude, scale * math.sqrt(max(0.0, variance)), unit),
        Parameter("phase", math.atan2(b, a), math.sqrt(max(0.0, turned)) / amplitude, "rad"),
    )


def size(value: float, std: float, unit: str) -> str:
    """'0.31 ± 0.02 Nm', with the half width of the 95 % interval; without it where std is not known."""
    text = _plain(value, 3)
    if math.isfinite(std) and std > 0.0:
        text += f" ± {_plain(1.96 * std, 1)}"
    return f"{text} {unit}".rstrip()


def _plain(value: float, digits: int) -> str:
    """So many significant digits, without an exponent up to a million: 7680, not 7.68e+03."""
    return f"{float(f'{value:.{digits}g}'):g}"


def size_of(parameter: Parameter) -> str:
    """`size` of a parameter."""
    return size(parameter.value, parameter.std, parameter.unit)


def joint_name(estimate: Estimate) -> str:
    """'Joint 3' or 'Every joint'."""
    return "Every joint" if estimate.place.joint is None else f"Joint {estimate.place.joint}"
