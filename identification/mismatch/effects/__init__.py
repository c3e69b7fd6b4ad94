"""The library of effects: one file per physical effect, and the list of all of them."""

from __future__ import annotations

from identification.mismatch.effects.asymmetric_viscous_friction import AsymmetricViscousFriction
from identification.mismatch.effects.backlash import Backlash
from identification.mismatch.effects.base import Effect, Estimate, Place
from identification.mismatch.effects.base_elasticity import BaseElasticity
from identification.mismatch.effects.base_tilt import BaseTilt
from identification.mismatch.effects.bending_crosstalk import BendingCrosstalk
from identification.mismatch.effects.cable_spring import CableSpring
from identification.mismatch.effects.distal_rotor_reaction import DistalRotorReaction
from identification.mismatch.effects.external_contact import ExternalContact
from identification.mismatch.effects.joint_coupling import JointCoupling
from identification.mismatch.effects.joint_crosstalk import JointCrosstalk
from identification.mismatch.effects.joint_elasticity import JointElasticity
from identification.mismatch.effects.joint_zero_offset import JointZeroOffset
from identification.mismatch.effects.load_dependent_friction import LoadDependentFriction
from identification.mismatch.effects.nonlinear_viscous_friction import NonlinearViscousFriction
from identification.mismatch.effects.payload import Payload
from identification.mismatch.effects.payload_change import PayloadChange
from identification.mismatch.effects.position_dependent_friction import PositionDependentFriction
from identification.mismatch.effects.position_dependent_torque import PositionDependentTorque
from identification.mismatch.effects.presliding_hysteresis import PreslidingHysteresis
from identification.mismatch.effects.rotor_inertia import RotorInertia
from identification.mismatch.effects.stribeck_friction import StribeckFriction
from identification.mismatch.effects.structural_resonance import StructuralResonance
from identification.mismatch.effects.thermal_friction import ThermalFriction
from identification.mismatch.effects.torque_delay import TorqueDelay
from identification.mismatch.effects.torque_offset import TorqueOffset
from identification.mismatch.effects.torque_ripple import TorqueRipple
from identification.mismatch.effects.torque_sensor_drift import TorqueSensorDrift
from identification.mismatch.effects.torque_sensor_gain import TorqueSensorGain

EFFECTS: tuple[Effect, ...] = (
    TorqueOffset(),
    StribeckFriction(),
    TorqueSensorGain(),
    JointCrosstalk(),
    AsymmetricViscousFriction(),
    NonlinearViscousFriction(),
    LoadDependentFriction(),
    PositionDependentFriction(),
    PositionDependentTorque(),
    CableSpring(),
    TorqueRipple(),
    BaseTilt(),
    TorqueDelay(),
    PreslidingHysteresis(),
    BendingCrosstalk(),
    DistalRotorReaction(),
    JointElasticity(),
    BaseElasticity(),
    JointZeroOffset(),
    RotorInertia(),
    Payload(),
    StructuralResonance(),
    Backlash(),
    JointCoupling(),
    TorqueSensorDrift(),
    ThermalFriction(),
    PayloadChange(),
    ExternalContact(),
)
"""Every effect of the library, simplest first: of two that explain alike, the earlier one is reported."""


def effect_named(name: str) -> Effect:
    """The effect of that name (contract §7). Raises KeyError with the known names."""
    for effect in EFFECTS:
        if effect.name == name:
            return effect
    raise KeyError(f"no effect is named {name}; known are {', '.join(effect.name for effect in EFFECTS)}")


__all__ = ["EFFECTS", "Effect", "Estimate", "Place", "effect_named"]
