"""Bones of a body without meshes: capsules from joint to joint, as converted models are drawn.

A bone goes from a body's origin to that of each body that hangs on it, and in the last body of a chain to its
farthest site or the far side of its centre of mass. A leaf that only slides is a moving point of a muscle
path, no bone.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from myowarp.view.drawing import style as look

LEAST = 0.02
"""Length of a bone that is worth drawing, in units of the longest."""
THICKNESS = 0.07
"""Radius of a bone over its length."""
THICKEST = 0.03
"""Largest radius, over the longest bone's length."""


class Skeleton:
    """The bones that a model lacks; none where its moving bodies have geoms.

    Attributes:
        radii: Radius of each bone [m], shape (num_bones,).
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Find the bones."""
        bones = list(_bones(model)) if _is_bare(model) else []
        self._bodies = np.array([bone[0] for bone in bones], dtype=int)
        self._children = np.array([bone[1] for bone in bones], dtype=int)
        self._far_ends = np.array([bone[2] for bone in bones]).reshape(-1, 3)
        self.radii = np.zeros(len(bones))
        data = mujoco.MjData(model)
        look.pose(model, data, look.rest_pose(model))
        starts, ends, _ = self.bones(data)
        lengths = np.linalg.norm(ends - starts, axis=1)
        longest = lengths.max(initial=0.0)
        kept = lengths > LEAST * longest
        self._bodies, self._children = self._bodies[kept], self._children[kept]
        self._far_ends = self._far_ends[kept]
        self.radii = np.minimum(THICKNESS * lengths[kept], THICKEST * longest)

    def bones(self, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return begins and ends of the bones [m], shape (num_bones, 3), and their radii."""
        turn, starts = data.xmat[self._bodies].reshape(-1, 3, 3), data.xpos[self._bodies]
        far_ends = np.einsum("bij,bj->bi", turn, self._far_ends) + starts
        # From joint to joint: a knee may slide while it bends.
        ends = np.where(self._children[:, None] >= 0, data.xpos[self._children], far_ends)
        return starts, ends, self.radii


def _is_bare(model: mujoco.MjModel) -> bool:
    """Say whether most of the bodies that move have nothing to draw."""
    moving = look.moving_bodies(model)
    bare = moving.copy()
    bare[model.geom_bodyid[look.drawn_geoms(model)]] = False
    return bool(2 * np.count_nonzero(bare) > np.count_nonzero(moving))


def _bones(model: mujoco.MjModel) -> Iterator[tuple[int, int, np.ndarray]]:
    """Yield of each bone its body, the body at its end, -1 for none, and else the end in the body's frame."""
    limb = look.limb_bodies(model)
    hung: dict[int, list[int]] = {body: [] for body in range(model.nbody)}
    for body in range(1, model.nbody):
        hung[int(model.body_parentid[body])].append(body)
    points = {body for body in range(1, model.nbody) if not hung[body] and _only_slides(model, body)}
    for body in np.flatnonzero(limb).tolist():
        below = [child for child in hung[body] if child not in points]
        yield from ((body, child, np.zeros(3)) for child in below)
        if not below and body not in points:
            yield body, -1, _far_end(model, body)


def _only_slides(model: mujoco.MjModel, body: int) -> bool:
    """Say whether all joints of a body are slides, and it has one."""
    first, count = model.body_jntadr[body], model.body_jntnum[body]
    return count > 0 and bool((model.jnt_type[first : first + count] == mujoco.mjtJoint.mjJNT_SLIDE).all())


def _far_end(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Return the end of the last body of a chain, in its frame [m], shape (3,)."""
    ends = np.concatenate((model.site_pos[model.site_bodyid == body], 2.0 * model.body_ipos[body][None]))
    return ends[np.argmax(np.linalg.norm(ends, axis=1))]
