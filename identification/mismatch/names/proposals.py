"""Names searched by the evidence of the whole model, torque of no known form in it.

Asked where the noise is measured and no few names explain all. A name comes beside the classes that the joints hold, or
takes the place of one of them: whichever gains most nats. What is proposed is a proposal; the rules judge it.
"""

from __future__ import annotations

from collections.abc import Sequence

from identification.mismatch.search.library import EffectRows, Library
from identification.mismatch.search.refinement import Member, refine, score_of
from identification.mismatch.search.screening import build_screen, without_noise
from identification.mismatch.search.search import Renewal, SearchResult, on_own_torque, polished, shortlist
from identification.mismatch.search.trial import Trial, fitted, pruned
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown.covariance import ClassCovariance, ClassOnJoint


def search_beside_classes(
    classes: ClassCovariance, before: Trial, library: Library, renewed: Renewal, settings: DiagnosisSettings
) -> SearchResult:
    """Names that gain nats, one by one, in the rows beside the classes whose place they did not take.

    before: the nominal problem without classes; without any such name it is what comes back. renewed: as in `search`.
    """
    candidates = library.candidates()[0]
    held = frozenset(classes.columns)
    members: Sequence[Member] = ()
    while len(members) < settings.largest_findings:
        move = _best_move(classes, held, members, library, candidates, settings)
        if move is None:
            break
        member, replaced = move
        held -= replaced
        problem = classes.problem(held)
        members = polished(problem, fitted(problem, [*members, member], settings), library, settings).members
    if not members:
        return SearchResult(before, before, library, library)
    problem = classes.problem(held)
    trial = pruned(problem, fitted(problem, members, settings), settings)
    trial, own = on_own_torque(problem, trial, library, renewed, settings)
    return SearchResult(trial, before, own, library)


def _best_move(
    classes: ClassCovariance,
    held: frozenset[ClassOnJoint],
    members: Sequence[Member],
    library: Library,
    candidates: Sequence[EffectRows],
    settings: DiagnosisSettings,
) -> tuple[Member, frozenset[ClassOnJoint]] | None:
    """The name that gains most beside what is held, and the class it takes the place of, if any."""
    taken = {(member.effect.name, member.place) for member in members}
    whole = fitted(classes.problem(held), members, settings).problem
    screen = build_screen(whole, candidates)
    best, found = 0.0, None
    for replaced in (frozenset[ClassOnJoint](), *(frozenset([place]) for place in sorted(held))):
        joints, loss = {joint for joint, _ in replaced}, sum(classes.losses[place] for place in replaced)
        seen = screen
        for place in replaced:
            seen = without_noise(screen, whole.whitened_unnamed(classes.columns[place], place[0]))
        chosen = shortlist(seen, library, taken, least=max(settings.provisional_score, loss + best), joints=joints)
        if not chosen:
            continue
        problem = fitted(classes.problem(held - replaced), members, settings).problem if replaced else whole
        for member in (refine(problem, library, item) for item in chosen):
            score = score_of(problem, member)
            if score >= settings.provisional_score and score - loss > best:
                best, found = score - loss, (member, replaced)
    return found
