"""Leave out the engine's launches that can do nothing for a model.

mujoco-warp launches kernels for tendon armature, springs, friction, gravity compensation and more whatever
the model holds. On the CPU device these are a quarter of a hand's step. Each entry of `IDLE_WHEN` names a
kernel and the condition under which it writes nothing that is read: its field is zero in the model, and no
task or muscle condition sets that field per world. Because the names are the
engine's own, `verify` trusts none of them before a pruned step has given the same state as a stock
step: bit for bit on the CPU, to rounding on CUDA, where the engine's sums have no fixed order.
"""

import contextlib
from collections.abc import Callable

import mujoco
import numpy as np

from myowarp.engine.patch import exchanged
from myowarp.engine.stepped import Stepped


def _zero(*names: str) -> Callable[[Stepped], bool]:
    """Return a condition: these fields of the model are zero, and no world has its own."""
    return lambda stepped: (
        not any(name in stepped.batched or np.any(getattr(stepped.oracle, name)) for name in names)
    )


_MUSCLE = mujoco.mjtDyn.mjDYN_MUSCLE.value
_NO_TENDON_ARMATURE = _zero("tendon_armature", "actuator_armature")
_NO_TENDON_DAMPING = _zero("tendon_damping", "tendon_dampingpoly", "actuator_damping", "actuator_dampingpoly")
_NO_TENDON_SPRING = _zero("tendon_stiffness", "tendon_stiffnesspoly")
_NO_FORCE_LIMIT = _zero("tendon_actfrclimited", "actuator_forcelimited")

IDLE_WHEN: dict[str, Callable[[Stepped], bool]] = {
    "_tendon_armature": _NO_TENDON_ARMATURE,
    "_tendon_bias_coef": _NO_TENDON_ARMATURE,
    "_tendon_bias_qfrc": _NO_TENDON_ARMATURE,
    "_tendon_dot": _NO_TENDON_ARMATURE,
    "_spring_damper_tendon_passive": lambda s: _NO_TENDON_DAMPING(s) and _NO_TENDON_SPRING(s),
    "_tendon_velocity": lambda s: _NO_TENDON_DAMPING(s) and s.oracle.nsensor == 0,
    "_qderiv_tendon_damping": _NO_TENDON_DAMPING,
    "_friction_dof": _zero("dof_frictionloss"),
    "_friction_tendon": _zero("tendon_frictionloss"),
    "_gravity_force": _zero("body_gravcomp"),
    "_tendon_actuator_force": lambda s: _NO_FORCE_LIMIT(s) and s.oracle.nsensor == 0,
    "_tendon_actuator_force_clamp": _NO_FORCE_LIMIT,
    "_qfrc_actuator_gravcomp_limits": _zero("jnt_actfrclimited", "jnt_actgravcomp"),
    "_next_activation": lambda s: (  # ours have none
        s.oracle.na == np.count_nonzero(s.oracle.actuator_dyntype == _MUSCLE)
    ),
    "_spatial_tendon_wrap": lambda s: True,  # exports the path for drawing; we draw with MuJoCo C
    "_apply_ft": lambda s: True,  # external forces on bodies; the simulation applies none
}


def idle_kernels(stepped: Stepped) -> frozenset[str]:
    """Return the names of the kernels that do nothing for this model and its worlds."""
    return frozenset(name for name, idle in IDLE_WHEN.items() if idle(stepped))


def pruned(names: frozenset[str]) -> contextlib.AbstractContextManager[None]:
    """Skip launches of the kernels with these names in the block."""
    return exchanged(lambda kernel: None if kernel.key.split("__locals__")[0] in names else kernel)
