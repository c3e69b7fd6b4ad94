"""The maps of eq. (4). Truth: Pinocchio's inertias, a solid box integrated in closed form, and going back and forth."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.physical_parameters import PhysicalParameters

FROM_PINOCCHIO = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]


def random_physical(seed: int, n: int = 4) -> PhysicalParameters:
    generator = np.random.default_rng(seed)
    spread = generator.normal(size=(n, 3, 3)) * 0.1
    second_moment = spread @ spread.transpose(0, 2, 1) + 1e-3 * np.eye(3)
    inertia = np.trace(second_moment, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second_moment
    return PhysicalParameters(
        generator.uniform(0.1, 10.0, n),
        generator.uniform(-0.3, 0.3, (n, 3)),
        0.5 * (inertia + inertia.transpose(0, 2, 1)),
        generator.uniform(0.1, 2.0, n),
        generator.uniform(0.0, 2.0, n),
    )


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_dynamic_parameters_equal_pinocchios(seed: int) -> None:
    physical = random_physical(seed)
    for link in range(physical.n):
        inertia = pinocchio.Inertia(physical.mass[link], physical.center_of_mass[link], physical.inertia[link])
        expected = inertia.toDynamicParameters()[FROM_PINOCCHIO]
        np.testing.assert_allclose(physical.dynamic_parameters()[link], expected, rtol=1e-12, atol=1e-13)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_going_to_dynamic_parameters_and_back_changes_nothing(seed: int) -> None:
    physical = random_physical(seed)
    back = PhysicalParameters.from_dynamic_parameters(physical.dynamic_parameters(), physical.viscous, physical.coulomb)
    for name in ("mass", "center_of_mass", "inertia", "viscous", "coulomb"):
        np.testing.assert_allclose(getattr(back, name), getattr(physical, name), rtol=1e-12, atol=1e-12)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_a_link_made_of_matter_has_a_positive_pseudo_inertia(seed: int) -> None:
    assert np.linalg.eigvalsh(random_physical(seed).pseudo_inertia()).min() > 0.0


def test_signs_of_eq_4_with_a_point_mass() -> None:
    """A point mass at (x, y, z): XX = m (y² + z²), XY = −m x y."""
    point = PhysicalParameters(
        np.array([2.0]), np.array([[0.1, 0.2, 0.3]]), np.zeros((1, 3, 3)), np.zeros(1), np.zeros(1)
    )
    expected = [2.0, 0.2, 0.4, 0.6, 0.26, -0.04, -0.06, 0.2, -0.12, 0.1]
    np.testing.assert_allclose(point.dynamic_parameters()[0], expected, atol=1e-15)


def test_pseudo_inertia_of_a_box_is_its_second_moment() -> None:
    """∫ r rᵀ dm of a homogeneous box of edges a, b, c about its centre is m/12 · diag(a², b², c²)."""
    m, edges = 3.0, np.array([0.1, 0.2, 0.4])
    squares = m / 12.0 * edges**2
    box = PhysicalParameters(
        np.array([m]), np.zeros((1, 3)), np.diag(squares.sum() - squares)[None], np.zeros(1), np.zeros(1)
    )
    np.testing.assert_allclose(box.pseudo_inertia()[0], np.diag([*squares, m]), atol=1e-15)


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="center_of_mass"):
        PhysicalParameters(np.ones(2), np.zeros((3, 3)), np.zeros((2, 3, 3)), np.zeros(2), np.zeros(2))
    lopsided = np.zeros((1, 3, 3))
    lopsided[0, 0, 1] = 1.0
    with pytest.raises(ValueError, match="symmetric"):
        PhysicalParameters(np.ones(1), np.zeros((1, 3)), lopsided, np.zeros(1), np.zeros(1))
