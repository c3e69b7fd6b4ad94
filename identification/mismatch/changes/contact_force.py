"""Where a push acts, once its window is roughly known: the window with free torques first, then the link.

Shared by pushes in single periods (`contact_search`) and pushes that come with every period (`repeated_contact`): the
two differ only in the rows that they are compared on, a `Ground`. What is claimed is not decided here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import Bounds, minimize
from scipy.special import chdtri

from identification.arrays import FloatArray
from identification.mismatch.changes.candidates import REFINED, dispersion_of
from identification.mismatch.changes.contrasts import solve
from identification.mismatch.changes.push_fit import (
    POINT,
    SHORTEST_S,
    Ground,
    Push,
    course_of,
    fit_push,
    longest_s,
    size_of_force,
    unit_torque,
)
from identification.mismatch.effects.external_contact import BENDS, ExternalContact, profile, reach_of
from identification.mismatch.settings import ALTERNATIVE

PROFILE_STARTS = ((1.0, 1.0), (0.2, 1.0), (0.4, 0.4))
"""Sharpness and skew from which the profile is looked for."""
UNSEEN = 2.7e-3
"""Chance of the torque on a joint, or of what a larger link explains, up to which it is no reason for that link."""
FADING = 1.8
"""How much longer a push that fades slowly may be than the plain profile that describes its body."""
LACK_KNOTS = 9
POINT_STEP_M = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class _OnLink:
    """A push on one link in a given window. value: gain, less what its point costs. force: (3,) N.

    information: of the point (m⁻²) in every direction that is free, over what is known before.
    """

    value: float
    point: dict[str, float]
    force: FloatArray
    information: FloatArray

    def evidence(self, noise: float) -> float:
        """Logarithm of how well it predicts the data before its point is known (Laplace)."""
        return 0.5 * self.value / noise - 0.5 * float(np.log1p(np.maximum(self.information, 0.0) / noise).sum())


def locate_push(
    ground: Ground, effect: ExternalContact, window: Mapping[str, float], dispersion: float = 1.0, least: float = 0.0
) -> Push | None:
    """The push in a window that explains most, on the smallest link that the data are consistent with.

    least: drop of the whitened squares that is asked; None where no link comes near it before window and profile are
    fitted too (REFINED). dispersion: how much noisier the rows are than the noise that whitened them. A larger link
    must explain more than chance, in units of what the freest push leaves of any smooth torque in the window: a profile
    that is not quite the true one leaves something, which a freer link would take up. Larger links that explain as much
    stay open: `largest_link` of the shape, and the spread of the force over them is part of its covariance. A push
    whose line meets the last joint's axis, where the data would have shown a miss, is one on the last link or its tool.
    """
    # Free torques know nothing of how the arm moves on during the push; a window for the freest force does.
    found, _ = _by_link(ground, effect, window)
    freest = max(found, key=lambda link: found[link].value)
    if REFINED * found[freest].value < least:
        return None
    push, left = _bent_if_needed(ground, freest, {**window, **found[freest].point}, dispersion)
    found, on_axis = _by_link(ground, effect, push.shape)
    noise = max(left, dispersion)
    # Torque on a joint beyond a link cannot come from it, whatever the profile.
    least = noise * float(chdtri(1, UNSEEN))
    found = {link: item for link, item in found.items() if _beyond(ground, link, push.shape, item) < least}

    def explains_more(other: int, link: int) -> bool:
        return other > link and found[other].value - found[link].value > noise * float(chdtri(other - link, UNSEEN))

    chosen = next(link for link in sorted(found) if not any(explains_more(other, link) for other in found))
    last = max(found)
    # One that might be on a smaller link is taken for one on the last joint's axis where the odds are clear.
    if chosen < last and on_axis.evidence(noise) > found[chosen].evidence(noise) + ALTERNATIVE:
        chosen, found = last, {last: on_axis}
    push, left = _bent_if_needed(ground, chosen, {**push.shape, **found[chosen].point}, dispersion)
    best = max(item.value for item in found.values())
    others = [link for link in found if link > chosen and best - found[link].value < noise * float(chdtri(1, UNSEEN))]
    weights = np.exp([(found[link].value - best) / (2.0 * noise) for link in (chosen, *others)])
    weights /= weights.sum()
    covariance = max(left, dispersion) * push.covariance + sum(
        weight * np.outer(found[link].force - found[chosen].force, found[link].force - found[chosen].force)
        for weight, link in zip(weights[1:], others, strict=True)
    )
    known = {**push.shape, "largest_link": float(max(others))} if others else push.shape
    return replace(push, shape=known, covariance=covariance)


def _bent_if_needed(ground: Ground, link: int, shape: Mapping[str, float], dispersion: float) -> tuple[Push, float]:
    """The push at its best, with a profile that is bent where a plain one lacks fit; and what lack is left."""
    push = fit_push(ground, link, shape)
    left = _lack_of_fit(ground, link, push.shape)
    if left > dispersion and "bend_0" not in shape:
        fits = [fit_push(ground, link, {**push.shape, **bent}) for bent in _bent_profiles(push.shape)]
        push = max(fits, key=lambda fit: fit.gain)
        left = _lack_of_fit(ground, link, push.shape)
    return push, left


def _bent_profiles(shape: Mapping[str, float]) -> list[dict[str, float]]:
    """Where to bend a profile from: as it is, and in a longer window, into which it may fade."""
    plain = {f"bend_{number}": 0.0 for number in range(len(BENDS))}
    longer = {"start_s": shape["start_s"], "duration_s": FADING * shape["duration_s"], "sharpness": 0.3, "skew": 1.0}
    time = longer["start_s"] + longer["duration_s"] * np.clip(BENDS, 0.01, 0.99)
    ratio = np.maximum(profile(time, shape["start_s"], shape), 0.02) / profile(time, longer["start_s"], longer)
    return [plain, {**longer, **{f"bend_{number}": float(value) for number, value in enumerate(np.log(ratio))}}]


def window_gain(ground: Ground, shape: Mapping[str, float]) -> float:
    """What free torques on all joints gain in a window."""
    gram, right = ground.free(course_of(ground, shape))
    return float(right @ solve(gram, right)[0])


def refine_window(ground: Ground, start: float, duration: float) -> dict[str, float]:
    """Window and profile with free torques on every joint: only the profile has to be projected."""
    found = []
    for sharpness, skew in PROFILE_STARTS:
        shape = {"start_s": start, "duration_s": duration, "sharpness": sharpness, "skew": skew}
        found.append(_simplex(lambda trial: window_gain(ground, trial), shape, longest_s(ground)))
    return max(found, key=lambda item: item[0])[1]


def seen_on(ground: Ground, shape: Mapping[str, float]) -> FloatArray:
    """(n,) χ² (one degree of freedom) of the torque on each joint in a window, beside those on the others."""
    gram, right = ground.free(course_of(ground, shape))
    torque, inverse, _ = solve(gram, right)
    return np.asarray(torque**2 / np.maximum(np.diag(inverse), 1e-300), dtype=np.float64)


def _simplex(
    gain_of: Callable[[Mapping[str, float]], float], shape: dict[str, float], longest_s: float
) -> tuple[float, dict[str, float]]:
    """Simplex search over window centre, and the logarithms of duration, sharpness and skew; gain and shape."""
    middle = shape["start_s"] + 0.5 * shape["duration_s"]
    stretch = np.log(np.array([SHORTEST_S, longest_s]) / shape["duration_s"])

    def unpack(x: FloatArray) -> dict[str, float]:
        duration = shape["duration_s"] * float(np.exp(np.clip(x[1], *stretch)))
        return {
            "start_s": middle + float(x[0]) * shape["duration_s"] - 0.5 * duration,
            "duration_s": duration,
            "sharpness": float(np.clip(shape["sharpness"] * np.exp(3.0 * x[2]), 0.05, 4.0)),
            "skew": float(np.clip(shape["skew"] * np.exp(x[3]), 0.3, 3.0)),
        }

    options: Any = {
        "maxfev": 100,
        "initial_simplex": np.vstack([np.zeros(4), 0.15 * np.eye(4)]),
        "xatol": 1e-3,
        "fatol": 1e-2,
    }
    result = minimize(  # type: ignore[call-overload]  # the stubs lose the array type of the lambda
        lambda x: -gain_of(unpack(x)), np.zeros(4), method="Nelder-Mead", options=options
    )
    return -float(result.fun), unpack(result.x)


def _by_link(
    ground: Ground, effect: ExternalContact, window: Mapping[str, float]
) -> tuple[dict[int, _OnLink], _OnLink]:
    """The best push on every link, and the best one on the last joint's axis."""
    motion = ground.motion
    links = [place.link for place in effect.places(motion) if place.link is not None]
    found = {link: _best_point(ground, link, window, np.eye(3)) for link in links}
    return found, _best_point(ground, links[-1], window, motion.robot.kinematics.axis[links[-1] - 1][None])


