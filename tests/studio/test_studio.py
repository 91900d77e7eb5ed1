"""The studio without a browser: sessions, what can be opened, and the server that many visit at once."""

from __future__ import annotations

import io
import socket
import stat
import tempfile
import threading
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from viser import _messages

import shapes
from archives import with_members_before_the_start
from plans import plan_digest
from roboassembly.audit.object_centric import audit_plan
from roboassembly.datasets import catalogue
from roboassembly.errors import InputError
from roboassembly.furniture import storage
from roboassembly.learning.policy import guide_of
from roboassembly.learning.registry import load_policy
from roboassembly.solvers.search import solve
from roboassembly.studio import uploads
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.client_session import ClientSession
from roboassembly.studio.messages import attempt_message
from roboassembly.studio.sources import BUILT_IN, Sources, open_path, open_plan
from roboassembly.studio.uploads import open_upload, unpack
from roboassembly.studio.viser_internals import uploads_in_progress
from roboassembly.task.full.failure import FullVerdict
from roboassembly.task.object_centric.task import ObjectCentricVerdict
from roboassembly.task.plans import plan_file
from studio_client import Browser, merges, note_clients, served, until

# Browsers that go away in the middle of something.
pytestmark = pytest.mark.filterwarnings("ignore:Queued a")


@pytest.fixture(scope="module")
def stool():
    return catalogue.make("stool")


def go_on(_) -> bool:
    return True


# A session


def test_a_session_found_by_the_search_is_the_plan_of_the_search(stool):
    session = AssemblySession(stool, seed=3)
    assert session.search(None, go_on) == ""
    assert session.task_state.complete
    assert session.reward == len(stool.parts) - 1 + 4
    assert plan_digest(session.plan()) == plan_digest(solve(stool, 3).plan)


def test_steps_done_one_by_one_with_the_search_s_actions_give_its_plan(stool):
    wanted = solve(stool, 1).plan
    session = AssemblySession(stool, seed=1)
    for step in wanted.steps:
        assert session.attempt(step.action).merged
    assert session.plan().success
    assert len(session.plan().steps) == len(wanted.steps)


def test_undo_goes_back_to_the_state_before_and_can_be_repeated_to_the_start(stool):
    session = AssemblySession(stool, seed=1)
    before = [p.homogeneous for p in session.task_state.part_poses]
    assert session.search(None, go_on) == ""
    merges = session.merges
    for k in range(merges):
        assert session.merges == merges - k
        assert len(session.task_state.groups) == 1 + k
        assert session.undo()
    assert not session.undo()
    np.testing.assert_array_equal([p.homogeneous for p in session.task_state.part_poses], before)
    assert session.reward == 0.0


def test_a_failure_changes_nothing_but_the_counts(stool):
    session = AssemblySession(stool, seed=1)
    legs = [i for i, p in enumerate(stool.parts) if p.name.startswith("leg")]
    tried = session.attempt((legs[0], legs[1], 0, 0, 0))
    assert tried.verdict == ObjectCentricVerdict.WRONG_PAIR
    assert (session.merges, session.failures, session.reward) == (0, 1, 0.0)
    assert len(session.task_state.groups) == len(stool.parts)
    assert "do not belong together" in attempt_message(stool, tried)


def test_search_finishes_a_manual_start_and_passes_the_audit(stool):
    session = AssemblySession(stool, seed=5)
    guide = guide_of(load_policy("relational"))
    for _ in range(3):
        action = session.suggestion(guide)
        assert action is not None
        session.attempt(action)
    by_hand = session.merges
    assert by_hand > 0
    assert session.search(guide, go_on) == ""
    assert session.merges == len(stool.parts) - 1
    assert sum(audit_plan(session.plan()).counts.values()) == 0


def test_stopped_search_reports_and_keeps_the_state(stool):
    session = AssemblySession(stool, seed=1)
    seen = []

    def three(standing) -> bool:
        seen.append(standing.attempts)
        return len(seen) < 3

    reason = session.search(None, three)
    assert reason.startswith("stopped after 2 merges")
    assert seen == [0, 1, 2]
    assert session.merges == 0
    assert session.search(None, go_on) == ""


def test_saved_plan_is_repeated_bit_for_bit(stool, tmp_path):
    session = AssemblySession(stool, seed=9)
    session.search(None, go_on)
    plan_file.write(session.plan(), tmp_path / "plan.json")
    storage.save(stool, tmp_path / "furniture")
    script, furniture = open_plan(tmp_path / "plan.json")
    again = AssemblySession(furniture, script.setting, script.seed)
    assert again.repeat(script, go_on) == ""
    assert plan_file.encode(again.plan()) == (tmp_path / "plan.json").read_bytes()
    with pytest.raises(InputError, match="whose parts differ"):
        AssemblySession(catalogue.make("plank")).repeat(script, go_on)
    with pytest.raises(InputError, match="setting"):
        AssemblySession(stool, "full").repeat(script, go_on)


