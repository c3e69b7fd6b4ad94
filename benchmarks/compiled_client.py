"""The C++ client beside which the loop is measured (`client.cpp`): compiled where there is a compiler, then run."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SOURCE = Path(__file__).with_name("client.cpp")
COMPILERS = ("g++", "clang++", "c++")


def compile_client(folder: Path) -> Path | None:
    """The program, optimised as the vendor's examples are (-O2); None where there is no compiler."""
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        return None
    program = folder / "client"
    subprocess.run([compiler, "-O2", "-std=c++17", "-o", str(program), str(SOURCE)], check=True)
    return program


def serve(program: Path, descriptor: int, total: int) -> NDArray[np.int64]:
    """Answer so many messages on a bound socket with a receive time-out; the turn-around of each, ns.

    The process asks for the loop's scheduling class and inherits the processor of its caller.
    """
    command = [str(program), str(descriptor), str(total)]
    done = subprocess.run(command, pass_fds=(descriptor,), stdout=subprocess.PIPE, stderr=sys.stderr, check=True)
    return np.frombuffer(done.stdout, dtype=np.int64)