def _beyond(ground: Ground, link: int, window: Mapping[str, float], push: _OnLink) -> float:
    """Largest χ² (one degree of freedom) of a torque of its own on a joint that a link does not reach, beside its push.

    Force and point are free once more: in a mean, base parameters carry what they lack to other joints.
    """
    n = ground.motion.n
    upstream = list(ground.motion.robot.kinematics.upstream(link - 1))
    others = [joint for joint in range(n) if joint not in upstream]
    if not others:
        return 0.0
    factors = course_of(ground, window)
    unit = unit_torque(ground, link, factors)
    arm = np.array([1.0, *(push.point[name] for name in POINT)])
    values = np.zeros((*factors.shape, n, 6 + len(others)))
    values[:, :, upstream, :3] = factors[..., None, None] * (unit @ arm)
    values[:, :, upstream, 3:6] = factors[..., None, None] * np.einsum("sjda,d->sja", unit[..., 1:], push.force)
    for place, joint in enumerate(others):
        values[:, :, joint, 6 + place] = factors
    rows, target = ground.rows(values, range(n)), ground.target(range(n))
    gram, right = rows.T @ rows, rows.T @ target
    inverse = solve(gram[:6, :6], right[:6])[1]
    shadow = gram[6:, :6] @ inverse
    left = np.diag(gram[6:, 6:] - shadow @ gram[:6, 6:])
    return float(((right[6:] - shadow @ right[:6]) ** 2 / np.maximum(left, 1e-300)).max())


