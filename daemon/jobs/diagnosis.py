"""A diagnosis from files to files: recordings in, `diagnosis.json`, `model.json` and `report.html` out.

Here: reading, calling, writing. Not here: any computation (`identification.mismatch`), and what is printed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from daemon.folders import make_folder
from daemon.json_files import write_bytes_atomically
from identification.audit.difference import Difference
from identification.audit.otherwise import may_be_read_otherwise
from identification.audit.reading import Reading
from identification.errors import RecordingError
from identification.export.write_back import draw_before_after, write_back
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.extended_model import extended_model
from identification.mismatch.findings import Diagnosis
from identification.mismatch.set_up import SetUpCheck, set_up_checks
from identification.mismatch.settings import DiagnosisSettings
from identification.model_file import Model, read_model, write_model
from identification.recordings import Recording
from identification.report import write_report
from identification.robots import RobotModel

Progress = Callable[[str, float], None]
_SHARE_OF_DIAGNOSIS = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisFiles:
    """A diagnosis, and the files in which it, its extended model and its page stand."""

    diagnosis: Diagnosis
    files: tuple[Path, ...]


def diagnose_recordings(
    recordings: Sequence[Recording],
    heldout: Sequence[Recording],
    robot: RobotModel,
    out: Path,
    *,
    baseline: Path | None = None,
    settings: DiagnosisSettings | None = None,
    progress: Progress | None = None,
) -> DiagnosisFiles:
    """Diagnose recordings and write the results into the folder `out`, which is made if it is not there.

    baseline: the model to diagnose against, None for a nominal fit. settings: None for the defaults. Raises the errors
    of the recordings, of the diagnosis, and OSError.
    """
    report = progress or (lambda *_: None)
    diagnosis = diagnose(
        recordings,
        robot,
        heldout=heldout,
        settings=settings,
        model=_baseline(baseline),
        progress=lambda phase, share: report(f"diagnosis: {phase}", _SHARE_OF_DIAGNOSIS * share),
    )
    there = diagnosis.standing(robot)
    model = extended_model(
        diagnosis,
        recordings,
        there,
        progress=lambda phase, share: report(
            f"extended model: {phase}", _SHARE_OF_DIAGNOSIS + (1.0 - _SHARE_OF_DIAGNOSIS) * share
        ),
    )
    make_folder(out)
    result_file = out / "diagnosis.json"
    text = json.dumps(diagnosis.to_json(), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    write_bytes_atomically(str(result_file), text.encode())
    model_file = write_model(model, out / "model.json")
    report_file = out / "report.html"
    fit_page = out.parent / report_file.name
    links = [(f"../{fit_page.name}", "The fit of this run")] if fit_page.is_file() else []
    write_report(
        report_file, diagnosis=diagnosis, set_up=_set_up(recordings, robot, diagnosis), model=model,
        recordings=diagnosis.as_read(recordings, robot), heldout=heldout, robot=there, links=links,
    )  # fmt: skip
    return DiagnosisFiles(diagnosis, (result_file, model_file, report_file))


@dataclass(frozen=True, slots=True)
class ModelFiles:
    """A simulator's file with what was found, and its figure; lines: what stands in it now and what does not."""

    lines: tuple[str, ...]
    files: tuple[Path, ...]


def write_model_back(
    recordings: Sequence[Recording],
    robot: RobotModel,
    source: Path,
    differences: Sequence[Difference],
    target: Path,
    reading: Reading | None = None,
) -> ModelFiles:
    """Write the differences into a simulator's file, and beside it the torque before and after as a picture.

    reading: how the recordings are to be read. Raises the errors of `identification.export.amend`, and OSError.
    """
    make_folder(target.parent)
    written = write_back(recordings, robot, source, differences, target, reading)
    picture = target.with_name(f"{target.name}.png")
    draw_before_after(written).savefig(picture, dpi=110)
    return ModelFiles((*written.amended.written, *written.amended.left, written.sentence), (target, picture))


def _set_up(recordings: Sequence[Recording], robot: RobotModel, diagnosis: Diagnosis) -> tuple[SetUpCheck, ...]:
    """The verdicts for the page; none of recordings that are too short to be asked."""
    before = diagnosis.baseline
    large = not before.noise_is_measured or may_be_read_otherwise(before.excess_nm / before.noise_floor_nm)
    try:
        return set_up_checks(recordings, robot, diagnosis.every_fault, large=large)
    except RecordingError:
        return ()


def _baseline(file: Path | None) -> Model | Path | None:
    """A model.json as read; a simulator's file is read by the diagnosis, which knows the robot's parameters."""
    return read_model(file) if file is not None and file.suffix == ".json" else file
