"""Claims about exported simulator models: other programs find the identified arm in them, or the export refuses.

Truth: what MuJoCo, Drake and Pinocchio read from the files, against Pinocchio's inverse dynamics of the numbers
themselves (never through a file); the usual iiwa 14 kinematics as published (data/README.md).
"""

from __future__ import annotations

import csv
import re
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daemon.cli.simulation import motor_prior
from identification.base_parameters import BaseRegressor
from identification.errors import ExportCheckError, InconsistentParametersError, ModelFileError
from identification.estimators.observation import ReducedProblem
from identification.estimators.semidefinite import solve_semidefinite
from identification.export.check import check_export
from identification.export.parameters import parameters_of, principal_slack, refuse_inconsistent
from identification.export.write import export_model
from identification.fitting.settings import FitSettings
from identification.model_file import read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import fit_recordings
from identification.recordings import read_recording
from identification.robots import Installation, load_robot
from identification.robots.simulator_models import read_simulator_model
from tests.identification.exported import consistent, model_of, random_arm, random_bodies
from tests.identification.synthetic import inverse_dynamics
from tests.reference import recording_file

pytest.importorskip("pydrake")

SUFFIX = {"urdf": ".urdf", "sdf": ".sdf", "mjcf": ".xml"}
ROTOR = np.array([0.3, 0.2, 0.5, 0.1, 0.4, 0.05, 0.02])
POSITIONS = np.random.default_rng(3).uniform(-2.0, 2.0, (10, 7))


def drake_plant(path: Path):
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(path)
    if path.suffix == ".urdf":
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.Finalize()
    return plant


def usual_flange(position: np.ndarray) -> np.ndarray:
    """Flange pose of the usual iiwa 14 from its published joint placements; all joints turn about +z."""
    rows = list(csv.reader((Path(__file__).parent / "data" / "iiwa14_usual_kinematics.csv").open()))[1:]
    pose = np.eye(4)
    for row, angle in zip(rows, [*position, 0.0], strict=True):
        x, y, z, roll, pitch, yaw = map(float, row[1:])
        step, turn = np.eye(4), np.eye(4)
        step[:3, :3], step[:3, 3] = pinocchio.rpy.rpyToMatrix(roll, pitch, yaw), (x, y, z)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        pose = pose @ step @ turn
    return pose


@pytest.mark.parametrize("form", ["urdf", "sdf", "mjcf"])
def test_every_program_reads_the_identified_arm_within_1e_9(
    form: str, tmp_path: Path, table3: PhysicalParameters
) -> None:
    physical = consistent(table3)
    model = model_of(tmp_path, "iiwa14", physical, rotor=ROTOR)
    result = export_model(model, tmp_path / f"arm{SUFFIX[form]}", form, parameter_set="physical")
    assert {item.program.split()[0] for item in result.agreements} == {
        "urdf": {"Pinocchio", "Drake"}, "sdf": {"Pinocchio", "Drake"}, "mjcf": {"Pinocchio", "MuJoCo"},
    }[form]  # fmt: skip
    assert max(item.difference_nm for item in result.agreements) < 1e-9


def test_mujoco_finds_all_of_equation_one_and_the_rotors_in_mjcf(tmp_path: Path, table3: PhysicalParameters) -> None:
    physical = consistent(table3)
    export_model(
        model_of(tmp_path, "iiwa14", physical, rotor=ROTOR), tmp_path / "arm.xml", "mjcf", parameter_set="physical"
    )
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(model)
    generator = np.random.default_rng(8)
    for position in POSITIONS:
        velocity = generator.choice([-1.0, 1.0], 7) * generator.uniform(0.2, 1.0, 7)
        data.qpos[:], data.qvel[:], data.qacc[:] = position, velocity, generator.normal(size=7)
        mujoco.mj_inverse(model, data)
        expected = inverse_dynamics(
            load_robot("iiwa14"), physical, *(np.array([x]) for x in (position, velocity, data.qacc))
        )
        assert np.abs(data.qfrc_inverse - expected[0] - ROTOR * data.qacc).max() < 1e-9


