"""Schema of `plan.json`, as typed structures; see `plan_file`."""

from __future__ import annotations

import msgspec


class PlacedEntry(msgspec.Struct):
    """Pose of a part."""

    part: int
    pose: list[float]


class StepEntry(msgspec.Struct):
    """One merge of the object-centric setting."""

    action: list[int]
    """`[u, v, k, l, w]`."""
    path: list[list[float]]
    """Poses of the moving group's frame (origin at its centre of mass), from where it lies to where it mates."""
    moving: list[PlacedEntry]
    """Parts of the moving group: a part's world pose is the path's pose times this one."""
    waiting: list[int]
    """Parts of the group that waits for it."""
    still: list[PlacedEntry]
    """World poses, while the group moves, of all parts that do not."""
    settling: list[list[float]]
    """Motions of the world that carry the merged group from the mating pose to rest, first to last."""
    after: list[list[float]]
    """World pose of every part when the step is over."""
    planning_steps: int
    planner: str


class FurnitureEntry(msgspec.Struct):
    """Furniture of a plan."""

    name: str
    parts: list[str]
    source: str


class SegmentEntry(msgspec.Struct):
    """One motion of one robot."""

    stage: str
    """A value of `Stage`."""
    robot: int
    """Robot that moves; the other one stands still."""
    opening: float
    """Distance between its finger pads [m]."""
    path: list[list[float]]
    """Configurations of the robot."""
    payload: list[PlacedEntry]
    """Parts in its hand, with their poses in the frame of the finger tips."""
    posts: list[int]
    """Posts that are raised meanwhile."""


class FullStepEntry(msgspec.Struct):
    """One merge of the full setting."""

    action: list[int]
    """`[u, v, k, l, g_a, g_b]`."""
    segments: list[SegmentEntry]
    after: list[list[float]]
    """World pose of every part when the step is over."""
    planning_steps: int


class MotionEntry(msgspec.Struct):
    """Object-centric motion: the piece moves as one body, is released and settles."""

    path: list[list[float]]
    """Poses of the piece's frame (origin at its centre of mass), from where it lies to where it is released."""
    moving: list[PlacedEntry]
    """All parts, in the frame of the piece."""
    settling: list[list[float]]
    """Motions of the world, like those of `StepEntry`."""
    after: list[list[float]]
    """World pose of every part at the end."""
    planner: str


class FullMotionEntry(msgspec.Struct):
    """Full motion: a robot picks the piece from its post and sets it on the floor."""

    segments: list[SegmentEntry]
    after: list[list[float]]
    """World pose of every part at the end."""


class UprightEntry(msgspec.Struct):
    """Whether the piece ends on its feet."""

    success: bool
    reason: str
    """Why the piece does not end on its feet; empty if it does."""
    motion: MotionEntry | FullMotionEntry | None
    """Motion; None if none was found or the piece stood already."""
    planning_steps: int
    """Configurations tested for collision; not part of those of the steps."""


class StableEntry(msgspec.Struct):
    """Stability of one group in one state."""

    step: int
    """Index of the step; -1 before the first one."""
    role: str
    """A value of `GroupRole`."""
    parts: list[int]
    stable: bool
    """Whether it stands on its own."""
    tilt: float
    """Largest tilt once it is released [rad]."""
    shift: float
    """Largest level motion of its centre of mass [m]."""


class InsertionEntry(msgspec.Struct):
    """One fastener that goes in."""

    fastener: str
    """Its name."""
    after: int
    """Index of the step after which it goes in; -1 before the first one, the number of steps once the piece stands."""
    part: int
    """Part with which it moves from then on."""
    pose: list[float]
    """Its pose in that part."""
    path: list[list[float]]
    """Its poses from outside to its place."""
    lift: float
    """Height by which its group is raised meanwhile [m]."""
    planning_steps: int


class LeftOutEntry(msgspec.Struct):
    """One fastener without a way in."""

    fastener: str
    reason: str


class PlanDocument(msgspec.Struct, omit_defaults=True):
    """Content of `plan.json`."""

    format: str
    version: int
    furniture: FurnitureEntry
    setting: str
    seed: int
    success: bool
    initial: list[list[float]]
    steps: list[StepEntry] | list[FullStepEntry]
    upright: UprightEntry | None = None
    robots: list[list[float]] = []
    posts: list[list[float]] = []
    density: float = 0.0
    """Density of the parts [kg/m³], full only."""
    stability: list[StableEntry] = []
    insertions: list[InsertionEntry] = []
    not_inserted: list[LeftOutEntry] = []
