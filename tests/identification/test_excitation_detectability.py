"""Claims about the objective that asks for visible effects; truth: the effect library, least squares, differences."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from identification.base_parameters import BaseRegressor
from identification.errors import DesignError
from identification.excitation import ExcitationLimits, default_trajectory, limits_of_robot
from identification.excitation.design import design_excitation
from identification.excitation.detectability_term import DetectabilityTerm, Measure, bounded_condition
from identification.excitation.effect_columns import ORDER, PLAUSIBLE_SIZES, STRIBECK_VELOCITY, evaluate_columns
from identification.excitation.effect_report import effects_shown
from identification.excitation.local_search import DesignSettings, Stage
from identification.excitation.nominal import TorqueLimit, foreseen_torque, nominal_parameters, searched_base_values
from identification.excitation.objective import BaseMatrix, FourierObjective, Samples, terms_of
from identification.excitation.prediction import NoiseColour, torque_noise
from identification.mismatch.effects import effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.motion import Motion
from identification.robots import RobotModel, load_robot

FloatArray = npt.NDArray[np.float64]

RUN_SAMPLES = 160_000.0
SHAPES = {
    "stribeck_friction": {"stribeck_velocity": STRIBECK_VELOCITY, "exponent": 2.0},
    "nonlinear_viscous_friction": {"exponent": 2.0},
    "position_dependent_torque": {"order": ORDER},
}


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("iiwa14")


@pytest.fixture(scope="module")
def values(robot: RobotModel) -> FloatArray:
    nominal = nominal_parameters(robot)
    assert nominal is not None
    return searched_base_values(robot, nominal)


@pytest.fixture(scope="module")
def term(robot: RobotModel, values: FloatArray) -> DetectabilityTerm:
    return DetectabilityTerm.of_robot(robot.kinematics, values, torque_noise(robot), RUN_SAMPLES)


def _samples(robot: RobotModel, count: int, width: float) -> Samples:
    motion = default_trajectory().evaluate(np.arange(count) * (10.0 / count))
    return BaseMatrix(robot).samples(*motion, width)


def test_every_column_is_the_effect_librarys_away_from_reversals(robot: RobotModel, term: DetectabilityTerm) -> None:
    samples = _samples(robot, 400, 1e-6)
    torque = samples.matrix @ term.values
    ours = evaluate_columns(term.where, samples, torque)[0]
    motion = Motion(
        robot, np.arange(400, dtype=np.float64) * 0.025, samples.position, samples.velocity, np.zeros_like(torque),
        torque, np.zeros(0), True, np.zeros(1),
    )  # fmt: skip
    moving = np.abs(samples.velocity) > 1e-4
    index = 0
    while index < len(term.where):
        where = term.where[index]
        crosstalk = where.source != where.joint
        place = Place(where.joint + 1, other_joint=where.source + 1 if crosstalk else None)
        theirs = effect_named(where.effect).columns(motion, place, SHAPES.get(where.effect, {}))
        assert theirs is not None
        assert theirs.joints == (where.joint,)
        width = 1 if where.effect == "cable_spring" else theirs.values.shape[2]
        rows = moving[:, where.joint]
        np.testing.assert_allclose(
            ours[rows, index : index + width],
            PLAUSIBLE_SIZES[where.effect] * theirs.values[rows, 0, :width],
            atol=1e-9,
        )
        index += width


def test_strength_is_what_least_squares_leaves_of_an_effect(robot: RobotModel, term: DetectabilityTerm) -> None:
    samples = _samples(robot, 64, 0.02)
    columns = evaluate_columns(term.where, samples, samples.matrix @ term.values)[0]
    scale = np.sqrt(RUN_SAMPLES / 64) / term.noise_nm
    known = (samples.matrix * scale[:, None]).reshape(-1, 57)

    def row_of(index: int) -> FloatArray:
        spread = np.zeros((64, 7))
        spread[:, term.where[index].joint] = columns[:, index] * scale[term.where[index].joint]
        return spread.ravel()

    strengths = term.strengths(samples)
    single = [k for k, measure in enumerate(term.measures) if len(measure.own) == 1]
    for k in single[::9]:
        measure = term.measures[k]
        explained = np.column_stack([known, *(row_of(i) for i in measure.other)])
        left = row_of(measure.own[0])
        left = left - explained @ np.linalg.lstsq(explained, left, rcond=None)[0]
        assert strengths[k] == pytest.approx(left @ left, rel=1e-6)
    beside = [k for k in single if term.measures[k].other]
    alone = {measure.own: strengths[k] for k, measure in enumerate(term.measures) if not measure.other}
    assert all(strengths[k] <= alone[term.measures[k].own] * (1.0 + 1e-9) for k in beside)


def test_gradient_in_the_coefficients_equals_finite_differences(
    robot: RobotModel,
    values: FloatArray,
    term: DetectabilityTerm,
) -> None:
    # Torque limits below what the motion needs and a condition number above its bound: every term is at work.
    tight = TorqueLimit(values, np.full(7, 10.0))
    mix = terms_of("cond:0.5,d:2,detectability:0.7", term.noise_nm, {"detectability": term})
    objective = FourierObjective(BaseMatrix(robot), (*mix, bounded_condition, tight), 0.1, 5, 64)
    generator = np.random.default_rng(4)
    coefficients, offset = 0.3 * generator.normal(size=(7, 10)), 0.2 * generator.normal(size=7)
    _, gradient, by_offset = objective(coefficients, offset)
    step = 1e-6
    for _ in range(4):
        direction, shift = generator.normal(size=(7, 10)), generator.normal(size=7)
        ahead = objective(coefficients + step * direction, offset + step * shift)[0]
        behind = objective(coefficients - step * direction, offset - step * shift)[0]
        exact = np.sum(gradient * direction) + np.sum(by_offset * shift)
        assert exact == pytest.approx((ahead - behind) / (2 * step), rel=1e-4)


def test_what_no_trial_motion_shows_is_left_out(term: DetectabilityTerm) -> None:
    measures = (Measure((0,)), Measure((1,)), Measure((2,)))
    small = DetectabilityTerm(term.values, term.noise_nm, term.run_samples, term.where, measures)
    assert small.reachable([np.array([0.1, 0.5, 9.0]), np.array([3.0, 0.2, 9.0])]).measures == measures[::2]


def test_the_search_sees_what_the_report_promises(robot: RobotModel, term: DetectabilityTerm) -> None:
    nominal = nominal_parameters(robot)
    assert nominal is not None
    report = effects_shown(BaseRegressor(robot), default_trajectory(), nominal, term.noise_nm, 16, NoiseColour(0.0))
    strengths = term.strengths(_samples(robot, 1000, 0.002))
    for measure, strength in zip(term.measures, strengths, strict=True):
        where = term.where[measure.own[0]]
        # The report has the band up to 60 Hz; reversals reach above it.
        if not measure.other and where.effect != "stribeck_friction":
            (same,) = (
                item
                for item in report
                if (item.effect, item.joint, item.other_joint or item.joint)
                == (where.effect, where.joint + 1, where.source + 1)
            )
            assert same.strength == pytest.approx(strength, rel=0.15)
            assert same.smallest_oracle * np.sqrt(same.strength) == pytest.approx(same.size * np.sqrt(24.0))


QUICK = DesignSettings(seed=3, starts=1, processes=1, samples=24, harmonics=3, stages=(Stage(1.0, 15, 0.9),))


def test_a_design_for_effects_shows_the_worst_of_them_better_than_one_for_conditioning(
    robot: RobotModel, term: DetectabilityTerm
) -> None:
    worst = {}
    for objective in ("cond", "detectability"):
        # After 15 iterations both searches are still on their way; what they show then is the start's more than theirs.
        settings = replace(
            QUICK, objective=objective, noise_nm=tuple(term.noise_nm.tolist()), stages=(Stage(1.0, 30, 0.9),)
        )
        found = design_excitation(robot, limits_of_robot(robot), settings, nominal=nominal_parameters(robot))
        motion = found.trajectory.evaluate(np.arange(400) * 0.025)
        worst[objective] = float(term.strengths(BaseMatrix(robot).samples(*motion, 0.005)).min())
    assert worst["detectability"] > worst["cond"]


def test_torque_stays_below_its_limit_at_every_millisecond(robot: RobotModel) -> None:
    nominal = nominal_parameters(robot)
    assert nominal is not None
    torque = foreseen_torque(BaseRegressor(robot), nominal)

    def peak(limits: ExcitationLimits) -> FloatArray:
        found = design_excitation(robot, limits, replace(QUICK, limits="true"), nominal=nominal)
        return np.asarray(np.max(np.abs(torque(*found.trajectory.evaluate(np.arange(10_000) * 1e-3))), axis=0))

    limits = limits_of_robot(robot)
    # A tenth less on joint 2 than it takes when it may: the limit binds, and the search has to turn away from it.
    tight = limits.torque_nm.copy()
    tight[1] = 0.9 * peak(limits)[1]
    assert peak(replace(limits, torque=tight))[1] <= tight[1]


def test_noise_weights_say_which_joints_d_optimality_may_trust(robot: RobotModel) -> None:
    base = BaseMatrix(robot)
    motion = _samples(robot, 50, 0.02)
    noise = np.array([0.2, 0.1, 0.3, 0.1, 0.08, 0.05, 0.03])
    (weighted,) = terms_of("d", noise)
    stacked = (motion.matrix / noise[:, None]).reshape(-1, base.size)
    assert weighted(motion)[0] == pytest.approx(-np.linalg.slogdet(stacked.T @ stacked)[1], rel=1e-9)
    (plain,) = terms_of("cond", noise)
    assert np.exp(plain(motion)[0]) == pytest.approx(np.linalg.cond(motion.matrix.reshape(-1, base.size)), rel=1e-6)


def test_detectability_without_noise_or_prior_is_refused(robot: RobotModel) -> None:
    with pytest.raises(DesignError, match="prior"):
        design_excitation(robot, limits_of_robot(robot), DesignSettings(objective="detectability", starts=1))


def test_the_prior_of_a_urdf_is_what_the_urdf_states(tmp_path: Path) -> None:
    file = tmp_path / "sled.urdf"
    file.write_text(
        """<robot name="sled"><link name="base"/><link name="sled"><inertial><origin xyz="0.1 0 0"/><mass value="3"/>
        <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.3"/></inertial></link>
        <joint name="slide" type="prismatic"><parent link="base"/><child link="sled"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" velocity="2" effort="50"/></joint></robot>""",
        encoding="utf-8",
    )
    robot = load_robot(file)
    nominal = nominal_parameters(robot)
    assert nominal is not None
    torque = foreseen_torque(BaseRegressor(robot), nominal)
    # A mass of 3 kg lifted with 2 m/s².
    lifted = torque(np.array([[0.2]]), np.array([[0.0]]), np.array([[2.0]]))
    assert lifted[0, 0] == pytest.approx(3.0 * 11.81)
    assert limits_of_robot(robot).torque_nm[0] == 50.0
