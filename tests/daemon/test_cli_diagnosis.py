"""Claims about `diagnose` and `batch`: files in, files out, exit codes, and one bad file does not cost the others.

Truth: a plant of Pinocchio with a known spring; what `validate` and `simulate` then say of the extended model.
"""

from __future__ import annotations

import csv
import json
import time
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from daemon.api import RunRequest
from daemon.cli.diagnosis import finding_lines
from daemon.errors import ConfigurationError
from daemon.jobs.batch import BatchItem, diagnosis_in_a_line, executor_of, folder_names, run_batch, run_item
from daemon.jobs.batch_summary import write_summary
from fixtures.physics import iiwa14_table_three
from identification.base_parameters import BaseRegressor
from identification.mismatch.effects.base import Parameter
from identification.mismatch.prediction import torque_along, validate_with_effects
from identification.mismatch.settings import DiagnosisSettings
from identification.model_file import read_model
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel, load_robot
from tests.daemon.command_line import run
from tests.identification.mismatch.plant import on_joint, record
from tests.short_motion import short_trajectory

STIFFNESS, REST = 2.0, 0.3


def spring(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    del dq, torque
    return on_joint(6, STIFFNESS * (q[:, 5] - REST))


@pytest.fixture(scope="module")
def iiwa14() -> RobotModel:
    return load_robot("iiwa14")


def true_parameters() -> PhysicalParameters:
    """The fake robot's table: the identification's own is not asked."""
    links = iiwa14_table_three()
    return PhysicalParameters(links.mass, links.center_of_mass, links.inertia, links.viscous, links.coulomb)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory, iiwa14: RobotModel) -> list[Path]:
    """A fitted and a held-out recording of an arm with a spring at joint 6, as files of others."""
    folder = tmp_path_factory.mktemp("logs")
    files = []
    for name, motion, periods in (("fitted", 3, 8), ("heldout", 9, 4)):
        recording = record(iiwa14, true_parameters(), spring, periods=periods, motion=motion, seed=motion)
        file = folder / f"{name}.npz"
        np.savez(
            file, t=recording.time, q=recording.position, tau=recording.torque,
            period_s=recording.period_s, robot="iiwa14",
        )  # fmt: skip
        files.append(file)
    return files


