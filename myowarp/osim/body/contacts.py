"""Contact forces of a model along a motion, in float64, by the laws of the simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from myowarp.kernels.launch import launch
from myowarp.laws.forces.contact import Contact, contact_wrench
from myowarp.osim.body.model_forces import motion_of
from myowarp.osim.body.skeleton import Bones, Placement, Skeleton, place
from myowarp.osim.bundle.contacts import SurfacePair, contact_table
from myowarp.osim.document.contacts import contact_pairs

wp.set_module_options({"enable_backward": False})


@wp.kernel(enable_backward=False)
def push_contacts(
    # Model:
    skeleton: Skeleton,
    contacts: wp.array[Contact],
    # In:
    values: wp.array2d[wp.float64],
    speeds: wp.array2d[wp.float64],
    # Out:
    placement: Placement,
    force: wp.array2d[wp.vec3d],
    location: wp.array2d[wp.vec3d],
):
    """Force on the second body of each contact [N], and where it acts [m]."""
    worldid = wp.tid()
    place(worldid, skeleton, values, worldid, placement)
    for number in range(contacts.shape[0]):
        contact = contacts[number]
        first = motion_of(worldid, contact.first.body, skeleton, speeds, placement)
        second = motion_of(worldid, contact.second.body, skeleton, speeds, placement)
        found = contact_wrench(contact, first, second)
        force[worldid, number] = found.touch.force
        location[worldid, number] = found.location


@dataclass(frozen=True, eq=False)
class Contacts:
    """Forces of contacts in a motion.

    Attributes:
        pairs: Who touches whom.
        force: On the second body of each [N], in ground, shape (frames, pairs, 3).
        location: Where it acts [m], in ground, likewise.
    """

    pairs: tuple[SurfacePair, ...]
    force: np.ndarray
    location: np.ndarray


def contacts_along(bones: Bones, values: np.ndarray, speeds: np.ndarray) -> Contacts:
    """Return what the contacts of a model do.

    Args:
        bones: The model.
        values: Of the independent coordinates [rad] or [m], shape (frames, coordinates).
        speeds: Their derivatives by time.

    Raises:
        ValueError: A contact force names a contact geometry that the model has not.
    """
    pairs = tuple(map(SurfacePair.of, contact_pairs(bones.model)))
    shape = len(values), len(pairs)
    with wp.ScopedDevice(bones.device):
        force, location = wp.zeros(shape, dtype=wp.vec3d), wp.zeros(shape, dtype=wp.vec3d)
        launch(
            push_contacts,
            len(values),
            skeleton=bones.skeleton,
            contacts=contact_table(pairs, bones.number),
            values=wp.array(values, dtype=wp.float64),
            speeds=wp.array(speeds, dtype=wp.float64),
            placement=bones.placement(len(values)),
            force=force,
            location=location,
        )
    return Contacts(pairs, force.numpy(), location.numpy())
