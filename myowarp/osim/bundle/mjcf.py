"""An MjSpec as MJCF text in full precision.

MuJoCo's own writer keeps six digits and drops some inertials; here every number is written so that it
reads back as the same float64. Only what a conversion contains is written; anything else is refused,
so that nothing is lost silently.
"""

from collections.abc import Iterable, Mapping
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

GEOMS = {
    mujoco.mjtGeom.mjGEOM_PLANE: "plane",
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
}
JOINTS = {mujoco.mjtJoint.mjJNT_HINGE: "hinge", mujoco.mjtJoint.mjJNT_SLIDE: "slide"}
DYNAMICS = {mujoco.mjtDyn.mjDYN_NONE: "none", mujoco.mjtDyn.mjDYN_MUSCLE: "muscle"}
GAINS = {mujoco.mjtGain.mjGAIN_FIXED: "fixed", mujoco.mjtGain.mjGAIN_MUSCLE: "muscle"}
BIASES = {
    mujoco.mjtBias.mjBIAS_NONE: "none",
    mujoco.mjtBias.mjBIAS_AFFINE: "affine",
    mujoco.mjtBias.mjBIAS_MUSCLE: "muscle",
}
TRANSMISSIONS = {
    mujoco.mjtTrn.mjTRN_JOINT: "joint",
    mujoco.mjtTrn.mjTRN_TENDON: "tendon",
    mujoco.mjtTrn.mjTRN_SITE: "site",
}
EQUALITIES = {
    mujoco.mjtEq.mjEQ_JOINT: "joint",
    mujoco.mjtEq.mjEQ_WELD: "weld",
    mujoco.mjtEq.mjEQ_CONNECT: "connect",
}
WRAPS = {
    mujoco.mjtWrap.mjWRAP_SITE: "site",
    mujoco.mjtWrap.mjWRAP_SPHERE: "geom",
    mujoco.mjtWrap.mjWRAP_CYLINDER: "geom",
    mujoco.mjtWrap.mjWRAP_JOINT: "joint",
}
INTEGRATORS = {
    mujoco.mjtIntegrator.mjINT_EULER: "Euler",
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST: "implicitfast",
}
JACOBIANS = {
    mujoco.mjtJacobian.mjJAC_DENSE: "dense",
    mujoco.mjtJacobian.mjJAC_SPARSE: "sparse",
    mujoco.mjtJacobian.mjJAC_AUTO: "auto",
}
IDENTITY = (1.0, 0.0, 0.0, 0.0)


