"""A run that commands nothing, as an operator starts it, while somebody leads the arm."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import yaml

from identification.recordings.reader import read_inputs
from identification.recordings.recording import CLOCK_START
from tests.end_to_end.processes import fake_robot, iiwa_ident, start_iiwa_ident
from tests.ports import free_udp_port

LED_RAD = 0.4
LED_PERIODS_S = (4.1, 4.7, 3.7, 3.1, 2.9, 2.3, 1.9)
"""Of the fake robot's hand, joint by joint."""
START_RAD = np.array([0.0, 0.3, 0.0, -1.2, 0.0, 0.8, 0.0])
ROBOT_STARTS_S = 1_700_000_000.0
"""Time of its first message."""


def test_a_led_arm_is_recorded_until_ctrl_c_and_seen_meanwhile(tmp_path: Path) -> None:
    port, folder = free_udp_port(), tmp_path / "run"
    settings = tmp_path / "led.yaml"
    rules: dict[str, object] = {"overlay_application": False, "led_by_rad": LED_RAD}
    settings.write_text(yaml.safe_dump({"initial_position_rad": START_RAD.tolist(), "session": rules}))
    summary = tmp_path / "robot.json"
    with fake_robot(port, summary, "--lockstep", "--physics", settings):
        run = start_iiwa_ident("run", "--monitor-only", "--bind", f"127.0.0.1:{port}", "--out", folder)
        assert run.stdout is not None
        said = ""
        while "MONITORING_READY" not in said:
            line = run.stdout.readline()
            assert line, said
            said += line
        seen = iiwa_ident("watch", "--once", "--port", port).stdout
        run.send_signal(signal.SIGINT)
        said += run.communicate(timeout=600)[0]
    assert run.returncode == 0, said
    assert "no motion was commanded" in said
    assert f"iiwa-ident fit {folder}/recording.mcap" in said
    assert "monitor only" in seen
    assert "A7" in seen
    counts = json.loads(summary.read_text())["counts"]
    assert counts["commands_accepted"] == counts["commands_rejected"] == 0

    recording = read_inputs([folder / "recording.mcap"]).recordings[0]
    assert recording.period_s is None
    assert len(recording.time) == json.loads((folder / "run.json").read_text())["loop"]["received"]
    # In lockstep the robot's clock begins at a known time, and the arm follows the hand within its lag.
    since_s = recording.time + float(recording.source.metadata[CLOCK_START]) - ROBOT_STARTS_S
    led = 0.5 * LED_RAD * (1.0 - np.cos(2.0 * np.pi * since_s[:, None] / LED_PERIODS_S))
    travelled = recording.position - START_RAD
    assert np.abs(travelled - led).max() < 0.03 < led.max()
