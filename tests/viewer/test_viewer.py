from __future__ import annotations

import base64
import itertools
import os
import re
import sys
import threading

import imageio.v3 as iio
import msgspec
import numpy as np
import pytest
import trimesh
import zstandard
from scipy.spatial import Delaunay

from roboassembly.errors import InputError
from roboassembly.furniture.model import Connection, ConnectionPoint, Furniture, Part, ShapeClass
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.rendering import gl
from roboassembly.rendering.camera import Camera, fit_camera, project
from roboassembly.rendering.colors import Role
from roboassembly.rendering.edges import smooth_edges
from roboassembly.rendering.renderer import OffscreenRenderer
from roboassembly.rendering.shading import shade
from roboassembly.task.plans.plan import Plan, PlanStep
from roboassembly.viewer.camera_path import follow
from roboassembly.viewer.film import (
    RenderingUnavailableError,
    render_contact_sheet,
    render_furniture,
    render_pictures,
    write_film,
    write_storyboard,
)
from roboassembly.viewer.html import write_html
from roboassembly.viewer.motion_timing import speed_profile
from roboassembly.viewer.playback import make_timeline
from roboassembly.viewer.timeline import Phase

EYE = np.eye(3)
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])
LYING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def at(x: float, y: float, z: float, rotation: np.ndarray = EYE) -> SE3:
    return SE3(rotation, np.array([x, y, z], dtype=float))


def box(*size: float) -> Mesh:
    return Mesh.from_trimesh(trimesh.creation.box(size))


def same(a: SE3, b: SE3) -> bool:
    return bool(np.allclose(a.homogeneous, b.homogeneous, rtol=0, atol=1e-12))


def table(name: str = "table") -> Furniture:
    """A plate, two legs, and a third that the plan below never touches."""
    leg = box(0.06, 0.06, 0.7)
    up, side = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    spots = np.array([[0.3, 0.2, -0.02], [-0.3, 0.2, -0.02], [0.3, -0.2, -0.02]])
    plate = Part("plate", box(0.8, 0.6, 0.04), tuple(ConnectionPoint(spot, -up, side, 0.0) for spot in spots))
    tip = ConnectionPoint(np.array([0.0, 0.0, 0.35]), up, side, 0.0)
    legs = [Part(f"leg_{k}", leg, (tip,)) for k in range(3)]
    assembled = (at(0, 0, 0.72), *(at(x, y, 0.35) for x, y, _ in spots))
    classes = (ShapeClass((0,), EYE[None]), ShapeClass((1, 2, 3), EYE[None]))
    connections = tuple(Connection(0, k, k + 1, 0) for k in range(3))
    return Furniture(name, (plate, *legs), assembled, connections, classes)


