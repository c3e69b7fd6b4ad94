"""What a user meets at the command line: one clear sentence and the right exit code for everything that is wrong."""

from __future__ import annotations

import json
import signal
import socket
from pathlib import Path

import numpy as np
import pytest

from identification.excitation import default_trajectory
from tests.end_to_end.processes import iiwa_ident, start_iiwa_ident
from tests.ports import free_udp_port
from tests.short_motion import short_trajectory
from tests.watchdog import WATCHDOG_S


def one_sentence(text: str) -> bool:
    """True when stderr ends in one line of the program's own and shows no traceback."""
    lines = [line for line in text.strip().splitlines() if line]
    return bool(lines) and "Traceback" not in text and len(lines[-1]) > 20


def test_unknown_options_are_usage_errors() -> None:
    assert iiwa_ident("check", "--no-such-option").returncode == 2
    assert iiwa_ident("run", "--bind", "nowhere").returncode == 2
    assert iiwa_ident("run", "--fri-version", "9.9").returncode == 2


def test_fri_decode_and_encode_are_inverse_and_never_stop_at_a_bad_line() -> None:
    good = "0a080881800d10001801"
    decoded = iiwa_ident(
        "fri", "decode", "--fri-version", "1.15", "--direction", "command", stdin=f"{good}\nzz\n0a0808\n{good}\n"
    )
    answers = [json.loads(line) for line in decoded.stdout.splitlines()]
    assert [answer["ok"] for answer in answers] == [True, False, False, True]
    assert answers[0]["fields"]["header"] == {
        "messageIdentifier": 0x34001, "sequenceCounter": 0, "reflectedSequenceCounter": 1,
    }  # fmt: skip
    encoded = iiwa_ident(
        "fri", "encode", "--fri-version", "1.15", "--direction", "command", stdin=json.dumps(answers[0]) + "\n"
    )
    assert encoded.stdout.strip() == good


def write_table(file: Path, table: np.ndarray) -> Path:
    np.savez(file, q=table, rate_hz=1000.0, robot="iiwa14")
    return file


def test_a_table_with_nan_is_refused_with_row_and_joint(tmp_path: Path) -> None:
    table = default_trajectory().table()
    table[123, 4] = np.nan
    result = iiwa_ident("check", write_table(tmp_path / "nan.npz", table))
    assert result.returncode in (1, 65)
    text = result.stdout + result.stderr
    assert "joint 5" in text.lower()
    assert "12" in text
    assert "Traceback" not in text


def test_a_joint_past_its_limit_is_named_and_nothing_runs(tmp_path: Path) -> None:
    table = default_trajectory().table()
    table[:, 3] += 1.6
    file = write_table(tmp_path / "far.npz", table)
    assert iiwa_ident("check", file).returncode == 1
    result = iiwa_ident("run", file, "--bind", f"127.0.0.1:{free_udp_port()}", "--out", tmp_path / "run", "--no-fit")
    assert result.returncode == 1
    assert "Joint 4" in result.stdout
    assert not (tmp_path / "run").exists()


def test_a_port_in_use_is_said_with_its_number(tmp_path: Path) -> None:
    motion = short_trajectory(tmp_path / "short.json")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        port = holder.getsockname()[1]
        result = iiwa_ident("run", motion, "--bind", f"127.0.0.1:{port}", "--out", tmp_path / "run", "--no-fit")
        assert result.returncode == 69
        assert str(port) in result.stderr + result.stdout
        assert not (tmp_path / "run").exists()
        (tmp_path / "mine").mkdir()
        (tmp_path / "mine" / "notes.txt").write_text("kept")
        for folder in ("mine", "new/folder"):
            words = ("--monitor-only",) if folder == "mine" else (motion, "--amplitude", "0.1", "--fri-version", "auto")
            assert iiwa_ident("run", *words, "--bind", f"127.0.0.1:{port}", "--out", tmp_path / folder).returncode == 69
    motion.unlink()
    assert [file.name for file in tmp_path.rglob("*")] == ["mine", "notes.txt"]


