"""The physical parameters μ of eq. (2) and the maps between them and the dynamic parameters π, eq. (4).

Here: the value object and exact closed forms, both ways. Not here: estimating them (`semidefinite`, `constrained`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from identification.arrays import FloatArray

INERTIAL_COUNT = 10

_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass(frozen=True, slots=True, eq=False)
class PhysicalParameters:
    """Physical parameters of the n links of a robot, eq. (2).

    mass: (n,) kg. center_of_mass: (n, 3) m in the link frame. inertia: (n, 3, 3) kg m², the tensor about the centre of
    mass with the axes of the link frame (entries of the tensor: I_xy = −∫ x y dm). viscous: (n,) Nm s/rad.
    coulomb: (n,) Nm. Raises ValueError when the shapes do not fit together or an inertia is not symmetric.
    """

    mass: FloatArray
    center_of_mass: FloatArray
    inertia: FloatArray
    viscous: FloatArray
    coulomb: FloatArray

    def __post_init__(self) -> None:
        n = len(self.mass)
        shapes = {
            "mass": (n,), "center_of_mass": (n, 3), "inertia": (n, 3, 3), "viscous": (n,), "coulomb": (n,),
        }  # fmt: skip
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}; {n} links need {shape}")
        if not np.array_equal(self.inertia, self.inertia.transpose(0, 2, 1)):
            raise ValueError("an inertia tensor is not symmetric")

    @property
    def n(self) -> int:
        """Number of links."""
        return len(self.mass)

    def to_json(self) -> list[dict[str, Any]]:
        """Mass, centre and tensor of each link (from 1) as plain JSON types, as `physical_parameters` of model.json."""
        rows = zip(self.mass.tolist(), self.center_of_mass.tolist(), self.inertia.tolist(), strict=True)
        return [
            {"link": link, "mass": mass, "com": center, "inertia": tensor}
            for link, (mass, center, tensor) in enumerate(rows, start=1)
        ]

    def dynamic_parameters(self) -> FloatArray:
        """Inertial part of π, eq. (4): (n, 10) M, MX, MY, MZ, XX, XY, XZ, YY, YZ, ZZ about the frame's origin."""
        c = self.center_of_mass
        square = np.einsum("ni,ni->n", c, c)[:, None, None] * np.eye(3) - c[:, :, None] * c[:, None, :]
        about_origin = self.inertia + self.mass[:, None, None] * square
        return np.column_stack(
            [self.mass, self.mass[:, None] * c, *(about_origin[:, row, column] for row, column in _UPPER)]
        )

    @classmethod
    def from_dynamic_parameters(
        cls, inertial: FloatArray, viscous: FloatArray | None = None, coulomb: FloatArray | None = None
    ) -> PhysicalParameters:
        """Inverse of eq. (4) for masses that are not zero. inertial: (n, 10). Friction defaults to zero."""
        n = len(inertial)
        mass = inertial[:, 0].copy()
        c = inertial[:, 1:4] / mass[:, None]
        about_origin = symmetric(inertial[:, 4:])
        square = np.einsum("ni,ni->n", c, c)[:, None, None] * np.eye(3) - c[:, :, None] * c[:, None, :]
        return cls(
            mass=mass,
            center_of_mass=c,
            inertia=about_origin - mass[:, None, None] * square,
            viscous=np.zeros(n) if viscous is None else np.array(viscous, dtype=np.float64),
            coulomb=np.zeros(n) if coulomb is None else np.array(coulomb, dtype=np.float64),
        )

    def pseudo_inertia(self) -> FloatArray:
        """(n, 4, 4) pseudo-inertias [[Σ, h], [hᵀ, m]]; a link exists physically if its matrix is positive definite."""
        return pseudo_inertia(self.dynamic_parameters())


def symmetric(entries: FloatArray) -> FloatArray:
    """(..., 6) entries XX, XY, XZ, YY, YZ, ZZ as symmetric (..., 3, 3) matrices."""
    matrix = np.empty((*entries.shape[:-1], 3, 3))
    for place, (row, column) in enumerate(_UPPER):
        matrix[..., row, column] = matrix[..., column, row] = entries[..., place]
    return matrix


def pseudo_inertia(inertial: FloatArray) -> FloatArray:
    """(n, 10) inertial parameters of eq. (3) → (n, 4, 4) [[½ tr(I) 1 − I, h], [hᵀ, m]], I about the frame's origin.

    Source: Wensing, Kim, Slotine, "Linear matrix inequalities for physically consistent inertial parameter
    identification", IEEE RA-L 2018.
    """
    tensor = symmetric(inertial[:, 4:])
    result = np.empty((len(inertial), 4, 4))
    trace = np.trace(tensor, axis1=1, axis2=2)[:, None, None]
    result[:, :3, :3] = 0.5 * trace * np.eye(3) - tensor
    result[:, :3, 3] = result[:, 3, :3] = inertial[:, 1:4]
    result[:, 3, 3] = inertial[:, 0]
    return result


def tensor_jacobians(m: FloatArray, h: FloatArray) -> FloatArray:
    """(n, 6, 4) derivatives of XX, XY, XZ, YY, YZ, ZZ of (hᵀh 1 − h hᵀ)/m by m, h_x, h_y, h_z; m (n,), h (n, 3)."""
    x, y, z = h.T
    zero = np.zeros_like(x)
    by_h = np.array(
        [
            [zero, 2 * y, 2 * z],
            [-y, -x, zero],
            [-z, zero, -x],
            [2 * x, zero, 2 * z],
            [zero, -z, -y],
            [2 * x, 2 * y, zero],
        ]
    )
    values = np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])
    return np.concatenate([-(values / m**2)[:, None], by_h / m], axis=1).transpose(2, 0, 1).copy()


def tensor_curvatures(m: FloatArray, h: FloatArray, slopes: FloatArray) -> FloatArray:
    """(n, 4, 4) second derivatives by m, h of the six entries of (hᵀh 1 − h hᵀ)/m, summed with weights slopes (n, 6).

    The sum is hᵀ V h / m with the symmetric V assembled here from the weights.
    """
    tensors = -0.5 * symmetric(slopes)
    xx, yy, zz = slopes[:, 0], slopes[:, 3], slopes[:, 5]
    for axis, entry in enumerate((yy + zz, xx + zz, xx + yy)):
        tensors[:, axis, axis] = entry
    turned = np.einsum("lij,lj->li", tensors, h)
    result = np.empty((len(m), 4, 4))
    result[:, 0, 0] = 2.0 * np.einsum("li,li->l", h, turned) / m**3
    result[:, 0, 1:] = result[:, 1:, 0] = -2.0 * turned / m[:, None] ** 2
    result[:, 1:, 1:] = 2.0 * tensors / m[:, None, None]
    return result
