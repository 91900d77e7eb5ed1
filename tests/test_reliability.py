"""What a long life brings: very many steps, sudden ends at any moment, disks that are full. See docs/reliability.md."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import hashlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import shapes
from roboassembly.audit.object_centric import audit_plan
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.errors import InputError
from roboassembly.furniture import storage
from roboassembly.furniture.model import Furniture
from roboassembly.generate import FAMILIES
from roboassembly.importers import IMPORTERS
from roboassembly.importers.pipeline import finish
from roboassembly.learning import checkpoint
from roboassembly.learning.policy import guide_of
from roboassembly.learning.registry import load_policy
from roboassembly.studio.sources import open_path
from roboassembly.task.plans.plan import Plan

_REAL = (
    ("ikea-manual", "ikea_manuals_at_work", 16),
    ("furniture-bench", "furniture_bench", 8),
    ("ikea-env", "clvrai_furniture", 10),
    ("partnet", "partnet", 5),
)
"""Importers, their folders of samples, and how many pieces of each, where they are there."""
_COMMAND = [sys.executable, "-m", "roboassembly.cli"]


def resident() -> int:
    """Bytes of memory that this process holds, without what the allocator merely has not given back."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def hundred(folder: Path) -> list[tuple[str, Any]]:
    """A hundred pieces of all sources, each made when it is its turn: real ones if there, plain files, generated."""
    out: list[tuple[str, Any]] = []
    samples = Path(os.environ.get("ROBOASSEMBLY_SAMPLES", "/nonexistent"))
    for kind, where, count in _REAL:
        if (samples / where).is_dir():
            importer = IMPORTERS[kind]
            out += [
                (f"{kind} {path.name}", lambda path=path, importer=importer: real(path, importer))
                for path in importer.find(samples / where)[:count]
            ]
    out += [
        (f"folder {family}", lambda family=family: as_files(open_path(f"{family}:1"), folder / family))
        for family in ("stool", "plank", "splat")
    ]
    families = list(FAMILIES)
    for k in range(100 - len(out)):
        name = f"{families[k % len(families)]}:{k // len(families)}"
        out.append((name, lambda name=name: open_path.__wrapped__(name)))
    # Mixed, so that memory early and late is that of like furniture.
    return [out[i] for i in np.random.default_rng(0).permutation(len(out))]


def real(path: Path, importer: Any) -> Furniture:
    """A piece of real furniture; a built-in chair where the importer refuses it."""
    try:
        return finish(path.name, importer.read(path)).furniture
    except InputError:
        return open_path.__wrapped__("stool")


def as_files(furniture: Furniture, folder: Path) -> Furniture:
    """The furniture as someone else's STL files, read again."""
    return open_path.__wrapped__(str(shapes.write_stl(furniture, folder)))


def steps(furniture: Furniture, count: int, seed: int) -> tuple[int, list[str], int]:
    """So many steps: any action, or one that a policy suggests, so that plays go on; every merge audited.

    Returns:
        Merges, after each step the hash of all that was observed, and violations that the audit found.
    """
    rng = np.random.default_rng(seed)
    policy = load_policy("relational")
    guide = guide_of(policy)
    env = ObjectCentricEnv(furniture)
    digest, hashes, merges, violations, records = hashlib.sha256(), [], 0, 0, []
    observation, info = env.reset(seed=seed)
    initial = env.state.part_poses
    for _ in range(count):
        suggestions = guide(env.task, env.state) if rng.random() < 0.5 else ()
        if suggestions:
            action = np.array(suggestions[min(int(rng.integers(3)), len(suggestions) - 1)].action)
        else:
            choices = np.argwhere(info["action_mask"])
            action = choices[rng.integers(len(choices))]
        observation, reward, terminated, truncated, info = env.step(action)
        for value in observation.values():
            assert np.isfinite(value).all()
            digest.update(value.tobytes())
        digest.update(repr((action.tolist(), reward, terminated, info["verdict"])).encode())
        hashes.append(digest.hexdigest())
        if env.last_outcome is not None and env.last_outcome.step is not None:
            records.append(env.last_outcome.step)
            merges += 1
        if terminated or truncated:
            if records:
                plan = Plan(furniture, initial, tuple(records), bool(info["success"]), seed)
                violations += sum(audit_plan(plan).counts.values())
                records = []
            observation, info = env.reset(seed=int(rng.integers(2**31)))
            initial = env.state.part_poses
    return merges, hashes, violations


