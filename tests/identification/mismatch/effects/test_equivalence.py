"""Relations of effects and experiments that separate them. Truth: spaces built to be nested."""

from __future__ import annotations

import numpy as np
import pytest

from identification.mismatch.effects.equivalence import relation, separating_experiment


def space(*columns: int) -> np.ndarray:
    return np.linalg.qr(np.random.default_rng(3).normal(size=(50, 6)))[0][:, list(columns)]


def test_relations_of_spaces_are_found() -> None:
    turned = space(0, 1) @ np.array([[0.6, -0.8], [0.8, 0.6]])
    assert relation(space(0, 1), turned).kind == "identical"
    assert relation(space(1), space(0, 1)).kind == "first_in_second"
    assert relation(space(0, 1, 2), space(1)).kind == "second_in_first"
    shared = relation(space(0, 1), space(1, 2))
    assert (shared.kind, shared.cosine) == ("distinct", pytest.approx(1.0))
    assert relation(space(0), space(1)).cosine == pytest.approx(0.0, abs=1e-12)


def test_the_cosine_of_two_directions_is_that_of_their_angle() -> None:
    first, second = space(0), np.cos(0.3) * space(0) + np.sin(0.3) * space(1)
    assert relation(first, second).cosine == pytest.approx(np.cos(0.3))


def test_nothing_lies_in_everything() -> None:
    assert relation(space()[:, :0], space(0)).kind == "first_in_second"


def test_the_experiment_does_not_depend_on_the_order_of_the_names() -> None:
    names = ("stribeck_friction", "torque_delay", "presliding_hysteresis")
    assert separating_experiment(names) == separating_experiment(names[::-1])
    assert separating_experiment(()) is None
