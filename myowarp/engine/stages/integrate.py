"""The end of a physics step in one launch instead of six to nine, see `kernels/integrate.py`."""

import contextlib
from collections.abc import Iterator
from unittest import mock

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp._src import forward
from mujoco_warp._src.types import BiasType, DisableBit, EnableBit, GainType, IntegratorType

from myowarp.engine.stages import FUSIONS, Fusion
from myowarp.engine.stages.arrays import InertiaRows, filled
from myowarp.engine.stages.integrate_kernel import (
    MAX_DOFS,
    MAX_ENTRIES,
    JointAddresses,
    Stages,
    StepState,
    Usage,
    VelocityForces,
    integrate,
)
from myowarp.spec.scene import Scene


@FUSIONS.register("integrate")
class Integrate(Fusion):
    """The integrators Euler and `implicitfast`; the engine's `implicit_free_body` still does free bodies."""

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why a step cannot end so, None if it can."""
        model, opt = scene.model, scene.model.opt
        implicit = opt.integrator == IntegratorType.IMPLICITFAST
        explicit = DisableBit.DAMPER | (DisableBit.ACTUATION if implicit else DisableBit.EULERDAMP)
        obstacles = {
            "the device is not the CPU": not scene.device.is_cpu,
            "the integrator is neither Euler nor implicitfast": not (
                implicit or opt.integrator == IntegratorType.EULER
            ),
            f"degrees of freedom are not 1 to {MAX_DOFS}": not 0 < model.nv <= MAX_DOFS,
            f"the inertia matrix has more than {MAX_ENTRIES} entries": scene.data.M.shape[1] > MAX_ENTRIES,
            "a row of the inertia matrix does not begin with the rows above it": not _rows_begin_alike(model),
            "forces are integrated explicitly": bool(opt.disableflags & explicit),
            "actuators damp joints or tendons": _any(model.actuator_damping, model.actuator_dampingpoly),
            "there are flexes or plastic springs": bool(model.nflex or model.nplastic),
            "sleeping is on": bool(opt.enableflags & EnableBit.SLEEP),
            "overflows are to be printed": bool(opt.warn_overflow),
        }
        reason = next((reason for reason, holds in obstacles.items() if holds), None)
        return reason or (_unknown_slope(model) if implicit else None)

    def __init__(self, scene: Scene) -> None:
        """Allocate the accelerations that the state is advanced with; `Data.qacc` stays the solver's."""
        self._acceleration = wp.zeros_like(scene.data.qvel)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Have the engine end its step with our launch."""
        with (
            mock.patch.object(forward, "euler", self._launch),
            mock.patch.object(forward, "implicit", self._launch),
        ):
            yield

    def _launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """End the step of all worlds, as `mujoco_warp._src.forward.euler` and `implicit` do."""
        acceleration = self._acceleration
        implicit = model.opt.integrator == IntegratorType.IMPLICITFAST
        free = implicit and model.body_freeadr.size > 0
        stateful = model.na > 0 or model.nhistory > 0
        launch_stages(model, data, acceleration, implicit, advance=not (free or stateful))
        if free:
            forward.implicit_free_body(model, data, data.efc.Ma, acceleration, solve=True)
        if stateful:
            forward._advance(model, data, acceleration)
        elif free:
            launch_stages(model, data, acceleration, implicit, solve=False)


def _any(*arrays: wp.array) -> bool:
    """Whether anything in these arrays is not zero."""
    return any(array.numpy().any() for array in arrays)


def _rows_begin_alike(model: mjw.Model) -> bool:
    """Whether each row of M is the row of the dof above and its own dof."""
    address, size = model.M_rowadr.numpy(), model.M_rownnz.numpy()
    rows = [model.M_colind.numpy()[a : a + n].tolist() for a, n in zip(address, size, strict=True)]
    return all(rows[dof] == row[: i + 1] for row in rows for i, dof in enumerate(row))


def _unknown_slope(model: mjw.Model) -> str | None:
    """Return which force has a derivative by velocity that we do not compute, None if none has."""
    velocity_gains = (GainType.AFFINE, GainType.MUSCLE, GainType.DCMOTOR)
    obstacles = {
        "a gain may depend on velocity": np.isin(model.actuator_gaintype.numpy(), velocity_gains).any(),
        "there are DC motors": (model.actuator_biastype.numpy() == BiasType.DCMOTOR).any(),
        "forces are limited at tendons or joints": _any(model.tendon_actfrclimited, model.jnt_actfrclimited),
        "tendons are damped": _any(model.tendon_damping, model.tendon_dampingpoly),
        "a fluid resists": bool(model.has_fluid),
    }
    return next((reason for reason, holds in obstacles.items() if holds), None)


def launch_stages(
    model: mjw.Model,
    data: mjw.Data,
    acceleration: wp.array,
    implicit_actuators: bool,
    solve: bool = True,
    advance: bool = True,
) -> None:
    """Compute accelerations, advance the state with them, or both; see `Stages`."""
    stages = Stages()
    stages.timestep, stages.implicit_actuators = model.opt.timestep, implicit_actuators
    stages.solve, stages.advance = solve, advance
    inertia, joints = filled(InertiaRows, model), filled(JointAddresses, model)
    forces, usage, state = filled(VelocityForces, model, data), filled(Usage, data), filled(StepState, data)
    wp.launch(
        integrate,
        dim=data.nworld,
        inputs=[inertia, joints, stages, data.M, data.efc.Ma, data.qacc, forces, usage],
        outputs=[acceleration, state],
    )
