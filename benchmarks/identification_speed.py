"""Speed of the regressor and of the whole base fit beside Pinocchio's loop and FIGAROH, on the same samples.

Run: python -m benchmarks.identification_speed [--repeats 7]. FIGAROH comes with `pip install -e '.[bench]'`; without it
its rows are left out. The data: one period of the shipped excitation at 1 kHz (10 000 samples, iiwa 14), torque by
Pinocchio's inverse dynamics of a drawn arm, plus friction and white noise (seed printed). All use one BLAS thread, and
times are CPU time of this process. The tools take turns, so that neighbours on the machine, who take caches and clock,
slow all alike; read the ratios.

What a fit is, for each: from q, q̇, q̈ and torque to the values of the base parameters, the choice of these parameters
included. Ours is what `iiwa-ident fit` runs between processed signals and base parameters: columns to the spectral
lines of the period, maximum likelihood with σ that hold on coloured noise, RMS over time. "Ours, eq. (9) on all rows"
is the paper's least squares from the same columns, with the σ of eq. (15): the estimate that FIGAROH makes, whose
quality figures and reports are left out of its time. Answers are compared as base parameters of ours and as torque by
Pinocchio's regressor.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import importlib.metadata
import logging
import platform
import sys
import time
import warnings
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio

from identification.base_parameters import BaseRegressor
from identification.estimators.least_squares import LeastSquaresResult, solve_least_squares
from identification.estimators.observation import compress_joints
from identification.excitation import default_trajectory
from identification.fitting.blocks import build_block
from identification.fitting.estimate import estimate_parameters
from identification.recordings import ImportReport, Recording, RecordingSource
from identification.robots import RobotModel, load_robot
from identification.robots.model import build_pinocchio_model
from identification.signals.periodic import process_periodic
from identification.signals.processed import ProcessedSignals

FloatArray = npt.NDArray[np.float64]
Samples = tuple[FloatArray, FloatArray, FloatArray, FloatArray]  # q, q̇, q̈ and torque, each (S, n)

SEED = 4
NOISE_NM = 0.2
IN_A_ROW = 3  # a regressor is over so quickly that the peer before it, leaving caches and heap cold, would show
REGRESSOR_TARGET_US = 1.3
FIT_TARGET_RATIO = 25.0

# Pinocchio orders a link's tensor Ixx Ixy Iyy Ixz Iyz Izz, eq. (3) XX XY XZ YY YZ ZZ.
FROM_PINOCCHIO = (0, 1, 2, 3, 4, 5, 7, 6, 8, 9)

STORED = "ours, stored as the fit reads it"
OURS = "ours, as `fit` runs it"
OURS_ALL = "ours, eq. (9) on all rows"
FIGAROH_ALL = "FIGAROH, all rows"
FIGAROH_DEFAULT = "FIGAROH, its default decimation by 10"


def main() -> int:
    """Print times, ratios and how far the answers are apart; 1 if a target is missed or the answers differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    robot = load_robot("iiwa14")
    base = BaseRegressor(robot)
    samples = drawn_samples(robot)
    count = len(samples[0])
    signals = process_periodic(recorded(samples))

    regressors: dict[str, Callable[[], Any]] = {
        STORED: lambda: base.joint_columns(*samples[:3]),
        "ours, one matrix": lambda: base.stacked(*samples[:3]),
        "Pinocchio loop, stored": lambda: pinocchio_regressor(robot, samples),
    }
    fits: dict[str, Callable[[], FloatArray]] = {
        OURS: lambda: _full(base, our_fit(BaseRegressor(robot), signals)),
        OURS_ALL: lambda: _full(base, least_squares(BaseRegressor(robot), samples).values),
        "Pinocchio loop, lstsq of our columns": lambda: pinocchio_fit(robot, base, samples),
    }
    peer = Figaroh.load(robot, samples)
    if peer is not None:
        regressors["FIGAROH build_regressor_basic"] = peer.calculate_regressor
        fits[FIGAROH_ALL] = lambda: peer.fit(decimate=False)
        fits[FIGAROH_DEFAULT] = lambda: peer.fit(decimate=True)
    _print_versions(count, repeats)

    times: dict[str, list[float]] = {name: [] for name in [*regressors, *fits]}
    answers: dict[str, FloatArray] = {}
    for _ in range(repeats):
        for name, regressor in regressors.items():
            for _ in range(IN_A_ROW):
                began = time.process_time()
                regressor()
                times[name].append(1e3 * (time.process_time() - began))
        for name, fit in fits.items():
            began = time.process_time()
            answers[name] = fit()
            times[name].append(1e3 * (time.process_time() - began))
    _print_times("regressor", regressors, times, STORED, count)
    _print_times("fit of the base parameters", fits, times, OURS, count)
    same = _print_differences(base, robot, samples, answers)

    per_sample = 1e3 * float(np.median(times[STORED])) / count
    passed = _verdict(
        f"regressor {per_sample:.2f} µs a sample, target {REGRESSOR_TARGET_US}", per_sample <= REGRESSOR_TARGET_US
    )
    if peer is not None:
        ratio = float(np.median(times[FIGAROH_ALL]) / np.median(times[OURS]))
        sentence = f"fit {ratio:.0f} times as fast as FIGAROH's on all rows, target {FIT_TARGET_RATIO:.0f}"
        passed &= _verdict(sentence, ratio >= FIT_TARGET_RATIO)
    passed &= _verdict("same answers on all rows to 1e-9 Nm", same)
    return 0 if passed else 1


