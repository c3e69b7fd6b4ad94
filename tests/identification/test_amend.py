"""Claims about a simulator's file with what was found written into it.

Truth: Pinocchio's inverse dynamics of the paper's arm with a body on its flange, more friction and a base that leans,
built without any file. Read back: the URDF by Pinocchio, the MJCF by MuJoCo, the SDF by Drake.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest

from identification.audit.columns import Geometry
from identification.audit.difference import Difference, Number, numbers_of
from identification.audit.foretold import lacking_friction
from identification.audit.rows import rows_of
from identification.audit.sentences import turned_signs
from identification.base_parameters import BaseRegressor
from identification.errors import ExportCheckError, ModelFileError, RobotError
from identification.export.amend import _wanted, amend
from identification.export.amended_files import Changes, write_mjcf_changes, write_sdf_changes, write_urdf_changes
from identification.export.write import export_model
from identification.export.write_back import write_back
from identification.physical_parameters import PhysicalParameters
from identification.robots import load_robot
from identification.robots.simulator_models import read_simulator_model
from tests.identification.exported import consistent, model_of
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

MASS_KG, CENTER_M = 1.5, np.array([0.06, 0.03, 0.1])
MORE_VISCOUS, MORE_COULOMB = 0.3, 0.2
ANGLE = 0.3
GRAVITY = 9.81 * np.array([np.sin(ANGLE), 0.0, -np.cos(ANGLE)])
FILES = {"urdf": "arm.urdf", "sdf": "arm.sdf", "mjcf": "arm.xml"}
Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def physical(table3: PhysicalParameters) -> PhysicalParameters:
    return consistent(table3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, physical: PhysicalParameters) -> Path:
    place = tmp_path_factory.mktemp("arms")
    model = model_of(place, "iiwa14", physical)
    for form, name in FILES.items():
        export_model(model, place / name, form, parameter_set="physical")
    return place


def number(name: str, value: float) -> Number:
    return Number(name, value, 0.01 * abs(value), "")


def payload(mass: float) -> Difference:
    center = zip("xyz", CENTER_M.tolist(), strict=True)
    numbers = (number("mass", mass), *(number(f"com_{axis}", value) for axis, value in center))
    return Difference("payload", None, 7, numbers, 0.9, 100.0, "model", "A load.")


def friction() -> Difference:
    numbers = (number("viscous", MORE_VISCOUS), number("coulomb", MORE_COULOMB))
    return Difference("friction_change", 3, None, numbers, 0.9, 100.0, "model", "Friction.")


def tilt() -> Difference:
    numbers = [number(f"gravity_{axis}", value) for axis, value in zip("xyz", GRAVITY.tolist(), strict=True)]
    return Difference("base_tilt", None, None, (number("angle", ANGLE), *numbers), 0.9, 100.0, "model", "Leans.")


def states() -> zip[tuple[np.ndarray, ...]]:
    generator = np.random.default_rng(8)
    q, dq, ddq = (generator.uniform(-1.5, 1.5, (10, 7)) for _ in range(3))
    return zip(q, dq, ddq, strict=True)


def truth(physical: PhysicalParameters, gravity: np.ndarray, mass: float) -> Torque:
    """The arm with a point on its flange, whose axes are the last link's turned by π about z, 126 mm out."""
    model = load_robot("iiwa14").pinocchio_model.copy()
    model.gravity.linear = gravity
    for link in range(7):
        model.inertias[link + 1] = pinocchio.Inertia(
            physical.mass[link], physical.center_of_mass[link], physical.inertia[link]
        )
    at = np.diag([-1.0, -1.0, 1.0]) @ CENTER_M + np.array([0.0, 0.0, 0.126])
    model.appendBodyToJoint(7, pinocchio.Inertia(mass, at, np.zeros((3, 3))), pinocchio.SE3.Identity())
    data = model.createData()
    viscous, coulomb = physical.viscous.copy(), physical.coulomb.copy()
    viscous[2] += MORE_VISCOUS
    coulomb[2] += MORE_COULOMB

    def torque(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        return np.asarray(pinocchio.rnea(model, data, q, dq, ddq) + viscous * dq + coulomb * np.sign(dq))

    return torque


def by_pinocchio(file: Path) -> Torque:
    model = pinocchio.buildModelFromUrdf(str(file))
    data = model.createData()
    joints = [ElementTree.parse(file).getroot().find(f"joint[@name='{name}']/dynamics") for name in model.names[1:]]
    damping, dry = (np.array([float(item.get(key)) for item in joints]) for key in ("damping", "friction"))  # type: ignore[union-attr, arg-type]
    return lambda q, dq, ddq: pinocchio.rnea(model, data, q, dq, ddq) + damping * dq + dry * np.sign(dq)


def by_mujoco(file: Path) -> Torque:
    model = mujoco.MjModel.from_xml_path(str(file))
    dry = np.array(model.dof_frictionloss)
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)

    def torque(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        return np.asarray(data.qfrc_inverse + dry * np.sign(dq))

    return torque


@pytest.mark.parametrize(("name", "reader"), [("arm.urdf", by_pinocchio), ("arm.xml", by_mujoco)])
@pytest.mark.parametrize("mass", [MASS_KG, -0.05])
def test_a_simulator_moves_the_arm_as_it_was_found(
    name: str, reader: Callable[[Path], Torque], mass: float, folder: Path, physical: PhysicalParameters, tmp_path: Path
) -> None:
    before = (folder / name).read_bytes()
    written = amend(folder / name, [payload(mass), friction(), tilt()], load_robot("iiwa14"), tmp_path / name)
    assert (folder / name).read_bytes() == before
    assert written.written == ("A load.", "Friction.", "Leans.")
    expected, found = truth(physical, GRAVITY, mass), reader(tmp_path / name)
    for state in states():
        # MuJoCo's editor writes six digits.
        np.testing.assert_allclose(found(*state), expected(*state), rtol=1e-5, atol=2e-4)


@pytest.mark.parametrize(("name", "reader"), [("arm.urdf", by_pinocchio), ("arm.xml", by_mujoco)])
@pytest.mark.parametrize("late", [0, 1])
def test_a_lean_that_a_file_has_already_is_not_written_twice(
    name: str, reader: Callable[[Path], Torque], late: int, folder: Path, physical: PhysicalParameters, tmp_path: Path
) -> None:
    """The lean was found against gravity as stated, whatever the file says of it: written twice it is not doubled.

    late: whether load and friction are written into the file that leans already.
    """
    source = folder / name
    for time in range(2):
        changes = [payload(MASS_KG), friction(), tilt()] if time == late else [tilt()]
        amend(source, changes, load_robot("iiwa14"), tmp_path / f"{time}_{name}")
        source = tmp_path / f"{time}_{name}"
    expected, found = truth(physical, GRAVITY, MASS_KG), reader(source)
    for state in states():
        # MuJoCo's editor writes six digits.
        np.testing.assert_allclose(found(*state), expected(*state), rtol=1e-5, atol=2e-4)


@pytest.mark.parametrize("form", FILES)
def test_a_file_whose_base_hangs_turned_is_the_same_arm(
    form: str, folder: Path, physical: PhysicalParameters, tmp_path: Path
) -> None:
    """Gravity is in the frame of the base: with the pose of a world joint or model besides it was counted twice."""
    if form == "sdf":
        pytest.importorskip("pydrake")
    robot = load_robot("iiwa14")
    leaning = BaseRegressor(replace(robot, gravity=GRAVITY))
    amend(folder / FILES[form], [tilt()], robot, tmp_path / FILES[form])
    for regressor in (BaseRegressor(robot), leaning):
        found = read_simulator_model(tmp_path / FILES[form], regressor)
        assert found == pytest.approx(regressor.base_from_physical(physical), abs=1e-5)


def test_an_sdf_has_the_load_too(folder: Path, physical: PhysicalParameters, tmp_path: Path) -> None:
    pytest.importorskip("pydrake")
    amend(folder / "arm.sdf", [payload(MASS_KG), friction()], load_robot("iiwa14"), tmp_path / "arm.sdf")
    regressor = BaseRegressor(load_robot("iiwa14"))
    values = read_simulator_model(tmp_path / "arm.sdf", regressor)
    expected = truth(physical, np.array([0.0, 0.0, -9.81]), MASS_KG)
    for state in states():
        columns = regressor.matrix(*(each[None] for each in state))[0]
        np.testing.assert_allclose(columns @ values, expected(*state), atol=1e-5)


def test_nothing_else_of_a_urdf_is_touched(folder: Path, tmp_path: Path) -> None:
    amend(folder / "arm.urdf", [payload(MASS_KG)], load_robot("iiwa14"), tmp_path / "arm.urdf")
    before, after = (ElementTree.parse(place / "arm.urdf").getroot() for place in (folder, tmp_path))
    changed = [
        (one.tag, one.get("name"))
        for one, other in zip(before, after, strict=True)
        if ElementTree.tostring(one).split() != ElementTree.tostring(other).split()
    ]
    assert changed == [("link", "link_7")]


def test_what_is_the_recordings_fault_is_left_out_and_said(folder: Path, tmp_path: Path) -> None:
    late = Difference("torque_delay", None, None, (number("delay", 0.02),), 0.5, 50.0, "model", "The torque is late.")
    written = amend(folder / "arm.urdf", [late], load_robot("iiwa14"), tmp_path / "arm.urdf")
    assert written.written == ()
    assert "The torque is late." in written.left[0]


def test_a_link_without_a_mass_and_another_format_are_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match=r"link 'link_7' would be left with -\d"):
        amend(folder / "arm.urdf", [payload(-40.0)], load_robot("iiwa14"), tmp_path / "arm.urdf")
    with pytest.raises(ModelFileError, match=r"ends in \.urdf"):
        amend(folder / "arm.urdf", [payload(1.0)], load_robot("iiwa14"), tmp_path / "arm.xml")
    assert not list(tmp_path.iterdir())


