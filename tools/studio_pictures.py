"""Pictures of the studio in docs/images, from the screenshots of its tests in a browser.

ROBOASSEMBLY_SCREENSHOTS=build/screenshots python -m pytest -m slow tests/studio/test_studio_page.py
python tools/studio_pictures.py build/screenshots
"""

import sys
from pathlib import Path

import imageio.v3 as iio

IMAGES = Path(__file__).parents[1] / "docs" / "images"
PICTURES = {"studio": "desk-opening", "studio-failed-step": "desk-wrong", "studio-telephone": "telephone-opening"}
"""Screenshot of each picture."""


def main(folder: Path) -> None:
    """Write the pictures."""
    for name, screenshot in PICTURES.items():
        picture = iio.imread(folder / f"{screenshot}.png")[..., :3]
        iio.imwrite(IMAGES / f"{name}.webp", picture, extension=".webp")
        sys.stdout.write(f"docs/images/{name}.webp\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
