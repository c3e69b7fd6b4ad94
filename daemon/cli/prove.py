"""The command `prove`: concealed cases drawn, sealed, diagnosed blind, opened and scored; its tables and its JSON."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from daemon.cli.app import app
from daemon.cli.output import JsonOption, data, data_lines, message, show_table, wants_json_on_stdout, write_json
from daemon.cli.progress import progress_shown
from daemon.cli.protection import folder_to_write
from daemon.folders import make_folder
from daemon.proof.prove import ProvenCase, Source, page_name, select_cases
from daemon.proof.prove import prove as run_proof
from daemon.proof.score import CaseScore
from daemon.proof.table import confusion, family_rows, negatives, wrong_answers
from identification.json_values import plain

FORMAT = "iiwa-ident/proof/1"
WORLDS = ("library", "alien", "hybrid")


@app.command()
def prove(
    cases: Annotated[int, typer.Option("--cases", min=1, help="Concealed cases; any number is spread evenly.")] = 100,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Below 10000: tuning; from 1000000 on: final runs.")] = 1,
    jobs: Annotated[int | None, typer.Option("--jobs", min=1, help="Cases at a time; default: processors.")] = None,
    world: Annotated[
        list[str] | None,
        typer.Option("--world", metavar="NAME", help="library (default), alien or hybrid; again for one more."),
    ] = None,
    sealed: Annotated[
        bool, typer.Option("--sealed", help="The worlds' sealed families only: for a final run, and then no more.")
    ] = False,
    recordings: Annotated[
        Path | None, typer.Option("--recordings", metavar="DIR", help="Real recordings of the hybrid world.")
    ] = None,
    only: Annotated[
        str | None, typer.Option("--only", metavar="GROUP/FAMILY", help="'pair', 'single/gain' or '/gain' only.")
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option("--minutes", min=0.0, help="Begin no further case after this time; score those done."),
    ] = None,
    closed_loop: Annotated[
        int | None,
        typer.Option(
            "--closed-loop", metavar="N", min=1, help="Instead: N cases of investigate beside two other ways."
        ),
    ] = None,
    first: Annotated[int, typer.Option("--first", min=0, help="Number of the first case of --closed-loop.")] = 0,
    report: Annotated[
        bool, typer.Option("--report", help="Write a page of each case, in its time; --out keeps them.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Keep the cases' pages there, and one of the proof.", callback=folder_to_write
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Prove the diagnosis on concealed cases: draw, seal, diagnose blind in other processes, open the seals, score.

    Three worlds: `library` (forms that the diagnosis knows, and a few others), `alien` (physics from the literature
    that it was not written for) and `hybrid` (an effect added to a real recording).

    Example: iiwa-ident prove --cases 600 --seed 1000000 --json proof.json
    """
    if closed_loop is not None:
        _close_the_loop(seed, range(first, first + closed_loop), json_file, out)
        return
    worlds = tuple(dict.fromkeys(world or ["library"]))
    for name in worlds:
        if name not in WORLDS:
            raise typer.BadParameter(f"there is no world '{name}'; the worlds are {', '.join(WORLDS)}")
    if sealed and "library" in worlds:
        raise typer.BadParameter("no family of the library is sealed: everybody has seen them")
    results = []
    for name in worlds:
        source = Source(seed, name, sealed, recordings)
        folder = out / name if out is not None and len(worlds) > 1 else out
        proven = _run(source, cases, only, jobs, math.inf if minutes is None else minutes, report, folder)
        results.append(_result(source, only, proven))
        if folder is not None:
            _write_pages(source, proven, folder, results[-1])
        if not wants_json_on_stdout(json_file):
            _show(source, proven, folder)
    if json_file is not None:
        write_json(json_file, results[0] if len(results) == 1 else {"format": FORMAT, "worlds": results})


