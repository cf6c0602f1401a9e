"""Right hand that touches: MyoSuite's hand for objects (key turn, object hold, pen, baoding balls).

MyoSuite 3.0.0 simulates objects with an older hand than its pose and reach tasks. myo-sim 0.2.3 does not have
it; these edits of the composed hand give it: every field that moves it agrees to rounding
(tests/oracle/test_oracle_contact.py). Collision, inertia floors and masses decide about contact and
conditioning; the other edits are needed for parity only.
"""

from dataclasses import replace

import mujoco
import warp as wp
from myo_sim.build.compose import apply_inertia_floor

from myowarp.definitions.body import BODIES, CAUTIOUS_STEP
from myowarp.models.bodies.hand import HAND, hand

ROOT_POS = (-0.025203285253, 0.071449974504, 1.392442909705)  # m
ROOT_QUAT = (0.521702295767, 0.469732569517, -0.478718760568, -0.527263099417)  # w, x, y, z

HAND_JOINTS = wp.constant(23)  # those of the objects come after them
INERTIA_FLOOR = 1e-4  # kg m^2, MyoSuite's compiler setting
MASS_FLOOR = 1e-3  # kg

LUNATE_FILLERS = (  # radius, half length [m], position [m], orientation: mass the composed hand lacks
    (0.008, 0.02, (0.0007, 0.0, 0.003), (1.0, 0.0, 0.0, 0.0)),
    (0.007, 0.02, (0.0, -0.01, -0.004), (0.807649, -0.0333177, 0.588355, 0.0207694)),
)
UNTOUCHABLE = ("humerus_coll_r", "radius_coll_r")
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
SOFT = (0.8, 0.8, 0.01, 0.5, 2.0)  # solimp of hand collision geoms


def contact_hand() -> mujoco.MjSpec:
    """Return the hand with 27 collision geoms; joint order and muscles are those of the hand."""
    spec = hand()
    root = spec.body("myoarm_r_root")
    root.pos, root.quat = ROOT_POS, ROOT_QUAT
    lunate = spec.body("lunate_r")
    for radius, half_length, pos, quat in LUNATE_FILLERS:
        filler = lunate.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=(radius, half_length, 0.0))
        filler.pos, filler.quat = pos, quat
        filler.density, filler.contype, filler.conaffinity, filler.group = 1000.0, 0, 0, 4
    radius_bone = spec.body("radius_r")
    radius_bone.pos = (0.0004, -0.011503, 0.019999)
    radius_bone.inertia = (0.000441184070984, 0.000415087788797, 0.0001)
    radius_bone.iquat = (0.770264275598, 0.635590307004, 0.011983263361, 0.050737646562)
    _make_touchable(spec)
    _undo_corrections(spec)
    apply_inertia_floor(spec, INERTIA_FLOOR, MASS_FLOOR)
    return spec


def _make_touchable(spec: mujoco.MjSpec) -> None:
    """Let the hand's collision geoms meet objects and each other."""
    for geom in spec.geoms:
        if geom.name in UNTOUCHABLE:
            geom.contype = geom.conaffinity = 0
        elif geom.contype:
            geom.conaffinity = 1
            geom.solimp = SOFT


def _undo_corrections(spec: mujoco.MjSpec) -> None:
    """Put back what myo-sim 0.2 changed: thumb ranges, one finger axis, three wrapping surfaces."""
    spec.joint("cmc_flexion_r").range = (-0.5, 0.78)
    spec.joint("cmc_abduction_r").range = (-0.78, 0.7)
    spec.joint("md5_flexion_r").axis = (0.643112, -0.226804, 0.731414)
    spec.geom("EDCL_torus_wrap").pos = (-0.0128, -0.0133, 0.0148)
    spec.geom("EDCM_torus_wrap").pos = (-0.0007, -0.0117, 0.0191)
    spec.geom("3rdmcp_ellipsoid_wrap").alt.euler = (2.5794221, -1.44967048, 2.90614774)


def add_object(
    spec: mujoco.MjSpec,
    name: str,
    pos: tuple[float, float, float],
    *,
    mocap: bool = False,
    floored: bool = True,
) -> mujoco.MjsBody:
    """Return a new body in the world, with the floors of the hand or, not `floored`, its true inertia."""
    if floored:
        body = spec.worldbody.add_body(name=name, pos=pos, mocap=mocap)
        body.compiler.boundinertia = INERTIA_FLOOR
        body.compiler.boundmass = MASS_FLOOR
        return body
    # A body keeps the compiler settings of the spec it was made in; those of the hand's are shared.
    own = mujoco.MjSpec().worldbody.add_body(name=name, pos=pos, mocap=mocap)
    body = spec.worldbody.add_frame().attach_body(own, "own_", "")
    body.name = name
    return body


def add_object_joints(
    body: mujoco.MjsBody,
    *,
    free: bool,
    reach: tuple[tuple[float, float], ...] = (),
    damping: float | None = None,
) -> None:
    """Let an object move: by a free joint or, as in MyoSuite, by three slides and three hinges.

    Args:
        body: The object.
        free: Whether by a free joint.
        reach: Ranges of the slides [m]; (): they have none.
        damping: Of slides and hinges [N s/m, N m s/rad]; None: the spec's own.
    """
    if free:
        body.add_joint(name="OBJ", type=mujoco.mjtJoint.mjJNT_FREE)
        return
    for prefix, kind in (("T", mujoco.mjtJoint.mjJNT_SLIDE), ("R", mujoco.mjtJoint.mjJNT_HINGE)):
        for number, (letter, axis) in enumerate(AXES.items()):
            joint = body.add_joint(name=f"OBJ{prefix}{letter}", type=kind, axis=axis)
            if damping is not None:
                joint.damping[0] = damping
            if reach and prefix == "T":
                joint.limited, joint.range = True, reach[number]


PALM_UP = -1.5  # rad, joint 0, the forearm's rotation: an object can lie on the palm
BODIES.add("contact_hand", replace(HAND, build=contact_hand, coarse_step=CAUTIOUS_STEP, title="hand"))
