"""Eighteen kinds of fault put into real recordings, and what the audit of the set-up says of each.

Run: OPENBLAS_NUM_THREADS=1 python -m benchmarks.setup_faults --seed S [--rounds N] [--kinds A,B] [--json FILE]
Each recording is cut into two halves (two runs of the KR300 are taken as they are): a model is fitted to one, the fault
is put into the other, sizes and places are drawn. Right: the fault's name at its place and nothing else; silent: no
name; wrong: any other. Coverage: how often the 95 % interval of its number holds what was put in. Seen: silent faults
whose own kind at its own place has odds of 400 : 1 against nothing, on the rows of the audit and with the noise of the
recording without the fault: one who knew kind and place, but not the size, would have seen them. Found: those of them
that keep these odds where kind and place are not known, so that each costs the odds that a name has beforehand.
The Panda's recording is not shipped (licence); without it beside the checkout its faults are left out, and said so.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from fixtures.real_recordings import real_recording
from identification.audit import Audit, audit
from identification.audit.audit import compared
from identification.audit.columns import PARAMETERS
from identification.audit.given import given_model, sizes_of
from identification.audit.rows import rows_of
from identification.audit.search import gain_of, possible
from identification.audit.shown import LEAST_GAIN
from identification.base_parameters import BaseRegressor
from identification.errors import IdentificationError
from identification.model_file import Model, read_model, write_model
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.recordings.reader import robot_of
from identification.regressor import torque_regressor
from identification.robots import RobotModel, load_robot
from identification.signals.aperiodic import sixth_order_difference, uniform_grid, zero_phase_low_pass

FloatArray = npt.NDArray[np.float64]
SETS: dict[str, tuple[tuple[str, ...], str | None, float]] = {
    "ur10": (("ur10.npz",), "ur10_mdh.csv", 10.0),
    "panda": (("panda_excitation.npz",), None, 3.0),
    "kr300": (("kr300_a.npz", "kr300_b.npz"), None, 300.0),
    "tx40": (("tx40_excitation.npz",), None, 2.0),
}
"""Files, robot, and the load in kg that the arm is made for."""
MOTION_HZ = 16.0
VERDICTS = "right", "silent", "wrong"


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """A recording without a fault, the robot, a model fitted to another one, and all its parameters by a guess."""

    name: str
    recording: Recording
    robot: RobotModel
    model: Model
    parameters: FloatArray
    rated_kg: float


@dataclass(frozen=True, slots=True, eq=False)
class Fault:
    """What was put in. names: (effect, joint or link) that are right. number: its name and true value, if any."""

    recording: Recording
    names: tuple[tuple[str, int | None], ...]
    number: tuple[str, float] | None


Injection = Callable[[Background, np.random.Generator], Fault]


def backgrounds(cache: Path) -> list[Background]:
    """Every recording that is not the one its model was fitted to."""
    found = []
    for name, (files, arm, rated) in SETS.items():
        try:
            paths, table = [real_recording(file) for file in files], None if arm is None else real_recording(arm)
        except FileNotFoundError as error:
            print(f"{name}: left out, {error}")
            continue
        whole = [read_recording(path, robot=table) for path in paths]
        robot = load_robot(robot_of(whole))
        parts = whole if len(whole) > 1 else halves(whole[0])
        models = []
        for place, part in enumerate(parts):
            result = fit_recordings([part], robot, FitSettings(physical=False, check_torque_sign=False))
            models.append(read_model(write_model(result.to_model_json(), cache / f"{name}_{place}.json")))
        for place, part in enumerate(parts):
            model = models[1 - place]
            rows = rows_of([part])
            mean = given_model(
                models[place], BaseRegressor(robot, models[place].options), sizes_of(robot, rows), ""
            ).values
            found.append(Background(f"{name} {place + 1}", part, robot, model, mean, rated))
    return found


def halves(recording: Recording) -> list[Recording]:
    """The first and the second half in time."""
    middle = 0.5 * (recording.time[0] + recording.time[-1])
    parts = [recording.rows(recording.time < middle), recording.rows(recording.time >= middle)]
    return [replace(part, time=part.time - part.time[0]) for part in parts]


def motion(background: Background) -> tuple[FloatArray, FloatArray, FloatArray]:
    """q, q̇, q̈ (S, n) of the recording at its own time stamps, smoothed as wide as the audit never looks."""
    recording = background.recording
    step = recording.sampling_period_s
    time, q, _ = uniform_grid(recording.time, recording.position, recording.torque, step)
    q = zero_phase_low_pass(q, step, min(MOTION_HZ, 0.2 / step))
    dq = sixth_order_difference(q, step)
    ddq = sixth_order_difference(dq, step)
    at = recording.time
    return CubicSpline(time, q)(at), CubicSpline(time, dq)(at), CubicSpline(time, ddq)(at)


def _added(background: Background, torque: FloatArray) -> Recording:
    return replace(background.recording, torque=background.recording.torque + torque)


def _body(background: Background, generator: np.random.Generator, link: int, sign: float) -> Fault:
    """A load: 20 to 80 % of the rated one, up to 100 mm from the link's frame, the size of a ball of steel."""
    mass = sign * generator.uniform(0.2, 0.8) * background.rated_kg
    scale = 0.1 if background.rated_kg < 50.0 else 0.3
    center = generator.uniform(-scale, scale, 3)
    inertia = np.eye(3) * 0.4 * abs(mass) * (0.5 * scale) ** 2 * sign
    inertia += mass * (center @ center * np.eye(3) - np.outer(center, center))
    body = np.concatenate([[mass], mass * center, inertia[np.triu_indices(3)]])
    columns = torque_regressor(background.robot, *motion(background))[..., 10 * link : 10 * link + 10]
    return Fault(_added(background, columns @ body), (("payload", link + 1),), ("mass", mass))


