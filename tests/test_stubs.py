"""The typed stubs in `typings/` name what the installed libraries have, with the types that they return."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin
import pytest

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
}
"""Calls whose result the stubs call an array of 64-bit floats."""


def hull() -> coal.BVHModelOBBRSS:
    model = coal.BVHModelOBBRSS()
    model.beginModel(4, 4)
    model.addVertices(np.vstack([np.zeros(3), np.eye(3)]))
    model.addTriangles(np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    model.endModel()
    return model


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
