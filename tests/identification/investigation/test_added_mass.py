"""Claims about a known mass on the flange. Truth: MuJoCo's inverse dynamics of an arm with a point mass merged in."""

from __future__ import annotations

import numpy as np
import pytest

from fixtures.cases.arm import Arm, random_links
from fixtures.cases.excitation import excitation_of
from identification.base_parameters import BaseRegressor
from identification.excitation import default_trajectory
from identification.investigation.added_mass import AddedMass
from identification.investigation.columns import (
    PLAN_RATE_HZ,
    Form,
    NoiseLevel,
    form_rows,
    planned,
    states_of_table,
    sums_of,
)
from identification.mismatch.effects.base import Place
from identification.mismatch.evidence import PlannedRows
from identification.mismatch.motion import Motion
from identification.robots import RobotModel

MASS = AddedMass(2.0, (0.03, -0.02, 0.05))
FLANGE_M = 0.126


def test_the_torque_of_the_mass_is_mujocos() -> None:
    from identification.robots import load_robot

    robot = load_robot("iiwa14")
    motion = excitation_of("", default_trajectory().table()[::10])
    q, dq, ddq = (part[::50] for part in default_trajectory().evaluate(motion.time * 10.0))
    arm = Arm(random_links(np.random.default_rng(2)))
    # The flange is turned by half a turn about the last link's z.
    heavier = arm.with_point_mass(MASS.mass_kg, np.array([-0.03, 0.02, FLANGE_M + 0.05]))
    truth = heavier.inverse_dynamics(q, dq, ddq) - arm.inverse_dynamics(q, dq, ddq)
    np.testing.assert_allclose(MASS.torque(robot, q, dq, ddq), truth, atol=1e-9)


@pytest.mark.parametrize("text", ["2.0", "2.0@0,0", "-1@0,0,0", "a@0,0,0", "nan@0,0,0"])
def test_what_is_no_mass_is_refused(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - whatever float() says
        AddedMass.parse(text)


def test_a_gain_common_to_all_sensors_shows_beside_a_known_mass_and_only_then(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor
) -> None:
    """No motion tells a common gain from heavier links; a recording with the mass beside one without it does."""
    trajectory = default_trajectory()
    states = states_of_table(trajectory.table(PLAN_RATE_HZ), trajectory.period_s)
    values = np.random.default_rng(4).normal(size=iiwa14_base.size)
    frequency = np.arange(301) / trajectory.period_s
    noise = NoiseLevel(frequency, np.full((301, 7), 0.05), np.zeros((301, 7)), 1000.0)
    full = np.zeros(len(iiwa14_base.full_names))
    like = Motion(iiwa14, np.arange(2) * 1e-3, *(part[:2] for part in states), states[0][:2], full, True, np.zeros(1))
    rows = planned(states, trajectory.period_s, like, iiwa14_base, values, noise, 4)
    gain = Form.of("torque_sensor_gain", Place(None), shape_of_common_gain(rows))
    alone = sums_of(rows, [gain])
    loaded = sums_of(PlannedRows(MASS.carried(rows.motion), rows.project, rows.nominal, rows.noise), [gain])
    whole = float(np.sum((form_rows(rows, gain) / rows.noise[..., None]) ** 2))
    assert float(alone.projected()[0, 0]) < 1e-9 * whole
    assert float((alone + loaded).projected()[0, 0]) > 1e-6 * whole


def shape_of_common_gain(rows: PlannedRows) -> dict[str, float]:
    from identification.mismatch.effects import effect_named

    parameters = effect_named("torque_sensor_gain").shape_parameters(rows.motion, Place(None))
    return {item.name: item.textbook if item.textbook is not None else item.grid[0] for item in parameters}
