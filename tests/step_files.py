"""STEP files as CAD programs write them: an assembly of boxes with instances, sub-assemblies and a unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

Vector = tuple[float, float, float]
_SIDES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
"""Corners of each side, seen from outside; bit k of a corner says whether it is the high one along axis k."""
_NORMALS = ((0, 0, -1), (0, 0, 1), (0, -1, 0), (0, 1, 0), (-1, 0, 0), (1, 0, 0))
_UNITS = {
    "mm": "(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))",
    "m": "(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT($,.METRE.))",
    "in": "(CONVERSION_BASED_UNIT('INCH',{factor})LENGTH_UNIT()NAMED_UNIT({dimensions}))",
}


@dataclass(frozen=True)
class Box:
    """Product: a box from the origin to a corner."""

    name: str
    size: Vector


@dataclass(frozen=True)
class Assembly:
    """Product made of instances: name, product, place of its origin, and its x axis."""

    name: str
    instances: Sequence[tuple[str, Box | Assembly, Vector] | tuple[str, Box | Assembly, Vector, Vector]]


def write_step(path: Path, root: Box | Assembly, unit: str = "mm") -> Path:
    """Write a product and all below it, each product once."""
    writer = _Writer(unit)
    writer.product(root)
    body = "\n".join(f"#{number}={text};" for number, text in enumerate(writer.lines, start=1))
    path.write_text(
        "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n"
        "FILE_NAME('x','2000-01-01T00:00:00',(''),(''),'','','');\n"
        f"FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));\nENDSEC;\nDATA;\n{body}\nENDSEC;\nEND-ISO-10303-21;\n"
    )
    return path


@dataclass
class _Writer:
    unit: str
    lines: list[str] = field(default_factory=list)
    made: dict[int, tuple[int, int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        context = self.add("APPLICATION_CONTEXT('mechanical design')")
        self.product_context = self.add(f"PRODUCT_CONTEXT('',#{context},'mechanical')")
        self.definition_context = self.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',#{context},'design')")
        if self.unit == "in":
            base = self.add(_UNITS["mm"])
            factor = self.add(f"LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#{base})")
            dimensions = self.add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
            length = self.add(_UNITS["in"].format(factor=f"#{factor}", dimensions=f"#{dimensions}"))
        else:
            length = self.add(_UNITS[self.unit])
        angle = self.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
        solid = self.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
        near = self.add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-05),#{length},'accuracy','')")
        self.geometry = self.add(
            f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{near}))"
            f"GLOBAL_UNIT_ASSIGNED_CONTEXT((#{length},#{angle},#{solid}))REPRESENTATION_CONTEXT('',''))"
        )
        self.origin = self.axes((0.0, 0.0, 0.0))

    def add(self, text: str) -> int:
        self.lines.append(text)
        return len(self.lines)

    def point(self, place: Vector) -> int:
        return self.add(f"CARTESIAN_POINT('',({_numbers(place)}))")

    def axes(self, place: Vector, z: Vector = (0, 0, 1), x: Vector = (1, 0, 0)) -> int:
        origin, up, along = self.point(place), self.direction(z), self.direction(x)
        return self.add(f"AXIS2_PLACEMENT_3D('',#{origin},#{up},#{along})")

    def direction(self, vector: Vector) -> int:
        return self.add(f"DIRECTION('',({_numbers(vector)}))")

    def product(self, made_of: Box | Assembly) -> tuple[int, int]:
        """Return the numbers of the product's definition and of its shape."""
        if id(made_of) in self.made:
            return self.made[id(made_of)]
        product = self.add(f"PRODUCT('{made_of.name}','{made_of.name}','',(#{self.product_context}))")
        formation = self.add(f"PRODUCT_DEFINITION_FORMATION('','',#{product})")
        definition = self.add(f"PRODUCT_DEFINITION('design','',#{formation},#{self.definition_context})")
        shape = self.add(f"PRODUCT_DEFINITION_SHAPE('','',#{definition})")
        if isinstance(made_of, Box):
            solid = self.box(made_of.size)
            outline = self.add(f"FACETED_BREP_SHAPE_REPRESENTATION('',(#{self.origin},#{solid}),#{self.geometry})")
            self.add(f"SHAPE_DEFINITION_REPRESENTATION(#{shape},#{outline})")
        else:
            places = [self.axes(place, x=x[0] if x else (1.0, 0.0, 0.0)) for _, _, place, *x in made_of.instances]
            listed = ",".join(f"#{place}" for place in (self.origin, *places))
            outline = self.add(f"SHAPE_REPRESENTATION('',({listed}),#{self.geometry})")
            self.add(f"SHAPE_DEFINITION_REPRESENTATION(#{shape},#{outline})")
            for place, (name, child, *_) in zip(places, made_of.instances, strict=True):
                self.instance(name, child, place, definition, outline)
        self.made[id(made_of)] = definition, outline
        return definition, outline

    def instance(self, name: str, child: Box | Assembly, place: int, definition: int, outline: int) -> None:
        below, shape = self.product(child)
        use = self.add(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{len(self.lines)}','{name}','',#{definition},#{below},$)")
        used = self.add(f"PRODUCT_DEFINITION_SHAPE('','',#{use})")
        moved = self.add(f"ITEM_DEFINED_TRANSFORMATION('','',#{self.origin},#{place})")
        relation = self.add(
            f"(REPRESENTATION_RELATIONSHIP('','',#{shape},#{outline})"
            f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#{moved})SHAPE_REPRESENTATION_RELATIONSHIP())"
        )
        self.add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#{relation},#{used})")

    def box(self, size: Vector) -> int:
        corners = [self.point((size[0] * (k & 1), size[1] * (k >> 1 & 1), size[2] * (k >> 2 & 1))) for k in range(8)]
        faces = []
        for side, normal in zip(_SIDES, _NORMALS, strict=True):
            loop = self.add(f"POLY_LOOP('',({','.join(f'#{corners[k]}' for k in side)}))")
            bound = self.add(f"FACE_OUTER_BOUND('',#{loop},.T.)")
            low = (size[0] * (side[0] & 1), size[1] * (side[0] >> 1 & 1), size[2] * (side[0] >> 2 & 1))
            plane = self.add(f"PLANE('',#{self.axes(low, normal, (0, 1, 0) if normal[0] else (1, 0, 0))})")
            faces.append(self.add(f"FACE_SURFACE('',(#{bound}),#{plane},.T.)"))
        shell = self.add(f"CLOSED_SHELL('',({','.join(f'#{face}' for face in faces)}))")
        return self.add(f"FACETED_BREP('',#{shell})")


def _numbers(vector: Vector) -> str:
    return ",".join(f"{value:.12G}" + ("" if "." in f"{value:.12G}" else ".") for value in vector)


def step_table(legs: Sequence[str] = ("front leg", "back leg")) -> Assembly:
    """Return a table of 12 parts, 1260 x 760 x 740: two equal sides in a base, four rails and two halves of a top."""
    leg, rail = Box("leg", (60, 60, 710)), Box("side rail", (22, 580, 90))
    side = Assembly(
        "side", [(legs[0], leg, (0, 0, 0)), (legs[1], leg, (0, 640, 0)), ("side rail", rail, (19, 60, 620))]
    )
    long, low = Box("long rail", (1080, 22, 90)), Box("stretcher", (1080, 22, 40))
    base = Assembly(
        "base",
        [
            ("left side", side, (0, 0, 0)),
            # Turned by half a turn: its legs change places.
            ("right side", side, (1200, 700, 0), (-1, 0, 0)),
            ("front rail", long, (60, 19, 620)),
            ("back rail", long, (60, 659, 620)),
            ("front stretcher", low, (60, 19, 150)),
            ("back stretcher", low, (60, 659, 150)),
        ],
    )
    half = Box("half top", (1260, 380, 30))
    return Assembly(
        "table", [("base", base, (0, 0, 0)), ("front top", half, (-30, -30, 710)), ("back top", half, (-30, 350, 710))]
    )
