"""Our constraint solver against MuJoCo C, a dense float64 Newton method, and mujoco-warp's solver."""

from types import SimpleNamespace

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from constrained import LIMITED, MORE, NUM_CONTACTS, NUM_ROWS, NUM_WORLDS, model_of, rows_of, states
from mujoco_warp._src import solver
from mujoco_warp._src.types import DisableBit
from often import often
from reference.constraint_newton import acceleration, imbalance, row_forces
from stepping import engine_alone

from myowarp.definitions.task import TASKS
from myowarp.engine.stages.constraint_rows import ConstraintRows, frames_in_solver
from myowarp.engine.stages.contact_solve import ContactSolve
from myowarp.sim.simulation import Simulation

CLOSE = 2e-4  # of a world's largest; float32 rows of D up to 1e5
REFERENCE = 1e-9  # MuJoCo C against the reference, both float64 and exact
BALANCE = 2e-5  # forces that must cancel, float32
ENGINE_MEDIAN, ENGINE_MAX = 1e-6, 2e-5  # two float32 solvers on the same rows
FEW_ITERATIONS = 4.0  # in motion, on average
EFFECT = 10.0
ALL = np.arange(NUM_WORLDS)
CONTACTS = (
    int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS),
    int(mujoco.mjtConstraint.mjCNSTR_CONTACT_PYRAMIDAL),
)


def on_device(name, warmth, worlds=ALL):
    """Return the engine's model and data, to be solved from a share of the right acceleration."""
    data = mjw.put_data(
        model_of(name), states(name)[0], nworld=len(worlds), njmax=NUM_ROWS, nconmax=NUM_CONTACTS
    )
    for (owner, array), values in rows_of(name).items():
        getattr(getattr(data, owner) if owner else data, array).assign(values[worlds])
    data.qacc_warmstart.assign(warmth * qacc_of(name)[worlds])
    for array in (data.qacc, data.qfrc_constraint, data.efc.force, data.efc.Ma):
        array.fill_(np.nan)
    data.efc.state.fill_(-1)
    data.solver_niter.fill_(-1)
    data.overflow.zero_()
    return mjw.put_model(model_of(name)), data


def launch_solve(model, data, in_solver=False):
    """Launch our solver alone; returns whether each world was solved in lanes."""
    stage = ContactSolve(SimpleNamespace(model=model, data=data, device=data.qpos.device))
    stage.solve(model, data, in_solver)
    return stage.memory.solved.numpy()


def qacc_of(name):
    """Return the right accelerations."""
    return np.array([data.qacc for data in states(name)])


