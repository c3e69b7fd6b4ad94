"""What is left out of the plain model on real robots: names, held-out RMS before and after, and what each claim costs.

Reproduce: `OPENBLAS_NUM_THREADS=1 python -m benchmarks.real_mismatch FOLDER`, FOLDER holding tx40_excitation.npz,
kr300_a.npz, kr300_b.npz, panda_excitation.npz and their URDFs. Figures are % of the RMS torque of the held-out rows, on
rows that were not fitted; seconds are of process time.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from identification.mismatch.diagnosis import diagnose
from identification.mismatch.findings import Diagnosis
from identification.mismatch.second_encoder import compare_encoders
from identification.mismatch.settings import DiagnosisSettings
from identification.recordings import Recording, read_recording
from identification.recordings.reader import robot_of
from identification.robots import load_robot

RUNS: tuple[tuple[tuple[str, ...], tuple[str, ...], str | None], ...] = (
    (("tx40_excitation",), (), None),
    (("tx40_excitation",), (), "blocks:0.5:3"),
    (("tx40_excitation",), (), "first:0.6"),
    (("panda_excitation",), (), None),
    (("panda_excitation",), (), "first:0.6"),
    (("kr300_a",), ("kr300_b",), None),
    (("kr300_b",), ("kr300_a",), None),
)


def main() -> None:
    """Diagnose every recording in its splits, then compare the two encoders of the KR300 in both directions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    for names, unseen, split in RUNS:
        fitted, heldout = (_read(folder, files) for files in (names, unseen))
        start = time.process_time()
        diagnosis = diagnose(
            fitted, load_robot(robot_of(fitted)), heldout=heldout, settings=DiagnosisSettings(split=split)
        )
        spent = time.process_time() - start
        title = f"{' '.join(names)} → {' '.join(unseen) or split or 'every third of fifteen blocks'}"
        _show(title, diagnosis, np.concatenate([item.torque for item in heldout or fitted]), spent)
    first, second = _read(folder, ("kr300_a", "kr300_b"))
    for one, other, title in ((first, second, "a → b"), (second, first, "b → a")):
        print(f"kr300 {title}")
        for item in compare_encoders([one], [other]):
            print(f"  {item.sentence}")


def _read(folder: Path, names: tuple[str, ...]) -> list[Recording]:
    return [read_recording(folder / f"{name}.npz") for name in names]


def _show(title: str, diagnosis: Diagnosis, torque: np.ndarray, seconds: float) -> None:
    print(f"{title}: {diagnosis.verdict}, {seconds:.1f} s")
    for finding in diagnosis.findings:
        print(f"  {finding.sentence} [{', '.join(item.effect for item in finding.alternatives)}]")
    assert diagnosis.heldout is not None
    size = np.sqrt(np.mean(torque**2, axis=0))
    for label, values in (("before", diagnosis.heldout.rms_before_nm), ("after", diagnosis.heldout.rms_after_nm)):
        print(f"  held out, {label:6} " + " ".join(f"{100 * value:6.1f}" for value in values / size))


if __name__ == "__main__":
    main()
