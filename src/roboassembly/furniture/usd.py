"""Export of furniture as USD (OpenUSD), with the physics that Isaac Sim, Newton and others read."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import numpy as np

from roboassembly.errors import InputError, MissingExtraError
from roboassembly.furniture.export import exported_file, with_safe_names
from roboassembly.furniture.model import Furniture
from roboassembly.furniture.triangles import unique_names
from roboassembly.geometry.meshes import WOOD_DENSITY, Mesh
from roboassembly.geometry.poses import SE3, pose_to_seven

_LIFT = 1e-3
"""Height of the lowest point above the ground [m]."""
_COLOR = (0.80, 0.62, 0.42)


def _pxr(name: str) -> Any:
    """Return a module of OpenUSD, which ships no types."""
    return importlib.import_module(f"pxr.{name}")


def check_usd() -> None:
    """Check that USD can be written.

    Raises:
        MissingExtraError: the `usd` extra is not installed.
    """
    try:
        importlib.import_module("pxr")
    except ModuleNotFoundError:
        raise MissingExtraError("usd-core", "usd") from None


def export_usd(furniture: Furniture, folder: Path) -> Path:
    """Write `FURNITURE.usda` with all meshes in it; returns the file.

    The furniture is one rigid body, the default prim. Each part is an `Xform` at its assembled pose with a mesh that
    collides and has a mass. Lengths are metres, z is up.

    Raises:
        MissingExtraError: the `usd` extra is not installed.
        InputError: the file cannot be written.
    """
    check_usd()
    geom, physics = _pxr("UsdGeom"), _pxr("UsdPhysics")
    path = exported_file(furniture, folder, "usd")
    furniture = with_safe_names(furniture)
    stage = _pxr("Usd").Stage.CreateInMemory()
    geom.SetStageUpAxis(stage, geom.Tokens.z)
    geom.SetStageMetersPerUnit(stage, 1.0)
    physics.SetStageKilogramsPerUnit(stage, 1.0)
    whole = geom.Xform.Define(stage, f"/{_identifier(furniture.name)}")
    stage.SetDefaultPrim(whole.GetPrim())
    _pxr("Usd").ModelAPI(whole.GetPrim()).SetKind(_pxr("Kind").Tokens.component)
    physics.RigidBodyAPI.Apply(whole.GetPrim())
    whole.AddTranslateOp().Set((0.0, 0.0, _LIFT - furniture.lowest))
    names = unique_names([_identifier(part.name) for part in furniture.parts])
    for name, part, pose in zip(map(_identifier, names), furniture.parts, furniture.assembled, strict=True):
        frame = geom.Xform.Define(stage, whole.GetPath().AppendChild(name))
        _place(frame, pose)
        mesh = geom.Mesh.Define(stage, frame.GetPath().AppendChild("mesh"))
        _shape(mesh, part.mesh)
        _weigh(physics.MassAPI.Apply(mesh.GetPrim()), part.mesh)
        physics.CollisionAPI.Apply(mesh.GetPrim())
        collision = physics.MeshCollisionAPI.Apply(mesh.GetPrim())
        collision.CreateApproximationAttr(physics.Tokens.convexDecomposition)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(stage.GetRootLayer().ExportToString(), encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from None
    return path


def _place(frame: Any, pose: SE3) -> None:
    x, y, z, qw, qx, qy, qz = pose_to_seven(pose)
    frame.AddTranslateOp().Set((x, y, z))
    turn = _pxr("Gf").Quatd(qw, qx, qy, qz)
    frame.AddOrientOp(_pxr("UsdGeom").XformOp.PrecisionDouble).Set(turn)


def _shape(target: Any, mesh: Mesh) -> None:
    vt = _pxr("Vt")
    points = np.ascontiguousarray(mesh.vertices, dtype=np.float32)
    target.CreatePointsAttr(vt.Vec3fArray.FromNumpy(points))
    target.CreateFaceVertexCountsAttr(vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, dtype=np.int32)))
    target.CreateFaceVertexIndicesAttr(vt.IntArray.FromNumpy(np.ascontiguousarray(mesh.faces.ravel(), dtype=np.int32)))
    target.CreateSubdivisionSchemeAttr(_pxr("UsdGeom").Tokens.none)
    target.CreateExtentAttr(vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)])))
    target.CreateDisplayColorAttr([_COLOR])


def _weigh(target: Any, mesh: Mesh) -> None:
    gf = _pxr("Gf")
    principal, axes = np.linalg.eigh(WOOD_DENSITY * mesh.inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    _, _, _, qw, qx, qy, qz = pose_to_seven(SE3(axes, np.zeros(3)))
    target.CreateMassAttr(float(WOOD_DENSITY * mesh.volume))
    target.CreateCenterOfMassAttr(gf.Vec3f(*map(float, mesh.center_of_mass)))
    target.CreateDiagonalInertiaAttr(gf.Vec3f(*map(float, principal)))
    target.CreatePrincipalAxesAttr(gf.Quatf(qw, qx, qy, qz))


def _identifier(name: str) -> str:
    """Return a name of a prim: letters, digits and underscores."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name) or "_"
    return f"_{plain}" if plain[0].isdigit() else plain
