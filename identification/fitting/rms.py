"""RMS of the difference between measured and modelled torque per joint, as in the paper's Table 4, and beside it what
share of the torque that is and what the noise alone would give.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.json_values import json_list


@dataclass(frozen=True, slots=True, eq=False)
class RmsRow:
    """One line of the table: a set of parameters on some data.

    label: which parameters on which data. rms_nm: (n,) RMS of the residual. torque_rms_nm: (n,) RMS of the torque
    itself, of the same rows and through the same filter. noise_floor_nm: (n,) RMS of the noise in the measured torque,
    nan where it is not known. A joint without usable rows has nan.
    """

    label: str
    rms_nm: FloatArray
    torque_rms_nm: FloatArray
    noise_floor_nm: FloatArray

    @property
    def total_nm(self) -> float:
        """Sum over the joints, the last line of Table 4."""
        return float(np.nansum(self.rms_nm))

    @property
    def percent(self) -> FloatArray:
        """(n,) RMS of the residual in percent of the RMS torque."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(100.0 * self.rms_nm / self.torque_rms_nm, dtype=np.float64)

    def to_json(self) -> dict[str, Any]:
        """The line as plain JSON types, null where a number is not known."""
        return {
            "label": self.label,
            "rms_nm": json_list(self.rms_nm),
            "percent_of_rms_torque": json_list(self.percent),
            "torque_rms_nm": json_list(self.torque_rms_nm),
            "noise_floor_nm": json_list(self.noise_floor_nm),
            "total_nm": self.total_nm,
        }


@dataclass(frozen=True, slots=True, eq=False)
class RmsTable:
    """Table 4 for any robot: one line per set of parameters and data, one column per joint, and the sum."""

    rows: tuple[RmsRow, ...]

    def row(self, label: str) -> RmsRow:
        """The line of that label. Raises KeyError, naming those there are."""
        for row in self.rows:
            if row.label == label:
                return row
        raise KeyError(f"there is no line '{label}'; there are {', '.join(row.label for row in self.rows)}")

    def to_json(self) -> list[dict[str, Any]]:
        """The table as plain JSON types."""
        return [row.to_json() for row in self.rows]


def rms_of_rows(values: FloatArray) -> FloatArray:
    """(n,) RMS over rows (R, n) without those that are nan; nan for a joint without any other."""
    counts = np.isfinite(values).sum(axis=0)
    return np.asarray(np.sqrt(np.nansum(values**2, axis=0) / np.where(counts > 0, counts, np.nan)), dtype=np.float64)
