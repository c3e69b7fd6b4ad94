"""The states of an investigation and every way from one to another, as one table. Nothing else decides what comes next.

A motion is only ever begun by ASKING with the answer AGREED: after a drop, a stop or a kill the loop stands in a state
from which nothing moves by itself.
"""

from __future__ import annotations

from enum import StrEnum

from daemon.errors import DaemonError


class State(StrEnum):
    """Where an investigation stands. choosing: the next motion. checking: its preflight. asking: the operator."""

    DIAGNOSING = "diagnosing"
    CHOOSING = "choosing"
    CHECKING = "checking"
    ASKING = "asking"
    RECORDING = "recording"
    SETTLED = "settled"
    NEEDS_ACTION = "needs_action"
    UNDECIDED = "undecided"
    OUT_OF_BUDGET = "out_of_budget"
    BLOCKED = "blocked"
    DECLINED = "declined"
    PLANNED = "planned"
    INTERRUPTED = "interrupted"
    DROPPED = "dropped"


class Event(StrEnum):
    """What can happen to it."""

    NOTHING_OPEN = "nothing_open"
    OPEN = "open"
    CHOSEN = "chosen"
    NO_TIME = "no_time"
    NOTHING_TELLS = "nothing_tells"
    NO_MOTION_TELLS = "no_motion_tells"
    KNOWN = "known"
    SAFE = "safe"
    UNSAFE = "unsafe"
    AGREED = "agreed"
    REFUSED = "refused"
    ONLY_PLANNED = "only_planned"
    RECORDED = "recorded"
    STOPPED = "stopped"
    DROPPED = "dropped"
    RESUMED = "resumed"
    RELEASED = "released"
    ACTED = "acted"


_S, _E = State, Event
TABLE: dict[tuple[State, Event], State] = {
    (_S.DIAGNOSING, _E.NOTHING_OPEN): _S.SETTLED,
    (_S.DIAGNOSING, _E.OPEN): _S.CHOOSING,
    (_S.DIAGNOSING, _E.NO_MOTION_TELLS): _S.NEEDS_ACTION,
    (_S.CHOOSING, _E.CHOSEN): _S.CHECKING,
    (_S.CHOOSING, _E.NO_TIME): _S.OUT_OF_BUDGET,
    (_S.CHOOSING, _E.NOTHING_TELLS): _S.UNDECIDED,
    (_S.CHOOSING, _E.NO_MOTION_TELLS): _S.NEEDS_ACTION,
    (_S.CHOOSING, _E.KNOWN): _S.SETTLED,
    (_S.CHECKING, _E.SAFE): _S.ASKING,
    (_S.CHECKING, _E.UNSAFE): _S.BLOCKED,
    (_S.ASKING, _E.AGREED): _S.RECORDING,
    (_S.ASKING, _E.REFUSED): _S.DECLINED,
    (_S.ASKING, _E.ONLY_PLANNED): _S.PLANNED,
    (_S.ASKING, _E.NO_TIME): _S.CHOOSING,
    (_S.RECORDING, _E.RECORDED): _S.DIAGNOSING,
    (_S.RECORDING, _E.STOPPED): _S.INTERRUPTED,
    (_S.RECORDING, _E.DROPPED): _S.DROPPED,
    (_S.RECORDING, _E.UNSAFE): _S.BLOCKED,
    # What follows needs a person: the command given anew, and after a drop one that says so.
    (_S.INTERRUPTED, _E.RESUMED): _S.ASKING,
    (_S.DECLINED, _E.RESUMED): _S.ASKING,
    (_S.PLANNED, _E.RESUMED): _S.ASKING,
    (_S.RECORDING, _E.RESUMED): _S.ASKING,
    (_S.ASKING, _E.RESUMED): _S.ASKING,
    (_S.DROPPED, _E.RELEASED): _S.ASKING,
    (_S.DIAGNOSING, _E.RESUMED): _S.DIAGNOSING,
    (_S.CHOOSING, _E.RESUMED): _S.CHOOSING,
    (_S.CHECKING, _E.RESUMED): _S.CHOOSING,
    (_S.BLOCKED, _E.RESUMED): _S.CHOOSING,
    (_S.OUT_OF_BUDGET, _E.RESUMED): _S.CHOOSING,
    (_S.UNDECIDED, _E.RESUMED): _S.CHOOSING,
    (_S.NEEDS_ACTION, _E.ACTED): _S.CHOOSING,
    (_S.SETTLED, _E.ACTED): _S.CHOOSING,
    (_S.SETTLED, _E.RESUMED): _S.DIAGNOSING,
}
"""What comes next. A pair that does not stand here does not happen."""

RESTING = frozenset(State) - {_S.DIAGNOSING, _S.CHOOSING, _S.CHECKING, _S.ASKING, _S.RECORDING}
"""States in which the program ends. Nothing moves until somebody calls it again."""


class TransitionError(DaemonError):
    """An event that cannot happen in a state."""

    def __init__(self, state: State, event: Event) -> None:
        super().__init__(f"The investigation is {state.value.replace('_', ' ')}, where '{event.value}' cannot happen.")


def after(state: State, event: Event) -> State:
    """The state that follows. Raises TransitionError."""
    try:
        return TABLE[state, event]
    except KeyError:
        raise TransitionError(state, event) from None
