"""Prints the tables of imports, and of assemblies by robots, for results.md, in Markdown.

Run this in a folder with the unpacked samples, for one archive after another:

    for set in ikea-manual:ikea_manuals_at_work ikea-env:clvrai_furniture furniture-bench:furniture_bench; do
        kind=${set%%:*} source=${set#*:}
        roboassembly import $kind $source --out imported/$kind --no-cache --jobs 1 --json > $kind.import.json
        roboassembly evaluate --policy search --set folder:imported/$kind --jobs 1 --json > $kind.search.json
        python tools/tables.py $kind.import.json $kind.search.json
    done

Part of a source, like `ikea_manuals_at_work/parts/Chair`, gives part of a table. `--no-cache` makes the times those of
an import, not of a look-up. A single file, of `roboassembly evaluate --setting full --json`, gives a table of
assemblies by robots.
"""

import json
import statistics
import sys
from pathlib import Path

HEAD = ("piece", "parts", "connections", "moved, mm", "trimmed at most, %", "size changed at most, mm",
        "import, s", "assembled", "states", "planning, s", "cannot be held")  # fmt: skip


def row(item: dict, episode: dict | None) -> list[str]:
    """Return the row of one piece."""
    seconds = "from the cache" if item["cached"] else f"{item['seconds']:.1f}"
    if item["error"]:
        return [item["name"], "", "", "", "", "", seconds, f"refused: {item['error']}", "", "", ""]
    found = [
        item["name"],
        str(item["parts"]),
        str(item["connections"]),
        f"{item['displacement_max_mm']:.1f}",
        f"{item['trimmed_max_percent']:.1f}",
        f"{max(item['size_change_mm'].values(), key=abs):+.1f}",
        seconds,
    ]
    held = ", ".join(item["unholdable"])
    if episode is None:
        return [*found, "not tried", "", "", held]
    planned = [f"{episode['planning_steps']:,}", f"{episode['planning_seconds']:.2f}"]
    return [*found, "yes" if episode["success"] else "no", *planned, held]


def table(imports: dict, search: dict) -> list[str]:
    """Return the lines of totals and table, from the output of both commands."""
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


FULL_HEAD = ("piece", "parts", "planned", "planning, s", "a merge, s", "carried out", "simulated, s", "fingers off, mm",
             "joints off, mm", "audit")  # fmt: skip


def full_row(episode: dict) -> list[str]:
    """Return the row of one piece with robots."""
    done, merges = episode["executed"], episode["step_seconds"]
    if not episode["success"] and done is None:
        return [episode["furniture"], str(episode["parts"]), f"{episode['verdict']}: {episode['reason']}", *[""] * 7]
    planned = [f"{episode['planning_seconds']:.1f}", f"{statistics.median(merges):.2f}"]
    if done is None:
        figures = [""] * 4
    else:
        figures = [
            "yes" if done["success"] else done["reason"],
            f"{done['simulated_seconds']:.0f}",
            f"{done['tracking_error_mm']:.1f}",
            f"{done['joint_error_mm']:.1f}",
        ]
    found = episode["violations"]
    audit = "" if found is None else "nothing" if found == 0 else f"{found} violations"
    return [episode["furniture"], str(episode["parts"]), "yes", *planned, *figures, audit]


def full_table(report: dict) -> list[str]:
    """Return the lines of totals and table, from the output of `evaluate --setting full`."""
    episodes = report["per_furniture"]
    planned = [e for e in episodes if e["success"] or e["executed"] is not None]
    totals = [f"{len(planned)} of {len(episodes)} planned"]
    if report["execution"] == "dynamic":
        totals.append(f"{sum(e['success'] for e in episodes)} of them carried out")
    if planned:
        totals.append(f"planning median {statistics.median(e['planning_seconds'] for e in planned):.1f} s a piece")
        totals.append(f"{report['merge_seconds_median']:.2f} s a merge")
    if any(e["violations"] is not None for e in episodes):
        totals.append(f"{sum(e['violations'] or 0 for e in episodes)} violations found by the audit")
    rows = (FULL_HEAD, ["---"] * len(FULL_HEAD), *map(full_row, episodes))
    return [", ".join(totals), "", *(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |" for cells in rows)]


def main() -> None:
    """Print the table of the files named on the command line."""
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    reports = [json.loads(Path(name).read_text()) for name in sys.argv[1:]]
    print("\n".join(full_table(*reports) if len(reports) == 1 else table(*reports)))


if __name__ == "__main__":
    main()
