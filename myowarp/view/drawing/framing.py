"""The camera's place: everything that matters in the picture, as large as it can be.

The limb with its muscles, its tips, the targets and the objects matter. The camera is fitted to their points
in closed form; it looks at the flattest side of the limb. A body with a root that moves is seen from its
right, as gaits are, and the camera goes along. The points are those of the joints' ranges; `Framing.fit`
takes those of a film instead.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import mujoco
import numpy as np

from myowarp.definitions.body import POINT_JOINTS
from myowarp.osim.bundle.couplings import follow
from myowarp.view.drawing import style as look
from myowarp.view.drawing.skeleton import Skeleton

BORDER = 0.05
"""Share of the picture, on each side, that stays free."""
GAP = 0.15
"""Space between a body and its twin, in units of their width or height."""
RUNS_OUT = 1.5
"""Size of all bones over that of the picture from which on they run out of it."""
TURN = 15.0
"""deg by which the camera goes round, so that the picture has some depth."""
ABOVE = -12.0
"""deg by which it looks down."""
ARM = 2.0
"""Part of a limb beside its end in the picture, in units of the end's radius: of an arm the hand and
half of the forearm."""
STRETCH = 0.35
"""Growth of the picture for moves beyond the usual place, in its own widths on each side."""


class Framing:
    """The camera of a model's pictures.

    Attributes:
        azimuth: Direction of the camera [deg], MuJoCo's.
        elevation: The same, above the horizon.
        radius: Half the larger side [m] of what is usually in the picture.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        tips: Iterable[str] = (),
        aspect: float = 4 / 3,
        skeleton: Skeleton | None = None,
    ) -> None:
        """Find the direction of the camera, and what the joints' ranges fill.

        Args:
            model: The full model; its vertical field of view is used.
            tips: Names of the sites at the ends of the limb.
            aspect: Image width over height.
            skeleton: What stands for bones that the model lacks.

        Raises:
            ValueError: There is nothing to look at.
        """
        self._model, self._tips = model, look.tip_sites(model, tips)
        self._skeleton = skeleton or Skeleton(model)
        self._tendons = look.muscle_tendons(model)
        drawn = look.drawn_geoms(model)
        drawn = drawn[model.geom_type[drawn] != mujoco.mjtGeom.mjGEOM_PLANE]
        moving, mobile = look.moving_bodies(model), look.mobile_bodies(model)
        objects = mobile & ~look.limb_trees(model)
        body = model.geom_bodyid[drawn]
        self._objects, self._limb = drawn[objects[body]], drawn[moving[body] & ~objects[body]]
        if not len(self._limb) and not len(self._tendons):
            self._limb = drawn
        acting = acting_bodies(model)
        self._end = self._limb[acting[model.geom_bodyid[self._limb]]]
        self._is_long = bool(len(self._end)) and bool((moving & ~acting)[model.geom_bodyid[self._limb]].any())
        self._root = look.carried_root(model)
        half = np.tan(np.radians(model.vis.global_.fovy) / 2) * np.array((aspect, 1.0))
        self._half = (1.0 - 2.0 * BORDER) * half
        data = mujoco.MjData(model)
        rest, motion, everything, away = self._range_of_motion(data, drawn[~moving[body]])
        self.azimuth, self.elevation = broadside(rest, motion, away)
        self._axes = view_axes(self.azimuth, self.elevation)
        if self._root:
            self.look_along(leftwards(model, data))
        look.pose(model, data, look.rest_pose(model))
        whole = look.geom_box(model, data, drawn[look.limb_bodies(model)[body]]) @ self._axes[:2].T
        self._limb_size = np.ptp(whole, axis=0) if len(whole) else np.zeros(2)
        self._depth = float((rest @ self._axes[2]).mean())
        self._usual = self._extent(everything)
        self.radius = self._measure()

    @property
    def follows(self) -> bool:
        """Whether the camera goes along with a root."""
        return self._root > 0

    def look_along(self, direction: np.ndarray) -> None:
        """Look along a direction (3,), turned as always so that the picture has some depth; `fit` follows."""
        level = float(np.degrees(np.arctan2(direction[2], np.linalg.norm(direction[:2]))))
        self.azimuth = float(np.degrees(np.arctan2(direction[1], direction[0]))) + TURN
        self.elevation = level + ABOVE
        self._axes = view_axes(self.azimuth, self.elevation)

    def fit(self, moments: Iterable[tuple[mujoco.MjData, Mapping[str, np.ndarray]]]) -> None:
        """Fit the picture to moments instead of the joints' ranges: data, posed, and goals of each."""
        extents = [self._extent(self.points(*moment) - self.shift(moment[0])) for moment in moments]
        low, high = np.array([e[0] for e in extents]), np.array([e[1] for e in extents])
        # Objects that fall down take the median's place, not their own.
        spread = np.median(high - low, axis=0)
        low = np.maximum(low.min(axis=0), np.median(low, axis=0) - STRETCH * spread)
        high = np.minimum(high.max(axis=0), np.median(high, axis=0) + STRETCH * spread)
        self._usual = low, high
        self.radius = self._measure()

    def camera(self, data: mujoco.MjData, goals: Mapping[str, np.ndarray]) -> mujoco.MjvCamera:
        """Return the camera for a moment; the same for the same moment.

        Args:
            data: The data, posed.
            goals: World positions [m] of targets, by name.
        """
        shift = self.shift(data)
        low, high = self._usual
        reach = STRETCH * (high - low)
        now_low, now_high = self._extent(self.points(data, goals) - shift)
        low = np.clip(now_low, low - reach, low)
        high = np.clip(now_high, high, high + reach)
        middle, distance = self._place(low, high)
        camera = mujoco.MjvCamera()
        camera.azimuth, camera.elevation, camera.distance = self.azimuth, self.elevation, distance
        camera.lookat[:] = np.array((*middle, self._depth)) @ self._axes + shift
        return camera

    @property
    def height(self) -> float:
        """Height of what is usually in the picture [m]."""
        return float(self._usual[1][1] - self._usual[0][1])

    def twin(self) -> tuple[np.ndarray, float]:
        """Return how far aside a twin stands [m], shape (3,), and the camera's distance over that for one.

        It stands to the right of what is tall, and below what is wide or runs out of the picture sideways.
        """
        size = self._usual[1] - self._usual[0]
        beyond = self._limb_size / size
        wide = int((beyond if beyond.max() > RUNS_OUT else size / self._half).argmax() == 0)
        aside = np.zeros(2)
        aside[wide] = (1.0 + GAP) * size[wide] * (-1.0 if wide else 1.0)
        farther = ((size + np.abs(aside)) / self._half).max() / (size / self._half).max()
        return aside @ self._axes[:2], float(farther)

    def shift(self, data: mujoco.MjData) -> np.ndarray:
        """Return how far a root that moves has come since the start [m], shape (3,)."""
        return data.xpos[self._root] - self._home if self._root else np.zeros(3)

    def points(self, data: mujoco.MjData, goals: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the points [m] that a picture must hold, shape (n, 3)."""
        paths = look.tendon_segments(self._model, data, self._tendons)[:2]
        targets = np.array(list(goals.values()), dtype=float).reshape(-1, 3)
        limb = np.concatenate((look.geom_box(self._model, data, self._limb), *paths))
        if self._is_long:
            end = look.geom_box(self._model, data, self._end)
            middle = end.mean(axis=0)
            near = ARM * np.linalg.norm(end - middle, axis=1).max()
            limb = limb[np.linalg.norm(limb - middle, axis=1) < near]
        objects = look.geom_box(self._model, data, self._objects)
        bones = self._skeleton.bones(data)[:2]
        return np.concatenate((limb, objects, *bones, data.site_xpos[self._tips], targets))

    def _extent(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and greatest place of points in the picture, as if at the middle's depth [m].

        A point at the offset x and the depth z behind the middle is at the edge of a picture with half
        opening h at the distance d where |x - c| = h (d + z).
        """
        seen = points @ self._axes.T
        behind = self._half * (seen[:, 2:] - self._depth)
        return (seen[:, :2] + behind).min(axis=0), (seen[:, :2] - behind).max(axis=0)

    def _place(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the middle (2,) and the distance [m] at which a picture holds an extent."""
        return (low + high) / 2, float(((high - low) / (2 * self._half)).max())

    def _measure(self) -> float:
        """Return half the larger side of the usual picture [m]."""
        return float((self._place(*self._usual)[1] * self._half).max())

    def _range_of_motion(self, data: mujoco.MjData, still: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return where the limb goes over the joints' ranges.

        Returns:
            Points [m] of the limb's end at rest and over the ranges, all points over the ranges, and the way
            to where the camera is: from the limb's end to objects that are at it, else level from the
            motionless geoms to the limb's end.
        """
        model = self._model
        clouds: list[np.ndarray] = []
        ends: list[np.ndarray] = []
        self._home, middle = np.zeros(3), None
        for qpos in motion_samples(model, ranges=not self._root):
            look.pose(model, data, qpos)
            if not clouds:
                self._home = data.xpos[self._root].copy()
                middle = data.geom_xpos[still].mean(axis=0) if len(still) else None
            clouds.append(self.points(data, {}))
            ends.append(look.geom_box(model, data, self._end) if len(self._end) else clouds[-1])
        if not len(clouds[0]):
            raise ValueError("the camera needs a geom or a muscle to look at, got a model with neither")
        end = ends[0].mean(axis=0)
        away = end - middle if middle is not None else np.zeros(3)
        away *= (1.0, 1.0, 0.0)  # an arm that hangs is beside the trunk, too
        if len(self._objects):
            look.pose(model, data, look.rest_pose(model))
            ways = data.geom_xpos[self._objects] - end
            beside = ways[np.linalg.norm(ways, axis=1).argmin()]  # a goal beside the hand does not count
            if np.linalg.norm(beside) < np.linalg.norm(ends[0] - end, axis=1).max():
                away = beside  # what a hand holds is before it, not behind it
        return ends[0], np.concatenate(ends), np.concatenate(clouds), away


def motion_samples(model: mujoco.MjModel, ranges: bool = True) -> Iterator[np.ndarray]:
    """Yield the rest pose, and each joint of the limb at both ends of its range."""
    rest = look.rest_pose(model)
    yield rest.copy()
    limb = look.limb_trees(model)[model.jnt_bodyid]
    for joint in np.flatnonzero(np.isin(model.jnt_type, POINT_JOINTS) & limb) if ranges else ():
        span = np.ptp(model.jnt_range[joint])
        if span > 0 and (model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE or span < look.TRAVEL):
            for end in model.jnt_range[joint]:
                qpos = rest.copy()
                qpos[model.jnt_qposadr[joint]] = end
                follow(model, qpos)
                yield qpos


def leftwards(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the level direction (3,) about which the limb's hinges turn most mass, from right to left.

    Args:
        model: The full model.
        data: The data, posed. Where no names end in `_r` and `_l`, either direction is returned.
    """
    hinges = (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) & look.limb_trees(model)[model.jnt_bodyid]
    weight = (model.body_subtreemass[model.jnt_bodyid] * np.ptp(model.jnt_range, axis=1) ** 2)[hinges]
    level = data.xaxis[hinges, :2]
    axis = np.linalg.eigh((level * weight[:, None]).T @ level)[1][:, -1]
    sides = [
        data.xpos[[model.body(body).name.endswith(end) for body in range(model.nbody)], :2]
        for end in ("_l", "_r")
    ]
    across = sides[0].mean(axis=0) - sides[1].mean(axis=0) if min(map(len, sides)) else axis
    return np.array((*(axis if axis @ across > 0.0 else -axis), 0.0))


def view_axes(azimuth: float, elevation: float) -> np.ndarray:
    """Return rows right, up, forward of MuJoCo's free camera at these angles [deg], shape (3, 3)."""
    a, e = np.radians((azimuth, elevation))
    forward = np.array((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)))
    right = np.array((np.sin(a), -np.cos(a), 0.0))
    return np.stack((right, np.cross(right, forward), forward))


def broadside(rest: np.ndarray, motion: np.ndarray, away: np.ndarray) -> tuple[float, float]:
    """Azimuth and elevation [deg] that look at the flattest side of a limb, slightly turned.

    The camera looks along the direction in which the points spread least, at rest and in motion alike,
    from one of its two sides.

    Args:
        rest: Points in the reference pose [m], shape (n, 3).
        motion: Points over the range of motion [m], shape (m, 3).
        away: Way to the side from which the camera looks [m], shape (3,).
    """
    spread = sum(cov / np.trace(cov) for cov in (np.cov(rest.T), np.cov(motion.T)))
    forward = np.linalg.eigh(spread)[1][:, 0]
    along = forward @ away
    if abs(along) < 0.25 * np.linalg.norm(away) or not along:
        along = forward[np.argmax(np.abs(forward))]
    forward = -forward if along > 0 else forward
    azimuth = np.degrees(np.arctan2(forward[1], forward[0]))
    elevation = float(np.clip(np.degrees(np.arcsin(np.clip(forward[2], -1, 1))) + ABOVE, -75.0, 30.0))
    return float(azimuth + TURN), elevation


def acting_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Return a mask over bodies: True below more than a quarter of the longest chain's joints.

    That is every moving body of an elbow or a finger, and of an arm with a hand the hand.
    """
    depth = np.zeros(model.nbody, dtype=int)
    for body in range(1, model.nbody):
        depth[body] = depth[model.body_parentid[body]] + model.body_dofnum[body]
    return 4 * depth > depth.max()
