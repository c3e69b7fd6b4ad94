"""Sums up the proof of the closed loop: what each arm reached with the same minutes, and whether forecasts came true.

Pure: cases in, figures and rows out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from daemon.proof.closed_loop import ARMS, Answer, LoopCase, reliability
from daemon.proof.table import rate

GROUPS = ("confusable", "weak", "structural", "background", "nothing")


def _answers(cases: Sequence[LoopCase], arm: str) -> list[Answer]:
    if arm == "before":
        return [case.before for case in cases]
    return [answer for case in cases for answer in case.answers if answer.arm == arm]


def loop_summary(cases: Sequence[LoopCase]) -> dict[str, Any]:
    """Per group and arm: named rightly, leading hypothesis right, pairs told apart, wrong names, seconds of motion;
    forecasts.
    """
    found: dict[str, Any] = {"cases": len(cases)}
    for group in (*GROUPS, "all"):
        members = [case for case in cases if group in ("all", case.label["group"])]
        if not members:
            continue
        found[group] = {"cases": len(members)}
        for arm in ("before", *ARMS):
            answers = _answers(members, arm)
            if answers:
                found[group][arm] = {
                    "named": rate(answer.named for answer in answers),
                    "leader_right": rate(answer.leader_right for answer in answers),
                    "told_apart": rate(answer.told_apart for answer in answers if answer.told_apart is not None),
                    "wrong_names": rate(bool(answer.wrong) for answer in answers),
                    "seconds_mean": sum(answer.seconds for answer in answers) / len(answers),
                    "limits_broken": sum(answer.limits_broken for answer in answers),
                }
    forecasts = [pair for case in cases for pair in case.forecasts]
    found["forecasts"] = [
        {"range": name, "count": count, "foretold": mean, "came_true": share}
        for name, count, mean, share in reliability(forecasts)
    ]
    found["each"] = [asdict(case) for case in cases]
    return found


def loop_rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    """A row for each group and arm: named, leader right, told apart, wrong names, mean seconds, limits broken."""
    rows: list[tuple[str, ...]] = []
    for group in (*GROUPS, "all"):
        for arm in ("before", *ARMS):
            part = summary.get(group, {}).get(arm)
            if part is None:
                continue
            shares = (
                f"{part[name].hits} of {part[name].count}" if part[name].count else "–"
                for name in ("named", "leader_right", "told_apart", "wrong_names")
            )
            rows.append((group, arm, *shares, f"{part['seconds_mean']:.0f}", str(part["limits_broken"])))
    return rows


def reliability_rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    """A row for each range of forecasts."""
    return [
        (item["range"], str(item["count"]), f"{100 * item['foretold']:.0f} %", f"{100 * item['came_true']:.0f} %")
        for item in summary["forecasts"]
    ]