@pytest.mark.slow
def test_ten_thousand_steps_on_a_hundred_pieces(tmp_path):
    """No exception, no penetration; and once more over all pieces: the same from the same seed, in the same memory."""
    held: list[int] = []
    hashes: list[list[str]] = []
    merges = violations = 0
    for index, (_, make) in enumerate(hundred(tmp_path)):
        found, seen, wrong = steps(make(), 100, index)
        merges, violations = merges + found, violations + wrong
        hashes.append(seen)
        held.append(resident())
    for index, (name, make) in enumerate(hundred(tmp_path)):
        assert steps(make(), 20, index)[1] == hashes[index][:20], name
        held.append(resident())
    early, late = (float(np.median(part)) / 1e6 for part in (held[80:100], held[180:]))
    print(f"10,000 steps, {merges} merges, {violations} violations, memory {early:.0f} and {late:.0f} MB")
    assert merges > 1_000
    assert violations == 0
    assert late < 1.05 * early


# Sudden ends


def started(arguments: list[str], cache: Path) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "ROBOASSEMBLY_CACHE": str(cache), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [*_COMMAND, *arguments], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    )


def whole(folder: Path) -> None:
    """Every file that is not marked as unfinished can be read to the end."""
    for path in folder.rglob("*"):
        if not path.is_file() or path.suffix in (".part", ".tmp") or path.name.startswith("."):
            continue
        if path.suffix == ".npz":
            checkpoint.load(path) if b"meta" in path.read_bytes()[:4000] else np.load(path, allow_pickle=False).close()
        elif path.suffix == ".json":
            json.loads(path.read_bytes())


def killed_again_and_again(arguments: list[str], cache: Path, out: Path, kills: int, longest: float, seed: int) -> int:
    """Run a command, kill it and all its processes at so many random moments, then let it end.

    Where it has ended before its moment came, it starts once more from nothing.

    Returns:
        How often it came to its end in between.
    """
    rng, hits, ends = np.random.default_rng(seed), 0, 0
    kept = {path for path in cache.rglob("*") if path.is_file()}
    while hits < kills:
        process = started(arguments, cache)
        try:
            told = process.communicate(timeout=float(rng.uniform(0.2, longest)))[1].decode()
            assert process.returncode == 0, told
        except subprocess.TimeoutExpired:
            hits += 1
            os.killpg(process.pid, signal.SIGKILL)
            told = process.communicate()[1].decode()
        assert "Traceback" not in told, told
        for folder in (cache, out):
            whole(folder)
        if process.returncode == 0:
            ends += 1
            shutil.rmtree(out, ignore_errors=True)
            for path in (p for p in cache.rglob("*") if p.is_file() and p not in kept):
                path.unlink()
            assert ends < 2 * kills, f"it ends before {longest} s; take shorter moments"
    process = started(arguments, cache)
    told = process.communicate(timeout=900)[1].decode()
    assert process.returncode == 0, told
    whole(out)
    print(f"{' '.join(arguments[:2])}: {hits} kills, {ends} ends in between")
    return ends


@pytest.mark.slow
def test_dataset_build_survives_kills(tmp_path):
    arguments = ["dataset", "build", "chairs-24", "--jobs", "2", "--json"]
    killed_again_and_again(arguments, tmp_path / "a", tmp_path / "a", 15, 12.0, 0)
    subprocess.run(
        [*_COMMAND, *arguments], env={**os.environ, "ROBOASSEMBLY_CACHE": str(tmp_path / "b")}, check=True,
        capture_output=True,
    )  # fmt: skip
    one, two = (json.loads((tmp_path / name / "chairs-24.json").read_bytes()) for name in "ab")
    assert one == two