def table_plan(furniture: Furniture | None = None, *, success: bool = False) -> Plan:
    """The plate is turned over and two legs are set on it: legs point up, as the plate lies with its face down."""
    furniture = furniture or table()
    initial = (at(0, 0, 0.03), at(1, 0, 0.04, LYING), at(1, 1, 0.04, LYING), at(-1, 0, 0.04, LYING))
    waiting = at(0, 0, 0.03, UPSIDE_DOWN)
    mating = at(0.3, -0.2, 0.41, UPSIDE_DOWN)
    path = (initial[1], at(1, 0, 0.8, LYING), at(0.3, -0.2, 0.8, UPSIDE_DOWN), at(0.3, -0.2, 0.8, UPSIDE_DOWN), mating)
    settling = tuple(at(0, 0, -0.002 * k) for k in range(6))
    after = (settling[-1] * waiting, settling[-1] * mating, *initial[2:])
    first = PlanStep(
        (1, 0, 0, 0, 3), {1: at(0, 0, 0)}, (0,), {0: waiting, 2: initial[2], 3: initial[3]},
        path, settling, after, 10, "retreat", 0.1,
    )  # fmt: skip
    turned = at(0, 0, 0, np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    raised = at(0, 0, 0.005)
    still = {0: raised * turned * after[0], 1: raised * turned * after[1], 3: initial[3]}
    # The moving group's frame is not the part's.
    group_from_part = at(0.0, 0.0, 0.1)
    goal = still[0] * at(-0.3, 0.2, -0.38) * group_from_part.inverse()
    second_path = (initial[2] * group_from_part.inverse(), goal)
    second_after = (still[0], still[1], goal * group_from_part, initial[3])
    second = PlanStep(
        (2, 0, 0, 1, 0), {2: group_from_part}, (0, 1), still,
        second_path, (at(0, 0, 0),), second_after, 10, "rrt-connect", 0.1,
    )  # fmt: skip
    return Plan(furniture, initial, (first, second), success, 0)


def frames_of(timeline, step: int, phase: Phase):
    return [frame for frame in timeline.frames if frame.step == step and frame.phase is phase]


def test_every_way_point_and_the_mating_pose_are_frames():
    plan = table_plan()
    timeline = make_timeline(plan, frames_per_second=12.0)
    for index, step in enumerate(plan.steps):
        frames = frames_of(timeline, index, Phase.MOVING)
        for part, group_from_part in step.moving.items():
            shown = [frame.poses[part] for frame in frames]
            for way_point in step.path:
                assert any(same(pose, way_point * group_from_part) for pose in shown)
            assert same(shown[0], step.path[0] * group_from_part)
            assert same(shown[-1], step.path[-1] * group_from_part)
        rest = frames_of(timeline, index, Phase.PAUSE)
        assert all(same(a, b) for a, b in zip(rest[-1].poses, step.after, strict=True))


def test_a_path_is_straight_between_way_points_and_slow_at_its_end():
    timeline = make_timeline(table_plan(), frames_per_second=60.0)
    heights = np.array([frame.poses[1].translation for frame in frames_of(timeline, 0, Phase.MOVING)])
    rising = heights[heights[:, 0] > 1 - 1e-12]
    assert np.allclose(rising[:, 1], 0.0)
    assert (np.diff(rising[:, 2]) > 0).all()
    strides = np.linalg.norm(np.diff(heights, axis=0), axis=1)
    near = heights[:-1, 2] < 0.41 + 0.05
    near &= heights[:-1, 0] < 0.3 + 1e-9
    assert strides[near].max() < 0.35 * strides.max()
    assert near.sum() > 15


def test_half_way_of_a_turn_is_half_the_angle():
    still = table_plan()
    quarter = SE3(LYING, np.zeros(3))
    step = still.steps[1]
    path = (at(0, 0, 1), at(0, 0, 1) * quarter)
    plan = Plan(still.furniture, still.initial, (PlanStep(
        step.action, {2: at(0, 0, 0)}, (0,), {0: still.initial[0], 1: still.initial[1], 3: still.initial[3]},
        path, (at(0, 0, 0),), still.initial, 1, "retreat", 0.0,
    ),), False, 0)  # fmt: skip
    frames = frames_of(make_timeline(plan, frames_per_second=40.0), 0, Phase.MOVING)
    angles = [np.arctan2(frame.poses[2].rotation[2, 1], frame.poses[2].rotation[1, 1]) for frame in frames]
    assert angles[0] == pytest.approx(0.0)
    assert angles[-1] == pytest.approx(np.pi / 2)
    assert (np.diff(angles) > 0).all()
    assert all(np.allclose(frame.poses[2].translation, [0, 0, 1]) for frame in frames)


def test_speed_profile_by_hand():
    distance = speed_profile(1.0, flight=1.0, approach=0.5)
    # 0.9 m of flight and 0.1 m of approach; they meet at 1.5 · 0.1 m / 0.5 s = 0.3 m/s.
    assert distance(np.array([0.0, 1.0, 1.5, 9.0])) == pytest.approx([0.0, 0.9, 1.0, 1.0])
    step = 1e-6
    before, there, after = distance(np.array([1.0 - step, 1.0, 1.0 + step]))
    assert (there - before) / step == pytest.approx(0.3, abs=1e-4)
    assert (after - there) / step == pytest.approx(0.3, abs=1e-4)
    for length in (0.001, 0.05, 0.3, 40.0):
        assert (np.diff(speed_profile(length, 0.7, 0.4)(np.linspace(0, 1.1, 500))) >= 0).all()


def test_roles_and_still_parts():
    plan = table_plan()
    timeline = make_timeline(plan)
    for frame in timeline.frames:
        assert same(frame.poses[3], plan.initial[3])
        assert frame.roles[3] is Role.IDLE
        if frame.phase in (Phase.OVERTURE, Phase.PAUSE, Phase.FINALE):
            assert set(frame.roles) == {Role.IDLE}
        elif frame.step == 0:
            assert frame.roles == (Role.WAITING, Role.MOVING, Role.IDLE, Role.IDLE)
        else:
            assert frame.roles == (Role.WAITING, Role.WAITING, Role.MOVING, Role.IDLE)
        if frame.step == 0:
            assert same(frame.poses[2], plan.initial[2])
        if frame.phase is Phase.MOVING:
            assert all(same(frame.poses[p], pose) for p, pose in plan.steps[frame.step].still.items())


def test_the_waiting_group_is_placed_as_one_body_above_the_ground():
    plan = table_plan()
    timeline = make_timeline(plan, frames_per_second=60.0)
    held = plan.steps[0].after[0].inverse() * plan.steps[0].after[1]
    frames = frames_of(timeline, 1, Phase.PLACING)
    assert len(frames) > 5
    assert all(same(frame.poses[0].inverse() * frame.poses[1], held) for frame in frames)
    assert same(frames[-1].poses[0], plan.steps[1].still[0])
    for frame in frames_of(timeline, 0, Phase.PLACING):
        lowest = transform_points(frame.poses[0], plan.furniture.parts[0].mesh.vertices)[:, 2].min()
        assert lowest > 0.01 - 1e-9
        assert same(frame.poses[1], plan.initial[1])


def test_settling_goes_through_the_recorded_poses():
    # Twenty frames a second are one a recorded pose (every 0.05 s), when there is time enough.
    timeline = make_timeline(table_plan(), frames_per_second=20.0, seconds_per_step=10.0)
    frames = frames_of(timeline, 0, Phase.SETTLING)
    assert [round(frame.poses[1].translation[2], 9) for frame in frames] == [0.408, 0.406, 0.404, 0.402]
    assert [round(frame.poses[0].translation[2], 9) for frame in frames] == [0.028, 0.026, 0.024, 0.022]
    assert frames_of(timeline, 0, Phase.PAUSE)[0].poses[1].translation[2] == pytest.approx(0.4)
    assert not frames_of(timeline, 1, Phase.SETTLING)


def test_captions_times_and_determinism():
    plan = table_plan()
    one, two = make_timeline(plan), make_timeline(plan)
    assert [caption for _, caption in one.captions] == [
        "table: 4 parts",
        "step 1 of 3: leg_0 onto plate",
        "step 2 of 3: leg_1 onto plate (+1)",
        "table: not assembled, stopped after 2 of 3 steps",
    ]
    assert one.captions[0][0] == 0.0
    assert one.captions[1][0] == pytest.approx(1.0)
    assert one.duration == pytest.approx(len(one.frames) / 30.0)
    assert len(one.frames) == len(two.frames)
    for a, b in zip(one.frames, two.frames, strict=True):
        assert all((p.homogeneous == q.homogeneous).all() for p, q in zip(a.poses, b.poses, strict=True))


def test_a_plan_without_steps_is_shown():
    plan = Plan(table(), table_plan().initial, (), False, 0)
    timeline = make_timeline(plan)
    assert timeline.frames[-1].caption == "table: not assembled, stopped after 0 of 3 steps"
    assert {frame.phase for frame in timeline.frames} == {Phase.OVERTURE, Phase.FINALE}


@pytest.mark.parametrize("bad", [{"frames_per_second": 0}, {"seconds_per_step": -1.0}, {"seconds_per_step": np.nan}])
def test_rates_must_be_positive(bad):
    with pytest.raises(InputError, match="positive"):
        make_timeline(table_plan(), **bad)


def test_shading_is_crisp_on_boxes_and_smooth_on_turned_legs():
    shaded = shade(box(1, 2, 3))
    assert len(shaded.vertices) == 24
    assert np.allclose(np.abs(shaded.normals).max(axis=1), 1.0)
    ring = trimesh.creation.cylinder(0.1, 1.0, sections=32)
    shaded = shade(Mesh.from_trimesh(ring))
    side = np.abs(shaded.normals[:, 2]) < 0.5
    assert np.allclose(shaded.normals[side, :2], shaded.vertices[side, :2] / 0.1, atol=1e-3)
    # A mesh whose triangles share no vertex is shaded the same.
    loose = Mesh(ring.triangles.reshape(-1, 3), np.arange(3 * len(ring.faces)).reshape(-1, 3))
    assert len(shade(loose).vertices) == len(shaded.vertices)


def test_camera_fits_the_points_it_should_hold():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200, 3))
    for width, height in ((1280, 720), (390, 844)):
        pixels = project(points, fit_camera(points, width / height), width, height)
        assert (pixels >= 0).all()
        assert (pixels <= [width, height]).all()
        slack = np.minimum(pixels, [width, height] - pixels).min(axis=0) / [width, height]
        assert slack.min() < 0.05
    timeline = make_timeline(table_plan(), frames_per_second=10.0)
    for corners, frame, view in zip(timeline.box_corners, timeline.frames, follow(timeline, 16 / 9), strict=True):
        busy = [p for p, role in enumerate(frame.roles) if role is not Role.IDLE] or [0, 1, 2]
        pixels = project(corners[busy].reshape(-1, 3), view, 1600, 900)
        assert (pixels >= 0).all()
        assert (pixels <= [1600, 900]).all()


