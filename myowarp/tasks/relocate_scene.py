"""Table and bin of the relocate tasks, with MyoSuite 3.0.0's places and sizes.

In MyoSuite a reset is drawn again, up to 200 times, while anything touches. Only object and bin ever do; here
the bin's place is drawn again while the bounding boxes of the object's parts may overlap that of the bin.
"""

import mujoco
import warp as wp

from myowarp.kernels.random import RandomKeys, open_stream, stream_of
from myowarp.tasks.euler_angles import quat_of, turned, wxyz
from myowarp.tasks.relocate_object import ASKEW, PARTS, START, Parts, kind_of, three
from myowarp.tasks.solids import half_box

TABLE_POS = (0.0, -0.5, 0.85)  # m
TABLE = (
    ("table_top", (0.8, 0.5, 0.05), (0.0, 0.0, 0.0), 0.0),
    ("table_base", (0.35, 0.6, 0.45), (0.0, 0.0, -0.45), 1.57),
)  # boxes: name, half sides [m], position [m], turn about z [rad]
BIN = (
    ("base", (0.1, 0.1, 0.1), (0.0, 0.0, -0.09)),
    ("wall0", (0.1, 0.01, 0.1), (0.0, 0.091, 0.1)),
    ("wall1", (0.01, 0.1, 0.1), (0.091, 0.0, 0.1)),
    ("wall2", (0.1, 0.01, 0.1), (0.0, -0.091, 0.1)),
    ("wall3", (0.01, 0.1, 0.1), (-0.091, 0.0, 0.1)),
)  # boxes, from the middle of its ground
BIN_MIDDLE = wp.constant(wp.vec3(0.0, 0.0, 0.005))
BIN_HALF = wp.constant(wp.vec3(0.101, 0.101, 0.195))
"""Box around them [m]."""
WOOD, STONE = (0.72, 0.58, 0.42, 1.0), (0.78, 0.78, 0.76, 1.0)

MOST_DRAWS = wp.constant(200)
APART = wp.constant(stream_of("relocate, places of the bin apart from the object"))


def add_table(spec: mujoco.MjSpec) -> None:
    """Add the table."""
    table = spec.worldbody.add_body(name="table", pos=TABLE_POS)
    for name, half, pos, turn in TABLE:
        box = table.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=pos, rgba=STONE)
        box.quat = quat_of((0.0, 0.0, turn))
        box.contype = box.conaffinity = 1


def add_bin(spec: mujoco.MjSpec) -> None:
    """Add the bin, a mocap body: it never moves in an episode, and each world has its own place for it."""
    target = spec.worldbody.add_body(name="target", pos=(0.0, -0.25, 0.9), mocap=True)
    target.quat = quat_of(ASKEW)
    for name, half, pos in BIN:
        wall = target.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=pos, rgba=WOOD)
        wall.contype = wall.conaffinity = 1


@wp.func
def may_overlap(parts: Parts, worldid: int, origin: wp.vec3, goal: wp.vec3, turn: wp.mat33) -> bool:
    """Whether no axis of the bin parts its box from that of a part of an object that is not turned."""
    middle = goal + turn @ BIN_MIDDLE
    for part in range(PARTS):
        size = three(parts.part_size, worldid, part)
        box = half_box(kind_of(parts, worldid, part), size)
        axes = wp.quat_to_matrix(turned(three(parts.part_turn, worldid, part)))
        way = wp.transpose(turn) @ (origin + wp.cw_mul(size, three(parts.part_place, worldid, part)) - middle)
        seen = wp.transpose(turn) @ axes
        gap = float(-1.0)
        for i in range(3):
            reach = wp.abs(seen[i, 0]) * box[0] + wp.abs(seen[i, 1]) * box[1] + wp.abs(seen[i, 2]) * box[2]
            gap = wp.max(gap, wp.abs(way[i]) - reach - BIN_HALF[i])
        if gap <= 0.0:
            return True
    return False


@wp.kernel(enable_backward=False)
def keep_apart(
    # Params:
    place_low: wp.vec3,
    place_high: wp.vec3,
    # In:
    parts: Parts,
    object_place: wp.array2d[float],
    goal_angles: wp.array2d[float],
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    goal_place: wp.array2d[float],
):
    """The bin's place ~ U(low, high), again while the object, at its start, may overlap the bin."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    state = open_stream(keys, worldid, APART)
    origin = three(object_place, worldid, 0) + START
    turn = wp.quat_to_matrix(turned(three(goal_angles, worldid, 0)))
    for _ in range(MOST_DRAWS):
        if not may_overlap(parts, worldid, origin, three(goal_place, worldid, 0), turn):
            return
        for i in range(3):
            goal_place[worldid, i] = wp.randf(state, place_low[i], place_high[i])


@wp.kernel(enable_backward=False)
def put_bin(
    # In:
    goal_place: wp.array2d[float],
    goal_angles: wp.array2d[float],
    mask: wp.array[bool],
    # Data out:
    mocap_pos_out: wp.array2d[wp.vec3],
    mocap_quat_out: wp.array2d[wp.quat],
):
    """The bin is where and as the episode asks; components w, x, y, z."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    mocap_pos_out[worldid, 0] = three(goal_place, worldid, 0)
    mocap_quat_out[worldid, 0] = wxyz(turned(three(goal_angles, worldid, 0)))