def _turned(background: Background, gravity: FloatArray, angle: float) -> Fault:
    rows = background.recording
    q, _, _ = motion(background)
    still = np.zeros_like(q)
    inertial = background.parameters.reshape(-1, PARAMETERS)[:, :10].ravel()
    torque = [
        torque_regressor(replace(background.robot, gravity=each), q, still, still) @ inertial
        for each in (gravity, background.robot.gravity)
    ]
    return Fault(replace(rows, torque=rows.torque + torque[0] - torque[1]), (("base_tilt", None),), ("angle", angle))


def _leaning(background: Background, generator: np.random.Generator, low: float, high: float) -> Fault:
    angle, way = np.radians(generator.uniform(low, high)), generator.uniform(-np.pi, np.pi)
    level = np.array([np.cos(way), np.sin(way), 0.0])
    down = background.robot.gravity / np.linalg.norm(background.robot.gravity)
    size = float(np.linalg.norm(background.robot.gravity))
    return _turned(background, size * (np.cos(angle) * down + np.sin(angle) * level), float(angle))


def _own(
    background: Background, joint: int, column: FloatArray, value: float, names: Sequence[str], number: str
) -> Fault:
    torque = np.zeros_like(background.recording.torque)
    torque[:, joint] = value * column
    return Fault(_added(background, torque), tuple((name, joint + 1) for name in names), (number, value))


def _scaled(
    background: Background, scale: FloatArray, names: tuple[tuple[str, int | None], ...], value: float | None
) -> Fault:
    recording = background.recording
    return Fault(replace(recording, torque=recording.torque * scale), names, None if value is None else ("gain", value))


def _joint(background: Background, generator: np.random.Generator) -> int:
    return int(generator.integers(background.robot.n))


def _sign(generator: np.random.Generator) -> float:
    return float(generator.choice([-1.0, 1.0]))


def _inject_gain_one(background: Background, generator: np.random.Generator) -> Fault:
    joint, value = _joint(background, generator), 1.0 + _sign(generator) * generator.uniform(0.1, 0.4)
    scale = np.where(np.arange(background.robot.n) == joint, value, 1.0)
    return _scaled(background, scale, (("torque_sensor_gain", joint + 1),), value)


def _inject_gain_all(background: Background, generator: np.random.Generator) -> Fault:
    value = 1.0 + _sign(generator) * generator.uniform(0.1, 0.3)
    return _scaled(background, np.full(background.robot.n, value), (("torque_sensor_gain", None),), value)


def _inject_sign_one(background: Background, generator: np.random.Generator) -> Fault:
    joint = _joint(background, generator)
    scale = np.where(np.arange(background.robot.n) == joint, -1.0, 1.0)
    return _scaled(background, scale, (("inverted_torque_sign", joint + 1),), None)