def problem(model, data):
    """Return what the reference takes, float64."""
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    J = data.efc_J
    if mujoco.mj_isSparse(model):
        J = np.zeros((data.nefc, model.nv))
        mujoco.mju_sparse2dense(J, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    J = J.reshape(-1, model.nv)
    return M, data.qfrc_smooth, J, data.efc_D, data.efc_aref, data.efc_frictionloss, data.ne, data.nf


def solved(name, warmth, worlds=ALL):
    """Return the solved worlds."""
    engine, data = on_device(name, warmth, worlds)
    launch_solve(engine, data)
    return data


def relative(ours, theirs):
    """Return the error of every world as a share of its largest entry."""
    return np.abs(ours - theirs).max(axis=1) / np.abs(theirs).max(axis=1)


@pytest.mark.parametrize("name", often([*MORE, *LIMITED], ["dense", "sparse", "wide", *LIMITED]))
def test_reference_is_mujoco_c(name):
    model = model_of(name)
    for data in states(name):
        assert np.allclose(acceleration(*problem(model, data)), data.qacc, rtol=REFERENCE, atol=REFERENCE)


@pytest.mark.parametrize("name", often([*MORE], ["dense", "sparse", "wide"]))
def test_every_kind_of_row_pulls(name):
    """Without rows of a kind, or with rows that never change their state, the tests below would be blind."""
    found = states(name)
    kinds = np.concatenate([data.efc_type for data in found])
    state = np.concatenate([data.efc_state for data in found])
    kind, of = mujoco.mjtConstraint, mujoco.mjtConstraintState
    wanted = {
        kind.mjCNSTR_EQUALITY: {of.mjCNSTRSTATE_QUADRATIC},
        kind.mjCNSTR_FRICTION_DOF: {
            of.mjCNSTRSTATE_QUADRATIC,
            of.mjCNSTRSTATE_LINEARNEG,
            of.mjCNSTRSTATE_LINEARPOS,
        },
        kind.mjCNSTR_LIMIT_JOINT: {of.mjCNSTRSTATE_QUADRATIC},
        kind.mjCNSTR_LIMIT_TENDON: {of.mjCNSTRSTATE_QUADRATIC},
        kind.mjCNSTR_CONTACT_PYRAMIDAL: {of.mjCNSTRSTATE_QUADRATIC, of.mjCNSTRSTATE_SATISFIED},
    }
    for row, expected in wanted.items():
        assert {int(s) for s in expected} <= set(state[kinds == row])
    constrained, free = (np.array([getattr(d, f) for d in found]) for f in ("qacc", "qacc_smooth"))
    assert relative(free, constrained).min() > EFFECT * CLOSE


@pytest.mark.parametrize("warmth", [0.0, 0.7, 1.0])
@pytest.mark.parametrize("name", often([*MORE, *LIMITED], ["dense", "sparse", "wide", *LIMITED]))
def test_acceleration_and_forces(name, warmth):
    model, found, data = model_of(name), states(name), solved(name, warmth)
    assert relative(data.qacc.numpy(), qacc_of(name)).max() < CLOSE
    pull = np.array([d.qfrc_constraint for d in found])
    assert relative(data.qfrc_constraint.numpy(), pull).max() < CLOSE
    momentum = np.array([problem(model, d)[0] @ d.qacc for d in found])
    assert relative(data.efc.Ma.numpy()[:, : model.nv], momentum).max() < CLOSE
    assert not data.overflow.numpy().any()
    for i, host in enumerate(found):
        rows = problem(model, host)
        _, _, J, D, aref, loss, ne, nf = rows
        force = row_forces(J @ host.qacc - aref, D, loss, ne, nf)
        ours = data.efc.force.numpy()[i, : host.nefc]
        assert np.abs(ours - force).max() < CLOSE * np.abs(force).max()
        assert np.array_equal(data.efc.state.numpy()[i, : host.nefc], host.efc_state)
        assert imbalance(data.qacc.numpy()[i].astype(float), *rows) < BALANCE
        assert data.solver_niter.numpy()[i] >= 1


@pytest.mark.parametrize("name", often([*MORE], ["dense", "sparse", "wide"]))
def test_contacts_without_a_jacobian(name):
    """Where rows are ours, the solver computes normal and tangents itself: edges are sums of them."""
    turns = set()
    for host in states(name):
        data = mjw.put_data(model_of(name), host, njmax=NUM_ROWS, nconmax=NUM_CONTACTS)
        J, address = data.efc.J.numpy(), data.efc.J_rowadr.numpy()
        rows = np.flatnonzero(np.isin(host.efc_type, CONTACTS))
        if data.efc.J_rownnz.shape[1]:
            J[0, 0, address[0, rows[0]] :] = np.nan
        else:
            J[:, rows] = np.nan
        data.efc.J.assign(J)
        data.qacc_warmstart.zero_()
        launch_solve(mjw.put_model(model_of(name)), data, in_solver=True)
        assert relative(data.qacc.numpy(), host.qacc[None]).max() < CLOSE
        assert relative(data.qfrc_constraint.numpy(), host.qfrc_constraint[None]).max() < CLOSE
        force = data.efc.force.numpy()[0, : host.nefc]
        assert np.abs(force - host.efc_force).max() < CLOSE * np.abs(host.efc_force).max()
        assert np.array_equal(data.efc.state.numpy()[0, : host.nefc], host.efc_state)
        turns |= set(host.contact.dim)
    assert turns >= ({3, 4, 6} if name == "wide" else {1, 3, 4, 6})


def test_who_writes_the_jacobian_of_contacts():
    """Our solver goes without it where it solves our rows, and not where others write rows in between."""
    scenes = [SimpleNamespace(data=on_device("dense", 0.0)[1], device=wp.get_device("cpu")) for _ in range(2)]
    rows, solver, others = ConstraintRows(scenes[0]), *(ContactSolve(scene) for scene in scenes)
    assert frames_in_solver((solver, rows))
    for stages in ((rows,), (solver,), (others, rows)):
        assert not frames_in_solver(stages)


@pytest.mark.parametrize("name", often([*MORE, *LIMITED], ["dense", "sparse", "wide", *LIMITED]))
def test_fewer_iterations_from_the_solution(name):
    warm, cold = (solved(name, warmth).solver_niter.numpy() for warmth in (1.0, 0.0))
    assert warm.max() == 1
    assert 1.5 < cold.mean() < 10


@pytest.mark.parametrize("name", LIMITED)
def test_limits_go_through_lanes(name):
    """Worlds with limits alone: bit for bit the same in a block, in another order, and alone."""
    assert launch_solve(*on_device(name, 0.7)).all()
    assert not launch_solve(*on_device("dense", 0.7)).any()
    order = np.random.default_rng(5).permutation(NUM_WORLDS)
    together, shuffled = solved(name, 0.0), solved(name, 0.0, order)
    alone = [solved(name, 0.0, [world]) for world in ALL]
    assert np.ptp(together.solver_niter.numpy()) > 1
    rows = together.nefc.numpy()
    assert np.ptp(rows) > 1
    for field in ("qacc", "qfrc_constraint", "solver_niter"):
        values = getattr(together, field).numpy()
        np.testing.assert_array_equal(getattr(shuffled, field).numpy(), values[order])
        np.testing.assert_array_equal(np.concatenate([getattr(one, field).numpy() for one in alone]), values)
    for field in ("force", "state"):
        for world, one in enumerate(alone):
            of_world = getattr(together.efc, field).numpy()[world, : rows[world]]
            np.testing.assert_array_equal(getattr(one.efc, field).numpy()[0, : rows[world]], of_world)


def test_without_rows():
    engine, data = on_device("dense", 0.0)
    data.nefc.zero_(), data.ne.zero_(), data.nf.zero_()
    launch_solve(engine, data)
    free = np.array([d.qacc_smooth for d in states("dense")])
    assert relative(data.qacc.numpy(), free).max() < CLOSE
    assert not data.qfrc_constraint.numpy().any()


@pytest.mark.parametrize("name", ["dense", "limits"])
def test_iteration_limit_is_flagged(name):
    engine, data = on_device(name, 0.0)
    engine.opt.iterations = 1
    launch_solve(engine, data)
    unfinished = data.overflow.numpy() == mjw.OverflowType.ITERATIONS
    right = relative(data.qacc.numpy(), qacc_of(name)) < CLOSE
    assert unfinished.any()
    assert np.array_equal(unfinished, ~right)
    assert np.all(data.solver_niter.numpy() == 1)


@pytest.mark.parametrize("name", often([*MORE, *LIMITED], ["dense", "sparse", "wide", *LIMITED]))
def test_a_step_ends_where_the_cost_is_least(name):
    """The first step from zero ends at x, along x: there the slope, x' gradient, is zero."""
    engine, data = on_device(name, 0.0)
    engine.opt.iterations = 1
    launch_solve(engine, data)
    for x, host in zip(data.qacc.numpy().astype(float), states(name), strict=True):
        M, smooth, J, D, aref, loss, ne, nf = problem(model_of(name), host)
        pull = J.T @ row_forces(J @ x - aref, D, loss, ne, nf)
        slopes = x @ M @ x, x @ smooth, x @ pull
        assert abs(slopes[0] - slopes[1] - slopes[2]) < BALANCE * np.abs(slopes).max()


@pytest.mark.parametrize("name", ["dense", "limits"])
def test_tolerance_of_each_world(name):
    engine, data = on_device(name, 0.0)
    tolerance = np.where(np.arange(NUM_WORLDS) % 2, 1e3, 1e-6)
    engine.opt.tolerance = wp.array(tolerance, dtype=float)
    launch_solve(engine, data)
    assert np.all(data.solver_niter.numpy()[1::2] == 1)
    assert np.mean(data.solver_niter.numpy()[::2]) > 1.5


@pytest.mark.parametrize("name", ["dense", "limits"])
def test_a_broken_world_is_seen_and_breaks_no_other(name):
    engine, data = on_device(name, 1.0)
    forces = data.qfrc_smooth.numpy()
    forces[4, 2] = np.nan
    data.qfrc_smooth.assign(forces)
    launch_solve(engine, data)
    qacc = data.qacc.numpy()
    assert np.isnan(qacc[4]).any()
    others = np.arange(NUM_WORLDS) != 4
    assert relative(qacc[others], qacc_of(name)[others]).max() < CLOSE


OBSTACLES = {
    "the device is not the CPU": lambda s: setattr(s, "device", SimpleNamespace(is_cpu=False)),
    "the solver is not Newton's": lambda s: setattr(s.model.opt, "solver", mjw.SolverType.CG),
    "the friction cone is not pyramidal": lambda s: setattr(s.model.opt, "cone", mjw.ConeType.ELLIPTIC),
    "noslip iterations are on": lambda s: setattr(s.model.opt, "noslip_iterations", 1),
    "warm starts are off": lambda s: setattr(s.model.opt, "disableflags", int(DisableBit.WARMSTART)),
    "the solver makes no iterations": lambda s: setattr(s.model.opt, "iterations", 0),
    "nothing moves, or no row has a place": lambda s: setattr(s.data, "njmax", 0),
    "matrices and rows are more than a thread's stack holds": lambda s: setattr(s.model, "nv", 300),
}


@pytest.mark.parametrize("reason", OBSTACLES)
def test_obstacles(reason):
    engine, data = on_device("dense", 0.0)
    scene = SimpleNamespace(model=engine, data=data, device=SimpleNamespace(is_cpu=True))
    assert ContactSolve.obstacle(scene) is None
    OBSTACLES[reason](scene)
    assert ContactSolve.obstacle(scene) == reason


FAMILIES = (
    "myoElbowPose1D6MRandom-v0",
    "myoFingerPoseRandom-v0",
    "myoHandPoseRandom-v0",
    "myoHandKeyTurnRandom-v0",
    "myoHandObjHoldRandom-v0",
    "myoHandPenTwirlRandom-v0",
    "myoChallengeBaodingP1-v1",
)


@pytest.mark.slow
@pytest.mark.parametrize("key", FAMILIES)
def test_engine_agrees_in_random_motion(key):
    """Ours ends where the engine's ends that goes on until nothing changes, where a body meets objects, too.

    At its own tolerance the engine's stops up to 2e-4 before; ours takes another iteration there.
    """
    sim = Simulation(TASKS[key], 50, device="cpu", autoreset="disabled", progress=False, stages=())
    sim.reset(seeds=np.arange(sim.num_worlds))
    model, data, rng = sim.scene.model, sim.scene.data, np.random.default_rng(0)
    own, errors, iterations, rows = model.opt.tolerance.numpy().copy(), [], [], []
    for step in range(60):
        sim.action.assign(rng.uniform(-1, 1, sim.action.shape).astype(np.float32))
        sim.step()
        if step % 15 < 14:
            continue
        results = []
        engine_alone(mjw.forward)(model, data)
        for solve, tolerance in ((launch_solve, own), (solver.solve, 0.0 * own)):
            model.opt.tolerance.assign(tolerance)
            data.qacc.fill_(np.nan)
            solve(model, data)
            results.append((data.qacc.numpy().copy(), data.solver_niter.numpy().copy()))
        model.opt.tolerance.assign(own)
        errors.append(relative(results[0][0], results[1][0]))
        iterations.append(results[0][1])
        rows.append(data.nefc.numpy().copy())
    assert np.median(errors) < ENGINE_MEDIAN
    assert np.max(errors) < ENGINE_MAX
    constrained = np.array(rows) > 0
    assert constrained.any()
    assert 1 <= np.array(iterations)[constrained].mean() < FEW_ITERATIONS
