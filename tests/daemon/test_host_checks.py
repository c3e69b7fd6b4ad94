"""Claims about the checks of the host: what they measure is there, and what they cannot use is said."""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.doctor import wake_ups as wake_ups_module
from daemon.doctor.host_checks import check_clock, check_disk, check_wake_ups, measure_disk
from daemon.doctor.wake_ups import WakeUps, measured_wake_ups, wake_ups
from fri_client.realtime import RealtimeSettings


def test_the_disk_is_measured_by_writing_and_nothing_is_left(tmp_path: Path) -> None:
    speed, slowest = measure_disk(tmp_path)
    assert speed > 0.0
    assert slowest > 0.0
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_a_run_will_make_is_judged_by_where_it_will_be(tmp_path: Path) -> None:
    check = check_disk(tmp_path / "runs" / "tomorrow")
    assert check.status in ("ok", "warning")
    assert f"in {tmp_path}:" in check.sentence
    assert "MB/s" in check.sentence


def test_a_folder_that_takes_no_file_fails() -> None:
    check = check_disk(Path("/proc/self"))
    assert check.status == "failed"
    assert check.remedy


@pytest.mark.parametrize("step", [0.5, -0.5])
def test_a_clock_that_jumps_is_told(step: float) -> None:
    check = check_clock(step, 3.0)
    assert check.status == "warning"
    assert f"{step * 1e3:.0f} ms" in check.sentence


def test_a_clock_that_runs_on_is_no_warning_unless_nobody_keeps_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for kept, status in ((True, "ok"), (False, "warning")):
        monkeypatch.setattr("daemon.doctor.host_checks._clock_is_kept", lambda kept=kept: kept)
        for check in (check_clock(0.0002, 3.0), check_clock(None, 0.0)):
            assert check.status == status
            assert bool(check.remedy) == (not kept)


class SimulatedTime:
    """A clock that sleeps exactly as long as it is asked to, and longer where the machine does something else."""

    def __init__(self, held_up_ns: dict[int, int]) -> None:
        self.now_ns, self.held_up_ns, self.sleeps = 10**9, held_up_ns, 0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.sleeps += 1
        self.now_ns += round(seconds * 1e9) + self.held_up_ns.get(self.sleeps, 0)


def test_the_latest_wake_up_is_the_longest_hold_up(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = RealtimeSettings(None, lock_memory=False, stop_garbage_collector=False, switch_interval_s=None)
    for held_up, latest in (({}, 0.0), ({3: 400_000, 7: 16_000_000}, 0.016)):
        time = SimulatedTime(held_up)
        monkeypatch.setattr(wake_ups_module, "time", time)
        found = wake_ups(0.1, nothing)
        assert found.latest_s == pytest.approx(latest, abs=1e-6)
        assert found.count == time.sleeps
        assert not found.real_time


def test_wake_ups_are_measured_in_a_process_that_ends_with_the_examination() -> None:
    with measured_wake_ups(0.02) as woken:
        found = woken()
    assert found is not None
    assert found.count > 0
    assert found.latest_s >= 0.0


@pytest.mark.parametrize(
    ("latest_s", "at_robot", "status"),
    [(2e-4, True, "ok"), (4e-3, True, "warning"), (16e-3, True, "failed"), (16e-3, False, "warning")],
)
def test_no_arm_is_driven_from_a_machine_that_holds_a_command_up_for_longer_than_a_robot_bridges(
    latest_s: float, at_robot: bool, status: str
) -> None:
    check = check_wake_ups(WakeUps(3000, latest_s, real_time=True), at_robot=at_robot)
    assert check.status == status
    assert f"{latest_s * 1e3:.2f} ms" in check.sentence
    assert "real-time kernel" in check.remedy


def test_what_could_not_be_measured_is_said() -> None:
    for nothing in (None, WakeUps(0, 0.0, real_time=True)):
        assert check_wake_ups(nothing, at_robot=True).status == "warning"