def test_an_inertia_that_no_body_has_becomes_the_nearest_and_is_said(folder: Path, tmp_path: Path) -> None:
    numbers = (number("mass", 0.1), number("first_moment_x", 0.02), number("XX", -0.5))
    wrong = Difference("link_parameters", None, 4, numbers, 0.9, 100.0, "model", "Link 4.")
    written = amend(folder / "arm.urdf", [wrong], load_robot("iiwa14"), tmp_path / "arm.urdf")
    assert "nearest that a body can have" in written.left[0]
    inertias = pinocchio.buildModelFromUrdf(str(tmp_path / "arm.urdf")).inertias
    assert np.linalg.eigvalsh(inertias[4].inertia).min() > 0.0


def test_the_file_of_another_arm_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises((ExportCheckError, RobotError)):
        amend(folder / "arm.urdf", [payload(1.0)], load_robot("iiwa7"), tmp_path / "arm.urdf")
    assert not (tmp_path / "arm.urdf").exists()


PLANAR = """<sdf version="1.9"><model name="planar">
<link name="base"/>
<link name="upper"><inertial><pose>0 0 0.2 0 0 0</pose><mass>3</mass></inertial></link>
<link name="lower"><pose relative_to="elbow"/><inertial><pose>0 0 0.15 0 0 0</pose><mass>2</mass></inertial></link>
<joint name="shoulder" type="revolute"><parent>base</parent><child>upper</child><axis><xyz>0 1 0</xyz></axis></joint>
<joint name="elbow" type="revolute"><pose relative_to="upper">0 0 0.5 0 0 0</pose><parent>upper</parent>
<child>lower</child><axis><xyz>0 1 0</xyz></axis></joint>
<joint name="stand" type="fixed"><parent>world</parent><child>base</child></joint>
</model></sdf>"""
"""Two links in a plane: 3 kg at 0.2 m of 0.5 m, 2 kg at 0.15 m."""


