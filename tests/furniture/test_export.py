"""Exports as other programs read them."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from roboassembly.datasets import catalogue
from roboassembly.furniture.export import WOOD_DENSITY, export_mjcf, export_urdf
from roboassembly.furniture.usd import export_usd

PIECES = ["ladder", "pedestal:3", "stool"]


@pytest.mark.parametrize("name", PIECES)
def test_mujoco_reads_it_and_it_stands(name: str, tmp_path: Path) -> None:
    furniture = catalogue.find(name)
    model = mujoco.MjModel.from_xml_path(str(export_mjcf(furniture, tmp_path)))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.nbody == len(furniture.parts) + 1
    expected = WOOD_DENSITY * sum(p.mesh.volume for p in furniture.parts)
    assert model.body_mass.sum() == pytest.approx(expected, rel=1e-6)
    lift = data.body(furniture.parts[0].name).xpos[2] - furniture.assembled[0].translation[2]
    for part, slot in zip(furniture.parts, furniture.assembled, strict=True):
        body = data.body(part.name)
        np.testing.assert_allclose(body.xpos - [0, 0, lift], slot.translation, atol=1e-6)
        np.testing.assert_allclose(body.xmat.reshape(3, 3), slot.rotation, atol=1e-6)
    top = max(data.body(p.name).xpos[2] for p in furniture.parts)
    mujoco.mj_step(model, data, nstep=1000)
    assert max(data.body(p.name).xpos[2] for p in furniture.parts) == pytest.approx(top, abs=0.005)


@pytest.mark.parametrize("name", PIECES)
def test_pinocchio_reads_the_urdf_and_every_link_is_in_place(name: str, tmp_path: Path) -> None:
    furniture = catalogue.find(name)
    path = export_urdf(furniture, tmp_path)
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    pin.updateFramePlacements(model, data)
    for part, slot in zip(furniture.parts, furniture.assembled, strict=True):
        there = data.oMf[model.getFrameId(part.name)]
        np.testing.assert_allclose(there.homogeneous, furniture.assembled[0].actInv(slot).homogeneous, atol=1e-6)
    shapes = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.VISUAL, package_dirs=[str(tmp_path)])
    assert shapes.ngeoms == len(furniture.parts)


@pytest.mark.parametrize("name", PIECES)
def test_openusd_reads_it_with_units_poses_and_masses(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdPhysics

    furniture = catalogue.find(name)
    stage = Usd.Stage.Open(str(export_usd(furniture, tmp_path)))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    whole = stage.GetDefaultPrim()
    assert whole.HasAPI(UsdPhysics.RigidBodyAPI)
    # One prim for the piece, and two a part: its frame and its mesh.
    assert len(list(stage.Traverse())) == 1 + 2 * len(furniture.parts)
    mass, lift = 0.0, np.array([0.0, 0.0, 1e-3 - furniture.lowest])
    lowest = np.inf
    for frame, part, slot in zip(whole.GetChildren(), furniture.parts, furniture.assembled, strict=True):
        assert frame.GetName() == part.name.replace(" ", "_").replace("-", "_")
        # USD multiplies rows from the left.
        there = np.array(UsdGeom.Xformable(frame).ComputeLocalToWorldTransform(Usd.TimeCode.Default())).T
        np.testing.assert_allclose(there[:3, 3], slot.translation + lift, atol=1e-6)
        np.testing.assert_allclose(there[:3, :3], slot.rotation, atol=1e-6)
        mesh = UsdGeom.Mesh(frame.GetChild("mesh"))
        points = np.array(mesh.GetPointsAttr().Get())
        np.testing.assert_allclose(points, part.mesh.vertices, atol=1e-6)
        faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        np.testing.assert_array_equal(faces, part.mesh.faces)
        lowest = min(lowest, (points @ there[2, :3] + there[2, 3]).min())
        weight = UsdPhysics.MassAPI(mesh.GetPrim())
        mass += weight.GetMassAttr().Get()
        q = weight.GetPrincipalAxesAttr().Get()
        axes = pin.Quaternion(q.GetReal(), *q.GetImaginary()).toRotationMatrix()
        inertia = axes @ np.diag(weight.GetDiagonalInertiaAttr().Get()) @ axes.T
        np.testing.assert_allclose(inertia, WOOD_DENSITY * part.mesh.inertia, rtol=1e-3, atol=1e-6)
    assert lowest == pytest.approx(1e-3, abs=1e-6)
    assert mass == pytest.approx(WOOD_DENSITY * sum(p.mesh.volume for p in furniture.parts), rel=1e-6)


@pytest.mark.parametrize(
    "name", ["../../outside", "/tmp/outside", "a\x1b]0;b\x07\n", ".hidden", "x" * 300, "\0", "Stühlchen"]
)
def test_names_stay_inside_the_folder_and_make_valid_xml(name: str, tmp_path: Path) -> None:
    furniture = catalogue.make("stool", with_grasps=False)
    parts = tuple(replace(p, name=f"{name}{k % 2}" if k < 2 else p.name) for k, p in enumerate(furniture.parts))
    folder = tmp_path / "some" / "folder"
    for export, suffix in ((export_mjcf, ".xml"), (export_urdf, ".urdf")):
        path = export(replace(furniture, name=name, parts=parts), folder)
        assert (path.parent, path.suffix) == (folder, suffix)
        assert path.name.isprintable()
        assert not path.name.startswith(".")
        assert len(ElementTree.parse(path).findall(".//body" if suffix == ".xml" else "link")) == len(parts)
        if suffix == ".xml":
            assert mujoco.MjModel.from_xml_path(str(path)).nbody == len(parts) + 1
    if importlib.util.find_spec("pxr") is not None:
        from pxr import Usd

        stage = Usd.Stage.Open(str(export_usd(replace(furniture, name=name, parts=parts), folder)))
        assert len(stage.GetDefaultPrim().GetChildren()) == len(parts)
    assert {p for p in tmp_path.rglob("*") if p.is_file()} == {p for p in folder.rglob("*") if p.is_file()}
