"""Draws the pictures of the README: `.venv/bin/python docs/pictures.py`."""

from pathlib import Path

from roboassembly.furniture import catalogue
from roboassembly.furniture.generate import CHAIRS, FAMILIES
from roboassembly.solvers.search import solve
from roboassembly.viewer.film import render_contact_sheet, write_storyboard

IMAGES = Path(__file__).parent / "images"

write_storyboard(solve(catalogue.make("ladder"), 0).plan, IMAGES / "storyboard.png", columns=4, width=360, height=240)
render_contact_sheet([catalogue.make(f) for f in FAMILIES], IMAGES / "families.png", columns=7, size=200)
sixty = [catalogue.make(list(CHAIRS)[i % len(CHAIRS)], 1 + i // len(CHAIRS)) for i in range(60)]
render_contact_sheet(sixty, IMAGES / "sixty.png", columns=10, size=140, names=[""] * 60)
