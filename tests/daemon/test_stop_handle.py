"""Claims about the way of a stop into the ring; truth: the ring as the loop reads it, and real signals."""

from __future__ import annotations

import os
import signal
import threading
import time

from daemon.stop_handle import StopHandle
from fri_client.handover.ring import EventCode, HandoverRing


def test_a_stop_asked_for_before_there_is_a_ring_stands_in_it_from_the_first_moment() -> None:
    handle, ring = StopHandle(), HandoverRing.create(8)
    assert handle.request()
    with handle.attached(ring):
        assert ring.stop_request == EventCode.OPERATOR_STOP
    ring.close()


def test_the_first_reason_counts_and_asking_again_changes_nothing() -> None:
    handle, ring = StopHandle(), HandoverRing.create(8)
    with handle.attached(ring):
        assert handle.request(EventCode.SIGNAL_STOP)
        assert not handle.request(EventCode.OPERATOR_STOP)
        assert ring.stop_request == EventCode.SIGNAL_STOP
    ring.close()


def test_a_reason_that_stands_in_the_ring_already_is_kept() -> None:
    handle, ring = StopHandle(), HandoverRing.create(8)
    with handle.attached(ring):
        ring.request_stop(EventCode.DISK_FULL)
        handle.request()
        assert ring.stop_request == EventCode.DISK_FULL
    ring.close()


def test_asking_while_the_run_closes_its_ring_in_another_thread_is_safe() -> None:
    failures: list[BaseException] = []

    def ask(handle: StopHandle) -> None:
        try:
            handle.request()
        except BaseException as error:
            failures.append(error)

    for _ in range(200):
        handle, ring = StopHandle(), HandoverRing.create(8)
        with handle.attached(ring):
            thread = threading.Thread(target=ask, args=(handle,))
            thread.start()
        ring.close()
        thread.join()
    assert not failures


def test_signals_reach_the_ring_and_the_handlers_before_are_put_back() -> None:
    before = signal.getsignal(signal.SIGTERM)
    for number, code in (
        (signal.SIGTERM, EventCode.SIGNAL_STOP),
        (signal.SIGINT, EventCode.OPERATOR_STOP),
        (signal.SIGHUP, EventCode.TERMINAL_CLOSED),
    ):
        handle, ring = StopHandle(), HandoverRing.create(8)
        with handle.attached(ring), handle.on_signals():
            os.kill(os.getpid(), number)
            assert (ring.stop_request, handle.signal_number) == (code, number)
        ring.close()
    assert signal.getsignal(signal.SIGTERM) is before


def test_without_a_sign_of_the_watching_thread_the_operator_counts_as_unheard() -> None:
    assert StopHandle().alive
    handle = StopHandle(watched_by_s=0.02)
    time.sleep(0.05)
    assert not handle.alive
    handle = StopHandle(watched_by_s=1000.0)
    handle.tick()
    assert handle.alive


def test_only_a_closed_terminal_that_was_ignored_before_stays_ignored() -> None:
    """A script's background job ignores SIGINT; it stops the arm all the same."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, signal.SIG_IGN) for number in numbers}
    try:
        with StopHandle().on_signals():
            heard = {number: signal.getsignal(number) is not signal.SIG_IGN for number in numbers}
        assert heard == {signal.SIGINT: True, signal.SIGTERM: True, signal.SIGHUP: False}
        assert all(signal.getsignal(number) is signal.SIG_IGN for number in numbers)
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