# The page


def open_sockets() -> int:
    if not sys.platform.startswith("linux"):
        pytest.skip("counts file descriptors in /proc")
    out = 0
    for entry in os.listdir("/proc/self/fd"):
        try:
            out += os.readlink(f"/proc/self/fd/{entry}").startswith("socket:")
        except FileNotFoundError:
            continue
    return out


def recording_in(page: str) -> dict:
    data = base64.b64decode(re.search(r'__VISER_EMBED_DATA__="([^"]+)"', page)[1])
    inner = zstandard.ZstdDecompressor().decompress(data[8:], max_output_size=int.from_bytes(data[:8], "little"))
    return msgspec.msgpack.decode(inner[8 : 8 + int.from_bytes(inner[:8], "little")])


def test_page_is_complete_and_leaves_no_server(tmp_path, capfd):
    plan, path = table_plan(), tmp_path / "assembly.html"
    write_html(plan, path)  # what Python opens once and keeps is open after this
    threads, sockets = set(threading.enumerate()), open_sockets()
    capfd.readouterr()
    write_html(plan, path)
    assert set(threading.enumerate()) <= threads
    assert open_sockets() == sockets
    assert capfd.readouterr() == ("", "")
    assert os.listdir(tmp_path) == ["assembly.html"]
    page = path.read_text(encoding="utf-8")
    assert len(page) < 3e6
    assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)=[\"']?(https?:)?//", page)
    assert '<meta name="viewport" content="width=device-width' in page
    assert "<title>table</title>" in page
    for _, caption in make_timeline(plan).captions:
        assert caption in page


