"""A push in every period is claimed only where it leaves nothing but noise beside names that are claimed as well."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from identification.mismatch import explained
from identification.mismatch.settings import DiagnosisSettings


@pytest.mark.parametrize(("complete", "kept"), [(True, "with a push"), (False, "without")])
def test_a_push_falls_with_the_names_that_it_needed(monkeypatch: pytest.MonkeyPatch, complete: bool, kept: str) -> None:
    """A base that yields was told as a push of 0.9 N: beside three names it left nothing but noise, and none of the
    three could be claimed. The push stood, beside eight times the noise.
    """

    def claimed(now: Any, *_: Any, physics: bool) -> Any:
        assert physics
        return now, None, None, SimpleNamespace(trial=SimpleNamespace(complete=complete and now == "with a push"))

    monkeypatch.setattr(explained, "_with_push", lambda *_: "with a push")
    monkeypatch.setattr(explained, "_with_drift", lambda now, *_: now)
    monkeypatch.setattr(explained, "_claimed", claimed)
    nothing: Any = None
    found = explained.concluded("without", nothing, nothing, set(), DiagnosisSettings(), physics=True)  # type: ignore[arg-type]
    assert found[0] == kept
