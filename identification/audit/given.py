"""The model that is given, as a Gaussian over all dynamic parameters: what it says, how sure, and what it leaves open.

A motion shows base parameters only; turned, or with a load, the same arm shows others. So all fourteen parameters of a
link are kept: those directions that the model does not know are as wide as bodies of the arm's size allow. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from identification.audit.columns import INERTIAL, PARAMETERS, SYMBOLS
from identification.audit.rows import COULOMB_VELOCITY, Rows
from identification.base_parameters import BaseRegressor
from identification.estimators.prior import uniform_bodies
from identification.model_file import Model
from identification.robots.model import RobotModel

__all__ = ["GivenModel", "Sizes", "given_model", "places_of", "sizes_of", "wide_open"]

FloatArray = npt.NDArray[np.float64]

MASS_OPEN, REST_OPEN = 3.0, 5.0
"""How wide a parameter is that nobody knows, in sizes of its link."""
DRAWN = 0.05
"""Of a link's size that a drawing is off by."""
DAILY_FRICTION = 0.1
"""Of a joint's friction by which it differs from day to day."""
DAILY_OFFSET = 0.02
"""Of the torque's standard deviation."""
DRIVE = 0.3
"""Of the torque's standard deviation that is a joint's own friction, where nobody knows."""


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """How large parameters of this arm are. each: (14 n,). mass: kg, length: m of a link (n,). torque: (n,) Nm."""

    each: FloatArray
    mass: FloatArray
    length: FloatArray
    torque: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class GivenModel:
    """values: (14 n,) with covariance (14 n, 14 n). own: fitted to a recording of the arm, else drawn. left: (n,) Nm
    RMS that it leaves of its own recordings, nan where it does not say. coulomb_velocity: rad/s of its friction.
    """

    name: str
    values: FloatArray
    covariance: FloatArray
    own: bool
    left: FloatArray
    coulomb_velocity: float


def sizes_of(robot: RobotModel, rows: Rows) -> Sizes:
    """Sizes by the arm's stretches, its torque and its motion."""
    bodies = uniform_bodies(robot.kinematics).bodies
    mass = bodies[:, 3, 3]
    mass = np.maximum(mass, 0.2 * mass.mean())
    length = np.sqrt(np.maximum(np.trace(bodies[:, :3, :3], axis1=1, axis2=2) / mass, 1e-4))
    torque = np.maximum(rows.torque.std(axis=0), 1e-6)
    speed, acceleration = (np.maximum(values.std(axis=0), 1e-3) for values in (rows.velocity, rows.acceleration))
    each = np.empty((robot.n, PARAMETERS))
    each[:, 0] = mass
    each[:, 1:4] = (mass * length)[:, None]
    each[:, 4:INERTIAL] = (mass * length**2)[:, None]
    drive = DRIVE * torque
    each[:, INERTIAL:] = np.stack([drive / speed, drive, drive, drive / acceleration], axis=1)
    return Sizes(each.ravel(), mass, length, torque)


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
    places = places_of(regressor)
    values = model.base_values(regressor) if isinstance(model, Model) else model
    covariance = model.base_covariance(regressor) if isinstance(model, Model) else None
    open_std = wide_open(sizes)
    mean = np.zeros(PARAMETERS * n)
    inertial = np.tile(np.arange(PARAMETERS) < INERTIAL, n)
    missing = np.ones(PARAMETERS * n, dtype=np.bool_)
    missing[places] = False
    # What the model does not have it holds for zero: an offset or a rotor is then a difference, not an open question.
    open_std[missing] = 1e-6 * sizes.each[missing]
    image = np.zeros((len(values), PARAMETERS * n))
    image[:, places] = regressor.regrouping
    spread = (image * open_std**2) @ image.T
    if covariance is None:
        covariance = np.diag(1e-8 * np.diag(spread))
    gain = np.linalg.solve(spread + covariance, image * open_std**2).T
    mean = mean + gain @ (values - image @ mean)
    known = np.diag(open_std**2) - gain @ (image * open_std**2)
    extra = np.zeros(PARAMETERS * n)
    table = mean.reshape(n, PARAMETERS)
    drives = extra.reshape(n, PARAMETERS)
    if isinstance(model, Model):
        drives[:, INERTIAL : INERTIAL + 2] = DAILY_FRICTION * np.abs(table[:, INERTIAL : INERTIAL + 2])
        drives[:, SYMBOLS.index("OFF")] = DAILY_OFFSET * sizes.torque
        fitted = model.data.get("rms_nm", {}).get("fit", [])
        left = np.array([np.nan if each is None else each for each in fitted])
    else:
        extra[inertial] = DRAWN * sizes.each[inertial]
        drives[:, INERTIAL:-1] = sizes.each.reshape(n, PARAMETERS)[:, INERTIAL:-1] * REST_OPEN
        left = np.full(n, np.nan)
    known = 0.5 * (known + known.T) + np.diag(extra**2 + (1e-6 * sizes.each) ** 2)
    width = regressor.options.coulomb_velocity or COULOMB_VELOCITY
    return GivenModel(
        name, mean, known, isinstance(model, Model), left if left.shape == (n,) else np.full(n, np.nan), width
    )


def places_of(regressor: BaseRegressor) -> npt.NDArray[np.int64]:
    """Where the regressor's dynamic parameters stand among the fourteen of each link."""
    symbols = (*SYMBOLS[:INERTIAL], *regressor.options.symbols)
    return np.array(
        [link * PARAMETERS + SYMBOLS.index(symbol) for link in range(regressor.robot.n) for symbol in symbols]
    )