def test_the_page_plays_the_plan(tmp_path):
    plan, path = table_plan(), tmp_path / "assembly.html"
    write_html(plan, path, seconds_per_step=2.0)
    timeline = make_timeline(plan, frames_per_second=30.0, seconds_per_step=2.0)
    recording = recording_in(path.read_text(encoding="utf-8"))
    assert recording["durationSeconds"] == pytest.approx(timeline.duration)
    by_type: dict[str, list] = {}
    for time, message in recording["messages"]:
        by_type.setdefault(message["type"], []).append((time, message))
    names = [message["name"] for _, message in by_type["MeshMessage"]]
    assert names == ["/parts/0_plate", "/parts/1_leg_0", "/parts/2_leg_1", "/parts/3_leg_2"]
    moves = {name: [] for name in names}
    for time, message in by_type["SetPositionMessage"]:
        if message["name"] in moves and time > 0:
            moves[message["name"]].append((time, message["position"]))
    assert moves[names[0]][-1][1] == pytest.approx(list(plan.steps[-1].after[0].translation), abs=1e-6)
    assert moves[names[2]][-1][1] == pytest.approx(list(plan.steps[-1].after[2].translation), abs=1e-6)
    assert not moves[names[3]]
    first = next(i for i, frame in enumerate(timeline.frames) if frame.phase is Phase.MOVING)
    mating = max(i for i, frame in enumerate(timeline.frames) if frame.step == 0 and frame.phase is Phase.MOVING)
    played = {round(time * 30): position for time, position in moves[names[1]] if time > first / 30}
    assert played[mating] == pytest.approx([0.3, -0.2, 0.41], abs=1e-6)


