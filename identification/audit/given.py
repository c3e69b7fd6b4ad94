"""The model that is given, as a Gaussian over all dynamic parameters: what it says, how sure, and what it leaves open.

A motion shows base parameters only; turned, or with a load, the same arm shows others. So all fourteen parameters of a
link are kept: those directions that the model does not know are as wide as bodies of the arm's size allow. Pure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.audit.columns import GRAVITY, INERTIAL, PARAMETERS, SYMBOLS
from identification.audit.rows import Rows
from identification.base_parameters import BaseRegressor
from identification.estimators.prior import uniform_bodies
from identification.model_file import Model
from identification.robots.model import RobotModel
from identification.robots.simulator_models import DRAWN

MASS_OPEN, REST_OPEN = 3.0, 5.0
"""How wide a parameter is that nobody knows, in sizes of its link."""
DAILY_FRICTION = 0.1
"""Of a joint's friction by which it differs from day to day."""
DAILY_OFFSET = 0.02
"""Of the torque's standard deviation."""
DAILY_DELAY_S = 1e-3
"""By which the torque of two runs is late by more or less: a cycle of the loop that reads it."""
HIDDEN = 0.3
"""Of what a model leaves of a joint, what one parameter makes that it does not have, or has by a motion that weighs
otherwise: more, and the fit had taken it.
"""
DRIVE = 0.3
"""Of the torque's standard deviation that is a joint's own friction, where nobody knows."""


FIRST = 0.1
"""Of its torque, what is taken to be left of a joint before anything is known; a joint out of its place leaves more."""
SLOW = 1e-3
"""rad/s, rad/s² that a joint is taken to move by at least."""
WIDEST = 20.0
"""Sizes of the arm's mean link that a load may have; more is no load of this arm."""


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """How large parameters of this arm are. each: (14 n,). mass: kg, length: m of a link (n,). torque: (n,) Nm. speed:
    (n,) rad/s (m/s), RMS.
    """

    each: FloatArray
    mass: FloatArray
    length: FloatArray
    torque: FloatArray
    speed: FloatArray

    @property
    def least_noise(self) -> FloatArray:
        """(n,) Nm, what a residual is weighed by at least: a share of its torque, and of the arm's own weight. Torques
        in another unit may be so far below that weight that the two have no solution together.
        """
        weight = GRAVITY * float(self.mass @ self.length)
        return np.maximum(1e-4 * self.torque, 1e-6 * weight)

    @property
    def first_noise(self) -> FloatArray:
        """(n,) Nm, what a residual is weighed by before anything is known."""
        return np.maximum(FIRST * self.torque, 1e-9)


@dataclass(frozen=True, slots=True, eq=False)
class GivenModel:
    """values: (14 n,) with covariance (14 n, 14 n) on the day it was made. daily: (14 n,) standard deviation by which
    friction and offsets differ on another day. own: fitted to a recording of the arm, else drawn. left: (n,) Nm RMS
    that it leaves of its own recordings, nan where it does not say. delay_s, delay_std_s: how late the torque of its
    own recordings was; only another delay is a difference. rotors: whether it could have said that drives have inertia.
    """

    name: str
    values: FloatArray
    covariance: FloatArray
    daily: FloatArray
    own: bool
    left: FloatArray
    delay_s: float
    delay_std_s: float
    rotors: bool

    def covariance_on(self, day: float) -> FloatArray:
        """(14 n, 14 n) where friction differs so many times as much as from day to day."""
        return self.covariance + np.diag((day * self.daily) ** 2)


def sizes_of(robot: RobotModel, rows: Rows) -> Sizes:
    """Sizes by the arm's stretches, its torque and its motion."""
    bodies = uniform_bodies(robot.kinematics).bodies
    mass = bodies[:, 3, 3]
    mass = np.maximum(mass, 0.2 * mass.mean())
    length = np.sqrt(np.maximum(np.trace(bodies[:, :3, :3], axis1=1, axis2=2) / mass, 1e-4))
    torque = np.maximum(rows.torque.std(axis=0), 1e-6)
    speed, acceleration = (np.maximum(values.std(axis=0), SLOW) for values in (rows.velocity, rows.acceleration))
    each = np.empty((robot.n, PARAMETERS))
    each[:, 0] = mass
    each[:, 1:4] = (mass * length)[:, None]
    each[:, 4:INERTIAL] = (mass * length**2)[:, None]
    drive = DRIVE * torque
    each[:, INERTIAL:] = np.stack([drive / speed, drive, drive, drive / acceleration], axis=1)
    return Sizes(each.ravel(), mass, length, torque, np.maximum(np.sqrt((rows.velocity**2).mean(axis=0)), SLOW))


def wide_open(sizes: Sizes) -> FloatArray:
    """(14 n,) standard deviation of parameters that nobody knows."""
    factor = np.full((len(sizes.mass), PARAMETERS), REST_OPEN)
    factor[:, 0] = MASS_OPEN
    return factor.ravel() * sizes.each


