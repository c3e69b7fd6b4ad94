"""The search for an excitation trajectory, problem (13)/(14): seeded starts in stages, best ones refined.

Here: the tournament of local searches, and the verified result. Not here: the local search (`local_search`), the
processes it runs in (`search_processes`), objective, constraints and their equations, any clock (the caller passes one
if a time budget shall hold) and any knowledge of collisions (the caller passes a judge).

Each stage keeps the best part of the one before and searches on from there with more iterations: most starts end in
poor local optima and show it early. What a time budget leaves after the last stage goes into hops: the best motions are
disturbed and improved again (basin hopping), on all processes; towards the end the best are polished.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import DesignError
from identification.excitation.constraints import verify
from identification.excitation.detectability_term import WORST_CONDITION, DetectabilityTerm
from identification.excitation.fourier import FourierTrajectory
from identification.excitation.limits import ExcitationLimits
from identification.excitation.local_search import DesignSettings, LocalSearch, Problem
from identification.excitation.nominal import TorqueLimit, foreseen_torque, searched_base_values
from identification.excitation.objective import (
    DETECTABILITY,
    PAYLOAD,
    BaseMatrix,
    Term,
    achieved_figures,
    mixture_weights,
)
from identification.excitation.payload_term import PayloadTerm
from identification.excitation.prediction import torque_noise
from identification.excitation.search_processes import Outcome, Task, workers
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from identification.robots.model import refuse_followers

_TRIALS = 8
"""Random motions on which it is found out which effects can be seen at all."""
_SHRINKING = (0.9, 0.8, 0.7, 0.6, 0.5)
_SHRUNK = 2
"""Where no motion found is accepted, the best two are tried at these amplitudes."""
_RESERVE_S = 2.5
"""Kept of the budget, or half of a budget that is very short, for ranking and verification, besides the judgement."""
_JUDGEMENTS = 1.5
"""So many times what the judgement of one candidate took is kept for that of the best."""
_HOPPING_SHARE = 0.95
_POLISHED_FROM = 0.85
_HOPPED_FROM = 3
_DISTURBED = (0.1, 0.2, 0.05, 0.3)
_RANKED = 24
_RANKING_RATE_HZ = 40.0
_RANKING_SIGN_WIDTH = 0.005


@dataclass(frozen=True, slots=True)
class DesignProgress:
    """One finished local search: stage and start counted from 1, its value and the best so far (cond, or criterion).

    planned: searches of this stage, 0 where they go on until the time is up.
    """

    stage: int
    stages: int
    done: int
    planned: int
    start: int
    value: float
    best: float


@dataclass(frozen=True, slots=True)
class DesignResult:
    """The trajectory, its figures at 100 Hz with true sign(), how the search went, and the verification at 1 kHz."""

    trajectory: FourierTrajectory
    cond: float
    log_det: float
    history: tuple[DesignProgress, ...]
    verified: dict[str, Any] = field(repr=False)


def design_excitation(
    robot: RobotModel,
    limits: ExcitationLimits,
    settings: DesignSettings | None = None,
    *,
    progress: Callable[[DesignProgress], None] | None = None,
    clock: Callable[[], float] | None = None,
    acceptable: Callable[[FourierTrajectory], bool] | None = None,
    nominal: PhysicalParameters | None = None,
    room: Term | None = None,
) -> DesignResult:
    """Design a trajectory for `robot` inside `limits`, problem (14) or with the true limits.

    progress: called in this process after every local search. clock: seconds, e.g. time.monotonic, for `budget_s`.
    acceptable: judges a candidate (self-collision, floor); the best one it accepts is returned, made smaller if need
    be. nominal: what the arm is taken to be; with the true limits its torque is bounded too, and the detectability of
    effects needs it. room: a penalty on coming near to things, added to the objective; picklable.
    Raises DesignError when limits and robot do not fit, or no candidate is accepted and verified.
    """
    settings = settings or DesignSettings()
    problem = replace(_problem(robot, limits, settings, nominal), room=room)
    began = 0.0 if clock is None else clock()
    history: list[DesignProgress] = []
    reserve_s = _RESERVE_S
    candidates: dict[int, tuple[float, FloatArray]] = {}

    def note(outcome: Outcome, number: int, done: int, planned: int) -> None:
        candidates[outcome.start] = (outcome.value, outcome.coefficients)
        best = min(value for value, _ in candidates.values())
        shown = [float(np.exp(v)) if settings.objective == "cond" else v for v in (outcome.value, best)]
        stages = max(number, len(settings.stages))
        event = DesignProgress(number, stages, done, planned, outcome.start + 1, shown[0], shown[1])
        history.append(event)
        if progress is not None:
            progress(event)

    def is_before(share: float) -> bool:
        return clock is None or settings.budget_s is None or clock() - began < share * settings.budget_s

    def is_searching_time() -> bool:
        return settings.budget_s is None or is_before(max(0.5, 1.0 - reserve_s / settings.budget_s))

    def judgement_s() -> float:
        """How long the caller takes to judge a candidate, on this machine beside what else runs on it; s."""
        if clock is None or settings.budget_s is None or acceptable is None or not is_searching_time():
            return 0.0
        before = clock()
        acceptable(_trajectory(problem, robot, min(candidates.values(), key=lambda found: found[0])[1]))
        return clock() - before

    with workers(problem) as run:
        for number, stage in enumerate(settings.stages, start=1):
            count = max(1, round(stage.part * settings.starts))
            order: list[int] = (
                list(range(count))
                if number == 1
                else sorted(candidates, key=lambda start: (candidates[start][0], start))[:count]
            )
            tasks = [Task(start, (stage.descent,), candidates[start][1] if number > 1 else None) for start in order]
            for done, outcome in enumerate(run(tasks, stage.budget_share, is_before, is_searching_time), start=1):
                note(outcome, number, done, len(tasks))
                # While the others search on.
                if number == done == 1:
                    reserve_s += _JUDGEMENTS * judgement_s()
        if settings.budget_s is not None and clock is not None and is_before(_HOPPING_SHARE):
            hops = run(_hops(candidates, settings, is_before), 1.0, is_before, is_searching_time)
            for done, outcome in enumerate(hops, start=1):
                note(outcome, len(settings.stages) + 1, done, 0)
    return _best_result(robot, problem, candidates, history, acceptable, nominal)


def _hops(
    candidates: dict[int, tuple[float, FloatArray]], settings: DesignSettings, is_before: Callable[[float], bool]
) -> Iterator[Task]:
    """Without end: the best motions so far in turn, disturbed by a share that alternates, as new starts.

    The candidates are read when a task is asked for, so that a better motion is hopped from at once. Late in the budget
    the best ones are polished, each once, before more are disturbed.
    """
    polished: set[int] = set()
    for number in itertools.count(settings.starts):
        best = sorted(candidates, key=lambda start: (candidates[start][0], start))[:_HOPPED_FROM]
        rough = [start for start in best if start not in polished]
        if rough and not is_before(_POLISHED_FROM):
            polished |= {rough[0], number}
            yield Task(number, (settings.polish,), candidates[rough[0]][1])
            continue
        share = _DISTURBED[number % len(_DISTURBED)]
        yield Task(number, settings.hop, candidates[best[number % len(best)]][1], share)


def _problem(
    robot: RobotModel, limits: ExcitationLimits, settings: DesignSettings, nominal: PhysicalParameters | None
) -> Problem:
    refuse_followers(robot, "design a motion of")
    if limits.joints != robot.n:
        raise DesignError(f"The limits are for {limits.joints} joints, but {robot.name} has {robot.n}.")
    offset = limits.middle if settings.offset_rad is None else np.array(settings.offset_rad, dtype=np.float64)
    if offset.shape != (robot.n,) or not np.all(np.isfinite(offset)):
        raise DesignError(f"The offset needs one finite number for each of the {robot.n} joints.")
    limits.reach(offset)
    if settings.noise_nm is not None and len(settings.noise_nm) != robot.n:
        raise DesignError(f"The torque noise needs one positive number for each of the {robot.n} joints, Nm.")
    problem = Problem(BaseMatrix(robot), limits, settings, offset)
    values = None if nominal is None else searched_base_values(robot, nominal)
    if values is not None and settings.limits == "true" and np.any(np.isfinite(limits.torque_nm)):
        problem = replace(problem, torque=TorqueLimit(values, limits.torque_nm))
    wanted = mixture_weights(settings.objective)
    if PAYLOAD in wanted:
        problem = replace(problem, payload=PayloadTerm.of(robot, torque_noise(robot, settings.noise_nm)))
    if DETECTABILITY not in wanted:
        return problem
    if values is None or settings.noise_nm is None:
        raise DesignError(
            "Detectability needs a prior of the arm and its torque noise; give a model with --model and --noise."
        )
    whole = DetectabilityTerm.of_robot(
        robot.kinematics, values, np.array(settings.noise_nm), 1000.0 * settings.period_s * settings.periods
    )
    search = LocalSearch(replace(problem, settings=replace(settings, objective="cond")))
    times = np.arange(settings.samples) * (settings.period_s / settings.samples)
    trials = []
    for trial in range(_TRIALS):
        a, b = np.split(search.random_start(np.random.default_rng([settings.seed, _TRIALS, trial])), 2, axis=1)
        motion = FourierTrajectory(1.0 / settings.period_s, a, b, offset).evaluate(times)
        trials.append(whole.strengths(problem.base.samples(*motion)))
    return replace(problem, detectability=whole.reachable(trials))


def _trajectory(problem: Problem, robot: RobotModel, coefficients: FloatArray) -> FourierTrajectory:
    a, b = np.split(coefficients, 2, axis=1)
    return FourierTrajectory(1.0 / problem.settings.period_s, a, b, problem.offset, robot.name)


def _figure(problem: Problem, trajectory: FourierTrajectory, achieved: dict[str, float]) -> float:
    """The achieved value of what was asked for, as `terms_of` mixes it, smaller is better."""
    size = achieved["parameters"]
    weighted = "" if problem.settings.noise_nm is None else "weighted_"
    terms = {
        "cond": float(np.log(achieved["cond"])),
        "d": -0.5 * achieved[f"{weighted}log_det"] / size,
        "a": 0.5 * float(np.log(achieved[f"{weighted}trace_inverse"] / size)),
    }
    bound = 0.0
    times = np.arange(round(_RANKING_RATE_HZ * trajectory.period_s)) / _RANKING_RATE_HZ
    samples = problem.base.samples(*trajectory.evaluate(times), _RANKING_SIGN_WIDTH)
    if problem.payload is not None:
        terms[PAYLOAD] = problem.payload(samples)[0]
    if problem.detectability is not None:
        terms[DETECTABILITY] = problem.detectability(samples)[0]
        bound = max(0.0, terms["cond"] - float(np.log(WORST_CONDITION))) ** 2
    weights = mixture_weights(problem.settings.objective)
    return bound + float(sum(weight * terms[name] for name, weight in weights.items()))


def _best_result(
    robot: RobotModel,
    problem: Problem,
    candidates: dict[int, tuple[float, FloatArray]],
    history: list[DesignProgress],
    acceptable: Callable[[FourierTrajectory], bool] | None,
    nominal: PhysicalParameters | None,
) -> DesignResult:
    settings, limits = problem.settings, problem.limits
    regressor = BaseRegressor(robot)
    noise = None if settings.noise_nm is None else np.array(settings.noise_nm)
    # Also where the search does not keep to it: "inside the limits of the arm" has to count the torque.
    bounded = nominal is not None and bool(np.any(np.isfinite(limits.torque_nm)))
    torque_of = foreseen_torque(regressor, nominal) if bounded and nominal is not None else None
    ranked: list[tuple[float, int, FourierTrajectory, dict[str, float]]] = []
    for start, (_, coefficients) in sorted(candidates.items(), key=lambda entry: (entry[1][0], entry[0]))[:_RANKED]:
        trajectory = _trajectory(problem, robot, coefficients)
        achieved = achieved_figures(regressor, trajectory, noise_nm=noise)
        ranked.append((_figure(problem, trajectory, achieved), start, trajectory, achieved))
    # The search smooths sign() and takes few samples; what is promised is ranked by the true figures.
    ranked.sort(key=lambda entry: entry[:2])
    # A motion about a safe centre becomes safe when it is made smaller, and stays inside every limit; it is worth less.
    shrunk = [(factor, entry) for factor in _SHRINKING if acceptable is not None for entry in ranked[:_SHRUNK]]
    for factor, (_, start, found, figures) in [*((1.0, entry) for entry in ranked), *shrunk]:
        trajectory = found if factor == 1.0 else found.scaled(factor)
        verified = verify(trajectory, limits, torque_of=torque_of)
        if not verified["within_limits" if settings.limits == "true" else "within_paper_limits"]:
            continue
        if acceptable is not None and not acceptable(trajectory):
            continue
        achieved = figures if factor == 1.0 else achieved_figures(regressor, trajectory, noise_nm=noise)
        record = {
            "limits": limits.to_json(),
            "achieved": {**achieved, "verified_at_1_khz": verified},
            "seed": settings.seed,
            "settings": {**asdict(settings), "start": start + 1, "searches": len(history), "shrunk_to": factor},
        }
        return DesignResult(
            replace(trajectory, record=record), achieved["cond"], achieved["log_det"], tuple(history), verified
        )
    raise DesignError(
        f"None of the {len(candidates)} trajectories found is free of collisions and inside the limits; "
        "tighten the position limits, move the offset or try another seed."
    )