def test_names_cannot_break_the_page(tmp_path):
    path = tmp_path / "page.html"
    write_html(Plan(table("</script><b>& $name"), table_plan().initial, (), False, 0), path)
    page = path.read_text(encoding="utf-8")
    assert "</script><b>" not in page
    assert "<title>&lt;/script&gt;&lt;b&gt;&amp; $name</title>" in page


# Pictures


@pytest.fixture
def fresh_choice():
    gl.context_module.cache_clear()
    yield
    gl.context_module.cache_clear()


@pytest.mark.parametrize(("value", "message"), [("disable", "switches"), ("nonsense", "unknown")])
def test_disabled_drawing_prints_one_line(monkeypatch, fresh_choice, tmp_path, value, message):
    if not sys.platform.startswith("linux") and value == "nonsense":
        pytest.skip("only Linux has a choice")
    monkeypatch.setenv("MUJOCO_GL", value)
    with pytest.raises(RenderingUnavailableError, match=message) as caught:
        write_film(table_plan(), tmp_path / "film.mp4")
    assert "\n" not in str(caught.value)
    assert not os.listdir(tmp_path)


def test_missing_opengl_prints_one_line(monkeypatch, fresh_choice):
    tried = []
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gl, "can_render", lambda name: tried.append(name))
    with pytest.raises(RenderingUnavailableError, match="off-screen OpenGL is not available") as caught:
        render_furniture(table())
    assert "\n" not in str(caught.value)
    if sys.platform.startswith("linux"):
        assert tried[:2] == ["mujoco.egl", "mujoco.osmesa"]


def test_a_box_is_drawn_where_the_projection_says(drawing):
    mesh = box(0.4, 0.2, 0.6).transformed(at(0.3, -0.1, 0.05))  # off its frame's origin, so that re-centring shows
    pose = at(0.1, 0.2, 0.8, trimesh.transformations.euler_matrix(0.3, -0.5, 0.9)[:3, :3])
    corners = transform_points(pose, mesh.vertices)
    width, height = 320, 240
    view = Camera(np.array([0.2, 0.1, 0.7]), 2.5, azimuth=0.7, elevation=-0.3)
    with OffscreenRenderer([mesh], width, height, center=view.target, radius=1.0) as stage:
        picture = stage.picture([pose], [(1.0, 0.0, 0.0)], view).astype(int)
    red = picture[:, :, 0] > picture[:, :, 1] + 60
    rows, columns = np.flatnonzero(red.any(axis=1)), np.flatnonzero(red.any(axis=0))
    pixels = project(corners, view, width, height)
    assert [columns[0], rows[0]] == pytest.approx(pixels.min(axis=0), abs=1.5)
    assert [columns[-1] + 1, rows[-1] + 1] == pytest.approx(pixels.max(axis=0), abs=1.5)
    # Nothing red outside the outline.
    inside = Delaunay(1.02 * (pixels - pixels.mean(axis=0)) + pixels.mean(axis=0)).find_simplex
    assert (inside(np.argwhere(red)[:, ::-1] + 0.5) >= 0).all()


def test_any_mesh_can_be_drawn(drawing):
    flat = Mesh(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float), np.array([[0, 1, 2], [0, 2, 3]]))
    inside_out = Mesh(box(1, 1, 1).vertices, box(1, 1, 1).faces[:, ::-1])
    double = Mesh(flat.vertices, np.concatenate([flat.faces, flat.faces[:, ::-1]]))
    sliver = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-4, 0]], float), np.array([[0, 1, 2], [0, 1, 1]]))
    view = Camera(np.zeros(3), 5.0)
    poses = [at(0, 0, 0.5)] * 4
    with OffscreenRenderer([flat, inside_out, double, sliver], 64, 64, center=np.zeros(3), radius=2.0) as stage:
        picture = stage.picture(poses, [(1.0, 0.0, 0.0)] * 4, view).astype(int)
    assert (picture[:, :, 0] > picture[:, :, 1] + 60).any()


