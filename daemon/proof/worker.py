"""The blind half of the proof: a process that is told where two recordings lie, and nothing else.

Reads one JSON object a line, {"recordings": [A], "heldout": [B]}, with "report": PATH where one is to be written too,
and answers each with {"diagnosis": …, "seconds": …} or {"error": …}. Started by ``prove`` as
``python -m daemon.proof.worker``.
"""

from __future__ import annotations

import json
import signal
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from identification.mismatch.diagnosis import diagnose
from identification.recordings.reader import read_inputs
from identification.report import write_report


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Diagnosis of one pair of recordings as JSON, with the CPU time it took."""
    start = time.process_time()
    try:
        inputs = read_inputs([*request["recordings"], *request["heldout"]])
        count, robot = len(request["recordings"]), inputs.robot
        recordings, heldout = inputs.recordings[:count], inputs.recordings[count:]
        diagnosis = diagnose(recordings, robot, heldout=heldout)
        if "report" in request:
            write_report(
                Path(request["report"]),
                diagnosis=diagnosis,
                model=diagnosis.extended_model_json(),
                recordings=recordings,
                heldout=heldout,
                robot=robot,
            )
    except Exception as error:  # one case that cannot be diagnosed is a score of its own, not the end of the proof
        return {"error": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc()}
    return {"diagnosis": diagnosis.to_json(), "seconds": time.process_time() - start}


def main() -> int:
    """Answer every line of stdin, and end without a word where nobody is left to read the answer."""
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
