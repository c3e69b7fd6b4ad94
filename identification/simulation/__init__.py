"""Forward simulation of identified arms under a controller, and its comparison with recordings (the paper's Fig. 4)."""

from __future__ import annotations

from identification.simulation.controllers import (
    CONTROLLERS,
    ComputedTorque,
    Controller,
    JointImpedance,
    PositionLoop,
    SetPoint,
    State,
    controller_named,
)
from identification.simulation.dynamics import ExtraTorque
from identification.simulation.motor_inertia import motor_inertia_of
from identification.simulation.simulate import CommandedMotion, SimulationResult, SimulationSettings, simulate

__all__ = [
    "CONTROLLERS",
    "CommandedMotion",
    "ComputedTorque",
    "Controller",
    "ExtraTorque",
    "JointImpedance",
    "PositionLoop",
    "SetPoint",
    "SimulationResult",
    "SimulationSettings",
    "State",
    "controller_named",
    "motor_inertia_of",
    "simulate",
]
