"""A trajectory played by franky, over Franka's network protocol, on franky-sim's robot in MuJoCo."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from roboassembly.furniture.model import Furniture
from roboassembly.settings import SETTINGS
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.motion_record import decode_motions
from roboassembly.task.trajectories.trajectory import time_plan

FR3_LOW = np.array([-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159])
FR3_HIGH = np.array([2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159])
"""Limits of the joints of an FR3 [rad]: what franky-sim has. A Panda's are wider in joints 1, 4 and 6."""
PLAYER = """
import json, os, sys, threading
import franky
import numpy as np
from franky_sim import SimulationServer
from franky_sim.mujoco_simulator import MujocoSimulator

content = np.load(sys.argv[1])
q, rates = content["q"], content["rates"]
over, seen = threading.Event(), []
with MujocoSimulator(enable_visualization=False) as simulator:
    model = simulator.add_robot(initial_q=q[0].tolist())
    with SimulationServer(simulator) as server:
        server.run_async()
        robot = franky.Robot(model.hostname, realtime_config=franky.RealtimeConfig.Ignore)
        motion = franky.JointImpedanceTrackingMotion(stiffness=np.array([600.0] * 4 + [250.0, 150.0, 50.0]))
        motion.set_reference(franky.JointReference(q[0]))

        def follow(state, step, elapsed, time, signal):
            tick = round(1000 * elapsed.to_sec())  # the robot's clock, not this machine's
            at = min(tick, len(q) - 1)
            motion.set_reference(franky.JointReference(q[at], rates[at]))
            seen.append((at, np.array(state.q)))
            if tick > len(q) + 500:
                over.set()

        motion.register_callback(follow)
        robot.move(motion, asynchronous=True)
        if over.wait(60.0):
            ticks = np.array([tick for tick, _ in seen])
            reached = np.array([angles for _, angles in seen])
            off = np.abs(reached - q[ticks])
            print(json.dumps({"ticks": len(ticks), "off": off.max(), "end": off[-1].max()}), flush=True)
        # The motion would hold its last reference for ever.
        os._exit(0 if over.is_set() else 1)
"""


@pytest.mark.slow
def test_a_franka_follows_the_arm_of_a_trajectory(chair: Callable[..., Furniture], tmp_path: Path) -> None:
    pytest.importorskip("franky")
    pytest.importorskip("franky_sim")
    plan = SETTINGS["full"].solve(chair("stool", 0), seed=0).plan
    trajectory = time_plan(decode_motions(plan_file.encode(plan), "plan.json"), plan.furniture)
    for timed in trajectory.segments:
        times = np.arange(round(1000 * timed.motion.seconds) + 1) / 1000.0
        states = timed.motion.states(times)
        q, rates = states.position[:, 3:], states.velocity[:, 3:]
        moves = np.abs(q[-1] - q[0]).max() > 1.0
        if not timed.segment.payload and moves and ((q > FR3_LOW + 0.05) & (q < FR3_HIGH - 0.05)).all():
            break
    else:
        pytest.fail("the trajectory has no motion within an FR3's limits")
    np.savez(tmp_path / "motion.npz", q=q, rates=rates)
    command = [sys.executable, "-c", PLAYER, str(tmp_path / "motion.npz")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    played = json.loads(done.stdout.splitlines()[-1])
    assert played["ticks"] > 0.9 * len(q)
    # It follows by a few hundredths of a radian, and stands where the motion ends.
    assert played["off"] < 0.06
    assert played["end"] < 0.01
