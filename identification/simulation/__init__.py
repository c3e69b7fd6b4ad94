"""Forward simulation of identified arms under a controller, and its comparison with recordings (the paper's Fig. 4)."""

from __future__ import annotations

from identification.simulation.comparison import SampledMotion, compare_with_plan, compare_with_recording
from identification.simulation.controllers import (
    ComputedTorque,
    Controller,
    JointImpedance,
    PositionLoop,
    SetPoint,
    State,
    controller_named,
)
from identification.simulation.motor_inertia import motor_inertia_of
from identification.simulation.simulate import SimulationSettings, simulate

__all__ = [
    "ComputedTorque",
    "Controller",
    "JointImpedance",
    "PositionLoop",
    "SampledMotion",
    "SetPoint",
    "SimulationSettings",
    "State",
    "compare_with_plan",
    "compare_with_recording",
    "controller_named",
    "motor_inertia_of",
    "simulate",
]
