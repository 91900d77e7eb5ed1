"""Continuous control of two mobile arms in physics: the environment `RoboAssembly/Control-v0` and its parts."""