def _inject_sign_all(background: Background, generator: np.random.Generator) -> Fault:
    del generator
    return _scaled(background, -np.ones(background.robot.n), (("inverted_torque_sign", None),), None)


def _friction(background: Background, generator: np.random.Generator, which: str) -> Fault:
    """30 to 100 % of the joint's torque at its usual speed as friction more."""
    joint = _joint(background, generator)
    _, dq, ddq = motion(background)
    size = generator.uniform(0.15, 0.5) * float(background.recording.torque[:, joint].std())
    column = {"viscous": dq[:, joint], "coulomb": np.tanh(dq[:, joint] / 0.02), "offset": np.ones(len(dq)),
              "rotor_inertia": ddq[:, joint]}[which]  # fmt: skip
    names = {"offset": ["torque_offset", "friction_change"], "rotor_inertia": ["rotor_inertia"]}.get(
        which, ["friction_change"]
    )
    return _own(background, joint, column, size / float(np.sqrt(np.mean(column**2))), names, which)


def _inject_zero(background: Background, generator: np.random.Generator) -> Fault:
    joint, value = _joint(background, generator), _sign(generator) * generator.uniform(0.03, 0.1)
    position = background.recording.position.copy()
    position[:, joint] -= value
    names: tuple[tuple[str, int | None], ...] = (("joint_zero_offset", joint + 1),)
    return Fault(replace(background.recording, position=position), names, ("offset", value))


def _inject_delay(background: Background, generator: np.random.Generator) -> Fault:
    recording, value = background.recording, generator.uniform(0.008, 0.03)
    torque = np.column_stack(
        [np.interp(recording.time - value, recording.time, column) for column in recording.torque.T]
    )
    return Fault(replace(recording, torque=torque), (("torque_delay", None),), ("delay", value))


def _inject_clock(background: Background, generator: np.random.Generator) -> Fault:
    recording, ratio = background.recording, float(np.exp(_sign(generator) * generator.uniform(0.1, 0.4)))
    velocity = recording.velocity
    slow = replace(
        recording, time=recording.time * ratio, sampling_period_s=recording.sampling_period_s * ratio, velocity=velocity
    )
    return Fault(slow, (("wrong_time_base", None),), ("ratio", ratio))


def _inject_degrees(background: Background, generator: np.random.Generator) -> Fault:
    del generator
    position = np.degrees(background.recording.position)
    return Fault(replace(background.recording, position=position), (("wrong_unit", None),), None)


def _inject_order(background: Background, generator: np.random.Generator) -> Fault:
    first, second = generator.choice(background.robot.n, 2, replace=False)
    torque = background.recording.torque.copy()
    torque[:, [first, second]] = torque[:, [second, first]]
    return Fault(replace(background.recording, torque=torque), (("wrong_joint_order", None),), None)


KINDS: dict[str, Injection] = {
    "load on the flange": lambda b, g: _body(b, g, b.robot.n - 1, 1.0),
    "load taken off": lambda b, g: _body(b, g, b.robot.n - 1, -1.0),
    "load on a link": lambda b, g: _body(b, g, int(g.integers(2, b.robot.n - 2)), 1.0),
    "base leaning": lambda b, g: _leaning(b, g, 3.0, 10.0),
    "base turned": lambda b, g: _leaning(b, g, 30.0, 180.0),
    "one sign": _inject_sign_one,
    "all signs": _inject_sign_all,
    "one scale": _inject_gain_one,
    "all scales": _inject_gain_all,
    "viscous friction": lambda b, g: _friction(b, g, "viscous"),
    "Coulomb friction": lambda b, g: _friction(b, g, "coulomb"),
    "offset": lambda b, g: _friction(b, g, "offset"),
    "rotor inertia": lambda b, g: _friction(b, g, "rotor_inertia"),
    "zero of a joint": _inject_zero,
    "late torque": _inject_delay,
    "clock": _inject_clock,
    "degrees": _inject_degrees,
    "order of joints": _inject_order,
}


