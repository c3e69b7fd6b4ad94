"""The commissioning ladder as far as a request alone tells of it: the rungs, who needs them, what a log says.

Not here: the record of what was completed, and who may drive (`commissioning`).
"""

from __future__ import annotations

from daemon.api import RunRequest

RUNGS = (0.1, 0.25, 0.5, 1.0)


def highest_allowed(done: float) -> float:
    """The largest amplitude that may follow `done` (0: none yet): the next rung above it."""
    return next((rung for rung in RUNGS if rung > done + 1e-9), RUNGS[-1])


def needs_ladder(request: RunRequest) -> bool:
    """Whether a real arm may move in this run; where not, only a robot that says it is the fake one is moved."""
    return not (request.simulation or request.monitor_only)


def tags(request: RunRequest) -> dict[str, str]:
    """What a log and run.json say: the amplitude, and whether the ladder was kept."""
    ladder = "skipped" if request.skip_ladder else "kept"
    if not needs_ladder(request):
        ladder = f"not needed: {'nothing is commanded' if request.monitor_only else 'fake robot'}"
    return {"commissioning": f"{request.amplitude:g}", "commissioning_ladder": ladder}
