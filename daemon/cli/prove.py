"""The command `prove`: concealed cases drawn, sealed, diagnosed blind, opened and scored; its tables and its JSON."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from daemon.cli.app import app
from daemon.cli.output import JsonOption, data, message, show_table, wants_json_on_stdout, write_json
from daemon.cli.progress import progress_shown
from daemon.prove_score import CaseScore
from daemon.prove_table import Rate, confusion, family_rows, negatives, summary, targets, wrong_answers


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
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Keep the cases' pages there, and one of the proof."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Prove the diagnosis on concealed cases: draw, seal, diagnose blind in other processes, open the seals, score.

    Example: iiwa-ident prove --cases 600 --seed 1000000 --json proof.json
    """
    from daemon.prove import page_name, select_cases
    from daemon.prove import prove as run_proof

    indices = select_cases(seed, cases, only)
    if not indices:
        raise typer.BadParameter(f"no case is called '{only}'; groups: single, negative, decoy, background, pair, …")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    with progress_shown(lines=False) as show:
        proven = run_proof(
            seed,
            indices,
            jobs=jobs or os.cpu_count() or 1,
            minutes=math.inf if minutes is None else minutes,
            report=report,
            pages=out,
            publish=lambda name, commitment: message(f"case {name}: label sealed, sha256 {commitment}"),
            progress=lambda done, total: show(f"{done} of {total} cases diagnosed", done / total),
        )
    scores = [case.score for case in proven]
    figures = summary(scores)
    result = plain(
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
    )
    if json_file is not None:
        write_json(json_file, result)
    if out is not None:
        from daemon.prove_page import proof_page
        from identification.report.page import render

        names = {case.index: page_name(case.index) for case in proven}
        pages = {index: name for index, name in names.items() if (out / name).is_file()}
        (out / "index.html").write_text(render(proof_page(seed, proven, pages)), encoding="utf-8")
        write_json(out / "proof.json", result)
    if wants_json_on_stdout(json_file):
        return
    show_proof(scores, figures)
    data("Wrong, superfluous or missing (λ ≥ 60) names:")
    for line in wrong_answers([(case.index, case.score) for case in proven]) or ["none"]:
        data(f"  {line}")
    data(f"One of these cases again: python -m fixtures.cases --seed {seed} --case I --out DIR")
    if out is not None:
        data("The page to open:")
        data(f"  {out / 'index.html'}")


def show_proof(scores: list[CaseScore], figures: dict[str, Any]) -> None:
    """Families, confusion, negatives, the other figures, and what was to be reached, on stdout."""
    from daemon.prove_page import proof_tables

    for table in proof_tables(scores, figures):
        shown = Table(*table.head)
        for row in table.rows:
            shown.add_row(*row)
        data(f"{table.caption}:")
        show_table(shown)


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
