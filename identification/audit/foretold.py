"""The torque that a model foretells on the rows of an audit, and the friction that it lacks. Pure."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from identification.arrays import FloatArray
from identification.audit.columns import Geometry
from identification.audit.comparison import LEAST_SIGMAS, PARTS, REPORT
from identification.audit.difference import Difference, by_so_much, numbers_of
from identification.audit.given import places_of
from identification.base_parameters import BaseRegressor
from identification.robots.joint_units import in_units

LEAST_SHARE = 0.15
"""Of what an offset leaves of a joint's torque, that friction takes away on rows that it was not fitted to."""


def foretold(
    geometry: Geometry, regressor: BaseRegressor, values: FloatArray, gravity: FloatArray | None = None
) -> FloatArray:
    """(R, n) Nm of base parameters (p,); gravity (3,) m/s² in the base frame, the robot's own where not given."""
    columns = geometry.columns(np.array(geometry.robot.gravity) if gravity is None else gravity)
    return np.asarray(columns[..., places_of(regressor)[regressor.kept]] @ values)


def lacking_friction(
    geometry: Geometry, left: FloatArray, viscous: FloatArray, coulomb: FloatArray, source: str
) -> list[Difference]:
    """Friction and offset of each joint in what a model leaves, (R, n) Nm, where they take enough of it away.

    viscous, coulomb: (n,) that the model has, below zero of which none may come. A drawn model does not know its
    friction: this is what it is by these rows.
    """
    rows, found = geometry.rows, []
    reported = np.isin(rows.block % PARTS, REPORT)
    for joint in range(geometry.robot.n):
        used = rows.used[:, joint]
        columns = np.column_stack([rows.velocity[:, joint], rows.direction[:, joint], np.ones(len(rows.block))])
        fitted, unseen = used & ~reported, used & reported
        least = np.array([-viscous[joint], -coulomb[joint], -np.inf]) - 1e-12
        if fitted.sum() < columns.shape[1] or not unseen.any():
            continue
        values = lsq_linear(columns[fitted], left[fitted, joint], (least, np.full(3, np.inf))).x
        stays = left[unseen, joint] - columns[unseen] @ values
        # An offset alone takes its part away as well, and has no place in a file.
        whole = float(np.sum((left[unseen, joint] - left[fitted, joint].mean()) ** 2))
        share = 1.0 - float(stays @ stays) / whole if whole > 0.0 else 0.0
        scale = float(np.std(left[fitted, joint] - columns[fitted] @ values))
        std = scale * np.sqrt(np.diag(np.linalg.pinv(columns[fitted].T @ columns[fitted])))
        # A mere offset is no friction, and no simulator's file holds one.
        if share < LEAST_SHARE or not (np.abs(values) > LEAST_SIGMAS * std)[:2].any():
            continue
        units = [in_units(unit, geometry.robot.units, (joint + 1,)) for unit in ("Nm s/rad", "Nm", "Nm")]
        numbers = numbers_of(("viscous", "coulomb", "offset"), values, std, units)
        found.append(
            Difference(
                "friction_change",
                joint + 1,
                None,
                numbers,
                share,
                float("nan"),
                "model",
                f"The friction of joint {joint + 1} is another than {source} says, by {by_so_much(numbers)}: "
                f"{100.0 * share:.0f} % of what an offset leaves there.",
            )
        )
    return found
