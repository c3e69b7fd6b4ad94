"""Claims about the demo's seal and its judgement; the chain behind it is that of `test_chain`.

Truth: SHA-256 of the standard library, and verdicts written down by hand.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from daemon.cli.demonstration import fresh_folder, is_right, judgement
from daemon.errors import SealBrokenError
from daemon.run.demonstration import fake_robot, opened_effect
from tests.ports import free_udp_port


def test_the_fake_robot_publishes_the_hash_of_what_its_summary_opens(tmp_path: Path) -> None:
    summary = tmp_path / "fake_robot.json"
    with fake_robot(free_udp_port(), summary, seed=1, hidden_effect=7, realtime=True) as commitment:
        assert commitment is not None
        assert not summary.exists()
    label = opened_effect(summary, commitment)
    assert label in json.loads(summary.read_text())["truth"]["effects"]


def test_a_label_that_was_changed_afterwards_is_noticed(tmp_path: Path) -> None:
    commitment = hashlib.sha256(b'salt{"effect": "cable_spring"}').hexdigest()
    summary = tmp_path / "fake_robot.json"
    seal = {"salt": "salt", "label": '{"effect": "cable_spring"}'}
    summary.write_text(json.dumps({"seal": seal}))
    assert opened_effect(summary, commitment) == {"effect": "cable_spring"}
    summary.write_text(json.dumps({"seal": {**seal, "label": '{"effect": "base_tilt"}'}}))
    with pytest.raises(SealBrokenError):
        opened_effect(summary, commitment)


def test_no_module_on_the_clients_side_knows_how_effects_are_drawn() -> None:
    code = (
        "import sys, daemon.cli.demonstration, daemon.run.demonstration, daemon.jobs.worker, daemon.jobs.diagnosis;"
        "print([name for name in sys.modules if name.startswith('fixtures')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


LABEL = {"effect": "torque_ripple", "joint": 4}
RIPPLE = {"effect": "torque_ripple", "joint": 4, "alternatives": []}
SPRING = {"effect": "cable_spring", "joint": 4, "alternatives": []}


@pytest.mark.parametrize(
    ("findings", "right", "words"),
    [
        ([RIPPLE], True, "Named rightly."),
        ([{**SPRING, "alternatives": [LABEL]}], True, "Within the names"),
        ([{**RIPPLE, "joint": 3}], False, "WRONG"),
        ([SPRING], False, "WRONG"),
        ([RIPPLE, SPRING], False, "among 2 findings"),
        ([], False, "Not named"),
    ],
)
def test_the_judgement_is_as_hard_as_the_truth(findings: list[dict[str, Any]], right: bool, words: str) -> None:
    assert is_right({"findings": findings}, LABEL) is right
    assert words in judgement({"findings": findings}, LABEL)


def test_a_second_demo_keeps_the_files_of_the_first(tmp_path: Path) -> None:
    wanted = tmp_path / "demo-output"
    assert fresh_folder(wanted) == wanted
    wanted.mkdir()
    assert fresh_folder(wanted) == wanted
    (wanted / "recording.mcap").touch()
    assert fresh_folder(wanted) == tmp_path / "demo-output-2"
    (tmp_path / "demo-output-2").touch()
    assert fresh_folder(wanted) == tmp_path / "demo-output-3"
