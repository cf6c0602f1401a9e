"""Walking on ground that each world draws in every episode: slope, hills, stairs and bumps.

    h(s) = grade s + hill (1 - cos(2 pi s / length)) / 2 + rise floor(s / tread) + bump U(0, 1)

with s = max(0, -y - 0.5 m), how far ahead of the start a point of the field is; bumps are behind it, too.
Reward, observation and start are those of `walk`, but heights are those above the ground below: a walker that
has climbed does not fall later for that. The field is that of `terrain`, with a point every 0.12 m, over
which a step of stairs rises.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.task import Column, Draw, Shown, task
from myowarp.kernels.random import RandomKeys, open_stream, stream_of
from myowarp.tasks.field import FIELD_POINTS, HALF_LENGTH, add_field
from myowarp.tasks.terrain import LEAST_RISE, TerrainProgram, TerrainTask
from myowarp.tasks.walk import WalkProgram, center_height, center_velocity, is_down, keeps_up

FLAT = wp.constant(0.5)  # m ahead of the start
HALF = wp.constant(HALF_LENGTH)
TWO_PI = wp.constant(2.0 * np.pi)
STREAM = stream_of("bumps")
MOST = {"grade": 0.3, "hill": 1.0, "length": 12.0, "rise": 0.25, "tread": 12.0, "bump": 0.2}
"""Largest values: what legs can climb; lengths those of the field [m]."""
LEAST = {"length": 1.0, "tread": 0.2}
"""Least values [m], where 0 would be no ground; a tread has two points of the field."""


@wp.func
def ground_at(heights: wp.array2d[float], x: float, y: float) -> float:
    """Height of the triangle of the field at a place, 0 beside the field [m]."""
    last = heights.shape[0] - 1
    column = (x + HALF) / (2.0 * HALF) * float(last)
    row = (y + HALF) / (2.0 * HALF) * float(last)
    inside = column >= 0.0 and row >= 0.0 and column < float(last) and row < float(last)
    if not inside:  # or not a number
        return 0.0
    c, r = int(column), int(row)
    u, v = column - float(c), row - float(r)
    side = float(heights[r, c + 1])
    if v > u:
        side = float(heights[r + 1, c])
    low, high = heights[r, c], heights[r + 1, c + 1]
    return low + wp.max(u, v) * (side - low) + wp.min(u, v) * (high - side)


@wp.func
def ground_below(heights: wp.array2d[float], qpos: wp.array[float]) -> float:
    """Height of the ground below the root [m]."""
    return ground_at(heights, qpos[0], qpos[1])


@wp.func
def height_above(xipos: wp.array[wp.vec3], share: wp.array[float], ground: float) -> float:
    """Height of the center of mass above the ground [m]."""
    return center_height(xipos, share) - ground


@wp.func
def falls(
    height: float, ground: float, qpos: wp.array[float], xpos: wp.array[wp.vec3], foot: wp.array[int]
) -> bool:
    """Down, or height of the center of mass - mean height of the ankles < 0.61."""
    ankles = 0.5 * (xpos[foot[0]][2] + xpos[foot[1]][2])
    return is_down(height, qpos) or height + ground - ankles < LEAST_RISE


@wp.func
def foot_above(xpos: wp.array[wp.vec3], foot: wp.array[int], heights: wp.array2d[float], i: int) -> float:
    """Height of the ankle above the ground below it [m]."""
    place = xpos[foot[i]]
    return place[2] - ground_at(heights, place[0], place[1])


@wp.func
def shaped(s: float, grade: float, hill: float, length: float, rise: float, tread: float) -> float:
    """grade s + hill (1 - cos(2 pi s / length)) / 2 + rise floor(s / tread) [m]."""
    wave = 0.5 * hill * (1.0 - wp.cos(TWO_PI * s / length))
    return grade * s + wave + rise * wp.floor(s / tread)


@wp.kernel(enable_backward=False)
def lay_ground(
    # Params:
    keys: RandomKeys,
    grade: wp.array2d[float],
    hill: wp.array2d[float],
    length: wp.array2d[float],
    rise: wp.array2d[float],
    tread: wp.array2d[float],
    bump: wp.array2d[float],
    # In:
    mask: wp.array[bool],
    # Out:
    heights: wp.array3d[float],
):
    """h(s) + bump U(0, 1), s = max(0, -y - 0.5)."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    state = open_stream(keys, worldid, STREAM)
    for row in range(heights.shape[1]):
        y = HALF * (2.0 * float(row) / float(heights.shape[1] - 1) - 1.0)
        height = shaped(
            wp.max(0.0, -y - FLAT),
            grade[worldid, 0],
            hill[worldid, 0],
            length[worldid, 0],
            rise[worldid, 0],
            tread[worldid, 0],
        )
        for column in range(heights.shape[2]):
            heights[worldid, row, column] = height + bump[worldid, 0] * wp.randf(state)


class GroundProgram(TerrainProgram):
    """Walking on drawn ground, bound to a scene; what is drawn has arrays of the names in `MOST`."""

    spec: GroundTask

    def sample_start(self, mask: wp.array) -> None:
        WalkProgram.sample_start(self, mask)
        self.launch(lay_ground, mask=mask)


