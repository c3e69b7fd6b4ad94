"""How much of each effect a fit of the nominal model hides, what size still shows, and which effects look alike.

Reproduce: `OPENBLAS_NUM_THREADS=1 python -m benchmarks.absorbed` ; `--trajectories 1` for the shipped one alone.
Effects stand at the middle of their grids. Absorbed: share of the energy in the whitened rows 0 to 60 Hz that the 57
base parameters take up, median [smallest .. largest] over joints and excitations, beside the figures of the prototype's
four excitations. Smallest: the size whose rest has λ = 24 with 16 periods and the noise below, best joint to worst.
"""

from __future__ import annotations

import argparse
import math
import time
from itertools import product

import numpy as np
import numpy.typing as npt

from fixtures.physics.links import iiwa14_table_three
from identification.base_parameters import BaseRegressor
from identification.excitation import Trajectory, default_trajectory, limits_of_robot
from identification.excitation.reference import reference_trajectory
from identification.mismatch.detectability import Candidate, candidates, confusable, planned_rows
from identification.mismatch.effects import EFFECTS
from identification.mismatch.motion import Motion
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel, load_robot

NOISE_NM = np.array([0.17, 0.17, 0.12, 0.12, 0.08, 0.05, 0.04])
PERIODS = 16
PROTOTYPE = {
    "stribeck_friction": "28 [2..46]",
    "presliding_hysteresis": "39 [10..79]",
    "load_dependent_friction": "73 [53..90]",
    "torque_offset": "47 [0..99.8]",
    "asymmetric_viscous_friction": "48 [9..89]",
    "nonlinear_viscous_friction": "97 [93..98]",
    "position_dependent_friction": "65 [13..99.8]",
    "position_dependent_torque": "45 [6..95]",
    "joint_elasticity": "66 [43..98]",
    "torque_ripple": "1 [0..7]",
    "torque_sensor_gain": "87 [50..99.6]",
    "bending_crosstalk": "62 [33..84]",
    "joint_crosstalk": "53 [14..85]",
    "cable_spring": "47 [7..99.9]",
    "joint_zero_offset": "99.6 [75..100]",
    "base_tilt": "83 [55..90]",
    "distal_rotor_reaction": "72 [58..86]",
    "payload": "100",
    "torque_delay": "26 [1..97]",
}


def main() -> None:
    """Parse, compute, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trajectories", type=int, default=4, help="1: the shipped excitation; more: random ones too")
    parser.add_argument("--cosine", type=float, default=0.9)
    arguments = parser.parse_args()
    robot = load_robot("iiwa14")
    regressor = BaseRegressor(robot)
    motions = [motion_on(robot, regressor, trajectory) for trajectory in excitations(robot, arguments.trajectories)]
    found = [candidates([planned_rows(motion, regressor, NOISE_NM, periods=PERIODS)]) for motion in motions]
    absorbed(found)
    look_alikes(found[0], arguments.cosine)
    cost(motions[0])


def excitations(robot: RobotModel, count: int) -> list[Trajectory]:
    """The shipped one, then random sums of sines."""
    limits = limits_of_robot(robot)
    others = [reference_trajectory("sine_series", limits, seed, robot=robot) for seed in range(count - 1)]
    return [default_trajectory("iiwa14"), *others]


def motion_on(robot: RobotModel, regressor: BaseRegressor, trajectory: Trajectory) -> Motion:
    """One period at 1 kHz of an arm with the links of Table 3."""
    links = iiwa14_table_three()
    full = regressor.full_from_physical(
        PhysicalParameters(links.mass, links.center_of_mass, links.inertia, links.viscous, links.coulomb)
    )
    when = np.arange(round(trajectory.period_s * 1000.0)) / 1000.0
    states = trajectory.evaluate(when)
    torque = regressor.matrix(*states) @ regressor.base_from_full(full)
    return Motion(robot, when, *states, torque, full, True, np.zeros(1))


def absorbed(found: list[tuple[Candidate, ...]]) -> None:
    """The table."""
    print(f"{'effect':30s}{'absorbed %':>24s}{'prototype':>16s}   smallest size that shows (λ = 24)")
    for effect in EFFECTS:
        single = [
            item
            for candidate_set in found
            for item in candidate_set
            if item.effect is effect and not (effect.name == "torque_sensor_gain" and item.place.joint is None)
        ]
        if not single:
            continue
        shares = 100.0 * np.array([item.absorbed_fraction for item in single])
        sizes = [item.smallest() for item in single if item.identifiable]
        text = "nothing shows"
        if sizes:
            values = sorted((size.value for size in sizes), reverse=effect.name == "joint_elasticity")
            text = f"{values[0]:.2g} .. {values[-1]:.2g} {sizes[0].unit} ({sizes[0].name})"
        print(f"{effect.name:30s}{summary(shares):>24s}{PROTOTYPE.get(effect.name, ''):>16s}   {text}")
    common = [item for candidate_set in found for item in candidate_set if item.effect.name == "torque_sensor_gain"]
    shares = 100.0 * np.array([item.absorbed_fraction for item in common if item.place.joint is None])
    print(f"{'the same gain on all joints':30s}{summary(shares):>24s}{'100':>16s}")


def summary(shares: npt.NDArray[np.float64]) -> str:
    """Median [smallest .. largest], in per cent."""
    return f"{np.median(shares):.1f} [{shares.min():.1f} .. {shares.max():.2f}]"


def look_alikes(found: tuple[Candidate, ...], cosine: float) -> None:
    """Pairs on the shipped excitation."""
    print(f"\nlook alike on the shipped excitation (cosine of the rests from {cosine}):")
    for pair in confusable(found, cosine):
        first, second = (
            f"{item.effect.name}({item.place.joint or item.place.link or 'all'}"
            + (f" from {item.place.other_joint})" if item.place.other_joint else ")")
            for item in (pair.first, pair.second)
        )
        print(f"  {first:40s}{second:40s}{pair.relation.cosine:.4f}  {pair.relation.kind.replace('_', ' ')}")


def cost(motion: Motion) -> None:
    """Seconds for all columns of all repeatable effects at all places and grid points."""
    count, start = 0, time.perf_counter()
    for effect in EFFECTS:
        if effect.stage != "repeatable":
            continue
        for place in effect.places(motion):
            shapes = effect.shape_parameters(motion, place)
            for values in product(*(shape.grid for shape in shapes)):
                effect.columns(motion, place, {shape.name: value for shape, value in zip(shapes, values, strict=True)})
                count += 1
    seconds = time.perf_counter() - start
    rate = math.ceil(motion.samples / 1000)
    print(
        f"\n{count} candidates (grids included) on {rate} thousand samples: {seconds:.2f} s (dynamics kept from above)"
    )


if __name__ == "__main__":
    main()
