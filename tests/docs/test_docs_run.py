"""Runs the examples of the documentation: each page in its order, in a folder that stands for a fresh clone.

There are two forms. The quick one leaves out films and everything that takes minutes. The slow one runs nearly all, in
a smaller form if it takes hours. The tables below say what is left out or smaller, and why.
"""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import pytest
import trimesh

from documentation import EXTRAS, PAGES, ROOT, Block, Command, can_draw, examples, extras_needed
from model_files import IKEA_PLATE, IKEA_POST, write_ikea_env, write_table
from roboassembly.cli import main
from step_files import step_table, write_step

ALWAYS = [
    (r"make .*", "makes a virtual environment; `test_release.py` installs the package into an empty one"),
    (r"python -m pip install .*", "as above; `test_docs.py` checks that what the lines name exists"),
    (r"python tools/split_real\.py .*|roboassembly train multitask .*--imported .*",
     "real furniture, which is no part of a clone; `test_relational_pipeline.py` trains on an imported piece"),
    (r"roboassembly benchmark", "days; `test_benchmark.py` runs all of it in miniature"),
]  # fmt: skip
"""Patterns of commands that never run here."""
WHEN_QUICK = [
    (r"roboassembly .*--setting full.*", "two robots take their time"),
    (r"roboassembly export trajectory .*", "exports what the commands with two robots plan"),
    (r"roboassembly demos .*", "robots take their time"),
    (r"roboassembly view .*|roboassembly view", "each starts a server; the studio's tests start enough of them"),
    (r"roboassembly train .*", "JAX compiles for half a minute"),
    (r"roboassembly bench .*", "measures for minutes"),
    (r"python examples/.*", "`test_examples.py` runs them in this process"),
    (r"roboassembly evaluate --policy examples/05_masked_ppo\.py.*", "needs PyTorch"),
]
"""Patterns of commands that the quick form leaves out as well."""
RECORDED = "Demonstrations("
"""What blocks contain that read the results of `roboassembly demos`, which the quick form leaves out."""
SMALLER = [
    (r"roboassembly train expert .*", "--limit 1 --jobs 1", "hours for 220 chairs"),
    (r"roboassembly train multitask --preset paper .*", "--steps 20 --jobs 1", "half an hour"),
    (r"roboassembly train multitask --setting full .*",
     "--limit 1 --extra 0 --episodes 1 --steps 2 --round-steps 2 --jobs 1", "a day"),
    (r"roboassembly demos .*", "--episodes 1", "minutes"),
    (r"roboassembly train multitask", "--limit 1 --extra 0 --steps 2 --jobs 1", "hours"),
    (r"roboassembly bench .*", "--quick", "minutes"),
    (r"python examples/05_masked_ppo\.py.*", "--steps 256", "minutes"),
    (r"python examples/06_behaviour_cloning\.py.*", "--starts 1", "minutes"),
    (r"roboassembly evaluate .*--episodes 100|roboassembly evaluate --policy examples/.*", "--episodes 2", "minutes"),
]  # fmt: skip
"""Words added to commands that would take too long as written."""
BRIEFLY = {"assemble": ["--no-film"], "evaluate": ["--jobs", "1"], "import": ["--jobs", "1", "--no-report"]}
"""Words added in the quick form: no film, no report, no further processes."""
EXTRA_MODULES = {"rl": "sb3_contrib", "learn": "jax", "imitation": "sklearn"}
"""A module of each extra that examples need; without it they do not run."""
BUILT = [("three_legged", 3)]
"""Pieces in each split of a built data set; `dataset build` takes 12 minutes and has tests of its own."""


def matches(table: list, command: Command) -> list:
    return [row for row in table if re.fullmatch(row[0], command.text.partition(" >")[0])]


@dataclass
class Reader:
    """Does what a page says."""

    quick: bool
    as_built: Callable[..., list[str]]
    ran: list[str] = field(default_factory=list)
    namespace: dict[str, object] = field(default_factory=dict)

    def read(self, page: str) -> None:
        """Run the whole page in the current folder."""
        for example in examples(page):
            if isinstance(example, Block):
                self._execute(example)
            elif not matches(ALWAYS, example) and not (self.quick and matches(WHEN_QUICK, example)):
                self._run(example)
                self.ran.append(example.text)

    def _execute(self, block: Block) -> None:
        if block.saved:
            Path(block.saved).write_text(block.text)
        if "render_mode" in block.text and not can_draw():
            return
        if self.quick and RECORDED in block.text:
            return
        exec(compile(block.text, str(block), "exec"), self.namespace)

    def _run(self, command: Command) -> None:
        more = [word for row in matches(SMALLER, command) for word in row[1].split()]
        if command.arguments is None:
            assert command.words[0] == "python", command
            if all(find_spec(EXTRA_MODULES[extra]) for extra in extras_needed(command)):
                subprocess.run([sys.executable, *command.words[1:], *more], check=True, timeout=500)
            return
        if "examples/05_masked_ppo.py" in command.words and not find_spec("sb3_contrib"):
            return
        more += BRIEFLY.get(command.arguments[0], []) if self.quick else []
        if command.arguments[:2] == ["dataset", "build"]:
            self.as_built(command.arguments[2], easy=BUILT, hard=BUILT, test=BUILT)
        elif command.arguments[0] == "view":
            visit(command.arguments)
        else:
            run([*command.arguments, *more], command)


def run(words: list[str], command: Command) -> None:
    """Run a command in this process; its output goes to the file that a shell would write, as one JSON object."""
    with contextlib.ExitStack() as stack:
        if command.target:
            stack.enter_context(contextlib.redirect_stdout(stack.enter_context(Path(command.target).open("w"))))
        with pytest.raises(SystemExit) as end:
            main(words)
    assert end.value.code == 0, str(command)
    if command.target:
        assert isinstance(json.loads(Path(command.target).read_text()), dict), str(command)


