"""Claims about the functions of a class. Truth: functions written down here."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np
import pytest

from identification.mismatch.effects.dynamics import rigid_torque
from identification.mismatch.evidence import Evidence
from identification.mismatch.motion import Motion
from identification.mismatch.settings import FADE
from identification.mismatch.unknown.classes import CLASSES, Basis
from identification.mismatch.unknown.functions import fade, responses, stops
from identification.mismatch.unknown.inputs import Inputs, Ranges

FADE = 2.0 * FADE
NUMBER = {item.name: number for number, item in enumerate(CLASSES)}


def inputs_of(motion: Motion, fitted: Motion | None = None) -> Inputs:
    ranges = Ranges.of([fitted if fitted is not None else motion])
    return Inputs(motion, ranges, FADE, ranges)


def columns_of(name: str, joint: int, fitted: Inputs, there: Inputs) -> np.ndarray:
    found = []
    for group, functions in enumerate(CLASSES[NUMBER[name]].groups):
        basis = Basis.of(NUMBER[name], group, joint, [functions(fitted, joint)])
        found.append(basis.columns(there))
    return np.concatenate(found, axis=1)


@pytest.fixture(scope="module")
def motion(clean_evidence: Evidence) -> Motion:
    return clean_evidence.motion


@pytest.mark.parametrize(
    ("name", "function"),
    [
        ("own_position", lambda q, _, __: q + 0.4 * np.sin(1.5 * q)),
        ("own_velocity", lambda _, dq, __: np.abs(dq)),
        ("own_load", lambda _, __, tau: (tau / np.abs(tau).max()) ** 3),
        ("own_position_by_direction", lambda q, dq, _: q * np.sign(dq)),
        # A disc that rubs where it runs out: an eighth of the range wide.
        ("own_position_by_direction", lambda q, dq, _: np.exp(-(((q - np.median(q)) / 0.12) ** 2)) * np.sign(dq)),
    ],
)
def test_a_class_holds_a_function_of_what_it_depends_on(motion: Motion, name: str, function: object) -> None:
    joint = 3
    inputs = inputs_of(motion)
    beside = np.stack([np.ones(motion.samples), np.sign(motion.velocity[:, joint])], axis=1)
    columns = np.concatenate([columns_of(name, joint, inputs, inputs), beside], axis=1)
    wanted = function(motion.position[:, joint], motion.velocity[:, joint], motion.torque[:, joint])  # type: ignore[operator]
    weights, *_ = np.linalg.lstsq(columns, wanted, rcond=1e-8)
    assert np.std(wanted - columns @ weights) < 0.01 * np.std(wanted)


def test_a_load_whose_share_changes_with_the_angle_is_a_function_of_load_and_position(motion: Motion) -> None:
    """A gear's mesh: a wave over the angle that grows with the load; base columns hold the load itself."""
    inputs = inputs_of(motion)
    load = rigid_torque(motion).torque[:, 3]
    columns = np.column_stack([columns_of("own_load_by_position", 3, inputs, inputs), load, np.ones(motion.samples)])
    wanted = load * np.sin(8.0 * motion.position[:, 3])
    weights, *_ = np.linalg.lstsq(columns, wanted, rcond=1e-8)
    assert np.std(wanted - columns @ weights) < 0.1 * np.std(wanted)


def test_what_turns_with_two_joints_together_is_a_function_of_the_other_joint_s_motion(motion: Motion) -> None:
    """Dry friction of a shaft that two joints turn: the direction of their sum."""
    inputs = inputs_of(motion)
    columns = columns_of("other_motion", 5, inputs, inputs)
    wanted = np.sign(motion.velocity[:, 5] + motion.velocity[:, 4])
    weights, *_ = np.linalg.lstsq(columns, wanted - wanted.mean(), rcond=1e-8)
    assert np.std(wanted - columns @ weights) < 0.1 * np.std(wanted)


def test_a_bending_moment_counts_the_same_on_every_motion(motion: Motion) -> None:
    """What the motions at hand reached scales it, not what the one at hand does: a slow motion bends the joint less."""
    slower = replace(motion, velocity=0.0 * motion.velocity, acceleration=0.0 * motion.acceleration)
    for each in (motion, slower):
        inputs = inputs_of(each, motion)
        columns, _ = CLASSES[NUMBER["other_torques"]].groups[0](inputs, 3)
        assert columns[:, -2:] == pytest.approx(inputs.moments[:, 3] / inputs_of(motion).ranges.bending[3])


