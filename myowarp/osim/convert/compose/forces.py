"""Forces beside muscles and motors in terms of the converted model: the sidecar `forces.json`."""

from myowarp.laws.paths.tables import Rows, Vector
from myowarp.osim.body.described import vector
from myowarp.osim.bundle.forces import (
    BodyBushing,
    BodyPush,
    JointLimit,
    JointPush,
    PassiveForces,
    TendonSpring,
)
from myowarp.osim.convert.compose.geometry import Build
from myowarp.osim.convert.compose.passive import is_of_joint
from myowarp.osim.document.elements import (
    LEAST_TRANSITION,
    Bushing,
    CoordinateLimitForce,
    Ligament,
    Pose,
)
from myowarp.osim.document.functions import curves
from myowarp.osim.document.model import GROUND, Note


def passive_forces(build: Build, has_paths: bool) -> PassiveForces | None:
    """Return what pushes joints back and what ligaments pull, after `tie`; None: nothing does.

    A ligament whose curve is no polynomial is noted; MuJoCo's spring is to stand for it.

    Args:
        build: The build.
        has_paths: Whether ligaments run over the document's paths; else springs are to stand for all.
    """
    model = build.model
    limits = tuple(_limit(build, item) for item in model.limit_forces if item.coordinate in build.carriers)
    ligaments = [_ligament(build, item) for item in model.ligaments.values()] if has_paths else []
    pulling = tuple(ligament for ligament in ligaments if ligament is not None)
    pushes = tuple(
        JointPush(*build.carriers[item.coordinate], item.formula)
        for item in model.coordinate_formulas
        if item.coordinate in build.carriers
    )
    bushings = tuple(_bushing(build, item) for item in model.bushings if not is_of_joint(build, item))
    body_pushes = tuple(
        BodyPush(
            build.bodies[item.body].name,
            build.bodies[GROUND].name,
            *_posed(item.frame),
            item.force_in_ground,
            item.point_in_ground,
            item.formulas,
        )
        for item in model.prescribed_forces
    )
    found = PassiveForces(limits, pulling, pushes=pushes, bushings=bushings, body_pushes=body_pushes)
    return found if found.acts else None


def _posed(frame: Pose) -> tuple[Rows, Vector]:
    """Return axes by rows and origin of a frame."""
    return tuple(vector(row) for row in frame.rotation), vector(frame.position)  # type: ignore[return-value]


def _bushing(build: Build, item: Bushing) -> BodyBushing:
    """Return a bushing with MuJoCo's names of bodies."""
    (first_turn, first), (second_turn, second) = map(_posed, item.frames)
    one, other = (build.bodies[body].name for body in item.bodies)
    return BodyBushing(
        bodies=(one, other),
        rotations=(first_turn, second_turn),
        origins=(first, second),
        turn_stiffness=vector(item.rotational_stiffness),
        shift_stiffness=vector(item.translational_stiffness),
        turn_damping=vector(item.rotational_damping),
        shift_damping=vector(item.translational_damping),
        formulas=item.formulas,
    )


def _limit(build: Build, item: CoordinateLimitForce) -> JointLimit:
    """Return a limit along the joint that shows its coordinate: joint = scale coordinate."""
    joint, scale = build.carriers[item.coordinate]
    way = 1 if scale > 0 else -1
    (low, high), (low_stiffness, high_stiffness) = item.limits[::way], item.stiffness[::way]
    return JointLimit(
        joint,
        scale * low,
        scale * high,
        low_stiffness / scale**2,
        high_stiffness / scale**2,
        item.damping / scale**2,
        abs(scale) * max(item.transition, LEAST_TRANSITION),
    )


def _ligament(build: Build, item: Ligament) -> TendonSpring | None:
    """Return a ligament; None where its curve is no polynomial."""
    chain = curves(item.force)
    if chain is None:
        rule = "its curve is no polynomial; it is the spring of plain MuJoCo"
        build.notes.append(Note(f"/forceset/{item.name}", rule))
        return None
    return TendonSpring(item.name, item.resting_length, item.dissipation, item.damping, chain, item.formula)
