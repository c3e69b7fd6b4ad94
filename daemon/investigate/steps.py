"""What is known after some recordings, for the account: the step of a study, and what is settled without a name."""

from __future__ import annotations

from daemon.investigate.account import Alive, Named, Step
from identification.investigation.forecast import STANDS_OUT, stands_out
from identification.investigation.study import Study


def step_of(found: Study, recordings: int) -> Step:
    """What a study of so many recordings says."""
    diagnosis = found.diagnosis
    return Step(
        recordings=recordings,
        verdict=diagnosis.verdict,
        answer=found.answer,
        alive=tuple(
            Alive(
                name=item.name,
                effect=item.effect,
                joint=item.place.joint,
                probability=item.probability,
                log_odds=item.log_odds,
            )
            for item in found.assessment.alive
        ),
        questions=tuple(item.sentence for item in found.questions),
        findings=tuple(
            Named(
                effect=item.effect,
                joint=item.place.joint,
                alternatives=tuple(other.effect for other in item.alternatives),
            )
            for item in diagnosis.findings
        ),
        stands_out=stands_out(found.assessment.alive),
        remaining=diagnosis.remaining,
        agreements=found.agreements,
        day_terms=tuple(item.sentence for item in found.day_terms),
    )


def as_a_class(found: Study) -> str:
    """What is settled where a class stands and no motion gives it a name."""
    alive = found.assessment.alive
    near = [item.name for item in alive if item.effect is not None and alive[0].log_odds - item.log_odds < STANDS_OUT]
    if len(near) > 1:
        why = f"{' or '.join(near)}: no motion within the limits tells them apart."
    elif near:
        why = f"{near[0]} comes nearest, and no motion would raise it to a name."
    else:
        why = "no form of the library describes it better than a free function does."
    return f"Settled as a class, without a name. {found.answer} {why[:1].upper()}{why[1:]}"
