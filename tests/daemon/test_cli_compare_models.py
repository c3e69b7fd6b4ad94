"""Claims about `compare --models`: who predicts best, what is wrong in whom, bad input.

Truth: torque of the paper's arm by Pinocchio; models of that arm as files, one of which has a heavier last link.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest

from daemon.cli.comparing import show_leaderboard
from daemon.jobs.diagnosis import write_model_back
from fixtures.physics import iiwa14_table_three
from identification.audit.difference import Audit, Difference, Number
from identification.audit.leaderboard import Standing
from identification.audit.misread import misread
from identification.base_parameters import BaseRegressor
from identification.errors import RobotError
from identification.export.write import export_model
from identification.fitting.rms import RmsRow
from identification.physical_parameters import PhysicalParameters
from identification.recordings import read_recording
from identification.robots import load_robot
from identification.robots.flange import IIWA_FLANGE
from identification.robots.simulator_models import read_simulator_model
from tests.daemon.command_line import run
from tests.identification.exported import consistent, model_of
from tests.identification.synthetic import fourier_motion, inverse_dynamics

NOISE_NM, EXTRA_KG, OFFSET_NM = 0.05, 1.5, 0.4
OUT_M = np.array([0.06, 0.03, 0.1])
"""Aside of the last axis: on it the mass could as well be the link's before."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, the true arm as URDF, MJCF and SDF, and one whose last link is EXTRA_KG too heavy."""
    place = tmp_path_factory.mktemp("models")
    links = iiwa14_table_three()
    physical = consistent(
        PhysicalParameters(links.mass, links.center_of_mass, links.inertia, links.viscous, links.coulomb)
    )
    states = fourier_motion(7, period_s=10.0, samples=1000, seed=4)
    torque = inverse_dynamics(load_robot("iiwa14"), physical, *states)
    torque += NOISE_NM * np.random.default_rng(6).standard_normal(torque.shape)
    torque[:, 1] += OFFSET_NM
    np.savez(place / "log.npz", t=np.arange(1000) * 0.01, q=states[0], tau=torque, robot="iiwa14")
    model = model_of(place, "iiwa14", physical)
    for form, name in (("urdf", "true.urdf"), ("mjcf", "true.xml"), ("sdf", "true.sdf")):
        export_model(model, place / name, form, parameter_set="physical")
    mass, center, inertia = physical.mass.copy(), physical.center_of_mass.copy(), physical.inertia.copy()
    mass[6] += EXTRA_KG
    center[6] = (physical.mass[6] * center[6] + EXTRA_KG * OUT_M) / mass[6]
    heavy = PhysicalParameters(mass, center, inertia, physical.viscous, physical.coulomb)
    (place / "other").mkdir()
    export_model(model_of(place / "other", "iiwa14", heavy), place / "heavy.urdf", "urdf", parameter_set="physical")
    return place


