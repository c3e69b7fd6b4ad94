"""Claims about the wheel: it holds every file of the packages, and what an operator copies; no tests, nothing else.

Truth: the files of the checkout. The backend that pyproject.toml names builds the wheel from a copy, without a network.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("daemon", "fixtures", "fri_client", "identification", "safety")
NOT_INSTALLED = ROOT / "fixtures" / "recordings"
"""Recordings of other people, with their own licence: 4 MB that nothing installed reads."""
FOR_OPERATORS = {
    "packaging/config.example.yaml": "share/iiwa-ident/config.example.yaml",
    "packaging/iiwa-ident.service": "share/iiwa-ident/iiwa-ident.service",
    "packaging/sunrise/IiwaIdentOverlay.java": "share/iiwa-ident/sunrise/IiwaIdentOverlay.java",
    "packaging/sunrise/README.md": "share/iiwa-ident/sunrise/README.md",
}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    if int(version("setuptools").split(".")[0]) < 80:
        pytest.skip("The build backend (setuptools 80) is not installed; `make test` installs it.")
    source = tmp_path_factory.mktemp("source")
    for folder in (*PACKAGES, "packaging", "tests"):
        shutil.copytree(ROOT / folder, source / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    build = "from setuptools.build_meta import build_wheel; build_wheel('dist')"
    subprocess.run([sys.executable, "-c", build], cwd=source, check=True, capture_output=True, text=True)
    (path,) = (source / "dist").glob("*.whl")
    return zipfile.ZipFile(path)


def test_the_wheel_holds_every_file_of_the_packages_and_no_tests(wheel: zipfile.ZipFile) -> None:
    expected = {
        file.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for file in (ROOT / package).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts and NOT_INSTALLED not in file.parents
    }
    found = {name for name in wheel.namelist() if ".dist-info/" not in name and ".data/" not in name}
    assert found == expected


def test_the_wheel_brings_unit_configuration_and_application_for_the_operator(wheel: zipfile.ZipFile) -> None:
    shipped = {name.partition(".data/data/")[2]: name for name in wheel.namelist() if ".data/" in name}
    assert set(shipped) == set(FOR_OPERATORS.values())
    for source, target in FOR_OPERATORS.items():
        assert wheel.read(shipped[target]) == (ROOT / source).read_bytes(), source
    on_disk = {file.relative_to(ROOT).as_posix() for file in (ROOT / "packaging").rglob("*") if file.is_file()}
    assert on_disk == set(FOR_OPERATORS)


def test_the_wheel_has_the_licence_and_the_command(wheel: zipfile.ZipFile) -> None:
    files = {name.partition(".dist-info/")[2]: name for name in wheel.namelist() if ".dist-info/" in name}
    assert wheel.read(files["licenses/LICENSE"]) == (ROOT / "LICENSE").read_bytes()
    assert "License-Expression: BSD-3-Clause" in wheel.read(files["METADATA"]).decode()
    assert "iiwa-ident = daemon.cli:main" in wheel.read(files["entry_points.txt"]).decode()