def drawn_samples(robot: RobotModel) -> Samples:
    """One period of the shipped excitation at 1 kHz; the torque of an arm of drawn boxes with friction and noise."""
    generator = np.random.default_rng(SEED)
    trajectory = default_trajectory()
    q, dq, ddq = trajectory.evaluate(np.arange(round(1000 * trajectory.period_s)) * 1e-3)
    inertias = []
    for mass, center, sides in zip(
        generator.uniform(1.0, 5.0, robot.n),
        generator.uniform(-0.1, 0.1, (robot.n, 3)),
        generator.uniform(0.05, 0.3, (robot.n, 3)),
        strict=True,
    ):
        box = pinocchio.Inertia.FromBox(mass, *sides)
        box.lever = center
        inertias.append(box)
    model = build_pinocchio_model("truth", robot.kinematics, robot.joint_names, robot.gravity, tuple(inertias))
    data = model.createData()
    torque = np.array([pinocchio.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])
    torque += generator.uniform(0.1, 0.5, robot.n) * dq + generator.uniform(0.1, 0.5, robot.n) * np.sign(dq)
    return q, dq, ddq, torque + NOISE_NM * generator.normal(size=torque.shape)


def recorded(samples: Samples) -> Recording:
    """The samples as a recording of one period."""
    count = len(samples[0])
    return Recording(
        time=np.arange(count, dtype=np.float64) * 1e-3,
        position=samples[0],
        torque=samples[3],
        sampling_period_s=1e-3,
        source=RecordingSource("simulated", "", "log"),
        report=ImportReport(count, count),
        robot="iiwa14",
        period_index=np.zeros(count, dtype=np.int64),
        sample_in_period=np.arange(count),
        period_s=count * 1e-3,
        samples_per_period=count,
    )


def our_fit(base: BaseRegressor, signals: ProcessedSignals) -> FloatArray:
    """Base parameters (p,) by the fit's own steps and its default estimator."""
    block = build_block(signals, base, None, 0.0, float(signals.time[-1]))
    assert block is not None, "the robot moves"
    return estimate_parameters([block], base.names, "maximum_likelihood").least_squares.values


def least_squares(base: BaseRegressor, samples: Samples) -> LeastSquaresResult:
    """The paper's least squares, eq. (9) with (15)."""
    columns = zip(base.joint_columns(*samples[:3]), samples[3].T, strict=True)
    joints = [(packed, positions, torque) for (packed, positions), torque in columns]
    return solve_least_squares(compress_joints(joints, base.names), weighting="none")


def pinocchio_regressor(robot: RobotModel, samples: Samples) -> FloatArray:
    """The regressor that Pinocchio's loop gives, (S, n, 10 n), in its own order of the tensor."""
    data = robot.pinocchio_model.createData()
    q, dq, ddq, _ = samples
    result = np.empty((len(q), robot.n, 10 * robot.n))
    for row, state in enumerate(zip(q, dq, ddq, strict=True)):
        result[row] = pinocchio.computeJointTorqueRegressor(robot.pinocchio_model, data, *state)
    return result


def full_regressor(robot: RobotModel, samples: Samples) -> FloatArray:
    """The same with friction, (S, n, 12 n), in our order of all dynamic parameters."""
    result = np.zeros((len(samples[0]), robot.n, robot.n, 12))
    theirs = pinocchio_regressor(robot, samples).reshape(len(result), robot.n, robot.n, 10)
    result[..., :10] = theirs[..., FROM_PINOCCHIO]
    joints = np.arange(robot.n)
    result[:, joints, joints, 10] = samples[1]
    result[:, joints, joints, 11] = np.sign(samples[1])
    return result.reshape(len(result), robot.n, -1)


def pinocchio_fit(robot: RobotModel, base: BaseRegressor, samples: Samples) -> FloatArray:
    """What one writes first: the loop, the columns of our base parameters, numpy's least squares."""
    columns = full_regressor(robot, samples)[:, :, base.kept].reshape(-1, base.size)
    return _full(base, np.asarray(np.linalg.lstsq(columns, samples[3].ravel(), rcond=None)[0], dtype=np.float64))