def test_the_true_arm_wins_in_every_format_and_the_heavy_link_is_named(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "board.json"
    files = [folder / name for name in ("heavy.urdf", "true.xml", "true.sdf")]
    assert run("compare", "--models", *files, "--", folder / "log.npz", "--offsets", "--json", out) == 0
    board = json.loads(out.read_text())
    assert board["offsets_fitted"]
    *best, last = board["models"]
    assert Path(last["model"]).name == "heavy.urdf"
    totals = [item["total_nm"] for item in best]
    # The band of the comparison holds 5 of 50 Hz of white noise.
    assert totals == pytest.approx([7 * NOISE_NM * np.sqrt(5 / 50)] * 2, rel=0.2)
    assert best[0]["offsets_nm"][1] == pytest.approx(OFFSET_NM, abs=0.01)
    (found,) = [item for item in last["differences"] if item["kind"] in ("payload", "link_parameters")]
    assert found["link"] == 7
    assert found["number"] == pytest.approx(-EXTRA_KG, rel=0.1)
    assert not any(item["kind"] in ("payload", "link_parameters") for each in best for item in each["differences"])


def test_a_recording_among_the_models_is_told_where_it_belongs(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of `--on A B`: B was taken for a model that cannot be read, and only A was asked."""
    log = folder / "log.npz"
    assert run("leaderboard", folder / "true.urdf", "--on", log, log) == 2
    assert "--on goes before each of several recordings" in " ".join(capsys.readouterr().err.split())


def test_the_leaderboard_is_the_comparison_of_models(folder: Path, tmp_path: Path) -> None:
    files = [folder / name for name in ("heavy.urdf", "true.urdf")]
    assert run("leaderboard", *files, "--on", folder / "log.npz", "--json", tmp_path / "a.json") == 0
    assert run("compare", "--models", *files, "--", folder / "log.npz", "--json", tmp_path / "b.json") == 0
    assert json.loads((tmp_path / "a.json").read_text()) == json.loads((tmp_path / "b.json").read_text())


def test_rows_of_an_rms_are_explained_only_where_a_sentence_states_one(capsys: pytest.CaptureFixture[str]) -> None:
    """The word RMS in what is said of a model with effects brought the explanation of figures that nobody saw."""
    named = misread("wrong_unit", (), 1.0, "The positions are in degrees")
    said = []
    for verdict, differences in (("named", (named,)), ("unexplained", ())):
        left = Audit("arm.json", verdict, differences, (1.0,), (0.1,), "arm.json leaves 1 Nm RMS.")
        line = RmsRow("arm.json", *(np.ones(1) for _ in range(3)))
        show_leaderboard([Standing("arm.json", line, None, left, extended=True)], False, "Nm", 8.0)
        said.append("An RMS in the sentences below" in capsys.readouterr().out)
    assert said == [False, True]


def test_nothing_is_fitted_unless_declared(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # Without dashes, files are told by their endings.
    assert run("compare", "--models", folder / "true.urdf", folder / "log.npz") == 0
    text = capsys.readouterr().out
    assert "nothing fitted" in text
    # `validate` states the same of more frequencies: on one recording the two differ by half.
    assert "torque per joint up to 5 Hz" in text
    row = next(line for line in text.splitlines() if line.startswith("true.urdf"))
    assert float(row.split()[2]) == pytest.approx(OFFSET_NM, rel=0.05)
    # What is asked about the set-up is another question, with less left, and says so.
    assert "(all joints together, friction and offsets fitted)" in text
    assert "An RMS in the sentences below is of a quarter of the rows" in text


def test_a_model_of_another_arm_has_no_line_and_says_why(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = (folder / "true.urdf").read_text().replace("0.42", "0.5")
    (tmp_path / "long.urdf").write_text(other)
    assert run("compare", "--models", tmp_path / "long.urdf", folder / "true.urdf", "--", folder / "log.npz") == 1
    text = capsys.readouterr().out
    assert "lengths or gravity are others" in text
    assert text.index("true.urdf") < text.index("long.urdf")


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('<joint name="A2"', '<joint name="A2" stiffness="20"', "the file also has springs (stiffness)"),
        (
            "</worldbody>",
            '</worldbody><tendon><fixed damping="2"><joint joint="A2" coef="1"/><joint joint="A3" coef="1"/></fixed>'
            "</tendon>",
            "damping that is no viscous friction of one joint",
        ),
        (
            '<body name="link_7"',
            '<body name="link_7" gravcomp="1"',
            "the file also has gravity compensation (gravcomp)",
        ),
        ("</worldbody>", '</worldbody><equality><joint joint1="A1"/></equality>', "constraints (equality)"),
    ],
)
def test_an_mjcf_with_forces_that_no_body_has_is_refused_for_these(
    old: str, new: str, reason: str, folder: Path, tmp_path: Path
) -> None:
    """Its kinematics was said to be another; the same file without that force is read."""
    text = (folder / "true.xml").read_text()
    assert old in text
    (tmp_path / "more.xml").write_text(text.replace(old, new))
    with pytest.raises(RobotError) as refused:
        read_simulator_model(tmp_path / "more.xml", BaseRegressor(load_robot("iiwa14")))
    assert reason in str(refused.value)
    assert "zero positions" not in str(refused.value)


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["compare", "--models", "a.urdf"], 2, "then --, then recordings"),
        (["compare", "a.npz"], 2, "two recordings or more"),
        (["compare", "a.npz", "b.npz", "--offsets"], 2, "belongs to --models"),
    ],
)
def test_what_makes_no_comparison_is_refused(
    words: list[str], code: int, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*words) == code
    assert says in " ".join(capsys.readouterr().err.replace("│", " ").split())


def test_a_model_that_is_not_there_is_missing_input(folder: Path, tmp_path: Path) -> None:
    for name in ("none.urdf", "none.json"):
        assert run("compare", "--models", folder / "true.urdf", tmp_path / name, "--", folder / "log.npz") == 66


def test_a_damaged_model_is_one_row_with_its_reason(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "damaged.json").write_text("{")
    assert run("leaderboard", tmp_path / "damaged.json", folder / "true.urdf", "--on", folder / "log.npz") == 1
    text = capsys.readouterr().out
    assert "damaged.json: cannot be read as JSON" in text
    assert text.index("true.urdf") < text.index("damaged.json:")


def test_what_was_found_is_written_into_the_simulators_file(folder: Path, tmp_path: Path) -> None:
    robot, recording = load_robot("iiwa14"), read_recording(folder / "log.npz")
    place = zip("xyz", IIWA_FLANGE.point(OUT_M).tolist(), strict=True)
    numbers = [Number("mass", -EXTRA_KG, 0.01, "kg"), *(Number(f"com_{axis}", v, 0.001, "m") for axis, v in place)]
    taken_off = Difference("payload", None, 7, tuple(numbers), 0.99, 1e3, "model", "A load was taken off.")
    fixed = tmp_path / "fixed.urdf"
    written = write_model_back([recording], robot, folder / "heavy.urdf", [taken_off], fixed)
    assert written.files == (fixed, tmp_path / "fixed.urdf.png")
    assert written.files[1].stat().st_size > 10_000
    regressor = BaseRegressor(robot)
    before, after, true = (
        read_simulator_model(file, regressor) for file in (folder / "heavy.urdf", fixed, folder / "true.urdf")
    )
    moments = [regressor.names.index(name) for name in ("MX_7", "MY_7")]
    assert np.abs((before - true)[moments]).min() > 0.04
    np.testing.assert_allclose(after[moments], true[moments], atol=0.002)


def test_what_was_found_is_said_where_the_file_cannot_be_changed(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The whole diagnosis went with it: one line said that joints have no names, and the exit code was 65."""
    nameless = tmp_path / "nameless.xml"
    given = re.sub(r'<joint name="[^"]*"', "<joint", (folder / "true.xml").read_text())
    nameless.write_text(given.partition("<actuator")[0] + "</mujoco>")
    words = ["--model", nameless, "--write-model", tmp_path / "written.xml", "--out", tmp_path / "out"]
    assert run("diagnose", folder / "log.npz", *words) == 65
    said = capsys.readouterr()
    assert "Set-up: nameless.xml holds as well as any rigid body" in said.out
    assert f"Written to {tmp_path / 'out' / 'diagnosis.json'}" in said.out
    assert "joints without a name" in said.err


@pytest.mark.parametrize(
    "words",
    [
        ["--write-model", "a.urdf"],
        ["--model", "a.urdf", "--write-model", "a.urdf"],
        ["--model", "a.urdf", "--write-model", "b.xml"],
        ["--model", "a.urdf", "--write-model", "b"],
    ],
)
def test_a_model_is_written_only_beside_the_one_that_was_given(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("diagnose", "a.npz", *words) == 2
    assert "--write-model" in capsys.readouterr().err


def test_a_model_that_was_fitted_to_the_recording_says_so(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, own = folder / "log.npz", tmp_path / "own.json"
    digest = hashlib.sha256(log.read_bytes()).hexdigest()
    fitted = json.loads((folder / "model.json").read_text()) | {"provenance": {"inputs": [{"sha256": digest}]}}
    own.write_text(json.dumps(fitted))
    assert run("leaderboard", own, folder / "true.urdf", "--on", log, "--json", tmp_path / "board.json") == 0
    board = json.loads((tmp_path / "board.json").read_text())
    assert {Path(item["model"]).name: item["fitted_to"] for item in board["models"]} == {
        "own.json": ["log.npz"],
        "true.urdf": [],
    }
    assert capsys.readouterr().out.count("NO CHECK") == 1
    assert run("compare", own, log) == 0
    assert "NO CHECK" in capsys.readouterr().err
    assert run("leaderboard", own, "--on", log, "--on", log) == 65
