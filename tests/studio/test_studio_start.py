"""`roboassembly view`: what it is given is read before anything is served, and what is printed at start."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

import shapes
from roboassembly.cli import main
from roboassembly.datasets.catalogue import make
from roboassembly.furniture import storage
from roboassembly.studio.access import Access
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.task.plans import plan_file


def stl_files(place: Path) -> Path:
    return shapes.write_stl(make("stool"), place / "mine", scale=1000.0)


def cut_off(place: Path) -> Path:
    folder = stl_files(place)
    file = sorted(folder.iterdir())[0]
    file.write_bytes(file.read_bytes()[:200])
    return folder


def without_meshes(place: Path) -> Path:
    (place / "mine").mkdir()
    (place / "mine" / "readme.txt").write_text("hello")
    return place / "mine"


def file_of(name: str, content: bytes) -> Callable[[Path], Path]:
    def write(place: Path) -> Path:
        (place / name).write_bytes(content)
        return place / name

    return write


def broken_furniture(place: Path) -> Path:
    storage.save(make("stool"), place / "f")
    (place / "f" / "furniture.json").write_text("{")
    return place / "f"


def plan_of(furniture: str, beside: str | None) -> Callable[[Path], Path]:
    """A plan of one piece, beside another."""

    def write(place: Path) -> Path:
        plan_file.write(AssemblySession(make(furniture)).plan(), place / "plan.json")
        if beside is not None:
            storage.save(make(beside), place / "furniture")
        return place / "plan.json"

    return write


def renamed_plan(place: Path) -> Path:
    path = plan_of("stool", None)(place)
    path.write_bytes(path.read_bytes().replace(b'"stool-0"', b'"sofa-0"'))
    return path


UNUSABLE = {
    "a name": (lambda _: "sofaa", "unknown"),
    "a number": (lambda _: "stool:x", "stool:x"),
    "a path": (lambda place: place / "nowhere", "nowhere"),
    "an empty folder": (lambda place: place, None),
    "a folder without meshes": (without_meshes, "mine"),
    "an STL file cut off": (cut_off, ".stl"),
    "no STL file": (file_of("a.stl", b"solid x\nendsolid x\n"), "a.stl"),
    "no GLB file": (file_of("a.glb", b"nonsense"), "a.glb"),
    "a GLB file cut off": (file_of("a.glb", b"glTF\2\0\0\0\xff\0\0\0"), "a.glb"),
    "a broken furniture folder": (broken_furniture, "furniture.json"),
    "no plan": (file_of("plan.json", b"{}"), "plan.json"),
    "a plan cut off": (file_of("plan.json", b'{"format": '), "plan.json"),
    "a plan that is not there": (lambda place: place / "plan.json", "plan.json"),
    "a plan of other parts": (plan_of("stool", "plank"), "whose parts differ"),
    "a plan without its furniture": (renamed_plan, "furniture"),
}
OPTIONS = {
    "a policy that is not there": (["--policies", "nowhere.py"], "nowhere.py"),
    "a policy of an unknown name": (["--policies", "relationall"], "relationall"),
    "a policy that ends in an error": (["--policies", "{0}/broken.py"], "broken.py"),
    "a policy that is none": (["--policies", "{0}/none.py"], "none.py"),
    "a checkpoint that is none": (["--policies", "relational", "{0}/none.npz"], "none.npz"),
    "a folder that is not there": (["--folders", "{0}/nowhere"], "--folders"),
    "a negative seed": (["--seed", "-1"], "--seed"),
    "no size": (["--scale", "nan"], "--scale"),
    "a size of nothing": (["--scale", "0"], "--scale"),
    "a token that anyone guesses": (["--token", "a"], "--token"),
    "an origin that is none": (["--allow-origin", "studio.example.org"], "--allow-origin"),
    "furniture that robots cannot hold": (["upholstered:25", "--setting", "full"], "no hand can hold"),
    "a host that is none": (["--host", "no.such.host.invalid"], "cannot listen on"),
    "a port that is none": (["--port", "70000"], "--port"),
}  # fmt: skip


@pytest.fixture
def unserved(monkeypatch) -> None:
    def served(*_: object) -> None:
        pytest.fail("something was served")

    monkeypatch.setattr("roboassembly.studio.server.quiet_server", served)


def ends_in_one_line(words: list[str], capsys) -> str:
    with pytest.raises(SystemExit) as end:
        main(["view", *words, "--no-browser"])
    printed = capsys.readouterr()
    assert end.value.code == 2
    assert printed.out == ""
    line, rest = printed.err.split("\n", 1)
    assert line.startswith("error: ")
    assert not rest, printed.err
    return line


@pytest.mark.parametrize("what", UNUSABLE)
def test_furniture_that_cannot_be_used_ends_it_before_anything_is_served(what, tmp_path, capsys, unserved):
    write, named = UNUSABLE[what]
    line = ends_in_one_line([str(write(tmp_path)), "--port", "0"], capsys)
    assert (named or tmp_path.name) in line


@pytest.mark.parametrize("what", OPTIONS)
def test_options_that_cannot_be_used_end_it_before_anything_is_served(what, tmp_path, capsys, unserved):
    (tmp_path / "broken.py").write_text("import nothing_of_that_name\n")
    (tmp_path / "none.py").write_text("x = 1\n")
    (tmp_path / "none.npz").write_bytes(b"nonsense")
    words, named = OPTIONS[what]
    line = ends_in_one_line([*(word.format(tmp_path) for word in words)], capsys)
    assert named in line


@pytest.fixture
def printed(monkeypatch, capsys) -> Callable[[list[str]], tuple[dict, str]]:
    """Starts a studio, ends it as Ctrl-C does, and returns what it printed."""

    def run(words: list[str]) -> tuple[dict, str]:
        class Interrupted:
            def wait(self) -> None:
                raise KeyboardInterrupt

        with monkeypatch.context() as patch, contextlib.suppress(SystemExit):
            patch.setattr("roboassembly.cli.view.threading", SimpleNamespace(Event=Interrupted))
            main(["view", *words, "--no-browser", "--json", "--port", "0"])
        out, err = capsys.readouterr()
        return json.loads(out), err

    return run


def test_the_address_is_printed_with_a_token_only_where_others_can_reach_it(printed):
    result, err = printed([])
    assert result["success"]
    assert result["urls"] == [result["url"]]
    assert result["url"].startswith("http://localhost:")
    assert "token" not in result["url"]
    assert result["url"] in err

    result, err = printed(["--host", "0.0.0.0"])
    for url in result["urls"]:
        assert url in err
        assert len(url.partition("/?token=")[2]) >= 40
    assert result["url"].startswith("http://localhost:")

    result, _ = printed(["--token", "my-own-secret"])
    assert result["url"].endswith("/?token=my-own-secret")


def test_a_machine_is_reached_by_its_address_on_the_network(monkeypatch):
    monkeypatch.setattr("roboassembly.studio.access.network_addresses", lambda: ["192.0.2.7"])
    access = Access("0.0.0.0", "12345678")
    assert access.urls(8080) == ["http://localhost:8080/?token=12345678", "http://192.0.2.7:8080/?token=12345678"]
    assert Access("192.0.2.8", "12345678").urls(8080) == ["http://192.0.2.8:8080/?token=12345678"]
