"""Random start configurations of a task: within the joint ranges, without penetration, not failing at once.

A start is drawn between the task's own start and a uniformly random posture, so that hands that must stay
near an object are found too. It is kept if MuJoCo C sees no deeper penetration than the task's own start has,
and if the task's own score does not call it failed.
"""

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.cache import cached
from myowarp.scene import Scene, compile_scene, source_digest
from myowarp.spec import TaskSpec

NUM_STARTS = 1024
BATCH = 256  # candidates scored together
MAX_BATCHES = 400
PENETRATION = 1e-4  # m, beyond that of the task's own start
JUDGED_STEP = 2  # the earliest step at which every task can fail


def posture_joints(model: mujoco.MjModel) -> np.ndarray:
    """Return the addresses in qpos of the body's own joints: those with a range."""
    return model.jnt_qposadr[np.flatnonzero(model.jnt_limited)].astype(np.int32)


def random_starts(spec: TaskSpec) -> np.ndarray:
    """Return start postures of a task, from disk if they were found before.

    Returns:
        Joint angles [rad] of the joints of `posture_joints`, shape (1024, num_joints).

    Raises:
        ValueError: Too few postures are free of penetration and failure.
    """
    key = ("random_starts", spec.key, source_digest(spec), NUM_STARTS, PENETRATION)
    return cached(key, ".npy", lambda: _find(spec), lambda starts, path: np.save(path, starts), np.load)


def _find(spec: TaskSpec) -> np.ndarray:
    """Draw until there are enough."""
    rng = np.random.default_rng(0)
    scene = compile_scene(spec, BATCH, "cpu")
    with wp.ScopedDevice("cpu"):
        judge = _Judge(spec, scene)
        found: list[np.ndarray] = []
        for _ in range(MAX_BATCHES):
            found.extend(judge.accepted(rng))
            if len(found) >= NUM_STARTS:
                return np.stack(found[:NUM_STARTS])
    raise ValueError(
        f"task {spec.key!r} has too few random starts: {len(found)} of {NUM_STARTS} after "
        f"{MAX_BATCHES * BATCH} draws; use reset='fixed'"
    )


class _Judge:
    """Draws candidates and keeps the good ones."""

    def __init__(self, spec: TaskSpec, scene: Scene) -> None:
        self.scene, self.model = scene, scene.oracle
        self.program = spec.bind(scene)
        self.start = spec.start(self.model)
        self.address = posture_joints(self.model)
        self.low, self.high = self.model.jnt_range[np.flatnonzero(self.model.jnt_limited)].T
        self.data = mujoco.MjData(self.model)
        self.everywhere = wp.ones(BATCH, dtype=bool)
        self.step_count = wp.full(BATCH, JUDGED_STEP, dtype=int)
        self.terms = wp.zeros((BATCH, len(spec.reward_terms())), dtype=float)
        self.solved, self.failed = wp.zeros(BATCH, dtype=bool), wp.zeros(BATCH, dtype=bool)
        self.depth = self._penetration(self.start) + PENETRATION

    def accepted(self, rng: np.random.Generator) -> list[np.ndarray]:
        """Return the good ones of a batch of candidates, posture joints only."""
        posture = rng.uniform(self.low, self.high, (BATCH, len(self.address)))
        share = rng.uniform(size=(BATCH, 1))
        qpos = np.tile(self.start, (BATCH, 1))
        qpos[:, self.address] += share * (posture - qpos[:, self.address])
        keys = self.scene.keys
        keys.seed.assign(rng.integers(2**31, size=BATCH).astype(np.int32))
        self.scene.data.qpos.assign(qpos)
        self.program.sample_start(self.everywhere)
        self.program.sample_goal(self.everywhere)
        drawn = self.scene.data.qpos.numpy()
        drawn[:, self.address] = qpos[:, self.address]
        mjw.kinematics(self.scene.model, self.scene.data)
        self.program.score(self.step_count, self.terms, self.solved, self.failed)
        good = ~self.failed.numpy()
        return [row[self.address] for row in qpos[good] if self._penetration(row) <= self.depth]

    def _penetration(self, qpos: np.ndarray) -> float:
        """Return the deepest penetration [m]."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        return max(0.0, -self.data.contact.dist.min(initial=0.0))
