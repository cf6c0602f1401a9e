"""Actuator forces by one thread a world, see `kernels/affine_actuators.py`."""

import contextlib
from collections.abc import Iterator
from unittest import mock

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp._src import forward
from mujoco_warp._src.types import BiasType, DisableBit, GainType, IntegratorType, JointType, TrnType

from myowarp.engine.stages import FUSIONS, Fusion
from myowarp.engine.stages.affine_actuators_kernel import ActuatorMoments, AffineActuators, actuate
from myowarp.engine.stages.arrays import filled
from myowarp.spec.scene import Scene


@FUSIONS.register("affine_actuators")
class AffineActuatorsFusion(Fusion):
    """The engine's actuation stage, for actuators without a state of their own."""

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why it cannot be used, None if it can."""
        model, callbacks = scene.model, scene.model.callback
        gains, biases = model.actuator_gaintype.numpy(), model.actuator_biastype.numpy()
        off = model.actuator_biasprm.numpy()[:, biases == BiasType.NONE]
        limited = (model.tendon_actfrclimited, model.jnt_actfrclimited)
        obstacles = {
            "the device is not the CPU": not scene.device.is_cpu,
            "there is no actuator": model.nu == 0,
            "actuators have states": model.na > 0,
            "a gain is not a constant": (gains != GainType.FIXED).any(),
            "a bias is not affine": not np.isin(biases, (BiasType.NONE, BiasType.AFFINE)).all(),
            "a bias that is off has parameters": off.any(),
            "an actuator drives neither tendon nor hinge nor slide": not _drives_scalars(model),
            "controls are delayed": model.nhistory > 0,
            "forces are limited at tendons or joints": any(array.numpy().any() for array in limited),
            "actuators compensate gravity": model.jnt_actgravcomp.numpy().any(),
            "the integrator is the discrete one": model.opt.integrator == IntegratorType.DISCRETE,
            "actuation is off": bool(model.opt.disableflags & DisableBit.ACTUATION),
            "the user has actuators": any((callbacks.act_dyn, callbacks.act_gain, callbacks.act_bias)),
        }
        return next((reason for reason, holds in obstacles.items() if holds), None)

    def __init__(self, scene: Scene) -> None:
        """Nothing to allocate."""

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Have the engine launch our kernel as its actuation stage."""
        with mock.patch.object(forward, "fwd_actuation", launch_actuation):
            yield


def _drives_scalars(model: mjw.Model) -> bool:
    """Whether all actuators pull tendons or act on joints with one degree of freedom."""
    kinds, joints = model.actuator_trntype.numpy(), model.actuator_trnid.numpy()[:, 0]
    if not np.isin(kinds, (TrnType.TENDON, TrnType.JOINT)).all():
        return False
    driven = model.jnt_type.numpy()[joints[kinds == TrnType.JOINT]]
    return bool(np.isin(driven, (JointType.HINGE, JointType.SLIDE)).all())


def launch_actuation(model: mjw.Model, data: mjw.Data) -> None:
    """Set the actuator forces of all worlds, as `mujoco_warp._src.forward.fwd_actuation` does."""
    actuators, moments = filled(AffineActuators, model), filled(ActuatorMoments, data)
    clamp_controls = not model.opt.disableflags & DisableBit.CLAMPCTRL
    wp.launch(
        actuate,
        dim=data.nworld,
        inputs=[actuators, data.ctrl, clamp_controls, moments],
        outputs=[data.actuator_force, data.qfrc_actuator],
    )
