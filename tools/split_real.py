"""Divide imported real furniture into pieces to train on and pieces to report on.

    python tools/split_real.py IMPORTED OUT

links the furniture folders in IMPORTED from OUT/train and OUT/report. All pieces of one product are on the same side,
whichever collection they are from: in alphabetical order, every other product is for training.
"""

import argparse
import sys
from pathlib import Path

TRAIN = (
    "agam", "agne", "alex", "askholmen", "bekvam", "bernhard", "besta", "billy", "bjorken", "bjursta", "chair",
    "dalselv", "dockstra", "expedit", "flaerke", "flip", "froset", "grevback", "hannes", "hensvik", "ivar", "kaustby",
    "klubbo", "lack", "lamp", "lekman", "liden", "lunnarp", "mikael", "nilsolle", "omtanksam", "ragrund", "satsumas",
    "sjalland", "smussla", "stig", "table", "three", "torsby", "tvunit", "vesken", "yngvar",
)  # fmt: skip
"""Products to train on."""
REPORT = (
    "agerum", "akurum", "applaro", "balser", "benno", "bertil", "billsta", "bjoderna", "bjorkudden", "cabinet", "dalom",
    "desk", "drawer", "falholmen", "fredrik", "gladom", "grubban", "hemnes", "ingolf", "jokkmokk", "klingsbo", "kyrre",
    "laiva", "lantliv", "lerhamn", "lillagen", "mammut", "nils", "norraker", "poang", "round", "sigurd", "skogsta",
    "square", "stool", "teodores", "tommaryd", "trogen", "vadholma", "vittsjo",
)  # fmt: skip
"""Products to report on."""
GENERAL = (
    "bed", "bench", "bookcase", "box", "cabinet", "chair", "desk", "misc", "objects", "shelf", "swivel", "table", "toy",
    "tvunit",
)  # fmt: skip
"""First words of names that say what a piece is, or where it comes from; the last word left is the product itself."""


def product(name: str) -> str:
    """Return the word of a folder's name that names the product: `hemnes` of `table_hemnes_0539`."""
    words = [word for word in name.split("_") if not word.isdigit()]
    while len(words) > 1 and words[0] in GENERAL:
        words = words[1:]
    return words[0]


def main() -> int:
    """Run the command; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("imported", type=Path)
    parser.add_argument("out", type=Path)
    args = parser.parse_args()
    unknown: list[str] = []
    for file in sorted(args.imported.glob("*/furniture.json")):
        name = file.parent.name
        side = "train" if product(name) in TRAIN else "report" if product(name) in REPORT else ""
        if not side:
            unknown.append(name)
            continue
        link = args.out / side / name
        link.parent.mkdir(parents=True, exist_ok=True)
        if not link.is_symlink():
            link.symlink_to(file.parent.resolve(), target_is_directory=True)
    if unknown:
        print(f"{', '.join(unknown)}: products of neither side; add them to TRAIN or REPORT")
    return 1 if unknown else 0


if __name__ == "__main__":
    sys.exit(main())