def test_one_joint_has_no_configuration_beside_its_own_position(motion: Motion) -> None:
    """The waves over the configuration of a lone joint are functions of its position: two names of one thing."""
    alone = replace(motion, position=motion.position[:, :1])
    assert Inputs(alone, Ranges.of([motion]), FADE).waves.shape == (motion.samples, 0)


def test_a_class_does_not_hold_a_function_of_another_joint(motion: Motion) -> None:
    inputs = inputs_of(motion)
    columns = columns_of("own_position", 3, inputs, inputs)
    wanted = np.sin(3.0 * motion.position[:, 1])
    weights, *_ = np.linalg.lstsq(columns, wanted, rcond=1e-8)
    assert np.std(wanted - columns @ weights) > 0.5 * np.std(wanted)


def test_unit_weights_give_a_mean_square_of_one_and_no_mean(motion: Motion) -> None:
    inputs = inputs_of(motion)
    for number, item in enumerate(CLASSES):
        for group, functions in enumerate(item.groups):
            columns = Basis.of(number, group, 2, [functions(inputs, 2)]).columns(inputs)
            assert np.mean(np.sum(columns**2, axis=1)) == pytest.approx(1.0)
            if item.name != "constant":
                assert columns.mean(axis=0) == pytest.approx(0.0, abs=1e-9)


def test_far_outside_the_fitted_range_every_class_of_the_position_is_zero(motion: Motion) -> None:
    fitted = inputs_of(motion)
    moved = replace(motion, position=motion.position + 2.0 * np.ptp(motion.position, axis=0))
    for name in ("own_position", "own_position_by_direction", "path_memory", "configuration"):
        assert np.all(columns_of(name, 1, fitted, inputs_of(moved, motion)) == 0.0)


def test_a_fade_is_one_within_and_falls_smoothly_to_zero() -> None:
    place = np.linspace(-2.0, 2.0, 401)
    values = fade(place, 0.5)
    assert np.all(values[np.abs(place) <= 1.0] == 1.0)
    assert np.all(values[np.abs(place) >= 1.5] == 0.0)
    assert np.abs(np.diff(values)).max() < 0.04


def test_stops_are_the_recursion_they_stand_for() -> None:
    path = np.sin(np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)) + 0.4 * np.sin(
        3.0 * np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    )
    widths = np.array([0.05, 0.3])
    state = np.zeros(2)
    walked = []
    for step in np.diff(np.concatenate([path[:1], path, path])):
        state = np.clip(state + step / widths, -1.0, 1.0)
        walked.append(state)
    assert stops(path, widths, periodic=True) == pytest.approx(np.array(walked[400:]), abs=1e-9)


def test_linear_dynamics_vanish_at_rest_and_are_one_column_of_a_wave() -> None:
    time = np.arange(1000) * 1e-3
    omega, natural = 2.0 * np.pi * 4.0, 2.0 * np.pi * 5.0
    arguments = {"lags_s": np.array([0.02]), "resonances_hz": np.array([5.0]), "damping": 0.1}
    assert responses(np.full(1000, 3.0), 1e-3, periodic=True, **arguments) == pytest.approx(0.0, abs=1e-9)
    found = responses(np.cos(omega * time), 1e-3, periodic=True, **arguments)
    transfer = (1j * omega) ** 2 / ((1j * omega) ** 2 + 0.2 * natural * 1j * omega + natural**2)
    assert found[:, 2] == pytest.approx(np.real(transfer * np.exp(1j * omega * time)), abs=1e-9)


def test_functions_of_the_state_are_freed_as_soon_as_nobody_needs_them(motion: Motion) -> None:
    """A function that called itself kept all products of a recording until the next collection, gigabytes later."""
    seen = inputs_of(motion)
    gc.collect()
    gc.disable()
    try:
        for functions in CLASSES[NUMBER["state"]].groups:
            functions(seen, 0)
        assert gc.collect() == 0
    finally:
        gc.enable()
