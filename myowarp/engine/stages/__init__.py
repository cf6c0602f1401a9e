"""Parts of the engine's step done by kernels of ours: same results, less work.

A fusion stands in for some of mujoco-warp's launches wherever a model allows it. It depends on the engine's
internals, so `verified_fusions` trusts none before a physics step with it has given what the stock step
gives, in states of the task itself; otherwise the stock launches stay. A new fusion is one file here, device
code in `kernels/`, and one import at the foot of this file.
"""

import abc
import contextlib
import logging
from collections.abc import Callable, Iterable, Iterator

import mujoco
import numpy as np
import warp as wp

from myowarp.spec.registry import Registry
from myowarp.spec.scene import Scene

logger = logging.getLogger("myowarp")

NUM_STATES = 16  # compared, at least
CONTROL_STEPS = 8  # between two states, at most
TRUSTED_SHARE = 0.9  # of the states that must agree: the engine itself loses single contacts
LEAST_CHANGE = 1e-6, 1e-2  # of velocities and positions, that errors are a share of; positions are rounded
ROUNDINGS = 16
"""A fusion may differ by as much as that many roundings of the state move the stock step. Stiff equalities,
as in models converted from OpenSim, turn one rounding into up to 3e-4 of the change of velocity; fusions
were seen to differ by up to 10 times the median of that."""


class Fusion(abc.ABC):
    """Kernels of ours in place of a part of the engine's step.

    Attributes:
        TOLERANCE: Largest difference that it makes to a step's change of velocity or of position, as a share
            of the largest such change in the state (float32 sums in another order), beyond `ROUNDINGS` of
            the state.
    """

    TOLERANCE = 1e-4

    @classmethod
    @abc.abstractmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why this scene cannot use the fusion, None if it can."""

    @abc.abstractmethod
    def __init__(self, scene: Scene) -> None:
        """Allocate all that the kernels need, on the scene's device."""

    @abc.abstractmethod
    def installed(self) -> contextlib.AbstractContextManager[None]:
        """Have the engine launch our kernels in place of its own in the block."""


FUSIONS: Registry[type[Fusion]] = Registry("fusion")


@contextlib.contextmanager
def installed(fusions: Iterable[Fusion]) -> Iterator[None]:
    """Install several fusions for a block."""
    with contextlib.ExitStack() as stack:
        for fusion in fusions:
            stack.enter_context(fusion.installed())
        yield


def applicable_fusions(scene: Scene, names: Iterable[str]) -> tuple[Fusion, ...]:
    """Return the fusions of these names that a scene can use, in the order of the names."""
    return tuple(FUSIONS[name](scene) for name in names if FUSIONS[name].obstacle(scene) is None)


def verified_fusions(
    scene: Scene, fusions: Iterable[Fusion], launch_step: Callable[[], None]
) -> tuple[Fusion, ...]:
    """Return the fusions whose step is the stock one; a line is logged for each that is left out.

    Args:
        scene: The task; its state is overwritten.
        fusions: What `applicable_fusions` returned.
        launch_step: Launches one stock physics step eagerly.
    """
    trusted: tuple[Fusion, ...] = ()
    fusions = tuple(fusions)
    if not fusions:
        return trusted
    batches = list(_states(scene))
    before = _changes(scene, batches, launch_step, ())
    # The median: single states where a rounding makes or breaks a contact must not count.
    rounding = float(np.median(_error(_changes(scene, map(_rounded, batches), launch_step, ()), before)))
    for fusion in fusions:
        changes = _changes(scene, batches, launch_step, (*trusted, fusion))
        error, allowed = _error(changes, before), fusion.TOLERANCE + ROUNDINGS * rounding
        if np.mean(error <= allowed) >= TRUSTED_SHARE:
            trusted, before = (*trusted, fusion), changes
            continue
        logger.warning(
            "%s is left to mujoco-warp: a step with ours differs by %.1e of what a step changes (median), "
            "allowed is %.0e",
            type(fusion).__name__,
            np.median(error),
            allowed,
        )
    return trusted


def _states(scene: Scene) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield qpos, qvel and activation of all worlds, until NUM_STATES states: random motion of MuJoCo C."""
    host, worlds = scene.oracle, scene.num_worlds
    data = mujoco.MjData(host)
    data.qpos[:] = scene.qpos_start.numpy()
    rng = np.random.default_rng(0)
    low, high = np.where(host.actuator_ctrllimited[:, None], host.actuator_ctrlrange, (-1.0, 1.0)).T
    motion = []
    for _ in range(NUM_STATES):
        data.ctrl[:] = rng.uniform(low, high)
        mujoco.mj_step(host, data, scene.num_substeps * int(rng.integers(1, CONTROL_STEPS)))
        motion.append((data.qpos.copy(), data.qvel.copy()))
    for first in range(0, NUM_STATES, worlds):
        chosen = [motion[(first + i) % NUM_STATES] for i in range(worlds)]
        activation = rng.uniform(size=scene.muscles.activation.shape)
        yield np.array([q for q, _ in chosen]), np.array([v for _, v in chosen]), activation


def _rounded(batch: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return states whose positions and velocities are the next float32 numbers, up or down at random."""
    qpos, qvel, activation = batch
    random = np.random.default_rng(0)

    def beside(values: np.ndarray) -> np.ndarray:
        way = np.where(random.integers(2, size=values.shape), np.float32(np.inf), np.float32(-np.inf))
        return np.nextafter(values.astype(np.float32), way)

    return beside(qpos), beside(qvel), activation


def _changes(
    scene: Scene,
    batches: Iterable[tuple[np.ndarray, np.ndarray, np.ndarray]],
    launch_step: Callable[[], None],
    fusions: Iterable[Fusion],
) -> tuple[np.ndarray, np.ndarray]:
    """Return what a physics step adds to velocities, (num_states, nv), and to positions, (num_states, nq)."""
    data, changes = scene.data, []
    for qpos, qvel, activation in batches:
        # What this leaves behind is that of other states: a fusion that leaves something out is seen.
        data.qpos.assign(np.roll(qpos, 1, axis=0))
        launch_step()
        data.qpos.assign(qpos)
        data.qvel.assign(qvel)
        data.qacc_warmstart.zero_()
        scene.muscles.activation.assign(activation)
        before = data.qvel.numpy().copy(), data.qpos.numpy().copy()
        with installed(fusions):
            launch_step()
        wp.synchronize_device(scene.device)
        changes.append((data.qvel.numpy() - before[0], data.qpos.numpy() - before[1]))
    velocities, positions = zip(*changes, strict=True)
    return np.concatenate(velocities), np.concatenate(positions)


def _error(ours: tuple[np.ndarray, np.ndarray], stock: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return by how much changes differ, as a share of the largest in each state, for the worse of both."""
    shares = [
        np.abs(mine - theirs).max(axis=1) / np.abs(theirs).max(axis=1).clip(min=least)
        for mine, theirs, least in zip(ours, stock, LEAST_CHANGE, strict=True)
    ]
    return np.maximum(*shares)


from myowarp.engine.stages import (  # noqa: E402  (they register themselves)
    affine_actuators,  # noqa: F401
    contact_rows,  # noqa: F401
    contact_search,  # noqa: F401
    contact_solve,  # noqa: F401
    integrate,  # noqa: F401
    joint_rows,  # noqa: F401
    muscle_path,  # noqa: F401
    rigid_body,  # noqa: F401
)
