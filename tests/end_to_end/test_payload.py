"""A tool weighed end to end: two fifths of the shipped motion twice against the fake robot in lockstep, then `payload`
on the logs.

Truth: the load that the fake robot's plant is told of.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from identification.excitation import FourierTrajectory
from tests.end_to_end.processes import fake_robot, iiwa_ident
from tests.ports import free_udp_port
from tests.short_motion import short_trajectory

LOAD = (2.5, 0.02, -0.015, 0.09)
"""kg, then m from the flange."""


def recorded(folder: Path, name: str, *options: object, load: tuple[float, ...] = (0.0,) * 4) -> Path:
    physics, port = folder / f"{name}.yaml", free_udp_port()
    motion = short_trajectory(folder / "motion.json", period_s=4.0, scale=0.4, offset=None)
    # Near where the second of lead-in begins: a ramp from afar would be as long as the motion.
    begin = FourierTrajectory.from_json(json.loads(motion.read_text())).evaluate(np.array([-1.0]))[0][0] + 0.02
    physics.write_text(
        f"load_kg_m: {list(load)}\ncabinet_load_kg_m: {list(load)}\ninitial_position_rad: {begin.tolist()}\n"
    )
    seed = sum(map(ord, name))
    with fake_robot(port, folder / f"{name}.json", "--lockstep", "--seed", seed, "--physics", physics):
        result = iiwa_ident(
            "run",
            motion,
            "--periods",
            1,
            "--bind",
            f"127.0.0.1:{port}",
            "--out",
            folder / name,
            "--no-fit",
            *options,
        )
    assert result.returncode == 0, result.stderr
    return folder / name / "recording.mcap"


def test_a_tool_on_the_fake_robot_is_weighed_from_two_runs(tmp_path: Path) -> None:
    bare = recorded(tmp_path, "bare")
    tool = recorded(tmp_path, "tool", "--tool", f"{LOAD[0]}@{LOAD[1]},{LOAD[2]},{LOAD[3]}", load=LOAD)
    result = iiwa_ident("payload", bare, "--", tool, "--json", "-")
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["frame"] == "the flange"
    numbers = [found["mass"], *(found["center_of_mass"][axis] for axis in "xyz")]
    assert numbers[0]["value"] == pytest.approx(LOAD[0], rel=0.01)
    for number, true in zip(numbers[1:], LOAD[1:], strict=True):
        assert number["value"] == pytest.approx(true, abs=0.002)
    # Four intervals of 95 %: fewer than three that hold have a chance of 1.4 %.
    assert sum(item["ci95"][0] <= true <= item["ci95"][1] for item, true in zip(numbers, LOAD, strict=True)) >= 3
    assert found["load_data"]["Z"] == pytest.approx(1e3 * LOAD[3], abs=2.0)
    assert found["comparison"] == "The log says 2.5 kg at (20, -15, 90) mm, which agrees."
