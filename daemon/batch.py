"""Many recordings at once: one job a file, on this machine's processors or on a Dask cluster.

Here: what one job does, and where jobs run. A file that fails does not stop the others. Called by the command `batch`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from daemon.errors import ConfigurationError

if TYPE_CHECKING:
    from identification.robots import Installation

__all__ = ["BatchItem", "Task", "executor_of", "run_batch", "run_item"]

Task = Literal["fit", "diagnose"]


@dataclass(frozen=True, slots=True)
class BatchItem:
    """The outcome for one file. exit_code: as of the command alone; sentence: result or error; files: those written."""

    file: str
    exit_code: int
    sentence: str
    files: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The item as plain JSON types."""
        return {
            "file": self.file,
            "exit_code": self.exit_code,
            "sentence": self.sentence,
            "files": list(self.files),
        }


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
    from daemon.cli.app import exit_code_of

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from daemon.diagnosis import diagnose_recordings
        from identification.fit import fit_recordings
        from identification.recordings.reader import read_inputs

        out = Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        checking = heldout if task == "diagnose" else ()
        inputs = read_inputs([file, *checking], robot=robot, joints=joints, installation=installation)
        recording, *unseen = inputs.recordings
        if task == "diagnose":
            found = diagnose_recordings([recording], unseen, inputs.robot, out)
            names = ", ".join(finding.effect for finding in found.diagnosis.findings) or "nothing named"
            return BatchItem(file, 0, f"{found.diagnosis.verdict}: {names}", tuple(map(str, found.files)))
        result = fit_recordings([recording], inputs.robot)
        target = out / "model.json"
        target.write_text(json.dumps(result.to_model_json(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        rms = ", ".join(f"{value:.3f}" for value in result.rms.rows[0].rms_nm)
        return BatchItem(file, 0, f"RMS per joint {rms} Nm", (str(target),))
    except Exception as error:  # one bad file must not cost the others their result
        return BatchItem(file, exit_code_of(error), str(error) or type(error).__name__)


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

    Each file's results go to a folder of its name in `out`, numbered where names repeat.
    """
    others = tuple(str(path.resolve()) for path in heldout)
    names = _folder_names(files)
    waiting: dict[Future[BatchItem], Path] = {
        executor.submit(
            run_item, task, str(file.resolve()), str((out / name).resolve()), robot, others, joints, installation
        ): file
        for file, name in zip(files, names, strict=True)
    }
    done: dict[Path, BatchItem] = {}
    for future in as_completed(waiting):
        file = waiting[future]
        error = future.exception()
        done[file] = future.result() if error is None else BatchItem(str(file), 70, f"the process died: {error}")
        if progress is not None:
            progress(done[file])
    return tuple(done[file] for file in files)


@contextmanager
def executor_of(scheduler: str | None, jobs: int | None) -> Iterator[Executor]:
    """A pool of processes on this machine, or the cluster behind a Dask scheduler's address.

    Raises ConfigurationError where Dask is not installed or its scheduler does not answer.
    """
    if scheduler is None:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            yield pool
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
        raise ConfigurationError(f"no Dask scheduler answers at {scheduler} ({error})", field="--scheduler") from error
    with client:
        # Not the client's own futures: `get_executor` gives those of the standard library.
        yield client.get_executor(pure=False)


def _folder_names(files: Sequence[Path]) -> list[str]:
    names: list[str] = []
    for file in files:
        name, number = file.stem, 2
        while name in names:
            name, number = f"{file.stem}-{number}", number + 1
        names.append(name)
    return names
