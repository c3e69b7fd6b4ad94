"""Claims about faults put into a recording of a real UR10, which others made (fixtures/recordings).

Truth: what was put in. A load's torque is Pinocchio's Newton-Euler of that body alone; the other faults are changes of
the file's own numbers. The model is fitted to the first half, the fault is put into the second.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from identification.audit import Audit, audit, search
from identification.audit.basis import Explanation
from identification.audit.hypotheses import Hypothesis
from identification.errors import EstimationError, ModelFileError, RecordingError
from identification.model_file import read_model, write_model
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import Installation, load_robot
from tests.identification.audit.halves import Bench, names, torque_of_lean, torque_of_load
from tests.reference import recording_file

FloatArray = np.ndarray


@pytest.fixture(scope="module")
def bench() -> Bench:
    robot = recording_file("ur10_mdh.csv")
    return Bench.of_halves(read_recording(recording_file("ur10.npz"), robot=robot), load_robot(robot))


def test_nothing_is_named_where_nothing_differs(bench: Bench) -> None:
    found = bench.asked(bench.recording)
    assert found.differences == ()
    assert found.verdict == "nothing"


@pytest.mark.parametrize("mass", [2.7, 6.0])
def test_a_load_on_the_flange_is_named_with_its_mass(bench: Bench, mass: float) -> None:
    center = np.array([0.01, -0.02, 0.08])
    load = torque_of_load(bench.robot, bench.recording, mass, center)
    found = bench.with_torque(bench.recording.torque + load)
    assert names(found) == [("payload", None, 6)]
    (number, *_) = found.differences[0].numbers
    low, high = number.interval
    assert number.value == pytest.approx(mass, rel=0.1)
    assert low < mass < high
    assert found.differences[0].explained > 0.5
    assert "on the flange" in found.differences[0].sentence


def test_a_load_that_was_taken_off_has_a_negative_mass(bench: Bench) -> None:
    load = torque_of_load(bench.robot, bench.recording, 4.0, np.array([0.0, 0.02, 0.06]))
    found = bench.with_torque(bench.recording.torque - load)
    assert names(found) == [("payload", None, 6)]
    assert found.differences[0].numbers[0].value == pytest.approx(-4.0, rel=0.1)
    assert "taken off" in found.differences[0].sentence


def test_torques_that_are_all_turned_round_are_named_so(bench: Bench) -> None:
    found = bench.with_torque(-bench.recording.torque)
    assert names(found) == [("inverted_torque_sign", None, None)]
    assert found.differences[0].against == "recording"


def test_one_torque_that_is_turned_round_is_named_with_its_joint(bench: Bench) -> None:
    torque = bench.recording.torque.copy()
    torque[:, 2] *= -1.0
    assert names(bench.with_torque(torque)) == [("inverted_torque_sign", 3, None)]


def test_a_common_scale_is_named_with_what_cannot_be_told_from_it(bench: Bench) -> None:
    found = bench.with_torque(1.25 * bench.recording.torque)
    assert names(found) == [("torque_sensor_gain", None, None)]
    assert found.differences[0].numbers[0].value == pytest.approx(1.25, abs=0.03)
    assert "all masses" in found.differences[0].sentence


def test_torques_under_other_joints_are_put_back_in_order(bench: Bench) -> None:
    found = bench.with_torque(bench.recording.torque[:, [0, 2, 1, 3, 4, 5]])
    assert names(found) == [("wrong_joint_order", None, None)]
    assert found.differences[0].joints == (2, 3)


def test_positions_in_degrees_are_read_so(bench: Bench) -> None:
    found = bench.asked(replace(bench.recording, position=np.degrees(bench.recording.position), velocity=None))
    assert names(found) == [("wrong_unit", None, None)]


def test_an_offset_is_named_with_its_joint(bench: Bench) -> None:
    torque = bench.recording.torque.copy()
    torque[:, 1] += 25.0
    found = bench.with_torque(torque)
    assert names(found)[0][:2] in (("torque_offset", 2), ("friction_change", 2))
    assert len(found.differences) == 1


def rates(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """q̇, q̈ by differences of the position, smoothed over 0.1 s."""
    width = round(0.1 / recording.sampling_period_s)
    values = recording.position
    found = []
    for _ in range(2):
        values = np.gradient(values, recording.sampling_period_s, axis=0)
        values = np.apply_along_axis(lambda row: np.convolve(row, np.ones(width) / width, "same"), 0, values)
        found.append(values)
    return found[0], found[1]


def on_joint(bench: Bench, joint: int, column: FloatArray) -> Audit:
    torque = bench.recording.torque.copy()
    torque[:, joint - 1] += column
    return bench.with_torque(torque)


@pytest.mark.parametrize(
    ("effect", "number", "value", "joint"),
    [("friction_change", "viscous", 14.0, 3), ("friction_change", "coulomb", 9.0, 2), ("rotor_inertia", "", 1.4, 4)],
)
def test_another_drive_is_named_with_its_joint_and_number(
    bench: Bench, effect: str, number: str, value: float, joint: int
) -> None:
    velocity, acceleration = rates(bench.recording)
    column = {"viscous": velocity, "coulomb": np.sign(velocity), "": acceleration}[number][:, joint - 1]
    found = on_joint(bench, joint, value * column)
    assert names(found) == [(effect, joint, None)]
    first = found.differences[0].numbers[0]
    assert first.name == (number or "rotor_inertia")
    assert first.value == pytest.approx(value, rel=0.3)


def test_one_scale_is_named_with_its_joint(bench: Bench) -> None:
    torque = bench.recording.torque * np.where(np.arange(6) == 2, 0.75, 1.0)
    found = bench.with_torque(torque)
    assert names(found) == [("torque_sensor_gain", 3, None)]
    assert found.differences[0].numbers[0].value == pytest.approx(0.75, abs=0.05)


def test_the_zero_of_a_joint_is_named_with_its_angle(bench: Bench) -> None:
    position = bench.recording.position.copy()
    position[:, 1] -= 0.1
    found = bench.asked(replace(bench.recording, position=position))
    assert names(found) == [("joint_zero_offset", 2, None)]
    assert found.differences[0].numbers[0].value == pytest.approx(0.1, abs=0.03)


def test_a_late_torque_is_named_beyond_the_delay_of_the_models_own_recording(bench: Bench) -> None:
    late = 0.03
    found = bench.with_torque(bench.late(late))
    assert names(found) == [("torque_delay", None, None)]
    low, high = found.differences[0].numbers[0].interval
    assert low < late < high


@pytest.mark.parametrize("velocity", [True, False])
def test_a_slow_clock_is_named_with_and_without_a_recorded_velocity(bench: Bench, velocity: bool) -> None:
    ratio, recording = 1.4, bench.recording
    slow = replace(
        recording,
        time=recording.time * ratio,
        sampling_period_s=recording.sampling_period_s * ratio,
        velocity=recording.velocity if velocity else None,
    )
    found = bench.asked(slow)
    assert names(found) == [("wrong_time_base", None, None)]
    assert found.differences[0].numbers[0].value == pytest.approx(ratio, rel=0.005 if velocity else 0.15)


@pytest.mark.parametrize("degrees", [8.0, 60.0, 170.0])
def test_a_base_that_stands_otherwise_than_it_is_said_is_named_with_its_angle(bench: Bench, degrees: float) -> None:
    # The arm stood level: what is stated leans, so what is found leans back.
    angle = np.radians(degrees)
    leaning = Installation((9.81 * float(np.sin(angle)), 0.0, -9.81 * float(np.cos(angle))))
    robot = load_robot(recording_file("ur10_mdh.csv"), leaning)
    found = audit([bench.recording], robot, bench.model)
    assert names(found) == [("base_tilt", None, None)]
    assert np.degrees(found.differences[0].numbers[0].value) == pytest.approx(degrees, abs=1.5)


def test_another_link_is_named_so_or_as_a_load_on_it(bench: Bench) -> None:
    # The inertia about the joint's own axis, which no weight of a load could make.
    _, acceleration = rates(bench.recording)
    found = on_joint(bench, 1, 25.0 * acceleration[:, 0])
    assert len(found.differences) == 1
    one = found.differences[0]
    also = [(one.effect, one.joint or one.link), *one.alternatives]
    assert {("link_parameters", 1), ("rotor_inertia", 1)} & set(also)


def small(bench: Bench, what: str) -> Recording:
    """A fault that is there and that these rows cannot show."""
    recording = bench.recording
    velocity, acceleration = rates(recording)
    first = np.eye(6)[1]
    match what:
        case "load":
            load = torque_of_load(bench.robot, recording, 0.05, np.array([0.0, 0.0, 0.05]))
            return replace(recording, torque=recording.torque + load)
        case "another link":
            load = torque_of_load(bench.robot, recording, 0.1, np.array([0.0, 0.0, 0.05]), link=3)
            return replace(recording, torque=recording.torque + load)
        case "lean":
            return replace(recording, torque=recording.torque + torque_of_lean(bench.robot, recording, np.radians(0.2)))
        case "offset":
            return replace(recording, torque=recording.torque + 0.2 * first)
        case "viscous friction":
            return replace(recording, torque=recording.torque + 0.3 * velocity * first)
        case "Coulomb friction":
            return replace(recording, torque=recording.torque + 0.2 * np.sign(velocity) * first)
        case "rotor inertia":
            return replace(recording, torque=recording.torque + 0.1 * acceleration * first)
        case "one scale":
            return replace(recording, torque=recording.torque * (1.0 + 0.005 * first))
        case "all scales":
            return replace(recording, torque=recording.torque * 1.005)
        case "zero":
            return replace(recording, position=recording.position - 0.002 * first)
        case "late torque":
            return replace(recording, torque=bench.late(0.001))
    return replace(
        recording, time=recording.time * 1.005, sampling_period_s=recording.sampling_period_s * 1.005, velocity=None
    )


@pytest.mark.parametrize(
    "what",
    ["load", "another link", "lean", "offset", "viscous friction", "Coulomb friction", "rotor inertia", "one scale",
     "all scales", "zero", "late torque", "clock"],
)  # fmt: skip
def test_what_the_rows_cannot_show_has_no_name(bench: Bench, what: str) -> None:
    assert bench.asked(small(bench, what)).differences == ()


def test_a_load_that_no_arm_carries_has_one_sentence_and_no_name(bench: Bench) -> None:
    load = torque_of_load(bench.robot, bench.recording, 3000.0, np.array([0.0, 0.0, 0.1]))
    with pytest.raises(EstimationError, match="no such arm carries"):
        bench.with_torque(bench.recording.torque + load)


def test_a_model_of_another_arm_is_refused(bench: Bench) -> None:
    other = read_recording(recording_file("tx40_excitation.npz"), robot=recording_file("tx40.urdf"))
    with pytest.raises(ModelFileError):
        audit([other], load_robot(recording_file("tx40.urdf")), bench.model)


def test_a_recording_without_motion_is_refused(bench: Bench) -> None:
    still = np.broadcast_to(bench.recording.position[:1], bench.recording.position.shape).copy()
    with pytest.raises(RecordingError, match="no joint moves"):
        bench.asked(replace(bench.recording, position=still, velocity=None))


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Bench, Bench]:
    """KUKA KR300, two recordings of 10 s with different motions of half a radian: each with the model of the other."""
    runs = [read_recording(recording_file(file)) for file in ("kr300_a.npz", "kr300_b.npz")]
    robot = load_robot(recording_file("kr300.urdf"))
    settings, there = FitSettings(physical=False, check_torque_sign=False), tmp_path_factory.mktemp("model")
    models = [fit_recordings([run], robot, settings).to_model_json(notes=False) for run in runs]
    first, second = (read_model(write_model(model, there / f"{k}.json")) for k, model in enumerate(models))
    return Bench(robot, first, runs[1]), Bench(robot, second, runs[0])


def test_two_runs_of_one_arm_on_other_programs_have_nothing_named(heavy: tuple[Bench, Bench]) -> None:
    for each in heavy:
        assert each.asked(each.recording).differences == ()


def test_a_late_torque_counts_by_what_it_gains_where_the_data_are_read_as_late_as_it_is(
    heavy: tuple[Bench, Bench],
) -> None:
    """From nought the torque is no line in a delay of 25 ms, and seemed not to gain enough."""
    for each in heavy:
        late = 0.025
        found = each.with_torque(each.late(late))
        assert names(found) == [("torque_delay", None, None)]
        low, high = found.differences[0].numbers[0].interval
        assert low < late < high


@pytest.mark.parametrize("pair", [(2, 3), (3, 4), (2, 5)])
def test_two_torques_are_put_back_in_order_beside_joints_of_which_the_model_leaves_more(
    heavy: tuple[Bench, Bench], pair: tuple[int, int]
) -> None:
    """Much of the misfit stays, so that it takes the recording alone and the model to tell it."""
    order = np.arange(6)
    order[np.array(pair) - 1] = np.array(pair[::-1]) - 1
    for each in heavy:
        found = each.with_torque(each.recording.torque[:, order])
        assert names(found) == [("wrong_joint_order", None, None)]
        assert found.differences[0].joints == pair


def counted(answer: Callable[..., object], most: int = 30) -> Callable[..., object]:
    """The same, and an error where it is asked far more often than any search needs."""
    times = iter(range(most))

    def asked(*arguments: object) -> object:
        assert next(times, None) is not None, "the search does not end"
        return answer(*arguments)

    return asked


def test_the_search_ends_where_a_sensor_seems_turned_round_however_it_is_read(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    third = np.where(np.arange(6) == 2, -1.0, 1.0)
    monkeypatch.setattr(search, "_signs", counted(lambda *_: third))
    assert bench.asked(bench.recording).differences == ()
    bench.with_torque(bench.recording.torque * np.array([1.0, 1.4, 1.0, 1.0, 1.0, 1.0]))


def test_the_search_ends_where_two_differences_make_each_other_needless(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def all_but_the_last(now: Explanation) -> list[Hypothesis]:
        return list(now.steps[:-1])

    load = torque_of_load(bench.robot, bench.recording, 6.0, np.array([0.0, 0.0, 0.08]))
    monkeypatch.setattr(search, "_needless", counted(all_but_the_last))
    found = bench.with_torque(bench.recording.torque + load + 30.0 * np.eye(6)[0])
    assert len(found.differences) == 1


@pytest.fixture(scope="module")
def panda() -> Bench:
    """An arm with joint torque sensors at 1 kHz: many quiet rows, which tell its delay to a tenth of a millisecond."""
    return Bench.of_halves(
        read_recording(recording_file("panda_excitation.npz")), load_robot(recording_file("panda.urdf"))
    )


def test_a_late_torque_is_not_taken_for_the_scatter_of_delays_from_run_to_run(panda: Bench) -> None:
    late = 0.012
    found = panda.with_torque(panda.late(late))
    assert names(found) == [("torque_delay", None, None)]
    low, high = found.differences[0].numbers[0].interval
    assert low < late < high
    assert found.differences[0].explained > 0.2


def test_a_lean_is_not_taken_for_the_scatter_of_how_a_base_stands(panda: Bench) -> None:
    found = panda.with_torque(panda.recording.torque + torque_of_lean(panda.robot, panda.recording, np.radians(4.0)))
    assert names(found) == [("base_tilt", None, None)]
    assert found.differences[0].explained > 0.8


@pytest.mark.parametrize("gain", [0.7, 1.25])
def test_an_interval_holds_what_stretches_of_a_recording_differ_by(panda: Bench, gain: float) -> None:
    """What the model leaves of joint 5 goes on for seconds; blocks in turns all had the same of it, and agreed.

    The halves differ without any fault: 1.25 lies at the upper end of 1.15 ± 0.1.
    """
    found = panda.with_torque(panda.recording.torque * np.where(np.arange(7) == 4, gain, 1.0))
    assert names(found) == [("torque_sensor_gain", 5, None)]
    low, high = found.differences[0].numbers[0].interval
    assert low < gain < high + 0.05 * (high - low)
