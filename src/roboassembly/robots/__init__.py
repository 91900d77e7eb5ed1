"""The mobile Franka: a Panda on a platform that drives and turns on the spot."""
