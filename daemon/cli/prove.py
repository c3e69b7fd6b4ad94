"""The command `prove`: concealed cases drawn, sealed, diagnosed blind, opened and scored; its tables and its JSON."""

from __future__ import annotations

import dataclasses
import math
import os
import sys
from typing import Annotated, Any

import typer
from rich.table import Table

from daemon.cli.app import app
from daemon.cli.output import JsonOption, data, message, show_table, wants_json_on_stdout, write_json
from daemon.prove_table import NO_NAME, Rate, confusion, family_rows, negatives, summary, targets, wrong_answers


@app.command()
def prove(
    cases: Annotated[int, typer.Option("--cases", min=1, help="Concealed cases; any number is spread evenly.")] = 100,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Below 10000: tuning; from 1000000 on: final runs.")] = 1,
    jobs: Annotated[int | None, typer.Option("--jobs", min=1, help="Cases at a time; default: processors.")] = None,
    only: Annotated[
        str | None, typer.Option("--only", metavar="GROUP/FAMILY", help="'pair', 'single/gain' or '/gain' only.")
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option("--minutes", min=0.0, help="Begin no further case after this time; score those done."),
    ] = None,
    report: Annotated[
        bool, typer.Option("--report", help="Write each case's report too, within the time of the case.")
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Prove the diagnosis on concealed cases: draw, seal, diagnose blind in other processes, open the seals, score.

    Example: iiwa-ident prove --cases 600 --seed 1000000 --json proof.json
    """
    from daemon.prove import prove as run_proof
    from daemon.prove import select_cases

    indices = select_cases(seed, cases, only)
    if not indices:
        raise typer.BadParameter(f"no case is called '{only}'; groups: single, negative, decoy, background, pair, …")
    proven = run_proof(
        seed,
        indices,
        jobs=jobs or os.cpu_count() or 1,
        minutes=math.inf if minutes is None else minutes,
        report=report,
        publish=lambda name, commitment: message(f"case {name}: label sealed, sha256 {commitment}"),
        progress=_show_progress if sys.stderr.isatty() else None,
    )
    scores = [case.score for case in proven]
    figures = summary(scores)
    if json_file is not None:
        write_json(
            json_file,
            plain(
                {
                    "format": "iiwa-ident/proof/1",
                    "seed": seed,
                    "only": only,
                    "summary": figures,
                    "targets": [dataclasses.asdict(target) for target in targets(figures)],
                    "families": family_rows(scores),
                    "negatives": negatives(scores),
                    "confusion": confusion(scores),
                    "cases": [dataclasses.asdict(case) for case in proven],
                }
            ),
        )
    if wants_json_on_stdout(json_file):
        return
    show_proof(scores, figures)
    data("Wrong, superfluous or missing (λ ≥ 60) names:")
    for line in wrong_answers([(case.index, case.score) for case in proven]) or ["none"]:
        data(f"  {line}")
    data(f"One of these cases again: python -m fixtures.cases --seed {seed} --case I --out DIR")


def _show_progress(done: int, total: int) -> None:
    message(f"[{100 * done // total:3d} %] {done} of {total} cases diagnosed")


def show_proof(scores: list[Any], figures: dict[str, Any]) -> None:
    """Families, confusion, negatives, the other figures, and the targets, on stdout."""
    data("Singles without background; rates at λ ≥ 100, what an oracle needs is λ = 24:")
    names = ("detected", "joint", "named", "in_set", "named_textbook", "named_perturbed", "named_background")
    table = Table(
        "family",
        "cases",
        "detected",
        "joint right",
        "named",
        "or in set",
        "textbook",
        "perturbed",
        "in background",
        "λ50",
        "λ90",
    )
    for row in family_rows(scores):
        curve = ["-" if row[name] is None else f"{row[name]:.0f}" for name in ("lambda50", "lambda90")]
        table.add_row(row["family"], str(row["cases"]), *(short(row[name]) for name in names), *curve)
    show_table(table)
    data("First name given, singles with λ ≥ 24 (structural equals count as right):")
    table = Table("hidden", "right", NO_NAME, "other names")
    for family, called in confusion(scores).items():
        others = ", ".join(f"{name} {n}" for name, n in called.most_common() if name not in ("right", NO_NAME))
        table.add_row(family, str(called["right"]), str(called[NO_NAME]), others)
    show_table(table)
    data("False names where nothing is hidden, with the 95 % upper bound:")
    table = Table("group", "false names", "bound")
    for group, value in negatives(scores).items():
        table.add_row(group, str(value), f"{100 * value.upper_bound:.1f} %")
    show_table(table)
    data("Everything else:")
    for name, value in figures.items():
        data(f"  {name.replace('_', ' ')}: {value if not isinstance(value, float) else f'{value:.4g}'}")
    table = Table("to be reached", "wanted", "reached", "")
    for target in targets(figures):
        verdict = "no case" if target.met is None else ("met" if target.met else "NOT MET")
        table.add_row(target.text, target.wanted, target.reached, verdict)
    show_table(table)


def short(value: Rate) -> str:
    """'11/12', or '-' of nothing."""
    return f"{value.hits}/{value.count}" if value.count else "-"


def plain(value: Any) -> Any:
    """The same as plain JSON types: rates as objects, what is not finite as null."""
    if isinstance(value, Rate):
        return {"hits": value.hits, "count": value.count, "upper_bound_95": value.upper_bound}
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
