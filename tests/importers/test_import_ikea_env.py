"""IKEA Furniture Assembly Environment importer: poses from connection sites, and messages on broken files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from model_files import IKEA_PLATE, IKEA_POST, ikea_body, write_ikea_env
from roboassembly.errors import FurnitureError
from roboassembly.furniture import storage
from roboassembly.importers import ikea_env
from roboassembly.importers.pipeline import finish


def test_rotated_sites(tmp_path):
    """Check by hand: plate from post is T(0, 0, 0.2) Rz(90) [T(0.1, 0, -0.01) Rx(180)]^-1: centre (0, -0.1, 0.19)."""
    raw = ikea_env.read(write_ikea_env(tmp_path, IKEA_POST, IKEA_PLATE))
    post, plate = (p.mesh.bounds for p in raw.parts)
    # The plate lies upside down, its long side along y; all is centred and set on the ground.
    assert np.allclose(post, [[-0.05, 0.05, 0.0], [0.05, 0.15, 0.4]], atol=1e-6)
    assert np.allclose(plate, [[-0.1, -0.2, 0.38], [0.1, 0.2, 0.4]], atol=1e-6)
    assert [(p.name, p.label) for p in raw.parts] == [("post", "post"), ("plate", "plate")]
    one, two = raw.sites
    assert (one.name, one.part, one.mate) == ("post-plate,90,conn_site1", 0, 1)
    assert (two.name, two.part, two.mate) == ("plate-post,90,conn_site1", 1, 0)
    for site in raw.sites:
        assert np.allclose(site.frame.translation, [0.0, 0.1, 0.4], atol=1e-6)
        assert np.allclose(site.frame.rotation[:, 2], [0.0, 0.0, 1.0], atol=1e-6)


def test_scale(tmp_path):
    raw = ikea_env.read(write_ikea_env(tmp_path, IKEA_POST, IKEA_PLATE), scale=2.0)
    assert np.allclose(raw.parts[1].mesh.bounds, [[-0.2, -0.4, 0.76], [0.2, 0.4, 0.8]], atol=1e-6)
    assert np.allclose(raw.sites[0].frame.translation, [0.0, 0.2, 0.8], atol=1e-6)


def test_mirrored_and_stretched_meshes(tmp_path):
    plate = ikea_body("plate", [("plate-post,90,conn_site1", "0.1 0 -0.01", "0 1 0 0")], scale="-1 0.5 1")
    mesh = ikea_env.read(write_ikea_env(tmp_path, IKEA_POST, plate)).parts[1].mesh
    assert mesh.is_solid
    assert mesh.volume == pytest.approx(0.4 * 0.1 * 0.02, rel=1e-4)


def test_the_up_axis_is_that_of_most_bodies(tmp_path):
    sites = [("a-b,0,conn_site1", "0 0 0.2", "1 0 0 0"), ("a-c,0,conn_site1", "0 0 -0.2", "1 0 0 0")]
    post = ikea_body("post", sites)
    plate = ikea_body("plate", [("b-a,0,conn_site1", "0 0 0", "1 0 0 0")], pose='quat="0 1 0 0"')
    rail = ikea_body("rail", [("c-a,0,conn_site1", "0 0 0", "1 0 0 0")], pose='quat="0 1 0 0"')
    raw = ikea_env.read(write_ikea_env(tmp_path, post, plate, rail))
    assert raw.parts[1].mesh.bounds[1, 2] < 0.1 < raw.parts[2].mesh.bounds[0, 2]


def two_pairs(at: str) -> tuple[tuple[str, str], tuple[str, str]]:
    post = [("a-b,0,90,conn_site1", "0 0 0.2", "1 0 0 0"), ("a-b,0,90,conn_site2", "0.04 0 0.2", "1 0 0 0")]
    plate = [("b-a,0,90,conn_site1", "0 0 0", "1 0 0 0"), ("b-a,0,90,conn_site2", at, "1 0 0 0")]
    return ikea_body("post", post), ikea_body("plate", plate)


def test_the_angle_that_closes_all_pairs_is_chosen(tmp_path):
    raw = ikea_env.read(write_ikea_env(tmp_path, *two_pairs("0 -0.04 0")))
    assert np.allclose(np.ptp(raw.parts[1].mesh.bounds, axis=0), [0.2, 0.4, 0.02], atol=1e-6)
    assert [site.mate for site in raw.sites] == [1, 0, 3, 2]


def test_sites_stay_where_their_parts_are_and_survive_a_file(tmp_path):
    furniture = finish("piece", ikea_env.read(write_ikea_env(tmp_path, *two_pairs("0 -0.04 0")))).furniture
    loaded = storage.load(storage.save(furniture, tmp_path / "out"))
    assert [(s.name, s.part, s.mate) for s in loaded.sites] == [(s.name, s.part, s.mate) for s in furniture.sites]
    assert len(loaded.sites) == 4
    for site in loaded.sites:
        mate = loaded.sites[site.mate]
        here, there = (loaded.assembled[s.part] * s.frame for s in (site, mate))
        assert np.linalg.norm(here.translation - there.translation) < 1e-3
        assert here.rotation[:, 2] @ there.rotation[:, 2] > np.cos(np.radians(5.0))


def test_sites_follow_a_part_that_repair_moves(tmp_path):
    """Repair moves a plate 6 mm down to the post; its sites then no longer meet."""
    plate = ikea_body("plate", [("plate-post,90,conn_site1", "0.1 0 0.016", "0 1 0 0")])
    raw = ikea_env.read(write_ikea_env(tmp_path, IKEA_POST, plate))
    imported = finish("piece", raw)
    assert sum(repair.displacement for repair in imported.repairs) == pytest.approx(0.0058, abs=1e-4)
    for site, before in zip(imported.furniture.sites, raw.sites, strict=True):
        now = imported.furniture.assembled[site.part] * site.frame
        shift = imported.repairs[site.part].shift
        assert np.allclose(now.translation, before.frame.translation + shift, atol=1e-9)
        assert np.allclose(now.rotation, before.frame.rotation, atol=1e-9)
        assert (before.mate, site.mate) == (1 - before.part, None)
    (note,) = [n for n in imported.furniture.provenance.notes if "connection sites" in n]
    assert note == (
        "connection sites 'post-plate,90,conn_site1' and 'plate-post,90,conn_site1' are 5.8 mm apart after repair"
    )


def test_scaled_up_sites_still_meet(tmp_path):
    """0.9 mm apart in the file, 1.8 mm at twice the size."""
    furniture = finish(
        "piece", ikea_env.read(write_ikea_env(tmp_path, *two_pairs("0.0009 -0.04 0")), scale=2.0)
    ).furniture
    assert [site.mate for site in furniture.sites] == [1, 0, 3, 2]
    assert not any("connection sites" in note for note in furniture.provenance.notes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"mate": 1', '"mate": 9', "a part or a site that is not there"),
        ('"mate": 1', '"mate": 3', "which has another"),
        ('"mate": 1', '"mate": null', "which has another"),
        ('"mate": 1', '"mate": "b"', "not valid"),
    ],
)
def test_broken_sites(tmp_path, old, new, message):
    folder = storage.save(
        finish("piece", ikea_env.read(write_ikea_env(tmp_path, *two_pairs("0 -0.04 0")))).furniture, tmp_path / "o"
    )
    text = (folder / "furniture.json").read_text()
    assert text.count(old) == 1
    (folder / "furniture.json").write_text(text.replace(old, new))
    with pytest.raises(FurnitureError, match=message) as caught:
        storage.load(folder)
    assert "\n" not in str(caught.value)


def test_open_pairs_are_refused_with_the_distance(tmp_path):
    ikea_env.read(write_ikea_env(tmp_path, *two_pairs("0.0409 0 0")))
    with pytest.raises(FurnitureError, match=r"'a-b,0,90,conn_site2'.* stay 2\.50 mm and 0° apart; 1 mm"):
        ikea_env.read(write_ikea_env(tmp_path, *two_pairs("0.0425 0 0")))


def test_tilted_pairs_do_not_close(tmp_path):
    post = [("a-b,0,conn_site1", "0 0 0.2", "1 0 0 0"), ("a-b,0,conn_site2", "0.04 0 0.2", "1 0 0 0")]
    plate = [("b-a,0,conn_site1", "0 0 0", "1 0 0 0"), ("b-a,0,conn_site2", "0.04 0 0", "0.70710678 0.70710678 0 0")]
    with pytest.raises(FurnitureError, match="90° apart"):
        ikea_env.read(write_ikea_env(tmp_path, ikea_body("post", post), ikea_body("plate", plate)))


def test_sites_without_a_suffix_join_unmatched_sites(tmp_path):
    post = ikea_body("post", [("leg-top,,conn_site0", "0 0 0.2", "1 0 0 0")])
    plate = ikea_body(
        "plate", [("top-leg,,conn_site4", "0.15 0 0", "1 0 0 0"), ("top-leg,,conn_site5", "-0.15 0 0", "1 0 0 0")]
    )
    sites = ikea_env.read(write_ikea_env(tmp_path, post, plate)).sites
    assert [(s.name[-5:], s.mate) for s in sites] == [("site0", 1), ("site4", 0), ("site5", None)]


def test_the_search_gives_up_after_a_limit(tmp_path):
    """The search gives up on twenty sites on each of two parts and a third part that fits none of them."""
    spots = [f"0.0{k // 10}{k % 10} 0.01 0" for k in range(20)]
    post = [(f"a-b,,conn_site{k}", spot, "1 0 0 0") for k, spot in enumerate(spots)]
    plate = [(f"b-a,,conn_site{k + 50}", spot, "1 0 0 0") for k, spot in enumerate(spots)]
    plate += [("b-c,0,conn_site1", "0 0 0", "1 0 0 0"), ("b-c,0,conn_site2", "0.1 0 0", "1 0 0 0")]
    rail = [("c-b,0,conn_site1", "0 0 0", "1 0 0 0"), ("c-b,0,conn_site2", "0.2 0 0", "1 0 0 0")]
    with pytest.raises(FurnitureError, match=r"100\.00 mm .*\(gave up after \d+ placements\)"):
        ikea_env.read(
            write_ikea_env(tmp_path, ikea_body("post", post), ikea_body("plate", plate), ikea_body("rail", rail))
        )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not well-formed"),
        ("<mujoco>", "not well-formed"),
        ("<robot/>", "root is <robot>"),
        ("<mujoco/>", "0 parts"),
        ('<!DOCTYPE m [<!ENTITY a "b">]><mujoco/>', "document type or entities"),
        ('<!DOCTYPE m SYSTEM "file:///etc/passwd"><mujoco/>', "document type or entities"),
        ('<mujoco><include file="/etc/passwd"/></mujoco>', "includes other files"),
        ("<mujoco>" * 100, "deeper than 64"),
        ('<?xml version="1.0" encoding="nonsense"?><mujoco/>', "not well-formed"),
    ],
)
def test_broken_xml(tmp_path, text, message):
    file = write_ikea_env(tmp_path, IKEA_POST, IKEA_PLATE)
    file.write_text(text)
    with pytest.raises(FurnitureError, match=message) as caught:
        ikea_env.read(file)
    assert "\n" not in str(caught.value)


def test_entities_in_other_encodings(tmp_path):
    file = write_ikea_env(tmp_path, IKEA_POST, IKEA_PLATE)
    file.write_bytes(
        '<?xml version="1.0" encoding="UTF-16"?><!DOCTYPE m [<!ENTITY a "b">]><mujoco>&a;</mujoco>'.encode("utf-16")
    )
    with pytest.raises(FurnitureError, match="document type or entities"):
        ikea_env.read(file)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("piece/post.stl", "../outside.stl", "not inside"),
        ("piece/post.stl", "/etc/passwd", "not inside"),
        ("piece/post.stl", "piece/link.stl", "not inside"),
        ("piece/post.stl", "C:\\\\windows", "not inside"),
        ("piece/post.stl", "", "not inside"),
        ("piece/post.stl", "piece/gone.stl", "cannot be read"),
        ("piece/post.stl", "piece", "not a mesh file that can be read"),
        ('mesh="m_post"', 'mesh="x"', "not among its assets"),
        ('mesh="m_post"', "", "no mesh; bodies made of primitives"),
        ('name="plate"', 'name="post"', "all different"),
        ('quat="0 1 0 0"', 'quat="0 0 0 0"', "no direction"),
        ('quat="0 1 0 0"', 'euler="0 1 0"', "turned by 'euler'"),
        ('pos="5 5 5"', 'pos="5 5"', "3 finite numbers"),
        ('pos="5 5 5"', 'pos="5 5 nan"', "3 finite numbers"),
        ('scale="1 1 1"', 'scale="0 1 1"', "is scaled by"),
        ('scale="1 1 1"', 'scale="1e5 1e5 1e5"', "name the unit of the files"),
        ("plate-post,90,", "plate-seat,90,", "do not join all parts"),
        ("post-plate,90,", "post-plate,ninety,", "angles in its name are not numbers"),
        ("<geom", "<body/><geom", "holds another body"),
    ],
)
def test_broken_models(tmp_path, old, new, message):
    folder = tmp_path / "in"
    folder.mkdir()
    file = write_ikea_env(folder, IKEA_POST, IKEA_PLATE)
    trimesh.creation.box().export(tmp_path / "outside.stl")
    (folder / "piece" / "link.stl").symlink_to(tmp_path / "outside.stl")
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(FurnitureError, match=message) as caught:
        ikea_env.read(file)
    assert "\n" not in str(caught.value)


def test_meshdir(tmp_path):
    file = write_ikea_env(tmp_path, IKEA_POST, IKEA_PLATE, extra='<compiler meshdir="piece"/>')
    file.write_text(file.read_text().replace("piece/po", "po").replace("piece/pl", "pl"))
    assert len(ikea_env.read(file).parts) == 2


def test_find(tmp_path):
    file = write_ikea_env(tmp_path, IKEA_POST, IKEA_PLATE)
    (tmp_path / "other.xml").write_text("<robot/>")
    assert ikea_env.find(tmp_path) == ikea_env.find(file) == [file]
    with pytest.raises(FurnitureError, match="holds no MJCF"):
        ikea_env.find(tmp_path / "piece")


SAMPLES = Path(os.environ.get("ROBOASSEMBLY_SAMPLES", "/nonexistent")) / "clvrai_furniture" / "objects"


@pytest.mark.slow
@pytest.mark.skipif(not SAMPLES.is_dir(), reason="set ROBOASSEMBLY_SAMPLES to the folder of sample furniture")
def test_most_samples_close():
    closed, refused = [], {}
    for file in sorted(SAMPLES.glob("*.xml")):
        try:
            raw = ikea_env.read(file)
        except FurnitureError as problem:
            refused[file.stem] = str(problem)
            continue
        closed.append(file.stem)
        assert raw.parts[0].mesh.bounds[0, 2] >= -1e-6
        met = [site for site in raw.sites if site.mate is not None]
        assert len({site.part for site in met}) == len(raw.parts)
        for site in met:
            there = raw.sites[site.mate].frame
            assert np.linalg.norm(site.frame.translation - there.translation) < 1e-3
    assert len(closed) >= 45
    assert "stay 10.00 mm" in refused["chair_bertil_0148"]
