"""Which changes explain the mean of the periods: a push beside names that are claimed as well, a drift that shows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from identification.mismatch import explained
from identification.mismatch.settings import LEAST_SHOWN, DiagnosisSettings
from identification.mismatch.unknown.over_time import Refused, least_of_drifts


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
    found = explained.concluded("without", nothing, nothing, {}, DiagnosisSettings(), physics=True)  # type: ignore[arg-type]
    assert found[0] == kept


@pytest.mark.parametrize(
    ("refused", "taken"),
    [
        ([], True),
        # Too weak in the contrasts: mean and contrasts together are asked.
        ([("torque_sensor_drift", 1, True)], True),
        ([("torque_sensor_drift", 1, True), ("thermal_friction", 1, False)], False),
        ([("thermal_friction", 1, False)], False),
        ([("thermal_friction", 2, False)], True),
    ],
)
def test_a_drift_too_weak_in_its_contrasts_is_asked_together_with_its_mean(
    monkeypatch: pytest.MonkeyPatch, refused: list[tuple[str, int, bool]], taken: bool
) -> None:
    least = least_of_drifts([Refused(name, joint, (), 0.0, (0.0, 0.0), 0.0, weak) for name, joint, weak in refused])
    now: Any = SimpleNamespace(
        problem=None, library=None, regressor=None, result=None, evidences=(),
        fitted=SimpleNamespace(evidences=(), changes=(), renewal=lambda *_: None, with_change=lambda _: changed),
    )  # fmt: skip
    changed = SimpleNamespace(problem=lambda: None)
    place = SimpleNamespace(place=SimpleNamespace(joint=1))
    monkeypatch.setattr(explained, "search", lambda *_: None)
    monkeypatch.setattr(explained, "replace", lambda *_, **__: "with a drift")
    for shown, with_drift in ((1.1 * LEAST_SHOWN, taken), (0.9 * LEAST_SHOWN, not refused or refused[0][1] == 2)):
        drift = SimpleNamespace(gain=shown, estimate=place)
        monkeypatch.setattr(explained, "find_drift_in_mean", lambda *_, drift=drift: drift)
        found: Any = explained._with_drift(now, least, DiagnosisSettings())
        assert (found == "with a drift") == with_drift
