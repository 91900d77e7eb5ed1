"""What is released: a small wheel that installs into an empty environment and works there; a source archive."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from roboassembly import __version__

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
LARGEST = 10e6
"""Bytes of the wheel, policy included."""


def run(*words: str | Path, cwd: Path) -> str:
    """What it writes to stdout; not touched by the environment that runs the tests."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV", "ROBOASSEMBLY"))}
    done = subprocess.run([*map(str, words)], cwd=cwd, env=clean, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the source archive, the wheel made from the archive."""
    out = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--outdir", out, ROOT, cwd=out)
    return out


def test_package_index_accepts_the_wheel(built: Path) -> None:
    files = sorted(built.iterdir())
    assert [f.name for f in files] == [
        f"roboassembly-{__version__}-py3-none-any.whl",
        f"roboassembly-{__version__}.tar.gz",
    ]
    told = run(sys.executable, "-m", "twine", "check", "--strict", *files, cwd=built)
    assert told.count("PASSED") == 2


def test_wheel_is_small_and_whole(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    assert wheel.stat().st_size <= LARGEST
    package = ROOT / "src"
    source = {str(p.relative_to(package)) for p in package.rglob("*") if p.is_file() and "__pycache__" not in p.parts}
    with zipfile.ZipFile(wheel) as archive:
        packed = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert packed == source
    assert "roboassembly/learning/weights/relational.npz" in packed


def test_source_archive_has_what_the_tests_need(built: Path) -> None:
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        names = {name.partition("/")[2] for name in opened.getnames()}
    assert {
        "README.md",
        "LICENSE",
        "CHANGELOG.md",
        "CITATION.cff",
        "Makefile",
        "mkdocs.yml",
        "tests/docs/test_docs.py",
    } <= names


def test_wheel_works_in_an_empty_environment(built: Path, tmp_path: Path) -> None:
    (wheel,) = built.glob("*.whl")
    run(sys.executable, "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    binaries = tmp_path / "venv" / "bin"
    run(binaries / "python", "-m", "pip", "install", "--quiet", wheel, cwd=tmp_path)
    here = tmp_path / "empty"
    here.mkdir()
    told = json.loads(run(binaries / "roboassembly", "assemble", "stool", "--no-film", "--json", cwd=here))
    assert (told["success"], told["merges"], told["guided_merges"]) == (True, 8, 8)
    assert sorted(p.name for p in (here / "assembly").iterdir()) == [
        "assembly.html", "furniture", "plan.json", "timings.json",
    ]  # fmt: skip
