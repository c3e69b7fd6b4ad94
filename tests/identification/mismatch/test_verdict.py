"""Other names of a finding. Truth: which of two laws, one of them a special case of the other, made the recording."""

from __future__ import annotations

import numpy as np

from identification.base_parameters import BaseRegressor
from identification.mismatch.effects import EFFECTS, effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.names.verdict import alternatives
from identification.mismatch.problem import build_problem
from identification.mismatch.reduction import build_evidence
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member
from identification.mismatch.search.screening import build_screen
from identification.mismatch.search.trial import fitted
from identification.mismatch.settings import DiagnosisSettings
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
    trial = fitted(problem, [Member(rows, (0,))], settings)
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
