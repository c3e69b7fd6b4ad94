"""Claims about the configuration file: every mistake is refused with exit code 78, its file and its field."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daemon.api import RunRequest
from daemon.config import DaemonConfig, load_config, read_settings
from daemon.errors import ConfigurationError, DaemonError, MissingInputError
from daemon.motion.workspace_file import WorkspaceFile


def test_an_empty_file_means_the_defaults(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text("\n")
    assert load_config(file) == DaemonConfig()
    assert load_config(file).fri.bind_host == "127.0.0.1"


def test_what_is_written_reaches_the_run_request(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(
        "robot: iiwa7\nfri: {version: '2.7', bind_host: 192.170.10.1, robot_host: 192.170.10.2}\n"
        "run: {periods: 3, tool: gripper, external_torque_limit: [60, 60, 60, 30, 12, 12, 6]}\n"
        "realtime: {priority: 70, cpu: 1}\n"
    )
    request = RunRequest(
        run_id="r", table_file="t", trajectory_file="j", out_dir="o", **load_config(file).request_fields()
    )
    assert (request.robot, request.fri_version, request.bind_host) == ("iiwa7", "2.7", "192.170.10.1")
    assert (request.periods, request.tool, request.realtime_priority, request.loop_cpu) == (3, "gripper", 70, 1)
    assert request.external_torque_limit == (60, 60, 60, 30, 12, 12, 6)


def test_the_example_is_complete_and_its_values_are_the_defaults_but_for_the_lab(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[2] / "packaging" / "config.example.yaml").read_text()
    config = load_config(_written(tmp_path / "c.yaml", text))
    shown, defaults = msgspec.to_builtins(config), msgspec.to_builtins(DaemonConfig())
    written = msgspec.yaml.decode(text)
    lab = {("fri", "bind_host"), ("fri", "robot_host")}
    assert text.count("# lab:") == len(lab)
    for section, default in defaults.items():
        if not isinstance(default, dict):
            assert written[section] == default
            continue
        assert set(written[section]) == set(default), section
        for key, value in default.items():
            assert (shown[section][key] != value) == ((section, key) in lab), f"{section}.{key}"


def _written(file: Path, text: str) -> Path:
    file.write_text(text)
    return file


def test_the_version_may_be_left_to_the_robot(tmp_path: Path) -> None:
    config = load_config(_written(tmp_path / "c.yaml", "fri: {version: Auto}\n"))
    assert config.request_fields()["fri_version"] == "auto"


@pytest.mark.parametrize(
    ("text", "kind", "said"),
    [
        ("frj: {version: '1.15'}\n", DaemonConfig, "there is no field `frj`; there are robot, fri, run, "),
        ("fri: {bind: 30200}\n", DaemonConfig, "there is no field `bind`; there are version, bind_host, bind_port, "),
        ("arms: {left: {port: 1}}\n", DaemonConfig, "there are robot, bind_host, bind_port, "),
        ("walls: [{nam: a}]\n", WorkspaceFile, "there are name, normal, offset_m."),
        ("tool: {mass: 1}\n", WorkspaceFile, "mass_kg, "),
    ],
)
def test_beside_an_unknown_key_stand_the_known_ones(tmp_path: Path, text: str, kind: type, said: str) -> None:
    """What `bind` may be called was to be looked up."""
    with pytest.raises(ConfigurationError) as refusal:
        read_settings(_written(tmp_path / "c.yaml", text), kind, "it")
    assert said in str(refusal.value)


def test_of_a_relayed_cabinet_nothing_untrue_is_said(tmp_path: Path) -> None:
    """127.0.0.1 was said to be reached from other machines."""
    with pytest.raises(ConfigurationError, match=r"robot_host: through 127\.0\.0\.1 a real arm is moved"):
        load_config(_written(tmp_path / "c.yaml", "fri: {real_robot: true}\n"))


@pytest.mark.parametrize("field", ["robot_host", "bind_host"])
def test_a_request_takes_no_host_that_is_a_name(field: str) -> None:
    with pytest.raises(ConfigurationError, match="notahost") as refusal:
        RunRequest(run_id="r", robot="iiwa14", table_file="t", trajectory_file="j", out_dir="o", **{field: "notahost"})
    assert refusal.value.field == field


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("robott: iiwa14", "robott"),
        ("robot: iiwa15", "robot"),
        ("arms: {left: {robot: iiwa15}}", "robot"),
        ("run: {tool: 2.5@0,0,0.06}", "run"),
        ("arms: {left: {tool: 2.5@0,0,0.06}}", "arms.left"),
        ("arms: {left: {serial: a}, right: {serial: b, colour: red}}", "arms.right"),
        ("arms: {left: {}, right: {bind_port: many}}", "arms.right.bind_port"),
        ("fri: {bind_prt: 1}", "fri"),
        ("fri: {bind_port: many}", "fri.bind_port"),
        ("fri: {bind_port: 70000}", "fri.bind_port"),
        ("fri: {version: '3.0'}", "fri.version"),
        ("fri: {bind_host: robot}", "fri.bind_host"),
        ("fri: {start_timeout_s: -1}", "fri.start_timeout_s"),
        ("fri: {bind_host: 0.0.0.0}", "fri.robot_host"),
        ("control: {server_key: a.key_secret}", "control.server_key"),
        ("control: {endpoint: 'tcp://0.0.0.0:5555'}", "control.endpoint"),
        ("control: {endpoint: 'tcp://10.0.0.1:5555'}", "control.endpoint"),
        ("control: {endpoint: 'udp://127.0.0.1:5555'}", "control.endpoint"),
        ("run: {periods: 0}", "run.periods"),
        ("run: {amplitude: 2}", "run.amplitude"),
        ("run: {amplitude: 1.0e-300}", "run.amplitude"),
        ("run: {external_torque_limit: [1, 2]}", "run.external_torque_limit"),
        ("run: {external_torque_limit: [60000, 60000, 60000, 30000, 12000, 12000, 6000]}", "run.external_torque_limit"),
        ("run: {maximum_distance_to_measured: 5.7}", "run.maximum_distance_to_measured"),
        ("run: {lead_in_s: .nan}", "run.lead_in_s"),
        ("run: {lead_in_s: 1000}", "run.lead_in_s"),
        ("fri: {receive_timeout_s: 500}", "fri.receive_timeout_s"),
        ("run: {periods: 1}\nrobot: iiwa14\nrun: {external_torque_limit: null}", "run"),
        ("arms: {left: {serial: a, bind_port: 1, serial: b}}", "serial"),
        ("run: {fit_pipeline: best}", "run.fit_pipeline"),
        ("realtime: {priority: 99}", "realtime.priority"),
        ("realtime: {ring_slots: 1000}", "realtime.ring_slots"),
        ("realtime: {ring_slots: 100000000000000}", "realtime.ring_slots"),
        ("realtime: {cpu: -1}", "realtime.cpu"),
        ('output: "runs\\0"', "output"),
        ('run: {workspace_file: "cell\\0.yaml"}', "run.workspace_file"),
    ],
)
def test_a_mistake_is_named_by_file_and_field(tmp_path: Path, text: str, field: str) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as caught:
        load_config(file)
    assert caught.value.exit_code == 78
    assert caught.value.field == field
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("text", ["fri: {version: 1.15}", "run: {serial: 222}", "run: {tool: 2.5@0,0,0.06}"])
def test_what_lacks_quotes_is_asked_for_with_quotes(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigurationError, match="needs quotes"):
        load_config(_written(tmp_path / "lab.yaml", text))


@pytest.mark.parametrize("text", ["a: [", "\t- x", "- 1", "just words"])
def test_what_is_no_configuration_is_refused_with_its_file(tmp_path: Path, text: str) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as caught:
        load_config(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_absent_file_is_missing_input(tmp_path: Path) -> None:
    with pytest.raises(MissingInputError):
        load_config(tmp_path / "no.yaml")


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=120))
def test_no_bytes_give_another_exception(tmp_path: Path, data: bytes) -> None:
    file = tmp_path / "c.yaml"
    file.write_bytes(data)
    try:
        load_config(file)
    except DaemonError:
        return


def test_external_torque_is_watched_unless_it_is_switched_off(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    for text, expected in (("{}", (60.0, 60.0, 60.0, 30.0, 12.0, 12.0, 6.0)), ("{external_torque_limit: null}", None)):
        file.write_text(f"run: {text}\n")
        assert load_config(file).request_fields()["external_torque_limit"] == expected


@pytest.mark.parametrize(
    "place", ["run.workspace_file", "run.urdf_file", "run.tool", "fri.robot_host", "control.server_key", "output"]
)
def test_a_setting_that_is_empty_is_named(tmp_path: Path, place: str) -> None:
    """An empty path is the working folder: ".: cannot be read" was said of it."""
    section, _, name = place.rpartition(".")
    file = tmp_path / "config.yaml"
    file.write_text(f'{section}: {{{name}: ""}}\n' if section else f'{name}: ""\n')
    with pytest.raises(ConfigurationError, match="is empty") as caught:
        load_config(file)
    assert caught.value.field == place


TWO_ARMS = """
fri: {version: auto, bind_host: 192.170.10.1}
run: {periods: 4, tool: "2.5@0,0,0.06"}
arms:
  left: {serial: "111", bind_port: 30200, robot_host: 192.170.10.2}
  right: {serial: "222", bind_port: 30201, robot_host: 192.170.10.3, robot: iiwa7, tool: none, version: "1.15"}
