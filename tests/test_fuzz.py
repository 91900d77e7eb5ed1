"""What people hand in, broken in every way: a result, or one clear line. Sources of furniture: `test_import_fuzz`."""

from __future__ import annotations

import copy
import io
import json
import warnings
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from roboassembly.cli import main
from roboassembly.datasets import catalogue
from roboassembly.envs import FULL, OBJECT_CENTRIC
from roboassembly.envs.assembly import AssemblyEnv
from roboassembly.envs.full import FullEnv
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.envs.wrappers import DiscreteActions
from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture import storage
from roboassembly.learning.registry import load_policy
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.task.full.failure import FullVerdict
from roboassembly.task.object_centric.task import ObjectCentricVerdict
from roboassembly.task.plans import plan_file

ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, -(2**31), 2**63, 2**70, 0.5, -0.0, 1e308, -1e-308, "", "a", "../../etc/passwd",
    "\0", "é\u202e", "x" * 5_000, [], [[]], {}, {"a": 1}, [0] * 50, [None], "nan", "1e999",
)  # fmt: skip
WORDS = (
    "", "-1", "0", "1", "nan", "1e999", "-", "--", "..", "/", "/proc/self/mem", "/dev/null", "no_such", "ladder:-1",
    "ladder:x", "ladder:99999999999999999999", "folder:", "folder:/", "chairs-412", "chairs-412:none", "é", "a" * 3_000,
    "{}", "stool", "object-centric", "full", "relational", "[]", "1,2", "\n", "--json", "--help-me",
    "@file", "%s", "$HOME", "*",
)  # fmt: skip


@pytest.fixture(scope="module")
def stool():
    return catalogue.make("stool")


@pytest.fixture(scope="module")
def small_stool():
    return catalogue.make("three_legged", 3)


def nodes(document: Any, above: tuple = ()) -> Iterator[tuple]:
    """Ways to all values in a JSON document."""
    yield above
    inner = (
        document.items() if isinstance(document, dict) else enumerate(document) if isinstance(document, list) else ()
    )
    for key, value in inner:
        yield from nodes(value, (*above, key))


def mutated(document: Any, rng: np.random.Generator) -> Any:
    """A value replaced by an odd one, taken away, or given twice; up to three times."""
    document = copy.deepcopy(document)
    for _ in range(rng.integers(1, 4)):
        ways = [w for w in nodes(document) if w]
        if not ways:
            return document
        *way, last = ways[rng.integers(len(ways))]
        at = document
        for key in way:
            at = at[key]
        match rng.integers(4):
            case 0:
                del at[last]
            case 1 if isinstance(at, list):
                at.insert(int(rng.integers(len(at) + 1)), copy.deepcopy(at[last]))
            case 2 if isinstance(at[last], int | float) and not isinstance(at[last], bool):
                at[last] = at[last] * float(rng.choice([-1.0, 1e-9, 1e9, 1.001])) + float(rng.choice([0.0, 1.0]))
            case _:
                at[last] = copy.deepcopy(ODD[rng.integers(len(ODD))])
    return document


def broken(content: bytes, rng: np.random.Generator) -> bytes:
    """Bytes flipped, cut out, doubled, or the end cut off."""
    out = bytearray(content)
    for _ in range(rng.integers(1, 6)):
        a, b = sorted(rng.integers(0, len(out) + 1, 2).tolist())
        match rng.integers(4):
            case 0 if a < len(out):
                out[a] ^= 1 << int(rng.integers(8))
            case 1:
                del out[a : min(b, a + 40)]
            case 2:
                out[a:a] = out[a : min(b, a + 40)]
            case _ if rng.random() < 0.2:
                del out[a:]
    return bytes(out)


def one_line(error: BaseException) -> None:
    text = str(error)
    assert text
    assert "\n" not in text.strip(), text
    assert len(text) < 12_000


def check_plan(content: bytes, session: AssemblySession) -> None:
    try:
        script = plan_file.decode(content, "plan.json")
        session.repeat(script, lambda _: session.merges < 3)
    except InputError as error:
        one_line(error)
    while session.undo():
        pass


def check_folder(folder: Path) -> None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            furniture = storage.load(folder)
    except FurnitureError as error:
        one_line(error)
        return
    # What passes has to be furniture that can be worked with.
    env = ObjectCentricEnv(furniture)
    _, info = env.reset(seed=0)
    action = np.argwhere(info["action_mask"])[0]
    assert env.step(action)[4]["verdict"] in set(ObjectCentricVerdict)


def check_checkpoint(path: Path, env: ObjectCentricEnv) -> None:
    try:
        policy = load_policy(str(path))
    except InputError as error:
        one_line(error)
        return
    with np.errstate(all="ignore"):
        observation, info = env.reset(seed=0)
        action = policy.act(observation, info["action_mask"])
    assert info["action_mask"][tuple(action)]