def judged(fault: Fault, result: Audit) -> tuple[str, bool | None]:
    """The word right, silent or wrong, and whether the interval of the fault's number holds; None where it has none."""
    if not result.differences:
        return "silent", None
    named = [(item.effect, item.joint if item.joint is not None else item.link) for item in result.differences]
    one = result.differences[0]
    also = [(one.effect, one.joint if one.joint is not None else one.link), *one.alternatives]
    if len(named) > 1 or not any(name in also for name in fault.names):
        return "wrong", None
    if fault.number is None:
        return "right", None
    number = next((item for item in one.numbers if item.name == fault.number[0]), None)
    return "right", None if number is None else number.interval[0] <= fault.number[1] <= number.interval[1]


def known(background: Background, fault: Fault) -> tuple[float, float]:
    """Nats of a fault's own kind at its own place against nothing: for one who knows them, and for one who does not.

    Both nan for kinds that no number says.
    """
    clean, faulty = (
        compared([recording], background.robot, background.model)
        for recording in (background.recording, fault.recording)
    )
    faulty = replace(faulty, noise=clean.noise)
    own = [
        item
        for item in possible(faulty)
        if (item.effect, next((each + 1 for each in (item.joint, item.link) if each is not None), None)) in fault.names
    ]
    found = [(gain_of(faulty, item), item.log_odds) for item in own] or [(float("nan"), 0.0)]
    return max(gain - log_odds for gain, log_odds in found), max(gain for gain, _ in found)


def main() -> int:
    """Inject, audit, count; print a line a kind."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--kinds", default="")
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    generator = np.random.default_rng(arguments.seed)
    kinds = [kind for kind in KINDS if not arguments.kinds or kind in arguments.kinds.split(",")]
    with tempfile.TemporaryDirectory() as folder:
        found = backgrounds(Path(folder))
    table: dict[str, Counter[str]] = {kind: Counter() for kind in (*kinds, "clean")}
    held: list[bool] = []
    loads: list[tuple[float, bool]] = []
    started, runs = time.process_time(), 0
    for background in found:
        clean = audit([background.recording], background.robot, background.model)
        table["clean"]["right" if not clean.differences else "wrong"] += 1
        for kind in kinds * arguments.rounds:
            fault = KINDS[kind](background, generator)
            try:
                result = audit([fault.recording], background.robot, background.model)
                verdict, holds = judged(fault, result)
                said = result.sentence
                if holds is not None and fault.names[0][0] == "payload" and fault.number is not None:
                    loads.append((result.differences[0].numbers[0].value / fault.number[1] - 1.0, bool(holds)))
            except IdentificationError as error:
                verdict, holds, said = "silent", None, str(error)
            runs += 1
            table[kind][verdict] += 1
            nats, unknown = known(background, fault) if verdict == "silent" else 2 * (float("nan"),)
            table[kind]["seen"] += int(nats >= LEAST_GAIN)
            table[kind]["found"] += int(unknown >= LEAST_GAIN)
            held += [] if holds is None else [bool(holds)]
            if arguments.verbose and (verdict != "right" or holds is False):
                put_in = f"{background.name}, {kind} {fault.names} {fault.number}"
                print(f"{put_in}: {verdict} {holds} {nats / LEAST_GAIN:.1f}: {said}", flush=True)
    total: Counter[str] = Counter()
    print(f"{'':23} right silent  wrong   seen  found (of the silent)")
    for kind, counts in table.items():
        print(f"{kind:22} {' '.join(f'{counts[name]:6}' for name in (*VERDICTS, 'seen', 'found'))}")
        total += counts if kind != "clean" else Counter()
    count = max(1, sum(total[name] for name in VERDICTS))
    shares = "  ".join(f"{name} {100 * total[name] / count:.0f} %" for name in VERDICTS)
    print(f"together: {shares}; could be seen {total['seen']} of {total['silent']} silent ones, found {total['found']}")
    print(f"95 % intervals that hold: {100 * np.mean(held) if held else float('nan'):.0f} % of {len(held)}")
    if loads:
        near, inside = (sum(item) for item in zip(*((abs(error) < 0.1, holds) for error, holds in loads), strict=True))
        print(f"loads named alone {len(loads)}: mass within 10 % {near}, interval holds {inside}")
    spent = (time.process_time() - started) / max(1, runs)
    print(f"seed {arguments.seed}, {len(found)} recordings, {spent:.2f} s CPU each")
    if arguments.json:
        arguments.json.write_text(json.dumps({"kinds": table, "together": total, "held": held}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
