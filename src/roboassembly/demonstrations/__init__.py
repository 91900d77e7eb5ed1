"""Demonstrations for `RoboAssembly/Control-v0`: planned, carried out in physics, and recorded as data sets.

`planner` plans and acts, `recording` records one episode, `collect` records many, in processes. A finished episode
waits in a folder of its own (`staging`) until it is added to a LeRobot data set (`lerobot_dataset`) or to a file in
robomimic's layout (`robomimic_file`). `roboassembly.demonstrations.replay` reads both and repeats episodes.
"""
