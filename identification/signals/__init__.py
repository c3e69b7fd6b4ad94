"""From a Recording to what an estimator can use: motion, torque, and one linear treatment of both sides.

Here: averaging over periods, derivatives, filters, standstill, noise from period to period. Not here: reading files
(`recordings`), regressors and estimation.
"""

from __future__ import annotations

from identification.signals.aperiodic import process_aperiodic
from identification.signals.paper_chain import process_as_in_paper
from identification.signals.periodic import PeriodicSettings, process_periodic
from identification.signals.periods import average_periods, period_table
from identification.signals.processed import ProcessedSignals

__all__ = [
    "PeriodicSettings",
    "ProcessedSignals",
    "average_periods",
    "period_table",
    "process_aperiodic",
    "process_as_in_paper",
    "process_periodic",
]
