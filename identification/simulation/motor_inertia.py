"""Motor inertias for simulation where identification cannot see them: a prior, and the sentence that says so.

A torque sensor behind the gear does not see its own motor, but a simulated arm without motors is unstable under the
gains that hold a real one (and a motor is most of what a wrist's controller moves).
"""

from __future__ import annotations

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.export.parameters import ModelParameters
from identification.robots import RobotModel
from identification.robots.joint_units import in_units

INERTIA_PER_TORQUE = 4.4 / 320.0
"""kg m² seen at the joint per Nm of rated torque: 160² · 1.74e-4 kg m² on a 320 Nm axis.

Gear ratio and rotor inertia of public simulator models of the iiwa (Drake, pull requests 19344 and 20420), which are
estimates themselves; the other axes by rated torque. Good to perhaps a factor of two.
"""


def motor_inertia_of(robot: RobotModel, parameters: ModelParameters) -> tuple[FloatArray, str]:
    """(n,) kg m² (kg for a prismatic joint) of each motor as seen at its joint, and where the numbers are from.

    Identified ones where the model has them (torque measured at the motor), joint by joint; else the prior by rated
    torque; else, where no rated torque is stated, as much as the links' own inertia at zero.
    """
    identified = parameters.rotor_inertia
    assumed = identified <= 0.0
    if not assumed.any():
        return identified.copy(), "Motor inertias are the identified ones; the simulated torque contains them."
    model = parameters.pinocchio_model(robot)
    model.armature = np.zeros(robot.n)
    own = np.diag(pinocchio.crba(model, model.createData(), np.zeros(robot.n)))
    rated = np.where(robot.effort > 0.0, robot.effort, np.nan)
    by_torque = np.isfinite(rated) & robot.kinematics.revolute
    prior = np.where(by_torque, INERTIA_PER_TORQUE * rated, own)
    values = np.where(assumed, prior, identified)
    listed = ", ".join(f"{value:.3g}" for value in values[assumed])
    joints = [str(joint + 1) for joint in np.flatnonzero(assumed)]
    which = "" if assumed.all() else f" of joint{'s' if len(joints) > 1 else ''} {', '.join(joints)}"
    others = "" if assumed.all() else " Those of the other joints are the identified ones, which it contains."
    origin = "from rated torque" if by_torque[assumed].all() else "where no rated torque is stated, as the links' own"
    return values, in_units(
        f"Motor inertias{which} are no identified numbers but a prior ({listed} kg m²; {origin}): they move the "
        f"simulated arm and are not in its measured torque.{others}",
        robot.units,
    )