def planar_torque(q: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Torque that holds the two links, by hand: the slope of the potential energy, links along z at zero, axes y."""

    def along(angle: float) -> float:
        return float(gravity[0] * np.cos(angle) - gravity[2] * np.sin(angle))

    elbow = -2.0 * 0.15 * along(q[0] + q[1])
    return np.array([-(3.0 * 0.2 + 2.0 * 0.5) * along(q[0]) + elbow, elbow])


@pytest.mark.parametrize("stated", ["", "<pose>0.1 0.2 0.3 0 0 0.4</pose>"])
def test_drake_holds_an_sdf_that_leans_with_the_torque_of_two_links_by_hand(stated: str, tmp_path: Path) -> None:
    plants = pytest.importorskip("pydrake.multibody.plant")
    parsing = pytest.importorskip("pydrake.multibody.parsing")
    source, target = tmp_path / "planar.sdf", tmp_path / "leaning.sdf"
    source.write_text(PLANAR.replace('<link name="base"/>', f'{stated}<link name="base"/>'))
    cosine, sine = np.cos(ANGLE), np.sin(ANGLE)
    turn = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    write_sdf_changes(source, target, Changes({}, {}, {}, {}, turn))
    plant = plants.MultibodyPlant(0.0)
    parsing.Parser(plant).AddModels(str(target))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    yaw = 0.4 if stated else 0.0
    # The base's own yaw comes after the lean: gravity in its frame turns back by it.
    back = np.array([[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    for q in np.random.default_rng(3).uniform(-2.0, 2.0, (5, 2)):
        plant.SetPositions(context, q)
        held = -plant.CalcGravityGeneralizedForces(context)
        np.testing.assert_allclose(held, planar_torque(q, back @ GRAVITY), atol=1e-6)


def test_friction_is_read_off_the_torque_as_it_was_found_to_be(tmp_path: Path, physical: PhysicalParameters) -> None:
    """Off a turned torque none was read, and off one of another scale too much, with an offset to be applied."""
    bare = PhysicalParameters(physical.mass, physical.center_of_mass, physical.inertia, np.zeros(7), np.zeros(7))
    source, target = tmp_path / "bare.urdf", tmp_path / "found.urdf"
    export_model(model_of(tmp_path, "iiwa14", bare), source, "urdf", parameter_set="physical")
    robot = load_robot("iiwa14")
    motion = fourier_motion(7, period_s=10.0, samples=2000, seed=5, speed=0.8)
    scale = np.array([1.0, -1.0, 1.0, 1.3, 1.0, 1.0, 1.0])
    torque = np.roll(scale * inverse_dynamics(robot, physical, *motion), 4, axis=0)
    recording = recording_of(motion[0], torque, period_s=10.0)
    differences = [
        turned_signs(scale, 0.9, 100.0, "bare.urdf"),
        Difference("torque_sensor_gain", 4, None, (number("gain", 1.3),), 0.9, 100.0, "model", "A scale."),
        Difference("torque_delay", None, None, (number("delay", 0.02),), 0.9, 100.0, "model", "Late."),
    ]
    written = write_back([recording], robot, source, differences, target)
    assert written.rms(written.after).max() < 0.05
    assert written.sentence.endswith("with what is wrong in the measured one put right.")
    root = ElementTree.parse(target).getroot()
    for joint in (1, 3):
        found = root.find(f"joint[@name='A{joint + 1}']/dynamics")
        assert float(found.get("friction")) == pytest.approx(physical.coulomb[joint], rel=0.05)
        assert float(found.get("damping")) == pytest.approx(physical.viscous[joint], rel=0.05)
    assert not [said for said in written.amended.left if "constant torque" in said]


def test_an_offset_is_no_friction(physical: PhysicalParameters) -> None:
    """What it took away counted for friction, which was then written with whatever misfit made of it."""
    robot, random = load_robot("iiwa14"), np.random.default_rng(7)
    motion = fourier_motion(7, period_s=10.0, samples=2000, seed=5, speed=0.8)
    position, torque = (np.tile(each, (4, 1)) for each in (motion[0], inverse_dynamics(robot, physical, *motion)))
    geometry = Geometry(robot, rows_of([recording_of(position, torque, period_s=10.0, periods=4)]))
    lacks = np.full(geometry.rows.velocity.shape, 1.0) + 0.08 * geometry.rows.velocity
    lacks += random.normal(scale=0.2, size=lacks.shape)
    assert lacking_friction(geometry, lacks, physical.viscous, physical.coulomb, "arm.urdf") == []
    lacks += 0.5 * geometry.rows.direction
    found = lacking_friction(geometry, lacks, physical.viscous, physical.coulomb, "arm.urdf")
    assert [item.joint for item in found] == [1, 2, 3, 4, 5, 6, 7]
    assert [item.numbers[1].value for item in found] == pytest.approx([0.5] * 7, abs=0.1)
    # A file that has friction has so much less than the arm: as the friction itself it was read as half of it.
    assert all("is another than arm.urdf says, by viscous +0." in item.sentence for item in found)
    assert all(", coulomb +0." in item.sentence for item in found)


@pytest.mark.parametrize(("offset", "said"), [(5e-4, False), (0.3, True)])
def test_a_constant_torque_is_advised_only_where_it_matters_beside_friction(offset: float, said: bool) -> None:
    """Of exact rows 0.5 mNm were known to a hundredth, and to be applied beside 0.8 Nm of friction."""
    numbers = numbers_of(("viscous", "coulomb", "offset"), (0.5, 0.8, offset), (0.01, 0.01, 1e-5), ("", "", ""))
    found = Difference("friction_change", 2, None, numbers, 1.0, 50.0, "model", "Friction is another.")
    left = _wanted([found], load_robot("iiwa14"), has_armature=True).left
    assert bool(left) == said


CUBE = (
    "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + "f 1 2 4\nf 1 2 5\nf 3 4 7\nf 5 6 8\n"
)
MESHES = {
    "xml": "<mujoco><asset><mesh name='cube' file='parts/cube.obj'/></asset><worldbody><body><joint name='q'/>"
    "<inertial mass='1' pos='0 0 0' diaginertia='1 1 1'/><geom type='mesh' mesh='cube'/></body></worldbody></mujoco>",
    "urdf": "<robot name='r'><link name='a'><visual><geometry><mesh filename='parts/cube.obj'/></geometry></visual>"
    "</link></robot>",
    "sdf": "<sdf><model name='m'><link name='a'><visual><geometry><mesh><uri>parts/cube.obj</uri></mesh></geometry>"
    "</visual></link></model></sdf>",
}


@pytest.mark.parametrize("form", MESHES)
def test_meshes_are_found_from_another_folder(form: str, tmp_path: Path) -> None:
    """Truth: a relative name of a mesh counts from the folder of the file that it stands in, in all three formats."""
    (tmp_path / "given" / "parts").mkdir(parents=True)
    (tmp_path / "written").mkdir()
    (tmp_path / "given" / "parts" / "cube.obj").write_text(CUBE)
    source, target = tmp_path / "given" / f"arm.{form}", tmp_path / "written" / f"arm.{form}"
    source.write_text(MESHES[form])
    write = {"xml": write_mjcf_changes, "urdf": write_urdf_changes, "sdf": write_sdf_changes}[form]
    write(source, target, Changes({}, {}, {}, {}, None))
    if form == "xml":
        assert mujoco.MjModel.from_xml_path(str(target)).nmesh == 1
    else:
        assert "../given/parts/cube.obj" in target.read_text()


@pytest.mark.parametrize("place", ["given", "written"])
def test_an_mjcf_says_where_its_meshes_are_only_where_that_is_another_folder(place: str, tmp_path: Path) -> None:
    """Only what was found changes: beside its source a file got `meshdir="."`, without meshes a folder of meshes."""
    for name in ("given", "written"):
        (tmp_path / name).mkdir()
    source, target = tmp_path / "given" / "arm.xml", tmp_path / place / "fixed.xml"
    source.write_text(re.sub("<asset>.*</asset>|<geom type='mesh'[^>]*>", "", MESHES["xml"]))
    write_mjcf_changes(source, target, Changes({}, {}, {}, {}, None))
    assert "meshdir" not in target.read_text()
    assert "texturedir" not in target.read_text()
