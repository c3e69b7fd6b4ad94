"""What a fit can be told, and the split of a recording into rows to fit and rows to hold out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from numbers import Real
from typing import Any, get_args

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.base_parameters import Widths
from identification.errors import EstimationError
from identification.estimators.feasibility import FeasibilityRules
from identification.fitting.choices import Choice, DelayCorrection, Estimator, Pipeline

OF_SIGNALS = ("low_pass_hz", "motion_bandwidth_hz", "torque_bandwidth_hz", "flip_torque")
OF_PROCESSING = ("pipeline", "split", *OF_SIGNALS)
"""Settings that other recordings are processed by, too, when they are compared with the fit."""
Progress = Callable[[str, float], None]
"""Called with what is being done and the share of the whole that is done, 0 to 1."""


def silent(phase: str, share: float) -> None:
    """Progress that nobody watches."""


@dataclass(frozen=True, slots=True)
class Split:
    """Which rows of a recording are held out, by time.

    "first:0.6" fits the first 60 % of the time and holds out the rest. "blocks:0.5:3" holds out every third block of
    0.5 s (the third, the sixth, …; "blocks:0.5:3:0" the first, the fourth, …).
    """

    kind: str
    numbers: tuple[float, ...]

    @classmethod
    def parse(cls, text: str) -> Split:
        """The split a text describes. Raises EstimationError for any other text."""
        kind, _, rest = text.partition(":")
        try:
            numbers = tuple(float(part) for part in rest.split(":"))
        except ValueError:
            numbers = ()
        if kind == "first" and len(numbers) == 1 and 0.0 < numbers[0] < 1.0:
            return cls(kind, numbers)
        if kind == "blocks" and len(numbers) in (2, 3) and numbers[0] > 0.0 and numbers[1] >= 2.0:
            return cls(kind, (*numbers, numbers[1] - 1.0)[:3])
        raise EstimationError(
            f"'{text}' is no split; 'first:0.6' (fit the first 60 %) or 'blocks:0.5:3' (hold out every third block of "
            "0.5 s) are"
        )

    def held_out(self, time: FloatArray, start_s: float, duration_s: float) -> BoolArray:
        """(N,) which of the times are held out of a recording that starts at start_s and lasts duration_s."""
        elapsed = time - start_s
        if self.kind == "first":
            return np.asarray(elapsed >= self.numbers[0] * duration_s, dtype=np.bool_)
        block_s, every, which = self.numbers
        return np.asarray(np.floor(elapsed / block_s + 1e-9) % int(every) == int(which), dtype=np.bool_)

    def boundary_distance(self, time: FloatArray, start_s: float, duration_s: float) -> FloatArray:
        """(N,) s, distance of each time to the nearest change between fitted and held out."""
        elapsed = time - start_s
        if self.kind == "first":
            return np.abs(elapsed - self.numbers[0] * duration_s)
        block_s = self.numbers[0]
        place = np.mod(elapsed, block_s)
        return np.asarray(np.minimum(place, block_s - place), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Settings of `fit_recordings`; the defaults suit a periodic recording of an arm with joint torque sensors.

    pipeline: "auto" takes the periodic one where a recording has periods and no split is asked for, else the
    aperiodic. low_pass_hz: cutoff of the aperiodic pipeline, None = as the data ask (`fitting.band`).
    motion_bandwidth_hz, torque_bandwidth_hz: most that the periodic pipeline looks at; the data may ask for less.
    split: text of a `Split`, None = fit all rows. estimator: as listed in `fitting.estimate`; "auto" is
    maximum_likelihood where the pipeline is periodic, ols where it is the paper's, weighted otherwise.
    delay_correction: shift the torque by the delay estimated against the position, one for all joints or one each;
    "no" only reports it. rotor_inertia, offset: whether each joint gets that parameter; "auto" = as
    `fitting.drives` decides, but no rotor inertia for the built-in arms, whose torque sensors sit behind the gear.
    coulomb_velocity: rad/s (m/s) over which Coulomb friction turns over on all joints, or on each, 0 = sign(q̇),
    None = as `fitting.friction_width` decides. flip_torque: turn the sign of all torques first. check_torque_sign:
    refuse a recording whose torque has the wrong sign. physical: also solve for physically feasible parameters. bounds:
    entries of `FeasibilityRules` by name, in place of the robot's defaults. full_consistency: program (10) also
    asks for positive semidefinite pseudo-inertias. starts, seed: of the constrained program.
    """

    pipeline: Pipeline = "auto"
    low_pass_hz: float | None = None
    motion_bandwidth_hz: float = 20.0
    torque_bandwidth_hz: float = 60.0
    split: str | None = None
    estimator: Estimator = "auto"
    delay_correction: DelayCorrection = "no"
    rotor_inertia: Choice = "auto"
    offset: Choice = "auto"
    coulomb_velocity: Widths | None = None
    flip_torque: bool = False
    check_torque_sign: bool = True
    physical: bool = True
    bounds: Mapping[str, Any] | None = None
    full_consistency: bool = False
    starts: int = 16
    seed: int = 20240607

    def __post_init__(self) -> None:
        if self.split is not None:
            Split.parse(str(self.split))
        FeasibilityRules().with_bounds(self.bounds)
        for name, allowed in (
            ("pipeline", ("auto", "periodic", "paper", "aperiodic")),
            ("estimator", get_args(Estimator)),
            ("delay_correction", get_args(DelayCorrection)),
            ("rotor_inertia", ("auto", "yes", "no")),
            ("offset", ("auto", "yes", "no")),
        ):
            if getattr(self, name) not in allowed:
                raise EstimationError(f"{name} is '{getattr(self, name)}'; known are {', '.join(allowed)}")
        for name in ("low_pass_hz", "motion_bandwidth_hz", "torque_bandwidth_hz"):
            hertz = getattr(self, name)
            if (name, hertz) != ("low_pass_hz", None) and not _is_positive(hertz):
                raise EstimationError(f"{name} is {hertz!r}; it is a positive number of Hz")
        if not isinstance(self.flip_torque, bool):
            raise EstimationError(f"flip_torque is {self.flip_torque!r}; it is true or false")

    def to_json(self) -> dict[str, Any]:
        """The settings as plain JSON types."""
        return asdict(self)


def _is_positive(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and 0.0 < float(value) < np.inf
