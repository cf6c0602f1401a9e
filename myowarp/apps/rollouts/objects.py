"""Figures about the objects of a task: inertia, friction, gimbal lock, and overlap with what is around them.

An object is a body that the task added and that can move.
"""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from myowarp.definitions.body import BODIES
from myowarp.definitions.scene import Scene
from myowarp.engine.slim import colliding_pairs
from myowarp.sim.build import full_spec
from myowarp.sim.simulation import Simulation

FREE, BALL, HINGE = (int(getattr(mujoco.mjtJoint, f"mjJNT_{name}")) for name in ("FREE", "BALL", "HINGE"))
SAME_FRICTION = 1e-6  # relative; single precision


@dataclass(frozen=True)
class Objects:
    """Figures about a task's objects; None where a figure has no meaning, for the reason in `why`.

    Attributes:
        names: Names of the objects' bodies.
        inertia_ratio: Largest ratio, over worlds and principal axes, of the model's inertia to that of
            the solid body of its mass and shape; 1 is right.
        friction_effective: Share of drawn friction coefficients (slide, spin and roll of every object in
            every world) that a contact with the body has, too; 1 is right.
        gimbal: Worst condition number, over the visited states, of the map from an object's rotational
            joint rates to its angular velocity; 1 is right, and it has no bound near gimbal lock.
        why: Figure to why it is None.
    """

    names: tuple[str, ...]
    inertia_ratio: float | None
    friction_effective: float | None
    gimbal: float | None
    why: dict[str, str]


@lru_cache
def _own_bodies(body: str) -> frozenset[str]:
    """Return the names of the parts of a body as it is without a task."""
    return frozenset(part.name for part in BODIES[body].build().bodies)


def object_bodies(scene: Scene) -> tuple[int, ...]:
    """Return the ids of the objects' bodies."""
    model, own = scene.oracle, _own_bodies(scene.spec.body)
    return tuple(
        b for b in range(1, model.nbody) if model.body_jntnum[b] > 0 and model.body(b).name not in own
    )


def of_world(scene: Scene, name: str, world: int) -> np.ndarray:
    """Return a field of the stepped model in one world, in the shape of MuJoCo's."""
    field = getattr(scene.model, name).numpy()
    return field[world % len(field)].reshape(getattr(scene.oracle, name).shape)


def host_model(scene: Scene, world: int) -> mujoco.MjModel:
    """Return a copy of the scene's model with what the task has set in one world."""
    model = copy.deepcopy(scene.oracle)
    for name in scene.spec.batched:
        getattr(model, name)[:] = of_world(scene, name, world)
    return model


def place(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, pos: np.ndarray, quat: np.ndarray | None = None
) -> None:
    """Put an object somewhere: by its free joint, else by its frame, in place, with its joints at 0."""
    joint = model.body_jntadr[body]
    if model.jnt_type[joint] == FREE:
        address = model.jnt_qposadr[joint]
        data.qpos[address : address + 3] = pos
        if quat is not None:
            data.qpos[address + 3 : address + 7] = quat
        return
    model.body_pos[body] = pos
    if quat is not None:
        model.body_quat[body] = quat
    data.qpos[model.jnt_qposadr[joint : joint + model.body_jntnum[body]]] = 0.0


