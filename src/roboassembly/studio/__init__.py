"""The studio in the browser: `roboassembly view`."""
