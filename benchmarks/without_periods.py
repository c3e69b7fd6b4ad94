"""Recordings without periods: what is said of a clean arm, and of one that hides a torque of middle strength.

Reproduce: `OPENBLAS_NUM_THREADS=1 python -m benchmarks.without_periods --cases 14 --seed 5`. A random arm runs a smooth
random motion (even numbers) or from point to point (odd ones) for 100 s at 1 kHz, and a second motion that is held out.
Every seventh case is clean; the others hide one torque whose RMS is `--size` times the RMS of the joint's noise, beyond
what base parameters take up. Per case: verdict, names, classes, joints with "unexplained" torque, process time.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt

from fixtures.cases.arm import JOINTS, Arm, nominal_columns, random_links
from fixtures.cases.classes import CLASSES
from fixtures.cases.excitation import RATE_HZ, Excitation
from fixtures.cases.families import FAMILIES
from fixtures.cases.noise import draw_noise, measured_position
from fixtures.cases.scene import LIBRARY_FORM, Hidden, Scene
from identification.mismatch.diagnosis import diagnose
from identification.recordings import read_recording
from identification.robots import load_robot

FloatArray = npt.NDArray[np.float64]

DURATION_S = 100.0
HIDDEN = ("", "stribeck", "dahl", "ripple", "tilt", "xadj", "loadf")
REACH = np.radians([100.0, 70.0, 100.0, 70.0, 100.0, 70.0, 100.0])
SPEED = 0.7 * np.radians([85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0])
ACCELERATION = 5.0


def smooth(random: np.random.Generator) -> Excitation:
    """Twelve waves a joint at random frequencies below 0.5 Hz: nothing repeats."""
    clock = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)
    turning = 2.0 * np.pi * random.uniform(0.02, 0.5, (12, JOINTS))
    size, phase = random.normal(size=(12, JOINTS)), random.uniform(0.0, 2.0 * np.pi, (12, JOINTS))
    angle = clock[:, None, None] * turning + phase
    waves = (np.sin(angle), turning * np.cos(angle), -(turning**2) * np.sin(angle))
    return _scaled("smooth", clock, *((size * wave).sum(axis=1) for wave in waves))


def point_to_point(random: np.random.Generator) -> Excitation:
    """From rest to rest between random points, 1.5 s to 4 s each, as polynomials of degree five."""
    clock = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)
    position, velocity, acceleration = (np.zeros((clock.size, JOINTS)) for _ in range(3))
    start, here = 0.0, np.zeros(JOINTS)
    while start < DURATION_S:
        length, there = random.uniform(1.5, 4.0), random.uniform(-1.0, 1.0, JOINTS)
        inside = (clock >= start) & (clock < start + length)
        s = ((clock[inside] - start) / length)[:, None]
        position[inside] = here + (there - here) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        velocity[inside] = (there - here) * (30 * s**2 - 60 * s**3 + 30 * s**4) / length
        acceleration[inside] = (there - here) * (60 * s - 180 * s**2 + 120 * s**3) / length**2
        start, here = start + length, there
    return _scaled("point to point", clock, position, velocity, acceleration)


def _scaled(
    name: str, clock: FloatArray, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> Excitation:
    limits = (REACH, SPEED, ACCELERATION)
    scale = np.min(
        [
            limit / np.abs(values).max(axis=0)
            for limit, values in zip(limits, (position, velocity, acceleration), strict=True)
        ],
        axis=0,
    )
    return Excitation(name, clock, position * scale, velocity * scale, acceleration * scale)


def visible_rms(motion: Excitation, wave: FloatArray) -> FloatArray:
    """(7,) Nm RMS of what the nominal columns leave of a torque, least squares over every 20th sample."""
    thin = slice(None, None, 20)
    columns = nominal_columns(motion.position[thin], motion.velocity[thin], motion.acceleration[thin])
    matrix, rows = columns.reshape(-1, columns.shape[-1]), wave[thin]
    left = rows.ravel() - matrix @ np.linalg.lstsq(matrix, rows.ravel(), rcond=1e-9)[0]
    return np.asarray(np.sqrt(np.mean(left.reshape(rows.shape) ** 2, axis=0)))


def main() -> None:
    """Print what is said of each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=7)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--step", type=int, default=1)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--size", type=float, default=0.5)
    parser.add_argument("--alone", action="store_true", help="no second recording: blocks of the one are held out")
    options = parser.parse_args()
    for number in range(options.first, options.cases, options.step):
        random = np.random.default_rng([options.seed, number, 3])
        family = HIDDEN[number % len(HIDDEN)]
        noise, arm = draw_noise(random), Arm(random_links(random))
        make = smooth if number % 2 == 0 else point_to_point
        scenes = [Scene(arm, make(random), 1) for _ in range(1 if options.alone else 2)]
        hidden, title = None, "clean"
        true: tuple[str, ...] = ()
        if family:
            kind = FAMILIES[family]
            joint = int(random.choice(kind.joints))
            effect = Hidden(kind, joint, LIBRARY_FORM, kind.draw(random, joint, LIBRARY_FORM), kind.start)
            for _ in range(1 if kind.linear else 4):
                seen = visible_rms(scenes[0].motion, effect.torque(scenes[0]))
                share = float((seen / noise.rms).max())
                effect = replace(effect, size=min(kind.largest, effect.size * options.size / share))
            hidden, title = effect, f"{kind.effect} on joint {joint + 1 if kind.per_joint else 'arm'}"
            true = kind.classes or CLASSES[family]
        with TemporaryDirectory() as folder:
            recordings = []
            for name, scene in zip("AB", scenes, strict=False):
                torque = scene.torque + noise.draw(random, len(scene.motion.time))
                if hidden is not None:
                    torque = torque + hidden.torque(scene)
                path = Path(folder, f"{name}.npz")
                np.savez(
                    path,
                    t=scene.motion.time,
                    q=measured_position(random, scene.motion.position),
                    tau=torque,
                    robot=np.array("iiwa14"),
                )
                recordings.append(read_recording(path))
        start = time.process_time()
        diagnosis = diagnose(recordings[:1], load_robot("iiwa14"), heldout=recordings[1:])
        spent = time.process_time() - start
        names = [f"{item.effect} {item.place.joint or 'arm'}" for item in diagnosis.findings]
        classes = [
            f"{item.name} {item.joint} ({item.significance:.0f}{', named' if item.named else ''})"
            for item in diagnosis.classes
        ]
        print(
            f"{number:3} {scenes[0].motion.name}, {title}, {' or '.join(true)} [{spent:.1f} s] {diagnosis.verdict}\n"
            f"      names: {', '.join(names) or 'none'}; classes: {', '.join(classes) or 'none'}\n"
            f"      {diagnosis.remaining}",
            flush=True,
        )


if __name__ == "__main__":
    main()