def test_a_plan_without_its_furniture_is_found_by_name_or_refused(stool, tmp_path):
    session = AssemblySession(stool, seed=9)
    content = plan_file.encode(session.plan())
    (tmp_path / "plan.json").write_bytes(content)
    assert open_plan(tmp_path / "plan.json")[1].name == "stool-0"
    (tmp_path / "plan.json").write_bytes(content.replace(b'"stool-0"', b'"sofa-0"'))
    with pytest.raises(InputError, match="put its furniture folder at"):
        open_plan(tmp_path / "plan.json")


def test_robots_are_asked_for_grasps_and_furniture_they_cannot_hold_is_refused(stool):
    session = AssemblySession(stool, "full", 0)
    assert [name for name, _ in session.choices()] == ["g_a", "g_b"]
    with pytest.raises(InputError, match="negative"):
        AssemblySession(stool, seed=-1)
    with pytest.raises(InputError, match="no hand can hold"):
        AssemblySession(catalogue.make("upholstered", 25), "full")


def test_every_verdict_has_a_text(stool):
    session = AssemblySession(stool, seed=1)
    base = session.attempt((0, 1, 0, 0, 0))
    for verdict in {*map(str, ObjectCentricVerdict), *map(str, FullVerdict)} - {"merged"}:
        text = attempt_message(stool, type(base)(base.action, verdict, "lift", 5, 0.001))
        assert verdict.replace("_", " ") in text
        assert "Nothing moved" in text


# What can be opened


def test_all_sources_open(stool, tmp_path):
    storage.save(stool, tmp_path / "mine" / "a")
    own = Sources((tmp_path / "mine",))
    pieces = own.pieces()
    assert pieces[BUILT_IN]
    folder = f"folder:{tmp_path / 'mine'}"
    assert pieces[folder] == ["a"]
    assert len(own.open(folder, "a").parts) == len(stool.parts)
    assert own.open(BUILT_IN, "stool", 2).name == "stool-2"
    for source, piece in ((folder, "b"), ("folder:/etc", "a"), (BUILT_IN, "../a")):
        with pytest.raises(InputError):
            own.open(source, piece)


def mesh_folder(furniture, folder: Path) -> Path:
    """Plain STL files of the assembled parts, in millimetres."""
    return shapes.write_stl(furniture, folder, scale=1000.0)


