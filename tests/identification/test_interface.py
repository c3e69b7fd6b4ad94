"""`import identification as ident` as the notebook uses it. Truth: the published parameters of the EMPS benchmark."""

from __future__ import annotations

import json
import pickle
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import identification as ident
from identification import interface
from identification.errors import (
    DesignError,
    EstimationError,
    ModelFileError,
    RecordingError,
    RecordingNotFoundError,
)
from identification.recordings import Recording
from identification.robots import Installation

REPOSITORY = Path(__file__).resolve().parents[2]
NOTEBOOK = REPOSITORY / "docs" / "notebooks" / "recording-to-table.ipynb"
PUBLISHED = {"M_1": (95.109, 0.5), "FV_1": (203.50, 5.0), "FS_1": (20.39, 1.0), "OFF_1": (-3.165, 0.5)}
"""Value and how far our estimate, which models nothing else either, may be from it."""


@pytest.fixture(scope="module")
def cells() -> list[dict[str, Any]]:
    return list(json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"])


@pytest.fixture(scope="module")
def ran(cells: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """The notebook's names after its code ran in its own folder, as Jupyter does it; `shown`: each cell's last line."""
    names: dict[str, Any] = {"shown": []}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(NOTEBOOK.parent)
        for cell in cells:
            if cell["cell_type"] == "code":
                *lines, last = "".join(cell["source"]).splitlines()
                exec("\n".join(lines), names)
                names["shown"].append(eval(last, names) if " = " not in last else exec(last, names))
        yield names


def test_the_notebook_has_no_outputs_and_fifteen_lines_of_code_at_most(cells: list[dict[str, Any]]) -> None:
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in code)
    assert len([line for cell in code for line in cell["source"] if line.strip()]) <= 15


def test_the_table_is_the_published_one(ran: dict[str, Any]) -> None:
    model = ran["model"].result
    found = dict(zip(model.names, model.values, strict=True))
    for name, (value, within) in PUBLISHED.items():
        assert found[name] == pytest.approx(value, abs=within), name


def test_everything_shown_prints_as_text_and_as_html(ran: dict[str, Any]) -> None:
    for shown in filter(None, ran["shown"]):
        text, html = str(shown), shown._repr_html_()
        assert html.count("<tr>") == html.count("</tr>") >= 2
        for row in shown.table.rows:
            assert row[0] in text
            assert len(row) == len(shown.table.header)


def test_a_recording_prints_as_what_it_is_and_not_as_its_arrays() -> None:
    """Truth: the benchmark's own account, 24.84 s at 1 kHz; the range is read from the file's column."""
    file = REPOSITORY / "fixtures" / "recordings" / "emps_a.npz"
    recording = ident.read_recording(file)
    text, html = repr(recording), recording._repr_html_()
    assert text == str(recording) == str(recording.table)
    assert text.splitlines()[0] == f"{file}: 24841 samples of 1 joint in 24.84 s, one each 1 ms."
    with np.load(file) as columns:
        lowest, highest = (f"{bound(columns['q']):z.4f}" for bound in (np.min, np.max))
    assert text.splitlines()[-1].split()[:3] == ["1", lowest, highest]
    assert f"<td>{highest}</td>" in html
    assert "array(" not in text
    nothing = recording.rows(recording.time < 0.0)
    assert repr(nothing).startswith(f"{file}: 0 samples of 1 joint.\n")


def test_a_design_does_not_run_the_callers_script_again(tmp_path: Path) -> None:
    """Its processes read the main module of the caller, who had to guard it; a notebook has none."""
    script = tmp_path / "script.py"
    script.write_text(
        "import identification as ident\n"
        "from identification.excitation.local_search import Stage\n"
        "print('begun')\n"
        "one = (Stage(1.0, 15, 0.9),)\n"
        "found = ident.design_excitation(seed=3, starts=1, processes=1, samples=24, harmonics=3, stages=one)\n"
        "print(found.result.cond > 1.0, __file__.endswith('script.py'))\n"
        "print(found)\n",
        encoding="utf-8",
    )
    done = subprocess.run([sys.executable, script], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    words, *shown = done.stdout.partition("cond(Y_b)")
    assert words.split() == ["begun", "True", "True"]
    # A table of numbers that a reader compares, not the lists that they are kept in.
    assert max(map(len, "".join(shown).splitlines())) < 100
    assert re.search(r"\nvelocity( +\d+\.\d){7}\n", "".join(shown))


def test_a_budget_without_a_clock_is_refused_and_not_passed_over() -> None:
    with pytest.raises(DesignError, match=r"clock=time\.monotonic"):
        ident.design_excitation(budget_s=5.0)
    ticks = iter(range(1000))
    quick: dict[str, Any] = {"starts": 3, "processes": 1, "samples": 24, "harmonics": 3}
    found = ident.design_excitation(budget_s=1.0, clock=lambda: float(next(ticks)), **quick)
    done = [event.done for event in found.result.history]
    assert done == [1] * len(done), "time is over after the first of each stage"
    # As of an arm from a URDF, which states no accelerations.
    unlimited = replace(found.result, verified={**found.result.verified, "acceleration": 7 * [0.0]})
    assert re.search(r"\nacceleration( +no limit){7}\n", str(replace(found, result=unlimited)))


def test_the_published_physics_is_named(ran: dict[str, Any]) -> None:
    """Viscous friction that differs between the directions: half the difference is −36.86 ± 0.87 N s/m."""
    first = ran["answer"].result.findings[0]
    assert first.effect == "asymmetric_viscous_friction"
    assert first.parameters[0].value == pytest.approx(-36.86, abs=4.0)


def test_what_is_saved_is_what_every_command_reads(ran: dict[str, Any], tmp_path: Path) -> None:
    model, folder = ran["model"], REPOSITORY / "fixtures" / "recordings"
    file = model.save(tmp_path / "model.json")
    mine, read = (ident.validate(item, folder / "emps_b.npz").result.rows[0] for item in (model, file))
    assert read.rms_nm == pytest.approx(mine.rms_nm, rel=1e-9)
    extended = ran["answer"].save_model(tmp_path / "extended.json")
    assert ident.validate(extended, folder / "emps_b.npz").result.rows[0].rms_nm.shape == (1,)


def test_a_fit_goes_to_another_process_with_its_notes(ran: dict[str, Any]) -> None:
    model = ran["model"]
    there = pickle.loads(pickle.dumps(model))
    assert there.result.notes == model.result.notes
    np.testing.assert_array_equal(there.result.values, model.result.values)


def test_a_fit_is_diagnosed_against_as_its_file_is(ran: dict[str, Any], tmp_path: Path) -> None:
    model, other = ran["model"], REPOSITORY / "fixtures" / "recordings" / "emps_b.npz"
    mine, read = (ident.diagnose(other, model=item).result for item in (model, model.save(tmp_path / "model.json")))
    assert mine.model_comparison is not None
    assert read.model_comparison is not None
    assert mine.model_comparison.model_nm == pytest.approx(read.model_comparison.model_nm, rel=1e-9)
    assert [item.effect for item in mine.findings] == [item.effect for item in read.findings]


def test_a_model_is_not_checked_by_what_it_was_fitted_to(ran: dict[str, Any], tmp_path: Path) -> None:
    """By content: the fit itself and its file know its samples, and a part of them too, in any precision."""
    fitted, other = (REPOSITORY / "fixtures" / "recordings" / name for name in ("emps_a.npz", "emps_b.npz"))
    model = ran["model"]
    assert [Path(item.source.path).name for item in model.result.recordings] == [fitted.name]
    with np.load(fitted) as whole:
        rows = len(whole["t"])
        part = {name: item[rows // 2 :] if item.shape[:1] == (rows,) else item for name, item in whole.items()}
    part["robot"] = np.array(str(fitted.with_name("emps.urdf")))
    np.savez(tmp_path / "part.npz", **part)
    single = {name: item.astype(np.float32) if name in ("q", "tau") else item for name, item in part.items()}
    np.savez(tmp_path / "single.npz", **single)
    file = model.save(tmp_path / "model.json")
    for known, recording in product((model, file), (fitted, tmp_path / "part.npz", tmp_path / "single.npz")):
        assert f"NO CHECK: the model was fitted to {recording.name} itself" in str(ident.validate(known, recording))
    assert not any("NO CHECK" in str(ident.validate(known, other)) for known in (model, file))


def test_bad_input_is_the_same_sentence_as_at_the_command_line(ran: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(RecordingNotFoundError, match="there is no such recording"):
        ident.fit(tmp_path / "none.npz")
    with pytest.raises(RecordingNotFoundError, match=r"none\.npz"):
        ident.diagnose(REPOSITORY / "fixtures" / "recordings" / "ur10.npz", heldout=str(tmp_path / "none.npz"))
    with pytest.raises(RecordingError, match="one after the other"):
        ident.fit([tmp_path / "none.npz"])  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match="No recording was given"):
        ident.validate(ran["model"])
    with pytest.raises(AttributeError, match="no attribute 'fits'"):
        _ = ident.fits  # type: ignore[attr-defined]


def test_recordings_of_arms_that_stood_otherwise_are_not_mixed_unsaid() -> None:
    """The stand of the first one was taken for all."""
    folder = REPOSITORY / "fixtures" / "recordings"
    on_the_floor = ident.read_recording(folder / "tx40_excitation.npz")
    on_the_wall = replace(on_the_floor, installation=Installation.parse(mount="wall") or on_the_floor.installation)
    with pytest.raises(RecordingError, match=r"gravity|installation|mounted|stand"):
        ident.fit(on_the_floor, on_the_wall)


def test_nothing_is_loaded_before_it_is_asked_for() -> None:
    code = "import identification, sys; sys.exit('numpy' in sys.modules or 'fit' not in dir(identification))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_blas_has_one_thread_while_a_function_runs_and_as_before_afterwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Truth: the library's own count of its threads."""

    def threads() -> set[int]:
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    seen: list[set[int]] = []

    def counted(*_: object, **__: object) -> None:
        seen.append(threads())
        raise RecordingError("enough was seen", file=Path("any.npz"))

    monkeypatch.setattr(interface, "read_recording", counted)
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        with pytest.raises(RecordingError):
            ident.fit("any.npz")
        assert threads() == before == {2}
    assert seen == [{1}]


@pytest.fixture(scope="module")
def emps() -> Recording:
    folder = REPOSITORY / "fixtures" / "recordings"
    return ident.read_recording(folder / "emps_a.npz", robot=folder / "emps.urdf")


@pytest.mark.parametrize(
    ("field", "changed", "said"),
    [
        ("position", lambda x: np.where(np.arange(len(x)) == 6, np.nan, x.T).T, "position of joint 1 is no finite"),
        ("torque", lambda x: np.where(np.arange(len(x)) == 6, np.inf, x.T).T, "torque of joint 1 is no finite"),
        ("torque", lambda x: x[:-3], "torque has the shape (24838, 1) and not (24841, 1)"),
        ("torque", lambda x: x[:, 0], "torque has the shape (24841,)"),
        ("torque", lambda x: x.tolist(), "torque is no array"),
        ("torque", lambda x: x.astype(int), "floating-point"),
        ("time", lambda x: x[::-1].copy(), "time does not advance after row 1"),
        ("time", lambda x: np.where(x == x[6], np.nan, x), "time does not advance after row 6"),
        ("time", lambda x: x[:, None], "time has the shape"),
        ("temperature", lambda _: np.zeros((3, 1)), "temperature has the shape"),
        ("sampling_period_s", lambda _: 0.0, "sampling_period_s is 0"),
    ],
)
def test_a_recording_made_by_hand_checks_itself(emps: Recording, field: str, changed: Any, said: str) -> None:
    with pytest.raises(RecordingError, match=re.escape(said)):
        replace(emps, **{field: changed(getattr(emps, field))})


def test_a_recording_made_by_hand_is_asked_for_its_units_as_a_file_is(emps: Recording) -> None:
    late: dict[str, Any] = {"time": 1000.0 * emps.time, "sampling_period_s": 1000.0 * emps.sampling_period_s}
    with pytest.raises(RecordingError, match="t looks like milliseconds"):
        ident.fit(replace(emps, **late))
    with pytest.raises(RecordingError, match=r"sampling_period_s is 0\.001 s, and its rows are 1 s apart"):
        ident.fit(replace(emps, time=late["time"]))
    with pytest.raises(RecordingError, match="holds no motion"):
        ident.fit(emps.rows(emps.time < 0.0))


def test_what_is_no_model_or_no_recording_is_refused_in_words(emps: Recording) -> None:
    with pytest.raises(ModelFileError, match="The model comes first"):
        ident.validate(emps, emps)  # type: ignore[arg-type]
    with pytest.raises(ModelFileError, match="no int"):
        ident.diagnose(emps, model=5)  # type: ignore[arg-type]
    with pytest.raises(RecordingError):
        ident.diagnose(emps, heldout=5)  # type: ignore[arg-type]
    with pytest.raises(EstimationError, match=r"'0.6' is no split"):
        ident.fit(emps, split=0.6)
