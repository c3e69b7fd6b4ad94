"""Which columns of a candidate are asked of together. Truth: what a stand may be, written here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.mismatch.effects import effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.evidence import Evidence
from identification.mismatch.problem import build_problem
from identification.mismatch.search.library import Library
from identification.mismatch.search.screening import build_screen, gains


def test_a_stand_may_lean_at_rest_besides_but_one_that_only_leans_at_rest_is_none(clean_evidence: Evidence) -> None:
    effect = effect_named("base_elasticity")
    rows = Library((effect,), (clean_evidence,)).rows(effect, Place(), (("pivot_depth", 0.4),))
    assert rows is not None
    problem = build_problem([clean_evidence])
    noisy = replace(problem, residual=problem.residual + np.random.default_rng(5).normal(size=problem.residual.size))
    free = replace(rows, cost=-100.0)
    found = {variant.selection for _, variant in gains(build_screen(noisy, [free]))}
    assert found == {(0, 1, 2, 3, 4), (0, 1, 2), (0,), (1,), (2,)}
