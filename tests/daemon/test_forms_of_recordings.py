"""Claims about where a recording may be given: every command takes every form, and the robot from the model given.

Truth: the same rows in each form, packed by numpy, rosbags and the MCAP library, of an arm whose torque Pinocchio made.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pinocchio
import pytest
from rosbags.rosbag2 import StoragePlugin

from tests.daemon.command_line import run
from tests.identification.bags import messages_of, write_bag, write_mcap
from tests.identification.synthetic import fourier_motion

ARM = """<robot name="pair"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.1 0.02 0.1"/><mass value="3"/>
<inertia ixx="0.04" iyy="0.05" izz="0.03" ixy="0.002" ixz="0.001" iyz="-0.003"/></inertial></link>
<link name="lower"><inertial><origin xyz="0.2 -0.03 0.05"/><mass value="2"/>
<inertia ixx="0.03" iyy="0.04" izz="0.02" ixy="0.001" ixz="0.002" iyz="-0.001"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<origin xyz="0 0 0.3"/><limit lower="-3" upper="3" velocity="3" effort="200"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><axis xyz="1 0 0"/>
<origin xyz="0.3 0 0.1"/><limit lower="-3" upper="3" velocity="3" effort="200"/></joint></robot>"""
NAMES = ("shoulder", "elbow")
STEP_S, SAMPLES = 0.01, 1200
TOOL_KG = 2.0
FORMS = ("npz", "csv", "mcap", "db3", "database folder", "bag folder", "run folder")
COMMANDS = (
    "fit A --robot ARM --no-physical --out OUT/model.json",
    "fit A B --robot ARM --no-physical --folds 2 --out OUT/model.json",
    "compare A B --robot ARM",
    "compare MODEL B",
    "compare --models MODEL ARM -- B",
    "leaderboard MODEL ARM --on B",
    "payload A C --robot ARM",
    "doctor --log A --robot ARM",
    "validate MODEL B",
    "feasibility MODEL B",
    "simulate MODEL B --controller position",
    "import A --robot ARM --out OUT/log.mcap",
)
PAIRS = [
    *((form, COMMANDS[0]) for form in FORMS),
    *((FORMS[(number + step) % len(FORMS)], command) for number, command in enumerate(COMMANDS[1:]) for step in (0, 3)),
]
"""Every form by one command, every command by two forms: one function reads them, and a command that does not use it is
told by either.
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The arm, its model, and recordings (a, b; c with a tool), a folder for each form; none of them names the arm."""
    home = tmp_path_factory.mktemp("forms")
    (home / "pair.urdf").write_text(ARM)
    model = pinocchio.buildModelFromXML(ARM)
    data = model.createData()
    for letter, seed in (("a", 1), ("b", 2), ("c", 3)):
        if letter == "c":
            model.inertias[2] += pinocchio.Inertia(TOOL_KG, np.array([0.3, 0.1, 0.1]), np.diag([4e-3, 5e-3, 6e-3]))
            data = model.createData()
        q, dq, ddq = fourier_motion(2, period_s=6.0, samples=600, seed=seed)
        tau = np.array([pinocchio.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])
        q, tau = np.tile(q, (2, 1)), np.tile(tau + 0.8 * np.sign(dq) + 0.5 * dq, (2, 1))
        tau += 0.02 * np.random.default_rng(seed).normal(size=tau.shape)
        write_forms(home, letter, np.arange(SAMPLES) * STEP_S, q, tau)
    assert run("fit", home / "npz" / "a.npz", "--robot", home / "pair.urdf", "--out", home / "model.json") == 0
    return home


def write_forms(home: Path, letter: str, time: np.ndarray, q: np.ndarray, tau: np.ndarray) -> None:
    for form in FORMS:
        (home / form).mkdir(exist_ok=True)
    messages = messages_of(5.0 + time, NAMES, q, tau)
    np.savez(home / "npz" / f"{letter}.npz", t=time, q=q, tau=tau)
    np.savetxt(
        home / "csv" / f"{letter}.csv", np.column_stack([time, q, tau]), delimiter=",", header="t,q1,q2,tau1,tau2",
        comments="",
    )  # fmt: skip
    write_mcap(home / "mcap" / f"{letter}.mcap", messages)
    write_bag(home / "database folder" / letter, messages)
    write_bag(home / "bag folder" / letter, messages, storage=StoragePlugin.MCAP)
    shutil.copy(home / "database folder" / letter / f"{letter}.db3", home / "db3" / f"{letter}.db3")
    (home / "run folder" / letter).mkdir()
    shutil.copy(home / "mcap" / f"{letter}.mcap", home / "run folder" / letter / "recording.mcap")


def command_line(text: str, home: Path, form: str, out: Path) -> list[object]:
    """The words of a command with A, B, C for recordings, ARM and MODEL for what they are of, OUT for a folder."""
    ending = "" if form.endswith("folder") else f".{form}"
    words: dict[str, object] = {name: home / form / f"{name.lower()}{ending}" for name in "ABC"}
    words |= {"ARM": home / "pair.urdf", "MODEL": home / "model.json"}
    return [words.get(word, word.replace("OUT", str(out))) for word in text.split()]


@pytest.mark.parametrize(("form", "command"), PAIRS)
def test_a_command_takes_a_recording_in_any_form(home: Path, form: str, command: str, tmp_path: Path) -> None:
    """An answer that is no (exit code 1) is one: what counts is that the recording is taken."""
    assert run("-q", *command_line(command, home, form, tmp_path)) in (0, 1)


@pytest.mark.parametrize(
    ("form", "command"),
    [
        ("database folder", "batch fit A B --robot ARM --jobs 1 --out OUT"),
        ("run folder", "diagnose A --heldout B --robot ARM --out OUT"),
        ("csv", "diagnose A --model MODEL --out OUT"),
    ],
)
def test_a_long_command_takes_a_recording_in_any_form(home: Path, form: str, command: str, tmp_path: Path) -> None:
    """All commands share one reader, and these forms are the three ways into it."""
    assert run("-q", *command_line(command, home, form, tmp_path)) == 0
