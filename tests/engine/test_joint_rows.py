"""Constraint rows of joints and tendons, and the places of all rows, against MuJoCo C and the engine."""

from functools import lru_cache
from types import SimpleNamespace

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from constrained import MORE, ROWS
from mujoco_warp._src.types import (
    ContactType,
    DeterminismType,
    DisableBit,
    OverflowType,
)
from stepping import engine_alone, launch_place

from myowarp.engine.stages.constraint_rows import ConstraintRows

WORLDS = 13
CLOSE = 2e-5  # of the largest of its kind, float32 against float64
ROUNDING = 2e-6  # the same operations, compiled in other surroundings
EFFECT = 1e-3
CAPACITY = {"rows": (90, None), "few rows": (11, None), "few entries": (90, 30), "both": (9, 14)}
"""Name: njmax, njmax_nnz; what the states need is more than the small ones."""
POISON = -7
COUNTS = ("ne", "nf", "nl", "nefc", "overflow", "dof_frictionadr")
WRITTEN = ("type", "id", "pos", "margin", "D", "vel", "aref", "frictionloss")
PLACES = ("J_rownnz", "J_rowadr", "J_colind", "jtdaj_adr", "jtdaj_nrow", "jtdaj_nblock", "Jqvel")
PER_WORLD = {
    "dof_frictionloss": WORLDS,
    "dof_solref": 4,
    "dof_solimp": WORLDS,
    "dof_invweight0": 5,
    "qpos0": WORLDS,
    "eq_data": 3,
    "eq_solref": WORLDS,
    "eq_solimp": 4,
    "jnt_range": WORLDS,
    "jnt_margin": 5,
    "jnt_solref": WORLDS,
    "jnt_solimp": 6,
    "tendon_range": 6,
    "tendon_margin": WORLDS,
    "tendon_invweight0": 4,
    "tendon_solref_lim": WORLDS,
    "tendon_solimp_lim": 3,
    "timestep": 5,
}
"""Parameter: number of values; a world has that of its number modulo this."""
EDITS = {
    '<joint name="wrist" axis="0 0 1"/>': '<joint name="wrist" axis="0 0 1" range="-20 20" limited="true" '
    'margin=".3" solreflimit="-300 -5" solimplimit=".8 .95 .4 .3 3"/>',
    '<fixed name="pull"': '<fixed name="pull" margin=".2" solimplimit=".5 .9 .2 .5 1"',
    "</equality>": '<joint joint1="elbow" polycoef=".2"/><joint joint1="twin" joint2="wrist" active="false"/>'
    '<joint joint1="twin" joint2="elbow" polycoef=".1 .7 -.3 .2 .1"/></equality>',
}


@lru_cache
def model_of(name):
    """Return a model with rows of every kind."""
    jacobian, more = MORE[name]
    xml = ROWS.format(jacobian=jacobian, more=more)
    for old, new in EDITS.items():
        assert old in xml
        xml = xml.replace(old, new)
    return mujoco.MjModel.from_xml_string(xml)


@lru_cache
def states(name):
    """Return MuJoCo C's data of random states."""
    model, rng, found = model_of(name), np.random.default_rng(3), []
    for _ in range(WORLDS):
        data = mujoco.MjData(model)
        data.qpos[:4] = rng.uniform(-1.0, 1.0, 4)
        data.qpos[6] -= rng.uniform(0.0, 0.02)
        data.qvel[:] = rng.standard_normal(model.nv)
        mujoco.mj_forward(model, data)
        found.append(data)
    return found


def on_device(name, capacity="rows", per_world=()):
    """Return a scene of the states, one in each world, up to the constraint rows; these are poisoned.

    Two of the contacts get no rows: one is for a sensor, one out of reach.
    """
    host, (njmax, njmax_nnz) = model_of(name), CAPACITY[capacity]
    model = mjw.put_model(host)
    model.opt.warn_overflow = False
    data = mjw.make_data(host, nworld=WORLDS, njmax=njmax, njmax_nnz=njmax_nnz, nconmax=16)
    data.qpos.assign([state.qpos for state in states(name)])
    data.qvel.assign([state.qvel for state in states(name)])
    engine_alone(mjw.fwd_position)(model, data)
    engine_alone(mjw.com_vel)(model, data)
    rng = np.random.default_rng(5)
    for part in per_world:
        owner = model.opt if part == "timestep" else model
        array, number = getattr(owner, part), PER_WORLD[part]
        shares = rng.uniform(0.8, 1.0, number)
        values = [share * array.numpy()[0] + 0.1 * (1.0 - share) for share in shares]
        setattr(owner, part, wp.array(np.array(values), dtype=array.dtype))
    contact = data.contact
    contact.type.assign(np.where(np.arange(data.naconmax) == 1, ContactType.SENSOR, contact.type.numpy()))
    contact.dist.assign(np.where(np.arange(data.naconmax) == 2, 1.0, contact.dist.numpy()))
    for array in arrays(data).values():
        array.fill_(POISON)
    data.overflow.zero_()
    return SimpleNamespace(model=model, data=data, device=wp.get_device("cpu"))


def arrays(data):
    """Return all that the rows are made of."""
    parts = {part: getattr(data.efc, part) for part in (*WRITTEN, *PLACES, "J")}
    return parts | {part: getattr(data, part) for part in COUNTS} | {"address": data.contact.efc_address}


