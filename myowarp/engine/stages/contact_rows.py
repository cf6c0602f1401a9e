"""Constraint rows of contacts as one kernel, see `kernels/contact_rows.py`."""

import contextlib
from collections.abc import Iterator
from unittest import mock

import mujoco_warp as mjw
import warp as wp
from mujoco_warp._src import constraint
from mujoco_warp._src.types import DeterminismType, DisableBit, IntegratorType

from myowarp.engine.idle import pruned
from myowarp.engine.stages import FUSIONS, Fusion
from myowarp.engine.stages.arrays import ConstraintRows, ContactPool, filled
from myowarp.engine.stages.contact_rows_kernel import KinematicTree, RowOptions, write_contact_rows
from myowarp.kernels.batching import num_threads
from myowarp.spec.scene import Scene

REPLACED = frozenset({"_efc_contact_jac_dense", "_efc_contact_jac_sparse", "_efc_contact_update"})


@FUSIONS.register("contact_rows")
class ContactRowsFusion(Fusion):
    """All rows of a contact in one thread; they have their places already."""

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why the rows cannot be written so, None if they can."""
        model, opt = scene.model, scene.model.opt
        obstacles = {
            "the device is not the CPU": not scene.device.is_cpu,
            "there are no contacts": scene.data.naconmax == 0,
            "contacts are off": bool(opt.disableflags & (DisableBit.CONTACT | DisableBit.CONSTRAINT)),
            "the friction cone is not pyramidal": opt.cone != mjw.ConeType.PYRAMIDAL,
            "the integrator is the discrete one": opt.integrator == IntegratorType.DISCRETE,
            "rows are sorted": bool(opt.deterministic & DeterminismType.CONSTRAINT),
            "there are flexes, adhesion or moving surfaces": bool(
                model.nflex or model.flg_adhesion or model.flg_surfacevel
            ),
        }
        return next((reason for reason, holds in obstacles.items() if holds), None)

    def __init__(self, scene: Scene) -> None:
        """Nothing to allocate."""

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Have `mujoco_warp.step` launch our kernel in place of those that it replaces."""
        stock = constraint.make_constraint

        def make_constraint(model: mjw.Model, data: mjw.Data) -> None:
            with pruned(REPLACED):
                stock(model, data)
            launch_rows(model, data)

        with mock.patch.object(constraint, "make_constraint", make_constraint):
            yield


def launch_rows(model: mjw.Model, data: mjw.Data) -> None:
    """Write the rows of all contacts."""
    tree, options = filled(KinematicTree, model), filled(RowOptions, model.opt)
    contacts, rows = filled(ContactPool, data.contact, data), filled(ConstraintRows, data.efc)
    threads = num_threads(data.nacon.device, data.naconmax)
    wp.launch(
        write_contact_rows,
        dim=threads,
        inputs=[tree, options, data.qvel, data.subtree_com, data.cdof, threads, contacts],
        outputs=[rows],
    )
