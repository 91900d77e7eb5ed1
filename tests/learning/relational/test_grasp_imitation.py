"""Imitation of labelled grasps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roboassembly.learning import checkpoint
from roboassembly.learning.relational.grasps import imitation as grasp_imitation
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.dataset import NO, UNKNOWN, YES, GraspSamples


def test_the_network_fits_the_grasps_of_one_piece(stand_grasps: GraspSamples, tmp_path: Path) -> None:
    stand_grasps.save(tmp_path / "a.npz")
    examples = grasp_imitation.examples_of([tmp_path / "a.npz"], 1)
    training = grasp_imitation.GraspTraining(steps=1_200, batch=8)
    steps = list(grasp_imitation.train(examples, tmp_path / "net.npz", training, {}))
    assert steps[-1][1]["loss"] < 0.5 * steps[0][1]["loss"]
    params = checkpoint.load(tmp_path / "net.npz", grasping.KIND).params
    found = grasp_imitation.accuracy(params, examples)
    assert min(found[name] for name in (("pick", "fit", "first"))) > 0.9
    assert set(np.unique(examples.mate)) == {UNKNOWN, NO, YES}
