"""Changes between periods, against torque that Pinocchio computes: nothing here comes from the effects under test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio
import pytest
from scipy.signal import butter, lfilter, sosfilt, sosfiltfilt

from identification.base_parameters import BaseRegressor
from identification.mismatch import claims
from identification.mismatch.changes import between_periods
from identification.mismatch.changes.between_periods import Change, find_between_periods
from identification.mismatch.effects.external_contact import ExternalContact
from identification.mismatch.effects.payload_change import PayloadChange
from identification.mismatch.effects.thermal_friction import ThermalFriction
from identification.mismatch.effects.torque_sensor_drift import TorqueSensorDrift
from identification.mismatch.evidence import Evidence
from identification.mismatch.reduction import build_evidence
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording
from identification.robots import RobotModel
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

FloatArray = npt.NDArray[np.float64]
Torque = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]

EFFECTS = (TorqueSensorDrift(), ThermalFriction(), PayloadChange(), ExternalContact())
PERIOD_S, SAMPLES, PERIODS = 10.0, 1250, 10
NOISE = np.array([0.17, 0.15, 0.1, 0.08, 0.06, 0.04, 0.03])


@pytest.fixture(scope="module")
def record(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> Callable[..., tuple[Recording, Evidence]]:
    """(extra torque, noise, seed) → recording and evidence. extra: (t, q, dq, ddq) of all rows → (rows, 7) Nm."""
    q, dq, ddq = fourier_motion(7, period_s=PERIOD_S, samples=SAMPLES, seed=4)
    plain = inverse_dynamics(iiwa14, table3, q, dq, ddq)

    def make(
        extra: Torque | None = None,
        noise: str = "white",
        seed: int = 1,
        filtered: Callable[[FloatArray], FloatArray] | None = None,
    ) -> tuple[Recording, Evidence]:
        generator = np.random.default_rng(seed)
        states = [np.tile(values, (PERIODS, 1)) for values in (q, dq, ddq)]
        rows = PERIODS * SAMPLES
        time = np.arange(rows) * PERIOD_S / SAMPLES
        torque = np.tile(plain, (PERIODS, 1)) + (0.0 if extra is None else extra(time, *states))
        torque = torque + NOISE * _noise(noise, (rows, 7), time, generator)
        if noise == "quantised":
            torque = np.round(torque / 0.05) * 0.05
        torque = torque if filtered is None else filtered(torque)
        position = states[0] + 2e-5 * generator.normal(size=(rows, 7))
        kind = "log" if filtered is None else "npz"
        recording = recording_of(position, torque, period_s=PERIOD_S, periods=PERIODS, kind=kind)
        return recording, build_evidence(recording, iiwa14, iiwa14_base)[0]

    return make


def _noise(kind: str, shape: tuple[int, int], time: FloatArray, generator: np.random.Generator) -> FloatArray:
    white = generator.normal(size=shape)
    if kind in ("red", "pink"):
        corner = 0.4 if kind == "red" else 5.0
        factor = np.exp(-2.0 * np.pi * corner * (time[1] - time[0]))
        coloured = lfilter([np.sqrt(1.0 - factor**2)], [1.0, -factor], generator.normal(size=shape), axis=0)
        return np.asarray(np.sqrt(0.5) * (white + coloured))
    if kind == "outliers":
        return np.asarray(white + 30.0 * generator.normal(size=shape) * (generator.random(shape) < 2e-4))
    if kind == "hum":
        return np.asarray(white + 0.8 * np.sin(2.0 * np.pi * 50.03 * time)[:, None] * generator.normal(size=shape[1]))
    return white


def _only(changes: tuple[Change, ...], name: str) -> Change:
    assert [change.effect.name for change in changes] == [name]
    return changes[0]


def _parameters(change: Change) -> dict[str, tuple[float, float]]:
    return {item.name: (item.value, item.std) for item in change.effect.parameters(change.estimate)}


def _push(robot: RobotModel, link: int, force: FloatArray, arm: FloatArray, window: Callable[[FloatArray], FloatArray]):
    """Torque JᵀF of a force in the base frame at a point of a link, by Pinocchio's Jacobian."""
    model = robot.pinocchio_model
    data = model.createData()
    frame = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED

    def extra(time: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        result = np.zeros_like(q)
        factor = window(time)
        for row in np.flatnonzero(factor):
            pinocchio.computeJointJacobians(model, data, q[row])
            jacobian = pinocchio.getJointJacobian(model, data, link, frame)
            lever = data.oMi[link].rotation @ arm
            result[row] = factor[row] * (jacobian.T @ np.concatenate([force, np.cross(lever, force)]))
        return result

    return extra


def _load(robot: RobotModel, carried: Callable[[FloatArray], npt.NDArray[np.bool_]]) -> Torque:
    """Torque of 0.4 kg on the flange while it is carried, by Pinocchio's inverse dynamics of that body alone."""
    model = robot.pinocchio_model.copy()
    for joint in range(model.njoints):
        model.inertias[joint] = pinocchio.Inertia.Zero()
    model.inertias[7] = pinocchio.Inertia(0.4, np.array([0.02, -0.01, 0.15]), 1e-3 * np.eye(3))
    data = model.createData()

    def extra(time: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        once = [
            pinocchio.rnea(model, data, *state) for state in zip(q[:SAMPLES], dq[:SAMPLES], ddq[:SAMPLES], strict=True)
        ]
        return np.tile(np.array(once), (PERIODS, 1)) * carried(time)[:, None]

    return extra


@pytest.mark.parametrize("noise", ["white", "red", "pink", "outliers", "quantised", "hum"])
@pytest.mark.parametrize("seed", [11, 12])
def test_noise_of_any_colour_is_no_change(record, noise: str, seed: int) -> None:
    assert find_between_periods([record(None, noise, seed)[1]], EFFECTS) == ()


def test_a_change_whose_size_may_as_well_be_zero_is_no_claim(record, monkeypatch: pytest.MonkeyPatch) -> None:
    """A drift of 10 Nm/h, once with the covariance that it has and once with one that makes it 1.9 of its own σ."""
    plain = between_periods._change

    def uncertain(*arguments: Any) -> Change:
        change = plain(*arguments)
        size = change.estimate.coefficients
        covariance = np.diag((size / 1.9) ** 2)
        return replace(change, estimate=replace(change.estimate, covariance=covariance))

    def extra(time: FloatArray, *_: FloatArray) -> FloatArray:
        return np.eye(7)[3] * time[:, None] * 10.0 / 3600.0

    evidence = record(extra)[1]
    _only(find_between_periods([evidence], (TorqueSensorDrift(),)), "torque_sensor_drift")
    monkeypatch.setattr(between_periods, "_change", uncertain)
    assert find_between_periods([evidence], (TorqueSensorDrift(),)) == ()


ZERO_PHASE = partial(sosfiltfilt, padtype=None)


@pytest.mark.parametrize(
    ("run", "cutoff_hz"),
    [(sosfilt, 3.0), (sosfilt, 20.0), (ZERO_PHASE, 3.0), (ZERO_PHASE, 8.0), (sosfiltfilt, 8.0), (ZERO_PHASE, 20.0)],
)
def test_the_ends_of_a_filtered_record_are_no_evidence(record, run, cutoff_hz: float) -> None:
    """A filter begins with nothing before the record: on every joint that is a jolt of the whole torque."""
    sos = butter(4, cutoff_hz, fs=SAMPLES / PERIOD_S, output="sos")
    _, evidence = record(filtered=lambda torque: run(sos, torque, axis=0))
    assert find_between_periods([evidence], EFFECTS) == ()


@pytest.mark.parametrize(
    ("course", "names"),
    [
        (lambda t: 6.0 * t / 3600.0, {"rate": 6.0}),
        (lambda t: 0.5 * np.exp(-t / 25.0), {"initial_torque": 0.5, "time_constant": 25.0}),
        (lambda t: 0.1 * (t > 43.3), {"step": 0.1, "time": 43.3}),
    ],
)
def test_a_sensor_that_drifts_is_named_on_its_joint(record, course, names: dict[str, float]) -> None:
    def extra(time, q, dq, ddq):
        return course(time)[:, None] * (np.arange(7) == 4)

    change = _only(find_between_periods([record(extra)[1]], EFFECTS), "torque_sensor_drift")
    assert change.estimate.place.joint == 5
    found = _parameters(change)
    assert set(found) == set(names)
    for name, truth in names.items():
        value, std = found[name]
        assert abs(value - truth) < 4.0 * std
        assert std < 0.3 * truth


@pytest.mark.parametrize(
    "fading",
    [lambda t: np.exp(-t / 60.0), lambda t: 0.5 * np.exp(-t / 20.0) + 0.5 * np.exp(-t / 200.0)],
    ids=["one time constant", "two time constants"],
)
def test_friction_that_fades_is_thermal_whatever_its_time_constants(record, fading) -> None:
    def extra(time, q, dq, ddq):
        own = fading(time)[:, None] * (0.2 * dq + 0.2 * np.sign(dq))
        return own * (np.arange(7) == 2)

    change = _only(find_between_periods([record(extra)[1]], EFFECTS), "thermal_friction")
    assert change.estimate.place.joint == 3


@pytest.mark.parametrize("moment", [30.0, 47.12])
def test_a_payload_is_weighed_and_its_moment_found_within_fifty_milliseconds(
    record, iiwa14: RobotModel, moment: float
) -> None:
    extra = _load(iiwa14, lambda time: time >= moment)
    change = _only(find_between_periods([record(extra)[1]], EFFECTS), "payload_change")
    found = _parameters(change)
    assert abs(found["time"][0] - moment) < 0.05
    assert abs(found["mass"][0] - 0.4) < max(4.0 * found["mass"][1], 0.004)
    assert abs(found["first_moment_z"][0] - 0.4 * 0.15) < max(4.0 * found["first_moment_z"][1], 0.001)


def test_a_payload_of_which_the_inertia_does_not_show_has_mass_and_first_moments_alone(
    record, iiwa14: RobotModel
) -> None:
    """3 g, of which ten parameters prove less than four."""
    load = _load(iiwa14, lambda time: time >= 42.0)
    evidence = record(lambda *states: 0.0075 * load(*states))[1]
    change = _only(find_between_periods([evidence], (PayloadChange(),)), "payload_change")
    found = _parameters(change)
    assert found["mass"][0] == pytest.approx(0.003, abs=4.0 * found["mass"][1])
    assert not change.estimate.coefficients[4:].any()
    assert change.mean_columns.shape[-1] == 4


@pytest.mark.parametrize(
    "profile",
    [
        lambda u: np.sin(np.pi * u),
        lambda u: 1.0 - np.abs(2.0 * u - 1.0),
        lambda u: np.clip(8.0 * np.minimum(u, 1.0 - u), 0.0, 1.0),
        lambda u: np.sin(np.pi * np.sqrt(u)) ** 2,
    ],
    ids=["half sine", "triangle", "plateau", "early peak"],
)
def test_a_push_on_the_flange_is_one_contact_whatever_its_profile(record, iiwa14: RobotModel, profile) -> None:
    start, duration, force = 53.4, 0.9, np.array([6.0, -8.0, 5.0])

    def window(time):
        u = (time - start) / duration
        return np.where((u > 0.0) & (u < 1.0), profile(np.clip(u, 0.0, 1.0)), 0.0)

    extra = _push(iiwa14, 7, force, np.array([0.0, 0.0, 0.15]), window)
    recording, evidence = record(extra)
    change = _only(find_between_periods([evidence], EFFECTS), "external_contact")
    assert change.estimate.place.link == 7
    assert abs(change.estimate.shape["start_s"] + 0.5 * change.estimate.shape["duration_s"] - start - 0.45) < 0.15
    truth = np.tile(extra(np.arange(PERIODS * SAMPLES) * PERIOD_S / SAMPLES, recording.position, None, None), (1, 1))
    expected = evidence.project(truth.reshape(PERIODS, SAMPLES, 7)[5])
    assert np.linalg.norm(change.contribution[5] - expected) < 0.25 * np.linalg.norm(expected)


@pytest.mark.parametrize("seed", [3, 4, 8])
def test_the_moment_of_a_jump_is_found_among_the_many_tops_that_noise_makes_of_its_gain(record, seed: int) -> None:
    def extra(time, q, dq, ddq):
        return 0.1 * (time > 43.3)[:, None] * (np.arange(7) == 4)

    change = _only(find_between_periods([record(extra, seed=seed)[1]], (TorqueSensorDrift(),)), "torque_sensor_drift")
    moment, std = _parameters(change)["time"]
    # The compared band ends at 50 Hz: half a wave of it, and noise of 0.6 times the jump.
    assert abs(moment - 43.3) < 0.03
    assert std < 0.03


def test_a_push_off_the_axis_of_the_wrist_is_on_the_link_it_is_on_and_its_force_within_the_interval(
    record, iiwa14: RobotModel
) -> None:
    force = np.array([-6.0, 2.5, -3.5])

    def window(time):
        return np.where(np.abs(time - 62.0) < 0.45, np.cos(np.pi * (time - 62.0) / 0.9), 0.0)

    extra = _push(iiwa14, 6, force, np.array([-0.1, -0.01, -0.09]), window)
    change = _only(find_between_periods([record(extra)[1]], EFFECTS), "external_contact")
    assert change.estimate.place.link == 6
    size, std = _parameters(change)["force"]
    assert abs(size - np.linalg.norm(force)) < 2.5 * std
    assert std < 0.1 * size


def test_a_push_on_the_elbow_leaves_the_joints_beyond_it_clean(record, iiwa14: RobotModel) -> None:
    def window(time):
        return np.where(np.abs(time - 71.0) < 0.4, np.cos(np.pi * (time - 71.0) / 0.8), 0.0)

    extra = _push(iiwa14, 4, np.array([20.0, 5.0, 10.0]), np.array([0.0, 0.1, 0.05]), window)
    change = _only(find_between_periods([record(extra)[1]], EFFECTS), "external_contact")
    assert change.estimate.place.link is not None
    assert change.estimate.place.link <= 4
    assert not change.contribution[:, :, 4:].any()


def test_a_contact_that_comes_back_is_one_finding_and_drift_beside_it_another(record, iiwa14: RobotModel) -> None:
    def window(time):
        return sum(np.where(np.abs(time - at) < 0.3, np.cos(np.pi * (time - at) / 0.6), 0.0) for at in (23.0, 63.0))

    push = _push(iiwa14, 7, np.array([0.0, 9.0, -6.0]), np.array([0.0, 0.0, 0.1]), window)

    def extra(time, q, dq, ddq):
        return push(time, q, dq, ddq) + 20.0 * time[:, None] / 3600.0 * (np.arange(7) == 1)

    changes = find_between_periods([record(extra)[1]], EFFECTS)
    assert {change.effect.name for change in changes} == {"external_contact", "torque_sensor_drift"}
    assert len(changes) == 2
    contact = next(change for change in changes if change.effect.name == "external_contact")
    starts = sorted(value for name, value in contact.estimate.shape.items() if name.startswith("start_"))
    assert starts == pytest.approx([22.7, 62.7], abs=0.1)


def test_subtracting_a_change_gives_the_mean_back(record) -> None:
    def extra(time, q, dq, ddq):
        return 0.3 * (time > 43.3)[:, None] * (np.arange(7) == 4)

    clean, changed = record()[1], record(extra)[1]
    change = _only(find_between_periods([changed], EFFECTS), "torque_sensor_drift")
    left = changed.torque - change.contribution.mean(axis=0) - clean.torque
    assert np.abs(left / changed.noise).max() < 3.0
    assert np.abs((changed.torque - clean.torque) / changed.noise).max() > 10.0


def test_the_finding_of_each_change_names_the_recording_it_was_found_in(record) -> None:
    def extra(time, q, dq, ddq):
        return 0.3 * (time > 43.3)[:, None] * (np.arange(7) == 4)

    change = _only(find_between_periods([record(extra)[1]], EFFECTS), "torque_sensor_drift")
    recordings = ["first.mcap", "second.mcap"]
    found = claims.between_periods([replace(change, evidence=number) for number in (0, 1, 0)], recordings)
    assert [finding.where["recording"] for finding in found] == ["first.mcap", "second.mcap", "first.mcap"]


def test_unit_forces_are_minus_the_transposed_jacobian(iiwa14: RobotModel, record) -> None:
    evidence = record()[1]
    effect = ExternalContact()
    place = effect.places(evidence.motion)[4]
    shape = {
        "point_x_m": 0.1,
        "point_y_m": -0.2,
        "point_z_m": 0.3,
    }
    found = effect.repeated_columns(evidence.motion, place, shape)
    assert found is not None
    row = int(np.argmin(np.abs(evidence.motion.time - 2.5)))
    model = iiwa14.pinocchio_model
    data = model.createData()
    pinocchio.computeJointJacobians(model, data, evidence.motion.position[row])
    jacobian = pinocchio.getJointJacobian(model, data, 5, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    lever = data.oMi[5].rotation @ np.array([0.1, -0.2, 0.3])
    expected = [-jacobian.T @ np.concatenate([unit, np.cross(lever, unit)]) for unit in np.eye(3)]
    assert found[1][row] == pytest.approx(np.array(expected).T[:5], abs=1e-4)
