"""The room that ties the others together: processes, ZeroMQ, files. Nothing below imports it.

`api` typed messages · `service` the supervisor of a run · `loop_process` the process around the loop · `recorder` and
`log` the MCAP file · `worker` the detached fit · `doctor` the examination · `config` the file · `cli` the commands.
Import the modules; the package itself stays empty, so that a child process loads only what it needs.
"""

from __future__ import annotations

import os

# Matrices here are small: a second BLAS thread gains nothing, and its spinning steals the core that the 1 kHz loop
# needs. It counts only when set before numpy is loaded, hence here; a user's own setting is kept.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__all__: list[str] = []