def mjcf(spec: mujoco.MjSpec, comment: str = "") -> str:
    """Return the MJCF of a spec.

    Args:
        spec: Made by this package.
        comment: Written at the top, for credits.

    Raises:
        NotImplementedError: It contains a kind of element that is not written.
    """
    for kind in ("flexes", "hfields", "pairs", "plugins", "skins", "sensors", "tuples", "cameras"):
        if len(getattr(spec, kind)):
            raise NotImplementedError(f"{kind} of an MjSpec are not written; remove them first")
    root = ElementTree.Element("mujoco", model=spec.modelname)
    if comment:
        root.append(ElementTree.Comment(" " + comment.replace("--", "- -").rstrip("-") + " "))
    _add(
        root,
        "compiler",
        angle="radian",
        inertiafromgeom="false",
        autolimits="false",
        meshdir=spec.meshdir or None,
    )
    option = spec.option
    integrator = INTEGRATORS[mujoco.mjtIntegrator(option.integrator)]
    jacobian = _unless(JACOBIANS[mujoco.mjtJacobian(option.jacobian)], "auto")
    _add(
        root,
        "option",
        timestep=option.timestep,
        integrator=integrator,
        jacobian=jacobian,
        gravity=option.gravity,
    )
    if len(spec.texts):
        custom = _add(root, "custom")
        for text in spec.texts:
            _add(custom, "text", name=text.name, data=text.data)
    if len(spec.meshes) or len(spec.materials):
        asset = _add(root, "asset")
        for texture in spec.textures:
            size = {"width": texture.width, "height": texture.height}
            colors = {"rgb1": texture.rgb1, "rgb2": texture.rgb2}
            _add(asset, "texture", name=texture.name, type="2d", builtin="checker", **size, **colors)
        for material in spec.materials:
            texture = material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB]
            _add(asset, "material", name=material.name, texture=texture, texrepeat=material.texrepeat)
        for mesh in spec.meshes:
            _add(asset, "mesh", name=mesh.name, file=mesh.file, scale=mesh.scale, inertia="shell")
    _body_content(_add(root, "worldbody"), spec.worldbody)
    _equalities(root, spec.equalities)
    _tendons(root, spec.tendons)
    _actuators(root, spec.actuators)
    if len(spec.excludes):
        contact = _add(root, "contact")
        for exclude in spec.excludes:
            _add(contact, "exclude", name=exclude.name, body1=exclude.bodyname1, body2=exclude.bodyname2)
    if len(spec.keys):
        frames = _add(root, "keyframe")
        for key in spec.keys:
            _add(frames, "key", name=key.name, qpos=key.qpos, act=key.act, ctrl=key.ctrl)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _text(value: object) -> str | None:
    """Return the text of an attribute, None for one that is left out."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    numbers = np.atleast_1d(np.asarray(value))
    if not len(numbers):
        return None
    # float32 colours read back the same from their short form.
    return " ".join(
        np.format_float_positional(n, trim="-") if n.dtype == np.float32 else repr(float(n)) for n in numbers
    )


def _add(parent: ElementTree.Element, tag: str, **attributes: object) -> ElementTree.Element:
    """Add an element; attributes that are None or empty arrays are left out."""
    texts = {name: _text(value) for name, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, {n: text for n, text in texts.items() if text is not None})


def _unless(value: Any, default: Any) -> Any:
    """Return a value, None if it is the default."""
    return None if np.array_equal(value, default) else value


def _body_content(element: ElementTree.Element, body: mujoco.MjsBody) -> None:
    """Write joints, geoms, sites and bodies of a body."""
    for joint in body.joints:
        _joint(element, joint)
    for geom in body.geoms:
        _geom(element, geom)
    for site in body.sites:
        quat = _unless(site.quat, IDENTITY)
        group = int(site.group)
        _add(
            element,
            "site",
            name=site.name,
            pos=site.pos,
            quat=quat,
            size=site.size,
            group=group,
            rgba=site.rgba,
        )
    for light in body.lights:
        _add(element, "light", name=light.name, pos=light.pos, dir=light.dir)
    for child in body.bodies:
        quat, gravcomp = _unless(child.quat, IDENTITY), _unless(child.gravcomp, 0.0)
        inner = _add(element, "body", name=child.name, pos=child.pos, quat=quat, gravcomp=gravcomp)
        if child.explicitinertial:
            _add(
                inner,
                "inertial",
                pos=child.ipos,
                quat=child.iquat,
                mass=child.mass,
                diaginertia=child.inertia,
            )
        _body_content(inner, child)


def _joint(element: ElementTree.Element, joint: mujoco.MjsJoint) -> None:
    """Write a joint."""
    limited = joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE
    _add(
        element,
        "joint",
        name=joint.name,
        type=JOINTS[joint.type],
        pos=joint.pos,
        axis=joint.axis,
        limited=limited,
        range=_unless(joint.range, (0.0, 0.0)),
        ref=_unless(joint.ref, 0.0),
        armature=_unless(joint.armature, 0.0),
        damping=_unless(joint.damping[0], 0.0),
        stiffness=_unless(joint.stiffness[0], 0.0),
        springref=_unless(joint.springref, 0.0),
    )


def _geom(element: ElementTree.Element, geom: mujoco.MjsGeom) -> None:
    """Write a geom."""
    mesh = geom.type == mujoco.mjtGeom.mjGEOM_MESH
    _add(
        element,
        "geom",
        name=geom.name,
        type=GEOMS[geom.type],
        pos=geom.pos,
        quat=_unless(geom.quat, IDENTITY),
        size=None if mesh else geom.size,
        mesh=geom.meshname if mesh else None,
        material=geom.material or None,
        mass=0.0,
        contype=int(geom.contype),
        conaffinity=int(geom.conaffinity),
        group=int(geom.group),
        rgba=None if geom.material else geom.rgba,
    )


def _equalities(root: ElementTree.Element, equalities: Iterable[mujoco.MjsEquality]) -> None:
    """Write equality constraints."""
    group = _add(root, "equality")
    for item in equalities:
        kind, data = EQUALITIES[item.type], np.asarray(item.data)
        ends: Mapping[str, object]
        if kind == "joint":
            ends = {"joint1": item.name1, "joint2": item.name2, "polycoef": data[:5]}
        elif item.objtype != mujoco.mjtObj.mjOBJ_SITE:
            raise NotImplementedError(f"equality {item.name!r} is between bodies; only sites are written")
        else:
            ends = {"site1": item.name1, "site2": item.name2}
        _add(group, kind, name=item.name, **ends, solref=item.solref, solimp=item.solimp)


def _tendons(root: ElementTree.Element, tendons: Iterable[mujoco.MjsTendon]) -> None:
    """Write tendons with their paths."""
    group = _add(root, "tendon")
    for tendon in tendons:
        path = list(tendon.path)
        fixed = path[0].type == mujoco.mjtWrap.mjWRAP_JOINT
        sprung = np.any(tendon.stiffness)
        limited = tendon.limited == mujoco.mjtLimited.mjLIMITED_TRUE
        element = _add(
            group,
            "fixed" if fixed else "spatial",
            name=tendon.name,
            stiffness=tendon.stiffness if sprung else None,
            springlength=tendon.springlength if sprung else None,
            damping=tendon.damping if np.any(tendon.damping) else None,
            limited=limited,
            range=tendon.range if limited else None,
            width=None if fixed else tendon.width,
            rgba=None if fixed else tendon.rgba,
        )
        for wrap in path:
            kind = WRAPS[wrap.type]
            side = wrap.sidesite.name if kind == "geom" and wrap.sidesite is not None else None
            coefficient = wrap.coef if kind == "joint" else None
            _add(element, kind, **{kind: wrap.target.name}, sidesite=side, coef=coefficient)


def _actuators(root: ElementTree.Element, actuators: Iterable[mujoco.MjsActuator]) -> None:
    """Write actuators."""
    group = _add(root, "actuator")
    for actuator in actuators:
        muscle = actuator.dyntype == mujoco.mjtDyn.mjDYN_MUSCLE
        limited = actuator.ctrllimited == mujoco.mjtLimited.mjLIMITED_TRUE
        clipped = actuator.forcelimited == mujoco.mjtLimited.mjLIMITED_TRUE
        _add(
            group,
            "general",
            name=actuator.name,
            **{TRANSMISSIONS[actuator.trntype]: actuator.target},
            refsite=actuator.refsite or None,
            gear=actuator.gear,
            dyntype=DYNAMICS[actuator.dyntype],
            gaintype=GAINS[actuator.gaintype],
            biastype=BIASES[actuator.biastype],
            dynprm=actuator.dynprm if muscle else None,
            gainprm=actuator.gainprm,
            biasprm=actuator.biasprm,
            lengthrange=_unless(actuator.lengthrange, (0.0, 0.0)),
            ctrllimited=limited,
            ctrlrange=actuator.ctrlrange if limited else None,
            forcelimited=clipped,
            forcerange=actuator.forcerange if clipped else None,
        )
