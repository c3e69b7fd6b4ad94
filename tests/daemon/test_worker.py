"""Claims about the detached fit: it outlives whoever started it, and every way it can end stands in its status file.

Truth: processes that are really killed; the recording is made by the recorder from a synthetic ring.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import psutil
import pytest

from daemon.api import WorkerJob, WorkerStatus
from daemon.cli.worker_view import settle_fit, wait_for_worker
from daemon.jobs.worker import StatusFile, main, run_job
from daemon.jobs.worker_start import JOB_NAME, launch
from daemon.json_files import read_json, write_json
from fixtures.physics import iiwa14_table_three
from identification.physical_parameters import PhysicalParameters
from identification.robots import load_robot
from tests.identification.mismatch.plant import record

REPOSITORY = Path(__file__).resolve().parents[2]


def make_job(folder: Path, recording: str) -> WorkerJob:
    return WorkerJob(
        job_id="job",
        recordings=(recording,),
        robot="iiwa14",
        model_file=str(folder / "model.json"),
        status_file=str(folder / "worker_status.json"),
    )


def wait_for_end(job: WorkerJob) -> WorkerStatus:
    deadline = time.monotonic() + 600
    while time.monotonic() < deadline:
        if Path(job.status_file).exists():
            status = read_json(job.status_file, WorkerStatus)
            if status.phase in ("done", "failed"):
                return status
        time.sleep(0.05)
    raise AssertionError("the worker did not end")


def test_a_worker_survives_the_kill_of_its_parent_and_of_its_parents_group(tmp_path: Path) -> None:
    """The parent stops the worker at its start, so that it cannot be done already, and is killed with its group."""
    job = make_job(tmp_path, str(tmp_path / "absent.mcap"))
    write_json(tmp_path / "input.json", job)
    code = (
        "import os, signal, sys, time; from pathlib import Path; from daemon.api import WorkerJob;"
        "from daemon.json_files import read_json;"
        "from daemon.jobs.worker_start import launch; job = read_json(sys.argv[1], WorkerJob);"
        "pid = launch(job, Path(sys.argv[2])); os.kill(pid, signal.SIGSTOP); print(pid, flush=True); time.sleep(600)"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "input.json"), str(tmp_path / "worker_job.json")],
        cwd=REPOSITORY,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert parent.stdout is not None
    worker = psutil.Process(int(parent.stdout.readline()))
    os.killpg(parent.pid, signal.SIGKILL)
    parent.wait(600)
    assert worker.is_running()
    worker.resume()
    status = wait_for_end(job)
    assert status.pid == worker.pid
    assert (status.phase, status.exit_code) == ("failed", 66)
    assert "absent.mcap" in status.sentence


def test_a_worker_is_announced_before_it_has_loaded_anything(tmp_path: Path) -> None:
    job = make_job(tmp_path, str(tmp_path / "absent.mcap"))
    pid = launch(job, tmp_path / "worker_job.json")
    assert read_json(job.status_file, WorkerStatus).phase in ("queued", "loading", "failed")
    assert wait_for_end(job).pid == pid


@pytest.mark.parametrize(
    ("content", "exit_code"),
    [(b"not an mcap file at all", 65), (b"", 65), (b"\x89MCAP0\r\n" + bytes(100), 65)],
)
def test_a_recording_that_cannot_be_used_ends_in_a_sentence_and_no_model(
    tmp_path: Path, content: bytes, exit_code: int
) -> None:
    recording = tmp_path / "recording.mcap"
    recording.write_bytes(content)
    job = make_job(tmp_path, str(recording))
    assert run_job(job, StatusFile(job)) == exit_code
    status = read_json(job.status_file, WorkerStatus)
    assert (status.phase, status.exit_code) == ("failed", exit_code)
    assert recording.name in status.sentence
    assert "Traceback" not in status.sentence
    assert not Path(job.model_file).exists()


def test_a_broken_job_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "job.json"
    file.write_text(json.dumps({"job_id": 3}))
    assert main(["--job", str(file)]) == 78
    assert str(file) in capsys.readouterr().err
    assert main(["--job", str(tmp_path / "no.json")]) == 66


def test_the_status_file_tells_phases_in_order_and_is_never_half_written(tmp_path: Path) -> None:
    job = make_job(tmp_path, "x")
    status = StatusFile(job)
    for phase, fraction in (("loading", 0.0), ("averaging", 0.1), ("fitting", 0.5), ("writing", 2.0), ("done", 1.0)):
        status.write(phase, f"{phase}.", fraction)  # type: ignore[arg-type]
        now = read_json(job.status_file, WorkerStatus)
        assert (now.phase, now.pid) == (phase, os.getpid())
        assert 0.0 <= now.fraction <= 1.0
    assert read_json(job.status_file, WorkerStatus).model_file == job.model_file


def test_a_status_that_cannot_be_written_does_not_stop_the_fit(tmp_path: Path) -> None:
    job = make_job(tmp_path / "no such folder", "x")
    assert StatusFile(job).write("fitting", "…", 0.5).phase == "fitting"


def test_a_diagnosis_that_fails_leaves_the_job_done_and_its_model(tmp_path: Path) -> None:
    links = iiwa14_table_three()
    truth = PhysicalParameters(links.mass, links.center_of_mass, links.inertia, links.viscous, links.coulomb)
    recording = record(load_robot("iiwa14"), truth, periods=2)
    np.savez(
        tmp_path / "log.npz", t=recording.time, q=recording.position, tau=recording.torque,
        period_s=recording.period_s, robot="iiwa14",
    )  # fmt: skip
    job = msgspec.structs.replace(
        make_job(tmp_path, str(tmp_path / "log.npz")),
        diagnosis_folder=str(tmp_path / "diagnosis"),
        heldout=(str(tmp_path / "absent.mcap"),),
    )
    assert run_job(job, StatusFile(job)) == 0
    status = read_json(job.status_file, WorkerStatus)
    assert (status.phase, status.exit_code, status.model_file) == ("done", 0, job.model_file)
    assert json.loads(Path(job.model_file).read_text())["base_parameters"]
    assert status.diagnosis_error is not None
    assert "absent.mcap" in status.diagnosis_error
    assert status.diagnosis_error in status.sentence
    # No link to a page that was never written.
    assert "diagnosis/report.html" not in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_killed_fit_says_so_in_its_status_and_to_whoever_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The worker waits for ever as its interpreter begins, and is killed: who waits for it gets an answer, no error."""
    (tmp_path / "sitecustomize.py").write_text("import signal; signal.pause()")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    job = make_job(tmp_path, str(tmp_path / "absent.mcap"))
    pid = launch(job, tmp_path / JOB_NAME)
    assert read_json(job.status_file, WorkerStatus).phase == "queued"
    os.kill(pid, signal.SIGKILL)
    status = wait_for_worker(tmp_path, pid)
    assert (status.phase, status.exit_code) == ("failed", 1)
    assert "while queued" in status.sentence
    assert "absent.mcap" in status.sentence
    assert wait_for_end(job).phase == "failed"


