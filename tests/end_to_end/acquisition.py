"""`python -m tests.end_to_end.acquisition REQUEST`: `iiwa-ident run` behind its preflight.

A process of its own, so that it can be killed, paused and interrupted like the real one. Prints what an operator
reads.
"""

from __future__ import annotations

import sys

from daemon.api import RunEvent, RunRequest
from daemon.circles import look_for_none_at_the_end
from daemon.errors import DaemonError
from daemon.json_files import read_json
from daemon.run.service import run_acquisition


def main() -> int:
    def show(event: RunEvent) -> None:
        print(f"[{event.kind}] {event.sentence}", flush=True)

    try:
        outcome = run_acquisition(read_json(sys.argv[1], RunRequest), observe=show)
    except DaemonError as error:
        print(error)
        return error.exit_code
    print(*outcome.sentences, sep="\n", flush=True)
    return outcome.exit_code


if __name__ == "__main__":
    look_for_none_at_the_end()  # as the command line does
    sys.exit(main())
