"""Claims about `payload` and `compare`: where the dashes and options may stand, what is printed, exit codes.

Truth: a body that Pinocchio adds to the paper's arm.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pinocchio
import pytest
from scipy.signal import butter, sosfiltfilt

from fixtures.physics import iiwa14_table_three
from identification.physical_parameters import PhysicalParameters
from identification.robots import load_robot
from tests.daemon.command_line import run
from tests.identification.synthetic import fourier_motion, inverse_dynamics


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Recordings of an iiwa 14 without and with 2 kg on its last link."""
    robot, links = load_robot("iiwa14"), iiwa14_table_three()
    bare = PhysicalParameters(links.mass, links.center_of_mass, links.inertia, links.viscous, links.coulomb)
    states = fourier_motion(7, period_s=20.0, samples=2000, seed=3)
    model = robot.pinocchio_model.copy()
    for joint in range(1, model.njoints):
        model.inertias[joint] = pinocchio.Inertia.Zero()
    body = pinocchio.Inertia(2.0, np.array([0.0, 0.03, 0.2]), 0.002 * np.eye(3))
    model.appendBodyToJoint(7, body, pinocchio.SE3.Identity())
    data = model.createData()
    load = np.array([pinocchio.rnea(model, data, *state) for state in zip(*states, strict=True)])
    generator, folder = np.random.default_rng(5), tmp_path_factory.mktemp("payload")
    for name, extra in (("bare", 0.0), ("tool", load)):
        torque = inverse_dynamics(robot, bare, *states) + extra + 0.03 * generator.standard_normal((2000, 7))
        np.savez(folder / f"{name}.npz", t=np.arange(2000) * 0.01, q=states[0], tau=torque, robot="iiwa14")
    return folder / "bare.npz", folder / "tool.npz"