def test_a_fit_killed_with_all_who_could_tell_is_settled_afterwards(tmp_path: Path) -> None:
    job = make_job(tmp_path, str(tmp_path / "absent.mcap"))
    write_json(tmp_path / JOB_NAME, job)
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    write_json(job.status_file, WorkerStatus(job_id=job.job_id, phase="loading", sentence="Reading.", pid=gone.pid))
    assert "iiwa-ident fit" in settle_fit(tmp_path)
    assert read_json(job.status_file, WorkerStatus).phase == "failed"
    assert settle_fit(tmp_path) == ""


def test_a_fit_whose_job_alone_reached_the_disk_never_began(tmp_path: Path) -> None:
    write_json(tmp_path / JOB_NAME, make_job(tmp_path, "recording.mcap"))
    said = settle_fit(tmp_path)
    assert said.startswith("The fit of this run never began; ")
    assert f"`iiwa-ident fit recording.mcap --out {tmp_path}/model.json`" in said


def test_the_fit_of_an_older_run_is_read_with_the_field_it_had_then(tmp_path: Path) -> None:
    job = make_job(tmp_path, "recording.mcap")
    older = {**msgspec.to_builtins(job), "progress_endpoint": None}
    (tmp_path / JOB_NAME).write_bytes(msgspec.json.encode(older))
    write_json(job.status_file, WorkerStatus(job_id=job.job_id, phase="done", sentence="Done."))
    assert settle_fit(tmp_path) == ""
