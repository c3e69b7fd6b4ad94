"""Many recordings at once: one job a file, on this machine's processors or on a Dask cluster.

Here: what one job does, and where jobs run. A file that fails does not stop the others.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from daemon.errors import ConfigurationError, exit_code_of, sentence_of
from daemon.folders import make_folder
from identification.errors import RecordingError

if TYPE_CHECKING:
    from identification.mismatch.findings import Diagnosis, Finding
    from identification.robots import Installation

Task = Literal["fit", "diagnose"]
RECORDING_NAME = "recording.mcap"
"""Of the log in the folder of every run."""


@dataclass(frozen=True, slots=True)
class BatchItem:
    """The outcome for one file. exit_code: as of the command alone; sentence: result or error; files: those written.

    name: of its folder. rms_nm: (n,) RMS of measured minus modelled torque, with the findings of a diagnosis, and
    noise_floor_nm: (n,) of the noise alone, None where it is not known; both empty after an error. tone: of its page.
    torque_units: "Nm", or "N" of a prismatic joint, by joint.
    """

    file: str
    exit_code: int
    sentence: str
    files: tuple[str, ...] = ()
    name: str = ""
    rms_nm: tuple[float | None, ...] = ()
    noise_floor_nm: tuple[float | None, ...] = ()
    tone: Literal["good", "attention", "neutral"] = "neutral"
    torque_units: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The item as plain JSON types."""
        document = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}
        del document["tone"]
        return document


