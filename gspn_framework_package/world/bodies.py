"""The bodies of the world in PyBullet: the floor, walls and obstacles, and robots on wheels."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import math
import multiprocessing
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Callable, Iterator, Tuple

from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.world.room import Cylinder, Obstacle, Person, Pose, RobotType, Room


@contextlib.contextmanager
def quiet(stream: int) -> Iterator[None]:
    """Keep PyBullet's messages off standard output (1) or standard error (2), which other programs
    may parse."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(stream)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), stream)
        yield
    finally:
        # the C library has its own buffer, which would otherwise be written later
        ctypes.CDLL(None).fflush(None)
        os.dup2(kept, stream)
        os.close(kept)


with quiet(2):
    import pybullet
    from pybullet_utils.bullet_client import BulletClient


def call_apart(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in a separate process, since PyBullet ends the process where a mesh is not
    what it expects.

    :param function: of a module; its temporary files are removed even if its process is ended.
    :returns: what the function returns; None if its process was ended.
    """
    fork = multiprocessing.get_context("fork")
    with tempfile.TemporaryDirectory(prefix="gspn_") as folder, ProcessPoolExecutor(
        1, fork, _begin_process, (folder,)
    ) as other:
        try:
            return other.submit(function, *arguments).result()
        except BrokenProcessPool:
            return None


def _begin_process(folder: str) -> None:
    faulthandler.disable()  # it would report the crash
    tempfile.tempdir = folder


def connect_bullet(gui: bool) -> BulletClient:
    """Create an empty PyBullet world.

    :param gui: open PyBullet's window.
    :raises UsageError: there is no display for the window.
    """
    if gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        # otherwise PyBullet would end the whole process
        raise UsageError(
            "there is no display for the window of the world (DISPLAY is not set)",
            hint="leave gui out; the page shows the room too, and gspn film makes films of it",
        )
    with quiet(1):
        return BulletClient(connection_mode=pybullet.GUI if gui else pybullet.DIRECT)


BODY_BOTTOM = 0.012
"""Height of the underside of a robot's body above the floor, in metres."""

BODY_HEIGHT = 0.15
"""Height of a robot's body, in metres."""

SCAN_HEIGHT = BODY_BOTTOM + BODY_HEIGHT - 0.02
"""Height of the laser scanner's rays above the floor, in metres; they hit the bodies of robots."""

_FLOOR_COLOR = (0.86, 0.88, 0.90, 1.0)
_TOP = 0.172


def rgba(color: str) -> Tuple[float, float, float, float]:
    """Convert ``#rrggbb`` to four numbers from 0 to 1."""
    red, green, blue = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return (red, green, blue, 1.0)


def make_floor(client: Any, room: Room) -> int:
    """Create the floor, slightly larger than the room; return its id."""
    bounds = room.bounds()
    half = [(high - low) / 2 + room.wall_thickness for low, high in zip(bounds.low, bounds.high)]
    middle = [(high + low) / 2 for low, high in zip(bounds.low, bounds.high)]
    extents = [half[0] + 0.3, half[1] + 0.3, 0.05]
    look = client.createVisualShape(
        pybullet.GEOM_BOX, halfExtents=extents, rgbaColor=_FLOOR_COLOR, specularColor=[0, 0, 0]
    )
    client.createMultiBody(0, -1, look, [middle[0], middle[1], -0.05])
    # contacts with a plane take a third of the time of contacts with a box
    shape = client.createCollisionShape(pybullet.GEOM_PLANE)
    # a plane without a visual shape would get a chequered one
    nothing = client.createVisualShape(pybullet.GEOM_SPHERE, radius=1e-4)
    floor = client.createMultiBody(0, shape, nothing)
    client.changeDynamics(floor, -1, lateralFriction=1.0)
    return int(floor)


def make_solid(client: Any, solid: Obstacle) -> int:
    """Create a wall or an obstacle; return its id."""
    if isinstance(solid, Cylinder):
        yaw = 0.0
        shape = client.createCollisionShape(
            pybullet.GEOM_CYLINDER, radius=solid.radius, height=solid.height
        )
        look = client.createVisualShape(
            pybullet.GEOM_CYLINDER,
            radius=solid.radius,
            length=solid.height,
            rgbaColor=rgba(solid.color),
            specularColor=[0.1, 0.1, 0.1],
        )
    else:
        yaw = solid.yaw
        half = [solid.size[0] / 2, solid.size[1] / 2, solid.height / 2]
        shape = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half)
        look = client.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=half, rgbaColor=rgba(solid.color)
        )
    middle = [*solid.at, solid.height / 2]
    turned = pybullet.getQuaternionFromEuler([0, 0, yaw])
    return int(client.createMultiBody(0, shape, look, middle, turned))


AWAY = (0.0, 0.0, -10.0)
"""The position of the body of an absent person: below the floor."""


