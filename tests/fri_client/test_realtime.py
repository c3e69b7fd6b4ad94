"""Real-time settings are obtained or refused item by item, never raised about, and given back."""

from __future__ import annotations

import ctypes
import gc
import json
import os
import resource
import subprocess
import sys
from typing import Any

import pytest

from fri_client import realtime as module
from fri_client.realtime import HIGHEST_PRIORITY, RealtimeSettings, realtime

NAMES = ["garbage_collector", "switch_interval", "memory", "affinity", "scheduler"]
NOTHING = RealtimeSettings(
    priority=None, cpus=None, lock_memory=False, stop_garbage_collector=False, switch_interval_s=None
)


def everything_of_the_process() -> tuple[Any, ...]:
    return (
        gc.isenabled(),
        sys.getswitchinterval(),
        os.sched_getscheduler(0),
        os.sched_getparam(0).sched_priority,
        os.sched_getaffinity(0),
    )


def test_what_is_obtained_holds_and_is_given_back() -> None:
    before = everything_of_the_process()
    cpu = min(os.sched_getaffinity(0))
    with realtime(RealtimeSettings(priority=1, cpus=(cpu,), switch_interval_s=0.001)) as report:
        assert [item.name for item in report.items] == NAMES
        assert not gc.isenabled()
        assert sys.getswitchinterval() == pytest.approx(0.001)
        if report.item("affinity").obtained:
            assert os.sched_getaffinity(0) == {cpu}
        if report.item("scheduler").obtained:
            assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
            assert os.sched_getparam(0).sched_priority == 1
    assert everything_of_the_process() == before


def test_it_is_given_back_when_the_loop_fails() -> None:
    before = everything_of_the_process()
    with pytest.raises(RuntimeError, match="loop"), realtime(RealtimeSettings(priority=1, lock_memory=False)):
        raise RuntimeError("loop")
    assert everything_of_the_process() == before


def test_what_is_not_asked_for_is_left_alone() -> None:
    before = everything_of_the_process()
    with realtime(NOTHING) as report:
        assert everything_of_the_process() == before
        assert all(not item.wanted and not item.obtained for item in report.items)


def test_a_collector_that_was_off_stays_off() -> None:
    gc.disable()
    try:
        with realtime(RealtimeSettings(priority=None, lock_memory=False)):
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_refusals_are_reported_with_their_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (0, 0))
    with realtime(RealtimeSettings(cpus=(100_000,), lock_memory=False)) as report:
        scheduler = report.item("scheduler")
        assert (scheduler.wanted, scheduler.obtained) == (True, False)
        assert "Operation not permitted" in scheduler.detail
        assert "rtprio" in scheduler.detail
        assert not report.item("affinity").obtained
        assert json.loads(json.dumps(report.to_json()))["scheduler"]["obtained"] is False


def test_a_lower_permitted_priority_is_taken_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def permit_up_to_20(_: int, policy: int, parameter: os.sched_param) -> None:
        asked.append(parameter.sched_priority)
        if parameter.sched_priority > 20:
            raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", permit_up_to_20)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (20, 20))
    with realtime(RealtimeSettings(priority=80, lock_memory=False)) as report:
        assert report.item("scheduler").obtained
        assert report.item("scheduler").detail == "SCHED_FIFO 20 instead of 80"
    assert asked[:2] == [80, 20]


def test_no_priority_above_the_kernels_own_threads_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda *arguments: asked.append(arguments[2].sched_priority))
    with realtime(RealtimeSettings(priority=99, lock_memory=False)):
        pass
    assert max(asked) == HIGHEST_PRIORITY


def test_a_platform_without_the_calls_is_served_with_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_setscheduler")
    monkeypatch.delattr(os, "sched_setaffinity")
    with realtime(RealtimeSettings(cpus=(0,), lock_memory=False)) as report:
        assert "no such call" in report.item("scheduler").detail
        assert "no such call" in report.item("affinity").detail
        assert report.item("garbage_collector").obtained


def test_future_memory_is_locked_only_where_no_limit_binds(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    class Library:
        def mlockall(self, flags: int) -> int:
            asked.append(flags)
            return 0

        def munlockall(self) -> int:
            return 0

    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: Library())
    monkeypatch.setattr(resource, "setrlimit", lambda *_: None)
    monkeypatch.setattr(module, "_has_capability", lambda _: False)
    only_memory = RealtimeSettings(priority=None, stop_garbage_collector=False, switch_interval_s=None)
    for limit in (resource.RLIM_INFINITY, 8 << 20):
        monkeypatch.setattr(resource, "getrlimit", lambda _, limit=limit: (limit, limit))
        with realtime(only_memory) as report:
            assert report.item("memory").obtained
    # Flags of mlockall(2): 1 is MCL_CURRENT, 2 is MCL_FUTURE.
    assert asked == [3, 1]


def test_an_ordinary_user_gets_a_report_and_no_exception() -> None:
    program = (
        "import json, os, resource\n"
        "for limit in (resource.RLIMIT_MEMLOCK, resource.RLIMIT_RTPRIO): resource.setrlimit(limit, (0, 0))\n"
        "if os.geteuid() == 0:\n"
        "    try: os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
        "    except PermissionError: print('null'); raise SystemExit\n"
        "with realtime(RealtimeSettings()) as report: print(json.dumps(report.to_json()))\n"
    )
    program = "from fri_client.realtime import RealtimeSettings, realtime\n" + program
    finished = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=600)
    report = json.loads(finished.stdout)
    if report is None:
        pytest.skip("this root may not become an ordinary user")
    assert {name: item["obtained"] for name, item in report.items()} == {
        "garbage_collector": True,
        "switch_interval": True,
        "memory": False,
        "affinity": False,
        "scheduler": False,
    }
    assert "memlock" in report["memory"]["detail"]
