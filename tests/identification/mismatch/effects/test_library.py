"""The library as a whole: the contract's names, words and numbers that fit, and robots of any kind."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.mismatch.effects import EFFECTS, Effect, Estimate, Place, effect_named
from identification.mismatch.effects.describe import harmonic, size
from identification.mismatch.motion import Motion
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel, robot_from_urdf
from tests.identification.mismatch.effects.motions import motion_of, random_links, shipped_motion, sliding_robot

# Contract, section 7.
NAMES = (
    "stribeck_friction",
    "presliding_hysteresis",
    "load_dependent_friction",
    "torque_offset",
    "asymmetric_viscous_friction",
    "nonlinear_viscous_friction",
    "thermal_friction",
    "position_dependent_friction",
    "position_dependent_torque",
    "joint_elasticity",
    "torque_ripple",
    "torque_sensor_gain",
    "bending_crosstalk",
    "joint_crosstalk",
    "cable_spring",
    "joint_zero_offset",
    "base_tilt",
    "base_elasticity",
    "distal_rotor_reaction",
    "rotor_inertia",
    "payload",
    "payload_change",
    "external_contact",
    "torque_sensor_drift",
    "torque_delay",
    "structural_resonance",
    "backlash",
    "joint_coupling",
)

REPEATABLE = [effect for effect in EFFECTS if effect.stage == "repeatable"]


@pytest.fixture(scope="module")
def motion(iiwa14: RobotModel) -> Motion:
    return shipped_motion(iiwa14, random_links(7, 2), rate_hz=50.0)


def middle_shape(effect: Effect, motion: Motion, place: Place) -> dict[str, float]:
    return {shape.name: shape.grid[len(shape.grid) // 2] for shape in effect.shape_parameters(motion, place)}


def test_every_effect_of_the_contract_is_in_the_library_once() -> None:
    assert sorted(effect.name for effect in EFFECTS) == sorted(NAMES)
    for effect in EFFECTS:
        assert effect_named(effect.name) is effect
        documentation = type(effect).__doc__ or ""
        assert all(told in documentation for told in ("Source:", "Usual:"))
        assert effect.separating_experiment.endswith(".")


def test_an_unknown_name_is_answered_with_the_known_ones() -> None:
    with pytest.raises(KeyError, match="stribeck_friction"):
        effect_named("stribeck")


@pytest.mark.parametrize("effect", REPEATABLE, ids=lambda effect: effect.name)
def test_columns_parameters_and_sentence_fit_together_at_every_place(effect: Effect, motion: Motion) -> None:
    places = effect.places(motion)
    assert places
    for place in places:
        shape = middle_shape(effect, motion, place)
        columns = effect.columns(motion, place, shape)
        if columns is None:
            continue
        assert columns.values.shape == (motion.samples, len(columns.joints), len(effect.units))
        assert np.isfinite(columns.values).all()
        m = len(effect.units)
        estimate = Estimate(place, shape, np.arange(1.0, m + 1.0), 0.01 * np.eye(m))
        parameters = effect.parameters(estimate)
        assert len({parameter.name for parameter in parameters}) == len(parameters)
        assert math.isfinite(parameters[0].value)
        assert parameters[0].std > 0.0
        sentence = effect.sentence(estimate)
        assert sentence.endswith((".", ")."))
        assert not re.search(r"\bnan\b", sentence)
        if place.joint is not None:
            assert f"joint {place.joint}" in sentence.lower()


def test_friction_that_is_not_in_proportion_to_the_load_says_at_which_load_it_is_given() -> None:
    """6 % of loads up to 60 Nm, fitted with a power, was said to be 3 % of "the load"."""
    effect, one = effect_named("load_dependent_friction"), np.ones((1, 1))
    straight, bent = (
        effect.sentence(Estimate(Place(2), {"power": power}, 0.03 * one[0], 1e-8 * one)) for power in (1.0, 1.33)
    )
    assert "by 3 ± 0.02 % of the load (" in straight
    assert "by 3 ± 0.02 % of the load at 10 Nm, with power 1.3 of the load (" in bent


@pytest.mark.parametrize("effect", REPEATABLE, ids=lambda effect: effect.name)
def test_grids_lie_within_the_bounds_of_their_refinement(effect: Effect, motion: Motion) -> None:
    for place in effect.places(motion):
        for shape in effect.shape_parameters(motion, place):
            assert shape.grid
            assert list(shape.grid) == sorted(shape.grid)
            assert shape.lower <= shape.grid[0] <= shape.grid[-1] <= shape.upper
            if shape.logarithmic:
                assert shape.lower > 0.0


@pytest.mark.parametrize("effect", REPEATABLE, ids=lambda effect: effect.name)
def test_every_effect_serves_a_robot_with_sliding_joints_and_without_periods(effect: Effect) -> None:
    robot = sliding_robot()
    motion = motion_of(robot, random_links(3, 2), rate_hz=50.0, periodic=False)
    for place in effect.places(motion):
        columns = effect.columns(motion, place, middle_shape(effect, motion, place))
        assert columns is None or np.isfinite(columns.values).all()
    sliding = {place.joint for place in effect.places(motion)} & {2}
    by_angle = {"torque_ripple", "position_dependent_torque", "position_dependent_friction", "bending_crosstalk"}
    if effect.name in by_angle:
        assert not sliding


def test_effects_of_friction_do_not_act_on_a_joint_that_stands_still(motion: Motion) -> None:
    held = [array.copy() for array in (motion.position, motion.velocity, motion.acceleration)]
    held[0][:, 4] = 0.7
    held[1][:, 4] = held[2][:, 4] = 0.0
    still = replace(motion, position=held[0], velocity=held[1], acceleration=held[2])
    acting = {
        effect.name
        for effect in REPEATABLE
        for place in effect.places(still)
        if place.joint == 5 and effect.columns(still, place, middle_shape(effect, still, place)) is not None
    }
    assert not acting & {name for name in NAMES if "friction" in name or name == "presliding_hysteresis"}
    assert "torque_offset" in acting


@given(a=st.floats(-5.0, 5.0), b=st.floats(-5.0, 5.0), x=st.floats(-3.0, 3.0))
def test_amplitude_and_phase_are_the_sine_and_cosine_again(a: float, b: float, x: float) -> None:
    amplitude, phase = harmonic(Estimate(Place(joint=1), {}, np.array([a, b]), np.eye(2)))
    assert amplitude.value * math.sin(x + phase.value) == pytest.approx(a * math.sin(x) + b * math.cos(x), abs=1e-12)


def test_deviations_of_amplitude_and_phase_are_those_of_many_draws() -> None:
    mean, covariance = np.array([0.8, -0.5]), np.array([[4e-4, 1e-4], [1e-4, 2e-4]])
    amplitude, phase = harmonic(Estimate(Place(joint=1), {}, mean, covariance))
    draws = np.random.default_rng(7).multivariate_normal(mean, covariance, 20_000)
    assert amplitude.std == pytest.approx(np.hypot(*draws.T).std(), rel=0.03)
    assert phase.std == pytest.approx(np.arctan2(draws[:, 1], draws[:, 0]).std(), rel=0.03)


def test_the_rest_position_of_a_spring_has_the_deviation_of_many_draws() -> None:
    mean, covariance = np.array([0.8, -0.5]), np.array([[4e-4, 1e-4], [1e-4, 2e-4]])
    rest = effect_named("cable_spring").parameters(Estimate(Place(joint=1), {}, mean, covariance))[1]
    draws = np.random.default_rng(8).multivariate_normal(mean, covariance, 20_000)
    assert rest.value == pytest.approx(0.625)
    assert rest.std == pytest.approx((-draws[:, 1] / draws[:, 0]).std(), rel=0.03)


def test_a_stiffness_has_the_relative_deviation_of_its_compliance() -> None:
    estimate = Estimate(Place(joint=2), {}, np.array([1e-4]), np.array([[4e-12]]))
    stiffness, compliance = effect_named("joint_elasticity").parameters(estimate)
    assert stiffness.value == pytest.approx(1e4)
    assert stiffness.std / stiffness.value == pytest.approx(compliance.std / compliance.value)


def test_a_base_that_yields_in_one_direction_says_so_and_none_drives_its_own_lean() -> None:
    effect, at_60 = effect_named("base_elasticity"), np.array([np.cos(np.radians(60.0)), np.sin(np.radians(60.0))])
    matrix = 2e-5 * np.outer(at_60, at_60)
    softest = Estimate(Place(), {"pivot_depth": 0.4}, matrix[[0, 1, 0], [0, 1, 1]], np.diag([1e-12, 1e-12, 1e-12]))
    stiffness, about_x, *_, depth = effect.parameters(softest)
    assert (depth.name, depth.value) == ("pivot_depth", 0.4)
    assert (stiffness.value, about_x.value) == (pytest.approx(5e4), pytest.approx(5e-6))
    draws = np.random.default_rng(3).multivariate_normal(softest.coefficients, softest.covariance, 20_000)
    moved = np.linalg.eigvalsh(draws[:, [0, 2, 2, 1]].reshape(-1, 2, 2))[:, 1]
    assert stiffness.std / stiffness.value == pytest.approx(moved.std() / moved.mean(), rel=0.05)
    assert (
        "at 60° from the base's first level axis (x of an upright base), where it is softest, across it no"
        in effect.sentence(softest)
    )
    assert not effect.is_impossible(softest.coefficients)
    assert effect.is_impossible(-softest.coefficients)
    assert effect.is_impossible(np.array([0.0, 0.0, 1e-5]))


def test_no_motor_has_an_inertia_below_zero() -> None:
    """A hose with hysteresis was told as -0.0103 +- 0.003 kg m2 of a motor."""
    effect = effect_named("rotor_inertia")
    assert effect.is_impossible(np.array([-0.0103]))
    assert not effect.is_impossible(np.array([0.0103]))


def test_a_sensor_that_reads_the_other_way_round_has_no_error_of_its_gain() -> None:
    effect = effect_named("torque_sensor_gain")
    assert effect.is_impossible(np.array([-2.11]))
    assert not effect.is_impossible(np.array([-0.9]))


def test_a_tenth_of_a_torque_that_is_60_ms_late_is_no_delay() -> None:
    """Sound arm of another simulator, all friction turning over by tanh: 0.109 +- 0.012 of it seemed 60 ms late."""
    effect = effect_named("torque_delay")
    assert effect.is_impossible(np.array([0.109]), np.array([0.012]))
    assert not effect.is_impossible(np.array([0.9]), np.array([0.01]))
    # Of a short delay only c d shows, and c is not known.
    assert not effect.is_impossible(np.array([-4.4]), np.array([16.0]))
    early = Estimate(Place(joint=4), {"delay": 3e-4, "lag": 0.0}, np.array([-4.4]), np.array([[256.0]]))
    assert "early against its position by 1.32" in effect.sentence(early)


def test_sizes_are_written_with_their_interval_where_it_is_known() -> None:
    assert size(0.3141, 0.0102, "Nm") == "0.314 ± 0.02 Nm"
    assert size(0.3141, math.nan, "Nm") == "0.314 Nm"


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [(7684.2, 48.7, "7680 ± 100 u"), (0.3141, 0.011, "0.314 ± 0.02 u"), (1.3e-5, 2e-7, "1.3e-05 ± 4e-07 u")],
)
def test_sentences_have_no_exponents_in_numbers_of_ordinary_size(value: float, std: float, text: str) -> None:
    assert size(value, std, "u") == text


def test_no_mode_is_sought_beyond_what_is_compared(motion: Motion) -> None:
    resonance, place = effect_named("structural_resonance"), Place(joint=2)
    frequency = resonance.shape_parameters(replace(motion, compared_hz=10.0), place)[0]
    assert frequency.upper == 10.0
    assert max(frequency.grid) < 10.0


def test_an_arm_that_loads_its_base_with_no_moment_makes_it_lean_nowhere() -> None:
    lift = robot_from_urdf(
        '<robot name="lift"><link name="base"/><link name="a"/><joint name="1" type="prismatic"><axis xyz="0 0 1"/>'
        '<parent link="base"/><child link="a"/><limit lower="-3" upper="3" velocity="9" effort="99"/></joint></robot>',
        source="lift.urdf",
    )
    body = PhysicalParameters(np.array([5.0]), np.zeros((1, 3)), np.zeros((1, 3, 3)), np.ones(1), np.ones(1))
    up_and_down = motion_of(lift, body)
    assert effect_named("base_elasticity").columns(up_and_down, Place(), {"pivot_depth": 0.4}) is None