def zipped(files: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return out.getvalue()


@pytest.mark.slow
def test_a_folder_of_stl_files_opens_as_it_is_and_as_an_archive(stool, tmp_path):
    folder = mesh_folder(stool, tmp_path / "my_stool")
    direct = open_path(str(folder))
    assert len(direct.parts) == len(stool.parts)
    files = {f"my_stool/{p.name}": p.read_bytes() for p in folder.iterdir()}
    brought = open_upload("my_stool.zip", zipped(files))
    assert [p.name for p in brought.parts] == [p.name for p in direct.parts]
    assert brought.name == "my_stool"
    session = AssemblySession(brought)
    assert session.search(None, go_on) == ""


def test_a_furniture_folder_comes_back_whole_from_an_archive(stool, tmp_path):
    storage.save(stool, tmp_path / "f")
    files = {str(p.relative_to(tmp_path)): p.read_bytes() for p in (tmp_path / "f").rglob("*") if p.is_file()}
    again = open_upload("f.zip", zipped(files))
    assert [len(p.points) for p in again.parts] == [len(p.points) for p in stool.parts]


@pytest.mark.parametrize(
    "entry", ["../evil.stl", "a/../../evil.stl", "/etc/evil.stl", "..\\evil.stl", "C:\\evil.stl", "a/b/../../../x.stl"]
)
def test_entries_that_would_lie_elsewhere_are_refused_and_nothing_is_written(entry, tmp_path):
    (tmp_path / "up").mkdir()
    with pytest.raises(InputError, match="would lie outside"):
        unpack("a.zip", zipped({entry: b"solid x\nendsolid x\n"}), tmp_path / "up")
    assert [p.name for p in tmp_path.rglob("*") if p.is_file()] == []


def test_links_in_archives_are_refused(tmp_path):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        entry = zipfile.ZipInfo("passwd.stl")
        entry.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(entry, "/etc/passwd")
    with pytest.raises(InputError, match="would lie outside"):
        unpack("a.zip", out.getvalue(), tmp_path)


@pytest.mark.parametrize("name", ["", ".", "..", "a/..", "x\0.glb"])
def test_invalid_names_are_refused(name, tmp_path):
    with pytest.raises(InputError, match="not a valid file name"):
        unpack(name, b"", tmp_path)


def test_only_the_last_component_of_a_name_counts(tmp_path):
    where = unpack("../../../etc/chair.glb", b"x", tmp_path)
    assert (where / "chair.glb").read_bytes() == b"x"
    assert where.parent == tmp_path


@pytest.mark.parametrize(
    "content",
    [
        b"", b"PK\x03\x04nonsense", b"\0" * 100, zipped({"a.stl": b"solid"})[:-30],
        with_members_before_the_start(zipped({"a.stl": b"solid"})),
    ],
    ids=range(5),
)  # fmt: skip
def test_broken_archives_give_one_line(content, tmp_path):
    with pytest.raises(InputError, match="not a readable ZIP archive"):
        unpack("a.zip", content, tmp_path)


def test_archives_that_unpack_to_too_much_are_refused(monkeypatch, tmp_path):
    bomb = zipped({"a.stl": bytes(2_000_000)})
    assert len(bomb) < 10_000
    monkeypatch.setattr(uploads, "LARGEST_UPLOAD", 1_000_000)
    with pytest.raises(InputError, match="unpacks to more than"):
        unpack("a.zip", bomb, tmp_path)
    with pytest.raises(InputError, match="at most"):
        unpack("a.glb", bytes(2_000_000), tmp_path)
    monkeypatch.setattr(uploads, "MOST_FILES", 3)
    with pytest.raises(InputError, match="contains 4 files"):
        unpack("b.zip", zipped({f"{i}.stl": b"" for i in range(4)}), tmp_path)


def test_uploads_without_furniture_leave_no_files(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for name, content in (("a.zip", zipped({"readme.txt": b"hello"})), ("a.glb", b"nonsense"), ("a.stl", b"solid")):
        with pytest.raises(InputError) as error:
            open_upload(name, content)
        assert str(tmp_path) not in str(error.value)
        assert not list(tmp_path.iterdir())


# The server


@pytest.fixture
def clients(monkeypatch) -> list[ClientSession]:
    return note_clients(monkeypatch)


@pytest.mark.parametrize("count", [3, *(pytest.param(n, marks=pytest.mark.slow) for n in (8, 50))])
def test_visitors_each_have_a_session_of_their_own(count, clients):
    threads = threading.active_count()
    with served() as server:
        browsers = [Browser(server) for _ in range(count)]
        until(lambda: len(clients) == count and all(merges(v) == 0 for v in clients))
        last = min(7, count - 1)
        for k in (0, last):
            browsers[k].press(clients[k].panel.suggest)
            browsers[k].press(clients[k].panel.join)
        until(lambda: merges(clients[0]) == merges(clients[last]) == 1)
        assert sum(merges(v) for v in clients) == 2
        for browser in browsers:
            browser.connection.close()
        until(lambda: not any(v.is_running for v in clients))
    until(lambda: threading.active_count() <= threads + 2)


def test_a_whole_assembly_by_buttons_then_undo(clients, stool):
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and merges(clients[0]) == 0)
        panel = clients[0].panel
        browser.press(panel.join)
        until(lambda: "choose a point" in panel.message.content)
        browser.press(panel.runs["guided"])
        until(lambda: merges(clients[0]) == len(stool.parts) - 1)
        until(lambda: panel.message.content.startswith("✓ Assembled"))
        assert f"{len(stool.parts) - 1} of {len(stool.parts) - 1} merges" in panel.status.content
        browser.press(panel.undo)
        until(lambda: merges(clients[0]) == len(stool.parts) - 2)
        assert not panel.undo.disabled


def test_full_plan_loads_on_furniture_without_grasps(clients, stool):
    content = plan_file.encode(AssemblySession(stool, "full", seed=3).plan())
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and merges(clients[0]) == 0)
        assert clients[0].session is not None
        assert not any(part.grasps for part in clients[0].session.furniture.parts)
        browser.upload(clients[0], "plan.json", len(content), [content])
        until(lambda: clients[0].session is not None and clients[0].session.setting == "full")
        assert clients[0].session.seed == 3
        assert all(part.grasps for part in clients[0].session.furniture.parts)


