"""Claims about `doctor --log`: a verdict for each question to a recording, exit codes.

Truth: torque of the paper's arm by Pinocchio, read with a fault that is put in.
"""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from fixtures.physics import iiwa14_table_three
from identification.mismatch.set_up import set_up_checks
from identification.physical_parameters import PhysicalParameters
from identification.recordings import read_recording
from identification.recordings.recording import Finding
from identification.recordings.units import wrong_torque_unit
from identification.robots import load_robot
from tests.daemon.command_line import run
from tests.identification.synthetic import fourier_motion, inverse_dynamics
from tests.reference import recording_file

UNKNOWN_KG = 0.8


@pytest.fixture(scope="module")
def sound() -> dict[str, np.ndarray]:
    """A recording of an iiwa 14 whose cabinet knows its load: the external torque is noise."""
    robot, links = load_robot("iiwa14"), iiwa14_table_three()
    physical = PhysicalParameters(links.mass, links.center_of_mass, links.inertia, links.viscous, links.coulomb)
    states = fourier_motion(7, period_s=10.0, samples=1000, seed=4)
    noise = 0.05 * np.random.default_rng(6).standard_normal((2, 1000, 7))
    torque = inverse_dynamics(robot, physical, *states) + noise[0]
    return {"t": np.arange(1000) * 0.01, "q": states[0], "dq": states[1], "tau": torque, "tau_ext": noise[1]}


def leaning(
    data: dict[str, np.ndarray], gravity: tuple[float, float, float] = (9.81, 0.0, 0.0)
) -> dict[str, np.ndarray]:
    robot, links = load_robot("iiwa14"), iiwa14_table_three()
    model = robot.pinocchio_model.copy()
    for link in range(7):
        model.inertias[link + 1] = pinocchio.Inertia(links.mass[link], links.center_of_mass[link], links.inertia[link])
    model.gravity.linear = np.array(gravity) - robot.gravity
    still = np.zeros(7)
    weight = [pinocchio.rnea(model, model.createData(), q, still, still) for q in data["q"]]
    return {**data, "tau": data["tau"] + np.array(weight)}


def torque_on_flange(mass: float, center: np.ndarray) -> np.ndarray:
    """(S, 7) Nm of a body alone on the last link along the motion."""
    model = load_robot("iiwa14").pinocchio_model.copy()
    for joint in range(1, 8):
        model.inertias[joint] = pinocchio.Inertia.Zero()
    model.appendBodyToJoint(7, pinocchio.Inertia(mass, center, 0.001 * np.eye(3)), pinocchio.SE3.Identity())
    states = fourier_motion(7, period_s=10.0, samples=1000, seed=4)
    return np.array([pinocchio.rnea(model, model.createData(), *state) for state in zip(*states, strict=True)])


