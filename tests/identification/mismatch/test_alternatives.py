"""Other names of a finding. Truth: which of two laws, one of them a special case of the other, made the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.base_parameters import BaseRegressor
from identification.mismatch.effects import EFFECTS, effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.names.alternatives import alternatives, own_score
from identification.mismatch.problem import build_problem
from identification.mismatch.reduction import build_evidence
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member, refine, score_of
from identification.mismatch.search.screening import build_screen
from identification.mismatch.search.trial import fitted
from identification.mismatch.settings import ALTERNATIVE, DiagnosisSettings
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record


def other_names(recording: Recording, robot: RobotModel, regressor: BaseRegressor) -> set[tuple[str, int | None]]:
    """What a torque offset of joint 6 is also called, fitted alone."""
    (evidence,) = build_evidence(recording, robot, regressor)
    problem, library, settings = build_problem([evidence]), Library(EFFECTS, [evidence]), DiagnosisSettings()
    rows = library.rows(effect_named("torque_offset"), Place(joint=6), ())
    assert rows is not None
    trial = fitted(problem, [Member(rows)], settings)
    screen = build_screen(problem, library.candidates()[0])
    return {(item.effect, item.joint) for item in alternatives(problem, trial, 0, screen, library, settings)}


def test_a_spring_is_another_name_of_an_offset_only_where_its_slope_shows(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """Noise alone shows a slope in one of twenty recordings, so one of three may be such a one."""

    def names(stiffness: float, seed: int) -> set[tuple[str, int | None]]:
        def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
            del dq, torque
            return on_joint(6, 0.3 + stiffness * q[:, 5])

        return other_names(record(iiwa14, table3, hidden, seed=seed), iiwa14, iiwa14_base)

    spring = ("cable_spring", 6)
    assert sum(spring in names(0.0, seed) for seed in (1, 2, 3)) <= 1
    assert all(spring in names(0.05, seed) for seed in (1, 2))


def test_what_is_a_hundred_times_less_likely_is_no_other_name_and_the_truth_is_never_that_unlikely(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """Friction with the square of speed against Stribeck friction. Twelve noises: were the odds wrong, the true name
    would be missing beside the other one; were more asked of them, the other one would stand beside the true one.
    """
    true, other = ("nonlinear_viscous_friction", 4), ("stribeck_friction", 4)
    alone = 0
    for size, seed in [(size, seed) for size in (0.12, 0.25) for seed in range(1, 7)]:

        def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray, size: float = size) -> np.ndarray:
            del q, torque
            return on_joint(4, size * dq[:, 3] * np.abs(dq[:, 3]))

        (evidence,) = build_evidence(record(iiwa14, table3, hidden, seed=seed), iiwa14, iiwa14_base)
        problem, library, settings = build_problem([evidence]), Library(EFFECTS, [evidence]), DiagnosisSettings()
        screen = build_screen(problem, library.candidates()[0])
        members, names = [], []
        for (effect, joint), shape in ((true, {"exponent": 2.0}), (other, {"stribeck_velocity": 0.3, "exponent": 2.0})):
            rows = library.rows(effect_named(effect), Place(joint=joint), tuple(shape.items()))
            assert rows is not None
            members.append(refine(problem, library, Member(rows)))
            trial = fitted(problem, members[-1:], settings)
            found = alternatives(problem, trial, 0, screen, library, settings)
            names.append({(item.effect, item.joint) for item in found})
        behind = score_of(problem, members[0]) - score_of(problem, members[1])
        assert true in names[1]
        assert other not in names[0] or behind < np.log(100.0)
        assert other in names[0] or behind > 0.99 * np.log(100.0)
        alone += not names[0] and behind < 10.0
    assert alone >= 2


def test_beside_an_unknown_torque_a_coefficient_more_has_to_earn_its_cost(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """An offset beside a torque without a form, and the same with a column of nothing: noise of no motion."""

    def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        del dq, torque
        return on_joint(6, 1.0 + 0.4 * np.sin(5.0 * q[:, 0] + 3.0 * q[:, 3]))

    (evidence,) = build_evidence(record(iiwa14, table3, hidden, seed=1), iiwa14, iiwa14_base)
    # Of a noise that is not measured nobody knows how much of the torque it is.
    problem = replace(build_problem([evidence]), noise_is_measured=False)
    library, settings = Library(EFFECTS, [evidence]), DiagnosisSettings()
    rows = library.rows(effect_named("torque_offset"), Place(joint=6), ())
    assert rows is not None
    for seed in range(4):
        nothing = np.random.default_rng(seed).standard_normal(rows.rows.shape)
        wider = replace(rows, rows=np.concatenate([rows.rows, nothing], axis=2))
        plain, more = Member(rows), Member(wider)
        trial = fitted(problem, [plain], settings)
        assert not trial.complete
        rest = fitted(problem, [], settings)
        scores = [own_score(problem, trial, rest, [], member, settings) for member in (plain, more)]
        gained = scores[1] - scores[0]
        # A column more lowers no likelihood, but for where misfit is located anew; half the square of a normal deviate
        # lies beyond 3 in one of seventy.
        assert -ALTERNATIVE - 0.5 <= gained < 0.0
