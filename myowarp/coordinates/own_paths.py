"""Muscle paths that a model brings along: OpenSim's own, in place of MuJoCo's tendons of the same names.

What a model's text says (`osim.bundle.paths`) is followed by `laws.paths.path`, in float64 from the
engine's poses. Lengths and moment arms of its tendons are then

    J_j = sum over bodies b that dof j moves of cdof_j . (torque_b - com x force_b, force_b),

force_b and torque_b being what the path does to the bodies at unit tension, about the origin, and com the
centre of mass that `cdof_j` refers to; moving points add d length / d place times d place / d joint. All the
rest of the step sees no difference. Tendons that the text does not name, of sites or of joints, are followed
as MuJoCo does.
"""

import dataclasses

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.kernels.batching import batched, num_threads
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_of
from myowarp.laws.paths.path import Frames, Pulls
from myowarp.laws.paths.tables import OsimPath, OsimPaths, PathMemory, Via
from myowarp.laws.pieces import PieceTables, evaluated, piece_tables
from myowarp.osim.bundle.paths import WRAP_SITE, DocumentPaths, is_of


@wp.struct
class Group:
    """Dofs that move the same bodies of a path.

    Attributes:
        first_handle: Of these bodies, in `RowTables.handles`.
        last_handle: The one after the last.
        first_entry: Of the dofs, in `RowTables.entries`.
        last_entry: The one after the last.
    """

    first_handle: int
    last_handle: int
    first_entry: int
    last_entry: int


@wp.struct
class Entry:
    """A dof, the root body whose centre of mass its `cdof` refers to, and its address in `ten_J`."""

    dof: int
    root: int
    address: int


@wp.struct
class MovingEntry:
    """A value that moves a point along an axis, and the address of its joint's dof in `ten_J`."""

    moving: int
    axis: int
    value: int
    dof: int
    address: int


@wp.struct
class VariableEntry:
    """A variable of a length that is a polynomial, its value, and the address of its dof in `ten_J`."""

    variable: int
    value: int
    address: int


@wp.struct
class Row:
    """A tendon: its path, -1 where it is a sum of joints, and spans of the tables."""

    path: int
    first_group: int
    last_group: int
    first_moving: int
    last_moving: int
    first_joint: int
    last_joint: int
    first_variable: int
    last_variable: int
    first: int
    last: int


@wp.struct
class JointEntry:
    """A joint of a tendon that is a sum of them."""

    address: int
    place: int
    coefficient: float


@wp.struct
class RowTables:
    """Tables from forces of paths on bodies to `ten_J`."""

    rows: wp.array[Row]
    groups: wp.array[Group]
    handles: wp.array[int]
    entries: wp.array[Entry]
    moving: wp.array[MovingEntry]
    joints: wp.array[JointEntry]
    variables: wp.array[VariableEntry]


@wp.kernel(enable_backward=False)
def place_bodies(
    # Params:
    bodies: wp.array[int],
    address: wp.array[int],
    values: PieceTables,
    # Data in:
    qpos_in: wp.array2d[float],
    xpos_in: wp.array2d[wp.vec3],
    xmat_in: wp.array2d[wp.mat33],
    # Out:
    frames: Frames,
    slopes: wp.array2d[wp.float64],
):
    """Frames of the paths' bodies in float64; values and slopes of what their points depend on."""
    worldid = wp.tid()
    for i in range(bodies.shape[0]):
        frames.origin[worldid, i] = wp.vec3d(xpos_in[worldid, bodies[i]])
        frames.rotation[worldid, i] = wp.mat33d(xmat_in[worldid, bodies[i]])
    for i in range(address.shape[0]):
        x = wp.float64(0.0)
        if address[i] >= 0:
            x = wp.float64(qpos_in[worldid, address[i]])
        found = evaluated(values, i, x)
        frames.value[worldid, i] = found[0]
        slopes[worldid, i] = found[1]


