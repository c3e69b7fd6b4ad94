"""Held-out RMS in percent of the RMS torque on the three real recordings, beside a plain baseline measured before.

Run: python -m benchmarks.real_recordings [--json FILE]. The Panda's recording is not shipped (licence): it is looked
for in the folder shared/recordings beside the checkout, and its row is left out where it is not there.
The baseline is rigid body + rotor inertia + viscous + Coulomb + offset, weighted least squares, zero-phase low-pass.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

from fixtures.real_recordings import real_recording
from identification.fitting.rms import RmsTable
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import read_recording
from identification.recordings.reader import robot_of
from identification.robots import load_robot
from identification.validation import validate_model

BASELINE = {
    "panda": (9.2, 1.2, 2.3, 1.2, 7.4, 3.7, 19.7),
    "tx40": (7.0, 8.0, 11.0, 13.0, 62.0, 29.0),
    "kr300": (7.4, 6.1, 5.4, 18.0, 7.4, 8.7),
}
ALLOWED = 1.15


def main() -> int:
    """Fit, try on held-out rows, print the table; exit status 1 if panda or tx40 is worse than 1.15 × the baseline."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    results: dict[str, list[float]] = {}
    failed = False
    for name, files, tried, settings in (
        ("panda", ["panda_excitation.npz"], None, FitSettings(low_pass_hz=10.0, split="first:0.6")),
        ("tx40", ["tx40_excitation.npz"], None, FitSettings(low_pass_hz=40.0, split="blocks:0.5:3")),
        ("kr300", ["kr300_a.npz"], "kr300_b.npz", FitSettings(low_pass_hz=8.0)),
        ("kr300", ["kr300_b.npz"], "kr300_a.npz", FitSettings(low_pass_hz=8.0)),
    ):
        start = time.perf_counter()
        try:
            recordings = [read_recording(real_recording(file)) for file in files]
        except FileNotFoundError as error:
            print(f"\n{name}: left out, {error}")
            continue
        result = fit_recordings(recordings, load_robot(robot_of(recordings)), settings)
        table: RmsTable = result.rms
        if tried is not None:
            table = validate_model(result, [read_recording(real_recording(tried))])
        held_out = {row.label: row.percent for row in table.rows if not row.label.startswith("fit")}
        options = result.regressor.options
        extras = [text for text, on in (("rotor inertia", options.rotor_inertia), ("offset", options.offset)) if on]
        print(
            f"\n{name}: {', '.join(files)} → {tried or settings.split}, {settings.low_pass_hz:g} Hz, "
            f"{len(result.names)} parameters ({', '.join(extras) or 'no drive parameters'}), "
            f"{time.perf_counter() - start:.1f} s"
        )
        baseline = np.array(BASELINE[name])
        label = "baseline (fit on A+B, tried on a third run)" if name == "kr300" else "baseline"
        print(_line(label, baseline))
        for row, percent in held_out.items():
            results[f"{name} {row}"] = [float(value) for value in percent]
            print(_line(row, percent))
        if tried is None:
            ratio = held_out["held out, base"] / baseline
            print(_line("ratio, base / baseline", ratio, digits=2))
            failed |= bool(np.any(ratio > ALLOWED))
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=1) + "\n")
    return int(failed)


def _line(label: str, values: np.ndarray, digits: int = 1) -> str:
    return f"  {label:<44s}" + "".join(f"{value:8.{digits}f}" for value in values)


if __name__ == "__main__":
    sys.exit(main())
