"""Which fraction of itself a motion is driven at: one rule, for options, configuration, requests and the service."""

from __future__ import annotations

SMALLEST_AMPLITUDE, LARGEST_AMPLITUDE = 0.01, 1.0
"""With less the arm hardly leaves its pose; with more it leaves what was designed."""


def amplitude_reason(amplitude: float) -> str | None:
    """Why a motion is not driven at this fraction of itself; None where it may be."""
    if SMALLEST_AMPLITUDE <= amplitude <= LARGEST_AMPLITUDE:
        return None
    return f"{amplitude:g} is outside {SMALLEST_AMPLITUDE:g} to {LARGEST_AMPLITUDE:g}."
