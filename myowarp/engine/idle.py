"""Leave out the engine's launches that can do nothing for a model.

mujoco-warp launches kernels for tendon armature, springs, friction, gravity compensation and more whatever
the model holds. On the CPU device these are a quarter of a hand's step. Each entry of `IDLE_WHEN` names a
kernel and the condition on the model under which it writes nothing that is read. Because the names are the
engine's own, `verified_idle` trusts none of them before a pruned step has given the same state as a stock
step: bit for bit on the CPU, to rounding on CUDA, where the engine's sums have no fixed order.
"""

import contextlib
from collections.abc import Callable, Iterator
from unittest import mock

import mujoco
import numpy as np
import warp as wp
from mujoco_warp._src import collision_convex, solver

from myowarp.engine.patch import exchanged
from myowarp.models.couplings import POINT_JOINTS
from myowarp.spec.scene import Scene


def _zero(*names: str) -> Callable[[mujoco.MjModel], bool]:
    """Return a condition: these fields of the model are all zero."""
    return lambda model: not any(np.any(getattr(model, name)) for name in names)


ROUNDING = 1e-4  # of the largest change in a world; float32 sums in any order

_MUSCLE = mujoco.mjtDyn.mjDYN_MUSCLE.value
_NO_TENDON_ARMATURE = _zero("tendon_armature", "actuator_armature")
_NO_TENDON_DAMPING = _zero("tendon_damping", "tendon_dampingpoly", "actuator_damping", "actuator_dampingpoly")
_NO_TENDON_SPRING = _zero("tendon_stiffness", "tendon_stiffnesspoly")
_NO_FORCE_LIMIT = _zero("tendon_actfrclimited", "actuator_forcelimited")

IDLE_WHEN: dict[str, Callable[[mujoco.MjModel], bool]] = {
    "_tendon_armature": _NO_TENDON_ARMATURE,
    "_tendon_bias_coef": _NO_TENDON_ARMATURE,
    "_tendon_bias_qfrc": _NO_TENDON_ARMATURE,
    "_tendon_dot": _NO_TENDON_ARMATURE,
    "_spring_damper_tendon_passive": lambda m: _NO_TENDON_DAMPING(m) and _NO_TENDON_SPRING(m),
    "_tendon_velocity": lambda m: _NO_TENDON_DAMPING(m) and m.nsensor == 0,
    "_qderiv_tendon_damping": _NO_TENDON_DAMPING,
    "_friction_tendon": _zero("tendon_frictionloss"),
    "_gravity_force": _zero("body_gravcomp"),
    "_tendon_actuator_force": lambda m: _NO_FORCE_LIMIT(m) and m.nsensor == 0,
    "_tendon_actuator_force_clamp": _NO_FORCE_LIMIT,
    "_next_activation": lambda m: m.na == np.count_nonzero(m.actuator_dyntype == _MUSCLE),  # ours have none
    "_spatial_tendon_wrap": lambda m: True,  # exports the path for drawing; we draw with MuJoCo C
    "_apply_ft": lambda m: True,  # external forces on bodies; the simulation applies none
}


def idle_kernels(model: mujoco.MjModel) -> frozenset[str]:
    """Return the names of the kernels that do nothing for this model."""
    return frozenset(name for name, idle in IDLE_WHEN.items() if idle(model))


def pruned(names: frozenset[str]) -> contextlib.AbstractContextManager[None]:
    """Skip launches of the kernels with these names in the block."""
    return exchanged(lambda kernel: None if kernel.key.split("__locals__")[0] in names else kernel)


@contextlib.contextmanager
def one_thread(device: wp.Device) -> Iterator[None]:
    """Have the engine split no work over threads in the block; on the CPU, which runs them in turn.

    Below 4 worlds mujoco-warp sums J' D J of a sparse model in several parts, and the rounding is another
    one; it looks for convex contacts in as many threads as there is room for, most of which find nothing.
    """
    if not device.is_cpu:
        yield
        return
    with (
        mock.patch.object(solver, "_jtdaj_groups_per_world", return_value=1),
        mock.patch.object(collision_convex, "_ccd_grid_size", return_value=1),
    ):
        yield


def verified_idle(scene: Scene, launch_step: Callable[[], None]) -> frozenset[str]:
    """Return the kernels to leave out, none if leaving them out changes the state.

    Args:
        scene: The task; its state is overwritten.
        launch_step: Launches one stock physics step eagerly.
    """
    host, data = scene.oracle, scene.data
    names = idle_kernels(host)
    rng = np.random.default_rng(0)
    low, high = np.where(host.jnt_limited[:, None], host.jnt_range, (-1.0, 1.0)).T
    qpos = np.tile(host.qpos0, (data.nworld, 1))
    scalar = np.isin(host.jnt_type, POINT_JOINTS)
    qpos[:, host.jnt_qposadr[scalar]] = rng.uniform(low, high, (data.nworld, host.njnt))[:, scalar]
    qvel = rng.standard_normal((data.nworld, host.nv))
    activation = rng.uniform(size=scene.muscles.activation.shape)
    start = np.concatenate([qpos, qvel], axis=1)
    ends = []
    for skipped in (names, frozenset[str]()):
        data.qpos.assign(qpos)
        data.qvel.assign(qvel)
        data.qacc_warmstart.zero_()
        scene.muscles.activation.assign(activation)
        with pruned(skipped):
            launch_step()
        ends.append(np.concatenate([data.qpos.numpy(), data.qvel.numpy()], axis=1).copy())
    ours, stock = ends
    return names if is_same_step(start, ours, stock, exact=scene.device.is_cpu) else frozenset()


def is_same_step(start: np.ndarray, first: np.ndarray, second: np.ndarray, exact: bool) -> bool:
    """Whether two steps from the same states, (num_worlds, n) each, have led to the same states.

    Args:
        start: States before.
        first: States after the one step.
        second: States after the other.
        exact: Whether every bit counts. If not, half of the worlds may differ by more than rounding: a
            solver that stops one iteration earlier makes more of it, a kernel left out shows in all worlds.
    """
    if exact:
        return np.array_equal(first, second)
    change = np.abs(second - start).max(axis=1).clip(min=1e-6)
    return bool(np.median(np.abs(first - second).max(axis=1) / change) <= ROUNDING)
