"""An iiwa 7 from its shipped motion to its parameters. Truth: its public dimensions and the links of the fake robot."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from identification.base_parameters import BaseRegressor
from identification.robots import load_robot
from tests.end_to_end.processes import fake_robot, iiwa_ident
from tests.identification.synthetic import table_three
from tests.ports import free_udp_port

ADDED_KG_M2 = 6e-4
"""On every link's inertia, by the fake robot's own account (docs/fake-robot.md)."""


def test_an_iiwa_7_is_driven_by_its_own_motion_and_its_parameters_are_found(tmp_path: Path) -> None:
    port = free_udp_port()
    with fake_robot(port, tmp_path / "robot.json", "--lockstep", "--physics", "iiwa7"):
        words = ("--robot", "iiwa7", "--periods", 2, "--bind", f"127.0.0.1:{port}", "--no-fit")
        result = iiwa_ident("run", *words, "--out", tmp_path / "run")
    assert result.returncode == 0, result.stderr
    result = iiwa_ident("fit", tmp_path / "run", "--no-physical", "--out", tmp_path / "model.json")
    assert result.returncode == 0, result.stderr
    model = json.loads((tmp_path / "model.json").read_text())
    regressor = BaseRegressor(load_robot("iiwa7"))
    links = table_three()
    links = replace(links, inertia=links.inertia + ADDED_KG_M2 * np.eye(3))
    true = regressor.base_from_physical(links)
    found = {item["name"]: item for item in model["base_parameters"]}
    deviation = [
        (found[name]["value"] - value) / found[name]["std"] for name, value in zip(regressor.names, true, strict=True)
    ]
    assert len(deviation) == 57
    assert np.sqrt(np.mean(np.square(deviation))) < 1.5
