"""Writes the tables of imports for results.md, in Markdown.

In a folder with the unpacked samples, for one archive after another:

    for set in ikea-manual:ikea_manuals_at_work ikea-env:clvrai_furniture furniture-bench:furniture_bench; do
        kind=${set%%:*} source=${set#*:}
        roboassembly import $kind $source --out imported/$kind --no-cache --jobs 1 --json > $kind.import.json
        roboassembly evaluate --policy search --set folder:imported/$kind --jobs 1 --json > $kind.search.json
        python docs/tables.py $kind.import.json $kind.search.json
    done

Part of a source, like `ikea_manuals_at_work/parts/Chair`, makes part of a table. `--no-cache`, because the seconds that
a look-up takes are not those of the import.
"""

import json
import statistics
import sys
from pathlib import Path

HEAD = ("piece", "parts", "connections", "moved, mm", "trimmed at most, %", "import, s", "assembled", "states",
        "planning, s", "cannot be held")  # fmt: skip


def row(item: dict, episode: dict | None) -> list[str]:
    """One piece."""
    seconds = "from the cache" if item["cached"] else f"{item['seconds']:.1f}"
    if item["error"]:
        return [item["name"], "", "", "", "", seconds, f"refused: {item['error']}", "", "", ""]
    found = [
        item["name"],
        str(item["parts"]),
        str(item["connections"]),
        f"{item['displacement_max_mm']:.1f}",
        f"{item['trimmed_max_percent']:.1f}",
        seconds,
    ]
    held = ", ".join(item["unholdable"])
    if episode is None:
        return [*found, "not tried", "", "", held]
    planned = [f"{episode['planning_steps']:,}", f"{episode['planning_seconds']:.2f}"]
    return [*found, "yes" if episode["success"] else "no", *planned, held]


def table(imports: dict, search: dict) -> list[str]:
    """Lines: totals, nothing, and the table, from what the two commands printed."""
    items = imports["items"]
    episodes = {e["furniture"]: e for e in search["per_furniture"]}
    imported = [i for i in items if not i["error"]]
    solved = [e for i in imported if (e := episodes.get(i["name"])) and e["success"]]
    totals = [f"{len(imported)} of {len(items)} imported", f"{len(solved)} of them assembled"]
    if solved:
        totals.append(f"planning median {statistics.median(e['planning_seconds'] for e in solved):.2f} s")
    if fresh := [i["seconds"] for i in items if not i["cached"]]:
        totals.append(f"import median {statistics.median(fresh):.1f} s, at most {max(fresh):.1f} s")
    rows = (HEAD, ["---"] * len(HEAD), *(row(i, episodes.get(i["name"])) for i in items))
    return [", ".join(totals), "", *(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |" for cells in rows)]


def main() -> None:
    """Print the table of the two files named on the command line."""
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    print("\n".join(table(*(json.loads(Path(name).read_text()) for name in sys.argv[1:]))))


if __name__ == "__main__":
    main()
