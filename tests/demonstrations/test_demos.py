"""`roboassembly demos`: planned, carried out, recorded; repeated, stopped, continued."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from gymnasium.error import InvalidAction

from command_line import Run
from demonstrations.made_up import contents
from roboassembly.cli import main
from roboassembly.control.controls import CONTROLS
from roboassembly.control.env import ControlEnv
from roboassembly.demonstrations import recording
from roboassembly.demonstrations.collect import Collection
from roboassembly.demonstrations.config import DemoConfig
from roboassembly.demonstrations.feature_statistics import of_histograms, of_rows
from roboassembly.demonstrations.recording import DemoPiece
from roboassembly.demonstrations.replay import Demonstrations
from roboassembly.demonstrations.staging import DemoFolder, new_part
from roboassembly.errors import ArgumentError, InputError

pq = pytest.importorskip("pyarrow.parquet")
PIECE = "three_legged:3"
FIRST_MERGE = ("--task", "merge", "--merge", "0")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One merge without cameras."""
    folder = tmp_path_factory.mktemp("demos") / "out"
    with pytest.raises(SystemExit) as stop:
        main(["demos", PIECE, *FIRST_MERGE, "--episodes", "1", "--out", str(folder)])
    assert stop.value.code == 0
    return folder


def test_a_recorded_merge_repeats_from_its_seed(recorded: Path) -> None:
    demos = Demonstrations(recorded)
    (record,) = demos.episodes
    assert (record.furniture, record.merge) == (PIECE, 0)
    assert list(demos.replay()) == [True]
    frames = pq.read_table(recorded / "data/chunk-000/file-000.parquet")
    assert frames.num_rows == record.frames
    assert frames.column("next.success").to_pylist() == [False] * (record.frames - 1) + [True]
    assert sum(frames.column("next.reward").to_pylist()) == 1.0
    assert record.task == "Join leg back right to stretcher."
    # Half of the numbers of an action are R_a's; both robots took part.
    assert (np.abs(demos.actions(0)).max(axis=0) > 0.05).reshape(2, 11).any(axis=1).all()


def test_actions_of_another_kind_do_not_repeat(recorded: Path) -> None:
    demos = Demonstrations(recorded)
    good = demos.actions(0).copy()
    demos.actions(0)[3] = np.nan
    with pytest.raises(InvalidAction, match=r"action\[0\] \(a/x\) is nan"):
        list(demos.replay())
    demos.actions(0)[:] = 0.0
    assert list(demos.replay()) == [False]
    demos.actions(0)[:] = good
    short = Demonstrations(recorded)
    short._episodes[0] = (short.episodes[0], good[:, :4])
    with pytest.raises(InvalidAction, match=r"has shape \(4,\); expected 22 numbers"):
        list(short.replay())


def test_the_same_command_again_adds_nothing(recorded: Path, run: Run) -> None:
    before = contents(recorded)
    options = ("demos", PIECE, *FIRST_MERGE, "--episodes", "1", "--out", recorded)
    status, out, _ = run(*options)
    assert (status, out) == (0, f"{recorded}: 1 episode; recorded now: 0, with 0 frames\n")
    status, out, _ = run(*options, "--json")
    report = json.loads(out)
    assert (status, report["episodes"], report["recorded"]) == (0, 1, 0)
    assert contents(recorded) == before


BAD = (
    (("--width", "0"), "--width 0 is too small; it must be 1 or more"),
    (("--episodes", "0"), "--episodes 0 is too small; it must be 1 or more"),
    (("--cameras", "overview", "--height", "33"), "picture size 128 x 33: H.264 needs an even width and height"),
    (("--cameras", "overview", "--width", "100000"), "width and height must be between 1 and 8192 pixels"),
    (("--cameras", "overview", "overview"), "camera 'overview' is named twice"),
    (("--depth",), "depth needs cameras; name at least one"),
    (("--merge", "2"), "merge is 2; expected 0 or more, with the task 'merge' only"),
    (("--task", "merge", "--merge", "9"), "three_legged-3 has no merge 9; expected 0 to 3"),
    (("--layout", "-1"), "--layout -1 is too small; it must be 0 or more"),
    (("--layout", "9999999999"), "layout is 9999999999; expected an integer from 0 to 2147483647"),
    (("--part-position", "0.5"), "part_position is 0.5; expected a number from 0 to 0.02"),
    (("--randomize", "nan"), "randomize is nan; expected a number from 0 to 1"),
    (("--set", "chairs-24"), "a piece of furniture and --set exclude each other"),
)