def try_plans(count: int, seed: int, stool) -> None:
    rng = np.random.default_rng(seed)
    session = AssemblySession(stool, seed=2)
    session.search(None, lambda _: True)
    whole = plan_file.encode(session.plan())
    while session.undo():
        pass
    document = json.loads(whole)
    for k in range(count):
        content = broken(whole, rng) if k % 2 else json.dumps(mutated(document, rng)).encode()
        check_plan(content, session)


def try_folders(count: int, seed: int, stool, folder: Path) -> None:
    rng = np.random.default_rng(seed)
    storage.save(stool, folder)
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    kept = {p: p.read_bytes() for p in files}
    document = json.loads(kept[folder / storage.FILE_NAME])
    for k in range(count):
        if k % 3:
            (folder / storage.FILE_NAME).write_text(json.dumps(mutated(document, rng)))
        else:
            path = files[rng.integers(len(files))]
            path.write_bytes(broken(kept[path], rng))
        check_folder(folder)
        for path, content in kept.items():
            path.write_bytes(content)


def try_checkpoints(count: int, seed: int, stool, folder: Path) -> None:
    rng = np.random.default_rng(seed)
    whole = (resources.files("roboassembly.learning") / "weights" / "relational.npz").read_bytes()
    env = ObjectCentricEnv(stool, cloud_points=load_policy("relational").cloud_points)
    with np.load(io.BytesIO(whole)) as file:
        arrays = {name: file[name] for name in file.files}
    about = next(n for n, a in arrays.items() if a.dtype == np.uint8 and a.ndim == 1)
    document = json.loads(arrays[about].tobytes())
    path = folder / "policy.npz"
    for k in range(count):
        if k % 3 == 0:
            path.write_bytes(broken(whole, rng))
        else:
            changed = dict(arrays)
            if k % 3 == 1:
                changed[about] = np.frombuffer(json.dumps(mutated(document, rng)).encode(), np.uint8)
            else:
                name = str(rng.choice([n for n in arrays if n != about]))
                match rng.integers(5):
                    case 0:
                        del changed[name]
                    case 1:
                        changed[name] = changed[name][..., :-1]
                    case 2:
                        changed[name] = changed[name].astype(np.complex64)
                    case 3:
                        changed[name] = np.full_like(changed[name], np.nan)
                    case _:
                        changed[f"{name}x"] = changed[name]
            np.savez(path, **changed)
        check_checkpoint(path, env)


def odd_action(rng: np.random.Generator, shape: tuple[int, ...]) -> Any:
    """Something that is no action of an environment with these numbers of choices, or by chance one."""
    match rng.integers(6):
        case 0:
            return copy.deepcopy(ODD[rng.integers(len(ODD))])
        case 1:
            return [copy.deepcopy(ODD[i]) for i in rng.integers(len(ODD), size=len(shape))]
        case 2:
            return rng.integers(-1, 30, tuple(rng.integers(0, 8, rng.integers(0, 3))))
        case 3:
            return rng.uniform(-2.0, 20.0, len(shape)).astype(str(rng.choice(["f2", "f4", "f8", "c8", "U3", "?"])))
        case 4:
            return rng.integers(-(2**62), 2**62, len(shape))
        case _:
            return [int(rng.integers(-1, n + 1)) for n in shape]


def try_actions(count: int, seed: int, env: gymnasium.Env[Any, Any], shape: tuple[int, ...]) -> None:
    """An action is carried out, or it is refused and nothing has happened."""
    rng, own = np.random.default_rng(seed), env.unwrapped
    assert isinstance(own, AssemblyEnv)
    refused, over = 0, True
    for _ in range(count):
        if over:
            env.reset(seed=int(rng.integers(100)))
        state, generator = own.state, own.np_random.bit_generator.state
        action = odd_action(rng, shape)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                _, _, over, _, info = env.step(action)
            except gymnasium.error.InvalidAction as error:
                one_line(error)
                over, refused = False, refused + 1
                assert own.state is state
                assert own.np_random.bit_generator.state == generator
                continue
        assert info["verdict"] in (*ObjectCentricVerdict, *FullVerdict)
    assert refused > count / 2


def try_all_actions(count: int, kind: type[AssemblyEnv[Any, Any, Any]], stool) -> None:
    """`count` actions each: of the class itself, as Gymnasium makes it, and numbered."""
    name = OBJECT_CENTRIC if kind is ObjectCentricEnv else FULL
    envs = (kind(stool), gymnasium.make(name, furniture=stool), DiscreteActions(kind(stool)))  # pyright: ignore[reportCallIssue]
    for seed, env in enumerate(envs):
        try_actions(count, seed, env, tuple(envs[0].action_space.nvec))


