"""Claims about the service's state table: every pair of state and event, and what must hold in any order of events.

Truth: the grid below, written from the operator's side (docs/security.md and docs/decisions/053), not from the table.
"""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.queue.service_states import TRANSITIONS, Action, Event, State, transition

EVENTS = ["RUN_READY", "PREPARED", "REFUSED", "COMPLETED", "FAILED", "STOP", "TERMINATE"]
FLAG, HOLD, BREAK, FIT = "SET_STOP_FLAG", "HOLD_WAITING", "BREAK_OFF_PREPARATION", "QUEUE_FIT"
ASIDE = "HOLD_PREPARED"
# One row per state; each cell: next state and actions, "." where nothing changes and nothing is done.
GRID = {
    "IDLE": ("PREPARING PREPARE_NEXT", f"IDLE {ASIDE}", ".", ".", ".", f"IDLE {HOLD}", "CLOSED"),
    "PREPARING": (".", "RUNNING START_RUN", "IDLE", ".", ".", f"STOPPING {BREAK} {HOLD}", f"CLOSING {BREAK}"),
    "RUNNING": (
        *(".", f"RUNNING {ASIDE}", ".", f"IDLE {FIT}"),
        *(f"IDLE {HOLD}", f"STOPPING {FLAG} {HOLD}", f"CLOSING {FLAG}"),
    ),
    "STOPPING": (
        *(".", f"IDLE {ASIDE}", "IDLE", f"IDLE {FIT}"),
        *("IDLE", f"STOPPING {FLAG} {HOLD}", f"CLOSING {FLAG}"),
    ),
    "CLOSING": (
        *(".", f"CLOSED {ASIDE}", "CLOSED", f"CLOSED {FIT}"),
        *("CLOSED", f"CLOSING {FLAG} {HOLD}", f"CLOSING {FLAG}"),
    ),
    "CLOSED": (".", f"CLOSED {ASIDE}", ".", ".", ".", ".", "."),
}
CELLS = [(state, event, cell) for state, row in GRID.items() for event, cell in zip(EVENTS, row, strict=True)]
sequences = st.lists(st.sampled_from(Event), max_size=40)


@pytest.mark.parametrize(("state", "event", "cell"), CELLS)
def test_each_event_in_each_state_does_what_the_grid_says(state: str, event: str, cell: str) -> None:
    after, *actions = (state if cell == "." else cell).split()
    assert transition(State[state], Event[event]) == (State[after], tuple(Action[name] for name in actions))


def test_grid_and_table_name_every_pair() -> None:
    assert {(State[state], Event[event]) for state, event, _ in CELLS} == set(TRANSITIONS)
    assert len(TRANSITIONS) == len(State) * len(Event)


@given(sequences)
def test_an_arm_that_may_move_is_always_reached_by_a_stop(events: list[Event]) -> None:
    state, moving, preparing = State.IDLE, False, False
    for event in events:
        # Nothing ends that was not begun, and a preparation answers once.
        if (event in (Event.COMPLETED, Event.FAILED) and not moving) or (
            event in (Event.PREPARED, Event.REFUSED) and not preparing
        ):
            continue
        state, actions = transition(state, event)
        preparing = (preparing or Action.PREPARE_NEXT in actions) and event not in (Event.PREPARED, Event.REFUSED)
        moving = (moving or Action.START_RUN in actions) and event not in (Event.COMPLETED, Event.FAILED)
        for request in (Event.STOP, Event.TERMINATE):
            assert (Action.SET_STOP_FLAG in transition(state, request)[1]) >= moving


@given(sequences)
def test_after_a_stop_no_motion_begins_before_a_run_was_made_ready_anew(events: list[Event]) -> None:
    state, stopped = State.IDLE, False
    for event in events:
        state, actions = transition(state, event)
        stopped = event is Event.STOP or (stopped and Action.PREPARE_NEXT not in actions)
        assert not (stopped and Action.START_RUN in actions)


@given(sequences)
def test_a_service_told_to_end_begins_nothing(events: list[Event]) -> None:
    state, told = State.IDLE, False
    for event in events:
        state, actions = transition(state, event)
        told = told or event is Event.TERMINATE
        if told:
            assert state in (State.CLOSING, State.CLOSED)
            assert not {Action.START_RUN, Action.PREPARE_NEXT} & set(actions)
