"""Every kind of difference in the set-up, put into the fake robot or into what its sensors send, named by the audit.

Truth: the physics that the fake robot's plant is told of, and changes of its samples. Model and recordings are of runs
of the shipped motion with errors of their own. The whole way over FRI is walked for a load in `test_payload.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.fake_robot.plant import Plant
from fixtures.physics import iiwa14_table_three
from fixtures.physics.settings import PhysicsSettings
from identification.audit import Audit, audit
from identification.audit.between import model_of
from identification.excitation import default_trajectory
from identification.model_file import Model
from identification.recordings import Recording, read_recording
from identification.robots import load_robot

FloatArray = np.ndarray
SECONDS, LEAD_IN = 10, 1000
LOAD = (2.5, 0.02, -0.015, 0.09)
"""kg, then m from the flange."""
EIGHT, NINETY = np.radians(8.0), np.radians(90.0)


@dataclass(frozen=True)
class Cell:
    """The fake robot in a folder, and the model of its bare arm."""

    folder: Path
    model: Model

    def run(self, seed: int, **physics: Any) -> Recording:
        """10 s of the shipped motion at 1 kHz, as the robot sends them."""
        time_s = 1e-3 * np.arange(-LEAD_IN, 1000 * SECONDS)
        path = default_trajectory("iiwa14").evaluate(time_s)[0]
        plant = Plant(PhysicsSettings(initial_position_rad=tuple(path[0].tolist()), **physics), seed=seed)
        samples = [(sample.measured_position, sample.measured_torque) for sample in map(plant.step, path)][LEAD_IN:]
        position, torque = (np.array(values) for values in zip(*samples, strict=True))
        file = self.folder / f"{seed}.npz"
        np.savez(file, t=time_s[LEAD_IN:], q=position, tau=torque, robot="iiwa14")
        return read_recording(file)

    def asked(self, recording: Recording, model: Model | None = None) -> Audit:
        return audit([recording], load_robot("iiwa14"), model or self.model)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    folder = tmp_path_factory.mktemp("cell")
    bare = Cell(folder, None).run(1)  # type: ignore[arg-type]
    return Cell(folder, model_of(bare, load_robot("iiwa14")))


@pytest.fixture(scope="module")
def sound(cell: Cell) -> Recording:
    """A second run of the bare arm."""
    return cell.run(2)


def named(found: Audit) -> list[tuple[str, int | None]]:
    return [(item.effect, item.joint if item.joint is not None else item.link) for item in found.differences]


def with_torque(change: Callable[[FloatArray], FloatArray]) -> Callable[[Recording], Recording]:
    return lambda recording: replace(recording, torque=change(recording.torque))


def on_joint(joint: int, value: float, otherwise: float) -> FloatArray:
    return np.where(np.arange(7) == joint - 1, value, otherwise)


def heavier(mass: float, link: int) -> dict[str, Any]:
    return {"links": ({"link": link, "mass": float(iiwa14_table_three().mass[link - 1]) + mass},)}


def rubbing(joint: int, name: str, by: float) -> dict[str, Any]:
    return {"links": ({"link": joint, name: float(getattr(iiwa14_table_three(), name)[joint - 1]) + by},)}


@pytest.mark.parametrize(
    ("physics", "names", "value"),
    [
        (heavier(3.0, 4), [("payload", 4), ("link_parameters", 4)], None),
        ({"gravity_m_s2": (9.81 * np.sin(EIGHT), 0.0, -9.81 * np.cos(EIGHT))}, [("base_tilt", None)], EIGHT),
        ({"gravity_m_s2": (9.81 * np.sin(NINETY), 0.0, -9.81 * np.cos(NINETY))}, [("base_tilt", None)], NINETY),
        # What the model expects of joints 1 and 2 is then nearer to each other's torque than to their own.
        ({"gravity_m_s2": (0.0, 9.81, 0.0)}, [("base_tilt", None)], NINETY),
        (rubbing(2, "viscous", 4.0), [("friction_change", 2)], 4.0),
        (rubbing(2, "coulomb", 1.0), [("friction_change", 2)], 1.0),
        ({"torque_late_s": 0.02}, [("torque_delay", None)], 0.02),
    ],
)
def test_what_is_different_of_the_arm_is_named_with_its_size(
    cell: Cell, physics: dict[str, Any], names: list[tuple[str, int | None]], value: float | None
) -> None:
    found = cell.asked(cell.run(3, **physics))
    first = found.differences[0]
    also = [(first.effect, first.joint if first.joint is not None else first.link), *first.alternatives]
    assert len(found.differences) == 1
    assert set(names) & set(also)
    if value is not None:
        assert first.numbers[0].value == pytest.approx(value, rel=0.15)


CHANGES: dict[str, tuple[Callable[[Recording], Recording], str, int | None]] = {
    "one sign": (with_torque(lambda torque: torque * on_joint(4, -1.0, 1.0)), "inverted_torque_sign", 4),
    "all signs": (with_torque(lambda torque: -torque), "inverted_torque_sign", None),
    "one scale": (with_torque(lambda torque: torque * on_joint(2, 1.2, 1.0)), "torque_sensor_gain", 2),
    "all scales": (with_torque(lambda torque: 1.2 * torque), "torque_sensor_gain", None),
    "offset": (with_torque(lambda torque: torque + on_joint(4, 3.0, 0.0)), "torque_offset", 4),
    "order": (with_torque(lambda torque: torque[:, [0, 3, 2, 1, 4, 5, 6]]), "wrong_joint_order", None),
    "zero": (lambda run: replace(run, position=run.position - on_joint(4, 0.05, 0.0)), "joint_zero_offset", 4),
    "degrees": (lambda run: replace(run, position=np.degrees(run.position)), "wrong_unit", None),
    "clock": (
        lambda run: replace(run, time=1.25 * run.time, sampling_period_s=1.25 * run.sampling_period_s),
        "wrong_time_base",
        None,
    ),
}


@pytest.mark.parametrize("what", list(CHANGES))
def test_what_is_different_of_the_recording_is_named(cell: Cell, sound: Recording, what: str) -> None:
    change, effect, joint = CHANGES[what]
    assert named(cell.asked(change(sound))) == [(effect, joint)]


def test_an_axis_with_another_motor_is_named(cell: Cell, sound: Recording) -> None:
    """A joint sensor of this robot does not feel the rotor's inertia; one on the motor's side would."""
    acceleration = default_trajectory("iiwa14").evaluate(sound.time)[2]
    first = cell.asked(replace(sound, torque=sound.torque + acceleration * on_joint(3, 0.8, 0.0))).differences[0]
    assert ("rotor_inertia", 3) in [(first.effect, first.joint), *first.alternatives]


def test_a_load_is_named_and_known_as_well_as_its_joints_know_their_scale(cell: Cell) -> None:
    """Joint 7 carries next to nothing of it: what its scale seems to be had made the interval of the mass far wider."""
    found = cell.asked(cell.run(3, load_kg_m=LOAD))
    assert named(found) == [("payload", 7)]
    mass = found.differences[0].numbers[0]
    assert mass.value == pytest.approx(LOAD[0], rel=0.15)
    low, high = mass.interval
    assert low < LOAD[0] < high
    assert 1.96 * mass.std < 0.03 * LOAD[0]


def test_a_load_that_is_taken_off_has_a_negative_mass(cell: Cell, sound: Recording) -> None:
    loaded = model_of(cell.run(4, load_kg_m=LOAD), load_robot("iiwa14"))
    found = cell.asked(sound, loaded)
    assert named(found) == [("payload", 7)]
    assert found.differences[0].numbers[0].value == pytest.approx(-LOAD[0], rel=0.05)


def test_nothing_is_named_where_nothing_differs(cell: Cell, sound: Recording) -> None:
    found = cell.asked(sound)
    assert found.differences == ()
    assert found.verdict == "nothing"