def _best_point(ground: Ground, link: int, window: Mapping[str, float], free: FloatArray) -> _OnLink:
    """A force on a link at its best point within the link's reach, less what an unlikely point costs.

    free: (d, 3) directions from the joint's origin, of length one, in which the point may be. The torque is bilinear in
    force and point; with the twelve products' normal equations made once, each point is a problem of d parameters.
    """
    motion = ground.motion
    upstream = motion.robot.kinematics.upstream(link - 1)
    factors = course_of(ground, window)
    unit = unit_torque(ground, link, factors)
    rows = ground.rows(factors[..., None, None] * unit.reshape(*unit.shape[:2], 12), upstream)
    gram, right = rows.T @ rows, rows.T @ ground.target(upstream)
    lower, upper = (free @ bound for bound in reach_of(motion, link))
    lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)
    centre, known = 0.5 * (lower + upper), 12.0 / (upper - lower) ** 2

    def normal_equations(reach: FloatArray) -> tuple[FloatArray, FloatArray]:
        expand = np.kron(np.eye(3), np.concatenate([[1.0], reach @ free])[:, None])
        return expand.T @ gram @ expand, expand.T @ right

    usual = size_of_force(*normal_equations(centre))

    def at(reach: FloatArray) -> tuple[float, FloatArray]:
        own, projected = normal_equations(reach)
        force = np.asarray(np.linalg.solve(own + np.eye(3) / usual**2, projected), dtype=np.float64)
        return float(projected @ force) - float((known * (reach - centre) ** 2).sum()), force

    best = minimize(  # type: ignore[call-overload]
        lambda reach: -at(reach)[0], centre, method="L-BFGS-B", bounds=Bounds(lower, upper)
    )
    reach = np.asarray(best.x, dtype=np.float64)
    value, force = at(reach)
    steps = POINT_STEP_M * np.eye(len(free))
    curvature = np.array(
        [
            [at(reach + a + b)[0] - at(reach + a - b)[0] - at(reach - a + b)[0] + at(reach - a - b)[0] for b in steps]
            for a in steps
        ]
    ) / (4.0 * POINT_STEP_M**2)
    scale = np.sqrt(known)
    information = np.linalg.eigvalsh(-0.5 * curvature / np.outer(scale, scale)) - 1.0
    point = reach @ free
    return _OnLink(value, {name: float(point[i]) for i, name in enumerate(POINT)}, force, information)


def _lack_of_fit(ground: Ground, link: int, shape: Mapping[str, float]) -> float:
    """How much more than noise the best push leaves of the smooth torque in its window, 1 where that is nothing."""
    upstream = ground.motion.robot.kinematics.upstream(link - 1)
    factors = course_of(ground, shape)
    unit = unit_torque(ground, link, factors)
    arm = np.array([1.0, *(shape[name] for name in POINT)])
    rows = ground.rows(factors[..., None, None] * (unit @ arm), upstream)
    target = ground.target(upstream)
    left = target - rows @ solve(rows.T @ rows, rows.T @ target)[0]
    knots = shape["start_s"] + shape["duration_s"] * np.linspace(-0.1, 1.1, LACK_KNOTS)
    width = knots[1] - knots[0]
    hats = np.stack([ground.course(partial(_hat, knot, width)) for knot in knots], axis=-1)
    squares = 0.0
    for place in range(len(upstream)):
        values = np.zeros((*hats.shape[:2], len(upstream), LACK_KNOTS))
        values[:, :, place] = hats
        rows = ground.rows(values, upstream)
        seen = rows.T @ left
        squares += float(seen @ solve(rows.T @ rows, seen)[0])
    return dispersion_of(squares, LACK_KNOTS * len(upstream))


def _hat(at: float, width: float, time: FloatArray) -> FloatArray:
    return np.maximum(0.0, 1.0 - np.abs(time - at) / width)
