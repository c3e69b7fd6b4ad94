"""Claims about the files that a newcomer looks for: licence, citation, issue forms, links between the pages.

Truth: the licences that each installed package states of itself, the DOI of the seed paper, the files of the checkout.
"""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("packaging/**/*.md")])

# These say nothing that a program can read in their metadata; a person read the licence file that comes with them.
READ_BY_HAND = {"apsw": "any OSI-approved licence", "cmeel-qhull": "Qhull licence"}
PERMISSIVE = re.compile(r"\b(MIT|BSD|0BSD|Apache|PSF|Python Software Foundation|ISC|Zlib|BSL-1\.0|CC0)\b")
COPYLEFT = re.compile(r"GPL|General Public License|Proprietary|Commercial|MPL|Mozilla|SSPL")


def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def citation() -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    return loaded


def normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def installed_with_the_program() -> dict[str, Distribution]:
    """Everything that comes with the required dependencies, theirs included, extras not."""
    found: dict[str, Distribution] = {}
    waiting = [re.split(r"[^\w.-]", line)[0] for line in project()["dependencies"]]
    while waiting:
        name = normalised(waiting.pop())
        if name in found:
            continue
        try:
            found[name] = distribution(name)
        except PackageNotFoundError:  # wanted on another platform or another Python only
            continue
        for line in found[name].requires or []:
            if "extra ==" not in line:
                waiting.append(re.split(r"[^\w.-]", line)[0])
    return found


def stated_licence(package: Distribution) -> str:
    """What a package says of its licence: the SPDX expression, else the trove classifiers, else the first line."""
    metadata = package.metadata
    classifiers = [line for line in metadata.get_all("Classifier") or [] if line.startswith("License ::")]
    first_line = ((metadata.get_all("License") or [""])[0].splitlines() or [""])[0]
    return (metadata.get_all("License-Expression") or [""])[0] or "; ".join(classifiers) or first_line


def test_everything_that_users_install_has_a_permissive_licence() -> None:
    packages = installed_with_the_program()
    assert {normalised(re.split(r"[^\w.-]", line)[0]) for line in project()["dependencies"]} <= set(packages)
    for name, package in packages.items():
        if name not in READ_BY_HAND:
            licence = stated_licence(package)
            assert PERMISSIVE.search(licence), f"{name}: {licence!r}"
            assert not COPYLEFT.search(licence), f"{name}: {licence!r}"


def test_licence_file_metadata_and_citation_name_the_same_licence() -> None:
    assert project()["license"] == citation()["license"] == "BSD-3-Clause"
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert text.startswith("BSD 3-Clause License")
    assert len(re.findall(r"^\d\. ", text, flags=re.MULTILINE)) == 3


def test_the_packages_under_the_gpl_are_imported_by_tests_only() -> None:
    for folder in ("fri_client", "safety", "identification", "daemon", "fixtures"):
        for file in (ROOT / folder).rglob("*.py"):
            assert "small_mcap" not in file.read_text(encoding="utf-8"), file


def test_the_citation_names_this_version_and_the_seed_paper() -> None:
    cited = citation()
    assert cited["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= set(cited)  # what the format demands
    assert cited["version"] == project()["version"]
    (paper,) = cited["references"]
    assert paper["doi"] == "10.1016/j.ifacol.2017.08.1208"
    assert [author["family-names"] for author in paper["authors"]] == ["Stürz", "Affolter", "Smith"]
    assert paper["doi"] in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["wrong-result", "run-not-as-planned", "idea"])
def test_issue_forms_have_what_the_host_demands(name: str) -> None:
    form = yaml.safe_load((ROOT / ".github" / "ISSUE_TEMPLATE" / f"{name}.yml").read_text(encoding="utf-8"))
    assert form["name"]
    assert form["description"]
    fields = [field for field in form["body"] if field["type"] != "markdown"]
    identifiers = [field["id"] for field in fields]
    assert len(set(identifiers)) == len(identifiers)
    for field in fields:
        assert field["type"] in ("input", "textarea", "dropdown", "checkboxes")
        assert field["attributes"]["label"]
        assert field["type"] != "dropdown" or field["attributes"]["options"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if not re.match(r"\w+:", target) and not target.startswith("#"):
            assert (page.parent / target.split("#")[0]).exists(), target


def headings(page: Path) -> set[str]:
    """The anchors that the host makes of a page's headings: small letters, no punctuation, hyphens for spaces."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return {
        re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
        for title in re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_to_a_heading_find_it(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]*#[^)\s]+)\)", page.read_text(encoding="utf-8")):
        file, _, heading = target.partition("#")
        if not re.match(r"\w+:", target) and (not file or file.endswith(".md")):
            assert heading in headings(page.parent / file if file else page), target


def test_the_application_for_the_cabinet_says_first_that_nobody_compiled_it() -> None:
    code = (ROOT / "packaging" / "sunrise" / "IiwaIdentOverlay.java").read_text(encoding="utf-8")
    assert code.startswith("// NOT COMPILED AND NOT RUN BY THIS PROJECT.")
    page = " ".join((ROOT / "docs" / "operator.md").read_text(encoding="utf-8").split())
    assert "Nobody here could compile or run it" in page
    assert "SEND_PERIOD_MS = 1;" in code
    assert "ClientCommandMode.POSITION" in code
    asked, opened, moved = (code.index(text) for text in ("operatorAgrees()", "new FRISession(", "lbr.move("))
    assert asked < opened < moved
    assert "displayModalDialog" not in code[opened:moved]


def test_the_readme_says_what_every_page_is_for() -> None:
    table = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Reading on")[2]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines() if line.startswith("| [")]
    purposes = {page: purpose for pages, purpose in rows for page in re.findall(r"\]\((\S+?)\)", pages)}
    assert {page.relative_to(ROOT).as_posix() for page in ROOT.glob("docs/*.md")} <= set(purposes)
    assert all(len(purpose.split()) >= 4 for purpose in purposes.values())
