"""A sealed label: its hash is published before anybody looks at the case, its text and salt only afterwards."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from daemon.errors import SealBrokenError


def opened(name: str, commitment: str, seal: dict[str, str]) -> dict[str, Any]:
    """The label of a case. Raises SealBrokenError where it is not the one whose hash was published."""
    if hashlib.sha256((seal["salt"] + seal["label"]).encode()).hexdigest() != commitment:
        raise SealBrokenError(name)
    label: dict[str, Any] = json.loads(seal["label"])
    return label
