"""Claims about simulators' files of others that are written as their formats allow, but seldom are.

Truth: the parallel axis theorem for a point at a link's origin, in the axes of SciPy's rotations.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from identification.audit.difference import Difference, Number
from identification.base_parameters import BaseRegressor
from identification.errors import ModelFileError
from identification.export.amend import amend
from identification.export.amended_files import Changes, write_mjcf_changes, write_sdf_changes
from identification.export.write_back import write_back
from identification.robots import load_robot
from identification.robots.installation import Installation
from identification.robots.simulator_models import read_simulator_model
from tests.identification.synthetic import fourier_motion, recording_of

POINT_KG, MASS_KG, CENTER_M, MOMENTS = 2.0, 2.0, 0.1, np.array([0.01, 0.03, 0.035])
TURN = Rotation.from_euler("xyz", (0.5, -0.3, 0.8))
ADDED = Changes({"q": np.diag([0.0, 0.0, 0.0, POINT_KG])}, {}, {}, {}, None)
POSES = {
    "": TURN.as_euler("xyz"),
    " degrees='true'": TURN.as_euler("xyz", degrees=True),
    " rotation_format='quat_xyzw'": TURN.as_quat(),
}
MJCF = """<mujoco><worldbody><body{body}><joint{joint}/><inertial mass="2" pos="0.1 0 0" quat="{turn}"
 diaginertia="0.01 0.03 0.035"/></body></worldbody></mujoco>"""


def with_the_point() -> np.ndarray:
    """(3, 3) kg m² about the common centre, half way to the body's."""
    own = TURN.as_matrix() @ np.diag(MOMENTS) @ TURN.as_matrix().T
    reduced = POINT_KG * MASS_KG / (POINT_KG + MASS_KG)
    return np.asarray(own + reduced * CENTER_M**2 * np.diag([0.0, 1.0, 1.0]))


def mjcf(body: str = "", joint: str = "") -> str:
    return MJCF.format(body=body, joint=joint, turn=" ".join(map(str, TURN.as_quat(scalar_first=True))))