@wp.kernel(enable_backward=False)
def pull_tendons(
    # Params:
    tables: RowTables,
    threads: int,
    # Data in:
    qpos_in: wp.array2d[float],
    subtree_com_in: wp.array2d[wp.vec3],
    cdof_in: wp.array2d[wp.spatial_vector],
    # In:
    pulls: Pulls,
    slopes: wp.array2d[wp.float64],
    # Data out:
    ten_length_out: wp.array2d[float],
    ten_J_out: wp.array2d[float],
):
    """ten_J = sum of cdof . (torque - com x force, force) + d length / d place slope; or coefficients."""
    worldid, thread = wp.tid()
    for tendonid in range(thread, tables.rows.shape[0], threads):
        row = tables.rows[tendonid]
        for k in range(row.first, row.last):
            ten_J_out[worldid, k] = 0.0
        if row.path >= 0:
            ten_length_out[worldid, tendonid] = float(pulls.length[worldid, row.path])
        else:
            length = float(0.0)
            for i in range(row.first_joint, row.last_joint):
                joint = tables.joints[i]
                length += joint.coefficient * qpos_in[worldid, joint.place]
                ten_J_out[worldid, joint.address] = joint.coefficient
            ten_length_out[worldid, tendonid] = length
        for g in range(row.first_group, row.last_group):
            group = tables.groups[g]
            force, torque = wp.vec3d(), wp.vec3d()
            for h in range(group.first_handle, group.last_handle):
                force += pulls.force[worldid, tables.handles[h]]
                torque += pulls.torque[worldid, tables.handles[h]]
            for e in range(group.first_entry, group.last_entry):
                entry = tables.entries[e]
                about = torque - wp.cross(wp.vec3d(subtree_com_in[worldid, entry.root]), force)
                cdof = cdof_in[worldid, entry.dof]
                moment = wp.dot(wp.vec3d(wp.spatial_top(cdof)), about)
                moment += wp.dot(wp.vec3d(wp.spatial_bottom(cdof)), force)
                ten_J_out[worldid, entry.address] = float(moment)
        for m in range(row.first_moving, row.last_moving):
            shown = tables.moving[m]
            more = pulls.along[worldid, shown.moving][shown.axis] * slopes[worldid, shown.value]
            ten_J_out[worldid, shown.address] = ten_J_out[worldid, shown.address] + float(more)
        for v in range(row.first_variable, row.last_variable):
            of = tables.variables[v]
            slope = pulls.by_variable[worldid, of.variable] * slopes[worldid, of.value]
            ten_J_out[worldid, of.address] = ten_J_out[worldid, of.address] + float(slope)


@wp.kernel(enable_backward=False)
def add_inner_speeds(
    # Model:
    actuator_gear: wp.array2d[wp.spatial_vector],
    # Params:
    tables: RowTables,
    drives: wp.array[int],
    # Data in:
    qvel_in: wp.array2d[float],
    cdof_in: wp.array2d[wp.spatial_vector],
    # In:
    pulls: Pulls,
    slopes: wp.array2d[wp.float64],
    # Data out:
    ten_velocity_out: wp.array2d[float],
    actuator_velocity_out: wp.array2d[float],
):
    """Speed += d length / d place slope qvel + twist . w: what OpenSim sees within bodies."""
    worldid = wp.tid()
    gears = actuator_gear[batched(worldid, actuator_gear.shape[0])]
    for tendon in range(tables.rows.shape[0]):
        row, speed = tables.rows[tendon], wp.float64(0.0)
        for m in range(row.first_moving, row.last_moving):
            entry = tables.moving[m]
            rate = slopes[worldid, entry.value] * wp.float64(qvel_in[worldid, entry.dof])
            speed += pulls.within[worldid, entry.moving][entry.axis] * rate
        for g in range(row.first_group, row.last_group):
            group, twist = tables.groups[g], wp.vec3d()
            for h in range(group.first_handle, group.last_handle):
                twist += pulls.twist[worldid, tables.handles[h]]
            if wp.length_sq(twist) > wp.float64(0.0):
                for e in range(group.first_entry, group.last_entry):
                    dof = tables.entries[e].dof
                    turn = wp.float64(qvel_in[worldid, dof]) * wp.vec3d(wp.spatial_top(cdof_in[worldid, dof]))
                    speed += wp.dot(twist, turn)
        if speed != wp.float64(0.0):
            ten_velocity_out[worldid, tendon] = ten_velocity_out[worldid, tendon] + float(speed)
            for actuator in range(drives.shape[0]):
                if drives[actuator] == tendon:
                    more = gears[actuator][0] * float(speed)
                    actuator_velocity_out[worldid, actuator] = actuator_velocity_out[worldid, actuator] + more


