"""Dynamic parameter identification of fixed-base serial robots: from a recording to a model with its uncertainty.

    import identification as ident

    recording = ident.read_recording("runs/first/recording.mcap")
    model = ident.fit(recording)

`read_recording`, `fit`, `validate`, `diagnose` and `design_excitation` are `identification.interface`, loaded when one
of them is first asked for. Models of robots, regressors, base parameters, estimators, excitation design, recordings and
fits live here. No sockets, no clocks, no processes: those are `daemon`'s. This package imports none of the other
top-level packages; inside it, import from the subpackage that holds a name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from identification.interface import design_excitation, diagnose, fit, read_recording, validate

__all__ = ["design_excitation", "diagnose", "fit", "read_recording", "validate"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module("identification.interface"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
