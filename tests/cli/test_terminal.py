"""Names that people choose cannot steer the terminal: what is printed holds no control characters."""

from __future__ import annotations

import ast
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import roboassembly
from command_line import Run
from roboassembly.cli import output
from roboassembly.datasets import catalogue
from roboassembly.furniture import storage

TITLE = "\x1b]0;owned\x07"
"""Sets a terminal's title."""
NASTY = f"{TITLE}\x1b[2Jseat\x9b1m\u202egel\x7f\r"


def command(*arguments: object, code: str = "from roboassembly.cli import main; main()") -> tuple[int, bytes, bytes]:
    """Exit status and the bytes that a command writes to stdout and stderr, as a process of its own."""
    done = subprocess.run([sys.executable, "-c", code, *map(str, arguments)], capture_output=True, timeout=120)
    return done.returncode, done.stdout, done.stderr


def steering(data: bytes) -> list[str]:
    """The characters in it that a terminal would act on."""
    text = data.decode("utf-8")
    return [
        c for c in text if (c < " " and c != "\n") or "\x7f" <= c <= "\x9f" or c in "\u061c\u200e\u200f\u202e\u2066"
    ]


def part(path: Path, extents: tuple[float, float, float], height: float) -> None:
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation((0, 0, height))
    path.write_bytes(mesh.export(file_type="stl"))


def table(folder: Path) -> Path:
    folder.mkdir(parents=True)
    part(folder / f"{NASTY}.stl", (0.5, 0.5, 0.04), 0.52)
    part(folder / "foot.stl", (0.1, 0.1, 0.5), 0.25)
    return folder


def test_names_of_files_and_parts_in_import(run: Run, tmp_path: Path) -> None:
    """The piece and one of its parts have escape codes in their names; so have the second piece, which is refused."""
    good, bad = table(tmp_path / "in" / f"good{NASTY}"), tmp_path / "in" / f"bad{NASTY}"
    bad.mkdir()
    (bad / f"broken{NASTY}.stl").write_bytes(b"nothing")
    (bad / "foot.stl").write_bytes((good / "foot.stl").read_bytes())
    status, out, err = run(
        "import", "folder", "--no-report", tmp_path / "in", "--out", tmp_path / f"out{NASTY}", "--jobs", "1"
    )
    assert status == 0
    told = (out + err).replace("\rimporting:", "importing:")  # the progress bar's own
    assert steering(told.encode()) == []
    assert r"good\x1b]0;owned\x07\x1b[2Jseat" in told
    assert r"broken\x1b]0;owned" in told
    assert "1 imported, 1 refused" in told
    status, out, err = run("import", "folder", "--no-report", good, "--out", tmp_path / f"one{NASTY}", "--json")
    assert status == 0
    assert steering((out + err).encode()) == []
    assert json.loads(out)["items"][0]["name"] == good.name, "JSON tells the name itself, escaped"
    assert out.count("\n") == 1


def test_names_in_furniture_files(run: Run, tmp_path: Path) -> None:
    folder = storage.save(catalogue.make("three_legged", 3, with_grasps=False), tmp_path / "stool")
    described = folder / "furniture.json"
    document = json.loads(described.read_text())
    document["name"] = f"stool{NASTY}\nerror: all is lost"
    described.write_text(json.dumps(document))
    status, out, err = run("assemble", folder, "--no-film", "--policy", "none", "--out", tmp_path / "a")
    assert status == 0
    assert steering((out + err).encode()) == []
    first = err.splitlines()[0]
    assert first.startswith(r"stool\x1b]0;owned\x07")
    assert r"\nerror: all is lost: 5 parts" in first, "a name cannot make a line of its own"
    document["parts"][0]["name"] = document["parts"][1]["name"] = TITLE
    described.write_text(json.dumps(document))
    status, out, err = run("assemble", folder, "--out", tmp_path / "b")
    assert status == 2
    assert steering((out + err).encode()) == []
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ("assemble", f"laddr{NASTY}"),
        ("import", "folder", f"gone{NASTY}"),
        ("evaluate", "--policy", f"{NASTY}.npz", "--set", "folder:gone"),
        (NASTY,),
        ("assemble", f"--{NASTY}"),
        ("assemble", "--seed", NASTY),
        ("train", "expert", "--set", f"chairs{NASTY}"),
    ],
)
def test_words_of_the_command_line_in_errors(
    run: Run, arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert err
    assert steering(err.encode()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ("assemble", f"no/such/{NASTY}"),
        ("import", "folder", b"gone\xff\x1b".decode(errors="surrogateescape")),
    ],
)
def test_words_of_the_command_line_in_errors_of_a_process(arguments: tuple[str, ...], tmp_path: Path) -> None:
    code = f"import os; os.chdir({str(tmp_path)!r}); from roboassembly.cli import main; main()"
    status, out, err = command(*arguments, code=code)
    assert status == 2
    assert out == b""
    assert err
    assert steering(err) == []


