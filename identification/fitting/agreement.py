"""Do recordings that are fitted together show one arm? Asked where several are: one with a tool and one without give
parameters of an arm that is neither. Where no motion repeats there is no noise that would tell.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.arrays import FloatArray
from identification.estimators.observation import RANK_TOLERANCE
from identification.fitting.blocks import Block
from identification.recordings.recording import Recording

APART = 5.0
"""Times the RMS that a recording's own parameters leave: two runs of one arm reach 2.6 where joints stand still in one
of them, friction that changed by a twentieth 3.6, a tool that only one of them carries 70.
"""
LEAST_SHARE = 0.01
"""Of a joint's RMS torque that the common parameters leave; less spoils nothing."""
ROWS_PER_PARAMETER = 10.0
"""Of a recording, fewer of which its own parameters would follow to their noise."""


def notes_on_agreement(blocks: Sequence[Block], values: FloatArray, names: Sequence[str]) -> tuple[str, ...]:
    """A warning where common base parameters (p,) leave much more of a recording than its own would.

    Every such recording is named: which of two is the other one, these numbers do not tell. names: of the recordings,
    in the order of `Block.recording`.
    """
    each = [[block for block in blocks if block.recording == number] for number in range(len(names))]
    if sum(any(block.fitted.any() for block in own) for own in each) < 2:
        return ()
    times = np.array([_times_its_own(own, values) for own in each])
    joint = int(np.argmax(times.max(axis=0)))
    if times[:, joint].max() < APART:
        return ()
    apart: list[int] = np.flatnonzero(times[:, joint] >= APART).tolist()
    more = ", ".join(f"{times[number, joint]:.3g} times on {names[number]}" for number in apart)
    joints = ", ".join(str(place + 1) for place in np.flatnonzero((times >= APART).any(axis=0)))
    return (
        f"WARNING, the recordings do not go together: of joint {joint + 1} the common parameters leave more RMS than a "
        f"recording's own would, {more} (all such joints: {joints}). Another load, stand, day or arm? "
        "`iiwa-ident compare` says which",
    )


def notes_on_arms(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A warning where logs state the serial numbers of different arms."""
    arms = serial_numbers(recordings)
    if len(arms) < 2:
        return ()
    said = f"WARNING, the recordings are of {len(arms)} arms (serial numbers {', '.join(arms)})"
    return (f"{said}: what is fitted to them together is the arm of none. Fit them one by one",)


def serial_numbers(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Each once, in their order, of the recordings that state one."""
    return tuple(dict.fromkeys(filter(None, (item.source.metadata.get("serial") for item in recordings))))


def _times_its_own(blocks: Sequence[Block], values: FloatArray) -> FloatArray:
    """(n,) RMS that common parameters leave of a recording over what its own leave; 0 where the first is small."""
    joints, size = blocks[0].torque.shape[1] if blocks else 1, len(values)
    rows = sum(int(block.fitted.sum()) for block in blocks)
    if rows < ROWS_PER_PARAMETER * size:
        return np.zeros(joints)
    common = _left(blocks, values)
    torque = _left(blocks, np.zeros(size))
    weight = 1.0 / np.maximum(np.sqrt(common), 1e-9 * np.sqrt(torque).max() + 1e-300)
    gram, right = np.zeros((size, size)), np.zeros(size)
    for block in blocks:
        columns = (block.columns * np.where(block.fitted, weight, 0.0)[..., None]).reshape(-1, size)
        gram += columns.T @ columns
        right += columns.T @ (block.torque * weight).ravel()
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    own = np.linalg.lstsq(gram / np.outer(scale, scale), right / scale, rcond=RANK_TOLERANCE)[0] / scale
    ratio = np.sqrt(common / np.maximum(_left(blocks, own), 1e-300))
    return np.where(common > LEAST_SHARE**2 * torque, ratio, 0.0)


def _left(blocks: Sequence[Block], values: FloatArray) -> FloatArray:
    """(n,) sum of the squares that parameters (p,) leave of each joint on the fitted rows."""
    squares = [(np.where(item.fitted, item.torque - item.columns @ values, 0.0) ** 2).sum(axis=0) for item in blocks]
    return np.asarray(np.sum(squares, axis=0))