@dataclass(frozen=True, kw_only=True)
class GroundTask(TerrainTask):
    """Walk on drawn ground; bounds of what is drawn uniformly.

    Attributes:
        grade: Rise of the slope over its length [1], at most 0.3.
        hill: Height of the hills [m], at most 1.
        length: From hill to hill [m], 1 to 12.
        rise: Height of a step of the stairs [m], at most 0.25.
        tread: Its length [m], 0.2 to 12.
        bump: Height of the bumps [m], at most 0.2.

    Raises:
        ValueError: Bounds are out of their range, or not a lower and an upper one.
    """

    program: ClassVar[type] = GroundProgram
    title: ClassVar[str] = "Walking on drawn ground"
    shown: ClassVar[Shown | None] = Shown(
        "Random actions: no policy has been trained on this ground.",
        "myoLegStairTerrainWalk-v1",
        "random",
        60,
        2,
    )
    measures: ClassVar = {
        "ground": ground_below,
        "height": height_above,
        "velocity": center_velocity,
        "failed": falls,
        "solved": keeps_up,
    }
    failed_when = (
        f"{TerrainTask.failed_when}; heights of the center of mass are those above the ground below the root"
    )
    varies = True

    terrain: str = "drawn"
    grade: tuple[float, float] = (0.0, 0.0)
    hill: tuple[float, float] = (0.0, 0.0)
    length: tuple[float, float] = (4.0, 4.0)
    rise: tuple[float, float] = (0.0, 0.0)
    tread: tuple[float, float] = (0.3, 0.3)
    bump: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check the bounds."""
        super().__post_init__()
        for name, most in MOST.items():
            bounds, least = getattr(self, name), LEAST.get(name, 0.0)
            if len(bounds) != 2 or not least <= bounds[0] <= bounds[1] <= most:
                raise ValueError(
                    f"{name} of the ground must be a lower and an upper bound from {least:g} to {most:g}, "
                    f"got {bounds!r}"
                )

    @property
    def scene_key(self) -> tuple[object, ...]:
        return (*super().scene_key, *(getattr(self, name) for name in MOST))

    @property
    def draws(self) -> tuple[Draw, ...]:
        docs = {
            "grade": ("1", "rise of the slope over its length"),
            "hill": ("m", "height of the hills"),
            "length": ("m", "from hill to hill"),
            "rise": ("m", "height of a step of the stairs"),
            "tread": ("m", "its length"),
            "bump": ("m", "height of the bumps, each point of the field from 0 to this"),
        }
        speed, *_ = super().draws
        drawn = [
            Draw(name, unit, *self._bounds(name), doc, (name,), when="start", array=name)
            for name, (unit, doc) in docs.items()
        ]
        return (speed, *drawn)

    def _bounds(self, name: str) -> tuple[tuple[float], tuple[float]]:
        low, high = getattr(self, name)
        return (low,), (high,)

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        above = {"height": height_above, "feet_heights": foot_above}
        return tuple(
            replace(column, doc=f"{column.doc} above the ground below", source=above[column.name])
            if column.name in above
            else column
            for column in super().columns(nq, nv, num_muscles)
        )

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the field as it is where everything drawn is largest, and the treads least."""
        y = np.linspace(-HALF_LENGTH, HALF_LENGTH, FIELD_POINTS)
        s = np.maximum(0.0, -y - FLAT)
        wave = 0.5 * self.hill[1] * (1.0 - np.cos(2.0 * np.pi * s / self.length[1]))
        rows = self.grade[1] * s + wave + self.rise[1] * np.floor(s / self.tread[0])
        bumps = np.random.default_rng(0).uniform(0.0, self.bump[1], (FIELD_POINTS, FIELD_POINTS))
        heights = rows[:, None] + bumps
        heights[-1, 0] = 0.0  # MuJoCo takes the lowest point for 0
        longest = HALF_LENGTH - FLAT
        steps = self.rise[1] * np.floor(longest / self.tread[0])
        heights[0, 0] = self.grade[1] * longest + self.hill[1] + steps + self.bump[1]  # the field's size
        add_field(spec, heights)


WHY = (
    "Each world draws its ground anew in every episode, and heights are those above it. Upstream's hills and "
    "stairs never change, and heights above the floor let no climber fall."
)


@task("myoLegRoughTerrainWalk-v1", WHY)
def rough_ground() -> GroundTask:
    """Walk ahead at 1.2 m/s over bumps of up to 0.08 m, as rough as is drawn."""
    return GroundTask(bump=(0.0, 0.08))


@task("myoLegHillyTerrainWalk-v1", WHY)
def hilly_ground() -> GroundTask:
    """Walk ahead at 1.2 m/s over hills on a slope, both drawn anew each episode."""
    return GroundTask(grade=(0.0, 0.15), hill=(0.0, 0.4), length=(2.0, 6.0))


@task("myoLegStairTerrainWalk-v1", WHY)
def stair_ground() -> GroundTask:
    """Walk ahead at 1.2 m/s up stairs whose steps are drawn anew each episode."""
    return GroundTask(rise=(0.05, 0.17), tread=(0.25, 0.45))
