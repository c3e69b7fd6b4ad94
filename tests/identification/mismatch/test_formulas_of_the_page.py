"""Claims of docs/formats.md on the torque of a model.json. Truth: its formulas, written out here a second time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.linalg import eigh

from identification.errors import ModelFileError
from identification.mismatch.effects import EFFECTS
from identification.mismatch.motion import Motion
from identification.mismatch.prediction import effects_torque
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.inputs import Ranges
from identification.mismatch.unknown.model_terms import terms_torque
from identification.robots import RobotModel
from tests.identification.mismatch.effects.motions import (
    pinocchio_model,
    pinocchio_torque,
    random_links,
    shipped_motion,
)

FloatArray = npt.NDArray[np.float64]
PAGE = (Path(__file__).resolve().parents[3] / "docs" / "formats.md").read_text(encoding="utf-8")
LINKS = random_links(7, 11)
J, I = 3, 2  # noqa: E741  the page's joints, from 1


@pytest.fixture(scope="module")
def motion(iiwa14: RobotModel) -> Motion:
    return shipped_motion(iiwa14, LINKS, rate_hz=50.0)


def test_every_effect_its_shape_and_every_class_stands_on_the_page(motion: Motion) -> None:
    _, _, part = PAGE.partition("\n## The torque of a model.json\n")
    for effect in EFFECTS:
        assert f"| `{effect.name}` |" in part
        for shape in effect.shape_parameters(motion, effect.places(motion)[0]):
            if not shape.tied:
                assert shape.name in part, f"{effect.name}: {shape.name}"
    assert all(f"| `{item.name}` |" in part for item in CLASSES)


def wave(x: FloatArray, real: float, imaginary: float) -> npt.NDArray[np.complex128]:
    return np.exp(1j * x) + (real + 1j * imaginary) * np.exp(2j * x)


def through(values: FloatArray, step_s: float, response: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]) -> FloatArray:
    s = 2j * np.pi * np.fft.rfftfreq(len(values), step_s)
    return np.fft.irfft(np.fft.rfft(values) * response(s), len(values))


def sliding_state(q: FloatArray, distance: float) -> FloatArray:
    """dz/dq = (1 − σ z) / distance, twice around."""
    z, states = 0.0, []
    for step in np.tile(np.diff(np.append(q, q[0])), 2):
        states.append(z)
        sign = np.sign(step)
        z = sign + (z - sign) * np.exp(-abs(step) / distance) if step else z
    return np.array(states[len(q) :])


C = (0.7, -0.4, 0.05)
W = {"second_harmonic_real": 0.2, "second_harmonic_imaginary": -0.1}
CASES: dict[str, tuple[int, dict[str, float], Callable[..., FloatArray]]] = {
    "torque_offset": (1, {}, lambda c, q, **_: c[0] + 0.0 * q),
    "stribeck_friction": (
        1, {"stribeck_velocity": 0.05, "exponent": 1.3},
        lambda c, dq, **_: c[0] * np.exp(-((np.abs(dq) / 0.05) ** 1.3)) * np.sign(dq),
    ),
    "asymmetric_viscous_friction": (1, {}, lambda c, dq, **_: c[0] * np.abs(dq)),
    "nonlinear_viscous_friction": (
        1, {"exponent": 1.7}, lambda c, dq, **_: c[0] * np.sign(dq) * np.abs(dq) ** 1.7,
    ),
    "load_dependent_friction": (
        1, {"power": 0.8}, lambda c, dq, tau, **_: c[0] * 10.0 * (np.abs(tau) / 10.0) ** 0.8 * np.sign(dq),
    ),
    "position_dependent_friction": (
        2, W, lambda c, q, dq, **_: np.sign(dq) * (c[0] * wave(q, 0.2, -0.1).imag + c[1] * wave(q, 0.2, -0.1).real),
    ),
    "position_dependent_torque": (
        2, {"order": 3.0, **W},
        lambda c, q, **_: c[0] * wave(3 * q, 0.2, -0.1).imag + c[1] * wave(3 * q, 0.2, -0.1).real,
    ),
    "torque_ripple": (
        2, {"order": 160.3, "load_share": 0.3},
        lambda c, q, tau, **_: (c[0] * np.sin(160.3 * q) + c[1] * np.cos(160.3 * q))
        * (0.7 + 0.3 * np.abs(tau) / np.sqrt(np.mean(tau**2))),
    ),
    "cable_spring": (
        2, {"hardening": 0.3, "softest_at": 0.2}, lambda c, q, **_: c[0] * (q + 0.3 * (q - 0.2) ** 3) + c[1],
    ),
    "rotor_inertia": (1, {}, lambda c, ddq, **_: c[0] * ddq),
    "presliding_hysteresis": (
        1, {"distance": 0.01, "exponent": 1.0}, lambda c, q, dq, **_: c[0] * (sliding_state(q, 0.01) - np.sign(dq)),
    ),
    "torque_sensor_gain": (
        1, {"turning_cosine": 0.3, "turning_sine": -0.2},
        lambda c, q, tau, **_: c[0] * tau * (1 + 0.3 * np.cos(q) - 0.2 * np.sin(q)),
    ),
    "joint_crosstalk": (1, {}, lambda c, other, **_: c[0] * other),
    "torque_delay": (
        1, {"delay": 0.02, "lag": 0.0},
        lambda c, tau, **_: c[0] * through(tau, 0.02, lambda s: np.exp(-0.02 * s) - 1.0),
    ),
    "structural_resonance": (
        2, {"frequency": 8.0, "damping": 0.05},
        lambda c, tau, **_: through(
            tau, 0.02,
            lambda s: (c[0] * s**2 + c[1] * 16 * np.pi * s) / (s**2 + 1.6 * np.pi * s + (16 * np.pi) ** 2),
        ),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_an_effect_is_the_formula_of_the_page(motion: Motion, name: str) -> None:
    numbers, shape, formula = CASES[name]
    other = I if name == "joint_crosstalk" else None
    entry = {
        "effect": name, "joint": J, "link": None,
        "model": {"other_joint": other, "coefficients": C[:numbers], "shape": shape},
    }  # fmt: skip
    torque = effects_torque([entry], motion)[0]
    q, dq, ddq = (values[:, J - 1] for values in (motion.position, motion.velocity, motion.acceleration))
    expected = formula(C, q=q, dq=dq, ddq=ddq, tau=motion.torque[:, J - 1], other=motion.torque[:, I - 1])
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(torque[:, J - 1], expected, atol=1e-9 * np.abs(expected).max())
    assert not np.delete(torque, J - 1, axis=1).any()


def test_an_effect_with_another_number_of_coefficients_is_refused(motion: Motion) -> None:
    """A ValueError of NumPy came out."""
    shape = {"pivot_depth": 0.4}
    entry = {"effect": "base_elasticity", "joint": None, "link": None,
             "model": {"other_joint": None, "coefficients": 2 * [1e-5], "shape": shape}}  # fmt: skip
    with pytest.raises(ModelFileError, match="2 coefficients, and 3 are needed"):
        effects_torque([entry], motion)
    assert effects_torque([{**entry, "model": {**entry["model"], "coefficients": 3 * [1e-5]}}], motion).any()


def test_one_motor_on_two_joints_is_the_formula_of_the_page(motion: Motion) -> None:
    entry = {
        "effect": "joint_coupling", "joint": J, "link": None,
        "model": {"other_joint": I, "coefficients": C, "shape": {"ratio": -0.8}},
    }  # fmt: skip
    speed, growth = (rate[:, J - 1] - 0.8 * rate[:, I - 1] for rate in (motion.velocity, motion.acceleration))
    own = C[0] * np.sign(speed) + C[1] * speed + C[2] * growth
    torque = effects_torque([entry], motion)[0]
    np.testing.assert_allclose(torque[:, [J - 1, I - 1]], np.stack([own, -0.8 * own], axis=1), atol=1e-12)


def smooth(length: float, most: int, *trends: Callable[[FloatArray], FloatArray]) -> Callable[[FloatArray], FloatArray]:
    """S(length, most; trends) of the page, by another driver of LAPACK and a projector instead of a basis."""
    grid = np.linspace(-1.0, 1.0, 401)
    known = np.stack([trend(grid) for trend in trends], axis=1)
    without = np.eye(401) - known @ np.linalg.pinv(known)
    kernel = without @ np.exp(-((grid[:, None] - grid) ** 2) / (2.0 * length**2)) @ without
    values, vectors = eigh(kernel, driver="evr")
    kept = [k for k in range(400, 400 - most, -1) if values[k] > 1e-6 * values[-1]]
    table = [np.sign(vectors[-1, k]) * vectors[:, k] * np.sqrt(values[k]) for k in kept]
    return lambda x: np.stack([np.interp(x, grid, function) for function in table], axis=1)


def trends(speed: bool) -> tuple[Callable[[FloatArray], FloatArray], ...]:
    bent = (lambda y: np.sinh(0.5 * (1.0 + y) * np.arcsinh(25.0)) / 25.0) if speed else (lambda x: x)
    return np.ones_like, bent


def stop(path: FloatArray, width: float) -> FloatArray:
    state, states = 0.0, []
    for step in np.tile(np.diff(np.append(path, path[0])), 2):
        states.append(state)
        state = min(1.0, max(-1.0, state + step / width))
    return np.array(states[len(path) :])


def functions(name: str, group: int, x: FloatArray, v: FloatArray, l: FloatArray, s: FloatArray) -> FloatArray:  # noqa: E741
    """φ of the page, inputs (S, n)."""
    x, v, l = (np.clip(values, -1.0, 1.0) for values in (x, v, l))  # noqa: E741
    own, j = x[:, J - 1], J - 1
    u = np.abs(v[:, j])
    lags = np.geomspace(0.002, 0.2, 5)

    def of_speed(u: FloatArray) -> FloatArray:
        return smooth(0.3, 11, *trends(speed=True))(2.0 * np.arcsinh(25.0 * u) / np.arcsinh(25.0) - 1.0)

    match name, group:
        case "own_position", 0:
            return np.column_stack([own, smooth(0.5, 9, *trends(speed=False))(own)])
        case "own_position", 1:
            return smooth(0.125, 27, *trends(speed=False))(own)
        case "own_velocity", 0:
            return np.column_stack([of_speed(u), u])
        case "own_velocity", 1:
            return of_speed(u) * s[:, [j]]
        case "own_velocity", 2:
            return np.column_stack([
                through(each, 0.02, lambda p, lag=lag, poles=poles: p * lag / (1.0 + p * lag) ** poles)
                for each in (s[:, j], *(of_speed(u)[:, :4] * s[:, [j]]).T) for poles in (1, 2) for lag in lags
            ])  # fmt: skip
        case "own_velocity", 3:
            before = [u - through(u, 0.02, lambda p, lag=lag: p * lag / (1.0 + p * lag)) for lag in lags]
            return np.column_stack([(of_speed(each) - of_speed(u))[:, :4] * s[:, [j]] for each in before])
        case "own_load_by_direction", 0:
            return smooth(0.5, 7, np.ones_like)(l[:, j]) * s[:, [j]]
        case "own_load_by_position", 0:
            return np.stack([l[:, j] ** i * own**k for i in (1, 2, 3) for k in (1, 2, 3)], axis=1)
        case _:
            return np.stack([stop(own, width) for width in np.geomspace(0.001, 0.3, 8)], axis=1)


FADED_BY = {"own_position": "x", "path_memory": "x", "own_velocity": "v"}


@pytest.mark.parametrize(
    ("name", "group"),
    [
        ("own_position", 0), ("own_position", 1), ("own_velocity", 0), ("own_velocity", 1),
        ("own_velocity", 2), ("own_velocity", 3),
        ("own_load_by_direction", 0), ("own_load_by_position", 0), ("path_memory", 0), ("configuration", 0),
    ],
)  # fmt: skip
def test_a_class_term_is_the_formula_of_the_page(motion: Motion, name: str, group: int) -> None:
    """Beyond some ranges, too, where it fades; stops are asked within, as they are not taken to the ends."""
    wide = 1.01 if name == "path_memory" else 0.95
    model = pinocchio_model(motion.robot, LINKS)
    rigid = pinocchio_torque(model, motion.position, motion.velocity, motion.acceleration)
    lower, upper = motion.position.min(axis=0), motion.position.max(axis=0)
    middle, half = 0.5 * (lower + upper), 0.5 * wide * (upper - lower)
    load = rigid.min(axis=0), rigid.max(axis=0)
    speed = 0.9 * np.abs(motion.velocity).max(axis=0)
    ranges = Ranges(
        middle - half, middle + half, speed, *load, np.ones(7), np.ones(7), np.ones((7, 2))
    ).to_json()  # fmt: skip
    x, v = (motion.position - middle) / half, motion.velocity / speed
    l = (2.0 * rigid - load[0] - load[1]) / (load[1] - load[0])  # noqa: E741
    random = np.random.default_rng(4)
    waves = random.normal(size=(7, 5)), random.uniform(0.0, 6.0, 5)
    fade = {key: 0.5 + 0.5 * np.cos(np.pi * np.clip((np.abs(values) - 1.0) / 0.3, 0.0, 1.0))
            for key, values in (("x", x), ("v", v), ("l", l))}  # fmt: skip
    if name == "configuration":
        phi, inside = np.cos(np.clip(x, -1, 1) @ waves[0] + waves[1]), fade["x"].prod(axis=1)
    else:
        phi = functions(name, group, x, v, l, np.sign(motion.velocity))
        inside = fade[FADED_BY.get(name, "l")][:, J - 1]
        inside = inside * (fade["x"][:, J - 1] if name == "own_load_by_position" else 1.0)
    centre, weights = random.normal(size=(2, phi.shape[1]))
    terms = [{"class": name, "group": group, "joint": J, "scale": 0.6, "centre": centre, "weights": weights}]
    data = {"ranges": ranges, "fade": 0.3, "terms": terms, "waves": {"direction": waves[0], "phase": waves[1]}}
    expected = 0.6 * inside * ((phi - centre) @ weights)
    torque = terms_torque(data, motion)
    np.testing.assert_allclose(torque[:, J - 1], expected, atol=1e-6 * np.abs(expected).max())
    assert not np.delete(torque, J - 1, axis=1).any()


def test_the_friction_among_the_terms_is_the_formula_of_the_page(motion: Motion) -> None:
    ones, velocity = np.full(7, 9.0), motion.velocity[:, J - 1]
    ranges = Ranges(-ones, ones, 0.9 * np.abs(motion.velocity).max(axis=0), -ones, ones, ones, ones, np.ones((7, 2)))
    term = {"class": "friction", "joint": J, "weights": [-0.3, 0.2]}
    data = {"ranges": ranges.to_json(), "fade": 0.3, "terms": [term], "waves": {"direction": [], "phase": []}}
    beyond = np.clip((np.abs(velocity) / ranges.speed[J - 1] - 1.0) / 0.3, 0.0, 1.0)
    expected = (0.5 + 0.5 * np.cos(np.pi * beyond)) * (-0.3 * velocity + 0.2 * np.sign(velocity))
    torque = terms_torque(data, motion)
    np.testing.assert_allclose(torque[:, J - 1], expected, atol=1e-12)
    assert not np.delete(torque, J - 1, axis=1).any()


def test_class_terms_of_as_many_functions_as_an_earlier_version_had_are_refused(motion: Motion) -> None:
    """Late friction had 15."""
    ones = np.ones(7)
    ranges = Ranges(-ones, ones, ones, -ones, ones, ones, ones, np.ones((7, 2))).to_json()
    term = {"class": "own_velocity", "group": 2, "joint": J, "scale": 1.0, "centre": 15 * [0.0], "weights": 15 * [0.1]}
    data = {"ranges": ranges, "fade": 0.3, "terms": [term], "waves": {"direction": [], "phase": []}}
    with pytest.raises(ModelFileError, match=r"or of an earlier version .* diagnose the recording again"):
        terms_torque(data, motion)
