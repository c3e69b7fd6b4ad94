"""Dynamic parameter identification of fixed-base serial robots: from a recording to a model with its uncertainty.

Models of robots, regressors, base parameters, estimators, excitation design, recordings and fits live here. No sockets,
no clocks, no processes: those are `daemon`'s. This package imports none of the other top-level packages. Import from
the subpackage that holds a name (`identification.robots`, `identification.base_parameters`, …).
"""

__all__: list[str] = []
