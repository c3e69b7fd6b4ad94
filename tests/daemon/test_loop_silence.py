"""How long a loop has been silent. Truth: a clock set here."""

from __future__ import annotations

import pytest

from daemon.run import supervision


@pytest.mark.parametrize(("said_ns", "silent_s"), [(95_000_000_000, 5.0), (0, 60.0)])
def test_a_loop_that_was_stopped_before_its_first_word_is_silent_since_it_was_begun(
    monkeypatch: pytest.MonkeyPatch, said_ns: int, silent_s: float
) -> None:
    """It counted as not silent at all, and a loop held then was waited for without end."""
    monkeypatch.setattr(supervision.time, "monotonic", lambda: 100.0)
    assert supervision.silence_s(said_ns, began_s=40.0) == pytest.approx(silent_s)