def rows_made(scene, stages=()):
    """Return a copy of all arrays after `make_constraint`."""
    launch_place(scene, "make_constraint", stages)
    found = {part: array.numpy().copy() for part, array in arrays(scene.data).items()}
    if not scene.model.is_sparse:
        found["J"] = found["J"][:, :, : scene.model.nv]
    return found


def full_row(found, world, row, nv):
    """Return a row of J with all columns."""
    if not found["J_rownnz"].shape[1]:
        return found["J"][world, row, :nv]
    full, first = np.zeros(nv), found["J_rowadr"][world, row]
    places = slice(first, first + found["J_rownnz"][world, row])
    full[found["J_colind"][world, 0, places]] = found["J"][world, 0, places]
    return full


@pytest.mark.parametrize("name", MORE)
def test_rows_are_those_of_mujoco_c(name):
    scene, host = on_device(name), model_of(name)
    found = rows_made(scene, [ConstraintRows(scene)])
    kinds, signs = set(), set()
    for world, state in enumerate(states(name)):
        number = state.ne + state.nf + state.nl
        counts = [found[part][world] for part in ("ne", "nf", "nl")]
        assert counts == [state.ne, state.nf, state.nl]
        J = np.zeros((state.nefc, host.nv))
        if mujoco.mj_isSparse(host):
            mujoco.mju_sparse2dense(
                J, state.efc_J, state.efc_J_rownnz, state.efc_J_rowadr, state.efc_J_colind
            )
        else:
            J[:] = state.efc_J.reshape(J.shape)
        ours = np.array([full_row(found, world, row, host.nv) for row in range(number)])
        assert np.abs(ours - J[:number]).max() <= CLOSE * np.abs(J).max()
        for part in WRITTEN:
            theirs = getattr(state, f"efc_{part}")[:number]
            error = np.abs(found[part][world, :number] - theirs)
            assert (error <= CLOSE * np.abs(theirs).max()).all(), part
        kinds |= set(state.efc_type[:number])
        signs |= {
            (kind, J[i].sum() > 0)
            for i, kind in enumerate(state.efc_type[:number])
            if kind == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
        }
    assert len(kinds) == 4  # equality, friction of joints, limits of joints and of tendons
    assert len(signs) == 2  # both ends of a range


def assert_same(ours, stock):
    """Check that two `rows_made` are the same, left-over entries included.

    Rows of contacts have a sum of their own in their stiffness; the engine's scratch `Jqvel` is not ours.
    """
    for part, theirs in stock.items():
        if part == "Jqvel":
            continue
        if part in ("J", "D", "aref", "vel"):
            assert np.abs(ours[part] - theirs).max() <= CLOSE * np.abs(theirs).max(), part
        elif theirs.dtype.kind == "f" and theirs.size:
            np.testing.assert_allclose(ours[part], theirs, rtol=ROUNDING, atol=ROUNDING, err_msg=part)
        else:
            assert np.array_equal(ours[part], theirs), part


@pytest.mark.parametrize("capacity", CAPACITY)
@pytest.mark.parametrize("name", MORE)
def test_rows_and_places_are_those_of_the_engine(name, capacity):
    """Also where rows or entries of a sparse J do not fit, to the entries left over from before."""
    stock = rows_made(on_device(name, capacity))
    scene = on_device(name, capacity)
    assert_same(rows_made(scene, [ConstraintRows(scene)]), stock)
    njmax, njmax_nnz = CAPACITY[capacity]
    assert (stock["nefc"] > njmax).any() == (njmax < 90)
    dropped = (stock["overflow"] & OverflowType.NJMAX_NNZ).any()
    assert dropped == (njmax_nnz is not None and scene.model.is_sparse)


@pytest.mark.parametrize("part", PER_WORLD)
def test_worlds_have_parameters_of_their_own(part):
    scene = on_device("dense", per_world=[part])
    stock, shared = rows_made(on_device("dense", per_world=[part])), rows_made(on_device("dense"))
    assert any(not np.allclose(stock[field], shared[field], rtol=EFFECT, atol=0) for field in ("D", "aref"))
    assert_same(rows_made(scene, [ConstraintRows(scene)]), stock)


OBSTACLES = {
    "the device is not the CPU": lambda s: setattr(s, "device", SimpleNamespace(is_cpu=False)),
    "rows of a kind are off": lambda s: setattr(s.model.opt, "disableflags", int(DisableBit.LIMIT)),
    "the friction cone is not pyramidal": lambda s: setattr(s.model.opt, "cone", mjw.ConeType.ELLIPTIC),
    "rows are sorted": lambda s: setattr(s.model.opt, "deterministic", DeterminismType.CONSTRAINT),
    "there are flexes, adhesion or moving surfaces": lambda s: setattr(s.model, "flg_adhesion", True),
    "an equality is not of joints": lambda s: setattr(s.model, "eq_wld_adr", wp.zeros(1, dtype=int)),
    "a ball joint is limited": lambda s: setattr(s.model, "jnt_limited_ball_adr", wp.zeros(1, dtype=int)),
    "tendons have friction": lambda s: s.model.tendon_frictionloss.fill_(0.1),
}


@pytest.mark.parametrize("reason", OBSTACLES)
def test_obstacles(reason):
    scene = on_device("dense")
    assert ConstraintRows.obstacle(scene) is None
    OBSTACLES[reason](scene)
    assert ConstraintRows.obstacle(scene) == reason