def loaded(data: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    load = torque_on_flange(UNKNOWN_KG, np.array([0.0, 0.02, 0.2]))
    # External torque is what the load does to the joints, not what the joints do against it.
    return {**data, "tau": data["tau"] + load, "tau_ext": data["tau_ext"] - load}


def examined(data: dict[str, np.ndarray], folder: Path) -> tuple[int, dict[str, dict[str, str]]]:
    np.savez(folder / "log.npz", robot="iiwa14", **data)  # type: ignore[arg-type]
    code = run("doctor", "--log", folder / "log.npz", "--json", folder / "set_up.json")
    checks = json.loads((folder / "set_up.json").read_text())["checks"]
    return code, {item["name"]: item for item in checks}


def test_a_sound_recording_passes_every_check(sound: dict[str, np.ndarray], tmp_path: Path) -> None:
    code, checks = examined(sound, tmp_path)
    assert code == 0
    assert list(checks) == [
        "gravity", "torque signs", "clock", "rows", "units", "order of joints", "constancy", "one body", "late torque",
        "load data",
    ]  # fmt: skip
    assert {item["status"] for item in checks.values()} == {"ok"}


def test_bytes_of_a_file_that_are_damaged_or_missing_are_a_warning(
    sound: dict[str, np.ndarray], tmp_path: Path
) -> None:
    """Of a whole one there is no such check: see the sound recording."""
    np.savez(tmp_path / "log.npz", robot="iiwa14", **sound)  # type: ignore[arg-type]
    recording = read_recording(tmp_path / "log.npz")
    findings = tuple(
        Finding.of_all(kind, 1000, f"of this {kind} it is said") for kind in ("damaged_attachment", "truncated_file")
    )
    damaged = replace(recording, report=replace(recording.report, findings=findings))
    robot = load_robot("iiwa14")
    checks = {each.name: each for each in set_up_checks([damaged], robot, [])}
    assert checks["file"].status == "warning"
    assert all(f"of this {finding.kind} it is said" in checks["file"].sentence for finding in findings)


def test_a_turned_sensor_fails_its_check(sound: dict[str, np.ndarray], tmp_path: Path) -> None:
    code, checks = examined({**sound, "tau": sound["tau"] * [1, 1, -1, 1, 1, 1, 1]}, tmp_path)
    assert code == 1
    assert checks["torque signs"]["status"] == "failed"
    assert "joint 3" in checks["torque signs"]["sentence"]


def test_a_clock_that_runs_twice_as_fast_is_not_called_right(sound: dict[str, np.ndarray], tmp_path: Path) -> None:
    """Recorded at 100 Hz and stamped as if at 50 Hz; without a velocity only inertia against gravity tells."""
    q = sound["q"] + 1e-5 * np.random.default_rng(8).standard_normal(sound["q"].shape)
    slow = {"t": 2.0 * sound["t"], "q": q, "tau": sound["tau"], "tau_ext": sound["tau_ext"]}
    _, checks = examined(slow, tmp_path)
    # Free functions of each joint do as well as another clock here, so it is no fault.
    assert checks["clock"]["status"] == "warning"
    ratio = float(re.findall(r"clock of ([\d.]+)", checks["clock"]["sentence"])[0])
    assert ratio == pytest.approx(2.0, abs=0.1)
    _, right = examined({name: values for name, values in sound.items() if name != "dq"}, tmp_path)
    assert right["clock"]["status"] == "ok"


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (
            lambda data: leaning(loaded(data)),
            {"gravity": "does not stand as stated", "load data": f"lack {UNKNOWN_KG}"},
        ),
        (
            lambda data: {**data, "tau": data["tau"][:, [0, 5, 2, 3, 4, 1, 6]]},
            {"order of joints": "that of joint 2 stands under joint 6"},
        ),
    ],
)
def test_what_was_put_in_fails_its_check(
    spoil: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]],
    expected: dict[str, str],
    sound: dict[str, np.ndarray],
    tmp_path: Path,
) -> None:
    np.savez(tmp_path / "log.npz", robot="iiwa14", **spoil(sound))  # type: ignore[arg-type]
    checks = set_up_checks([read_recording(tmp_path / "log.npz")], load_robot("iiwa14"), ())
    failed = {item.name: item.sentence for item in checks if item.status != "ok"}
    assert failed.keys() == expected.keys()
    assert all(words in failed[name] for name, words in expected.items())


def test_torques_that_are_a_thousand_times_too_small_fail_their_check(
    sound: dict[str, np.ndarray], tmp_path: Path
) -> None:
    code, checks = examined({**sound, "tau": 1e-3 * sound["tau"], "tau_ext": 1e-3 * sound["tau_ext"]}, tmp_path)
    assert code == 1
    assert checks["units"]["status"] == "failed"
    assert "Are they in kNm?" in checks["units"]["sentence"]
    assert "multiply each joint's by its gear ratio and torque constant" in checks["units"]["sentence"]


@pytest.mark.parametrize(
    ("name", "robot"),
    [
        ("kr300_a", "kr300.urdf"),
        ("tx40_excitation", "tx40.urdf"),
        ("ur10", "ur10_mdh.csv"),
        ("lbrmed7", "med7dock.urdf"),
    ],
)
def test_only_newton_metres_pass_for_the_torques_of_real_arms(name: str, robot: str) -> None:
    """A TX40 is so heavy for its length that a wrong prefix goes unseen: better than to refuse a right one."""
    recording, arm = read_recording(recording_file(f"{name}.npz")), load_robot(recording_file(robot))
    said = {}
    for factor in (1e-3, 1.0, 1e3):
        scaled = replace(recording, torque=factor * recording.torque)
        (units,) = (each for each in set_up_checks([scaled], arm, (), large=False) if each.name == "units")
        said[factor] = units.status, units.sentence.rpartition(". ")[2]
    assert said[1.0][0] == "ok"
    if name != "tx40_excitation":
        assert said[1e-3] == ("failed", "Are they in kNm?")
        assert said[1e3] == ("failed", "Are they in mNm?")


