"""Forces of actuators that are affine in their control, length and velocity: worlds in lanes, on the CPU.

So are motors, and muscles once `myowarp.models.muscles` has put their force into the bias. The engine has a
thread for each actuator that first finds out which of a dozen kinds it is.
"""

from pathlib import Path
from typing import ClassVar

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp import BiasType, DisableBit, GainType, JointType, TrnType
from mujoco_warp._src.types import vec10

from myowarp.engine.stage import Stage
from myowarp.engine.stages.arrays import any_of, filled
from myowarp.engine.stepped import Stepped
from myowarp.kernels.lanes import at_namespace_level, block_scratch, native_kernel
from myowarp.kernels.launch import launch

FILE = Path(__file__).with_suffix(".cpp")


@wp.struct
class Actuators:
    """Parameters of actuator forces; fields are those of the engine's `Model`."""

    actuator_ctrllimited: wp.array[bool]
    actuator_ctrlrange: wp.array2d[wp.vec2]
    actuator_gainprm: wp.array2d[vec10]
    actuator_biasprm: wp.array2d[vec10]
    actuator_forcelimited: wp.array[bool]
    actuator_forcerange: wp.array2d[wp.vec2]


@wp.struct
class ActuatorMoments:
    """Lengths, velocities and moment arms; fields are those of the engine's `Data`."""

    actuator_length: wp.array2d[float]
    actuator_velocity: wp.array2d[float]
    moment_rownnz: wp.array2d[int]
    moment_rowadr: wp.array2d[int]
    moment_colind: wp.array2d[int]
    actuator_moment: wp.array2d[float]


@native_kernel(
    at_namespace_level(FILE),
    does="""
    lanes::for_blocks(ctrl_in.shape[0], nullptr, scratch.data, [&](auto& block) {
        lanes::actuate_block(block, actuators, clamp_controls, moments, ctrl_in, actuator_force_out,
                             qfrc_actuator_out);
    });
    """,
)
def actuate(
    # Model:
    actuators: Actuators,
    # Data in:
    ctrl_in: wp.array2d[float],
    # In:
    scratch: wp.array[float],
    clamp_controls: bool,
    moments: ActuatorMoments,
    # Data out:
    actuator_force_out: wp.array2d[float],
    qfrc_actuator_out: wp.array2d[float],
):
    """force = g ctrl + b0 + b1 length + b2 velocity, within its range; qfrc = moment' force."""


def _drives_scalars(model: mjw.Model) -> bool:
    """Whether all actuators pull tendons or act on joints with one degree of freedom."""
    kinds, joints = model.actuator_trntype.numpy(), model.actuator_trnid.numpy()[:, 0]
    if not np.isin(kinds, (TrnType.TENDON, TrnType.JOINT)).all():
        return False
    driven = model.jnt_type.numpy()[joints[kinds == TrnType.JOINT]]
    return bool(np.isin(driven, (JointType.HINGE, JointType.SLIDE)).all())


class AffineActuators(Stage):
    """The engine's actuation stage, for actuators without a state of their own."""

    REPLACES = ("actuation",)
    OBSTACLES: ClassVar = {
        "there is no actuator": lambda stepped: stepped.model.nu == 0,
        "actuators have states": lambda stepped: stepped.model.na > 0,
        "a gain is not a constant": lambda stepped: any_of(
            stepped.model.actuator_gaintype.numpy() != GainType.FIXED
        ),
        "a bias is not affine": lambda stepped: (
            not np.isin(stepped.model.actuator_biastype.numpy(), (BiasType.NONE, BiasType.AFFINE)).all()
        ),
        "a bias that is off has parameters": lambda stepped: any_of(
            stepped.model.actuator_biasprm.numpy()[
                :, stepped.model.actuator_biastype.numpy() == BiasType.NONE
            ]
        ),
        "an actuator drives neither tendon nor hinge nor slide": lambda stepped: (
            not _drives_scalars(stepped.model)
        ),
        "controls are delayed": lambda stepped: stepped.model.nhistory > 0,
        "forces are limited at tendons or joints": lambda stepped: any_of(
            stepped.model.tendon_actfrclimited, stepped.model.jnt_actfrclimited
        ),
        "actuators compensate gravity": lambda stepped: any_of(stepped.model.jnt_actgravcomp),
        "actuation is off": lambda stepped: bool(stepped.model.opt.disableflags & DisableBit.ACTUATION),
        "the user has actuators": lambda stepped: any(
            (
                stepped.model.callback.act_dyn,
                stepped.model.callback.act_gain,
                stepped.model.callback.act_bias,
            )
        ),
    }

    def __init__(self, stepped: Stepped) -> None:
        """Allocate the memory of a block."""
        super().__init__(stepped)
        model, data = stepped.model, stepped.data
        read = filled(Actuators, model), filled(ActuatorMoments, data), data.ctrl
        self._scratch = block_scratch(stepped.device, *read, data.actuator_force, data.qfrc_actuator)

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Set the actuator forces of all worlds, as `mujoco_warp.fwd_actuation` does."""
        launch(
            actuate,
            1,
            data,
            scratch=self._scratch,
            actuators=filled(Actuators, model),
            moments=filled(ActuatorMoments, data),
            clamp_controls=not model.opt.disableflags & DisableBit.CLAMPCTRL,
        )
