"""The typed stubs in `typings/` name what the installed libraries have, with the types that they return."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coal
import fast_simplification
import imageio.v3 as iio
import imageio_ffmpeg
import jax
import jax.numpy as jnp
import manifold3d as m3
import mujoco
import numpy as np
import optax
import pinocchio as pin
import pytest
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene

SE3 = pin.SE3
TYPINGS = Path(__file__).parents[1] / "typings"
STUBS = {
    ".".join(p.relative_to(TYPINGS).with_suffix("").parts).removesuffix(".__init__"): p for p in TYPINGS.rglob("*.pyi")
}
INSTANCES: dict[str, Any] = {
    "mujoco.MjVisual": lambda: mujoco.MjSpec().visual,
    "mujoco.MjOption": lambda: mujoco.MjSpec().option,
    "mujoco.MjStatistic": lambda: mujoco.MjSpec().stat,
}
"""Classes whose attributes only an instance shows."""


def names_of(body: list[ast.stmt], owner: str) -> Iterator[str]:
    """Dotted names of everything that a stub declares; private helpers of the stub are left out."""
    for node in body:
        match node:
            case ast.ClassDef(name=name) if not name.startswith("_"):
                yield f"{owner}.{name}"
                yield from names_of(node.body, f"{owner}.{name}")
            case (
                ast.FunctionDef(name=name)
                | ast.AnnAssign(target=ast.Name(id=name))
                | ast.Assign(targets=[ast.Name(id=name)])
            ) if name.startswith("__") or not name.startswith("_"):
                if not (isinstance(node, ast.Assign) and owner in STUBS):  # TypeVar
                    yield f"{owner}.{name}"
            case _:
                pass


def declared() -> list[str]:
    return sorted({n for module, path in STUBS.items() for n in names_of(ast.parse(path.read_text()).body, module)})


def found(dotted: str) -> Any:
    """The object of the library that a dotted name of a stub stands for."""
    module = next(m for m in sorted(STUBS, key=len, reverse=True) if dotted.startswith(f"{m}."))
    value: Any = importlib.import_module(module)
    path = module
    for name in dotted.removeprefix(f"{module}.").split("."):
        if path in INSTANCES and not hasattr(value, name):
            value = INSTANCES[path]()
        value, path = getattr(value, name), f"{path}.{name}"
    return value


def test_every_name_of_the_stubs_exists_in_the_library() -> None:
    missing = []
    for dotted in declared():
        try:
            found(dotted)
        except AttributeError:
            missing.append(dotted)
    assert not missing
    assert len(declared()) > 250


ARRAYS: dict[str, Any] = {
    "coal.BVHModelBase.vertices": lambda: hull().vertices(),
    "coal.DistanceResult.getNearestPoint1": lambda: coal.DistanceResult().getNearestPoint1(),
    "coal.Box.halfSide": lambda: coal.Box(1.0, 2.0, 3.0).halfSide,
    "pinocchio.SE3.act": lambda: SE3.Identity().act(np.ones(3)),
    "pinocchio.SE3ToXYZQUAT": lambda: pin.SE3ToXYZQUAT(SE3.Identity()),
    "pinocchio.Quaternion.coeffs": lambda: pin.Quaternion(1.0, 0.0, 0.0, 0.0).coeffs(),
    "pinocchio.exp3": lambda: pin.exp3(np.ones(3)),
    "pinocchio.log3": lambda: pin.log3(np.eye(3)),
    "pinocchio.Motion.vector": lambda: pin.log6(pin.exp6(np.ones(6))).vector,
    "pinocchio.rpy.matrixToRpy": lambda: pin.rpy.matrixToRpy(np.eye(3)),
    "pinocchio.rpy.rpyToMatrix": lambda: pin.rpy.rpyToMatrix(0.1, 0.2, 0.3),
    "pinocchio.Model.lowerPositionLimit": lambda: free_flyer().lowerPositionLimit,
    "pinocchio.neutral": lambda: pin.neutral(free_flyer()),
    "mujoco.MjModel.body_mass": lambda: ball().body_mass,
    "mujoco.MjData.qpos": lambda: mujoco.MjData(ball()).qpos,
    "mujoco.MjsBody.ipos": lambda: mujoco.MjSpec().worldbody.ipos,
    "manifold3d.Mesh64.vert_properties": lambda: m3.Manifold.cube().to_mesh64().vert_properties,
    "fast_simplification.simplify": lambda: fast_simplification.simplify(*triangles(), target_count=8, agg=1.0)[0],
    "trimesh.Trimesh.vertices": lambda: trimesh.creation.box().vertices,
    "trimesh.Trimesh.face_normals": lambda: trimesh.creation.box().face_normals,
    "trimesh.Trimesh.area_faces": lambda: trimesh.creation.box().area_faces,
    "trimesh.Trimesh.center_mass": lambda: trimesh.creation.box().center_mass,
    "trimesh.Trimesh.moment_inertia": lambda: trimesh.creation.box().moment_inertia,
    "trimesh.Trimesh.triangles": lambda: trimesh.creation.box().triangles,
    "trimesh.Trimesh.triangles_center": lambda: trimesh.creation.box().triangles_center,
    "trimesh.bounds.oriented_bounds": lambda: trimesh.bounds.oriented_bounds(triangles()[0])[0],
    "trimesh.sample.sample_surface": lambda: trimesh.sample.sample_surface(trimesh.creation.box(), 3, seed=0)[0],
    "trimesh.triangles.closest_point": lambda: trimesh.triangles.closest_point(np.eye(3)[None], np.zeros((1, 3))),
    "trimesh.triangles.points_to_barycentric": lambda: trimesh.triangles.points_to_barycentric(
        np.eye(3)[None], np.zeros((1, 3))
    ),
}
"""Calls whose result the stubs call an array of 64-bit floats."""


def hull() -> coal.BVHModelOBBRSS:
    model = coal.BVHModelOBBRSS()
    model.beginModel(4, 4)
    model.addVertices(np.vstack([np.zeros(3), np.eye(3)]))
    model.addTriangles(np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    model.endModel()
    return model


def triangles() -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box()
    return np.array(box.vertices), np.array(box.faces)


def free_flyer() -> pin.Model:
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), SE3.Identity(), "joint")
    return model


def ball() -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="ball", pos=np.ones(3), quat=[1, 0, 0, 0], gravcomp=0.0)
    body.add_joint(name="slide", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], limited=True, range=[-1, 1])
    body.add_geom(name="ball", mass=1.0, size=[0.1, 0, 0], friction=[1.0, 0.1, 0.1], condim=3, solref=[0.01, 1.0])
    return spec.compile()


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_are_64_bit_floats_as_the_stubs_say(name: str) -> None:
    assert name in declared()
    array = ARRAYS[name]()
    assert isinstance(array, np.ndarray)
    assert array.dtype == np.float64


def test_collision_calls_take_and_return_what_the_stubs_say() -> None:
    here, away = coal.Transform3s.Identity(), coal.Transform3s(np.eye(3), np.array([3.0, 0.0, 0.0]))
    model = hull()
    assert model.buildConvexHull(True, "Qt")
    assert isinstance(model.convex, coal.ConvexBase)
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.num_max_contacts, request.security_margin, request.break_distance = 3, 0.01, 0.0
    assert coal.collide(model, here, coal.Sphere(0.5), here, request, result) == result.numContacts() > 0
    assert result.isCollision()
    contact = result.getContact(0)
    assert (type(contact.b1), type(contact.b2), contact.pos.shape) == (int, int, (3,))
    assert len(result.getContacts()) == result.numContacts()
    distance = coal.distance(model, here, coal.Sphere(0.5), away, coal.DistanceRequest(True), coal.DistanceResult())
    assert distance == pytest.approx(1.5, abs=1e-6)


def test_batches_of_collision_tests_return_one_flag_a_configuration() -> None:
    geometry = pin.GeometryModel()
    model = free_flyer()
    first = geometry.addGeometryObject(pin.GeometryObject("moves", 1, SE3.Identity(), coal.Sphere(0.1)))
    second = geometry.addGeometryObject(pin.GeometryObject("stays", 0, SE3.Identity(), hull()))
    geometry.addCollisionPair(pin.CollisionPair(first, second))
    q = np.asfortranarray(np.array([[0, 0, 0, 0, 0, 0, 1.0], [5, 0, 0, 0, 0, 0, 1.0]]).T)
    for kind in (pin.GeometryPool, pin.TreeBroadPhaseManagerPool_DynamicAABBTreeCollisionManager):
        pool = kind(model, geometry, 1)
        assert isinstance(pool.getGeometryDatas()[0].collisionRequests[0], coal.CollisionRequest)
        assert pin.computeCollisionsInParallel(1, pool, q, False).tolist() == [True, False]
    data, geometry_data = model.createData(), pin.GeometryData(geometry)
    assert pin.computeCollisions(model, data, geometry, geometry_data, q[:, 0], False)
    assert geometry_data.collisionResults[0].isCollision()


def test_solids_take_sequences_and_arrays_and_return_what_the_stubs_say() -> None:
    cube = m3.Manifold.cube([1.0, 1.0, 1.0]).translate(np.array([1.0, 0.0, 0.0]))
    assert cube.bounding_box() == (1.0, 0.0, 0.0, 2.0, 1.0, 1.0)
    assert all(type(number) is float for number in (*cube.bounding_box(), cube.volume(), cube.surface_area()))
    below, above = cube.split_by_plane((0.0, 0.0, 1.0), 0.25)
    assert {round(below.volume(), 6), round(above.volume(), 6)} == {0.25, 0.75}
    mesh = cube.to_mesh64()
    assert mesh.tri_verts.dtype == np.uint64
    assert all(type(number) is int for number in (*mesh.run_index, *mesh.run_original_id, cube.num_tri()))
    assert m3.Manifold(m3.Mesh64(np.array(mesh.vert_properties), np.array(mesh.tri_verts))).status() is m3.Error.NoError
    assert m3.Manifold().is_empty()
    hits = cube.ray_cast(np.array([1.5, 0.5, -1.0]), (1.5, 0.5, 2.0))
    assert [type(hit) for hit in hits] == [m3.RayHit, m3.RayHit]
    outline = m3.CrossSection([np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])])
    assert (m3.CrossSection() + outline).extrude(2.0).volume() == pytest.approx(1.0)
    assert m3.triangulate([np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])]).dtype == np.int32


def test_triangles_rays_and_samples_are_what_the_stubs_say(tmp_path: Path) -> None:
    vertices, faces = triangles()
    assert fast_simplification.simplify(vertices, faces, target_count=8, agg=1.0)[1].dtype == np.int32
    box = trimesh.Trimesh(vertices, faces, process=False)
    assert (box.faces.dtype, box.is_volume, isinstance(box.volume, float)) == (np.int64, True, True)
    assert box.contains(np.zeros((1, 3))).dtype == np.bool_
    assert trimesh.sample.sample_surface(box, 3, seed=np.random.default_rng(0))[1].dtype == np.int64
    assert isinstance(box.export(tmp_path / "box.ply", encoding="binary", vertex_normal=False), bytes)
    moved = trimesh.load_mesh(tmp_path / "box.ply", file_type="ply", process=False).apply_translation([0.5, 0.0, 0.0])
    assert trimesh.boolean.intersection([box, moved], engine="manifold").volume == pytest.approx(0.5)
    scene = EmbreeScene(EmbreeDevice())
    kept = TriangleMesh(scene, vertices[faces].astype(np.float32))
    first = scene.run(np.array([[0.1, 0.2, 5.0]], np.float32), np.array([[0.0, 0.0, -1.0]], np.float32))
    assert (first.dtype, kept is not None) == (np.int32, True)
    assert vertices[faces[first[0]]][:, 2].tolist() == [0.5, 0.5, 0.5]


def test_a_file_without_faces_is_a_mesh_without_faces(tmp_path: Path) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(f"property float {axis}\n" for axis in "xyz")
    (tmp_path / "point.ply").write_text(f"{header}end_header\n0 0 0\n")
    loaded = trimesh.load_mesh(tmp_path / "point.ply", file_type="ply", process=False)
    assert (type(loaded), len(loaded.faces)) == (trimesh.Trimesh, 0)


def test_pictures_are_written_and_ffmpeg_found_as_the_stubs_say(tmp_path: Path) -> None:
    picture = np.zeros((32, 32, 3), np.uint8)
    iio.imwrite(tmp_path / "a.png", picture, extension=".png")
    assert iio.imread(tmp_path / "a.png").dtype == np.uint8
    assert Path(imageio_ffmpeg.get_ffmpeg_exe()).is_file()


def test_transformations_of_jax_take_and_return_what_the_stubs_say() -> None:
    def loss(x: jax.Array, y: float) -> tuple[jax.Array, dict[str, jax.Array]]:
        return (x * y).sum(), {"largest": x.max()}

    x = jnp.arange(3)[:, None] * jnp.zeros((3, 1))
    (value, terms), gradient = jax.value_and_grad(loss, has_aux=True)(x, 2.0)
    assert [type(v).__name__ for v in (value, terms["largest"], gradient)] == ["ArrayImpl"] * 3
    assert jax.jit(loss, static_argnums=1)(x, 2.0)[1].keys() == terms.keys()
    total, rows = jax.lax.scan(lambda a, b: (a + b, b), jnp.zeros((1,)), x)
    assert (total.shape, rows.shape) == ((1,), (3, 1))
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(optax.cosine_decay_schedule(0.1, 9)))
    params = {"a": {"w": x}}
    state = optimiser.init(params)
    structure, leaves = jax.tree.structure(state), jax.tree.leaves(state)
    assert structure.num_leaves == len(leaves)
    change, state = optimiser.update(params, jax.tree.unflatten(structure, leaves), params)
    assert jax.tree.structure(optax.apply_updates(params, change)) == jax.tree.structure(params)
