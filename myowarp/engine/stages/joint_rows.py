"""Constraint rows of joints and tendons as one kernel, see `kernels/joint_rows.py`."""

import contextlib
from collections.abc import Iterator
from unittest import mock

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp._src import constraint
from mujoco_warp._src.types import DeterminismType, DisableBit, EnableBit, IntegratorType

from myowarp.engine.idle import pruned
from myowarp.engine.stages import FUSIONS, Fusion
from myowarp.engine.stages.arrays import ConstraintRows, ContactPool, filled
from myowarp.engine.stages.contact_rows_kernel import KinematicTree, RowOptions
from myowarp.engine.stages.joint_rows_kernel import JointConstraints, JointState, write_joint_rows
from myowarp.engine.stages.row_places import RowPlaces
from myowarp.spec.scene import Scene

REPLACED = frozenset({"_zero_constraint_counts", "_efc_contact_init", "_efc_nnz_overflow"})
ROWS = DisableBit.EQUALITY | DisableBit.FRICTIONLOSS | DisableBit.LIMIT


@FUSIONS.register("joint_rows")
class JointRowsFusion(Fusion):
    """All rows but those of contacts, which get their places; sparse rows that do not fit are not printed."""

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why the rows cannot be written so, None if they can."""
        model, opt = scene.model, scene.model.opt
        others = (model.eq_connect_adr, model.eq_wld_adr, model.eq_ten_adr)
        obstacles = {
            "the device is not the CPU": not scene.device.is_cpu,
            "rows of a kind are off": bool(opt.disableflags & (ROWS | DisableBit.CONSTRAINT)),
            "the friction cone is not pyramidal": opt.cone != mjw.ConeType.PYRAMIDAL,
            "the integrator is the discrete one": opt.integrator == IntegratorType.DISCRETE,
            "sleeping is on": bool(opt.enableflags & EnableBit.SLEEP),
            "rows are sorted": bool(opt.deterministic & DeterminismType.CONSTRAINT),
            "there are flexes or adhesion": bool(model.nflex or model.flg_adhesion),
            "an equality is not of joints": any(address.size for address in others),
            "a ball joint is limited": model.jnt_limited_ball_adr.size > 0,
            "tendons have friction": bool(np.any(model.tendon_frictionloss.numpy() > 0)),
        }
        return next((reason for reason, holds in obstacles.items() if holds), None)

    def __init__(self, scene: Scene) -> None:
        """Allocate the number of entries of each world's J."""
        self.efc_nnz = wp.zeros(scene.data.nworld, dtype=int, device=scene.device)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Have `mujoco_warp.step` launch our kernel in place of those that it replaces."""
        stock = constraint.make_constraint

        def make_constraint(model: mjw.Model, data: mjw.Data) -> None:
            self.launch(model, data)
            # Switched off rather than pruned: their kernels would be made, all but launched.
            off = mock.patch.object(model.opt, "disableflags", model.opt.disableflags | ROWS)
            with off, pruned(REPLACED):
                stock(model, data)

        with mock.patch.object(constraint, "make_constraint", make_constraint):
            yield

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Write the rows of all joints and tendons, and give those of contacts their places."""
        tree, joints = filled(KinematicTree, model), filled(JointConstraints, model)
        options, state = filled(RowOptions, model.opt), filled(JointState, data)
        contacts, rows = filled(ContactPool, data.contact, data), filled(ConstraintRows, data.efc)
        places = filled(RowPlaces, data, data.efc, self)
        wp.launch(
            write_joint_rows,
            dim=1,  # the rows of contacts come after the other rows of their world
            inputs=[tree, joints, options, state, contacts],
            outputs=[places, rows],
        )
