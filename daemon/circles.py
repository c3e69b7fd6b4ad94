"""When the interpreter looks for circles of objects that nobody needs: each look goes through all that is loaded."""

from __future__ import annotations

import atexit
import gc
import sys

__all__ = ["look_for_none_at_the_end", "look_seldom"]

_OBJECTS_BEFORE_A_LOOK = 50_000


def look_seldom() -> None:
    """For a process that keeps what it makes until it ends: looks cost a fit 0.15 s and free little."""
    gc.set_threshold(_OBJECTS_BEFORE_A_LOOK)
    look_for_none_at_the_end()


def look_for_none_at_the_end() -> None:
    """What ends needs none: it is a sixth of the time that a process of a run takes to start and end."""
    atexit.register(_keep_all)


def _keep_all() -> None:
    # Ruckig's binding prints a page of what it finds not freed.
    if "ruckig" not in sys.modules:
        gc.freeze()