def test_the_load_is_printed_as_the_cabinet_asks_for_it_and_options_may_stand_behind_the_files(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "load.json"
    bare, tool = map(str, files)
    assert run("payload", bare, "--", tool, "--robot", "iiwa14", "--json", str(out)) == 0
    text = capsys.readouterr().out
    assert float(text.removeprefix("Mass M: ").split()[0]) == pytest.approx(2.0, rel=0.01)
    assert "does not say which load data are set" in text
    assert "too light" not in text
    assert "carry less" not in text
    found = json.loads(out.read_text())
    assert found["mass"]["value"] == pytest.approx(2.0, rel=0.01)
    # In the flange's frame, which is the last link's turned by π about z and 126 mm further out.
    assert found["load_data"]["Y"] == pytest.approx(-30.0, abs=2.0)
    assert found["load_data"]["Z"] == pytest.approx(74.0, abs=2.0)
    low, high = found["mass"]["ci95"]
    assert low < 2.0 < high


def test_a_tool_taken_off_is_said_to_be_no_load_data(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """As when the two recordings are given the wrong way round."""
    assert run("payload", *map(str, reversed(files))) == 0
    assert "the second ones carry less" in capsys.readouterr().out


def test_a_joint_whose_torque_reads_otherwise_with_the_tool_is_told(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    held = dict(np.load(files[1]))
    np.savez(tmp_path / "tool.npz", **{**held, "tau": held["tau"] * np.where(np.arange(7) == 3, 0.97, 1.0)})
    assert run("payload", str(files[0]), str(tmp_path / "tool.npz"), "--json", str(tmp_path / "load.json")) == 0
    told = re.search(r"same torque of joint 4 reads (\S+) ± (\S+) % less with the tool", capsys.readouterr().out)
    assert told is not None
    size, half = map(float, told.groups())
    assert abs(size - 3.0) < half < 1.0
    assert json.loads((tmp_path / "load.json").read_text())["torque_ratio_joint"] == 4


PLANAR = """<robot name="planar"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.2 0.01 0"/><mass value="3"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial></link>
<link name="lower"><inertial><origin xyz="0.15 0.01 0"/><mass value="2"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin rpy="1.5707963267948966 0 0"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="100" velocity="5"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="100" velocity="5"/></joint></robot>
"""


@pytest.fixture
def planar(tmp_path: Path) -> Path:
    """Recordings of an arm in a plane without and with 1.2 kg, 350 mm from its last joint."""
    (tmp_path / "arm.urdf").write_text(PLANAR)
    bare = pinocchio.buildModelFromXML(PLANAR)
    loaded = pinocchio.buildModelFromXML(PLANAR)
    loaded.appendBodyToJoint(
        2, pinocchio.Inertia(1.2, np.array([0.35, 0.02, 0.03]), 0.003 * np.eye(3)), pinocchio.SE3.Identity()
    )
    states, generator = fourier_motion(2, period_s=20.0, samples=2000, seed=3), np.random.default_rng(5)
    for name, model in (("bare", bare), ("tool", loaded)):
        data = model.createData()
        torque = np.array([pinocchio.rnea(model, data, *state) for state in zip(*states, strict=True)])
        torque += 0.02 * generator.standard_normal(torque.shape)
        np.savez(tmp_path / f"{name}.npz", t=np.arange(2000) * 0.01, q=states[0], tau=torque, robot="arm.urdf")
    return tmp_path


def test_what_a_motion_cannot_determine_is_said_in_words(planar: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two parallel joints: where along them a load sits makes no torque, and of its inertia only the one about them."""
    words = ["payload", str(planar / "bare.npz"), "--", str(planar / "tool.npz")]
    assert run(*words, "--json", str(planar / "load.json")) == 0
    text = capsys.readouterr().out
    assert max(float(number) for number in re.findall(r"± ([\d.]+)", text)) < 20.0
    assert "not determined mm" in text
    assert "Not determined by these motions: Z, A, B, C, JX, JY." in text
    found = json.loads((planar / "load.json").read_text())
    assert found["undetermined"] == ["com_z", *(f"inertia_{entry}" for entry in ("xx", "yy", "xy", "xz", "yz"))]
    assert [name for name, value in found["load_data"].items() if value is None] == ["Z", "A", "B", "C", "JX", "JY"]
    assert found["load_data"]["X"] == pytest.approx(350.0, abs=2.0)
    assert found["mass"]["value"] == pytest.approx(1.2, rel=0.01)


def test_compare_weighs_a_load_far_from_its_link_with_its_inertia(planar: Path) -> None:
    """Its inertia about the last joint is more than that of the link: mass and moment alone would bend to it."""
    words = ["compare", str(planar / "bare.npz"), str(planar / "tool.npz")]
    assert run(*words, "--json", str(planar / "changes.json")) == 0
    (change,) = json.loads((planar / "changes.json").read_text())["changes"]
    (load,) = change["differences"]
    assert load["effect"] == "payload"
    assert load["number"] == pytest.approx(1.2, rel=0.02)
    low, high = load["interval"]
    assert low < 1.2 < high
    assert high - low < 0.2
    assert sum(change["audit"]["rms_after_nm"]) < 0.1


def test_compare_says_what_the_recording_may_be_that_the_others_are_compared_with(
    planar: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with np.load(planar / "bare.npz") as bare:
        smooth = sosfiltfilt(butter(2, 1.0, fs=100.0, output="sos"), bare["tau"], axis=0)
        np.savez(planar / "smooth.npz", **{**bare, "tau": smooth})
    assert run("compare", str(planar / "smooth.npz"), str(planar / "tool.npz")) == 0
    first = capsys.readouterr().err
    assert run("compare", str(planar / "bare.npz"), str(planar / "tool.npz")) == 0
    assert "low-passed before they were recorded" in first
    assert "low-passed before" not in capsys.readouterr().err


def test_a_series_is_of_recordings_as_they_have_to_be_read(planar: Path) -> None:
    """Exchanged torques were fitted as they stood, though the same answer says that they are exchanged."""
    viscous, generator, model = np.array([6.0, 1.5]), np.random.default_rng(5), pinocchio.buildModelFromXML(PLANAR)
    for number, order in enumerate(([0, 1], [0, 1], [1, 0], [0, 1])):
        states, data = fourier_motion(2, period_s=20.0, samples=2000, seed=number), model.createData()
        torque = np.array([pinocchio.rnea(model, data, *state) for state in zip(*states, strict=True)])
        torque += viscous * states[1] + 0.02 * generator.standard_normal(torque.shape)
        time = np.arange(2000) * 0.01
        np.savez(planar / f"{number}.npz", t=time, q=states[0], tau=torque[:, order], robot="arm.urdf")
    files = [str(planar / f"{number}.npz") for number in range(4)]
    assert run("compare", *files, "--json", str(planar / "series.json")) == 0
    result = json.loads((planar / "series.json").read_text())
    assert [item["effect"] for item in result["changes"][1]["differences"]] == ["wrong_joint_order"]
    for joint, true in zip(result["trend"]["joints"], viscous, strict=True):
        assert joint["friction_nm"] == pytest.approx(4 * [true * joint["speed_rad_s"]], rel=0.02)


def test_a_load_that_is_too_light_for_its_motion_is_said_with_the_time_that_would_do(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Truth: σ goes with one over the root of the time: ± 0.01 mm asks for (half width / 0.01 mm)² times the time."""
    out = tmp_path / "load.json"
    monkeypatch.setattr("daemon.cli.payload.CENTER_KNOWN_M", 1e-5)
    assert run("payload", *map(str, files), "--json", str(out)) == 0
    said = re.search(r"too light for ± 0.01 mm from 20 s of motion. About (\d+) s without", capsys.readouterr().out)
    assert said is not None
    halves = [
        (high - low) / 2.0
        for low, high in (axis["ci95"] for axis in json.loads(out.read_text())["center_of_mass"].values())
    ]
    assert float(said[1]) == pytest.approx(20.0 * (max(halves) / 1e-5) ** 2, abs=10.0)


def test_one_list_is_refused_with_what_to_write(files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert run("payload", str(files[0])) == 2
    assert "then --, then those with it" in capsys.readouterr().err


def test_the_same_arm_without_a_tool_has_no_load(files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    bare, other = dict(np.load(files[0])), files[0].with_name("other.npz")
    noise = 0.03 * np.random.default_rng(6).standard_normal(bare["tau"].shape)
    np.savez(other, **{**bare, "tau": bare["tau"] + noise})
    assert run("payload", str(files[0]), str(other)) == 65
    assert "No load can be seen" in capsys.readouterr().err


def test_compare_names_the_tool_as_what_changed(files: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "changes.json"
    assert run("compare", *map(str, files), "--json", str(out)) == 0
    (change,) = json.loads(out.read_text())["changes"]
    (difference,) = change["differences"]
    assert difference["kind"] == "payload"
    assert difference["link"] == 7
    assert difference["number"] == pytest.approx(2.0, rel=0.05)
    low, high = difference["interval"]
    assert low < 2.0 < high
    # Every run's recording is a recording.mcap: the sentence has the path that the user gave.
    assert difference["sentence"].endswith(f"of the difference to {files[0]}.")
    assert abs(change["parameters"][0]["sigmas"]) > 10.0


@pytest.mark.parametrize("words", [["bare", "--", "tool", "again"], ["bare", "--", "tool", "bare"]])
def test_one_measurement_weighs_once(
    words: list[str], files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """A copy in single precision is the same measurement; counted twice, every interval would be too narrow."""
    bare, tool = files
    held = dict(np.load(tool))
    np.savez(bare.with_name("again.npz"), **{**held, "tau": held["tau"].astype(np.float32)})
    named = {"bare": str(bare), "tool": str(tool), "again": str(bare.with_name("again.npz")), "--": "--"}
    assert run("payload", *(named[word] for word in words)) == 65
    assert "counts once" in capsys.readouterr().err


def test_a_recording_is_not_compared_with_itself(files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert run("compare", str(files[0]), str(files[0])) == 65
    assert "counts once" in capsys.readouterr().err


def test_a_load_is_not_called_taken_off_where_torques_have_the_sign_of_fri(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    turned = [tmp_path / file.name for file in files]
    for file, to in zip(files, turned, strict=True):
        with np.load(file) as sound:
            np.savez(to, **{**sound, "tau": -sound["tau"]})
    for command in ("compare", "payload"):
        assert run(command, *map(str, turned)) == 65
        assert "`iiwa-ident import --flip-torque`" in capsys.readouterr().err
    assert run("import", *map(str, turned), "--flip-torque") == 0
    assert "the sign of all torques was turned" in capsys.readouterr().out
    logs = [str(file.with_suffix(".mcap")) for file in turned]
    assert run("compare", *logs) == 0
    assert re.search(r"A load of (1\.99|2\.0).* kg on the flange", capsys.readouterr().out)
    assert run("payload", *logs) == 0
