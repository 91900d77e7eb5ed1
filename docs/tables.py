"""Writes the tables of imports for results.md.

For each source: `roboassembly import KIND SOURCE --out DIR --json > IMPORT.json`, then `roboassembly evaluate --policy
search --set folder:DIR --jobs 1 --json > SEARCH.json`, then `python docs/tables.py IMPORT.json SEARCH.json`.
"""

import json
import statistics
import sys
from pathlib import Path

HEAD = ("piece", "parts", "connections", "moved, mm", "trimmed at most, %", "import, s", "assembled", "states",
        "planning, s", "cannot be held")  # fmt: skip


def row(item: dict, episode: dict | None) -> list[str]:
    """One piece."""
    if item["error"]:
        return [item["name"], "", "", "", "", f"{item['seconds']:.1f}", f"refused: {item['error']}", "", "", ""]
    assert episode is not None, f"{item['name']} was imported and not searched"
    return [
        item["name"],
        str(item["parts"]),
        str(item["connections"]),
        f"{item['displacement_max_mm']:.1f}",
        f"{item['trimmed_max_percent']:.1f}",
        f"{item['seconds']:.1f}",
        "yes" if episode["success"] else "no",
        f"{episode['planning_steps']:,}",
        f"{episode['planning_seconds']:.2f}",
        str(len(item["unholdable"]) or ""),
    ]


def main(imports: Path, search: Path) -> None:
    """Print one line of totals, and the table."""
    items = json.loads(imports.read_text())["items"]
    episodes = {e["furniture"]: e for e in json.loads(search.read_text())["per_furniture"]}
    imported = [i for i in items if not i["error"]]
    solved = [episodes[i["name"]] for i in imported if episodes[i["name"]]["success"]]
    print(
        f"{len(imported)} of {len(items)} imported, {len(solved)} of them assembled, planning median "
        f"{statistics.median(e['planning_seconds'] for e in solved):.2f} s, import median "
        f"{statistics.median(i['seconds'] for i in imported):.1f} s, at most {max(i['seconds'] for i in items):.1f} s\n"
    )
    for cells in (HEAD, ["---"] * len(HEAD), *(row(i, episodes.get(i["name"])) for i in items)):
        print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
