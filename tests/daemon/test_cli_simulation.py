"""Claims about `export` and `simulate` as a user meets them: files, sentences and exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from identification.excitation import default_trajectory
from identification.physical_parameters import PhysicalParameters
from tests.daemon.command_line import run
from tests.identification.exported import model_of, random_bodies
from tests.reference import recording_file


@pytest.fixture
def good(tmp_path: Path) -> Path:
    model_of(tmp_path, "iiwa14", random_bodies(7, 2))
    return tmp_path / "model.json"


@pytest.fixture
def short_motion(tmp_path: Path) -> Path:
    """A second of the shipped excitation's speed: its path at a tenth, ten times as fast."""
    table = default_trajectory().scaled(0.02).table(100.0)
    path = tmp_path / "short.npz"
    np.savez(path, q=table, rate_hz=1000.0)
    return path


def test_export_writes_what_mujoco_loads_and_says_what_was_compared(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "arm.xml"
    assert run("export", good, "--format", "mjcf", "--out", target, "--json", tmp_path / "result.json") == 0
    assert mujoco.MjModel.from_xml_path(str(target)).nv == 7
    said = capsys.readouterr().out
    assert "MuJoCo" in said
    assert "note: damping and frictionloss" in said
    result = json.loads((tmp_path / "result.json").read_text())
    assert max(item["difference_nm"] for item in result["read_back"]) < 1e-9


def test_export_adds_a_prior_of_motor_inertias_only_when_asked_and_says_so(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, option, expected in (("without.xml", [], 0.0), ("with.xml", ["--motor-inertia"], 4.4)):
        assert run("export", good, "--format", "mjcf", "--out", tmp_path / name, *option) == 0
        assert mujoco.MjModel.from_xml_path(str(tmp_path / name)).dof_armature[0] == pytest.approx(expected)
    assert "prior" in capsys.readouterr().err


def test_export_refuses_links_that_no_body_can_be_with_65(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fine = random_bodies(7, 2)
    inertia = fine.inertia.copy()
    inertia[4] = np.diag([0.01, 0.01, 0.03])
    model_of(
        tmp_path, "iiwa14", PhysicalParameters(fine.mass, fine.center_of_mass, inertia, fine.viscous, fine.coulomb)
    )
    words = ["export", tmp_path / "model.json", "--format", "urdf", "--out", tmp_path / "arm.urdf"]
    assert run(*words, "--parameters", "physical") == 65
    error = capsys.readouterr().err
    assert "link 5" in error
    assert "-0.01" in error
    assert not (tmp_path / "arm.urdf").exists()
    assert run(*words) == 0
    assert run("export", tmp_path / "none.json", "--format", "urdf", "--out", tmp_path / "arm.urdf") == 66


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_simulate_follows_a_trajectory_and_writes_series_figure_and_summary(
    suffix: str, good: Path, short_motion: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    series, figure = tmp_path / f"series{suffix}", tmp_path / "figure.png"
    options = ["--controller", "position", "--out", series, "--figure", figure, "--json", "-"]
    assert run("-q", "simulate", good, short_motion, *options) == 0
    summary = json.loads(capsys.readouterr().out)
    assert "prior" in summary["motor_note"]
    assert len(summary["position_rms"]["simulated minus commanded"]) == 7
    assert figure.read_bytes().startswith(b"\x89PNG")
    if suffix == ".npz":
        with np.load(series) as archive:
            assert archive["simulated_torque"].shape == (1000, 7)
    else:
        assert np.loadtxt(series, delimiter=",", skiprows=1).shape == (1000, 29)


def test_simulate_takes_a_table_with_torques_for_a_recording(good: Path, tmp_path: Path) -> None:
    time = np.arange(3000) * 1e-3
    position = 0.3 * np.sin(2.0 * np.pi * time[:, None] * np.linspace(0.4, 0.6, 7))
    np.savez(tmp_path / "log.npz", t=time, q=position, tau=10.0 * position)
    result = tmp_path / "result.json"
    assert run("-q", "simulate", good, tmp_path / "log.npz", "--json", result) == 0
    labels = [row["label"] for row in json.loads(result.read_text())["torque_rms"]]
    assert "measured minus simulated" in labels


def test_simulate_reads_a_recording_as_the_fit_did(tmp_path: Path) -> None:
    """Of a model whose fit turned the torque, "measured minus inverse dynamics" was the torque twice."""
    log, model, result = tmp_path / "turned.npz", tmp_path / "model.json", tmp_path / "result.json"
    with np.load(recording_file("emps_a.npz")) as known:
        np.savez(log, **{**known, "tau": -known["tau"]})
    robot = recording_file("emps.urdf")
    assert run("-q", "fit", log, "--robot", robot, "--flip-torque", "--out", model) == 0
    assert run("-q", "simulate", model, log, "--json", result) == 0
    left = {row["label"]: row["total_nm"] for row in json.loads(result.read_text())["torque_rms"]}
    fitted = json.loads(model.read_text())["rms_nm"]["fit_physical"][0]
    assert left["measured minus inverse dynamics"] == pytest.approx(fitted, rel=1e-3)


def test_simulate_says_what_it_cannot_use(good: Path, tmp_path: Path) -> None:
    assert run("simulate", good, tmp_path / "absent.json") == 66
    assert run("simulate", good, "--figure", tmp_path / "figure.docx") == 2
    assert run("simulate", good, "--controller", "psychic") == 2
    np.savez(tmp_path / "two.npz", q=np.zeros((10, 2)), rate_hz=100.0)
    assert run("simulate", good, tmp_path / "two.npz") == 2


@pytest.mark.parametrize(
    ("field", "expected"),
    [
        ("mass", "the mass of link 2 is 0 kg"),
        ("inertia", "the smallest principal moment of inertia of link 2 is -0.02 kg m²"),
        ("viscous", "the viscous friction of joint 2 is -0.5 Nm s/rad"),
        ("coulomb", "the Coulomb friction of joint 2 is -0.5 Nm"),
        ("rotor_inertia", "the rotor inertia of joint 2 is -0.1 kg m²"),
    ],
)
def test_what_no_moving_arm_has_is_not_simulated(
    field: str, expected: str, good: Path, short_motion: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = json.loads(good.read_text())
    body, friction = model["physical_parameters"][1], model["friction"][1]
    model["drives"] = [{"joint": joint, "rotor_inertia": 1.0, "offset": 0.0} for joint in range(1, 8)]
    match field:
        case "mass":
            body["mass"] = 0.0
        case "inertia":
            body["inertia"] = np.diag([0.01, -0.02, 0.01]).tolist()
        case "viscous" | "coulomb":
            friction[field] = -0.5
        case "rotor_inertia":
            model["drives"][1][field] = -0.1
    good.write_text(json.dumps(model))
    assert run("simulate", good, short_motion) == 65
    said = capsys.readouterr()
    assert expected in said.err
    assert not said.out


def test_what_a_solver_leaves_below_zero_by_rounding_moves(
    good: Path, short_motion: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = json.loads(good.read_text())
    model["friction"][1]["viscous"] = -4.4e-14
    good.write_text(json.dumps(model))
    assert run("simulate", good, short_motion) == 0
    assert "no arm that moves" not in capsys.readouterr().err