@pytest.mark.parametrize(("options", "message"), BAD)
def test_bad_input_is_one_line(options: tuple[str, ...], message: str, run: Run, tmp_path: Path) -> None:
    status, out, err = run("demos", PIECE, *options, "--out", tmp_path / "out")
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_set_that_is_not_built_and_an_unknown_camera(run: Run, tmp_path: Path) -> None:
    status, _, err = run("demos", "--set", "chairs-412:train", "--out", tmp_path / "out")
    assert (status, err) == (
        2, "error: data set 'chairs-412' is not built yet; run: roboassembly dataset build chairs-412\n",
    )  # fmt: skip
    status, _, err = run("demos", PIECE, "--cameras", "wrist_c", "--out", tmp_path / "out")
    assert status == 2
    assert "'wrist_a', 'wrist_b', 'overview', 'overview_back'" in err


def test_a_folder_with_something_else_is_left_alone(recorded: Path, run: Run, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    status, _, err = run("demos", PIECE, "--out", tmp_path)
    assert (status, err) == (2, f"error: '{tmp_path}' exists and holds no demonstrations; choose another --out\n")
    status, _, err = run("demos", PIECE, "--task", "merge", "--control", "joint_position", "--out", recorded)
    assert status == 2
    assert err == (
        f'error: \'{recorded}\' holds episodes with control "joint_delta", not "joint_position"; choose another --out\n'
    )


def test_two_commands_do_not_write_to_one_folder(tmp_path: Path) -> None:
    with DemoFolder(tmp_path, {"seed": 0}).open():
        with pytest.raises(InputError, match="another command writes to"), DemoFolder(tmp_path, {"seed": 0}).open():
            pass
        with new_part(tmp_path, 0):
            pass
    # Nothing was recorded, so nothing stays.
    assert not tmp_path.exists()


def test_what_a_killed_process_left_half_written_is_not_taken(tmp_path: Path) -> None:
    half = tmp_path / ".staging" / "episode-000000.part"
    half.mkdir(parents=True)
    (half / "numbers.npz").write_bytes(b"PK")
    (half.parent / ".file-000.17.parquet").write_bytes(b"PAR1")
    with DemoFolder(tmp_path, {"seed": 0}).open() as folder:
        assert [entry.name for entry in half.parent.iterdir()] == ["lock"]
        assert list(folder.staged()) == []


def test_one_layout_is_part_of_the_description(tmp_path: Path) -> None:
    """Starts of one layout differ by the ranges, the planner's seed not at all; older data sets have no layout."""
    config = DemoConfig(task="merge", merge=0, layout=1, part_position=0.02, randomize=0.5, seed=7)
    ranges = config.randomization()
    assert (ranges.part_position, ranges.part_angle, ranges.lighting) == (0.02, 0.025, 0.5)
    assert (config.planner_seed(3), DemoConfig().planner_seed(3)) == (7, 3)
    env = config.make_env(DemoPiece(PIECE).furniture(), 5, pictures=False)
    first, second = (env.reset(seed=seed, options=config.reset_options())[0]["parts"] for seed in (0, 1))
    assert 0.0 < np.abs(first[:, :3] - second[:, :3]).max() < 0.1
    assert DemoConfig(task="merge").env_arguments(5).get("layout") is None
    description = {"format": "lerobot", "max_parts": 5, **config.to_json()}
    (tmp_path / "demos.json").write_text(json.dumps(description))
    assert Demonstrations(tmp_path).config == config
    for name in ("layout", "part_position", "part_angle"):
        del description[name]
    (tmp_path / "demos.json").write_text(json.dumps(description))
    assert Demonstrations(tmp_path).config.layout is None


def test_a_broken_description_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no valid demos.json"):
        Demonstrations(tmp_path)
    (tmp_path / "demos.json").write_text('{"format": "zarr"}')
    with pytest.raises(InputError, match=r"demos.json' is not valid"):
        Demonstrations(tmp_path)
    with pytest.raises(ArgumentError, match="control is 'fast'"):
        DemoConfig(control="fast")  # pyright: ignore[reportArgumentType]


def test_statistics_of_rows_and_of_histograms_agree() -> None:
    values = np.random.default_rng(0).integers(0, 7, 400)
    rows, levels = of_rows(values), np.arange(7.0)
    counted = of_histograms(np.bincount(values, minlength=7)[None], levels, 400)
    for name in ("min", "max", "mean", "std"):
        assert counted[name].shape == (1, 1, 1)
        assert counted[name].item() == pytest.approx(rows[name].item())
    ordered = np.sort(values)
    assert counted["q50"].item() == ordered[199]
    assert counted["q99"].item() == ordered[395]


class Waving:
    """Demonstrator that moves a little for thirty steps."""

    failure = ""

    def __init__(self, *_: object) -> None:
        pass

    def actions(self):
        yield from 0.2 * np.random.default_rng(0).uniform(-1.0, 1.0, (30, 22)).astype(np.float32)


@pytest.mark.usefixtures("drawing")
def test_pictures_are_those_of_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An episode of thirty steps that counts as a success; HDF5 keeps all pixels."""
    h5py = pytest.importorskip("h5py")
    step = ControlEnv.step

    def succeeding(env: ControlEnv, action: np.ndarray):
        *some, info = step(env, action)
        return *some, info | {"is_success": True}

    monkeypatch.setattr(recording, "Demonstrator", Waving)
    monkeypatch.setattr(ControlEnv, "step", succeeding)
    config = DemoConfig(task="merge", cameras=("overview",), width=32, height=24, depth=True, randomize=0.5)
    (record,) = Collection(tmp_path / "out", "hdf5", [DemoPiece(PIECE)], "", config, 5).record(1, 1)
    assert record is not None
    env = config.make_env(DemoPiece(PIECE).furniture(), 5)
    observation, _ = env.reset(seed=record.seed)
    with h5py.File(tmp_path / "out" / "demos.hdf5") as file:
        obs = file["data/demo_0/obs"]
        for frame, action in enumerate(Waving().actions()):
            np.testing.assert_array_equal(obs["overview_image"][frame], observation["rgb_overview"])
            np.testing.assert_array_equal(obs["overview_depth"][frame, ..., 0], observation["depth_overview"])
            np.testing.assert_array_equal(obs["state"][frame], observation["robots"].ravel())
            observation, *_ = env.step(action)
        np.testing.assert_array_equal(file["data/demo_0/next_obs/state"][-1], observation["robots"].ravel())
    env.close()


# Slow: many episodes


@pytest.mark.slow
@pytest.mark.usefixtures("drawing")
def test_a_merge_with_cameras(tmp_path: Path, run: Run) -> None:
    """The robots move in the videos, and the checker finds the videos sound."""
    pytest.importorskip("lerobot_doctor")
    from lerobot_doctor.dataset_loader import load_dataset
    from lerobot_doctor.runner import run_checks

    out = tmp_path / "out"
    options = ("--cameras", "wrist_a", "overview", "--width", "32", "--height", "24", "--jobs", "1")
    assert run("demos", PIECE, *FIRST_MERGE, *options, "--episodes", "1", "--out", out)[0] == 0
    info = json.loads((out / "meta/info.json").read_text())
    assert info["features"]["observation.images.wrist_a"]["shape"] == [24, 32, 3]
    report = run_checks(load_dataset(str(out)))
    assert report.overall_severity.value != "FAIL", report.results
    (videos,) = [result for result in report.results if result.name == "Video Integrity"]
    assert videos.severity.value == "PASS", videos
    spread = json.loads((out / "meta/stats.json").read_text())["observation.images.overview"]["std"]
    assert min(np.ravel(spread)) > 0.02


@pytest.mark.slow
@pytest.mark.parametrize("control", CONTROLS)
def test_twenty_replays(control: str, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    options = ("--task", "merge", "--control", control, "--randomize", "0.5", "--json")
    status, printed, _ = run("demos", PIECE, *options, "--episodes", "20", "--out", out)
    assert status == 0
    report = json.loads(printed)
    assert report["recorded"] == 20
    assert report["planned"] <= 21, report
    assert sum(Demonstrations(out).replay()) == 20


def command(out: Path, *options: str) -> list[str]:
    return [sys.executable, "-m", "roboassembly.cli", "demos", PIECE, *FIRST_MERGE, *options, "--out", str(out)]


@pytest.mark.slow
@pytest.mark.parametrize("format", ["lerobot", "hdf5"])
def test_a_killed_command_continues_to_the_same_result(format: str, tmp_path: Path) -> None:
    """Killed once two of four episodes are there, with two processes, then continued with one: the same bytes."""
    options = ("--format", format, "--episodes", "4")
    subprocess.run(command(tmp_path / "whole", *options, "--jobs", "1"), check=True, capture_output=True)
    stopped = tmp_path / "stopped"
    process = subprocess.Popen(
        command(stopped, *options, "--jobs", "2"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    done = ("data/chunk-000/*.parquet", ".staging/episode-??????")
    begun = time.monotonic()
    while sum(len(list(stopped.glob(pattern))) for pattern in done) < 2:
        assert process.poll() is None
        assert time.monotonic() - begun < 240.0
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    with (stopped / ".staging/lock").open("w") as lock:
        for _ in range(100):  # workers end with their parent
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except OSError:
                time.sleep(0.1)
    subprocess.run(command(stopped, *options, "--jobs", "1"), check=True, capture_output=True)
    whole, again = contents(tmp_path / "whole"), contents(stopped)
    assert whole.keys() == again.keys()
    if format == "lerobot":
        assert whole == again
    else:  # HDF5 notes times
        for mine, theirs in zip(*(Demonstrations(p)._episodes for p in (tmp_path / "whole", stopped)), strict=True):
            assert mine[0] == theirs[0]
            np.testing.assert_array_equal(mine[1], theirs[1])


@pytest.mark.slow
def test_a_full_disk_is_one_line_and_nothing_is_lost(tmp_path: Path) -> None:
    """A limit on the size of files stands for the end of the disk."""
    out = tmp_path / "out"
    line = " ".join(command(out, "--episodes", "1", "--jobs", "1"))
    limited = subprocess.run(["bash", "-c", f"ulimit -f 20; {line}"], capture_output=True, text=True, check=False)
    assert limited.returncode == 1
    assert limited.stderr.splitlines()[-1].startswith("error: cannot write ")
    assert "Traceback" not in limited.stderr
    subprocess.run(command(out, "--episodes", "1", "--jobs", "1"), check=True, capture_output=True)
    assert len(Demonstrations(out).episodes) == 1


READ = """
import sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
dataset = LeRobotDataset("local/demos", root=sys.argv[1], delta_timestamps={"action": [0.0, 0.05]})
print(dataset.num_episodes, dataset.num_frames, dataset.fps, *dataset.meta.depth_keys)
for index in (0, dataset.num_frames - 1):
    item = dataset[index]
    print(item["action"].shape, item["observation.images.overview"].shape, item["task"])
    depth = item["observation.images.overview_depth"]
    print(depth.shape, 300.0 < float(depth.min()) < float(depth.max()) <= 10000.0, bool(item["next.success"]))
"""


@pytest.mark.slow
@pytest.mark.usefixtures("drawing")
@pytest.mark.skipif("LEROBOT_PYTHON" not in os.environ, reason="LEROBOT_PYTHON names a Python with LeRobot")
def test_lerobot_loads_it(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    options = ("--cameras", "overview", "--depth", "--width", "32", "--height", "32", "--episodes", "2")
    assert run("demos", PIECE, *FIRST_MERGE, *options, "--out", out)[0] == 0
    frames = sum(record.frames for record in Demonstrations(out).episodes)
    done = subprocess.run(
        [os.environ["LEROBOT_PYTHON"], "-c", READ, str(out)], capture_output=True, text=True, check=True,
        env={**os.environ, "HF_HUB_OFFLINE": "1", "PYTHONPATH": ""},
    )  # fmt: skip
    task = "Join leg back right to stretcher."
    shapes = f"torch.Size([2, 22]) torch.Size([3, 32, 32]) {task}"
    assert done.stdout.splitlines() == [
        f"2 {frames} 20 observation.images.overview_depth",
        shapes, "torch.Size([1, 32, 32]) True False", shapes, "torch.Size([1, 32, 32]) True True",
    ]  # fmt: skip


EVALUATE = """
import logging
import lerobot_env_roboassembly
import numpy as np
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env, make_env_config
from lerobot.envs.utils import env_to_policy_features, preprocess_observation
from lerobot.utils.import_utils import register_third_party_plugins

register_third_party_plugins()
config = make_env_config(
    "roboassembly", furniture="three_legged:3", task="merge", merge=0, cameras=["overview"], width=32, height=32
)
features = env_to_policy_features(config)
env = make_env(config, n_envs=2)["roboassembly"][0]
observation, info = env.reset(seed=[0, 1], options={"lerobot_new_rollout": True})
for name, rows in sorted(preprocess_observation(observation).items()):
    assert tuple(rows.shape[1:]) == tuple(features[name].shape), name
    print(name, tuple(rows.shape))
print(env.call("task_description")[0], env.call("_max_episode_steps")[0])
*_, info = env.step(np.zeros((2, 22), np.float32))
print(info["is_success"])
"""


@pytest.mark.slow
@pytest.mark.usefixtures("drawing")
@pytest.mark.skipif("LEROBOT_PYTHON" not in os.environ, reason="LEROBOT_PYTHON names a Python with LeRobot")
def test_lerobot_makes_the_environment() -> None:
    assert with_plug_in(EVALUATE)[-5:] == [
        "observation.environment_state (2, 97)", "observation.images.overview (2, 3, 32, 32)",
        "observation.state (2, 64)", "Join leg back right to stretcher. 2400", "[False False]",
    ]  # fmt: skip


ROLLOUT = """
import sys
import torch
from lerobot.envs.factory import make_env, make_env_config
from lerobot.scripts.lerobot_eval import rollout
from lerobot.utils.import_utils import register_third_party_plugins
import lerobot_env_roboassembly
from roboassembly.demonstrations.replay import Demonstrations

demos = Demonstrations(sys.argv[1])
(record,) = demos.episodes

class Repeat(torch.nn.Module):
    def __init__(self, actions):
        super().__init__()
        self.actions = torch.from_numpy(actions.copy())

    def reset(self):
        self.step = 0

    def select_action(self, observation):
        self.step += 1
        return self.actions[None, self.step - 1]

class Rest(Repeat):
    def select_action(self, observation):
        return torch.zeros_like(self.actions[:1])

config = make_env_config(
    "roboassembly", furniture=record.furniture, task="merge", merge=0, layout=1, part_position=0.02, part_angle=0.2,
    episode_length=record.frames,
)
env = make_env(config, n_envs=1)["roboassembly"][0]
same = lambda batch: batch
for policy in (Repeat(demos.actions(0)), Rest(demos.actions(0))):
    result = rollout(env, policy, same, same, same, same, seeds=[record.seed])
    print(bool(result["success"].any()), float(result["reward"].sum()), bool(result["done"][:, -1].all()))
"""


@pytest.mark.slow
@pytest.mark.skipif("LEROBOT_PYTHON" not in os.environ, reason="LEROBOT_PYTHON names a Python with LeRobot")
def test_lerobot_counts_successes(tmp_path: Path, run: Run) -> None:
    """Its own evaluation of a policy that repeats what was recorded, and of one that does nothing."""
    options = ("--layout", "1", "--part-position", "0.02", "--part-angle", "0.2", "--episodes", "1")
    assert run("demos", PIECE, *FIRST_MERGE, *options, "--out", tmp_path / "out")[0] == 0
    assert with_plug_in(ROLLOUT, str(tmp_path / "out"))[-2:] == ["True 1.0 True", "False 0.0 True"]


def with_plug_in(script: str, *arguments: str) -> list[str]:
    """Return the lines that a script prints in LeRobot's Python, where the plug-in of this folder is found."""
    here = Path(__file__).parents[2]
    paths = os.pathsep.join(map(str, (here / "src", here / "integrations" / "lerobot_env_roboassembly")))
    run = [os.environ["LEROBOT_PYTHON"], "-c"]
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "PYTHONPATH": paths}
    if subprocess.run([*run, "import roboassembly.demonstrations.config"], env=environment, check=False).returncode:
        pytest.skip("that Python lacks what RoboAssembly needs")
    done = subprocess.run([*run, script, *arguments], capture_output=True, text=True, check=True, env=environment)
    return done.stdout.splitlines()