def visit(words: list[str]) -> None:
    """Start the studio, load its page, and stop it."""
    line = [sys.executable, "-m", "roboassembly.cli", *words, "--no-browser", "--port", "0", "--json"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            address = json.loads(server.stdout.readline())["url"]
            with urllib.request.urlopen(address, timeout=30) as page:
                assert page.status == 200
                assert b"<html" in page.read().lower()
        finally:
            server.terminate()


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the files that examples need: those of a clone and those of a reader; no data set is built."""
    monkeypatch.setenv("ROBOASSEMBLY_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "clone"
    shutil.copytree(ROOT / "examples", folder / "examples", ignore=shutil.ignore_patterns("*.pt", "__pycache__"))
    monkeypatch.chdir(folder)
    write_table(folder / "my_files", unit=0.001, suffixes=("stl", "stl", "stl"))
    parts = [trimesh.load_mesh(path) for path in sorted((folder / "my_files").iterdir())]
    trimesh.util.concatenate(parts).export(folder / "my_chair.stl")
    write_step(folder / "table.step", step_table())
    (folder / "chair_agne_0010").mkdir()
    write_ikea_env(folder / "chair_agne_0010", IKEA_POST, IKEA_PLATE)
    with (folder / "my.npz").open("wb") as out:
        out.write((files("roboassembly.learning") / "weights" / "relational.npz").read_bytes())
    return folder


WITH_EXAMPLES = [page for page in PAGES if examples(page)]
FIRST = ("README.md",)
"""Pages that newcomers open first."""


@pytest.mark.usefixtures("clone")
@pytest.mark.parametrize("page", [pytest.param(p, marks=() if p in FIRST else pytest.mark.slow) for p in WITH_EXAMPLES])
def test_pages_run(page: str, as_built) -> None:
    Reader(True, as_built).read(page)


@pytest.mark.slow
@pytest.mark.usefixtures("clone")
@pytest.mark.parametrize("page", WITH_EXAMPLES)
def test_pages_run_to_the_letter(page: str, as_built) -> None:
    if page == "docs/studio.md":
        run(["assemble", "three_legged:3", "--no-film"], Command(page, 0, "an earlier day"))
    Reader(False, as_built).read(page)


MODULES = {
    "jax": "jax", "optax": "optax", "tensorboardx": "tensorboardX", "matplotlib": "matplotlib", "minari": "minari",
    "pyarrow": "pyarrow", "h5py": "h5py", "scikit-learn": "sklearn",
    "pybullet": "pybullet", "python-fcl": "fcl", "roboplan-core": "roboplan", "roboplan-rrt": "roboplan",
    "sb3-contrib": "sb3_contrib", "ray": "ray", "mcap": "mcap",
    "mcap-ros2-support": "mcap_ros2", "usd-core": "pxr", "franky-control": "franky", "franky-sim": "franky_sim",
}  # fmt: skip
"""Packages of the extras, and the modules they provide."""
WITHOUT = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in sys.argv[1].split(","):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
from roboassembly.cli import main
for line in sys.argv[2:]:
    try:
        main(line.split())
    except SystemExit as end:
        assert end.code == 0, line
"""
"""A script that runs commands where some modules are not installed."""


def test_commands_run_on_the_package_alone(clone: Path, as_built) -> None:
    """Commands that need no extra run without any; the slow form also starts `view`."""
    named = {re.split(r"[\s\[<>=;]", r)[0] for requirements in EXTRAS.values() for r in requirements}
    assert named == MODULES.keys()
    as_built("chairs-24", easy=BUILT, hard=BUILT, test=BUILT)
    page = [e for e in examples("docs/your-own-policy.md") if isinstance(e, Block) and e.saved]
    (clone / "my_policy.py").write_text(page[-1].text)
    lines = (
        "generate three_legged --seed 3 --out made",
        "assemble made --no-film --out played",
        "manual played/plan.json --out printed",
        "stability played/plan.json",
        "import folder my_files --out mine --jobs 1",
        "export mjcf made --out exported",
        "dataset show chairs-24",
        "dataset list",
        "evaluate --set chairs-24:test --jobs 1",
        "evaluate --set chairs-24:test --jobs 1 --policy relational",
        "evaluate --set chairs-24:test --jobs 1 --policy my_policy.py --search --out kept.jsonl",
        "evaluate --set chairs-24:test --jobs 1 --policy relational --setting full",
    )
    here = [c for p in PAGES for c in examples(p) if isinstance(c, Command) and c.arguments and not extras_needed(c)]
    used = {(c.arguments or [""])[0] for c in here}
    assert used <= {line.split()[0] for line in lines} | {"view"}
    subprocess.run(
        [sys.executable, "-c", WITHOUT, ",".join(MODULES.values()), *lines], check=True, timeout=120, cwd=clone
    )


def test_tables_of_exceptions_match_commands() -> None:
    """Every row of the tables matches a command, and every command runs in some form."""
    commands = [e for page in PAGES for e in examples(page) if isinstance(e, Command)]
    for table in (ALWAYS, WHEN_QUICK, SMALLER):
        for row in table:
            assert any(matches([row], c) for c in commands), f"{row[0]}: no such command any more"
            assert row[-1], "why?"
    assert set(BRIEFLY) <= {c.arguments[0] for c in commands if c.arguments}
    slow = [c for c in commands if not matches(ALWAYS, c)]
    assert {c.words[0] for c in slow} == {"roboassembly", "python"}
    assert sum(not matches(WHEN_QUICK, c) for c in slow) > 20
