"""Forward simulation of identified arms under a controller, and its comparison with recordings (the paper's Fig. 4)."""

from __future__ import annotations

from identification.simulation.comparison import (
    Comparison,
    SampledMotion,
    compare_with_plan,
    compare_with_recording,
    inverse_dynamics,
)
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
    "Comparison",
    "ComputedTorque",
    "Controller",
    "ExtraTorque",
    "JointImpedance",
    "PositionLoop",
    "SampledMotion",
    "SetPoint",
    "SimulationResult",
    "SimulationSettings",
    "State",
    "compare_with_plan",
    "compare_with_recording",
    "controller_named",
    "inverse_dynamics",
    "motor_inertia_of",
    "simulate",
]