class OwnPaths:
    """The paths of a model, in all worlds.

    Attributes:
        said: What the model's text says.
        names: Of the tendons that are no sums of joints.
        memory: The paths; `memory.pulls.jumps` counts what its guard refused in the last step.
    """

    def __init__(self, said: DocumentPaths, host: mujoco.MjModel, model: mjw.Model, data: mjw.Data) -> None:
        """Write tables on the current Warp device, and give `ten_J` and moments of actuators their rows."""
        self.said = said
        names = [host.tendon(tendon).name for tendon in range(host.ntendon)]
        described = dataclasses.replace(said.paths, paths=dict(said.paths.paths))
        for tendon, name in enumerate(names):
            if name not in described.paths and is_of(host, tendon, WRAP_SITE):
                described.paths[name] = _of_sites(host, tendon)  # type: ignore[index]
        self.names = tuple(described.paths)
        self.memory = PathMemory(described, data.nworld, len(said.values), said.guard, said.exact)
        self.bodies = wp.array([host.body(name).id for name in described.bodies], dtype=int)
        address = [-1 if of is None else host.joint(of).qposadr[0] for of, _ in said.values]
        self.address = wp.array(address, dtype=int)
        self.values = piece_tables(chain for _, chain in said.values)
        self.slopes = wp.zeros_like(self.memory.frames.value)
        self.drives = None
        if any(_moves_within(path) or len(path.wraps) > 1 for path in described.paths.values()):
            on_tendon = host.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
            self.drives = wp.array(np.where(on_tendon, host.actuator_trnid[:, 0], -1), dtype=int)
        self._place(host, model, data, described)

    def _place(self, host: mujoco.MjModel, model: mjw.Model, data: mjw.Data, described: OsimPaths) -> None:
        """Write the rows, and make room for them."""
        of_path, joint_dof = {name: k for k, name in enumerate(described.paths)}, host.jnt_dofadr
        rows, groups, handles, entries, moving, joints, variables = ([] for _ in range(7))  # type: ignore[var-annotated]
        columns: list[int] = []
        begins: list[int] = []
        for tendon in range(host.ntendon):
            path, first = of_path.get(host.tendon(tendon).name, -1), len(columns)
            begins.append(first)
            spans = [len(groups), len(moving), len(joints), len(variables)]
            if path < 0:
                at = slice(host.tendon_adr[tendon], host.tendon_adr[tendon] + host.tendon_num[tendon])
                tied = sorted(zip(host.wrap_objid[at].tolist(), host.wrap_prm[at].tolist(), strict=True))
                columns += [int(joint_dof[joint]) for joint, _ in tied]
                joints += [
                    (first + k, host.jnt_qposadr[joint], share) for k, (joint, share) in enumerate(tied)
                ]
            else:
                one = list(described.paths.values())[path]
                sets = _moved(
                    host, [host.body(name).id for name in described.handles(one)], len(one.wraps) > 1
                )
                driven = {
                    value: int(joint_dof[host.joint(of).id])
                    for value, (of, _) in enumerate(self.said.values)
                    if of is not None
                }
                shown = [
                    (number, axis, value, driven[value])
                    for number in self.memory.path_moving[path]
                    for axis, value in enumerate(self.memory.moving[number])
                    if value in driven
                ]
                of_length = [
                    (variable, value)
                    for variable, value in self.memory.path_variables[path].items()
                    if value in driven
                ]
                dofs = sorted(
                    {dof for _, several in sets for dof in several}
                    | {dof for *_, dof in shown}
                    | {driven[value] for _, value in of_length}
                )
                place = {dof: first + k for k, dof in enumerate(dofs)}
                for bodies, several in sets:
                    ends = len(handles), len(entries)
                    handles += [self.memory.handles[path] + number for number in bodies]
                    entries += [(d, host.body_rootid[host.dof_bodyid[d]], place[d]) for d in several]
                    groups.append((ends[0], len(handles), ends[1], len(entries)))
                moving += [(*entry, place[entry[-1]]) for entry in shown]
                variables += [(variable, value, place[driven[value]]) for variable, value in of_length]
                columns += dofs
            after = [len(groups), len(moving), len(joints), len(variables)]
            pairs = [number for pair in zip(spans, after, strict=True) for number in pair]
            rows.append((path, *pairs, first, len(columns)))
        self.rows = struct_of(
            RowTables,
            rows=rows,
            groups=groups,
            handles=handles,
            entries=entries,
            moving=moving,
            joints=joints,
            variables=variables,
        )
        sizes = np.diff([*begins, len(columns)])
        model.ten_J_rownnz, model.ten_J_rowadr = wp.array(sizes, dtype=int), wp.array(begins, dtype=int)
        model.ten_J_colind, model.max_ten_J_rownnz = wp.array(columns, dtype=int), int(sizes.max(initial=0))
        data.ten_J = wp.zeros((data.nworld, max(len(columns), 1)), dtype=float)
        room = data.actuator_moment.shape[1] + _added(host, sizes)
        data.actuator_moment = wp.zeros((data.nworld, room), dtype=float)
        data.moment_colind = wp.zeros((data.nworld, room), dtype=int)

    def points(self, world: int) -> dict[str, np.ndarray]:
        """Return the points of the tendons as last followed in a world, by name; see `PathMemory.points`."""
        return dict(zip(self.names, self.memory.points(world), strict=True))

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Write lengths and Jacobian of all tendons; poses, `cdof` and `subtree_com` are those of qpos."""
        launch(place_bodies, data.nworld, self, self.memory, data)
        self.memory.launch()
        threads = num_threads(data.qpos.device, self.rows.rows.shape[0])
        shape, own = (data.nworld, threads), {"tables": self.rows, "threads": threads}
        launch(pull_tendons, shape, self, self.memory, data, **own)

    def launch_velocity(self, model: mjw.Model, data: mjw.Data) -> None:
        """Add to speeds of tendons and actuators what is not J qvel."""
        if self.drives is not None:
            launch(add_inner_speeds, data.nworld, self, self.memory, model, data, tables=self.rows)


def paths_of(host: mujoco.MjModel, model: mjw.Model, data: mjw.Data) -> OwnPaths | None:
    """Return the paths that a model brings along, on the current Warp device; None: it brings none."""
    said = DocumentPaths.of(host)
    return None if said is None else OwnPaths(said, host, model, data)


def _moves_within(path: OsimPath) -> bool:
    """Whether a point of a path moves in a body that another point is in."""
    bodies = [point.body for point in path.points]
    return any(point.rotation is not None and bodies.count(point.body) > 1 for point in path.points)


def _of_sites(host: mujoco.MjModel, tendon: int) -> OsimPath:
    """Return a tendon of sites as a path."""
    first = host.tendon_adr[tendon]
    sites = host.wrap_objid[first : first + host.tendon_num[tendon]]
    bodies = [host.body(body).name for body in host.site_bodyid[sites]]
    return OsimPath(tuple(map(Via, bodies, map(tuple, host.site_pos[sites].tolist()))))


def _moved(host: mujoco.MjModel, bodies: list[int], common: bool) -> list[tuple[list[int], list[int]]]:
    """Return which of some bodies the same dofs move, and these dofs.

    Args:
        host: The model.
        bodies: Ids of the bodies of a path.
        common: Whether to keep dofs that move all of them. These feel nothing of a path in balance; where
            OpenSim iterates over several wraps it remembers old points, and the path is not.
    """
    sets: dict[tuple[int, ...], list[int]] = {}
    for dof in range(host.nv):
        moved = []
        for number, body in enumerate(bodies):
            while body and body != host.dof_bodyid[dof]:
                body = host.body_parentid[body]
            if body:
                moved.append(number)
        if moved and (common or len(moved) < len(bodies)):
            sets.setdefault(tuple(moved), []).append(dof)
    return [(list(moved), dofs) for moved, dofs in sets.items()]


def _added(host: mujoco.MjModel, sizes: np.ndarray) -> int:
    """Return how many entries actuators on tendons have more than in the compiled model, at most."""
    pulled = host.actuator_trnid[host.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON, 0]
    return int(np.maximum(sizes - host.ten_J_rownnz, 0)[pulled].sum())
