"""Places of constraint rows, given out in the engine's order: in `efc`, and in its sparse Jacobian."""

import warp as wp
from mujoco_warp import OverflowType

from myowarp.engine.stages.arrays import ConstraintRows, ContactPool
from myowarp.engine.stages.contact_rows import KinematicTree, clear, last_dof


@wp.struct
class RowPlaces:
    """Numbers of rows, allocated and used, and places of some; fields of `Data` and `Data.efc`.

    Attributes:
        efc_nnz: Entries given out in the sparse J of each world, those that did not fit included.
    """

    njmax: int
    njmax_nnz: int
    ne: wp.array[int]
    nf: wp.array[int]
    nl: wp.array[int]
    nefc: wp.array[int]
    overflow: wp.array[int]
    dof_frictionadr: wp.array2d[int]
    jtdaj_adr: wp.array2d[int]
    jtdaj_nrow: wp.array2d[int]
    jtdaj_nblock: wp.array[int]
    Jqvel: wp.array2d[float]
    efc_nnz: wp.array[int]


@wp.func
def add_rows(
    world: int, number: int, rownnz: int, grouped: bool, places: RowPlaces, rows: ConstraintRows
) -> int:
    """Return the first of a number of new rows, -1 if the sparse J has no room for their entries.

    Rows from `njmax` on are counted and nothing else. `grouped`: the engine's sparse solver adds these rows
    to the Hessian as a block.
    """
    first = places.nefc[world]
    fitting = wp.min(number, places.njmax - first)
    if rows.J_rownnz.shape[1] > 0 and fitting > 0:
        address = places.efc_nnz[world]
        places.efc_nnz[world] = address + fitting * rownnz
        if address + fitting * rownnz > places.njmax_nnz:
            places.overflow[world] = places.overflow[world] | int(OverflowType.NJMAX_NNZ)
            return -1
        for i in range(fitting):
            rows.J_rownnz[world, first + i] = rownnz
            rows.J_rowadr[world, first + i] = address + i * rownnz
        if grouped and places.jtdaj_adr.shape[1] > 0:
            block = places.jtdaj_nblock[world]
            places.jtdaj_nblock[world] = block + 1
            places.jtdaj_adr[world, block] = first
            places.jtdaj_nrow[world, block] = fitting
    places.nefc[world] = first + number
    return first


@wp.func
def add_row(
    world: int, count: wp.array[int], rownnz: int, grouped: bool, places: RowPlaces, rows: ConstraintRows
) -> int:
    """Return a new row of a kind of which there are `count`, -1 if it does not fit; a dense one is zero."""
    row = add_rows(world, 1, rownnz, grouped, places, rows)
    if row < 0:
        return -1
    count[world] = count[world] + 1
    if row >= places.njmax:
        return -1
    if rows.J_rownnz.shape[1] == 0:
        clear(rows.J[world, row])
    return row


@wp.func
def place_contact(
    tree: KinematicTree, contacts: ContactPool, conid: int, places: RowPlaces, rows: ConstraintRows
):
    """Give the rows of a contact their places, -1 where they do not fit."""
    world, condim, geoms = contacts.worldid[conid], contacts.dim[conid], contacts.geom[conid]
    number = wp.max(1, 2 * (condim - 1))
    rownnz = int(0)
    if rows.J_rownnz.shape[1] > 0:
        dof1 = last_dof(tree, tree.geom_bodyid[geoms[0]])
        dof2 = last_dof(tree, tree.geom_bodyid[geoms[1]])
        while dof1 != dof2:  # what moves both bodies moves neither against the other
            if dof1 > dof2:
                dof1 = tree.dof_parentid[dof1]
            else:
                dof2 = tree.dof_parentid[dof2]
            rownnz += 1
    first = add_rows(world, number, rownnz, True, places, rows)
    for i in range(number):
        row = first + i
        if first >= 0 and row < places.njmax:
            contacts.efc_address[conid, i] = row
            rows.id[world, row] = conid
            places.Jqvel[world, row] = 0.0  # the engine adds to it
        else:
            contacts.efc_address[conid, i] = -1
