"""Objects in the hand follow the palm: T_object = T_palm(q) T_palm(start)^-1 T_object(start)."""

from collections.abc import Iterable

import mujoco
import numpy as np

_FREE, _SLIDE, _HINGE = (
    getattr(mujoco.mjtJoint, f"mjJNT_{kind}").value for kind in ("FREE", "SLIDE", "HINGE")
)


def joint_address(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Return the addresses in qpos of the joints of one body."""
    first, count = model.body_jntadr[body], model.body_jntnum[body]
    return model.jnt_qposadr[first] + np.arange(7 if model.jnt_type[first] == _FREE else count)


def coordinates(model: mujoco.MjModel, body: int, rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return the joint coordinates that put a body of the world into a pose.

    A free joint holds the pose itself. MuJoCo applies several joints in order: slides along x, y, z move the
    body in its frame R0, p0 at rest, and hinges about x, y, z then turn it,

        position = p0 + R0 (s1, s2, s3),    rotation = R0 Rx(h1) Ry(h2) Rz(h3).

    Args:
        model: The model.
        body: Id of the body.
        rotation: Wanted rotation matrix, shape (3, 3).
        position: Wanted position [m], shape (3,).

    Raises:
        ValueError: It has other joints, or hangs on another body.
    """
    first, count = model.body_jntadr[body], model.body_jntnum[body]
    joints = slice(first, first + count)
    kinds = [] if model.body_parentid[body] else model.jnt_type[joints].tolist()
    if kinds == [_FREE]:
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, rotation.ravel())
        return np.concatenate([position, quat])
    if (
        kinds != 3 * [_SLIDE] + 3 * [_HINGE]
        or not np.array_equal(model.jnt_axis[joints], np.tile(np.eye(3), (2, 1)))
        or model.jnt_pos[joints].any()
        or model.qpos0[joint_address(model, body)].any()
    ):
        raise ValueError(
            f"body {model.body(body).name!r} cannot lie in the hand: in the world it needs a free joint, or "
            "three slides and then three hinges along x, y, z that are 0 at rest"
        )
    rest = np.empty(9)
    mujoco.mju_quat2Mat(rest, model.body_quat[body])
    to_rest = rest.reshape(3, 3).T
    turn = to_rest @ rotation
    hinges = (
        np.arctan2(-turn[1, 2], turn[2, 2]),
        np.arcsin(np.clip(turn[0, 2], -1.0, 1.0)),
        np.arctan2(-turn[0, 1], turn[0, 0]),
    )
    return np.concatenate([to_rest @ (position - model.body_pos[body]), hinges])


class Palm:
    """Places of objects in the palm."""

    def __init__(
        self, model: mujoco.MjModel, start: np.ndarray, palm: str | None, carried: Iterable[str]
    ) -> None:
        """Note it in a start configuration.

        Args:
            model: The model; later changes of its geoms do not matter.
            start: Configuration, shape (nq,).
            palm: Name of the body that carries; None: the model has none.
            carried: Names of the bodies that lie on it.

        Raises:
            ValueError: Something has to be carried, and there is no palm.
        """
        self.model, self.data = model, mujoco.MjData(model)
        self.bodies = [model.body(name).id for name in carried]
        if self.bodies and palm is None:
            raise ValueError(
                f"{', '.join(carried)} cannot lie in the hand: the body names no palm; name one where it is "
                "registered"
            )
        self.palm = model.body(palm).id if self.bodies else 0
        self.data.qpos[:] = start
        mujoco.mj_kinematics(model, self.data)
        rotation, position = self._pose(self.palm)
        poses = [self._pose(body) for body in self.bodies]
        self.poses = [(rotation.T @ turn, rotation.T @ (place - position)) for turn, place in poses]

    def _pose(self, body: int) -> tuple[np.ndarray, np.ndarray]:
        """Return rotation matrix and position of a body."""
        return self.data.xmat[body].reshape(3, 3).copy(), self.data.xpos[body].copy()

    def place(self, qpos: np.ndarray) -> None:
        """Set the objects' coordinates in `qpos`, shape (nq,), to where its posture carries them."""
        if not self.bodies:
            return
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        rotation, position = self._pose(self.palm)
        for body, (turn, place) in zip(self.bodies, self.poses, strict=True):
            values = coordinates(self.model, body, rotation @ turn, position + rotation @ place)
            qpos[joint_address(self.model, body)] = values

    def drift(self, xpos: np.ndarray, xmat: np.ndarray) -> np.ndarray:
        """Return how far the object that moved most in the palm has moved [m], one entry a world.

        Args:
            xpos: Positions of the bodies [m], shape (num_worlds, num_bodies, 3).
            xmat: Their rotation matrices, shape (num_worlds, num_bodies, 3, 3).
        """
        farthest = np.zeros(len(xpos))
        for body, (_, place) in zip(self.bodies, self.poses, strict=True):
            moved = xpos[:, body] - xpos[:, self.palm] - xmat[:, self.palm] @ place
            farthest = np.maximum(farthest, np.linalg.norm(moved, axis=1))
        return farthest