def test_bytes_of_names_that_are_no_text(tmp_path: Path) -> None:
    good = table(tmp_path / "table")
    odd = os.fsencode(tmp_path) + b"/out\xff"
    status, out, err = command("import", "folder", "--no-report", good, "--out", os.fsdecode(odd))
    assert status == 0, err
    assert Path(os.fsdecode(odd + b"/furniture.json")).is_file()
    assert rb"out\udcff" in out + err


def test_crashes_warnings_and_log_messages() -> None:
    code = (
        "import logging, threading, warnings\n"
        "from roboassembly import cli\n"
        "def run(self):\n"
        f"    warnings.warn({NASTY!r})\n"
        f"    logging.getLogger('x').warning('%s', {NASTY!r})\n"
        f"    def fail(): raise ValueError({NASTY!r})\n"
        "    thread = threading.Thread(target=fail)\n"
        "    thread.start()\n"
        "    thread.join()\n"
        f"    raise RuntimeError({NASTY!r})\n"
        "cli.AssembleCommand.run = run\n"
        "cli.main(['assemble'])\n"
    )
    status, out, err = command(code=code)
    assert (status, out) == (1, b"")
    assert steering(err) == []
    told = err.decode()
    assert told.count("\\x1b]0;owned\\x07") >= 4
    assert told.count("Traceback") == 2
    assert "RuntimeError" in told


def test_output_in_an_ascii_terminal(tmp_path: Path) -> None:
    code = "from roboassembly.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "generate", "cantilever", "--out", str(tmp_path / "Stühlchen")],
        capture_output=True, env=os.environ | {"PYTHONIOENCODING": "ascii"}, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert rb"St\xfchlchen" in done.stdout


def test_closed_stdout_is_no_error() -> None:
    shell = f"{sys.executable} -m roboassembly.cli dataset list | true; {sys.executable} -m roboassembly.cli -h | true"
    done = subprocess.run(["bash", "-c", shell], capture_output=True, timeout=60)
    assert done.stderr == b""


def test_only_the_output_module_prints() -> None:
    """All prints of the package are in `cli/output.py`; others would need a reason."""
    root = Path(roboassembly.__file__).parent
    found = [
        f"{path.relative_to(root)}:{node.lineno}"
        for path in sorted(root.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    ]
    assert {place.split(":")[0] for place in found} == {"cli/output.py"}


def test_progress_bars(capsys: pytest.CaptureFixture[str]) -> None:
    bar = output.progress_bar(desc=f"piece {TITLE}", total=2)
    bar.update(2)
    bar.close()
    said = capsys.readouterr().err
    assert "\x1b]" not in said
    assert r"piece \x1b]0;owned\x07" in said


@given(st.text())
def test_text_of_any_kind(text: str) -> None:
    line = output.plain(text)
    assert steering(line.encode("utf-8")) in ([], ["\t"] * text.count("\t"))
    assert len(line.splitlines()) <= 1
    assert output.plain(line) == line
    if text.isprintable():
        assert line == text


@pytest.mark.parametrize("text", ["Stühlchen", "椅子", "کرسی\u200cچوبی", "a\tb", "👩\u200d🔧 chair", "two words"])
def test_ordinary_names_stay_as_they_are(text: str) -> None:
    assert output.plain(text) == text


def test_json_holds_no_control_characters() -> None:
    said = io.StringIO()
    code = "from roboassembly.cli.output import print_json; print_json({'name': '\\x7f\\x1b\\x9b\\u202e'})"
    said.write(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60).stdout)
    assert json.loads(said.getvalue()) == {"name": "\x7f\x1b\x9b\u202e"}
    assert steering(said.getvalue().encode()) == []
