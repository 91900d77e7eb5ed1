"""`python -m roboassembly.cli`: the same as `roboassembly`."""

from roboassembly.cli import main

main()
