"""Facts of the compiled models of the contact families, to be compared by name."""

import mujoco
import numpy as np

COUNTS = "nq nv nu na nbody njnt ngeom nsite ntendon nwrap nexclude npair neq"
FIELDS = {
    "body": "pos quat mass inertia ipos iquat parentid weldid invweight0",
    "jnt": "type range limited axis pos stiffness solref solimp margin bodyid qposadr dofadr",
    "dof": "damping armature frictionloss solref solimp invweight0 M0 bodyid",
    "geom": """type size pos quat contype conaffinity condim friction solimp solref solmix margin
        gap priority group rbound bodyid""",
    "site": "pos quat size bodyid",
    "actuator": """gainprm biasprm dynprm gear ctrlrange ctrllimited forcelimited lengthrange acc0
        trntype trnid dyntype gaintype biastype""",
    "tendon": """adr num range limited stiffness damping frictionloss lengthspring length0 margin
        invweight0""",
    "wrap": "type objid prm",
    "exclude": "signature",
}
OPTIONS = """timestep gravity integrator cone solver jacobian iterations ls_iterations tolerance
    ls_tolerance impratio disableflags enableflags noslip_iterations ccd_iterations ccd_tolerance
    density viscosity wind o_margin"""
# What the episodes of the Random ids change in the model, of the bodies of the objects.
BODY_CHANGES = "mass inertia ipos iquat pos quat invweight0"
GEOM_CHANGES = "type size pos quat rbound aabb friction"
DOF_CHANGES = "M0 invweight0"


def model_arrays(model):
    """Fields of the model, `model_<kind>_<field>`."""
    arrays = {f"model_{k}": np.array(getattr(model, k)) for k in ("qpos0", *COUNTS.split())}
    for kind, fields in FIELDS.items():
        names = [f"{kind}_{field}" for field in fields.split()]
        arrays |= {f"model_{name}": np.array(getattr(model, name)) for name in names}
    signature = arrays.pop("model_exclude_signature")
    arrays["model_exclude_bodies"] = np.stack([signature >> 16, signature & 0xFFFF], axis=1)
    arrays["model_geom_collides"] = (model.geom_contype | model.geom_conaffinity) != 0
    return arrays


def model_meta(model):
    """Names in the order of the model's arrays and the solver options."""
    options = {name: np.asarray(getattr(model.opt, name)).tolist() for name in OPTIONS.split()}
    stat = {name: np.asarray(getattr(model.stat, name)).tolist() for name in ("meaninertia", "extent")}
    return {
        "geoms": [model.geom(i).name for i in range(model.ngeom)],
        "sites": [model.site(i).name for i in range(model.nsite)],
        "options": options,
        "stat": stat,
    }


def object_geoms(model, objects):
    """Ids of the collision geoms of the bodies."""
    bodies = [model.body(name).id for name in objects]
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    return np.flatnonzero(np.isin(model.geom_bodyid, bodies) & collides)


def object_fields(model, objects):
    """Fields of the object bodies, their collision geoms and their dofs as they are now."""
    bodies = [model.body(name).id for name in objects]
    changes = {
        "body": (bodies, BODY_CHANGES),
        "geom": (object_geoms(model, objects), GEOM_CHANGES),
        "dof": (np.isin(model.dof_bodyid, bodies), DOF_CHANGES),
    }
    fields = [(f"{kind}_{k}", ids) for kind, (ids, names) in changes.items() for k in names.split()]
    return {name: getattr(model, name)[ids] for name, ids in fields}


def contact_counts(model, qpos, shifts):
    """Number of contacts of a pose with the collision margins shifted [m]; the data of the last."""
    counts, data, margin = [], mujoco.MjData(model), model.geom_margin.copy()
    for shift in shifts:
        model.geom_margin[:] = margin + shift
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        counts.append(data.ncon)
    model.geom_margin[:] = margin
    return counts, data
