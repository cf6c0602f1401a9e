"""The smallest model that moves exactly like the full one.

Meshes, cameras, lights, sensors, sites that no force acts on, and geoms that can touch nothing go; bodies
that cannot move are fused into their parents. What remains is the same mechanism: forces and accelerations
agree with the full model to rounding (tests/engine/test_slim.py), in a third of the memory.
"""

from collections.abc import Iterable

import mujoco
import numpy as np

_WRAPS_WITH_SIDE_SITE = (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER)
_HOLDING = (mujoco.mjtEq.mjEQ_WELD, mujoco.mjtEq.mjEQ_CONNECT)
_DRIVES_OF_SITES = (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_SLIDERCRANK)


def slim(full: mujoco.MjSpec, keep_sites: Iterable[str]) -> mujoco.MjSpec:
    """Return a slim copy of a spec.

    Args:
        full: The full model; left as it is.
        keep_sites: Names of sites to keep besides those that forces act on.

    Returns:
        A new spec, to be compiled by the caller. If no two of its geoms can collide, contacts are
        disabled in it.

    Raises:
        ValueError: A name of `keep_sites` does not exist.
    """
    spec = full.copy()
    for index, geom in enumerate(spec.geoms):
        geom.name = geom.name or f"geom {index}"
    model = spec.compile()
    names = {model.site(i).name for i in range(model.nsite)}
    if missing := sorted(set(keep_sites) - names):
        raise ValueError(f"site {missing[0]!r} unknown in this body; check the names of the task sites")
    kept = set(keep_sites) | {model.site(i).name for i in _loaded_sites(model)}
    for site in list(spec.sites):
        if site.name not in kept:
            spec.delete(site)
    for element in [*spec.cameras, *spec.lights, *spec.keys, *spec.sensors]:
        spec.delete(element)
    spec.nkey = 0  # a file may ask for empty ones
    colliding = colliding_geoms(model)
    for geom in spec.geoms:
        if geom.id not in colliding:
            geom.contype = 0
            geom.conaffinity = 0
        else:
            # How hard a contact is follows from the weight of its geom's own body, so the body stays one.
            geom.parent.fuse = 0
    for body in _held_bodies(spec, model):  # and how stiff a weld or connect is, from that of what it holds
        for child in body.bodies:
            child.fuse = 0
    if not colliding:
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.compiler.discardvisual = True
    spec.compiler.fusestatic = True
    # Fused into its parent, a static body hands its exclusions on to all of the parent's geoms.
    if colliding and _pair_names(spec.copy().compile()) != _pair_names(model):
        spec.compiler.fusestatic = False
    return spec


def _held_bodies(spec: mujoco.MjSpec, model: mujoco.MjModel) -> Iterable[mujoco.MjsBody]:
    """Yield the bodies that welds and connects hold together, but for the world."""
    of_bodies = np.isin(model.eq_type, _HOLDING) & (model.eq_objtype == mujoco.mjtObj.mjOBJ_BODY)
    for held in {*model.eq_obj1id[of_bodies].tolist(), *model.eq_obj2id[of_bodies].tolist()} - {0}:
        yield spec.body(model.body(held).name)


def _pair_names(model: mujoco.MjModel) -> set[frozenset[str]]:
    """Return the names of the geoms that can collide, pair by pair."""
    return {frozenset(model.geom(i).name for i in pair) for pair in colliding_pairs(model)}


def _loaded_sites(model: mujoco.MjModel) -> set[int]:
    """Return the ids of the sites of tendon paths, side sites of wraps included, actuators and equalities."""
    used = set(model.wrap_objid[model.wrap_type == mujoco.mjtWrap.mjWRAP_SITE].tolist())
    wraps = np.isin(model.wrap_type, _WRAPS_WITH_SIDE_SITE) & (model.wrap_prm >= 0)
    used |= set(model.wrap_prm[wraps].astype(int).tolist())
    used |= set(model.actuator_trnid[np.isin(model.actuator_trntype, _DRIVES_OF_SITES)].flatten().tolist())
    tied = model.eq_objtype == mujoco.mjtObj.mjOBJ_SITE
    used |= {*model.eq_obj1id[tied].tolist(), *model.eq_obj2id[tied].tolist()}
    return used - {-1}


def colliding_pairs(model: mujoco.MjModel) -> set[tuple[int, int]]:
    """Return the pairs of geoms that MuJoCo's filters allow to collide, bounding volumes aside.

    The filters are those of MuJoCo's documentation, *Collision detection, Selection*: contype and
    conaffinity, same or parent body (through welds), excluded body pairs; explicit pairs come on top.
    """
    explicit = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
    pairs = {(min(pair), max(pair)) for pair in explicit}
    weld = model.body_weldid
    excluded = set(model.exclude_signature.tolist())
    filter_parent = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    candidates = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    for i, first in enumerate(candidates):
        for second in candidates[i + 1 :]:
            if not (
                model.geom_contype[first] & model.geom_conaffinity[second]
                or model.geom_contype[second] & model.geom_conaffinity[first]
            ):
                continue
            body1, body2 = sorted((model.geom_bodyid[first], model.geom_bodyid[second]))
            weld1, weld2 = weld[body1], weld[body2]
            parent1, parent2 = (weld[model.body_parentid[w]] for w in (weld1, weld2))
            related = weld1 and weld2 and (weld1 == parent2 or weld2 == parent1)
            if weld1 == weld2 or (filter_parent and related):
                continue
            if (int(body1) << 16) + int(body2) not in excluded:
                pairs.add((int(first), int(second)))
    return pairs


def colliding_geoms(model: mujoco.MjModel) -> set[int]:
    """Return the ids of the geoms that can collide with another geom at all."""
    return {geom for pair in colliding_pairs(model) for geom in pair}