class Figaroh:
    """FIGAROH's own steps from the samples to base parameters, as its `BaseIdentification.solve` takes them."""

    def __init__(self, problem: Any, n: int) -> None:
        self._problem = problem
        self._n = n

    @classmethod
    def load(cls, robot: RobotModel, samples: Samples) -> Figaroh | None:
        """None, with a message, where it is not installed."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                from figaroh.identification.base_identification import (  # type: ignore[import-untyped, import-not-found, unused-ignore]
                    BaseIdentification,
                )
        except ImportError as error:
            print(f"FIGAROH is left out ({error}); pip install -e '.[bench]' brings it.", file=sys.stderr)
            return None
        logging.getLogger("figaroh").setLevel(logging.ERROR)

        class Problem(BaseIdentification):  # type: ignore[misc]
            def __init__(self) -> None:  # no configuration file: the settings stand below
                self.model = robot.pinocchio_model.copy()
                for link in range(1, self.model.njoints):
                    self.model.inertias[link] = pinocchio.Inertia.FromSphere(1.0, 0.1)
                self.robot = SimpleNamespace(model=self.model, data=self.model.createData())
                self.identif_config = {
                    "is_joint_torques": True,
                    "has_friction": True,
                    "act_idxv": list(range(robot.n)),
                    "fv": [0.0] * robot.n,
                    "fs": [0.0] * robot.n,
                }
                names = ("positions", "velocities", "accelerations", "torques")
                self.processed_data = dict(zip(names, samples, strict=True))
                self.num_samples = len(samples[0])

            def load_trajectory_data(self, data_source: str | None = None) -> None:
                """Nothing: the samples are there."""

        problem = Problem()
        problem.initialize_standard_parameters()
        return cls(problem, robot.n)

    def calculate_regressor(self) -> None:
        """All columns of all rows, (n S, 12 n), kept in the problem."""
        self._problem.calculate_full_regressor()

    def fit(self, *, decimate: bool) -> FloatArray:
        """Dynamic parameters (full,) in our order that have its base parameters; the others of each group are zero."""
        problem = self._problem
        problem.calculate_full_regressor()
        reduced, active = problem._eliminate_zero_columns(0.001)
        prepare = (
            problem._apply_decimation if decimate else lambda reduced, _: problem._prepare_undecimated_data(reduced)
        )
        torque, columns = prepare(reduced, 10)
        result = problem._calculate_base_parameters(torque, columns, active)
        kept = np.delete(np.arange(12 * self._n), problem._idx_eliminated)[problem._base_indices]
        theirs = np.zeros(12 * self._n)
        theirs[kept] = result["phi_base"]
        ours = np.zeros((self._n, 12))
        ours[:, :10] = theirs[: 10 * self._n].reshape(self._n, 10)[:, FROM_PINOCCHIO]
        ours[:, 10:] = theirs[10 * self._n :].reshape(2, self._n).T
        return ours.ravel()


def _full(base: BaseRegressor, values: FloatArray) -> FloatArray:
    """Dynamic parameters with these base parameters: each group's value on its first member."""
    full = np.zeros(len(base.full_names))
    full[base.kept] = values
    return full


def _print_versions(count: int, repeats: int) -> None:
    names = ("iiwa-ident", "numpy", "scipy", "pin", "figaroh")
    versions = []
    for name in names:
        try:
            versions.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    print(f"python -m benchmarks.identification_speed --repeats {repeats}: {count} samples, 7 joints, seed {SEED}")
    print(f"Python {platform.python_version()}, " + ", ".join(versions))
    print(f"BLAS threads: {os.environ['OPENBLAS_NUM_THREADS']}")


def _print_times(
    title: str, names: dict[str, Callable[[], Any]], times: dict[str, list[float]], reference: str, count: int
) -> None:
    print(f"\n{title:<42s}{'median ms':>10s}{'least ms':>10s}{'µs/sample':>11s}{'ratio':>8s}")
    for name in names:
        median = float(np.median(times[name]))
        ratio = median / float(np.median(times[reference]))
        print(f"  {name:<40s}{median:10.1f}{min(times[name]):10.1f}{1e3 * median / count:11.2f}{ratio:8.1f}")


def _print_differences(
    base: BaseRegressor, robot: RobotModel, samples: Samples, answers: dict[str, FloatArray]
) -> bool:
    """Largest difference of each answer from ours; whether those on all rows agree to 1e-9 Nm."""
    sigma = least_squares(base, samples).std
    columns = full_regressor(robot, samples)
    print(f"\n{'largest difference from eq. (9)':<42s}{'parameter':>12s}{'in σ':>10s}{'torque, Nm':>12s}")
    same = True
    for name, full in answers.items():
        difference = np.abs(base.base_from_full(full - answers[OURS_ALL]))
        torque = float(np.abs(columns @ (full - answers[OURS_ALL])).max())
        print(f"  {name:<40s}{difference.max():12.1e}{(difference / sigma).max():10.1e}{torque:12.1e}")
        if name not in (OURS, FIGAROH_DEFAULT):  # other weights, fewer rows: another estimate
            same &= torque < 1e-9
    return same


def _verdict(sentence: str, passed: bool) -> bool:
    print(f"{'met   ' if passed else 'MISSED'} {sentence}")
    return passed


if __name__ == "__main__":
    sys.exit(main())