@pytest.mark.parametrize("form", ["urdf", "sdf", "mjcf"])
def test_the_flange_is_where_the_usual_iiwa_14_has_it(form: str, tmp_path: Path, table3: PhysicalParameters) -> None:
    path = tmp_path / f"arm{SUFFIX[form]}"
    export_model(model_of(tmp_path, "iiwa14", consistent(table3)), path, form, parameter_set="physical")
    for position in POSITIONS:
        pose = np.eye(4)
        if form == "mjcf":
            model = mujoco.MjModel.from_xml_path(str(path))
            data = mujoco.MjData(model)
            data.qpos[:] = position
            mujoco.mj_kinematics(model, data)
            pose[:3, :3], pose[:3, 3] = data.site("flange").xmat.reshape(3, 3), data.site("flange").xpos
        else:
            plant = drake_plant(path)
            context = plant.CreateDefaultContext()
            plant.SetPositions(context, position)
            pose = plant.GetFrameByName("flange").CalcPoseInWorld(context).GetAsMatrix4()
        assert np.abs(pose - usual_flange(position)).max() < 1e-9


def test_friction_rotors_and_limits_stand_where_each_program_reads_them(
    tmp_path: Path, table3: PhysicalParameters
) -> None:
    physical, robot = consistent(table3), load_robot("iiwa14")
    model = model_of(tmp_path, "iiwa14", physical, rotor=ROTOR)
    for form, suffix in SUFFIX.items():
        export_model(model, tmp_path / f"arm{suffix}", form, parameter_set="physical")
    by_mujoco = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    from_urdf = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.urdf"))
    assert np.allclose(by_mujoco.dof_armature, ROTOR, atol=1e-15)
    for read in (by_mujoco, from_urdf):
        assert np.allclose(read.dof_damping, physical.viscous, atol=1e-15)
        assert np.allclose(read.dof_frictionloss, physical.coulomb, atol=1e-15)
        assert np.allclose(read.jnt_range, np.column_stack([robot.position_lower, robot.position_upper]), atol=1e-12)
    by_pinocchio = pinocchio.buildModelFromXML((tmp_path / "arm.urdf").read_text())
    assert np.allclose(by_pinocchio.damping, physical.viscous, atol=1e-15)
    assert np.allclose(by_pinocchio.upperDryFrictionLimit, physical.coulomb, atol=1e-15)
    assert np.allclose(by_pinocchio.upperEffortLimit, robot.effort, atol=1e-12)
    for suffix in (".urdf", ".sdf"):
        plant = drake_plant(tmp_path / f"arm{suffix}")
        context = plant.CreateDefaultContext()
        joints = [plant.GetJointByName(name) for name in robot.joint_names]
        assert np.allclose([joint.default_damping() for joint in joints], physical.viscous, atol=1e-15)
        assert np.allclose([joint.velocity_upper_limit() for joint in joints], robot.velocity, atol=1e-12)
        actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
        seen = {item.joint().name(): item.rotor_inertia(context) * item.gear_ratio(context) ** 2 for item in actuators}
        assert np.allclose([seen[name] for name in robot.joint_names], ROTOR, atol=1e-15)


