"""Plan an assembly and look at it.

    python examples/01_plan_and_view.py
    python examples/01_plan_and_view.py --furniture windsor:3 --out windsor

Prints the plan, then writes a page to turn and scrub, the plan as JSON and a picture of each step.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from roboassembly.datasets import catalogue
from roboassembly.settings import set_upright
from roboassembly.solvers.search import solve
from roboassembly.task.plans import plan_file
from roboassembly.viewer.film import RenderingUnavailableError, write_storyboard
from roboassembly.viewer.html import write_html


def main() -> None:
    """Plan the assembly of one piece, and show it."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--furniture", default="stool", help="a family, FAMILY:SEED, or a furniture folder")
    parser.add_argument("--seed", type=int, default=0, help="where the parts lie at first")
    parser.add_argument("--out", type=Path, default=Path("plan_and_view"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    # A piece of furniture: parts with meshes, connection points, assembled poses.
    furniture = catalogue.find(args.furniture)
    print(f"{furniture.name}: {len(furniture.parts)} parts, {len(furniture.connections)} connections")

    # The search finds an order and a path for every merge. The same seed gives the same plan.
    result = solve(furniture, seed=args.seed)
    if not result.plan.success:
        raise SystemExit(f"no plan: {result.reason}")
    for number, step in enumerate(result.plan.steps, 1):
        u, v, *_ = step.action
        names = f"{furniture.parts[u].name} onto {furniture.parts[v].name}"
        print(f"{number}. {names}: {len(step.path)} waypoints, {step.planning_steps} states checked")

    # One more motion sets the finished piece on its feet.
    plan = set_upright(result.plan)

    plan_file.write(plan, args.out / "plan.json")
    write_html(plan, args.out / "assembly.html")
    try:
        write_storyboard(plan, args.out / "steps.png")
    except RenderingUnavailableError as error:
        print(f"no picture: {error}")
    print(f"open {args.out / 'assembly.html'} in a browser")


if __name__ == "__main__":
    main()