@pytest.mark.slow
def test_a_step_is_shown_soon(clients, stool):
    """From the button to the new state and the first frame of the way there."""
    seconds = []
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and merges(clients[0]) == 0)
        panel = clients[0].panel
        for merge in range(len(stool.parts) - 1):
            browser.press(panel.suggest)
            until(lambda: "The policy suggests this action" in panel.message.content)
            there, begun = f" {merge + 1} of {len(stool.parts) - 1} merges", time.monotonic()
            browser.press(panel.join)
            until(lambda there=there: there in panel.status.content, every=0.002)
            seconds.append(time.monotonic() - begun)
            until(lambda: panel.time.value == panel.time.max)
    print(f"a step: median {np.median(seconds):.3f} s, at most {max(seconds):.3f} s")
    assert np.median(seconds) < 1.0


def test_uploaded_plan_is_repeated_on_the_furniture_shown(clients, stool):
    other = AssemblySession(stool, seed=4)
    other.search(None, go_on)
    content = plan_file.encode(other.plan())
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and merges(clients[0]) == 0)
        browser.upload(clients[0], "plan.json", len(content), [content])
        until(lambda: clients[0].panel.message.content.startswith("✓ Repeated the plan"))
        assert clients[0].session is not None
        assert clients[0].session.seed == clients[0].panel.seed.value == 4
        assert plan_file.encode(clients[0].session.plan()) == content
        browser.upload(clients[0], "plan.json", 7, [b"{}     "])
        until(lambda: "is no plan" in clients[0].panel.message.content)
        assert merges(clients[0]) == len(stool.parts) - 1


def test_a_long_search_is_cancelled(clients, monkeypatch):
    begun, slow = threading.Event(), AssemblySession.search

    def search(self, guide, watch):
        def watched(standing):
            begun.set()
            time.sleep(0.05)
            return watch(standing)

        return slow(self, guide, watched)

    monkeypatch.setattr(AssemblySession, "search", search)
    with served(furniture="ladder") as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and merges(clients[0]) == 0)
        panel = clients[0].panel
        browser.press(panel.runs["search"])
        assert begun.wait(20)
        assert panel.join.disabled
        browser.press(panel.cancel)
        until(lambda: "stopped" in panel.message.content)
        assert merges(clients[0]) == 0
        assert not panel.join.disabled


def test_uploads_are_opened_and_those_too_large_are_forgotten(clients, stool, tmp_path, monkeypatch):
    folder = mesh_folder(stool, tmp_path / "brought")
    content = zipped({p.name: p.read_bytes() for p in folder.iterdir()})
    monkeypatch.setattr("roboassembly.studio.incoming.LARGEST_UPLOAD", len(content))
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and merges(clients[0]) == 0)
        kept = uploads_in_progress(clients[0].handle)
        # Too large by what it says; by what comes, whatever it says; and one that is neither.
        browser.upload(clients[0], "a.zip", len(content) + 1, [b"x"])
        browser.upload(clients[0], "a.zip", 10, [bytes(len(content)), b"x", b"y"])
        browser.upload(clients[0], "../brought.zip", len(content), [content[:100], content[100:]])
        until(lambda: clients[0].session is not None and clients[0].session.furniture.name == "brought")
        assert not kept


def test_only_the_page_is_served_and_no_tunnel_opened(clients):
    with served() as server:
        for path in (
            "/../../../../etc/passwd",
            "/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
            "//etc/passwd",
            "/..%2f..%2fetc/passwd",
        ):
            with socket.create_connection(("127.0.0.1", server.get_port())) as raw:
                raw.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
                answer = b"".join(iter(lambda: raw.recv(65536), b""))
            assert b"200 OK" not in answer.split(b"\r\n", 1)[0], path
            assert b"root:" not in answer
        browser = Browser(server)
        until(lambda: len(clients) == 1)
        browser.send(_messages.ShareUrlRequest())
        time.sleep(0.3)
        assert server._share_tunnel is None


def test_folders_are_opened_by_name_only_where_a_root_was_given(clients, tmp_path):
    for roots in ((), (tmp_path,)):
        clients.clear()
        with served(roots=roots) as server:
            browser = Browser(server)
            until(lambda: len(clients) == 1)
            assert (clients[0].panel.path is not None) == bool(roots)
            browser.connection.close()


def test_unusable_addresses_print_one_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputError, match="cannot listen on"), served(taken.getsockname()[1]):
            pass
    with pytest.raises(InputError, match="--port 70000"), served(70_000):
        pass
    for host in ("no.such.host.invalid", "a" * 70 + ".invalid"):
        with pytest.raises(InputError, match="cannot listen on"), served(host=host):
            pass
