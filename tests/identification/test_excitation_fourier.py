"""Claims about eq. (12), its table and its file; truth from the printed equation, differences and the file format."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.errors import ModelFileError, TrajectoryError, TrajectoryNotFoundError
from identification.excitation import FourierTrajectory, TableTrajectory, load_trajectory, trajectory_from_json
from identification.model_file import read_model


def _trajectory(seed: int = 0, joints: int = 3, harmonics: int = 4) -> FourierTrajectory:
    generator = np.random.default_rng(seed)
    a, b = generator.normal(size=(2, joints, harmonics))
    return FourierTrajectory(0.1, a, b, generator.normal(size=joints), "iiwa14", {"seed": seed})


def test_position_is_the_printed_series() -> None:
    trajectory = FourierTrajectory(0.1, np.array([[0.3, -0.2]]), np.array([[0.5, 0.4]]), np.array([0.7]))
    time = 1.7
    w = 2.0 * math.pi * 0.1
    printed = 0.7 + sum(
        a / (w * k) * math.sin(w * k * time) - b / (w * k) * math.cos(w * k * time)
        for k, a, b in ((1, 0.3, 0.5), (2, -0.2, 0.4))
    )
    q, _, _ = trajectory.evaluate(time)
    assert q[0, 0] == pytest.approx(printed, abs=1e-15)


def test_velocity_and_acceleration_are_the_derivatives_of_position() -> None:
    trajectory = _trajectory()
    time = np.linspace(0.0, 10.0, 37)
    step = 1e-4
    _, dq, ddq = trajectory.evaluate(time)
    before, after = trajectory.evaluate(time - step), trajectory.evaluate(time + step)
    np.testing.assert_allclose(dq, (after[0] - before[0]) / (2 * step), atol=1e-6)
    np.testing.assert_allclose(ddq, (after[1] - before[1]) / (2 * step), atol=1e-6)


def test_table_holds_exactly_one_period_and_repeats() -> None:
    trajectory = _trajectory()
    table = trajectory.table(1000.0)
    assert table.shape == (10_000, 3)
    np.testing.assert_allclose(trajectory.evaluate(10.0)[0][0], table[0], atol=1e-12)
    np.testing.assert_allclose(trajectory.evaluate(3.217)[0][0], table[3217], atol=1e-12)


def test_a_period_without_whole_samples_is_refused() -> None:
    trajectory = FourierTrajectory(0.3, np.ones((1, 3)), np.ones((1, 3)), np.zeros(1))
    with pytest.raises(TrajectoryError, match="whole number of samples"):
        trajectory.table(1000.0)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.01, 3.0), st.integers(0, 1000))
def test_scaling_multiplies_every_derivative_and_keeps_the_offset(amplitude: float, seed: int) -> None:
    trajectory = _trajectory(seed)
    full, part = trajectory.evaluate(2.3), trajectory.scaled(amplitude).evaluate(2.3)
    np.testing.assert_allclose(part[0] - trajectory.offset, amplitude * (full[0] - trajectory.offset), atol=1e-12)
    np.testing.assert_allclose(part[1], amplitude * full[1], atol=1e-12)
    np.testing.assert_allclose(part[2], amplitude * full[2], atol=1e-12)


def test_a_file_brings_back_every_bit(tmp_path: Path) -> None:
    trajectory = _trajectory()
    path = tmp_path / "motion.json"
    path.write_text(json.dumps(trajectory.to_json(table_rate_hz=100.0)), encoding="utf-8")
    loaded = load_trajectory(path)
    assert isinstance(loaded, FourierTrajectory)
    np.testing.assert_array_equal(loaded.a, trajectory.a)
    np.testing.assert_array_equal(loaded.offset, trajectory.offset)
    assert loaded.robot == "iiwa14"
    assert loaded.record["seed"] == 0


@pytest.mark.parametrize("field", ["a", "b", "fundamental_frequency_hz"])
def test_a_missing_field_is_named(tmp_path: Path, field: str) -> None:
    document = _trajectory().to_json()
    del document[field]
    path = tmp_path / "motion.json"
    path.write_text(json.dumps({**document, "kind": "fourier"}), encoding="utf-8")
    with pytest.raises(TrajectoryError, match=f"motion.json.*'{field}'") as caught:
        load_trajectory(path)
    assert caught.value.exit_code == 65
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("a", [[1.0, float("nan")]] * 3),
        ("a", [[1.0, 2.0], [1.0]]),
        ("b", [[1.0]]),
        ("b", "none"),
        ("offset", [0.0]),
        ("offset", [0.0, float("inf"), 0.0]),
        ("harmonics", 7),
        ("fundamental_frequency_hz", -1.0),
        ("fundamental_frequency_hz", "fast"),
        ("format", "someone-else/1"),
        ("kind", "spline"),
    ],
)
def test_unusable_content_is_bad_data(tmp_path: Path, field: str, value: Any) -> None:
    path = tmp_path / "motion.json"
    path.write_text(json.dumps({**_trajectory().to_json(), field: value}), encoding="utf-8")
    with pytest.raises(TrajectoryError) as caught:
        load_trajectory(path)
    assert caught.value.exit_code == 65
    assert "motion.json" in str(caught.value)


def test_brackets_without_end_are_bad_data(tmp_path: Path) -> None:
    path = tmp_path / "motion.json"
    path.write_text("[" * 100_000, encoding="utf-8")
    with pytest.raises(TrajectoryError, match=r"motion\.json"):
        load_trajectory(path)
    with pytest.raises(ModelFileError, match=r"motion\.json"):
        read_model(path)


def test_no_file_is_missing_input(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryNotFoundError) as caught:
        load_trajectory(tmp_path / "nowhere.json")
    assert caught.value.exit_code == 66


@pytest.mark.parametrize("content", ["{", "[1, 2]", '{"robot": "iiwa14"}', "\x00\x01"])
def test_a_file_that_is_no_trajectory_is_bad_data(tmp_path: Path, content: str) -> None:
    path = tmp_path / "motion.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(TrajectoryError) as caught:
        load_trajectory(path)
    assert caught.value.exit_code == 65


def test_a_csv_table_becomes_one_period(tmp_path: Path) -> None:
    trajectory = _trajectory(joints=2)
    time = np.arange(1001) / 100.0
    rows = np.column_stack([time, trajectory.evaluate(time)[0]])
    path = tmp_path / "motion.csv"
    path.write_text("t,q1,q2\n" + "\n".join(",".join(f"{x:.17g}" for x in row) for row in rows), encoding="utf-8")
    loaded = load_trajectory(path)
    assert loaded.period_s == pytest.approx(10.0, rel=1e-9)
    # The closed-form series is band-limited, so the trigonometric interpolation must find it between the rows again.
    np.testing.assert_allclose(loaded.table(1000.0), trajectory.table(1000.0), atol=1e-10)
    for own, true in zip(loaded.evaluate([1.2345]), trajectory.evaluate(1.2345), strict=True):
        np.testing.assert_allclose(own, true, atol=1e-8)


@pytest.mark.parametrize(
    ("content", "wanted"),
    [
        ("t,q1\n0,0\n0.01,abc\n0.02,0\n0.03,0\n", "row 3.*'q1'.*'abc'"),
        ("t,q1\n0,0\n0.01,nan\n0.02,0\n0.03,0\n", "row 2, joint 1"),
        ("t,q1\n0,0\n0.01\n", "row 3 has 1"),
        ("t,q2\n0,0\n", "first line"),
        ("t,q1\n0,0\n0.01,1\n0.05,2\n0.06,1\n", "evenly"),
        ("", "empty"),
    ],
)
def test_a_bad_csv_says_where(tmp_path: Path, content: str, wanted: str) -> None:
    path = tmp_path / "motion.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(TrajectoryError, match=wanted):
        load_trajectory(path)


def test_an_npz_table_is_read_and_a_broken_one_refused(tmp_path: Path) -> None:
    table = _trajectory().table(100.0)
    path = tmp_path / "motion.npz"
    np.savez(path, q=table, rate_hz=100.0, robot="iiwa14")
    loaded = load_trajectory(path)
    np.testing.assert_array_equal(loaded.table(100.0), table)
    assert loaded.robot == "iiwa14"
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(TrajectoryError, match="NPZ"):
        load_trajectory(path)


def test_a_table_survives_its_own_file() -> None:
    trajectory = TableTrajectory(_trajectory().table(50.0), 50.0, "x")
    again = trajectory_from_json(json.loads(json.dumps(trajectory.to_json())))
    np.testing.assert_array_equal(again.table(50.0), trajectory.position)
