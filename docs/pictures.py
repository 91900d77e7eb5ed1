"""Draws the pictures of the README: `.venv/bin/python docs/pictures.py`."""

from pathlib import Path

from roboassembly.furniture import catalogue
from roboassembly.furniture.generate import FAMILIES
from roboassembly.solvers.search import solve
from roboassembly.viewer.film import render_contact_sheet, write_storyboard

IMAGES = Path(__file__).parent / "images"

write_storyboard(solve(catalogue.make("ladder"), 0).plan, IMAGES / "storyboard.png", columns=4, width=360, height=240)
chairs = [catalogue.make(family, seed) for seed in range(2) for family in FAMILIES]
render_contact_sheet(chairs, IMAGES / "families.png", columns=len(FAMILIES), size=200)