def test_a_fit_to_torques_in_another_unit_is_warned_of_where_nobody_stated_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The UR10's table knows no efforts, so nothing at reading told: every mass was a thousand times too large."""
    with np.load(recording_file("ur10.npz")) as file:
        arrays = dict(file)
    robot = ["--robot", recording_file("ur10_mdh.csv"), "--out", tmp_path / "model.json"]
    arrays.pop("robot", None)
    for stated, factor in (("", 1e3), ("Nm", 1e3), ("", 1.0), ("mNm", 1e3)):
        np.savez(
            tmp_path / "log.npz",
            **{**arrays, "tau": factor * arrays["tau"], **({"tau_unit": stated} if stated else {})},
        )
        assert run("fit", tmp_path / "log.npz", *robot, "--no-physical") == 0
        said = capsys.readouterr()
        assert ("Are they in mNm?" in said.out + said.err) == (factor == 1e3 and not stated)


def test_a_recording_without_motion_is_refused_in_one_sentence(
    sound: dict[str, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = {**sound, "q": np.tile(sound["q"][0], (1000, 1)), "dq": 0.0 * sound["dq"]}
    np.savez(tmp_path / "log.npz", robot="iiwa14", **still)  # type: ignore[arg-type]
    assert run("doctor", "--log", tmp_path / "log.npz") == 65
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [["fit", "--no-physical"], ["import", "--out", "log.mcap"], ["diagnose"], ["batch", "fit"], ["payload"]],
    ids=lambda words: words[0],
)  # fmt: skip
def test_nothing_is_fitted_under_a_gravity_that_the_recording_contradicts(
    words: list[str], sound: dict[str, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    np.savez("log.npz", robot="iiwa14", **leaning(sound))  # type: ignore[arg-type]
    np.savez("level.npz", robot="iiwa14", **sound)  # type: ignore[arg-type]
    logs = ["level.npz", "log.npz"] if words[0] in ("payload", "fit") else ["log.npz"]
    options = ["--jobs", "1"] if words[0] == "batch" else []
    before = set(tmp_path.iterdir())
    assert run(*words, *logs, *options) == (1 if words[0] == "batch" else 65)
    said = capsys.readouterr()
    assert "gravity is (9.81" in said.err + said.out.replace("\n", " ")
    assert "--mount auto, or --gravity=9.8" in said.err + said.out
    assert "log.npz: The base does not stand as stated" in said.err + said.out
    assert "Traceback" not in said.err
    assert words[0] == "batch" or set(tmp_path.iterdir()) == before


@pytest.fixture(scope="module")
def model(sound: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a fit makes of the sound recording."""
    folder = tmp_path_factory.mktemp("sound")
    np.savez(folder / "sound.npz", robot="iiwa14", **sound)  # type: ignore[arg-type]
    assert run("fit", folder / "sound.npz", "--no-physical", "--out", folder / "model.json") == 0
    return folder / "model.json"


def test_joints_in_another_order_are_told_by_a_fit_and_beside_a_model(
    sound: dict[str, np.ndarray], model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of an arm whose joints are e0, e1, s0, s1, w0 by name. The answer beside a model goes before all else."""
    order = [2, 3, 0, 1, 4, 5, 6]
    moved = {name: values if name == "t" else values[:, order] for name, values in sound.items()}
    np.savez(tmp_path / "log.npz", robot="iiwa14", **moved)  # type: ignore[arg-type]
    folder = tmp_path / "diagnosis"
    assert run("fit", tmp_path / "log.npz", "--no-physical", "--out", tmp_path / "moved.json") == 0
    assert "--joints 3,4,1,2,5,6,7" in capsys.readouterr().out
    assert run("validate", model, tmp_path / "log.npz") == 0
    assert "--joints 3,4,1,2,5,6,7" in capsys.readouterr().out
    assert run("diagnose", tmp_path / "log.npz", "--model", model, "--out", folder) == 0
    (first, *_) = json.loads((folder / "diagnosis.json").read_text())["differences"]
    assert first["sentence"].startswith("Positions and torques stand in another order than the robot's joints")
    assert "--joints 3,4,1,2,5,6,7" in first["sentence"]


def test_a_torque_without_weight_is_refused_by_a_fit_and_said_where_a_model_is_validated(
    sound: dict[str, np.ndarray], model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savez(tmp_path / "log.npz", robot="iiwa14", **leaning(sound, (0.0, 0.0, 0.0)))  # type: ignore[arg-type]
    assert run("fit", tmp_path / "log.npz", "--no-physical", "--out", tmp_path / "model.json") == 65
    assert "holds no weight of the arm" in capsys.readouterr().err
    assert run("validate", model, tmp_path / "log.npz") == 0
    assert "holds no weight of the arm" in capsys.readouterr().err


def test_a_recording_is_imported_as_it_shows_that_it_stood(
    sound: dict[str, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savez(tmp_path / "log.npz", robot="iiwa14", **leaning(sound))  # type: ignore[arg-type]
    log = tmp_path / "log.mcap"
    assert run("import", tmp_path / "log.npz", "--mount", "auto", "--out", log) == 0
    assert "Gravity is taken as the recordings show it" in capsys.readouterr().err
    gravity = np.array(read_recording(log).installation.gravity)
    assert np.linalg.norm(gravity - [9.81, 0.0, 0.0]) < np.radians(1.0) * 9.81


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The arm of the recording as URDF text."""
    folder = tmp_path_factory.mktemp("twin")
    assert run("twin", "--out", folder) == 0
    return (folder / "iiwa14.urdf").read_text()


def without(text: str, link: str, *, whole: bool) -> str:
    """A URDF in which one link has no body, or is not there at all."""
    root = ElementTree.fromstring(text)
    (found,) = [item for item in root.findall("link") if item.get("name") == link]
    if whole:
        root.remove(found)
    else:
        found.remove(next(found.iter("inertial")))
    return ElementTree.tostring(root, encoding="unicode")


@pytest.mark.parametrize(
    ("case", "expected"),
    [
        ("body", "what joint 'A4' moves has no mass"),
        ("mass", "what joint 'A4' moves has a mass of -1 kg"),
        ("link", "cannot be read as a simulator model"),
        ("arm", "has 6 movable joints, iiwa14 has 7"),
        ("still", "no joint moves"),
        ("load", "and can bear"),
    ],
)
def test_what_cannot_be_compared_is_refused_in_one_sentence(
    case: str, expected: str, twin: str, sound: dict[str, np.ndarray], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    data, model = dict(sound), tmp_path / "arm.urdf"
    match case:
        case "body" | "link":
            model.write_text(without(twin, "link_4", whole=case == "link"))
        case "mass":
            root = ElementTree.fromstring(twin)
            (body,) = root.findall("link[@name='link_4']/inertial/mass")
            body.set("value", "-1")
            model.write_text(ElementTree.tostring(root, encoding="unicode"))
        case "arm":
            model.write_text(recording_file("tx40.urdf").read_text())
        case "still":
            model.write_text(twin)
            data |= {"q": np.tile(sound["q"][0], (1000, 1)), "dq": 0.0 * sound["dq"]}
        case "load":
            model.write_text(twin)
            data["tau"] = sound["tau"] + torque_on_flange(2000.0, np.array([0.0, 0.0, 0.0]))
    log, out = tmp_path / "log.npz", tmp_path / "diagnosis"
    np.savez(log, robot="iiwa14", **data)  # type: ignore[arg-type]
    assert run("diagnose", log, "--model", model, "--out", out) == 65
    said = capsys.readouterr()
    assert expected in said.err
    assert "Traceback" not in said.err
    assert not out.exists()
    assert not said.out


def test_four_arms_on_one_body_are_not_as_long_as_all_of_them_together(tmp_path: Path) -> None:
    """A torso that turns and four arms of 0.8 m: 20 Nm are what such an arm has."""
    links, joints = ['<link name="base"/><link name="body"/>'], [joint_of("waist", "base", "body", 0.2)]
    for arm in range(4):
        parent = "body"
        for number in range(3):
            child = f"arm{arm}_{number}"
            links.append(f'<link name="{child}"/>')
            joints.append(joint_of(f"j{child}", parent, child, 0.4 if number else 0.1))
            parent = child
    (tmp_path / "torso.urdf").write_text(f'<robot name="torso">{"".join(links)}{"".join(joints)}</robot>')
    robot = load_robot(tmp_path / "torso.urdf")
    for gravity_acts in (False, True):
        assert not wrong_torque_unit(20.0, robot, gravity_acts=gravity_acts)
    assert wrong_torque_unit(0.02, robot, gravity_acts=True).endswith("Are they in kNm?")


def joint_of(name: str, parent: str, child: str, offset: float) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{offset} 0 0"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="99" velocity="5"/></joint>'
    )
