"""Which effects, together, explain the mean of the periods: forward, exchanged, pruned.

Where the noise is measured, sets are ranked by the squares that they leave in units of it. Where it is not, by the
profile likelihood with a free smooth background. Where no few effects leave nothing but noise, names are searched again
beside torque of no known form (`names.proposals`). Decides nothing about words.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Place
from identification.mismatch.problem import Problem
from identification.mismatch.search.extension import extend
from identification.mismatch.search.library import EffectRows, Library
from identification.mismatch.search.refinement import Member, refine, score_of
from identification.mismatch.search.screening import Screen, build_screen, gains, narrowed
from identification.mismatch.search.trial import Trial, fitted, pruned, without
from identification.mismatch.settings import MOST, DiagnosisSettings

SHORTLIST = 6
"""Candidates per screening that are refined."""
GROWS = 0.5
"""Share of its refined score that a candidate has on the grid at least."""
SMALLEST_SHARE_OF_BEST = 0.4
"""A candidate on the grid below this share of the best is not refined."""
MOST_RENEWALS = 4
WORTH_RENEWING = 2.0
"""Log-likelihood that a new nominal torque must bring in a step."""

Renewal = Callable[[FloatArray], Library]


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """What the search settled on. before: the nominal problem.

    library: that of the last nominal torque. looked_at: the one whose candidates names are told from.
    """

    trial: Trial
    before: Trial
    library: Library
    looked_at: Library

    @property
    def candidates(self) -> Sequence[EffectRows]:
        """Computed when asked for: where names are searched again beside classes, nobody asks for the first ones."""
        return self.looked_at.candidates()[0]


def search(nominal: Problem, library: Library, renewed: Renewal, settings: DiagnosisSettings) -> SearchResult:
    """Forward steps until nothing more is gained, exchange of members, then pruning by the regime that holds.

    renewed: the library seen from other base parameters. The torque that gains, delays and loads act on is that of the
    nominal fit, which an effect that is not yet modelled bends; after each step it is taken from the extended fit, if
    the members then explain more.
    """
    before = trial = fitted(nominal, (), settings)
    # What is refined is chosen by the nominal fit's torque: anew for a torque that differs by a few per cent, all forms
    # at all places would be half of a search.
    screen = build_screen(nominal, library.candidates()[0])
    # Beyond few effects that explain all by the noise alone, names have to stand out from classes.
    most = settings.largest_explanation if nominal.noise_is_measured else settings.largest_findings
    while len(trial.members) < most:
        step = _step(trial, _beside(screen, trial), library, settings)
        if step is None:
            break
        trial = polished(nominal, step, library, settings)
        if nominal.noise_is_measured:
            trial = _exchanged(nominal, trial, screen, library, settings)
        trial, library = _seen_anew(nominal, trial, library, renewed, settings)
    if not nominal.noise_is_measured:
        trial = _exchanged(nominal, trial, screen, library, settings)
    trial, library = on_own_torque(nominal, trial, library, renewed, settings)
    trial = _on_every_joint(nominal, before, trial, library, settings)
    trial = pruned(nominal, trial, settings)
    trial, library = on_own_torque(nominal, trial, library, renewed, settings)
    return SearchResult(trial, before, library, library)


def _on_every_joint(
    nominal: Problem, before: Trial, trial: Trial, library: Library, settings: DiagnosisSettings
) -> Trial:
    """The same physics on every joint as one member, where that leaves nothing but noise at less cost.

    Asked where most joints are wrong, and single members do not explain all or share a name. before: without members.
    """
    if not nominal.noise_is_measured:
        return trial
    names = [member.effect.name for member in trial.members]
    wrong = int((before.power.probability.min(axis=1) < settings.consistency_probability).sum())
    if 2 * wrong <= nominal.n or (trial.complete and len(set(names)) == len(names)):
        return trial
    found = [trial] if trial.complete else []
    for effect in library.effects:
        shapes = library.grid(effect, Place()) if effect.everywhere else ()
        rows = [library.rows(effect, Place(), shape) for shape in shapes]
        members = [Member(item) for item in rows if item is not None]
        if not members:
            continue
        every = max(members, key=lambda member: score_of(nominal, member))
        if 2.0 * score_of(nominal, every) < MOST * (before.squares - nominal.torque.size):
            continue
        every = refine(nominal, library, every)
        others = [member for member in trial.members if member.effect is not effect]
        for beside in ([], others) if others else ([],):
            candidate = fitted(nominal, [every, *beside], settings, trial)
            if candidate.complete:
                found.append(candidate)
    return min(found, key=lambda item: item.penalised, default=trial)


def _seen_anew(
    nominal: Problem, trial: Trial, library: Library, renewed: Renewal, settings: DiagnosisSettings
) -> tuple[Trial, Library]:
    """The members on the torque of the extended fit, in turns, as long as that explains clearly more."""
    for _ in range(MOST_RENEWALS):
        other = renewed(extend(nominal, trial.members).base)
        members = []
        for member in trial.members:
            rows = other.rows(member.effect, member.place, member.rows.shape)
            if rows is None:
                return trial, library
            members.append(Member(rows))
        again = fitted(nominal, members, settings)
        if _gain(again, trial) < WORTH_RENEWING:
            break
        library = other
        trial = polished(nominal, again, library, settings, alone=True)
    return trial, library


def on_own_torque(
    nominal: Problem, trial: Trial, library: Library, renewed: Renewal, settings: DiagnosisSettings
) -> tuple[Trial, Library]:
    """The members on the torque of the model they belong to, also where that explains no more than the nominal one's.

    Another motion is predicted with that torque: a friction that grows with load would there meet another load.
    """
    for _ in range(2 if trial.members else 0):
        other = renewed(extend(nominal, trial.members).base)
        rows = [other.rows(member.effect, member.place, member.rows.shape) for member in trial.members]
        members = [Member(item) for item in rows if item]
        again = fitted(nominal, members, settings, trial)
        same = len(members) == len(trial.members) and again.complete == trial.complete
        if not same or again.squares > trial.squares + 2.0 * settings.provisional_score:
            break
        trial, library = again, other
    return trial, library


def _beside(screen: Screen, trial: Trial) -> Screen:
    return narrowed(screen, trial.problem) if trial.members else screen


def _step(trial: Trial, screen: Screen, library: Library, settings: DiagnosisSettings) -> Trial | None:
    """The best set with one member more; None when nothing is gained. screen: beside the members of the trial."""
    taken = {(member.effect.name, member.place) for member in trial.members}
    found = [refine(screen.problem, library, member) for member in shortlist(screen, library, taken)]
    worth = [member for member in found if score_of(trial.problem, member) >= settings.provisional_score]
    if not worth:
        return None
    return _best([fitted(trial.nominal, [*trial.members, member], settings, trial) for member in worth])


def _gain(trial: Trial, before: Trial) -> float:
    """Log-likelihood by which a trial is better than another with the same members."""
    if trial.nominal.noise_is_measured:
        return 0.5 * (before.squares - trial.squares)
    return trial.likelihood - before.likelihood


def _best(trials: Sequence[Trial]) -> Trial:
    """The trial that leaves least for its size; where the noise is not measured the likeliest beside a background."""
    if trials[0].nominal.noise_is_measured:
        return min(trials, key=lambda trial: trial.penalised)
    return max(trials, key=lambda trial: trial.likelihood - trial.cost)


def shortlist(
    screen: Screen,
    library: Library,
    taken: set[tuple[str, Place]],
    least: float = 0.0,
    joints: AbstractSet[int] = frozenset(),
) -> list[Member]:
    """The best candidates, one per effect and place. taken: not these. least: score that they may reach once refined.

    joints: on which they act (from 0).
    """
    chosen: dict[tuple[str, Place], Member] = {}
    best = 0.0
    for score, rows in gains(screen):
        key = (rows.effect.name, rows.place)
        if not joints <= set(rows.joints):
            continue
        best = max(best, score)
        if key in taken or key in chosen:
            continue
        if score < max(SMALLEST_SHARE_OF_BEST * best, GROWS * least) or len(chosen) >= SHORTLIST:
            break
        if (own := library.rows(rows.effect, rows.place, rows.shape)) is not None:
            chosen[key] = Member(own)
    return list(chosen.values())


def polished(
    nominal: Problem, trial: Trial, library: Library, settings: DiagnosisSettings, *, alone: bool = False
) -> Trial:
    """Nonlinear parameters of all members refined beside each other; of a single one only when asked for."""
    if len(trial.members) < 2 and not alone:
        return trial
    members = list(trial.members)
    for index, member in enumerate(members):
        if member.shape:
            rest = fitted(nominal, without(members, index), settings)
            members[index] = refine(rest.problem, library, member)
    polished = fitted(nominal, members, settings)
    return polished if polished.squares < trial.squares else trial


def _exchanged(nominal: Problem, trial: Trial, screen: Screen, library: Library, settings: DiagnosisSettings) -> Trial:
    """Each member against all candidates in its place: early steps saw less than the last one does."""
    if len(trial.members) < 2:
        return trial
    for index in range(len(trial.members)):
        others = without(trial.members, index)
        rest = fitted(nominal, others, settings)
        taken = {(member.effect.name, member.place) for member in others}
        rivals = [refine(rest.problem, library, rival) for rival in shortlist(_beside(screen, rest), library, taken)]
        better = [fitted(nominal, [*others, rival], settings, trial) for rival in rivals]
        best = _best([trial, *better])
        if best is not trial and (best.penalised < trial.penalised - 2.0 or not nominal.noise_is_measured):
            trial = _reordered(best, index)
    return trial


def _reordered(trial: Trial, index: int) -> Trial:
    """The member exchanged last (it stands at the end) back at its place."""
    members = list(trial.members)
    members.insert(index, members.pop())
    return replace(trial, members=tuple(members))