def given_model(model: Model | FloatArray, regressor: BaseRegressor, sizes: Sizes, name: str) -> GivenModel:
    """A model.json, or base parameters (p,) of a simulator's file, as a Gaussian.

    Raises ModelFileError where its parameters are those of another arm.
    """
    n = regressor.robot.n
    own = isinstance(model, Model)
    places = places_of(regressor)
    values = model.base_values(regressor) if isinstance(model, Model) else model
    covariance = model.base_covariance(regressor) if isinstance(model, Model) else None
    open_std = wide_open(sizes)
    missing = np.ones(PARAMETERS * n, dtype=np.bool_)
    missing[places] = False
    # What the model does not have it holds for zero.
    open_std[missing] = 1e-6 * sizes.each[missing]
    image = np.zeros((len(values), PARAMETERS * n))
    image[:, places] = regressor.regrouping
    spread = (image * open_std**2) @ image.T
    if covariance is None:
        covariance = np.diag(1e-8 * np.diag(spread))
    gain = np.linalg.solve(spread + covariance, image * open_std**2).T
    mean = gain @ values
    known = np.diag(open_std**2) - gain @ (image * open_std**2)
    known = 0.5 * (known + known.T) + np.diag((1e-6 * sizes.each) ** 2)
    daily = np.zeros((n, PARAMETERS))
    left, delay = np.full(n, np.nan), (0.0, DAILY_DELAY_S)
    if isinstance(model, Model):
        friction = slice(INERTIAL, INERTIAL + 2)
        daily[:, friction] = DAILY_FRICTION * np.abs(mean.reshape(n, PARAMETERS)[:, friction])
        daily[:, SYMBOLS.index("OFF")] = DAILY_OFFSET * sizes.torque
        fitted = model.data.get("rms_nm", {}).get("fit", [])
        if len(fitted) == n:
            left = np.array([np.nan if each is None else each for each in fitted])
        # A drive's parameter that the fit does not have may hide in what it left, and is then no news.
        hidden = sizes.each.reshape(n, PARAMETERS) * (HIDDEN * np.nan_to_num(left) / (DRIVE * sizes.torque))[:, None]
        known += np.diag(np.where(missing, hidden.ravel(), 0.0) ** 2)
        known += np.diag(_at_another_speed(np.nan_to_num(left), model.speed_rms(n), sizes.speed).ravel() ** 2)
        delay = _delay(model.data.get("provenance", {}))
    else:
        drawn = DRAWN * sizes.each.reshape(n, PARAMETERS)
        drawn[:, INERTIAL:] = 0.0
        drawn[:, INERTIAL:-1] = REST_OPEN * sizes.each.reshape(n, PARAMETERS)[:, INERTIAL:-1]
        known += np.diag(drawn.ravel() ** 2)
    rotors = own or regressor.options.rotor_inertia
    return GivenModel(name, mean, known, daily.ravel(), own, left, *delay, rotors)


def _at_another_speed(left: FloatArray, its_own: FloatArray | None, here: FloatArray) -> FloatArray:
    """(n, 14) by which viscous and Coulomb friction of a fit are in doubt at the speeds here.

    Friction over velocity is no straight line. What a fit leaves of it at speeds v₀, Nm RMS, is as much at v₁ and
    |v₁/v₀ − 1| times as much besides, where the line goes on that was fitted at v₀. At the same speeds a share of what
    it leaves stays in doubt, as another motion weighs the curve otherwise (HIDDEN).
    """
    result = np.zeros((len(left), PARAMETERS))
    if its_own is not None:
        slow, fast = (np.maximum(choose(its_own, here), SLOW) for choose in (np.minimum, np.maximum))
        result[:, SYMBOLS.index("FV")] = left * np.hypot(1.0 / slow - 1.0 / fast, HIDDEN / fast)
        result[:, SYMBOLS.index("FS")] = left * np.hypot(1.0 - slow / fast, HIDDEN)
    return result


def _delay(provenance: Mapping[str, Any]) -> tuple[float, float]:
    """How late the torque of a fit's recordings was beside its parameters, and how well that is known of another run,
    s; zeros without. Parameters that were fitted to a late torque as it was have part of the delay in them.
    """
    entry = provenance.get("torque_delay", {})
    which = "common" if any(provenance.get("torque_shift_s") or ()) or "first_s" not in entry else "first"
    late, std = entry.get(f"{which}_s"), entry.get(f"{which}_std_s")
    if late is None or std is None:
        return 0.0, 0.0
    return float(late), float(np.hypot(std, DAILY_DELAY_S))


def places_of(regressor: BaseRegressor) -> IntArray:
    """Where the regressor's dynamic parameters stand among the fourteen of each link."""
    symbols = (*SYMBOLS[:INERTIAL], *regressor.options.symbols)
    return np.array(
        [link * PARAMETERS + SYMBOLS.index(symbol) for link in range(regressor.robot.n) for symbol in symbols]
    )
