"""Claims about docs/glossary.md: what tables, findings and messages print in capitals is explained there.

Truth: the names in the code, and the regrouping of the iiwa 14's parameters (the paper's eq. (6)).
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest

from fri_client.messages import ConnectionQuality, SessionState
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.regressor import INERTIAL_SYMBOLS
from identification.robots import load_robot

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
TERMS = set(re.findall(r"\*\*(.+?)\*\*", TEXT))

# Firms, arms, societies and conferences that the sentences cite as sources.
NO_TERMS = {"AIAA", "AIM", "CAD", "ICRA", "IEEE", "IFAC", "IIWA", "IROS", "ISMA", "KUKA", "LBR", "TX40"} | {
    "VIOLATE",  # a sentence that must be seen
}


def capitals_in(folder: Path) -> set[str]:
    """Capitalised words of all strings with a space that are no docstring."""
    words: set[str] = set()
    for file in folder.rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        bare = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            text = node.value if isinstance(node, ast.Constant) and id(node) not in bare else None
            if isinstance(text, str) and " " in text:
                words |= set(re.findall(r"\b[A-Z][A-Z0-9]+(?:_[A-Z0-9]+)*\b", text))
    return words


def test_every_symbol_of_a_parameter_is_explained() -> None:
    everything = RegressorOptions(rotor_inertia=True, offset=True)
    symbols = {name.split("_")[0] for name in BaseRegressor(load_robot("iiwa14"), everything).names}
    assert {symbol if symbol in TERMS else symbol.removesuffix("R") for symbol in symbols} <= TERMS
    assert set(INERTIAL_SYMBOLS) <= TERMS


def test_every_session_state_and_quality_is_explained() -> None:
    assert {item.name for item in (*SessionState, *ConnectionQuality)} <= TERMS


@pytest.mark.parametrize("folder", ["identification/mismatch", "identification/report"])
def test_every_capitalised_word_of_findings_and_reports_is_explained(folder: str) -> None:
    assert capitals_in(ROOT / folder) - NO_TERMS <= TERMS


def test_the_regrouped_examples_are_those_of_the_arm() -> None:
    base = BaseRegressor(load_robot("iiwa14"))
    printed = {
        "MYR_2": {"MY_2": 1.0, "MZ_3": 1.0} | {f"M_{link}": 0.42 for link in range(3, 8)},
        "ZZR_1": {"ZZ_1": 1.0, "YY_2": 1.0},
    }
    assert "MY_2 + MZ_3 + 0.42 m · (M_3 + M_4 + M_5 + M_6 + M_7)" in TEXT
    assert "is ZZ_1 + YY_2." in TEXT
    for name, parts in printed.items():
        row = base.regrouping[base.position_of(name)]
        found = {base.full_names[column]: row[column] for column in np.flatnonzero(np.abs(row) > 1e-9)}
        assert found == pytest.approx(parts), name
