"""What the long-running service does with the motion, as one table: (state, event) -> (state, actions).

Pure: no clock, no socket, no thread; `server` feeds it events and carries the actions out. Every pair stands in the
table, also those that cannot happen, because an event that comes late must never start a motion.

    IDLE       nothing moves, nothing is about to
    PREPARING  the next run's motion is checked once more
    RUNNING    an acquisition is under way
    STOPPING   a stop was asked for; its end is waited for
    CLOSING    the service ends; the end of the ramp is waited for
    CLOSED     nothing is left to wait for

Two rules for the operator stand in it. Whatever was waiting when a motion did not end as planned is put on hold: no
queued motion follows a stop by itself. And a stop needs no particular state: it is obeyed or there was nothing to stop.
"""

from __future__ import annotations

from enum import Enum, auto


class State(Enum):
    """What the service is doing with the arm."""

    IDLE = "idle"
    PREPARING = "preparing"
    RUNNING = "running"
    STOPPING = "stopping"
    CLOSING = "closing"
    CLOSED = "closed"


class Event(Enum):
    """What may happen to it."""

    RUN_READY = auto()  # a checked run waits in the queue
    PREPARED = auto()  # the next run's motion was found safe once more
    REFUSED = auto()  # it was not, or its check was broken off; nothing moved
    COMPLETED = auto()  # the acquisition ended as planned
    FAILED = auto()  # it ended otherwise: stopped, dropped, no robot, fault
    STOP = auto()  # an operator asks for a stop
    TERMINATE = auto()  # SIGTERM or SIGINT to the service


class Action(Enum):
    """What is to be done, in the order given."""

    PREPARE_NEXT = auto()
    START_RUN = auto()
    HOLD_PREPARED = auto()  # the prepared run is not started; it waits for the operator's word
    BREAK_OFF_PREPARATION = auto()
    SET_STOP_FLAG = auto()  # the word in the ring; harmless when it stands there already
    HOLD_WAITING = auto()  # every waiting run waits for the operator's word
    QUEUE_FIT = auto()


Step = tuple[State, tuple[Action, ...]]

_S, _E, _A = State, Event, Action

TRANSITIONS: dict[tuple[State, Event], Step] = {
    (_S.IDLE, _E.RUN_READY): (_S.PREPARING, (_A.PREPARE_NEXT,)),
    (_S.IDLE, _E.PREPARED): (_S.IDLE, (_A.HOLD_PREPARED,)),
    (_S.IDLE, _E.REFUSED): (_S.IDLE, ()),
    (_S.IDLE, _E.COMPLETED): (_S.IDLE, ()),
    (_S.IDLE, _E.FAILED): (_S.IDLE, ()),
    (_S.IDLE, _E.STOP): (_S.IDLE, (_A.HOLD_WAITING,)),
    (_S.IDLE, _E.TERMINATE): (_S.CLOSED, ()),
    (_S.PREPARING, _E.RUN_READY): (_S.PREPARING, ()),
    (_S.PREPARING, _E.PREPARED): (_S.RUNNING, (_A.START_RUN,)),
    (_S.PREPARING, _E.REFUSED): (_S.IDLE, ()),
    (_S.PREPARING, _E.COMPLETED): (_S.PREPARING, ()),
    (_S.PREPARING, _E.FAILED): (_S.PREPARING, ()),
    (_S.PREPARING, _E.STOP): (_S.STOPPING, (_A.BREAK_OFF_PREPARATION, _A.HOLD_WAITING)),
    (_S.PREPARING, _E.TERMINATE): (_S.CLOSING, (_A.BREAK_OFF_PREPARATION,)),
    (_S.RUNNING, _E.RUN_READY): (_S.RUNNING, ()),
    (_S.RUNNING, _E.PREPARED): (_S.RUNNING, (_A.HOLD_PREPARED,)),
    (_S.RUNNING, _E.REFUSED): (_S.RUNNING, ()),
    (_S.RUNNING, _E.COMPLETED): (_S.IDLE, (_A.QUEUE_FIT,)),
    (_S.RUNNING, _E.FAILED): (_S.IDLE, (_A.HOLD_WAITING,)),
    (_S.RUNNING, _E.STOP): (_S.STOPPING, (_A.SET_STOP_FLAG, _A.HOLD_WAITING)),
    (_S.RUNNING, _E.TERMINATE): (_S.CLOSING, (_A.SET_STOP_FLAG,)),
    (_S.STOPPING, _E.RUN_READY): (_S.STOPPING, ()),
    (_S.STOPPING, _E.PREPARED): (_S.IDLE, (_A.HOLD_PREPARED,)),
    (_S.STOPPING, _E.REFUSED): (_S.IDLE, ()),
    (_S.STOPPING, _E.COMPLETED): (_S.IDLE, (_A.QUEUE_FIT,)),
    (_S.STOPPING, _E.FAILED): (_S.IDLE, ()),
    (_S.STOPPING, _E.STOP): (_S.STOPPING, (_A.SET_STOP_FLAG, _A.HOLD_WAITING)),
    (_S.STOPPING, _E.TERMINATE): (_S.CLOSING, (_A.SET_STOP_FLAG,)),
    (_S.CLOSING, _E.RUN_READY): (_S.CLOSING, ()),
    (_S.CLOSING, _E.PREPARED): (_S.CLOSED, (_A.HOLD_PREPARED,)),
    (_S.CLOSING, _E.REFUSED): (_S.CLOSED, ()),
    (_S.CLOSING, _E.COMPLETED): (_S.CLOSED, (_A.QUEUE_FIT,)),
    (_S.CLOSING, _E.FAILED): (_S.CLOSED, ()),
    (_S.CLOSING, _E.STOP): (_S.CLOSING, (_A.SET_STOP_FLAG, _A.HOLD_WAITING)),
    (_S.CLOSING, _E.TERMINATE): (_S.CLOSING, (_A.SET_STOP_FLAG,)),
    **{(_S.CLOSED, event): (_S.CLOSED, ()) for event in Event if event is not _E.PREPARED},
    (_S.CLOSED, _E.PREPARED): (_S.CLOSED, (_A.HOLD_PREPARED,)),
}


def transition(state: State, event: Event) -> Step:
    """The next state and what to do on the way."""
    return TRANSITIONS[state, event]
