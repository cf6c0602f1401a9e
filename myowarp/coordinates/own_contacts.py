"""Contact as OpenSim computes it, of a model that brings it along: forces between surfaces that overlap.

What a model's text says (`osim.bundle.contacts`) is evaluated in float64 from the engine's poses and acts as
passive forces,

    qfrc_j += d_j . (location x f - com x f, f) of both bodies, d_j the motion of dof j about com.

Friction below the transition velocity is a damper of 1e3 to 1e5 N s/m, which explicit steps of a
millisecond would throw back and forth. Its slope goes into the step: M + h sum of J' S D J in place of M,
where J moves the point of contact, and D is the drag across the normal and the damping along it. The share
S = 1 / (1 - e^-z) - 1 / z of each, z = h D / mass, is that with which a mass on this damper alone slows down
as e^-z: a half where the damper is soft, as the trapezoidal rule has it, and 1 where it is stiff. So forces
are those at the moment of the positions; with all of D they are those of half a step later. Between two
bodies of different branches of the tree the rows of M have no place for what couples them; there each damps
itself (as `engine.stages.integrate` has it with actuators).
"""

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.coordinates.own_forces import forces_of
from myowarp.definitions.forces import Forces
from myowarp.engine.stages.arrays import InertiaRows, filled
from myowarp.kernels.batching import batched
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_of, zeros_of
from myowarp.laws.forces.bushing import BodyMotion
from myowarp.laws.forces.contact import Contact, contact_wrench
from myowarp.osim.bundle.contacts import DocumentContacts, contact_table

SOFT = wp.constant(1e-2)
"""z below which the share is its series: in float32 the formula has no digits there."""


@wp.struct
class Pushes:
    """Forces of contacts in all worlds, (num_worlds, num_contacts).

    Attributes:
        force: On the second body [N]; 0 where the surfaces are apart.
        location: Where it acts [m].
        normal: Out of the first body.
        damping: Along the normal [N s/m].
        drag: Across it [N s/m].
    """

    force: wp.array2d[wp.vec3]
    location: wp.array2d[wp.vec3]
    normal: wp.array2d[wp.vec3]
    damping: wp.array2d[float]
    drag: wp.array2d[float]


@wp.struct
class Chains:
    """Dofs that move the bodies of contacts.

    Attributes:
        last: Last dof that moves the first and the second body of each, -1 for none, (num_contacts, 2).
        root: Body whose `subtree_com` their velocities refer to, (num_contacts, 2).
        parent: Dof above each dof, -1 for none.
        lightness: Of the bodies of each, 1 / mass in the model's first pose [1/kg], (num_contacts,).
    """

    last: wp.array2d[int]
    root: wp.array2d[int]
    parent: wp.array[int]
    lightness: wp.array[float]


@wp.func
def moving(
    worldid: int,
    body: int,
    root: int,
    xpos: wp.array2d[wp.vec3],
    xmat: wp.array2d[wp.mat33],
    subtree_com: wp.array2d[wp.vec3],
    cvel: wp.array2d[wp.spatial_vector],
) -> BodyMotion:
    """Return where a body is and how it moves, by the engine's velocity of it."""
    found = BodyMotion()
    found.rotation = wp.mat33d(xmat[worldid, body])
    found.origin = wp.vec3d(xpos[worldid, body])
    found.turn = wp.vec3d(wp.spatial_top(cvel[worldid, body]))
    com = wp.vec3d(subtree_com[worldid, root])
    found.shift = wp.vec3d(wp.spatial_bottom(cvel[worldid, body])) - wp.cross(found.turn, com)
    return found


@wp.kernel(enable_backward=False)
def touch_surfaces(
    # Params:
    contacts: wp.array[Contact],
    chains: Chains,
    # Data in:
    xpos_in: wp.array2d[wp.vec3],
    xmat_in: wp.array2d[wp.mat33],
    subtree_com_in: wp.array2d[wp.vec3],
    cvel_in: wp.array2d[wp.spatial_vector],
    # Out:
    pushes: Pushes,
):
    """Force, location and slopes of a contact."""
    worldid, number = wp.tid()
    contact = contacts[number]
    first = moving(
        worldid, contact.first.body, chains.root[number, 0], xpos_in, xmat_in, subtree_com_in, cvel_in
    )
    second = moving(
        worldid, contact.second.body, chains.root[number, 1], xpos_in, xmat_in, subtree_com_in, cvel_in
    )
    found = contact_wrench(contact, first, second)
    pushes.force[worldid, number] = wp.vec3(found.touch.force)
    pushes.location[worldid, number] = wp.vec3(found.location)
    pushes.normal[worldid, number] = wp.vec3(found.normal)
    pushes.damping[worldid, number] = float(found.touch.damping)
    pushes.drag[worldid, number] = float(found.touch.drag)


