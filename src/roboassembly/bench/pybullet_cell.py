"""Peer: the workcell in Bullet, one callback for each configuration of the moving robot.

Both Pandas come from the URDF, each on a box. The payload of the other robot, the posts and the parts are concave
meshes. The payload of the moving robot consists of convex hulls, because Bullet finds no contacts between two concave
meshes; this is less exact, and faster.
"""

from __future__ import annotations

from collections.abc import Callable

from roboassembly.bench.bullet import Bullet, numbers, quiet
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.planning.robot_path import Configuration
from roboassembly.robots.body import world_from_platform, world_from_tips
from roboassembly.robots.gripper import panda_folder
from roboassembly.robots.kinematics import JOINTS
from roboassembly.robots.platform import CLEARANCE, HEIGHT, LENGTH, PLATFORM_FROM_MOUNT, WIDTH
from roboassembly.task.full.cell_state import Segment


class BulletCell:
    """Workcell in Bullet: two Pandas from the URDF, platforms, posts, parts.

    Raises:
        MissingExtraError: PyBullet is not installed.
    """

    def __init__(self) -> None:
        self._world = Bullet()
        folder = panda_folder()
        self._world.api.setAdditionalSearchPath(str(folder.parent.parent.parent), physicsClientId=self._world.client)
        self._urdf = str(folder / "urdf/panda.urdf")

    def close(self) -> None:
        """Disconnect from Bullet."""
        self._world.close()

    def set_up(self, furniture: Furniture, segment: Segment) -> Callable[[Configuration], bool]:
        """Replace the scene by that of a segment; returns the test whether a configuration of its robot is free."""
        world = self._world
        bullet, client = world.api, world.client
        world.empty()
        state = segment.before
        own, other = state.robots[segment.robot], state.robots[1 - segment.robot]
        still: list[int] = []
        for body in state.around(furniture, segment.robot):
            if body.name != "robot":
                still += [world.add(world.concave(s.mesh), body.pose * s.body_from_mesh) for s in body.shapes]
        with quiet():
            movers = [self._robot(own.opening), self._robot(other.opening)]
        tips = world_from_tips(other.at)
        still += [world.add(world.concave(s.mesh), tips * s.body_from_mesh) for s in other.payload_shapes(furniture)]
        payload = own.payload_shapes(furniture)
        load = [world.add(world.hull(s.mesh), SE3.Identity()) for s in payload]
        place, joint = bullet.resetBasePositionAndOrientation, bullet.resetJointState

        def put(index: int, q: Configuration) -> None:
            arm, platform = movers[index]
            base_pose = world_from_platform(q)
            world.put(platform, base_pose)
            world.put(arm, base_pose * PLATFORM_FROM_MOUNT)
            for j in range(JOINTS):
                joint(arm, j, float(q[3 + j]), physicsClientId=client)

        put(1, other.at)
        obstacles = {*still, *movers[1]}
        overlapping, closest, box = bullet.getOverlappingObjects, bullet.getClosestPoints, bullet.getAABB
        arm, platform = movers[0]
        tips_link = next(
            i for i in range(bullet.getNumJoints(arm, physicsClientId=client))
            if bullet.getJointInfo(arm, i, physicsClientId=client)[12] == b"panda_hand_tcp"
        )  # fmt: skip
        links = range(-1, bullet.getNumJoints(arm, physicsClientId=client))

        def touches(body: int, link: int) -> bool:
            low, high = box(body, link, physicsClientId=client)
            near = {other for other, _ in overlapping(low, high, physicsClientId=client) or ()} & obstacles
            return any(
                contact[8] < 0.0
                for other in near
                for contact in closest(body, other, 0.0, linkIndexA=link, physicsClientId=client)
            )

        def is_free(q: Configuration) -> bool:
            put(0, q)
            if load:
                position, orientation = bullet.getLinkState(
                    arm, tips_link, computeForwardKinematics=True, physicsClientId=client
                )[4:6]
                for body, s in zip(load, payload, strict=True):
                    where = bullet.multiplyTransforms(position, orientation, *numbers(s.body_from_mesh))
                    place(body, *where, physicsClientId=client)
            if touches(platform, -1) or any(touches(arm, link) for link in links):
                return False
            if any(touches(body, -1) for body in load):
                return False
            return not any(closest(platform, body, 0.0, physicsClientId=client) for body in load)

        return is_free

    def _robot(self, opening: float) -> tuple[int, int]:
        bullet, client = self._world.api, self._world.client
        arm = bullet.loadURDF(self._urdf, useFixedBase=True, physicsClientId=client)
        for i in range(bullet.getNumJoints(arm, physicsClientId=client)):
            if b"finger_joint" in bullet.getJointInfo(arm, i, physicsClientId=client)[1]:
                bullet.resetJointState(arm, i, 0.5 * opening, physicsClientId=client)
        half = [0.5 * LENGTH, 0.5 * WIDTH, 0.5 * (HEIGHT - CLEARANCE)]
        shape = bullet.createCollisionShape(
            bullet.GEOM_BOX, halfExtents=half, collisionFramePosition=[0.0, 0.0, 0.5 * (HEIGHT + CLEARANCE)],
            physicsClientId=client,
        )  # fmt: skip
        return arm, bullet.createMultiBody(0.0, shape, physicsClientId=client)
