"""The parts of a fit: settings, observation, choice of the drive model, sign of the torque, result.

`identification.fit` puts them together; nothing else calls them.
"""

from __future__ import annotations

from identification.fitting.result import FitResult
from identification.fitting.rms import RmsRow, RmsTable
from identification.fitting.settings import FitSettings, Split

__all__ = ["FitResult", "FitSettings", "RmsRow", "RmsTable", "Split"]
