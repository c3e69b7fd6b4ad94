"""Where the flange is: the frame that load data are given in, seen from the link that carries it.

Known of the built-in arms, and of a URDF whose frames bear the usual names (REP 199). Pure.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pinocchio

from identification.arrays import FloatArray

IIWA_FLANGE_M = 0.126
"""From the wrist to the flange without media flange, both arms (KUKA brochure LBR iiwa)."""
_NAMES = tuple(re.compile(rf"(?:.*[_/-])?{name}") for name in ("tool0", "flange", "link_ee"))
"""tool0 first: it is the controller's tool frame without a tool, which load data are given in. A `flange` beside it is
where models of tools are fixed, with x outwards."""


@dataclass(frozen=True, slots=True, eq=False)
class Flange:
    """A frame fixed on a link (from 0): rotation (3, 3), its axes as columns, and origin (3,) m in the link's frame."""

    link: int
    rotation: FloatArray
    origin: FloatArray

    def point(self, place: FloatArray) -> FloatArray:
        """(3,) m in the flange's frame of a place in the link's."""
        return np.asarray(self.rotation.T @ (place - self.origin))

    def tensor(self, matrix: FloatArray) -> FloatArray:
        """(3, 3) in the flange's axes of a tensor in the link's."""
        return np.asarray(self.rotation.T @ matrix @ self.rotation)


IIWA_FLANGE = Flange(6, np.diag([-1.0, -1.0, 1.0]), np.array([0.0, 0.0, IIWA_FLANGE_M]))
"""Turned by π about the last link's z (see `export.kinematic_urdf`)."""


def flange_of_frames(model: pinocchio.Model) -> Flange | None:
    """The flange among a description's frames: `tool0`, else `flange`, else `link_ee`, with any prefix; else None."""
    for name in _NAMES:
        for frame in model.frames:
            if name.fullmatch(frame.name) and frame.parentJoint > 0 and frame.type == pinocchio.FrameType.BODY:
                placement = frame.placement
                return Flange(frame.parentJoint - 1, placement.rotation.copy(), placement.translation.copy())
    return None
