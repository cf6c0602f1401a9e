"""Constraint rows in two launches: those of joints and tendons, then those of contacts."""

from functools import partial
from typing import ClassVar

import mujoco_warp as mjw
import warp as wp
from mujoco_warp import DeterminismType, DisableBit

from myowarp.engine.stage import Launches, Stage
from myowarp.engine.stages.arrays import ConstraintRows as Rows
from myowarp.engine.stages.arrays import ContactPool, any_of, filled
from myowarp.engine.stages.contact_rows import KinematicTree, RowOptions, write_contact_rows
from myowarp.engine.stages.joint_rows import JointConstraints, JointState, write_joint_rows
from myowarp.engine.stages.row_places import RowPlaces
from myowarp.engine.stepped import Stepped
from myowarp.kernels.launch import launch

KINDS = DisableBit.CONSTRAINT | DisableBit.EQUALITY | DisableBit.FRICTIONLOSS | DisableBit.LIMIT


class ConstraintRows(Stage):
    """All rows of joints and tendons in one thread, then each contact's; rows that do not fit are counted."""

    REPLACES = ("make_constraint",)
    OBSTACLES: ClassVar = {
        "rows of a kind are off": lambda stepped: bool(stepped.model.opt.disableflags & KINDS),
        "the friction cone is not pyramidal": lambda stepped: (
            stepped.model.opt.cone != mjw.ConeType.PYRAMIDAL
        ),
        "rows are sorted": lambda stepped: bool(stepped.model.opt.deterministic & DeterminismType.CONSTRAINT),
        "there are flexes, adhesion or moving surfaces": lambda stepped: bool(
            stepped.model.nflex or stepped.model.flg_adhesion or stepped.model.flg_surfacevel
        ),
        "an equality is not of joints": lambda stepped: any(
            address.size
            for address in (
                stepped.model.eq_connect_adr,
                stepped.model.eq_wld_adr,
                stepped.model.eq_ten_adr,
            )
        ),
        "a ball joint is limited": lambda stepped: stepped.model.jnt_limited_ball_adr.size > 0,
        "tendons have friction": lambda stepped: any_of(stepped.model.tendon_frictionloss.numpy() > 0),
    }

    def __init__(self, stepped: Stepped) -> None:
        """Allocate the number of entries of each world's J."""
        super().__init__(stepped)
        self.efc_nnz = wp.zeros(stepped.data.nworld, dtype=int, device=stepped.device)

    def launcher(self, stages: tuple[Stage, ...], mask: wp.array | None = None) -> Launches:
        """Return a launch that leaves the Jacobian of contacts to our solver, if it solves these rows."""
        return partial(self.launch, in_solver=frames_in_solver(stages))

    def launch(self, model: mjw.Model, data: mjw.Data, in_solver: bool = False) -> None:
        """Write the rows of joints and tendons, give those of contacts their places, then write these."""
        launch(
            write_joint_rows,
            1,  # the rows of contacts come after the other rows of their world
            tree=filled(KinematicTree, model),
            joints=filled(JointConstraints, model),
            options=filled(RowOptions, model.opt),
            state=filled(JointState, data),
            contacts=filled(ContactPool, data.contact, data),
            places=filled(RowPlaces, data, data.efc, self),
            rows=filled(Rows, data.efc),
        )
        if data.naconmax:
            launch_contact_rows(model, data, in_solver)


def frames_in_solver(stages: tuple[Stage, ...]) -> bool:
    """Return whether our solver solves our rows: those of free coordinates others write in between."""
    places = {"make_constraint", "solve"}
    owners = [stage.data for stage in stages if places.intersection(stage.replaces)]
    return len(owners) == len(places) and owners[0] is owners[1]


def launch_contact_rows(model: mjw.Model, data: mjw.Data, in_solver: bool = False) -> None:
    """Write the rows of all contacts that have places; `in_solver`: all but their Jacobian."""
    launch(
        write_contact_rows,
        1,
        data,
        tree=filled(KinematicTree, model),
        options=filled(RowOptions, model.opt),
        contacts=filled(ContactPool, data.contact, data),
        in_solver=in_solver,
        rows=filled(Rows, data.efc),
    )
