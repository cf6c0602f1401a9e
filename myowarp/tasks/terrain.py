"""Walking on rough ground, over hills or up stairs: the walking task on a height field.

Reward, observation and start are those of `walk`, heights above the floor; an episode also fails when the
center of mass comes within 0.61 m of the mean height of the ankles. Source: MyoSuite 3.0.0,
myoLeg{Rough,Hilly,Stair}TerrainWalk.

As there, the field ends after 6 m, and the floor goes on. Rough ground is drawn anew in every episode, where
upstream stretches what it draws to the bounds, by 10 um.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Draw, Shown, task
from myowarp.kernels.random import RandomKeys, open_stream, stream_of
from myowarp.tasks.field import FIELD_POINTS, add_field
from myowarp.tasks.walk import (
    STEPPING_POSE,
    STEPPING_VELOCITY,
    WalkProgram,
    WalkTask,
    center_height,
    center_velocity,
    is_down,
    keeps_up,
)

LEAST_RISE = wp.constant(0.61)  # m
ROUGH = (-0.02, 0.06)  # m
HILLS_FROM, HILLS, HILL_HEIGHT = 3000, 3, 0.63  # points in order before the hills, half waves, m
STAIRS, STAIR_ROWS, STAIR_HEIGHT = 12, 4, 2.5 * 0.1 / 3.2  # rows of points on each, m
STREAM = stream_of("heights")


@wp.func
def is_down_or_kneels(
    height: float, qpos: wp.array[float], xpos: wp.array[wp.vec3], foot: wp.array[int]
) -> bool:
    """Down, or height - mean height of the ankles < 0.61."""
    ankles = 0.5 * (xpos[foot[0]][2] + xpos[foot[1]][2])
    return is_down(height, qpos) or height - ankles < LEAST_RISE


@wp.kernel(enable_backward=False)
def draw_heights(
    # Params:
    keys: RandomKeys,
    lowest: float,
    highest: float,
    # In:
    mask: wp.array[bool],
    # Out:
    heights: wp.array3d[float],
):
    """Heights ~ U(lowest, highest)."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    state = open_stream(keys, worldid, STREAM)
    for row in range(heights.shape[1]):
        for column in range(heights.shape[2]):
            heights[worldid, row, column] = wp.randf(state, lowest, highest)


def hills() -> np.ndarray:
    """Return heights that wave along -y, and stay high from y = 2.5 m on [m]."""
    number = FIELD_POINTS**2 - HILLS_FROM
    wave = 0.5 * (1.0 + np.sin(np.linspace(0.0, HILLS * np.pi, number) + 0.5 * np.pi))
    points = np.concatenate([np.ones(HILLS_FROM), wave])
    return HILL_HEIGHT * (points - points.min())[::-1].reshape(FIELD_POINTS, FIELD_POINTS)


def stairs() -> np.ndarray:
    """Return heights of stairs that rise along -y, from y = -0.7 m on [m]."""
    steps = np.repeat(np.arange(STAIRS), STAIR_ROWS)
    rows = np.concatenate([np.zeros(FIELD_POINTS - len(steps)), steps])
    return np.tile(STAIR_HEIGHT * rows[::-1, None], FIELD_POINTS)


def rough() -> np.ndarray:
    """Return heights as they are drawn, but those below the floor, which the floor hides [m]."""
    drawn = np.random.default_rng(0).uniform(*ROUGH, (FIELD_POINTS, FIELD_POINTS))
    drawn[0, :2] = 0.0, ROUGH[1]  # the bounds of a model's field
    return drawn.clip(min=0.0)


class TerrainProgram(WalkProgram):
    """Walking on a height field, bound to a scene.

    Attributes:
        heights: Of rough ground [m], shape (num_worlds, FIELD_POINTS, FIELD_POINTS).
    """

    spec: TerrainTask

    def __init__(self, spec: TerrainTask, scene: Scene) -> None:
        """Give each world a field of its own, where the ground is drawn.

        Raises:
            ValueError: The field is left to the engine, whose worlds share one.
        """
        super().__init__(spec, scene)
        if spec.varies:
            if scene.ground is None:
                raise ValueError(
                    f"task {spec.key!r} needs contacts with height fields, which are left to mujoco-warp"
                )
            self.heights = scene.zeros("task.heights", FIELD_POINTS, FIELD_POINTS)
            scene.ground.heights = self.heights

    def sample_start(self, mask: wp.array) -> None:
        super().sample_start(mask)
        if self.spec.varies:
            lowest, highest = ROUGH
            self.launch(draw_heights, mask=mask, lowest=lowest, highest=highest)


@dataclass(frozen=True, kw_only=True)
class TerrainTask(WalkTask):
    """Walk on a height field.

    Attributes:
        terrain: Name of the ground in `TERRAINS`.
    """

    program: ClassVar[type] = TerrainProgram
    title: ClassVar[str] = "Walking on terrain"
    shown: ClassVar[Shown | None] = Shown(
        "Random actions: no policy has been trained on this ground.",
        "myoLegStairTerrainWalk-v0",
        "random",
        60,
        2,
    )
    measures: ClassVar = {
        "height": center_height,
        "velocity": center_velocity,
        "failed": is_down_or_kneels,
        "solved": keeps_up,
    }
    least_contacts: ClassVar[int] = 40  # of legs that lie on an edge; the motion from the start shows 8
    failed_when = (
        f"{WalkTask.failed_when}, or the center of mass is within {LEAST_RISE:g} m of the ankles' height"
    )

    speed: tuple[float, float] = (1.2, 1.2)
    start_pose: tuple[float, ...] = STEPPING_POSE
    start_velocity: tuple[float, ...] = STEPPING_VELOCITY
    terrain: str

    @property
    def varies(self) -> bool:
        """Whether the ground is drawn."""
        return self.terrain == "rough"

    @property
    def world_bytes(self) -> int:  # type: ignore[override]
        """The heights of a world's own ground."""
        return 4 * FIELD_POINTS**2 if self.varies else 0

    @property
    def scene_key(self) -> tuple[object, ...]:
        return (*super().scene_key, self.terrain)

    @property
    def draws(self) -> tuple[Draw, ...]:
        if not self.varies:
            return super().draws
        low, high = ROUGH
        doc = f"height of each of {FIELD_POINTS} by {FIELD_POINTS} points of the ground"
        return *super().draws, Draw("heights", "m", (low,), (high,), doc, when="start")

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the ground."""
        add_field(spec, TERRAINS[self.terrain]())


TERRAINS = {"rough": rough, "hilly": hills, "stairs": stairs}
"""Name of a ground: its heights, those of a draw where it is drawn."""


@task("myoLegRoughTerrainWalk-v0")
def rough_terrain() -> TerrainTask:
    """Walk ahead at 1.2 m/s over ground with bumps, drawn anew each episode."""
    return TerrainTask(terrain="rough")


@task("myoLegHillyTerrainWalk-v0")
def hilly_terrain() -> TerrainTask:
    """Walk ahead at 1.2 m/s over hills 0.63 m high."""
    return TerrainTask(terrain="hilly")


@task("myoLegStairTerrainWalk-v0")
def stair_terrain() -> TerrainTask:
    """Walk ahead at 1.2 m/s up a flight of stairs."""
    return TerrainTask(terrain="stairs")