def overlaps(model: mujoco.MjModel, data: mujoco.MjData, objects: tuple[int, ...]) -> tuple[float, float]:
    """Return how deep objects are in anything else, and in each other [m], where `data.qpos` puts them."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    touching = np.isin(model.geom_bodyid[data.contact.geom.reshape(-1, 2)], objects).sum(axis=1)
    deep = -data.contact.dist
    return deep[touching == 1].max(initial=0.0), deep[touching == 2].max(initial=0.0)


def solid_inertia(
    body: mujoco.MjsBody,
    sizes: Mapping[str, np.ndarray],
    mass: float,
    places: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
) -> np.ndarray:
    """Return the principal inertia of a solid of the shape of a body's geoms, in ascending order.

    Args:
        body: The body; the densities, or masses, of its geoms say how its mass is distributed.
        sizes: Sizes of geoms by name where they are not those of `body` [m].
        mass: Its mass [kg].
        places: Positions [m] and quaternions of geoms, likewise.

    Returns:
        Moments of inertia [kg m^2], shape (3,).
    """
    spec = mujoco.MjSpec()
    solid = spec.worldbody.add_body()
    for geom in body.geoms:
        part = solid.add_geom(type=geom.type, size=sizes.get(geom.name, geom.size))
        part.pos, part.quat = (places or {}).get(geom.name, (geom.pos, geom.quat))
        part.density, part.mass = geom.density, geom.mass
    model = spec.compile()
    return np.sort(model.body_inertia[1]) * mass / model.body_mass[1]


def inertia_ratio(sim: Simulation) -> float | None:
    """Return `Objects.inertia_ratio` of the worlds as they are; None without objects."""
    scene, ratios = sim.scene, []
    oracle, batched = scene.oracle, scene.spec.batched
    full = full_spec(scene.spec)
    drawn = {"body_mass", "body_inertia", "geom_size"} & set(batched)
    for body in object_bodies(scene):
        shape = full.body(oracle.body(body).name)
        first = oracle.body_geomadr[body]
        geoms = range(first, first + oracle.body_geomnum[body])
        for world in range(sim.num_worlds if drawn else 1):
            sizes, positions, turns = (
                of_world(scene, f"geom_{field}", world) for field in ("size", "pos", "quat")
            )
            mass = float(of_world(scene, "body_mass", world)[body])
            own = {oracle.geom(g).name: sizes[g] for g in geoms}
            places = {oracle.geom(g).name: (positions[g], turns[g]) for g in geoms}
            true = solid_inertia(shape, own, mass, places)
            ratios.append((np.sort(of_world(scene, "body_inertia", world)[body]) / true).max())
    return float(max(ratios)) if ratios else None


def friction_effective(sim: Simulation) -> float | None:
    """Return `Objects.friction_effective` of the worlds as they are; None if no friction is drawn.

    MuJoCo's rule for a contact of two geoms: the friction of the geom of higher priority, the elementwise
    maximum at equal priority.
    """
    scene, objects = sim.scene, object_bodies(sim.scene)
    if "geom_friction" not in scene.spec.batched:
        return None
    model = scene.oracle
    friction, priority = scene.model.geom_friction.numpy(), scene.model.geom_priority.numpy()
    same = []
    for pair in sorted(colliding_pairs(model)):
        mine = [g for g in pair if model.geom_bodyid[g] in objects]
        if len(mine) != 1:
            continue
        (held,), (other,) = mine, set(pair) - set(mine)
        mixed = np.maximum(friction[:, held], friction[:, other])
        if priority[held] != priority[other]:
            mixed = friction[:, held if priority[held] > priority[other] else other]
        same.append(np.isclose(mixed, friction[:, held], rtol=SAME_FRICTION, atol=0.0))
    return float(np.mean(same)) if same else None


class Gimbal:
    """Looks for the state in which an object's rotational joints are closest to gimbal lock.

    Attributes:
        worst: `Objects.gimbal` so far; None: no object has three rotational degrees of freedom.
    """

    def __init__(self, sim: Simulation) -> None:
        """Find the rotational joints of every object."""
        self.sim, model = sim, sim.scene.oracle
        self.worst: float | None = None
        self._hinges: list[np.ndarray] = []
        for body in object_bodies(sim.scene):
            joints = model.body_jntadr[body] + np.arange(model.body_jntnum[body])
            kinds = model.jnt_type[joints]
            if np.isin(kinds, (FREE, BALL)).any():
                self.worst = 1.0  # their rates are the angular velocity
            elif np.count_nonzero(kinds == HINGE) == 3:
                self._hinges.append(joints[kinds == HINGE])

    def look(self) -> None:
        """Take the states as they are."""
        for joints in self._hinges:
            axes = self.sim.scene.data.xaxis.numpy()[:, joints].astype(float)
            axes = axes[np.isfinite(axes).all(axis=(1, 2))]
            if len(axes):
                self.worst = max(self.worst or 1.0, condition_number(axes))


def condition_number(axes: np.ndarray) -> float:
    """Return the largest ratio of extreme singular values of matrices (num, 3, 3), at most 1e9."""
    values = np.linalg.svd(axes, compute_uv=False)
    return float((values[:, 0] / np.maximum(values[:, -1], 1e-9 * values[:, 0])).max())


def measure(sim: Simulation, gimbal: float | None) -> Objects:
    """Return the figures of the worlds as they are.

    Args:
        sim: Simulation that was reset.
        gimbal: What a `Gimbal` found.
    """
    names = tuple(sim.scene.oracle.body(body).name for body in object_bodies(sim.scene))
    figures = {
        "inertia_ratio": inertia_ratio(sim),
        "friction_effective": friction_effective(sim),
        "gimbal": gimbal,
    }
    reasons = {
        "inertia_ratio": "",
        "friction_effective": "no friction is drawn",
        "gimbal": "no object turns about three axes",
    }
    why = {
        name: reasons[name] if names else "the task has no object"
        for name, value in figures.items()
        if value is None
    }
    return Objects(names=names, why=why, **figures)