def test_a_film_is_watched_and_stopped(drawing, tmp_path):
    path, shares = tmp_path / "film.mp4", []

    def watch(share: float) -> bool:
        shares.append(share)
        return len(shares) < 5

    assert not write_film(table_plan(), path, width=64, height=48, fps=10, watch=watch)
    assert len(shares) == 5
    assert shares[0] == 0.0
    assert np.diff(shares) == pytest.approx(shares[1] * np.ones(4))
    assert not os.listdir(tmp_path)


def test_the_film_plays_back(drawing, tmp_path):
    plan, path = table_plan(), tmp_path / "film.mp4"
    write_film(plan, path, width=320, height=240, fps=10, seconds_per_step=1.5)
    timeline = make_timeline(plan, frames_per_second=10, seconds_per_step=1.5)
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat"), "playing starts before all is there"
    frames = np.array(list(iio.imiter(path, plugin="FFMPEG")))
    assert frames.shape == (len(timeline.frames), 240, 320, 3)
    assert iio.immeta(path, plugin="FFMPEG")["fps"] == 10
    red, green, blue = (frames[..., k].astype(int) for k in range(3))
    orange = ((red > green + 60) & (green > blue) & (blue < 90)).sum(axis=(1, 2))
    greens = ((green > red + 30) & (green > blue + 30)).sum(axis=(1, 2))
    for index, frame in enumerate(timeline.frames):
        if frame.phase is Phase.MOVING:
            assert orange[index] > 50
            assert greens[index] > 50
        if frame.phase in (Phase.OVERTURE, Phase.FINALE):
            assert orange[index] <= 10  # compression
            assert greens[index] <= 10


def test_stills(drawing, tmp_path):
    furniture = table()
    pictures = render_pictures(table_plan(furniture), width=200, height=150)
    assert [picture.shape for picture in pictures] == [(150, 200, 3)] * 4
    assert all((a != b).any() for a, b in itertools.pairwise(pictures))
    for ending in ("png", "webp"):
        path = tmp_path / f"story.{ending}"
        write_storyboard(table_plan(furniture), path, columns=3, width=100, height=80)
        assert iio.imread(path).shape == (160, 300, 3)
    with pytest.raises(InputError, match=r"written as \.png or \.webp"):
        write_storyboard(table_plan(furniture), tmp_path / "story.gif")
    with pytest.raises(InputError, match="at least 2"):
        render_pictures(table_plan(furniture), 1)
    picture = render_furniture(furniture, tmp_path / "table.png", width=120, height=90)
    assert (iio.imread(tmp_path / "table.png") == picture).all()
    render_contact_sheet([furniture, furniture, furniture], tmp_path / "sheet.png", columns=2, size=64)
    assert iio.imread(tmp_path / "sheet.png").shape == (128, 128, 3)


def test_sizes_are_checked(tmp_path):
    with pytest.raises(InputError, match="even"):
        write_film(table_plan(), tmp_path / "film.mp4", width=161)
    with pytest.raises(InputError, match="between 1 and"):
        write_film(table_plan(), tmp_path / "film.mp4", width=0)
    with pytest.raises(InputError, match="at least one"):
        render_contact_sheet([], tmp_path / "sheet.png")


def test_smoothing_touches_edges_only():
    # A stair of two steps, as a slanted edge has without samples.
    picture = np.zeros((8, 16, 3), dtype=np.uint8)
    picture[:4, :8] = picture[:3] = 200
    before = picture.copy()
    smooth_edges(picture)
    values = picture[3, :, 1].astype(int)
    assert (np.diff(values) <= 0).all(), "the step becomes a slope"
    assert ((values[5:11] > 0) & (values[5:11] < 200)).any()
    far = np.ones((8, 16), bool)
    far[2:5] = False
    assert (picture[far] == before[far]).all()
