"""Files of recordings, whole or spoilt, as tests of the reader write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.errors import RecordingError
from identification.recordings import read_recording

ROWS, JOINTS, STEP = 600, 7, 0.005


def whole_arrays(seed: int = 0) -> dict[str, Any]:
    time = np.arange(ROWS) * STEP
    phase = np.arange(JOINTS)
    position = np.sin(2.0 * time[:, None] + phase)
    torque = 5.0 * np.cos(3.0 * time[:, None] + phase)
    return {"t": time, "q": position, "tau": torque + np.random.default_rng(seed).normal(scale=0.05, size=torque.shape)}


def save_npz(path: Path, **arrays: Any) -> Path:
    np.savez(path, **arrays)
    return path


def save_csv(path: Path, arrays: dict[str, Any], head: str = "") -> Path:
    names = ["t"] + [f"q{j}" for j in range(1, JOINTS + 1)] + [f"tau{j}" for j in range(1, JOINTS + 1)]
    rows = np.column_stack([arrays["t"], arrays["q"], arrays["tau"]])
    lines = [",".join(repr(float(value)) for value in row) for row in rows]
    path.write_text(head + ",".join(names) + "\n" + "\n".join(lines) + "\n")
    return path


def refused(path: Path, *words: str, exit_code: int = 65) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        read_recording(path)
    assert caught.value.exit_code == exit_code
    for word in words:
        assert word in str(caught.value)
    assert str(caught.value).count(". ") <= 1, "one sentence, two at most"
    return caught.value
