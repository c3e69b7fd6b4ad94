"""What physics of a joint's own could look like, without a name: the rival that a fault of the data must beat.

A strong spring bends a fit much as a wrong clock does, and strong crosstalk onto a light joint outweighs that joint's
own torque. Before either is called a fault of the data, every joint is given free smooth functions of its state and of
the torques; a true fault stays visible beside them.
"""

from __future__ import annotations

import numpy as np

from identification.arrays import FloatArray

POSITION_KNOTS = 20
VELOCITY_KNOTS = 12
LEFT_OF_SWALLOWED = 1e-7
"""A column of which less than this share of the length is left is swallowed up to rounding."""


def rival_physics(
    position: FloatArray, velocity: FloatArray, torque: FloatArray, torque_rate: FloatArray
) -> tuple[FloatArray, ...]:
    """Per joint an orthonormal basis (S, m) of its free functions; all arguments (S, n).

    Of the position in each direction of motion, of the velocity, of its own torque (delay, friction under load) and of
    the torques of all other joints (crosstalk). Friction under load without its share of the torque itself: where
    friction is all that a joint carries the two are one, and the torque would be its own explanation.
    """
    bases = []
    for joint in range(position.shape[1]):
        heading = np.sign(velocity[:, joint])[:, None]
        own = torque[:, joint : joint + 1]
        by_load = beside(own / max(float(np.linalg.norm(own)), 1e-300), heading * np.abs(own))
        curves = hats(position[:, joint], POSITION_KNOTS)
        columns = np.concatenate(
            [
                curves,
                heading * curves,
                hats(velocity[:, joint], VELOCITY_KNOTS),
                by_load,
                torque_rate[:, joint : joint + 1],
                np.delete(torque, joint, axis=1),
            ],
            axis=1,
        )
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        left, size, _ = np.linalg.svd(columns, full_matrices=False)
        bases.append(left[:, size > 1e-9 * size[0]])
    return tuple(bases)


def beside(basis: FloatArray, values: FloatArray) -> FloatArray:
    """The values (S, …) off a joint's free functions; columns that these swallow are zero."""
    left = values - basis @ (basis.T @ values)
    kept = np.linalg.norm(left, axis=0) > LEFT_OF_SWALLOWED * np.linalg.norm(values, axis=0)
    return np.asarray(np.where(kept, left, 0.0), dtype=np.float64)


def hats(values: FloatArray, number: int) -> FloatArray:
    """(S, number) piecewise linear functions that sum to one; knots at quantiles, fewer where these coincide."""
    knots = np.unique(np.quantile(values, np.linspace(0.0, 1.0, number)))
    return np.stack([np.interp(values, knots, unit) for unit in np.eye(knots.size)], axis=1)
