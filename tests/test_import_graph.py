"""The arrows of docs/architecture.md, read from the code's own import statements."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGES = ("daemon", "fri_client", "identification", "safety", "fixtures")
ALLOWED = {
    "daemon": {"fri_client", "identification", "safety"},
    "fri_client": {"safety"},
    "identification": set(),
    "safety": set(),
    "fixtures": {"fri_client.messages"},
}
CLOCKS_AND_SOCKETS = {"socket", "asyncio", "zmq", "time", "sched"}


def imported_names(source: str, package: tuple[str, ...]) -> set[str]:
    """Absolute names of all modules that a source text imports, at any depth of its code; package: where it stands."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            names.add(module)
            names.update(f"{module}.{alias.name}" for alias in node.names)
    return names


def modules_imported_by(file: Path) -> set[str]:
    return imported_names(file.read_text(encoding="utf-8"), file.relative_to(REPOSITORY).parts[:-1])


def project_arrows(package: str) -> set[tuple[Path, str]]:
    """Pairs (file, imported module) of one package that point to another package of the project, or to the tests."""
    return {
        (file.relative_to(REPOSITORY), name)
        for file in (REPOSITORY / package).rglob("*.py")
        for name in modules_imported_by(file)
        if name.split(".")[0] in {*PACKAGES, "tests"} - {package}
    }


@pytest.mark.parametrize("package", PACKAGES)
def test_arrows_run_down_only(package: str) -> None:
    def is_allowed(name: str) -> bool:
        return any(name == root or name.startswith(root + ".") for root in ALLOWED[package])

    wrong = {(str(file), name) for file, name in project_arrows(package) if not is_allowed(name)}
    # `from fri_client import messages` names the package first; what counts is the module it brings in.
    if package == "fixtures":
        wrong = {(file, name) for file, name in wrong if name != "fri_client"}
    assert not wrong


ROOMS = {
    "fri_client": ("wire", "handover", "session", "motion", "loop"),
    "daemon": ("motion", "log", "live", "doctor", "jobs", "run", "queue", "investigate", "proof", "cli"),
}
"""From the bottom up: a room imports from those before it alone, also inside functions and under TYPE_CHECKING."""


@pytest.mark.parametrize("package", ROOMS)
def test_rooms_import_from_below_only(package: str) -> None:
    rooms = ROOMS[package]
    folders = {folder.name for folder in (REPOSITORY / package).iterdir() if (folder / "__init__.py").is_file()}
    assert folders == set(rooms)
    for file in (REPOSITORY / package).rglob("*.py"):
        place = file.relative_to(REPOSITORY / package).parts[0]
        allowed = rooms[: rooms.index(place) + 1] if place in rooms else rooms if place == "__init__.py" else ()
        for name in modules_imported_by(file):
            parts = name.split(".")
            if parts[0] == package and len(parts) > 1 and parts[1] in rooms:
                assert parts[1] in allowed, f"{file.relative_to(REPOSITORY)} imports {name}"


DIAGNOSIS = REPOSITORY / "identification" / "mismatch"
DIAGNOSIS_ROOMS = ("effects", "data_faults", "search", "changes", "unknown", "names")
"""From the bottom up. The files beside the rooms hold what all of these share, and what joins them."""


def test_rooms_of_the_diagnosis_import_from_below_only() -> None:
    assert {folder.name for folder in DIAGNOSIS.iterdir() if (folder / "__init__.py").is_file()} == set(DIAGNOSIS_ROOMS)
    for place, room in enumerate(DIAGNOSIS_ROOMS):
        above = tuple(f"identification.mismatch.{other}." for other in DIAGNOSIS_ROOMS[place + 1 :])
        for file in (DIAGNOSIS / room).rglob("*.py"):
            wrong = [name for name in modules_imported_by(file) if f"{name}.".startswith(above)]
            assert not wrong, f"{file.relative_to(REPOSITORY)} imports {wrong}"


@pytest.mark.parametrize("package", PACKAGES)
def test_no_two_modules_need_each_other(package: str) -> None:
    """No circle of any length, also none hidden by an import inside a function or under TYPE_CHECKING.

    A module of another package needs that package's `__init__` as well, which runs first.
    """
    module_of = {
        ".".join(file.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__"): file
        for file in (REPOSITORY / package).rglob("*.py")
    }

    def with_packages(name: str) -> set[str]:
        parts = name.split(".")
        return {".".join(parts[:count]) for count in range(1, len(parts) + 1)}

    needs = {
        module: {
            needed
            for name in modules_imported_by(file)
            if name in module_of
            for needed in with_packages(name)
            if not f"{module}.".startswith(f"{needed}.")
        }
        for module, file in module_of.items()
    }
    TopologicalSorter(needs).prepare()


def test_the_simulator_shares_no_code_with_the_estimator() -> None:
    for package, other in (("fixtures", "identification"), ("identification", "fixtures")):
        assert not [arrow for arrow in project_arrows(package) if arrow[1].split(".")[0] == other]


def test_identification_has_no_sockets_and_no_clocks() -> None:
    used = {
        (str(file.relative_to(REPOSITORY)), name)
        for file in (REPOSITORY / "identification").rglob("*.py")
        for name in modules_imported_by(file)
        if name.split(".")[0] in CLOCKS_AND_SOCKETS
    }
    assert not used


def test_an_import_is_seen_wherever_it_hides() -> None:
    source = "def late():\n    from ..fit import fit_recordings\n    import daemon.api\n"
    assert imported_names(source, ("identification", "signals")) == {
        "identification.fit",
        "identification.fit.fit_recordings",
        "daemon.api",
    }
