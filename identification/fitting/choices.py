"""The words a fit can be told to choose by. Apart from the settings, so that a command line knows them at no cost."""

from __future__ import annotations

from typing import Literal

Pipeline = Literal["auto", "periodic", "paper", "aperiodic"]
Estimator = Literal["auto", "ols", "weighted", "maximum_likelihood", "huber", "instrumental"]
DelayCorrection = Literal["no", "common", "per_joint"]
Choice = Literal["auto", "yes", "no"]