@wp.kernel(enable_backward=False)
def push_touching_bodies(
    # Params:
    chains: Chains,
    # Data in:
    subtree_com_in: wp.array2d[wp.vec3],
    cdof_in: wp.array2d[wp.spatial_vector],
    # In:
    pushes: Pushes,
    # Data out:
    qfrc_passive_out: wp.array2d[float],
):
    """qfrc_passive += d . ((location - com) x f, f) on the second body, - the same on the first."""
    worldid = wp.tid()
    for number in range(pushes.force.shape[1]):
        force = pushes.force[worldid, number]
        if wp.length_sq(force) > 0.0:
            for side in range(2):
                dof = int(chains.last[number, side])
                pushed = wp.where(side == 0, -force, force)
                arm = pushes.location[worldid, number] - subtree_com_in[worldid, chains.root[number, side]]
                wrench = wp.spatial_vector(wp.cross(arm, pushed), pushed)
                while dof >= 0:
                    more = wp.dot(cdof_in[worldid, dof], wrench)
                    qfrc_passive_out[worldid, dof] = qfrc_passive_out[worldid, dof] + more
                    dof = chains.parent[dof]


@wp.func
def moved(direction: wp.spatial_vector, arm: wp.vec3) -> wp.vec3:
    """Return how a motion about a point moves another one, `arm` from it."""
    return wp.spatial_bottom(direction) + wp.cross(wp.spatial_top(direction), arm)


@wp.func
def share_of(z: float) -> float:
    """1 / (1 - e^-z) - 1 / z, from 1/2 at 0 to 1."""
    if z < SOFT:
        return 0.5 + z / 12.0
    return 1.0 / (1.0 - wp.exp(-z)) - 1.0 / z


@wp.kernel(enable_backward=False)
def damp_bodies(
    # Params:
    chains: Chains,
    inertia: InertiaRows,
    timestep: wp.array[float],
    # Data in:
    subtree_com_in: wp.array2d[wp.vec3],
    # In:
    directions: wp.array2d[wp.spatial_vector],
    pushes: Pushes,
    # Data out:
    M_out: wp.array2d[float],
):
    """M += h J' (S drag (1 - n n') + S damping n n') J of both bodies of each contact."""
    worldid = wp.tid()
    h = timestep[batched(worldid, timestep.shape[0])]
    for number in range(pushes.force.shape[1]):
        if wp.length_sq(pushes.force[worldid, number]) > 0.0:
            normal, light = pushes.normal[worldid, number], h * chains.lightness[number]
            drag = pushes.drag[worldid, number] * share_of(light * pushes.drag[worldid, number])
            damping = pushes.damping[worldid, number] * share_of(light * pushes.damping[worldid, number])
            stiffer = damping - drag
            for side in range(2):
                dof = int(chains.last[number, side])
                arm = pushes.location[worldid, number] - subtree_com_in[worldid, chains.root[number, side]]
                while dof >= 0:
                    own = moved(directions[worldid, dof], arm)
                    slowed = h * (drag * own + stiffer * wp.dot(normal, own) * normal)
                    first = inertia.M_rowadr[dof]
                    for k in range(first, first + inertia.M_rownnz[dof]):
                        other = moved(directions[worldid, inertia.M_colind[k]], arm)
                        M_out[worldid, k] = M_out[worldid, k] + wp.dot(slowed, other)
                    dof = chains.parent[dof]


class OwnContacts:
    """Contact of a model, in all worlds, and its springs and dampers.

    Attributes:
        said: What the model's text says.
        pushes: What contacts did in the last step.
    """

    def __init__(self, said: DocumentContacts, host: mujoco.MjModel, data: mjw.Data, forces: Forces | None):
        """Write tables on the current Warp device."""
        self.said, self.forces = said, forces
        self.contacts = contact_table(said.pairs, lambda name: int(host.body(name).id))
        bodies = np.array([[host.body(s.body).id for s in (pair.first, pair.second)] for pair in said.pairs])
        movers = host.body_weldid[bodies]
        last = host.body_dofadr[movers] + host.body_dofnum[movers] - 1
        self.chains = struct_of(
            Chains,
            last=np.maximum(last, -1),
            root=host.body_rootid[bodies],
            parent=host.dof_parentid,
            lightness=host.body_invweight0[bodies, 0].sum(axis=1),
        )
        self.pushes = zeros_of(Pushes, (data.nworld, len(bodies)))

    def launch_damping(self, model: mjw.Model, data: mjw.Data) -> None:
        """Write the damping of limits of coordinates."""
        if self.forces is not None:
            self.forces.launch_damping(model, data)

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Add what springs, dampers and contacts do to `qfrc_passive`."""
        if self.forces is not None:
            self.forces.launch(model, data)
        launch(touch_surfaces, self.pushes.force.shape, self, data)
        launch(push_touching_bodies, data.nworld, self, data)

    def launch_implicit(self, model: mjw.Model, data: mjw.Data, directions: wp.array) -> None:
        """Add h J' D J to `M`; see `Forces`."""
        inertia = filled(InertiaRows, model)
        launch(damp_bodies, data.nworld, self, model.opt, data, inertia=inertia, directions=directions)


def acting_on(host: mujoco.MjModel, model: mjw.Model, data: mjw.Data) -> Forces | None:
    """Return the forces and contacts that a model brings along, on the current Warp device; None: none."""
    forces, said = forces_of(host, model, data), DocumentContacts.of(host)
    return forces if said is None or not said.pairs else OwnContacts(said, host, data, forces)