def run_item(
    task: Task,
    file: str,
    folder: str,
    robot: str | None,
    heldout: tuple[str, ...],
    joints: Sequence[str] | None = None,
    installation: Installation | None = None,
) -> BatchItem:
    """Fit or diagnose one recording into a folder of its own; every error becomes the item's sentence and exit code."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from daemon.jobs.diagnosis import diagnose_recordings
        from identification.audit.mount import require_stated_stand
        from identification.json_values import json_list
        from identification.model_file import write_model
        from identification.recording_fit import fit_recordings
        from identification.recordings.reader import read_inputs
        from identification.report import write_report
        from identification.report.diagnosis_sections import tone_of
        from identification.report.fit_verdict import fit_verdict
        from identification.robots.joint_units import in_units

        out = Path(folder)
        make_folder(out)
        checking = heldout if task == "diagnose" else ()
        inputs = read_inputs([file, *checking], robot=robot, joints=joints, installation=installation)
        recording, *unseen = inputs.recordings
        require_stated_stand(inputs.recordings, inputs.robot)
        if task == "diagnose":
            found = diagnose_recordings([recording], unseen, inputs.robot, out)
            diagnosis = found.diagnosis
            baseline = diagnosis.baseline
            left = diagnosis.rms_after_nm if diagnosis.findings else baseline.rms_nm
            noise = json_list(baseline.noise_floor_nm) if baseline.noise_is_measured else [None] * left.size
            return BatchItem(
                file, 0, diagnosis_in_a_line(diagnosis), tuple(map(str, found.files)), out.name,
                tuple(json_list(left)), tuple(noise), tone_of(diagnosis), inputs.robot.units,
            )  # fmt: skip
        result = fit_recordings([recording], inputs.robot)
        model, target, page = result.to_model_json(), out / "model.json", out / "report.html"
        write_model(model, target)
        write_report(page, fit=result, model=model)
        rms, (sentence, tone) = result.rms.rows[0], fit_verdict(model)
        return BatchItem(
            file, 0, in_units(sentence, inputs.robot.units), (str(target), str(page)), out.name,
            tuple(json_list(rms.rms_nm)), tuple(json_list(rms.noise_floor_nm)), tone, inputs.robot.units,
        )  # fmt: skip
    except Exception as error:  # one bad file must not cost the others their result
        return BatchItem(file, exit_code_of(error), sentence_of(error), name=Path(folder).name)


def diagnosis_in_a_line(diagnosis: Diagnosis) -> str:
    """Verdict, names and faults of the data of one diagnosis among many."""
    names = ", ".join(_claim(finding) for finding in diagnosis.findings) or "nothing named"
    joints: dict[str, list[int]] = {}
    for fault in diagnosis.data_faults:
        joints.setdefault(fault.fault.replace("_", " "), []).extend(fault.joints)
    faults = ", ".join(f"{fault} of joint {', '.join(map(str, sorted(set(own))))}" for fault, own in joints.items())
    said = f"; faulty data: {faults}" if faults else ""
    return f"{diagnosis.verdict.replace('_', ' ')}: {names}{said}"


def _claim(finding: Finding) -> str:
    where = "" if finding.place.joint is None else f" of joint {finding.place.joint}"
    doubt = " (NOT confirmed)" if finding.confirmed is False else ""
    return f"{finding.effect.replace('_', ' ')}{where}{doubt}"


def run_batch(
    task: Task,
    files: Sequence[Path],
    out: Path,
    executor: Executor,
    *,
    robot: str | None = None,
    heldout: Sequence[Path] = (),
    joints: Sequence[str] | None = None,
    installation: Installation | None = None,
    progress: Callable[[BatchItem], None] | None = None,
) -> tuple[BatchItem, ...]:
    """One job a file, results in the order of the files; `progress` sees each item as it ends.

    Each file's results go to a folder of its name in `out`, of its run's name where every run's log has the same one;
    numbered where names repeat.
    """
    others = tuple(str(path.resolve()) for path in heldout)
    names = folder_names(files)
    done: dict[str, BatchItem] = {}
    for later, first in repeated_files(files).items():
        reason = f"{files[later]}: is {files[first]} itself, which is done already; give it once"
        done[names[later]] = BatchItem(str(files[later]), 65, reason, name=names[later])
        if progress is not None:
            progress(done[names[later]])
    waiting: dict[Future[BatchItem], tuple[Path, str]] = {
        executor.submit(
            run_item, task, str(file.resolve()), str((out / name).resolve()), robot, others, joints, installation
        ): (file, name)
        for file, name in zip(files, names, strict=True)
        if name not in done
    }
    for future in as_completed(waiting):
        file, name = waiting[future]
        error = future.exception()
        died = BatchItem(str(file), 70, f"the process died: {error}", name=name)
        done[name] = future.result() if error is None else died
        if progress is not None:
            progress(done[name])
    return tuple(done[name] for name in names)


@contextmanager
def executor_of(scheduler: str | None, jobs: int | None) -> Iterator[Executor]:
    """A pool of processes on this machine, or the cluster behind a Dask scheduler's address.

    Raises ConfigurationError where Dask is not installed or its scheduler does not answer.
    """
    if scheduler is None:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            before = active_children()
            try:
                yield pool
            except BaseException:
                # Interrupted: a pool would first do all that waits. Without its processes it is broken.
                for process in active_children():
                    if process not in before:
                        process.kill()
                raise
        return
    try:
        import distributed
    except ImportError as error:
        raise ConfigurationError(
            "a Dask scheduler needs the package 'distributed': pip install 'iiwa-ident[dask]'", field="--scheduler"
        ) from error
    try:
        connect: Any = distributed.Client
        client = connect(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        reason = sentence_of(error).rstrip(".")
        raise ConfigurationError(f"no Dask scheduler answers at {scheduler} ({reason})", field="--scheduler") from error
    with client:
        # Not the client's own futures: `get_executor` gives those of the standard library.
        yield client.get_executor(pure=False)


def repeated_files(files: Sequence[Path]) -> dict[int, int]:
    """Places of files that are an earlier one again, byte by byte, with the place of that one."""
    from identification.recordings.reader import file_digest, recording_file

    by_size: dict[int, list[int]] = {}
    logs: dict[int, Path] = {}
    for place, path in enumerate(files):
        with suppress(OSError, RecordingError):  # said where it is read
            log = recording_file(path)
            if log.is_file():
                logs[place] = log
                by_size.setdefault(log.stat().st_size, []).append(place)
    repeated: dict[int, int] = {}
    for places in by_size.values():
        seen: dict[str, int] = {}
        for place in places if len(places) > 1 else ():
            first = seen.setdefault(file_digest(logs[place]), place)
            if first != place:
                repeated[place] = first
    return repeated


def folder_names(files: Sequence[Path]) -> list[str]:
    """A name for each file's results: its own, of `recording.mcap` that of the run's folder, numbered if taken."""
    names: list[str] = []
    for file in files:
        own = file.resolve().parent.name if file.name == RECORDING_NAME else file.name if file.is_dir() else file.stem
        name, number = own, 2
        while name in names:
            name, number = f"{own}-{number}", number + 1
        names.append(name)
    return names
