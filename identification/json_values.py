"""Arrays and nested values as JSON has them: a number that is not finite becomes null."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import numpy.typing as npt


def number(value: float) -> float | None:
    """A float for JSON: None where it is not finite."""
    return float(value) if math.isfinite(value) else None


def json_list(values: npt.ArrayLike) -> list[Any]:
    """An array as nested lists, None where a number is not finite."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim > 1:
        return [json_list(row) for row in array]
    return [number(float(value)) for value in array]


def plain(value: Any) -> Any:
    """Plain JSON types of nested mappings, value objects, sequences, arrays and numpy numbers."""
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: plain(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return number(float(value))
    return value