"""


def test_one_of_several_arms_is_chosen_by_its_name(tmp_path: Path) -> None:
    file = _written(tmp_path / "lab.yaml", TWO_ARMS)
    left, right = (load_config(file, name).request_fields() for name in ("left", "right"))
    assert [left[key] for key in ("robot", "bind_port", "robot_host", "serial", "tool", "fri_version", "periods")] == [
        "iiwa14", 30200, "192.170.10.2", "111", "2.5@0,0,0.06", "auto", 4,
    ]  # fmt: skip
    assert [right[key] for key in ("robot", "bind_port", "robot_host", "serial", "tool", "fri_version", "periods")] == [
        "iiwa7", 30201, "192.170.10.3", "222", "none", "1.15", 4,
    ]  # fmt: skip


@pytest.mark.parametrize(("arm", "said"), [(None, "no arm is named"), ("middle", "there is no arm 'middle'")])
def test_an_arm_that_is_not_there_or_not_named_is_said_with_those_that_are(
    tmp_path: Path, arm: str | None, said: str
) -> None:
    with pytest.raises(ConfigurationError, match=said) as caught:
        load_config(_written(tmp_path / "lab.yaml", TWO_ARMS), arm)
    assert "left, right" in str(caught.value)
    assert caught.value.exit_code == 78
    with pytest.raises(ConfigurationError, match="there is no arm 'left'"):
        load_config(_written(tmp_path / "one.yaml", "run: {periods: 4}"), "left")


def test_a_mistake_in_another_arm_is_found_too(tmp_path: Path) -> None:
    text = TWO_ARMS.replace("bind_port: 30201", "bind_port: 70000")
    with pytest.raises(ConfigurationError, match="arm right") as caught:
        load_config(_written(tmp_path / "lab.yaml", text), "left")
    assert caught.value.field == "fri.bind_port"


@pytest.mark.parametrize("serials", [('serial: "111", ', 'serial: "111", '), ("", "")])
def test_two_arms_with_one_serial_number_would_share_a_ladder_and_are_refused(
    tmp_path: Path, serials: tuple[str, str]
) -> None:
    """What the left arm completed in T1 let the right one begin with 0.25 in AUT."""
    left, right = serials
    text = (
        'run: {serial: "111"}\narms:\n'
        f"  left: {{{left}bind_port: 30200, robot_host: 127.0.0.1}}\n"
        f"  right: {{{right}bind_port: 30201, robot_host: 127.0.0.1}}\n"
    )
    with pytest.raises(ConfigurationError, match=r"arm left and arm right .* one serial number, '111'") as caught:
        load_config(_written(tmp_path / "lab.yaml", text), "left")
    assert caught.value.field == "arms.right.serial"


def test_one_arm_may_have_two_names(tmp_path: Path) -> None:
    """Such as with and without a gripper: its address is the same."""
    text = 'run: {serial: "111"}\narms: {bare: {}, gripping: {tool: "2.5@0,0,0.06"}}\n'
    assert load_config(_written(tmp_path / "lab.yaml", text), "gripping").run.serial == "111"
