"""A recording confirms nothing that was fitted to it, under whatever name, format or cut it comes again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from identification.errors import RecordingError
from identification.model_file import read_model, write_model
from identification.recording_fit import fit_recordings
from identification.recordings import (
    Recording,
    read_recording,
    recording_names,
    refuse_repeated,
    refuse_shared_samples,
    write_recording,
)
from identification.robots import load_robot
from tests.identification.bags import messages_of, write_mcap
from tests.identification.synthetic import coloured_noise, fourier_motion, recording_of
from tests.reference import recording_file


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
    single = {"q": fitted.position.astype(np.float32), "tau": fitted.torque.astype(np.float32)}
    np.savez(folder / "single.npz", t=fitted.time, **single)
    files = (log, folder / "cut.npz", folder / "rounded.csv", folder / "single.npz")
    return [fitted, *(read_recording(path) for path in files)]


def test_a_fitted_recording_is_refused_under_any_name(fitted: Recording, tmp_path: Path) -> None:
    for copy in copies(fitted, tmp_path):
        with pytest.raises(RecordingError, match=r"cannot confirm what was fitted") as refusal:
            refuse_shared_samples([one_run(2), fitted], [copy])
        assert refusal.value.file == Path(copy.source.path)
        assert "fitted.npz" in str(refusal.value)


def test_the_file_of_a_model_knows_the_samples_it_was_fitted_to(fitted: Recording, tmp_path: Path) -> None:
    fit = fit_recordings([fitted], load_robot("iiwa14"))
    model = read_model(write_model(fit.to_model_json(notes=False), tmp_path / "model.json"))
    for copy in copies(fitted, tmp_path):
        assert model.fitted_among([one_run(2), copy, one_run(3)]) == (Path(copy.source.path).name,)


def test_one_measurement_given_twice_is_refused_with_both_names(fitted: Recording, tmp_path: Path) -> None:
    robot = load_robot("iiwa14")
    for copy in copies(fitted, tmp_path):
        with pytest.raises(RecordingError, match=r"counts once") as refusal:
            fit_recordings([one_run(2), fitted, copy], robot)
        assert "fitted.npz" in str(refusal.value)
        assert Path(copy.source.path).name in str(refusal.value)
    refuse_repeated([fitted, one_run(2), one_run(3)])


def stamped(folder: Path, name: str, *, start_s: float, seed: int, rate_hz: float) -> Recording:
    """A log of one long motion that begins at start_s of its clock, as another program sees it: own rate, own noise."""
    random = np.random.default_rng(seed)
    since = np.arange(start_s, 20.0, 1.0 / rate_hz)
    phase = 2.0 * np.pi * since[:, None] * np.array([0.13, 0.21, 0.34, 0.27, 0.19, 0.41, 0.11])
    torque = 3.0 * np.cos(phase) + 0.1 * random.normal(size=phase.shape)
    path = folder / f"{name}.npz"
    np.savez(
        path, t=1.7e9 + since, q=np.sin(phase) + 1e-5 * random.normal(size=phase.shape), tau=torque, robot="iiwa14"
    )
    return read_recording(path)


def test_one_motion_seen_by_two_programs_is_one_measurement(tmp_path: Path) -> None:
    """A bag beside the log: no row is the same in both, their clocks and their positions are."""
    log, bag = (
        stamped(tmp_path, name, start_s=start, seed=seed, rate_hz=rate)
        for name, start, seed, rate in (("log", 0.0, 1, 500.0), ("bag", 8.0, 2, 93.0))
    )
    for first, second in ((log, bag), (bag, log)):
        with pytest.raises(RecordingError, match=r"same time as the fitted recording \S+, for 1[12](\.\d+)? s"):
            refuse_shared_samples([first], [second])
    kept = read_recording(write_recording(bag, tmp_path / "kept.mcap"))
    with pytest.raises(RecordingError, match="same time"):
        refuse_shared_samples([log], [kept])
    later = replace(bag, time=bag.time + 3600.0)
    refuse_shared_samples([log], [later])
    other_arm = replace(bag, position=bag.position[::-1].copy())
    refuse_shared_samples([log], [other_arm])
    without_date = [replace(item, time=item.time - 1.7e9) for item in (log, bag)]
    refuse_shared_samples(without_date[:1], without_date[1:])


def test_a_ros_bag_keeps_the_clock_that_its_rows_count_from(tmp_path: Path) -> None:
    log, _ = (stamped(tmp_path, name, start_s=0.0, seed=seed, rate_hz=500.0) for seed, name in ((1, "log"), (2, "x")))
    bag = tmp_path / "bag.mcap"
    names = [f"A{joint}" for joint in range(1, 8)]
    every = slice(3, None, 5)
    write_mcap(bag, messages_of(log.time[every], names, log.position[every], log.torque[every] + 0.01))
    with pytest.raises(RecordingError, match="same time"):
        refuse_repeated([log, read_recording(bag, robot="iiwa14")])


def test_another_run_of_the_same_motion_is_independent(fitted: Recording) -> None:
    refuse_shared_samples([fitted], [one_run(2), one_run(3)])


def test_two_runs_of_one_axis_with_coarse_sensors_are_independent() -> None:
    """The EMPS benchmark: position and force in steps, so that pairs of them come again by accident."""
    first, second = (read_recording(recording_file(f"emps_{run}.npz")) for run in "ab")
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


def several_periods(seed: int, *, motion: int = 1, warming: float = 0.0, kicked: bool = False) -> Recording:
    """Eight periods at 200 Hz with coloured noise; friction that fades as an arm warms up, and a start with a kick."""
    states = fourier_motion(7, period_s=5.0, samples=1000, seed=motion)
    q, dq, ddq = (np.tile(values, (8, 1)) for values in states)
    time = 0.005 * np.arange(len(q))[:, None]
    noise = coloured_noise(q.shape, deviation=0.1, correlation=0.9, seed=seed)
    torque = 5.0 * ddq + 3.0 * np.sign(dq) * (1.0 + warming * np.exp(-time / 30.0)) + noise
    return recording_of(q, torque + 50.0 * kicked * np.exp(-time / 0.3), period_s=5.0, periods=8, kind="npz")


def resampled(run: Recording, rate_hz: float, *, low_pass_hz: float = 40.0, begin_s: float = 0.0) -> Recording:
    """What another program makes of a run: a causal filter, another rate, a later begin, torques turned, no period."""
    filtered = lfilter(*butter(2, 2.0 * low_pass_hz * 0.005), run.torque, axis=0)
    time = np.arange(begin_s, run.time[-1], 1.0 / rate_hz)
    q, torque = (
        np.column_stack([np.interp(time, run.time, column) for column in values.T])
        for values in (run.position, -filtered)
    )
    return replace(
        run, time=time - begin_s, position=q, torque=torque, sampling_period_s=1.0 / rate_hz, period_s=None,
        period_index=None, sample_in_period=None, samples_per_period=None, source=replace(run.source, sha256="copy"),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("rate_hz", "low_pass_hz", "begin_s"), [(93.0, 40.0, 0.0), (200.0, 5.0, 0.0), (50.0, 15.0, 1.237)]
)
def test_a_copy_that_was_resampled_or_filtered_is_known_by_its_noise(
    rate_hz: float, low_pass_hz: float, begin_s: float
) -> None:
    """It was taken for another run, and confirmed whatever was fitted to it."""
    run = several_periods(1)
    copy = resampled(run, rate_hz, low_pass_hz=low_pass_hz, begin_s=begin_s)
    for first, second in ((run, copy), (copy, run)):
        with pytest.raises(RecordingError, match=r"has the noise of .*a copy, resampled or filtered"):
            refuse_shared_samples([first], [second])


@pytest.mark.parametrize(("warming", "kicked"), [(0.0, False), (1.0, True)])
def test_runs_alike_in_all_but_their_noise_are_independent(warming: float, kicked: bool) -> None:
    """The same motion, the same way of warming up from cold, the same kick at the start."""
    first, second, third = (several_periods(seed, warming=warming, kicked=kicked) for seed in (1, 2, 3))
    refuse_shared_samples([first], [second, resampled(third, 93.0)])
    refuse_shared_samples([first], [several_periods(4, motion=2)])


def test_simulated_runs_of_two_motions_with_the_same_random_numbers_are_independent() -> None:
    """A study with one seed for its noise was refused as a copy."""
    refuse_shared_samples([several_periods(4)], [several_periods(4, motion=2)])