def test_table_three_is_refused_by_link_and_slack_and_left_as_it_is(tmp_path: Path, table3: PhysicalParameters) -> None:
    """MuJoCo refuses the same link; its balanceinertia, which would change the torques silently, is not used."""
    target = tmp_path / "arm.xml"
    with pytest.raises(InconsistentParametersError) as caught:
        export_model(model_of(tmp_path, "iiwa14", table3), target, "mjcf", parameter_set="physical")
    assert caught.value.link == 4
    assert caught.value.slack == pytest.approx(-2.9e-4, abs=0.05e-4)
    assert "link 4" in str(caught.value)
    assert "link 7" in str(caught.value)
    assert "consistent set" in str(caught.value)
    assert not target.exists()
    entries = " ".join(str(table3.inertia[3][i]) for i in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    body = f'<body><joint/><inertial pos="0 0 0" mass="1" fullinertia="{entries}"/></body>'
    with pytest.raises(ValueError, match="inertia must satisfy"):
        mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")


def test_the_fits_consistent_set_of_an_infeasible_table_is_one_that_simulators_take(
    iiwa14_base: BaseRegressor, table2: dict[str, float]
) -> None:
    """Table 2 is the base parameters of no robot (ZZR_1 < 0): the nearest consistent set lies on the cone's edge."""
    values = np.array([table2[name] for name in iiwa14_base.names])
    problem = ReducedProblem(np.eye(len(values)) / 1e-3, values / 1e-3, 1.0, 7000)
    physical = solve_semidefinite(problem, iiwa14_base).physical
    assert principal_slack(physical).min() > 0.0
    refuse_inconsistent(physical)


@pytest.mark.parametrize("form", ["urdf", "sdf", "mjcf"])
def test_a_model_whose_physical_set_no_body_has_is_exported_all_the_same(
    form: str, tmp_path: Path, table3: PhysicalParameters
) -> None:
    """The default set is one of real bodies; MuJoCo takes it as it is, and the head says what rests on the prior."""
    model = model_of(tmp_path, "iiwa14", table3)
    result = export_model(model, tmp_path / f"arm{SUFFIX[form]}", form)
    assert len(result.agreements) == 2
    assert result.origins is not None
    assert result.origins.to_json()["from_data"]["M_1"] < 1e-3
    text = (tmp_path / f"arm{SUFFIX[form]}").read_text()
    assert re.search("Link 1: data: [ZFVS, ]*FV, FS; .*prior: M, MX", text)
    assert "uniform bodies" in text


def test_what_no_motion_shows_alone_is_never_said_to_be_the_datas(tmp_path: Path) -> None:
    """Ten seconds of the KR300 end at a fifth link of 89 kg, far from its prior body: the data narrow that by more than
    90 % of its variance, but torques tell sums of masses only.
    """
    robot = load_robot(recording_file("kr300.urdf"))
    fit = fit_recordings([read_recording(recording_file("kr300_a.npz"))], robot, FitSettings(physical=False))
    origins = parameters_of(read_model(write_model(fit.to_model_json(notes=False), tmp_path / "model.json"))).origins
    assert origins is not None
    share = dict(zip(origins.names, origins.settled.from_data, strict=True))
    assert share["M_5"] > 0.9
    fifth, last = (line.split("data: ")[-1].split(";")[0].split(", ") for line in origins.sentences()[-2:])
    assert "M" not in fifth
    assert {"MX", "MY", "XY", "FV"} <= set(last)
    assert set(origins.to_json()["told_alone"]) >= {"MX_6", "MY_6", "XY_6", "FV_1"}


def test_a_given_prior_is_where_open_directions_go(tmp_path: Path, table3: PhysicalParameters) -> None:
    physical = consistent(table3)
    model = model_of(tmp_path, "iiwa14", physical)
    export_model(model, tmp_path / "given.urdf", "urdf", parameter_set="physical")
    export_model(model, tmp_path / "arm.urdf", "urdf", prior=tmp_path / "given.urdf")
    trees = [ElementTree.parse(tmp_path / name).getroot() for name in ("given.urdf", "arm.urdf")]
    masses = [[float(mass.get("value")) for mass in tree.findall("link/inertial/mass")] for tree in trees]
    assert masses[1] == pytest.approx(masses[0], rel=1e-3)
    with pytest.raises(ModelFileError, match="prior"):
        export_model(model, tmp_path / "arm.urdf", "urdf", parameter_set="physical", prior=tmp_path / "given.urdf")


def test_a_urdf_that_hangs_on_the_world_is_welded_once(tmp_path: Path) -> None:
    """As the URDFs of universal robots, xArm and Med 7 do; the first link of the file need not be its root."""
    source = tmp_path / "source.urdf"
    arm = random_arm(3, 4).replace('<link name="base"/>', '<link name="base"/><link name="world"/>')
    weld = '<joint name="anchor" type="fixed"><parent link="world"/><child link="base"/></joint></robot>'
    source.write_text(arm.replace("</robot>", weld))
    model = model_of(tmp_path, str(source), random_bodies(3, 4))
    for form, suffix in SUFFIX.items():
        result = export_model(model, tmp_path / f"arm{suffix}", form)
        assert len(result.agreements) == 2, result.notes


def test_what_drake_does_not_take_is_a_note(tmp_path: Path) -> None:
    """Two motors of one name, as a public xArm 6 has them: Pinocchio and MuJoCo read it, Drake does not."""
    source = tmp_path / "source.urdf"
    motors = "".join(
        f'<transmission name="t{joint}"><type>transmission_interface/SimpleTransmission</type>'
        f'<joint name="axis_{joint}"/><actuator name="motor"/></transmission>'
        for joint in (1, 2)
    )
    source.write_text(random_arm(2, 0).replace("</robot>", motors + "</robot>"))
    result = export_model(model_of(tmp_path, str(source), random_bodies(2, 0)), tmp_path / "arm.urdf", "urdf")
    assert [item.program.split()[0] for item in result.agreements] == ["Pinocchio"]
    assert [note for note in result.notes if note.startswith("Drake") and "motor" in note]


def test_a_drake_that_cannot_be_loaded_is_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As under LC_ALL=C without UTF-8, where the import of its module fails."""
    monkeypatch.setitem(sys.modules, "pydrake.multibody.parsing", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name)
    source = tmp_path / "source.urdf"
    source.write_text(random_arm(2, 0))
    result = export_model(model_of(tmp_path, str(source), random_bodies(2, 0)), tmp_path / "arm.urdf", "urdf")
    assert any("cannot be loaded" in note for note in result.notes)
    assert [item.program.split()[0] for item in result.agreements] == ["Pinocchio"]


def test_a_link_called_like_a_joint_is_renamed_for_sdf(tmp_path: Path) -> None:
    source = tmp_path / "source.urdf"
    source.write_text(random_arm(2, 6).replace('"part_2"', '"axis_1"'))
    model = model_of(tmp_path, str(source), random_bodies(2, 6))
    result = export_model(model, tmp_path / "arm.sdf", "sdf")
    assert len(result.agreements) == 2
    assert "link axis_1 is called axis_1_link" in " ".join(result.notes)


@pytest.mark.parametrize(("form", "place"), [("urdf", "link/inertial/mass"), ("sdf", "model/link/inertial/mass")])
def test_a_file_that_says_something_else_is_found_out(
    form: str, place: str, tmp_path: Path, table3: PhysicalParameters
) -> None:
    model = model_of(tmp_path, "iiwa14", consistent(table3))
    path = tmp_path / f"arm{SUFFIX[form]}"
    export_model(model, path, form, parameter_set="physical")
    tree = ElementTree.parse(path)
    # Link 1 turns about a vertical axis: its mass is felt by no joint. Link 3's is.
    mass = tree.getroot().findall(place)[2]
    if form == "urdf":
        mass.set("value", str(float(mass.get("value")) * (1.0 + 1e-6)))
    else:
        mass.text = str(float(mass.text) * (1.0 + 1e-6))
    tree.write(path)
    with pytest.raises(ExportCheckError):
        check_export(path, form, model.load_robot(), parameters_of(model, "physical"))


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(joints=st.integers(1, 6), seed=st.integers(0, 10**6))
def test_any_serial_arm_survives_in_every_format(joints: int, seed: int, tmp_path: Path) -> None:
    """Revolute, continuous and prismatic joints in general position; the tool's own inertia is not counted twice."""
    source = tmp_path / "arm_source.urdf"
    source.write_text(random_arm(joints, seed))
    model = model_of(tmp_path, str(source), random_bodies(joints, seed))
    for form, suffix in SUFFIX.items():
        result = export_model(model, tmp_path / f"arm{suffix}", form, parameter_set="physical")
        assert len(result.agreements) == 2


@pytest.mark.parametrize("name", ["panda", "kr300", "tx40"])
def test_arms_of_others_survive_in_every_format(name: str, tmp_path: Path) -> None:
    source = recording_file(f"{name}.urdf")
    joints = load_robot(source).n
    model = model_of(tmp_path, str(source), random_bodies(joints, 5), rotor=np.full(joints, 0.2))
    for form, suffix in SUFFIX.items():
        assert len(export_model(model, tmp_path / f"arm{suffix}", form, parameter_set="physical").agreements) == 2


def test_a_urdf_keeps_its_names_meshes_and_limits_and_gets_full_right_angles(tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    source = tmp_path / "source" / "crane.urdf"
    source.write_text(
        """<robot name="crane"><!-- painted yellow --><link name="floor"/><link name="mast"><visual><geometry>
        <mesh filename="meshes/mast.stl"/></geometry></visual><visual><geometry><mesh filename="package://c/m.dae"/>
        </geometry></visual></link><link name="trolley"><inertial><mass value="77"/><inertia ixx="1" ixy="0" ixz="0"
        iyy="1" iyz="0" izz="1"/></inertial></link><joint name="slew" type="continuous"><origin xyz="0 0 1"
        rpy="1.5708 0 0"/><parent link="floor"/><child link="mast"/><axis xyz="0 1 0"/></joint><joint name="run"
        type="prismatic"><origin xyz="0 2 0" rpy="0 1.5708 0"/><parent link="mast"/><child link="trolley"/>
        <axis xyz="1 0 0"/><limit lower="-0.5" upper="3" effort="900" velocity="1.5"/></joint></robot>"""
    )
    target = tmp_path / "out.urdf"
    physical = random_bodies(2, 1)
    export_model(model_of(tmp_path, str(source), physical), target, "urdf", parameter_set="physical")
    root = ElementTree.parse(target).getroot()
    assert "painted yellow" in target.read_text()
    assert [link.get("name") for link in root.findall("link")] == ["floor", "mast", "trolley"]
    assert [mesh.get("filename") for mesh in root.iter("mesh")] == ["source/meshes/mast.stl", "package://c/m.dae"]
    assert root.find("joint[@name='run']/limit").attrib == {
        "lower": "-0.5", "upper": "3", "effort": "900", "velocity": "1.5",
    }  # fmt: skip
    assert len(root.find("link[@name='trolley']").findall("inertial")) == 1
    angles = [float(value) for value in root.find("joint[@name='slew']/origin").get("rpy").split()]
    assert angles[0] == pytest.approx(np.pi / 2, abs=1e-15)


def test_a_rotor_inertia_that_a_diagnosis_found_is_in_the_file(tmp_path: Path, table3: PhysicalParameters) -> None:
    """It was said to be there, and stood neither there nor in the file beside."""
    found = {"effect": "rotor_inertia", "joint": 3, "link": None,
             "model": {"other_joint": None, "coefficients": [1.7], "shape": {}}}  # fmt: skip
    model = model_of(tmp_path, "iiwa14", consistent(table3), effects=[found])
    path = tmp_path / "arm.xml"
    result = export_model(model, path, "mjcf", parameter_set="physical")
    assert mujoco.MjModel.from_xml_path(str(path)).dof_armature.tolist() == [0.0, 0.0, 1.7, 0.0, 0.0, 0.0, 0.0]
    assert "Rotor inertia stands in armature." in result.notes
    assert result.effects_path is None
    added = motor_prior(model, "physical")
    assert added[[1, 2]] == pytest.approx([4.4, 0.0])  # none is added to what is known
    for prior, is_said in ((added, True), (np.zeros(7), False)):
        notes = export_model(model, path, "mjcf", parameter_set="physical", motor_inertia=prior).notes
        assert any("data-sheet prior" in note for note in notes) == is_said
    del found["model"]
    with pytest.raises(ModelFileError, match="rotor_inertia is not complete"):
        export_model(model_of(tmp_path, "iiwa14", consistent(table3), effects=[found]), path, "mjcf")


@pytest.mark.parametrize("form", ["urdf", "sdf", "mjcf"])
def test_an_arm_on_a_wall_weighs_the_same_in_a_simulator(form: str, tmp_path: Path, table3: PhysicalParameters) -> None:
    """On a wall the paper's +x points down, which is −x of `base_link` in every file (cabinet: A 0°, B −90°, C 0°)."""
    wall = Installation.parse(mount="wall")
    model = model_of(tmp_path, "iiwa14", consistent(table3), installation=wall)
    path = tmp_path / f"arm{SUFFIX[form]}"
    result = export_model(model, path, form, parameter_set="physical")
    assert len(result.agreements) == 2
    robot = load_robot("iiwa14", wall)
    still = np.zeros_like(POSITIONS)
    expected = inverse_dynamics(robot, consistent(table3), POSITIONS, still, still)
    if form == "mjcf":
        arm = mujoco.MjModel.from_xml_path(str(path))
        data = mujoco.MjData(arm)
        assert arm.opt.gravity.tolist() == [-9.81, 0.0, 0.0]
        for position, torque in zip(POSITIONS, expected, strict=True):
            data.qpos[:] = position
            mujoco.mj_forward(arm, data)
            assert np.abs(data.qfrc_bias - torque).max() < 1e-9
    else:
        assert any("-9.81 0 0" in note for note in result.notes)
    # The same file as other people's: `diagnose --model` and `compare --models` read it as it stands.
    base = BaseRegressor(robot)
    assert np.allclose(read_simulator_model(path, base), base.base_from_physical(consistent(table3)), atol=1e-6)
