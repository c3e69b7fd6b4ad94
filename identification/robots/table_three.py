"""The paper's Table 3: physical parameters of the LBR iiwa 14 as published, feasible or not."""

from __future__ import annotations

import csv
from importlib import resources

import numpy as np

from identification.physical_parameters import PhysicalParameters, symmetric


def table_three() -> PhysicalParameters:
    """Seven links in the frames of the paper's Table 1; tensors about the centres of mass, friction as in eq. (1)."""
    with (resources.files("identification.robots.data") / "iiwa14_table3.csv").open(encoding="utf-8") as file:
        rows = {name: np.array(values, dtype=np.float64) for name, *values in list(csv.reader(file))[1:]}
    tensor = symmetric(np.column_stack([rows[f"I{entry}"] for entry in ("xx", "xy", "xz", "yy", "yz", "zz")]))
    center = np.column_stack([rows[f"lC{axis}"] for axis in "xyz"])
    return PhysicalParameters(rows["m"], center, tensor, rows["Fv"], rows["Fs"])