@pytest.fixture(scope="module")
def diagnosed(logs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "diagnosis"
    (out.parent / "report.html").touch()  # as the fit of a run leaves it
    code = run(
        "diagnose", str(logs[0]), "--heldout", str(logs[1]), "--out", str(out), "--json", str(out.parent / "copy.json")
    )
    assert code == 0
    return out


def load(file: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return document


def test_diagnose_names_the_spring_and_leaves_three_files(diagnosed: Path) -> None:
    diagnosis = load(diagnosed / "diagnosis.json")
    (finding,) = diagnosis["findings"]
    assert (finding["effect"], finding["joint"]) == ("cable_spring", 6)
    assert finding["parameters"]["stiffness"]["value"] == pytest.approx(STIFFNESS, rel=0.05)
    assert load(diagnosed.parent / "copy.json") == diagnosis
    page = (diagnosed / "report.html").read_text(encoding="utf-8")
    assert "<h1>Diagnosis of iiwa14</h1>" in page
    assert '<a href="../report.html">' in page


def test_the_extended_model_has_bodies_and_predicts_unseen_torque_down_to_its_noise(
    diagnosed: Path, logs: list[Path]
) -> None:
    model = read_model(diagnosed / "model.json")
    assert model.physical is not None
    assert model.data["consistent_parameters"]
    from identification.recordings import read_recording

    table = validate_with_effects(model, [read_recording(logs[1])])
    for row in table.rows:
        assert (row.rms_nm < 1.5 * row.noise_floor_nm).all()


def test_the_models_spring_pulls_where_the_simulated_arm_is(diagnosed: Path, iiwa14: RobotModel) -> None:
    """Between two angles the torque differs by stiffness times angle: constants may sit in gravity parameters."""
    model = read_model(diagnosed / "model.json")
    regressor = BaseRegressor(iiwa14, model.options)
    time = np.arange(100) * 0.01
    position = np.zeros((100, 7))
    position[:, 5] = np.sin(2.0 * np.pi * time)
    velocity = np.gradient(position, 0.01, axis=0)
    effects = model.data["effects"]
    torque = torque_along(effects, regressor, model.base_values(regressor), time, (position, velocity, 0.0 * velocity))

    class At:
        def __init__(self, time_s: float) -> None:
            self.time_s = time_s

    swing = torque(At(1.25)) - torque(At(-0.25))
    assert swing[5] == pytest.approx(2.0 * STIFFNESS, rel=0.05)
    assert not np.delete(swing, 5).any()


def test_numbers_under_a_sentence_show_sigma_and_no_chance_of_zero() -> None:
    """± in a sentence is half of the 95 % interval; the same sign for σ one line below read as another result."""
    finding = SimpleNamespace(
        parameters=(Parameter("stiffness", 7684.2, 48.7, "Nm/rad"), Parameter("exponent", 1.52, 0.2, "1")),
        score=6900.0, significance=0.0,
        absorbed_fraction=0.68, heldout_gain_nm=np.zeros(0), separating_experiment=None,
    )  # fmt: skip
    numbers, sureness = finding_lines(finding)  # type: ignore[arg-type]
    assert numbers == "stiffness 7684 Nm/rad (σ 49); exponent 1.52 (σ 0.20)"  # it read "exponent 1.52 1"
    assert "noise alone below 1e−6, 68 %" in sureness


def test_a_joint_that_a_finding_makes_worse_elsewhere_is_not_said_to_be_lowered() -> None:
    finding = SimpleNamespace(
        parameters=(), score=60.0, significance=0.0, absorbed_fraction=0.0, separating_experiment=None,
        heldout_gain_nm=np.array([1.5, -0.0252]),
    )  # fmt: skip
    assert finding_lines(finding)[-1] == (  # type: ignore[arg-type]
        "lowers the held-out RMS of joints 1 to 2 by 1500.0, -25.2 mNm (below zero: raises it)"
    )


def test_a_missing_recording_is_missing_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("diagnose", str(tmp_path / "absent.npz")) == 66
    assert "absent.npz" in capsys.readouterr().err


def test_a_file_that_is_no_recording_is_bad_data(tmp_path: Path) -> None:
    file = tmp_path / "noise.npz"
    np.savez(file, a=np.zeros(3))
    assert run("diagnose", str(file)) == 65


def test_no_recording_confirms_itself(logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--heldout", str(logs[0]), "--out", str(tmp_path / "out"))
    assert run("diagnose", str(logs[0]), *words) == 65
    assert f"fitted.npz: is the fitted recording {logs[0]} itself" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert run("batch", "diagnose", str(logs[0]), *words, "--jobs", "1", "--json", str(tmp_path / "items.json")) == 1
    (item,) = json.loads((tmp_path / "items.json").read_text(encoding="utf-8"))
    assert item["exit_code"] == 65
    assert "cannot confirm" in item["sentence"]


def test_one_recording_given_twice_is_refused(
    diagnosed: Path, logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy.npz"
    copy.write_bytes(logs[0].read_bytes())
    for words in (["fit"], ["diagnose", "--out", str(tmp_path / "out")], ["validate", str(diagnosed / "model.json")]):
        assert run(*words, str(logs[0]), str(copy)) == 65
        said = capsys.readouterr().err
        assert "copy.npz" in said
        assert "fitted.npz itself" in said
    assert not (tmp_path / "out").exists()


def test_a_batch_takes_one_recording_once(logs: list[Path], tmp_path: Path) -> None:
    bad, copy = tmp_path / "bad.npz", tmp_path / "copy.npz"
    for file in (bad, copy):
        np.savez(file, a=np.zeros(3))
    with ThreadPoolExecutor(1) as executor:
        items = run_batch("fit", [bad, tmp_path / "absent.npz", copy], tmp_path / "out", executor)
    assert [item.exit_code for item in items] == [65, 66, 65]
    assert "itself" not in items[0].sentence
    assert "copy.npz: is " in items[2].sentence
    assert "bad.npz itself" in items[2].sentence


def test_validate_says_that_a_model_was_fitted_to_the_recording(
    diagnosed: Path, logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "rms.json"
    assert run("validate", str(diagnosed / "model.json"), *map(str, logs), "--json", str(table)) == 0
    assert {row["label"].split(",")[0]: row["same_recording"] for row in json.loads(table.read_text())} == {
        "fitted.npz": True,
        "heldout.npz": False,
    }
    said = capsys.readouterr().out
    first = said.index("NO CHECK: the model was fitted to fitted.npz itself")
    assert first < said.index("RMS of measured minus modelled")
    assert "fitted to heldout.npz" not in said


def test_one_bad_file_does_not_cost_the_others_their_fit(logs: list[Path], tmp_path: Path) -> None:
    bad = tmp_path / "bad.npz"
    np.savez(bad, a=np.zeros(3))
    with ThreadPoolExecutor(1) as executor:
        first, second = run_batch("fit", [bad, logs[1]], tmp_path / "out", executor)
    assert (first.exit_code, second.exit_code) == (65, 0)
    assert (tmp_path / "out" / "heldout" / "model.json").is_file()
    assert str(tmp_path / "out" / "heldout" / "report.html") in second.files
    assert len(second.rms_nm) == len(second.noise_floor_nm) == 7


@pytest.mark.parametrize(
    ("codes", "head"), [((0, 65, 66), "1 of 3 recordings fitted"), ((0, 0), "2 recordings fitted")]
)
def test_the_page_of_a_batch_heads_what_was_done(tmp_path: Path, codes: tuple[int, ...], head: str) -> None:
    """A page headed "4 recordings fitted" stood above three that had failed."""
    items = [BatchItem(f"{number}.npz", code, "so") for number, code in enumerate(codes)]
    page, _ = write_summary("fit", items, tmp_path)
    assert f"<h1>{head}</h1>" in page.read_text(encoding="utf-8")


def test_a_batch_states_no_noise_that_was_not_measured(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    baseline = SimpleNamespace(rms_nm=np.ones(7), noise_floor_nm=np.full(7, 0.1), noise_is_measured=False)
    found = SimpleNamespace(verdict="undecided", findings=(), data_faults=(), every_fault=(), baseline=baseline)
    monkeypatch.setattr(
        "daemon.jobs.diagnosis.diagnose_recordings", lambda *_: SimpleNamespace(diagnosis=found, files=())
    )
    item = run_item("diagnose", str(logs[0]), str(tmp_path / "out"), None, ())
    assert (item.rms_nm, item.noise_floor_nm) == ((1.0,) * 7, (None,) * 7)


def test_an_interrupted_batch_does_not_do_what_waits() -> None:
    waiting: list[Future[None]] = []

    def interrupted() -> None:
        with executor_of(None, jobs=1) as executor:
            waiting.extend(executor.submit(time.sleep, 10.0) for _ in range(10))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert isinstance(waiting[-1].exception(), BrokenExecutor)


def test_results_are_named_after_the_runs_and_not_after_a_name_that_all_logs_have() -> None:
    files = ["runs/monday/recording.mcap", "runs/tuesday/recording.mcap", "old/monday/recording.mcap", "arm.npz"]
    assert folder_names([Path(file) for file in files]) == ["monday", "tuesday", "monday-2", "arm"]


def test_a_batch_leaves_one_page_and_one_table(tmp_path: Path) -> None:
    folder = tmp_path / "monday"
    folder.mkdir()
    own = folder / "report.html"
    own.write_text("<p>its own page</p>")
    items = [
        BatchItem("a.mcap", 0, "mostly noise", (str(own),), "monday", (0.25, None), (0.1, 0.2), "good"),
        BatchItem("b.mcap", 65, "b.mcap: <no> torque", name="tuesday"),
    ]
    page, table = write_summary("fit", items, tmp_path)
    text = page.read_text(encoding="utf-8")
    assert '<a href="monday/report.html">monday</a>' in text
    assert "FAILED: b.mcap: &lt;no&gt; torque" in text
    assert "1 of 2 recordings are fitted, 1 failed" in text
    with table.open(encoding="utf-8", newline="") as stream:
        first, second = csv.DictReader(stream)
    names = ("recording", "rms_1", "rms_2", "noise_2", "page")
    assert [first[name] for name in names] == ["monday", "0.25", "", "0.2", "monday/report.html"]
    assert (second["exit_code"], second["page"]) == ("65", "")


def test_a_line_of_a_batch_names_the_faults_of_its_data() -> None:
    faults = [
        SimpleNamespace(fault="wrong_joint_order", joints=(4,)),
        SimpleNamespace(fault="inverted_torque_sign", joints=(1,)),
        SimpleNamespace(fault="wrong_joint_order", joints=(2, 4)),
    ]
    found: Any = SimpleNamespace(verdict="no_mismatch", findings=(), data_faults=faults)
    said = "faulty data: wrong joint order of joint 2, 4, inverted torque sign of joint 1"
    assert diagnosis_in_a_line(found) == f"no mismatch: nothing named; {said}"
    assert diagnosis_in_a_line(SimpleNamespace(**{**vars(found), "data_faults": ()})) == "no mismatch: nothing named"


def test_batch_says_by_its_exit_code_that_one_failed(tmp_path: Path) -> None:
    result = tmp_path / "items.json"
    code = run("batch", "fit", str(tmp_path / "absent.npz"), "--out", str(tmp_path / "out"), "--json", str(result))
    assert code == 1
    assert json.loads(result.read_text(encoding="utf-8"))[0]["exit_code"] == 66


def test_a_scheduler_that_is_not_there_is_a_bad_configuration() -> None:
    with pytest.raises(ConfigurationError, match=r"Dask|distributed"), executor_of("tcp://127.0.0.1:9", None):
        pass


def test_split_and_low_pass_reach_a_diagnosis_without_periods_and_no_other(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with np.load(logs[0]) as whole:
        np.savez(tmp_path / "plain.npz", t=whole["t"], q=whole["q"], tau=whole["tau"], robot="iiwa14")
    asked: list[DiagnosisSettings] = []

    def stop_here(*_: object, settings: DiagnosisSettings, **__: object) -> None:
        asked.append(settings)
        raise ConfigurationError("enough")

    monkeypatch.setattr("daemon.jobs.diagnosis.diagnose_recordings", stop_here)
    options = ("--split", "first:0.6", "--low-pass-hz", "12")
    assert run("diagnose", str(tmp_path / "plain.npz"), *options) == ConfigurationError.exit_code
    assert asked == [DiagnosisSettings(split="first:0.6", low_pass_hz=12.0)]
    for pair in (options[:2], options[2:]):
        assert run("diagnose", str(logs[0]), *pair) == 2
    assert len(asked) == 1


def test_run_hands_the_wish_for_a_diagnosis_to_the_acquisition(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[RunRequest] = []

    def stop_here(request: RunRequest, **_: object) -> None:
        asked.append(request)
        raise ConfigurationError("enough")

    monkeypatch.setattr("daemon.run.service.run_acquisition", stop_here)
    motion = str(short_trajectory(tmp_path / "short.json"))
    words = ("run", motion, "--out", str(tmp_path / "run"), "--heldout", str(logs[1]))
    assert run(*words, "--diagnose") == ConfigurationError.exit_code
    assert (asked[0].diagnose, asked[0].heldout) == (True, (str(logs[1]),))
    assert run(*words) == 2
    assert run("run", "--out", str(tmp_path / "run"), "--diagnose", "--no-fit") == 2
    assert len(asked) == 1
    # The folder of an earlier run stands for its log, as everywhere.
    (tmp_path / "earlier").mkdir()
    log = tmp_path / "earlier" / "recording.mcap"
    log.write_bytes(b"")
    words = ("run", motion, "--out", str(tmp_path / "run"), "--heldout", str(log.parent), "--diagnose")
    assert run(*words) == ConfigurationError.exit_code
    assert asked[1].heldout == (str(log),)
