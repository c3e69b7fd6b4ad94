"""A batch on one page and in one CSV file: what came of every recording, and where its own page is."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from pathlib import Path

from daemon.folders import make_folder
from daemon.jobs.batch import BatchItem, Task
from daemon.words import counted
from identification.report.document import Document, Section, Table
from identification.report.numbers import joint_heads, row_of
from identification.report.page import render
from identification.robots.joint_units import in_units
from identification.whole_file import write_whole, written_whole


def write_summary(task: Task, items: Sequence[BatchItem], out: Path) -> tuple[Path, Path]:
    """Write `index.html` and `summary.csv` into the folder `out`, which is made if it is not there; their paths."""
    make_folder(out)
    page, table = out / "index.html", out / "summary.csv"
    joints = max((len(item.rms_nm) for item in items), default=0)
    write_whole(page, render(_document(task, items, out, joints)))
    with written_whole(table) as partial, partial.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        numbers = [f"{name}_{joint + 1}" for name in ("rms", "noise") for joint in range(joints)]
        writer.writerow(["recording", "file", "exit_code", "result", *numbers, "torque_units", "page"])
        for item in items:
            values = [*_filled(item.rms_nm, joints), *_filled(item.noise_floor_nm, joints)]
            writer.writerow(
                [
                    item.name, item.file, item.exit_code, item.sentence,
                    *("" if value is None else repr(value) for value in values), " ".join(item.torque_units),
                    _page_of(item, out) or "",
                ]
            )  # fmt: skip
    return page, table


def _document(task: Task, items: Sequence[BatchItem], out: Path, joints: int) -> Document:
    failed = sum(item.exit_code != 0 for item in items)
    looked_at = sum(item.exit_code == 0 and item.tone == "attention" for item in items)
    done = {"fit": "fitted", "diagnose": "diagnosed"}[task]
    rms = "left by the model" if task == "fit" else "left with the findings"
    return Document(
        title=f"{f'{len(items) - failed} of ' * bool(failed)}{counted(len(items), 'recording')} {done}",
        verdict=f"{len(items) - failed} of {counted(len(items), 'recording', verb=True)} {done}, "
        f"{failed} failed; {looked_at} want{'s' * (looked_at == 1)} a closer look.",
        tone="attention" if failed or looked_at else "good",
        sections=(
            Section(
                "recordings",
                "Recordings",
                (
                    Table(
                        "What came of each",
                        ("recording", "result"),
                        tuple((item.name, ("FAILED: " if item.exit_code else "") + item.sentence) for item in items),
                        "words",
                        links=tuple(_page_of(item, out) for item in items),
                        tones=tuple("attention" if item.exit_code else item.tone for item in items),
                    ),
                    Table(
                        _caption(items, rms),
                        ("recording", *joint_heads(joints), *(f"noise {joint}" for joint in joint_heads(joints))),
                        tuple(
                            (
                                item.name, *row_of(_filled(item.rms_nm, joints)),
                                *row_of(_filled(item.noise_floor_nm, joints)),
                            )
                            for item in items
                            if item.rms_nm
                        ),
                    ),
                ),
            ),
        ),
    )  # fmt: skip


def _caption(items: Sequence[BatchItem], rms: str) -> str:
    """In the units of all joints of all recordings."""
    units = [unit for item in items for unit in item.torque_units]
    return in_units(f"RMS of measured minus modelled torque by joint, {rms}, and of the noise alone, Nm", units)


def _filled(values: Sequence[float | None], count: int) -> list[float | None]:
    return [*values, *[None] * (count - len(values))]


def _page_of(item: BatchItem, out: Path) -> str | None:
    """The item's own page as an address relative to the summary."""
    pages = [file for file in item.files if file.endswith(".html")]
    return Path(os.path.relpath(pages[0], out.resolve())).as_posix() if pages else None
