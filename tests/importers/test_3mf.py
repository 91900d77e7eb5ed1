"""3MF: units, components, names, several model files; broken and hostile files."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from archives import with_members_before_the_start
from model_files import box
from roboassembly.errors import FurnitureError
from roboassembly.importers import folder, threemf

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
RELS = (
    '<?xml version="1.0"?><Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="/3D/{start}" Id="r" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    "</Relationships>"
)


def mesh(number: int, size: tuple[float, float, float], more: str = "") -> str:
    """Return an object: a box from the origin to a corner."""
    shape = box(size, (size[0] / 2, size[1] / 2, size[2] / 2))
    vertices = "".join(f'<vertex x="{x:g}" y="{y:g}" z="{z:g}"/>' for x, y, z in shape.vertices)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in shape.faces)
    return (
        f'<object id="{number}" type="model" {more}><mesh><vertices>{vertices}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object>"
    )


def group(number: int, name: str, *components: str) -> str:
    return f'<object id="{number}" name="{name}"><components>{"".join(components)}</components></object>'


def component(number: int, transform: str = "", more: str = "") -> str:
    placed = f'transform="{transform}"' if transform else ""
    return f'<component objectid="{number}" {placed} {more}/>'


def model(objects: str, build: str, unit: str = 'unit="millimeter"') -> str:
    return (
        f'<?xml version="1.0"?><model xmlns="{CORE}" xmlns:p="{PRODUCTION}" {unit}><resources>{objects}</resources>'
        f"<build>{build}</build></model>"
    )


def item(number: int, transform: str = "") -> str:
    return component(number, transform).replace("component", "item")


def write(path: Path, text: str, start: str = "3dmodel.model", **others: str) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
        archive.writestr("_rels/.rels", RELS.format(start=start))
        archive.writestr(f"3D/{start}", text)
        for name, content in others.items():
            archive.writestr(f"3D/Objects/{name}.model", content)
    return path


LEG, TOP = mesh(1, (2, 2, 16), 'name="leg"'), mesh(2, (20, 12, 1), 'name="top"')


def test_components_in_inches(tmp_path: Path) -> None:
    """Two sides of two legs, the right one turned by a quarter about z: x to y, y to -x; points are rows there."""
    sides = group(3, "left", component(1), component(1, "1 0 0 0 1 0 0 0 1 0 10 0"))
    sides += group(4, "right", component(1), component(1, "0 1 0 -1 0 0 0 0 1 0 10 0"))
    table = group(5, "", component(3), component(4, "1 0 0 0 1 0 0 0 1 18 0 0"))
    path = write(
        tmp_path / "table.3mf",
        model(LEG + TOP + sides + table, item(5) + item(2, "1 0 0 0 1 0 0 0 1 0 0 16"), 'unit="inch"'),
    )
    raw = folder.read(path)
    assert [part.name for part in raw.parts] == ["left/leg", "left/leg_2", "right/leg", "right/leg_2", "top"]
    assert raw.unit is not None
    assert (raw.unit.text, raw.unit.guessed) == ("inches, as the file states", False)
    inches = [(part.mesh.bounds - raw.parts[0].mesh.bounds[0]) / 0.0254 for part in raw.parts]
    assert np.allclose(inches[0], [[0, 0, 0], [2, 2, 16]], atol=1e-4)
    assert np.allclose(inches[1], [[0, 10, 0], [2, 12, 16]], atol=1e-4)
    assert np.allclose(inches[3], [[16, 10, 0], [18, 12, 16]], atol=1e-4), "x 0..2, y 0..2 turns to x -2..0, y 0..2"
    assert np.allclose(inches[4], [[0, 0, 16], [20, 12, 17]], atol=1e-4)
    assert all(part.mesh.is_solid for part in raw.parts)


@pytest.mark.parametrize(
    ("unit", "size"),
    [("", 0.016), ("millimeter", 0.016), ("centimeter", 0.16), ("inch", 0.4064), ("foot", 4.8768), ("meter", 16.0)],
)
def test_units(tmp_path: Path, unit: str, size: float) -> None:
    stated = f'unit="{unit}"' if unit else ""
    path = write(tmp_path / "x.3mf", model(LEG + TOP, item(1) + item(2, "1 0 0 0 1 0 0 0 1 0 0 15"), stated))
    scene = threemf.read_3mf(path)
    assert scene.unit is not None
    assert scene.unit.scale * 16 == pytest.approx(size)
    assert folder.read(path, scale=0.05).size[2] == pytest.approx(0.8)


def test_mirrored_component_stays_solid(tmp_path: Path) -> None:
    path = write(tmp_path / "x.3mf", model(LEG + TOP, item(2) + item(1, "-1 0 0 0 1 0 0 0 1 10 0 1")))
    raw = folder.read(path, scale=0.05)
    assert all(part.mesh.is_solid for part in raw.parts)
    assert all(part.mesh.volume > 0 for part in raw.parts)
    assert np.allclose(raw.parts[1].mesh.bounds[:, 0], [-0.1, 0.0], atol=1e-6), "x 0..2 to 10..8, the top from 0 to 20"


def test_objects_in_other_model_files(tmp_path: Path) -> None:
    """As slicers write them: the start names no object of its own, names are part numbers, supports are left out."""
    other = model(
        mesh(1, (2, 2, 16), 'partnumber="post"')
        + TOP
        + LEG.replace('"model"', '"support"', 1).replace('id="1"', 'id="7"'),
        "",
    )
    where = 'p:path="/3D/Objects/parts.model"'
    table = group(
        9, "table", *(component(k, f"1 0 0 0 1 0 0 0 1 0 0 {z}", where) for k, z in ((1, 0), (2, 16), (7, 0)))
    )
    path = write(tmp_path / "x.3mf", model(table, item(9)), start="start.model", parts=other)
    assert [part.name for part in folder.read(path, scale=0.05).parts] == ["post", "top"]


def test_one_object_of_several_bodies_is_split(tmp_path: Path) -> None:
    first, second = mesh(1, (2, 2, 16)), box((9, 9, 1), (0, 0, 20))
    more = "".join(f'<vertex x="{x:g}" y="{y:g}" z="{z:g}"/>' for x, y, z in second.vertices)
    faces = "".join(f'<triangle v1="{a + 8}" v2="{b + 8}" v3="{c + 8}"/>' for a, b, c in second.faces)
    both = first.replace("</vertices>", more + "</vertices>").replace("</triangles>", faces + "</triangles>")
    raw = folder.read(write(tmp_path / "x.3mf", model(both, item(1))), scale=0.05)
    assert [part.name for part in raw.parts] == ["part_1", "part_2"]
    assert raw.remarks == ("part: split into 2 bodies",)


LOOP = group(3, "a", component(4)) + group(4, "b", component(3))
BROKEN = {
    "no build list": (model(LEG + TOP, ""), "build list has no object"),
    "object that is not there": (model(LEG, item(1) + item(6)), "line 1 refers to object '6', which is not there"),
    "loop": (model(LOOP, item(3)), "nested deeper than 64, or loop"),
    "vertex that is not there": (
        model(LEG.replace('v1="0"', 'v1="99"', 1), item(1)),
        "object 'leg': mesh face refers to vertex 99",
    ),
    "no number": (model(LEG.replace('x="0"', 'x="zero"', 1), item(1)), r"line 1: could not convert string to float"),
    "no coordinate": (model(LEG.replace('x="0"', "", 1), item(1)), "line 1 lacks 'x'"),
    "not a number": (model(LEG.replace('x="0"', 'x="nan"', 1), item(1)), "not finite"),
    "transform of 3 numbers": (model(LEG, item(1, "1 2 3")), "transform '1 2 3'; expected 12 numbers"),
    "transform that overflows": (
        model(LEG, item(1, "1e308 0 0 0 1 0 0 0 1 16 0 0")),
        r"object 'leg': mesh vertex \d is not finite",
    ),
    "nested transforms that overflow": (
        model(LEG + group(3, "a", component(1, "1e200 0 0 0 1 0 0 0 1 0 0 0")), item(3, "1e200 0 0 0 1 0 0 0 1 0 0 0")),
        r"object 'leg': mesh vertex \d is not finite",
    ),
    "unknown unit": (model(LEG, item(1), 'unit="ell"'), "its unit 'ell' is not known"),
    "cut XML": (model(LEG, item(1))[:400], "not well-formed XML"),
    "entities": (
        model(LEG, item(1)).replace("<model", '<!DOCTYPE model [<!ENTITY a "x">]><model', 1),
        "declares a document type",
    ),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", BROKEN)
def test_broken_models(tmp_path: Path, name: str) -> None:
    text, message = BROKEN[name]
    with pytest.raises(FurnitureError, match=message) as caught:
        folder.read(write(tmp_path / "x.3mf", text))
    assert "x.3mf" in str(caught.value)
    assert str(caught.value).isprintable()


def test_files_that_are_no_archives(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.3mf", model(LEG + TOP, item(1) + item(2))).read_bytes()
    for content in (b"", b"solid x", whole[: len(whole) // 2]):
        (tmp_path / "x.3mf").write_bytes(content)
        with pytest.raises(FurnitureError, match=r"x.3mf' cannot be read as 3MF: it is no ZIP archive"):
            folder.read(tmp_path / "x.3mf")
    with zipfile.ZipFile(tmp_path / "y.3mf", "w") as archive:
        archive.writestr("a.txt", "x")
    with pytest.raises(FurnitureError, match=r"its archive has no '3d/3dmodel.model'"):
        folder.read(tmp_path / "y.3mf")


def test_archive_whose_members_lie_before_its_start(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.3mf", model(LEG + TOP, item(1) + item(2))).read_bytes()
    (tmp_path / "x.3mf").write_bytes(with_members_before_the_start(whole))
    with pytest.raises(FurnitureError, match=r"x.3mf' cannot be read as 3MF: .*cannot be unpacked"):
        folder.read(tmp_path / "x.3mf")


def test_archive_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    with (
        zipfile.ZipFile(tmp_path / "x.3mf", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("3D/3dmodel.model", "w") as member,
    ):
        for _ in range(140):
            member.write(b" " * 2**20)
    assert (tmp_path / "x.3mf").stat().st_size < 2**20
    with pytest.raises(FurnitureError, match="unpacks to more than 128 MiB"):
        folder.read(tmp_path / "x.3mf")


def test_components_that_multiply_are_refused(tmp_path: Path) -> None:
    """Ten levels of ten components each would be 10,000 million boxes."""
    levels = "".join(group(k, "", *([component(k - 1)] * 10)) for k in range(2, 12))
    with pytest.raises(FurnitureError, match="places more than 20000 objects"):
        folder.read(write(tmp_path / "x.3mf", model(LEG + levels, item(11))))