def try_arguments(count: int, seed: int, kind: type[AssemblyEnv[Any, Any, Any]], stool) -> None:
    """An environment that can be reset, or one line with the error that Python or Gymnasium has for it."""
    rng = np.random.default_rng(seed)
    names = ("max_parts", "max_points", "cloud_points", "render_mode", "width", "height")
    for _ in range(count):
        arguments = {name: ODD[rng.integers(len(ODD))] for name in rng.choice(names, rng.integers(3), replace=False)}
        furniture: Any = stool if rng.random() < 0.7 else ODD[rng.integers(len(ODD))]
        options = {} if rng.random() < 0.7 else {"furniture": ODD[rng.integers(len(ODD))]}
        try:
            observation, _ = kind(furniture, **arguments).reset(seed=0, options=options)  # pyright: ignore[reportCallIssue]
        except (TypeError, ValueError, InputError, gymnasium.error.UnsupportedMode) as error:
            one_line(error)
        else:
            assert observation["poses"].any()


COMMANDS: dict[str, tuple[str, ...]] = {
    "assemble": ("--setting", "--execution", "--seed", "--out", "--policy", "--no-search", "--no-film", "--film-size",
                 "--json"),
    "import": ("--out", "--scale", "--up", "--jobs", "--no-cache", "--json"),
    "generate": ("--out", "--seed", "--json"),
    "export": ("--out", "--json"),
    "dataset build": ("--seed", "--jobs", "--json"),
    "dataset show": ("--json",),
    "dataset list": ("--json",),
    "evaluate": ("--policy", "--search", "--set", "--limit", "--sample", "--episodes", "--seed", "--jobs", "--setting",
                 "--execution", "--json"),
    "train autoencoder": ("--set", "--out", "--steps", "--seed", "--json"),
    "train expert": ("--set", "--out", "--steps", "--seed", "--jobs", "--json"),
    "train multitask": ("--set", "--out", "--preset", "--rounds", "--seed", "--jobs", "--json"),
    "benchmark": ("--setting", "--real", "--out", "--write", "--seed", "--jobs", "--json"),
    "view": ("--setting", "--seed", "--scale", "--folders", "--host", "--port", "--json"),
}  # fmt: skip
TYPED = ("--seed", "--jobs", "--setting", "--scale", "--steps", "--port", "--limit", "--episodes", "--preset")
"""Options that take a number, or one of a few words."""


def try_command_lines(count: int, seed: int, capsys, monkeypatch, folder: Path) -> None:
    """Every line ends in a value that cannot be right, and so the command at once, with status 2 and what is wrong."""
    rng = np.random.default_rng(seed)
    monkeypatch.chdir(folder)
    for _ in range(count):
        command = str(rng.choice(list(COMMANDS)))
        options = COMMANDS[command]
        words = command.split()
        for _ in range(rng.integers(0, 3)):
            words += [str(rng.choice(options)), str(rng.choice(WORDS))]
        typed = [option for option in options if option in TYPED]
        option = str(rng.choice(typed)) if typed and rng.random() < 0.7 else "--no-such-option"
        words += [option, "x y z"]
        with pytest.raises(SystemExit) as end:
            main(words)
        told = capsys.readouterr()
        assert end.value.code == 2, (words, told)
        assert "Traceback" not in told.err, words
        assert told.err.strip() or told.out.strip(), words
    assert not [p for p in folder.iterdir() if p.suffix != ".npz"], "bad input left something behind"


def slow(*values: Any) -> Any:
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize(("count", "seed"), [(40, 0), slow(150, 0), *(slow(2_500, seed) for seed in range(1, 5))])
def test_broken_plans(count, seed, stool):
    try_plans(count, seed, stool)


@pytest.mark.parametrize(("count", "seed"), [(20, 0), slow(60, 0), *(slow(1_000, seed) for seed in range(1, 5))])
def test_broken_furniture_folders(count, seed, stool, tmp_path):
    try_folders(count, seed, stool, tmp_path / "f")


@pytest.mark.parametrize(("count", "seed"), [(20, 0), slow(60, 0), *(slow(1_000, seed) for seed in range(1, 3))])
def test_broken_checkpoints(count, seed, stool, tmp_path):
    try_checkpoints(count, seed, stool, tmp_path)


@pytest.mark.parametrize("count", [30, slow(100), slow(1_000)])
@pytest.mark.parametrize("kind", [ObjectCentricEnv, FullEnv])
def test_actions_of_every_kind(kind, count, small_stool):
    try_all_actions(count, kind, small_stool)


@pytest.mark.parametrize(("count", "seed"), [(20, 0), slow(60, 0), slow(1_000, 1)])
@pytest.mark.parametrize("kind", [ObjectCentricEnv, FullEnv])
def test_arguments_of_every_kind(kind, count, seed, small_stool):
    try_arguments(count, seed, kind, small_stool)


@pytest.mark.parametrize(("count", "seed"), [(20, 0), slow(60, 0), slow(1_000, 1)])
def test_wrong_command_lines(count, seed, tmp_path, capsys, monkeypatch):
    try_command_lines(count, seed, capsys, monkeypatch, tmp_path)


def test_the_settings_share_three_verdicts():
    assert {str(v) for v in ObjectCentricVerdict} & {str(v) for v in FullVerdict} == {
        "merged",
        "not_an_action",
        "wrong_pair",
    }
