"""The paper's Table 4 on a fake robot: identified models scored on the four reference trajectories of section 4.6.

Reproduce: `OPENBLAS_NUM_THREADS=1 python -m benchmarks.reference_trajectories --seed 1`.
Each trajectory is written to a file, checked by the preflight, recorded from a fake robot over FRI in lockstep and
scored. Prints RMS per joint of the model fitted to the first one, beside the paper's and beside the noise floor of the
recorded mean, and the same four recordings with each left out of the fit in turn. A fake robot has the physics of the
model and white noise: the figures show what is added on the way from file to table, not what an arm will show.

Two bands. "Below 10 Hz" scores all four alike: those are the lines that fits compare, and the motion up to 20 Hz, which
their products and signs mix, stands above the noise of the position. Over the whole band the polynomials lie higher,
since their jerk jumps at every waypoint: what they have above 20 Hz is torque in the measurement and no motion in the
model. A wider motion band does not mend that: with 40 Hz the position's noise raises the excitation's residual by 30 %.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

from daemon.motion.clearance import safe_in
from daemon.motion.preparation import prepare_motion
from daemon.motion.workspace import load_surroundings
from daemon.run.demonstration import record
from identification.excitation import iiwa_limits
from identification.excitation.reference import REFERENCE_KINDS, reference_trajectory
from identification.recording_fit import FitResult, FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import load_robot
from identification.signals.periodic import process_periodic
from identification.validation import cross_validate, validate_model

FloatArray = npt.NDArray[np.float64]

PAPER = {
    # Table 4, Nm, joints 1 to 7; the paper states base parameters for the first trajectory only.
    ("excitation", "base"): (0.29, 0.36, 0.13, 0.15, 0.08, 0.18, 0.06),
    ("excitation", "physical"): (0.35, 0.39, 0.14, 0.17, 0.09, 0.21, 0.10),
    ("sine_series", "physical"): (0.34, 0.44, 0.23, 0.17, 0.12, 0.22, 0.12),
    ("polynomial_10", "physical"): (0.55, 0.48, 0.23, 0.25, 0.15, 0.22, 0.12),
    ("polynomial_20", "physical"): (0.43, 0.74, 0.15, 0.27, 0.06, 0.15, 0.06),
}


def main() -> None:
    """Parse, record the four, score, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of the random trajectories and of the noise")
    parser.add_argument("--periods", type=int, default=16, help="of each recording")
    parser.add_argument("--folder", type=Path, default=None, help="keep all files here, and take recordings from here")
    parser.add_argument("--no-folds", action="store_true", help="leave out the four fits of the folds")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.folder or Path(scratch)
        recordings = [
            recorded(kind, number, folder, arguments.seed, arguments.periods)
            for number, kind in enumerate(REFERENCE_KINDS)
        ]
        score(recordings, not arguments.no_folds)


def recorded(kind: str, number: int, folder: Path, seed: int, periods: int) -> Recording:
    """One trajectory from file to recording."""
    acceptable = safe_in(load_surroundings("iiwa14"), "iiwa14", None)
    trajectory = reference_trajectory(
        kind, iiwa_limits("iiwa14"), seed, robot=load_robot("iiwa14"), acceptable=acceptable
    )
    folder.mkdir(parents=True, exist_ok=True)
    file, log = folder / f"{kind}.json", folder / kind / "recording.mcap"
    if log.is_file() and (folder / kind / "run.json").is_file():
        print(f"q_ref,{number + 1} {kind}: recording taken from {log}")
        return read_recording(log)
    file.write_text(json.dumps(trajectory.to_json(), indent=1) + "\n", encoding="utf-8")
    motion = prepare_motion(file, robot="iiwa14")
    began = time.monotonic()
    outcome = record(
        motion, folder / kind, periods=periods, seed=seed + number, realtime=False, fit=False, observe=lambda _: None
    )
    print(
        f"q_ref,{number + 1} {kind}: preflight {'safe' if motion.preflight.safe else 'NOT SAFE'}, {periods} periods of "
        f"{trajectory.period_s:g} s recorded in {time.monotonic() - began:.0f} s, exit code {outcome.exit_code}",
        flush=True,
    )
    return read_recording(log)


def score(recordings: list[Recording], with_folds: bool) -> None:
    """Table 4 and the folds."""
    robot = load_robot("iiwa14")
    result = fit_recordings(recordings[:1], robot)
    print(
        f"\nRMS, Nm, of the model fitted to q_ref,1\n{'':<26}"
        + "".join(f"{joint:8d}" for joint in range(1, 8))
        + "     sum"
    )
    for kind, recording in zip(REFERENCE_KINDS, recordings, strict=True):
        table = validate_model(result, [recording])
        for label, row in zip(("base", "physical"), table.rows, strict=True):
            line(f"{kind}, {label}", row.rms_nm)
            if (kind, label) in PAPER:
                line("  the paper's arm", np.array(PAPER[kind, label]))
        line("  noise alone", table.rows[0].noise_floor_nm)
        below, noise = in_fitted_band(recording, result)
        line("  below 10 Hz, base", below["base"])
        line("  below 10 Hz, physical", below["physical"])
        line("  below 10 Hz, noise alone", noise)
    if with_folds:
        print("\neach recording scored by a fit of the other three, Nm")
        folds = cross_validate(recordings, robot, FitSettings(physical=False))
        for label, row in zip((*REFERENCE_KINDS, "all"), folds.rows, strict=True):
            line(f"{label}, left out", row.rms_nm)


def in_fitted_band(recording: Recording, result: FitResult) -> tuple[dict[str, FloatArray], FloatArray]:
    """(n,) RMS of the residuals on the lines that fits compare, and of the noise on the same lines, Nm."""
    signals = process_periodic(recording)
    matrix = result.regressor.matrix(signals.position, signals.velocity, signals.acceleration)
    assert signals.row_noise is not None, "several periods know their noise"
    assert result.constrained is not None, "physical parameters were asked for"
    samples = len(signals.time)
    below = {}
    for label, values in (("base", result.values), ("physical", result.constrained.base_values)):
        rows = signals.project(signals.torque - matrix @ values)
        below[label] = np.sqrt(np.sum(rows**2, axis=0) / samples)
    return below, np.sqrt(np.sum(signals.row_noise**2, axis=0) / samples)


def line(label: str, values: FloatArray) -> None:
    """One row of numbers."""
    print(f"{label:<26}" + "".join(f"{value:8.4f}" for value in values) + f"{float(values.sum()):8.3f}")


if __name__ == "__main__":
    main()
