"""Import furniture from mesh files, and assemble it.

    python examples/02_your_own_furniture.py
    python examples/02_your_own_furniture.py --meshes my_files --scale 0.001

Takes a folder with one STL, OBJ, PLY or GLB file per part, each part at its place in the finished piece. Without one,
it first writes the meshes of a small table, in millimetres.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import trimesh

from roboassembly.datasets import catalogue
from roboassembly.furniture import storage
from roboassembly.importers import folder
from roboassembly.importers.pipeline import finish
from roboassembly.solvers.search import solve


def write_table(path: Path) -> None:
    """Write a table of five parts that touch each other, as modelling programs export them."""
    path.mkdir(parents=True, exist_ok=True)
    top = trimesh.creation.box((600.0, 400.0, 25.0))
    top.apply_translation((0.0, 0.0, 462.5))
    top.export(path / "top.stl")
    for x in (-1, 1):
        for y in (-1, 1):
            leg = trimesh.creation.box((40.0, 40.0, 450.0))
            leg.apply_translation((260.0 * x, 160.0 * y, 225.0))
            leg.export(path / f"leg_{'left' if x < 0 else 'right'}_{'front' if y < 0 else 'back'}.stl")


def main() -> None:
    """Import a folder of meshes, save the result as a furniture folder, and plan its assembly."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--meshes", type=Path, default=None, help="a folder of mesh files")
    parser.add_argument("--scale", type=float, default=0.001, help="metres per unit of the files")
    parser.add_argument("--out", type=Path, default=Path("my_table"), help="the furniture folder to write")
    args = parser.parse_args()
    meshes = args.meshes or args.out.with_name(f"{args.out.name}_meshes")
    if args.meshes is None:
        write_table(meshes)

    # Read the files, leave a gap of 0.2 mm at every contact, find connection points, equal parts and grasps.
    imported = finish(args.out.name, folder.read(meshes, scale=args.scale))
    furniture = imported.furniture
    for part, repair in zip(furniture.parts, imported.repairs, strict=True):
        trimmed = 100.0 * repair.trimmed
        print(f"{part.name}: {trimmed:.2f} % trimmed, {len(part.points)} connection points, {len(part.grasps)} grasps")
    for shape in furniture.classes:
        if len(shape.members) > 1:
            print("interchangeable:", ", ".join(furniture.parts[i].name for i in shape.members))

    # A furniture folder works wherever a name of built-in furniture does: in commands, environments and here.
    storage.save(furniture, args.out)
    result = solve(catalogue.find(str(args.out)), seed=0)
    print(f"{len(result.plan.steps)} merges, assembled: {result.plan.success}")


if __name__ == "__main__":
    main()
