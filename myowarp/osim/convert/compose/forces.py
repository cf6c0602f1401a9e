"""Limits of coordinates and ligaments in terms of the converted model: the sidecar `forces.json`."""

from myowarp.osim.bundle.forces import JointLimit, PassiveForces, TendonSpring
from myowarp.osim.convert.compose.geometry import Build
from myowarp.osim.document.elements import LEAST_TRANSITION, CoordinateLimitForce, Ligament
from myowarp.osim.document.functions import curves
from myowarp.osim.document.model import Note


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
    if not limits and not pulling:
        return None
    return PassiveForces(limits, pulling)


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
    return TendonSpring(item.name, item.resting_length, item.dissipation, item.damping, chain)