def test_a_robot_whose_version_nobody_heard_leaves_no_folder(tmp_path: Path) -> None:
    bind = f"127.0.0.1:{free_udp_port()}"
    words = ("--no-fit", "--fri-version", "auto", "--start-timeout", 0.1)
    motion = short_trajectory(tmp_path / "short.json")
    assert iiwa_ident("run", motion, "--bind", bind, "--out", tmp_path / "run", *words).returncode == 69
    assert list(tmp_path.iterdir()) == [motion]


def test_no_robot_is_said_after_the_time_allowed(tmp_path: Path) -> None:
    motion, bind = short_trajectory(tmp_path / "short.json"), f"127.0.0.1:{free_udp_port()}"
    result = iiwa_ident("run", motion, "--bind", bind, "--out", tmp_path / "run", "--no-fit", "--start-timeout", 1)
    assert result.returncode == 69
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_before_anything_is_recorded_leaves_no_folder(number: signal.Signals, tmp_path: Path) -> None:
    motion, bind = short_trajectory(tmp_path / "short.json"), f"127.0.0.1:{free_udp_port()}"
    words = ("--bind", bind, "--out", tmp_path / "run", "--no-fit", "--fri-version", "auto")
    process = start_iiwa_ident("run", motion, *words)
    assert process.stdout is not None
    while "Listening which FRI version" not in process.stdout.readline():
        assert process.poll() is None
    process.send_signal(number)
    process.communicate(timeout=WATCHDOG_S)
    assert process.returncode == 130
    assert list(tmp_path.iterdir()) == [motion]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_proof_that_is_ended_leaves_no_folder(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGTERM and a closed terminal left the recordings of its cases among the temporary files."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    process = start_iiwa_ident("prove", "--cases", 4, "--jobs", 1)
    assert process.stdout is not None
    while "label sealed" not in process.stdout.readline():
        assert process.poll() is None
    assert list(tmp_path.iterdir())
    process.send_signal(number)
    process.communicate(timeout=WATCHDOG_S)
    assert process.returncode == 130
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["fit", "import", "recover"])
def test_a_missing_file_is_66(tmp_path: Path, command: str) -> None:
    result = iiwa_ident(command, tmp_path / "nothing.mcap")
    assert result.returncode == 66
    assert "nothing.mcap" in result.stderr


def test_a_csv_with_letters_names_line_and_column(tmp_path: Path) -> None:
    rows = ["t,q1,tau1"] + [f"{k * 0.01:.2f},{np.sin(k * 0.1):.6f},{np.cos(k * 0.1):.6f}" for k in range(500)]
    rows[42] = "0.41,abc,0.5"
    file = tmp_path / "letters.csv"
    file.write_text("\n".join(rows) + "\n")
    result = iiwa_ident("fit", file, "--robot", "iiwa14")
    assert result.returncode == 65
    assert "letters.csv" in result.stderr
    assert one_sentence(result.stderr)


def test_a_recording_of_a_tenth_of_a_second_is_refused(tmp_path: Path) -> None:
    time = np.arange(100) * 1e-3
    file = tmp_path / "short.npz"
    np.savez(file, t=time, q=np.zeros((100, 7)) + time[:, None], tau=np.zeros((100, 7)), robot="iiwa14")
    result = iiwa_ident("fit", file)
    assert result.returncode == 65
    assert one_sentence(result.stderr)


def test_a_urdf_without_the_joints_is_refused(tmp_path: Path) -> None:
    urdf = tmp_path / "empty.urdf"
    urdf.write_text('<robot name="empty"><link name="base"/></robot>')
    time = np.arange(5000) * 1e-3
    file = tmp_path / "recording.npz"
    motion = np.sin(time[:, None] * np.arange(1, 8))
    np.savez(file, t=time, q=motion, tau=motion, robot="iiwa14")
    result = iiwa_ident("fit", file, "--robot", urdf)
    assert result.returncode == 65
    assert "empty.urdf" in result.stderr


def test_json_on_stdout_is_nothing_but_json() -> None:
    result = iiwa_ident("check", "--json", "-")
    assert result.returncode == 0
    assert json.loads(result.stdout)["safe"] is True
