"""A recording confirms nothing that was fitted to it, under whatever name, format or cut it comes again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.errors import RecordingError
from identification.recordings import (
    Recording,
    read_recording,
    recording_names,
    refuse_shared_samples,
    write_recording,
)
from tests.identification.synthetic import fourier_motion, recording_of


def one_run(seed: int) -> Recording:
    """The same motion each time, with noise of its own: what a second run of a trajectory is."""
    random = np.random.default_rng(seed)
    q, dq, _ = fourier_motion(7, period_s=5.0, samples=1000, seed=1)
    return recording_of(q + 1e-5 * random.normal(size=q.shape), dq + 0.1 * random.normal(size=q.shape), period_s=5.0)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("run") / "fitted.npz"
    run = one_run(1)
    np.savez(path, t=run.time, q=run.position, tau=run.torque, robot="iiwa14")
    return read_recording(path)


def copies(fitted: Recording, folder: Path) -> list[Recording]:
    log = write_recording(fitted, folder / "imported.mcap")
    cut = slice(600, None)
    np.savez(folder / "cut.npz", t=fitted.time[cut] - 3.0, q=fitted.position[cut], tau=fitted.torque[cut])
    table = np.column_stack([fitted.time, fitted.position, fitted.torque])
    names = ["t", *(f"q{j}" for j in range(1, 8)), *(f"tau{j}" for j in range(1, 8))]
    np.savetxt(folder / "rounded.csv", table, delimiter=",", header=",".join(names), comments="", fmt="%.8f")
    return [fitted, *(read_recording(path) for path in (log, folder / "cut.npz", folder / "rounded.csv"))]


def test_a_fitted_recording_is_refused_under_any_name(fitted: Recording, tmp_path: Path) -> None:
    for copy in copies(fitted, tmp_path):
        with pytest.raises(RecordingError, match=r"cannot confirm what was fitted") as refusal:
            refuse_shared_samples([one_run(2), fitted], [copy])
        assert refusal.value.file == Path(copy.source.path)
        assert "fitted.npz" in str(refusal.value)


def test_another_run_of_the_same_motion_is_independent(fitted: Recording) -> None:
    refuse_shared_samples([fitted], [one_run(2), one_run(3)])


def test_two_runs_of_one_axis_with_coarse_sensors_are_independent(shared_folder: Path) -> None:
    """The EMPS benchmark: position and force in steps, so that pairs of them come again by accident."""
    first, second = (read_recording(shared_folder / "recordings" / f"emps_{run}.npz") for run in "ab")
    refuse_shared_samples([first], [second])
    cut = replace(second.rows(second.time > 12.0), source=replace(second.source, sha256="a cut"))
    with pytest.raises(RecordingError, match="shares"):
        refuse_shared_samples([second], [cut])


def test_a_robot_at_rest_shows_the_same_numbers_in_every_run(fitted: Recording) -> None:
    def rested(run: Recording) -> Recording:
        position, torque = run.position.copy(), run.torque.copy()
        position[:300], torque[:300] = position[0].round(2), torque[0].round(1)
        source = replace(run.source, sha256=f"{run.torque.sum()}")
        return replace(run, position=position, torque=torque, source=source)

    first, second = rested(one_run(4)), rested(one_run(5))
    same = first.position[:300], first.torque[:300]
    second.position[:300], second.torque[:300] = same
    refuse_shared_samples([first], [second])


def test_names_hold_as_many_folders_as_tell_the_files_apart(fitted: Recording) -> None:
    def at(path: str) -> Recording:
        return replace(fitted, source=replace(fitted.source, path=path))

    assert recording_names([at("a/x.npz"), at("a/y.npz")]) == ["x.npz", "y.npz"]
    runs = [at("a/first/recording.mcap"), at("a/second/recording.mcap")]
    assert recording_names(runs) == ["first/recording.mcap", "second/recording.mcap"]