@pytest.mark.slow
def test_import_survives_kills(tmp_path):
    for k, family in enumerate(("stool", "plank", "ladder", "windsor", "splat", "shell")):
        as_files(open_path(f"{family}:{k}"), tmp_path / "files" / family)
    arguments = [
        "import",
        "folder",
        str(tmp_path / "files"),
        "--out",
        str(tmp_path / "out"),
        "--jobs",
        "2",
        "--force",
        "--json",
    ]
    killed_again_and_again(arguments, tmp_path / "cache", tmp_path / "out", 15, 8.0, 1)
    for folder in sorted((tmp_path / "out").iterdir()):
        storage.load(folder)
    assert len(list((tmp_path / "out").iterdir())) == 6


@pytest.mark.slow
def test_training_survives_kills(tmp_path):
    subprocess.run(
        [*_COMMAND, "dataset", "build", "chairs-24", "--json"], check=True, capture_output=True,
        env={**os.environ, "ROBOASSEMBLY_CACHE": str(tmp_path / "cache")},
    )  # fmt: skip
    out = tmp_path / "out"
    arguments = ["train", "expert", "--set", "chairs-24:easy", "--limit", "2", "--steps", "6000", "--out", str(out)]
    killed_again_and_again([*arguments, "--json"], tmp_path / "cache", out, 10, 40.0, 2)


@pytest.mark.slow
def test_the_benchmark_survives_kills(tmp_path):
    out = tmp_path / "out"
    arguments = ["benchmark", "--quick", "--out", str(out), "--json"]
    killed_again_and_again(arguments, tmp_path / "cache", out, 10, 60.0, 3)
    told = json.loads((out / "benchmark.json").read_bytes())
    assert told["rows"]


# Disks


def limited(largest: int):
    """What a process does before it starts: no file may grow beyond so many bytes, as on a disk that is full."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    return limit


def lines_of(arguments: list[str], cache: Path, largest: int | None = None) -> tuple[int, list[str]]:
    """Exit status and what is said on stderr, progress aside."""
    done = subprocess.run(
        [*_COMMAND, *arguments], capture_output=True, text=True, timeout=300,
        env={**os.environ, "ROBOASSEMBLY_CACHE": str(cache)}, preexec_fn=limited(largest) if largest else None,
    )  # fmt: skip
    said = done.stderr.replace("\r", "\n").splitlines()
    # Ours begins with the word, perhaps behind a progress bar; JAX warns of compiled code that was only half written.
    ours = (re.search(r"(?<![a-z] )error: .*|Traceback.*", line) for line in said)
    return done.returncode, [found[0] for found in ours if found]


@pytest.mark.slow
@pytest.mark.parametrize("largest", [100, 20_000])
def test_full_disk_prints_one_line(largest, tmp_path):
    as_files(open_path("stool"), tmp_path / "files")
    for arguments in (
        ["assemble", "stool", "--no-film", "--out", str(tmp_path / "a")],
        ["generate", "windsor", "--out", str(tmp_path / "g")],
        ["import", "folder", str(tmp_path / "files"), "--out", str(tmp_path / "i"), "--jobs", "1"],
        ["export", "mjcf", "windsor", "--out", str(tmp_path / "x")],
        ["dataset", "build", "chairs-24", "--jobs", "1"],
        ["train", "autoencoder", "--set", "chairs-24:easy", "--steps", "20", "--out", str(tmp_path / "t")],
    ):
        status, lines = lines_of(arguments, tmp_path / "cache", largest)
        if status == 0:  # all that it writes was small enough
            assert largest > 100, arguments
            continue
        assert status in (1, 2), (arguments, lines)
        assert len(lines) <= 1, (arguments, lines)
        assert not lines or lines[0].startswith("error: "), (arguments, lines)


def test_unwritable_folders_give_one_line(tmp_path):
    for command in (["assemble", "stool", "--no-film"], ["generate", "stool"], ["export", "mjcf", "stool"]):
        begun = time.monotonic()
        status, lines = lines_of([*command, "--out", "/proc/no/such"], tmp_path)
        assert status == 2, command
        assert len(lines) == 1, lines
        assert "/proc/no" in lines[0]
        assert time.monotonic() - begun < 60.0
