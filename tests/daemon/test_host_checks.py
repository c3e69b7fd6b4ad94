"""Claims about the checks of the host: what they measure is there, and what they cannot use is said."""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.doctor.host_checks import check_clock, check_disk, measure_disk


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