def make_person(client: Any, person: Person) -> int:
    """Create an absent person, an upright cylinder with a head; return its id."""
    shape = client.createCollisionShape(
        pybullet.GEOM_CYLINDER, radius=person.radius, height=person.height
    )
    head = person.radius * 0.6
    length = person.height - 2 * head
    look = client.createVisualShapeArray(
        shapeTypes=[pybullet.GEOM_CYLINDER, pybullet.GEOM_SPHERE],
        radii=[person.radius, head],
        lengths=[length, 0.0],
        halfExtents=[[0, 0, 0]] * 2,
        rgbaColors=[list(rgba(person.color)), [0.85, 0.68, 0.55, 1.0]],
        visualFramePositions=[[0, 0, -head], [0, 0, person.height / 2 - head]],
    )
    return int(client.createMultiBody(0, shape, look, AWAY))


def make_robot(client: Any, kind: RobotType, pose: Pose, color: str) -> int:
    """Create a robot, a disc on two wheels (joint 0 left, joint 1 right) and two casters; return
    its id."""
    dark, light = [0.13, 0.14, 0.16, 1.0], rgba(color)
    # the casters are part of the base, have no friction and hang a millimetre above the floor, so
    # that the wheels carry the robot
    ball, lift = 0.01, 0.001
    front = kind.radius * 0.7
    body = client.createCollisionShapeArray(
        shapeTypes=[pybullet.GEOM_CYLINDER, pybullet.GEOM_SPHERE, pybullet.GEOM_SPHERE],
        radii=[kind.radius, ball, ball],
        lengths=[BODY_HEIGHT, 0.0, 0.0],
        halfExtents=[[0, 0, 0]] * 3,
        collisionFramePositions=[
            [0, 0, BODY_BOTTOM + BODY_HEIGHT / 2],
            [front, 0, ball + lift],
            [-front, 0, ball + lift],
        ],
    )
    # the visual shape: plates, a coloured ring, the scanner
    plates = [
        (kind.radius, 0.02, 0.022, dark),
        (kind.radius * 0.98, 0.045, 0.06, list(light)),
        (kind.radius, 0.012, 0.09, dark),
        (kind.radius * 0.9, 0.03, 0.11, list(light)),
        (kind.radius, 0.012, 0.135, list(light)),
        (0.035, 0.035, _TOP - 0.01, [0.05, 0.05, 0.06, 1.0]),
    ]
    looks = client.createVisualShapeArray(
        shapeTypes=[pybullet.GEOM_CYLINDER] * len(plates) + [pybullet.GEOM_BOX],
        radii=[p[0] for p in plates] + [0.0],
        lengths=[p[1] for p in plates] + [0.0],
        halfExtents=[[0, 0, 0]] * len(plates) + [[0.03, 0.012, 0.004]],
        rgbaColors=[p[3] for p in plates] + [[1.0, 1.0, 1.0, 1.0]],
        visualFramePositions=[[0, 0, p[2]] for p in plates] + [[kind.radius * 0.65, 0, 0.145]],
    )
    wheel = client.createCollisionShape(
        pybullet.GEOM_CYLINDER, radius=kind.wheel_radius, height=0.018
    )
    wheel_look = client.createVisualShape(
        pybullet.GEOM_CYLINDER, radius=kind.wheel_radius, length=0.018, rgbaColor=dark
    )
    side = kind.wheel_separation / 2
    level = pybullet.getQuaternionFromEuler([0, 0, 0])
    # the axis of a cylinder is z; that of a wheel is y
    lying = pybullet.getQuaternionFromEuler([-math.pi / 2, 0, 0])
    unique_id = client.createMultiBody(
        baseMass=kind.mass,
        baseCollisionShapeIndex=body,
        baseVisualShapeIndex=looks,
        basePosition=[pose.x, pose.y, 0.0],
        baseOrientation=pybullet.getQuaternionFromEuler([0, 0, pose.yaw]),
        baseInertialFramePosition=[0, 0, 0.04],
        linkMasses=[0.03, 0.03],
        linkCollisionShapeIndices=[wheel, wheel],
        linkVisualShapeIndices=[wheel_look, wheel_look],
        linkPositions=[[0, side, kind.wheel_radius], [0, -side, kind.wheel_radius]],
        linkOrientations=[lying, lying],
        linkInertialFramePositions=[[0, 0, 0]] * 2,
        linkInertialFrameOrientations=[level] * 2,
        linkParentIndices=[0, 0],
        linkJointTypes=[pybullet.JOINT_REVOLUTE] * 2,
        linkJointAxis=[[0, 0, 1]] * 2,
    )
    for link in (0, 1):
        client.changeDynamics(unique_id, link, lateralFriction=1.0, jointDamping=0.0)
    client.changeDynamics(unique_id, -1, lateralFriction=0.0, linearDamping=0.0, angularDamping=0.0)
    return int(unique_id)