@pytest.mark.parametrize("attribute", POSES)
def test_an_sdf_states_angles_in_degrees_or_as_a_quaternion_too(attribute: str, tmp_path: Path) -> None:
    """Degrees were read as radians, so the body that was written was turned; four numbers ended in a traceback."""
    source, target = tmp_path / "arm.sdf", tmp_path / "written.sdf"
    pose = f"<pose{attribute}>{CENTER_M} 0 0 {' '.join(map(str, POSES[attribute]))}</pose>"
    source.write_text(
        f"<sdf version='1.9'><model name='m'><link name='a'><inertial><mass>{MASS_KG}</mass>{pose}<inertia>"
        + "".join(f"<{symbol}>{value}</{symbol}>" for symbol, value in zip(("ixx", "iyy", "izz"), MOMENTS, strict=True))
        + "</inertia></inertial></link><joint name='q' type='revolute'><parent>world</parent><child>a</child></joint>"
        "</model></sdf>"
    )
    write_sdf_changes(source, target, ADDED)
    inertia = ElementTree.parse(target).getroot().find(".//inertia")
    assert inertia is not None
    found = [float(inertia.findtext(symbol, "0")) for symbol in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
    np.testing.assert_allclose(found, with_the_point()[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], atol=1e-12)


def test_a_body_of_an_mjcf_need_not_have_a_name(tmp_path: Path) -> None:
    """It ended in a KeyError."""
    source, target = tmp_path / "arm.xml", tmp_path / "written.xml"
    source.write_text(mjcf(joint=' name="q"'))
    write_mjcf_changes(source, target, ADDED)
    body = mujoco.MjModel.from_xml_path(str(target)).body(1)
    axes = Rotation.from_quat(body.iquat, scalar_first=True).as_matrix()
    np.testing.assert_allclose(axes @ np.diag(body.inertia) @ axes.T, with_the_point(), atol=1e-6)


def test_an_mjcf_whose_joints_have_no_names_is_refused_for_that(tmp_path: Path) -> None:
    """It was said to have one movable joint."""
    source, robot = tmp_path / "arm.xml", tmp_path / "arm.urdf"
    source.write_text(mjcf())
    robot.write_text(
        "<robot name='r'><link name='w'/><link name='a'/><joint name='q' type='continuous'><parent link='w'/>"
        "<child link='a'/><axis xyz='0 0 1'/></joint></robot>"
    )
    with pytest.raises(ModelFileError, match="joints without a name"):
        amend(source, [], load_robot(robot), tmp_path / "written.xml")


ONE_JOINT = """<robot name='one'><link name='w'/><link name='a'><inertial><origin xyz='{at} 0 0'/><mass value='2'/>
<inertia ixx='0.01' iyy='0.03' izz='0.035' ixy='0' ixz='0' iyz='0'/></inertial></link>
<joint name='q' type='{kind}'><parent link='w'/><child link='a'/><axis xyz='0 1 0'/>
<limit lower='-1' upper='1' velocity='1' effort='100'/></joint></robot>"""


@pytest.mark.parametrize(
    ("kind", "expected"), [("revolute", {"YY_1": 0.05, "MX_1": 0.2, "MZ_1": 0.0}), ("prismatic", {"M_1": 2.0})]
)
def test_a_simulators_file_of_one_joint_is_read(kind: str, expected: dict[str, float], tmp_path: Path) -> None:
    """Every diagnosis of a robot of one joint against a file ended in an IndexError.

    Truth: I + m l² about the axis and m l of a pendulum, the mass of a slide.
    """
    file = tmp_path / "one.urdf"
    file.write_text(ONE_JOINT.format(kind=kind, at=CENTER_M))
    regressor = BaseRegressor(load_robot(file))
    values = dict(zip(regressor.names, read_simulator_model(file, regressor), strict=True))
    assert {name: values[name] for name in expected} == pytest.approx(expected, abs=1e-9)


def test_a_constant_force_of_a_slide_is_said_in_newtons(tmp_path: Path) -> None:
    file = tmp_path / "one.urdf"
    file.write_text(ONE_JOINT.format(kind="prismatic", at=CENTER_M))
    numbers = tuple(Number(name, 3.0, 0.1, unit) for name, unit in (("viscous", "N s/m"), ("offset", "N")))
    friction = Difference("friction_change", 1, None, numbers, 0.9, 100.0, "model", "Friction.")
    written = amend(file, [friction], load_robot(file), tmp_path / "written.urdf")
    assert "Joint 1 has a constant force of 3 N, which" in written.left[0]


AXES, STEPS, HELD = ("0 0 1", "0 1 0", "1 0 0"), ("0 0 0.2", "0.1 0 0.3", "0.4 0 0.1"), 0.7
BODY = {"urdf": "ixx='0.01' iyy='0.03' izz='0.035' ixy='0' ixz='0' iyz='0'", "mjcf": "0.01 0.03 0.035"}


def arm_of_three(form: str, *, on_a_table: bool = False) -> str:
    """Three joints j0, j1, j2 with a body of 2 kg, 0.1 m from each, in one of three formats."""
    links, joints, nested = "", "", ""
    for joint, (axis, step) in enumerate(zip(AXES, STEPS, strict=True)):
        carrier = f"l{joint - 1}" if joint else "w"
        if form == "urdf":
            links += f"<link name='l{joint}'><inertial><origin xyz='{CENTER_M} 0 0'/><mass value='{MASS_KG}'/>"
            links += f"<inertia {BODY['urdf']}/></inertial></link>"
            joints += f"<joint name='j{joint}' type='continuous'><parent link='{carrier}'/><child link='l{joint}'/>"
            joints += f"<origin xyz='{step}'/><axis xyz='{axis}'/></joint>"
        elif form == "sdf":
            carrier = carrier if joint or on_a_table else "world"
            at = "" if carrier == "world" else f" relative_to='{carrier}'"
            links += f"<link name='l{joint}'><pose{at}>{step} 0 0 0</pose><inertial><pose>{CENTER_M} 0 0 0 0 0</pose>"
            links += f"<mass>{MASS_KG}</mass><inertia><ixx>0.01</ixx><iyy>0.03</iyy><izz>0.035</izz></inertia>"
            links += "</inertial></link>"
            joints += f"<joint name='j{joint}' type='revolute'><parent>{carrier}</parent>"
            joints += f"<child>l{joint}</child><axis><xyz>{axis}</xyz></axis></joint>"
        else:
            nested += f"<body pos='{step}'><joint name='j{joint}' axis='{axis}'/>"
            nested += f"<inertial pos='{CENTER_M} 0 0' mass='{MASS_KG}' diaginertia='{BODY['mjcf']}'/>"
    if form == "urdf":
        if on_a_table:
            joints += "<joint name='f' type='fixed'><parent link='world'/><child link='w'/>"
            joints += "<origin xyz='0.3 -0.2 0.8' rpy='0 0 0.5'/></joint>"
            links += "<link name='world'/>"
        return f"<robot name='three'><link name='w'/>{links}{joints}</robot>"
    if form == "sdf":
        pose = "<pose>0.3 -0.2 0.8 0 0 0.5</pose><link name='w'/>" if on_a_table else ""
        return f"<sdf version='1.9'><model name='three'>{pose}{links}{joints}</model></sdf>"
    table = "pos='0.3 -0.2 0.8' euler='0 0 0.5'" if on_a_table else ""
    return f"<mujoco><compiler angle='radian'/><worldbody><body {table}>{nested}{4 * '</body>'}</worldbody></mujoco>"


@pytest.mark.parametrize("on_a_table", [False, True])
@pytest.mark.parametrize(("form", "suffix"), [("urdf", "urdf"), ("mjcf", "xml"), ("sdf", "sdf")])
def test_a_held_joint_and_the_base_stand_in_the_file_as_they_do(
    form: str, suffix: str, on_a_table: bool, tmp_path: Path
) -> None:
    """A held joint stood at zero there: "zero positions, axes, lengths or gravity are others" was said of the robot's
    own file. A base beside the origin of the file's world ended in "internal error: the file's frames are others".

    Truth: Pinocchio's inverse dynamics of the whole arm with the joint at 0.7 rad, and 2 kg at the last link's origin.
    """
    description, file, target = tmp_path / "arm.urdf", tmp_path / f"given.{suffix}", tmp_path / f"written.{suffix}"
    description.write_text(arm_of_three("urdf"))
    file.write_text(arm_of_three(form, on_a_table=on_a_table))
    robot = load_robot(description, Installation(locked_joints=(("j1", HELD),)))
    numbers = [Number("mass", POINT_KG, 0.01, "kg"), *(Number(f"com_{axis}", 0.0, 0.01, "m") for axis in "xyz")]
    load = Difference("payload", None, robot.n, tuple(numbers), 0.9, 100.0, "model", "A load.")
    assert amend(file, [load], robot, target).written == ("A load.",)
    whole = pinocchio.buildModelFromUrdf(str(description))
    regressor, data = BaseRegressor(robot), whole.createData()
    random = np.random.default_rng(3)
    for path in (file, target):
        values = read_simulator_model(path, regressor)
        for _ in range(5):
            q, dq, ddq = random.uniform(-1.5, 1.5, (3, 2))
            state = pinocchio.integrate(whole, pinocchio.neutral(whole), np.array([q[0], HELD, q[1]]))
            expected = pinocchio.rnea(whole, data, state, *(np.array([each[0], 0.0, each[1]]) for each in (dq, ddq)))
            found = regressor.matrix(q[None], dq[None], ddq[None])[0] @ values
            np.testing.assert_allclose(found, expected[[0, 2]], atol=1e-4)
        whole.appendBodyToJoint(3, pinocchio.Inertia(POINT_KG, np.zeros(3), np.zeros((3, 3))), pinocchio.SE3.Identity())
        data = whole.createData()


LEANS = Rotation.from_euler("xy", (0.25, -0.15)).inv().apply((0.0, 0.0, -9.81))


def lean() -> Difference:
    numbers = [Number(f"gravity_{axis}", value, 0.01, "m/s^2") for axis, value in zip("xyz", LEANS, strict=True)]
    numbers.insert(0, Number("angle", float(np.arccos(-LEANS[2] / 9.81)), 0.001, "rad"))
    return Difference("base_tilt", None, None, tuple(numbers), 0.9, 100.0, "model", "Leans.")


def test_an_sdf_that_stands_turned_leans_as_it_was_found(tmp_path: Path) -> None:
    """The pose that the model had was not looked at, and stayed below the lean: another direction of gravity.

    Truth: gravity in the frame of a base is Rᵀ g, with R of the pose.
    """
    description, file, target = tmp_path / "arm.urdf", tmp_path / "given.sdf", tmp_path / "written.sdf"
    description.write_text(arm_of_three("urdf"))
    file.write_text(arm_of_three("sdf", on_a_table=True))
    amend(file, [lean()], load_robot(description), target)
    pose = np.array((ElementTree.parse(target).getroot().findtext("model/pose") or "").split(), dtype=np.float64)
    felt = Rotation.from_euler("xyz", pose[3:]).inv().apply((0.0, 0.0, -9.81))
    np.testing.assert_allclose(felt, LEANS, atol=1e-9)


def test_friction_of_a_vertical_joint_is_read_off_beside_the_weight_that_leans(tmp_path: Path) -> None:
    """Base parameters on a level base have no first moment about a vertical axis; what it weighs where the base leans
    was taken for friction and offset.

    Truth: Pinocchio's inverse dynamics under gravity that leans, and friction of 0.5 Nm and 0.3 Nm s/rad.
    """
    file, target = tmp_path / "arm.urdf", tmp_path / "written.urdf"
    file.write_text(arm_of_three("urdf"))
    whole = pinocchio.buildModelFromUrdf(str(file))
    whole.gravity.linear = LEANS
    data = whole.createData()
    states = fourier_motion(3, period_s=10.0, samples=2000, seed=2)
    torque = np.array([
        pinocchio.rnea(whole, data, pinocchio.integrate(whole, pinocchio.neutral(whole), q), dq, ddq)
        for q, dq, ddq in zip(*states, strict=True)
    ])  # fmt: skip
    torque += 0.3 * states[1] + 0.5 * np.tanh(states[1] / 0.01)
    torque += 0.01 * np.random.default_rng(1).standard_normal(torque.shape)
    recording = recording_of(states[0], torque, period_s=10.0, robot=str(file))
    written = write_back([recording], load_robot(file), file, [lean()], target)
    dynamics = ElementTree.parse(target).getroot().find("joint[@name='j0']/dynamics")
    assert dynamics is not None
    assert float(dynamics.get("friction", 0.0)) == pytest.approx(0.5, abs=0.05)
    assert written.rms(written.after).max() < 0.1


def test_what_is_left_of_the_weight_of_a_load_is_not_said_to_be_a_constant_torque(tmp_path: Path) -> None:
    """Beside a load of 1.71 ± 0.68 kg for 1.8 kg it was advised to apply -0.44 Nm that no joint had."""
    file = tmp_path / "arm.urdf"
    file.write_text(arm_of_three("urdf"))
    load = Difference("payload", None, 3, (Number("mass", 1.7, 0.3, "kg"),), 0.9, 100.0, "model", "A load.")
    friction = Difference("friction_change", 2, None, (Number("offset", -0.4, 0.01, "Nm"),), 0.9, 9.0, "model", "F.")
    alone, beside = (
        amend(file, found, load_robot(file), tmp_path / "written.urdf").left for found in ([friction], [load, friction])
    )
    assert "apply it as a joint torque" in alone[0]
    assert "or so much is left of the weight of the body" in beside[0]