def _close_the_loop(seed: int, indices: range, json_file: Path | None, pages: Path | None) -> None:
    """The proof of `investigate`: motions chosen, random ones and the shipped one repeated, on one set of cases."""
    import tempfile

    from daemon.proof.closed_loop import prove_closed_loop
    from daemon.proof.closed_loop_table import loop_rows, loop_summary, reliability_rows

    with tempfile.TemporaryDirectory(prefix="iiwa-ident-prove-") as scratch:
        cases = prove_closed_loop(seed, indices, Path(scratch), tell=message, pages=pages)
    summary = loop_summary(cases)
    if json_file is not None:
        write_json(json_file, plain({"format": FORMAT, "closed_loop": True, "seed": seed, **summary}))
    if wants_json_on_stdout(json_file):
        return
    titles = ("named rightly", "leader right", "pair told apart", "wrong names", "s of motion", "limits broken")
    show_table(("group", "motions", *titles), loop_rows(summary))
    data("Forecasts: the probability that the truth would stand out, and how often it did:")
    show_table(("predicted", "motions", "mean", "came true"), reliability_rows(summary))


def _run(
    source: Source, cases: int, only: str | None, jobs: int | None, minutes: float, report: bool, out: Path | None
) -> list[ProvenCase]:
    """The proof of one world, with what is sealed and how far it is on the terminal."""
    indices = select_cases(source, cases, only)
    if not indices:
        raise typer.BadParameter(f"no case is called '{only}'; groups: single, negative, decoy, background, pair, …")
    if out is not None:
        make_folder(out)
    with progress_shown(lines=False) as show:
        return run_proof(
            source,
            indices,
            jobs=jobs or os.cpu_count() or 1,
            minutes=minutes,
            report=report,
            pages=out,
            publish=lambda name, commitment: message(f"case {name}: label sealed, sha256 {commitment}"),
            progress=lambda done, total: show(f"{done} of {total} cases diagnosed", done / total),
        )


def _result(source: Source, only: str | None, proven: list[ProvenCase]) -> dict[str, Any]:
    """The proof of one world as JSON."""
    from daemon.proof.page import aims_of, figures_of

    scores = [case.score for case in proven]
    figures = figures_of(source.world, scores)
    tables = (
        {"families": family_rows(scores), "negatives": negatives(scores), "confusion": confusion(scores)}
        if source.world == "library"
        else {}
    )
    result: dict[str, Any] = plain(
        {
            "format": FORMAT,
            "world": source.world,
            "sealed_families": source.sealed,
            "seed": source.seed,
            "only": only,
            "summary": figures,
            "targets": aims_of(source.world, figures),
            **tables,
            "cases": proven,
        }
    )
    return result


def _write_pages(source: Source, proven: list[ProvenCase], out: Path, result: dict[str, Any]) -> None:
    """The proof's own page beside those of the cases, and its JSON."""
    from daemon.proof.page import proof_page
    from identification.report.page import render
    from identification.whole_file import write_whole

    names = {case.index: page_name(case.index) for case in proven}
    pages = {index: name for index, name in names.items() if (out / name).is_file()}
    write_whole(out / "index.html", render(proof_page(source, proven, pages)))
    write_json(out / "proof.json", result)


def _show(source: Source, proven: list[ProvenCase], out: Path | None) -> None:
    """The proof of one world on stdout."""
    data(f"World: {source.world}{', sealed families' if source.sealed else ''}")
    show_proof(source.world, [case.score for case in proven])
    data("Wrong, superfluous or missing (λ ≥ 60) names:")
    data_lines(f"  {line}" for line in wrong_answers([(case.index, case.score) for case in proven]) or ["none"])
    world = "".join(f" {word}" for word in source.arguments[2:] if word != "--serve")
    data(f"One of these cases again: python -m fixtures.cases{world} --case I --out DIR")
    if out is not None:
        data("The page to open:")
        data(f"  {out / 'index.html'}")


def show_proof(world: str, scores: list[CaseScore]) -> None:
    """The tables of one world's cases, and what was to be reached, on stdout."""
    from daemon.proof.page import figures_of, proof_tables

    for table in proof_tables(world, scores, figures_of(world, scores)):
        data(f"{table.caption}:")
        show_table(table.head, table.rows)
