"""A muscle with an elastic tendon, from outside of the package, can all that a muscle of ours can.

Its tendon is a spring, its fibers are damped and pull F_max (a exp(-4 (l - 1)^2) + 4 max(l - 1, 0)^2).
"""

import gymnasium as gym
import mujoco
import numpy as np
import pytest
import warp as wp
from converted import OSIM, muscled
from registries import as_before

import myowarp
from myowarp.apps.reports.figures import contraction_curves
from myowarp.apps.rollouts.film import Film, write
from myowarp.definitions.setup import Setup
from myowarp.osim.document.read.model import read_model
from myowarp.view.drawing.muscles import Muscles
from myowarp.view.drawing.style import pose

NAME, STEP = "outside_tendon", 0.002  # s
STIFFNESS, DAMPING = wp.constant(20.0), wp.constant(0.1)
BALANCE = 2e-4  # of the greatest force: float32 lengths of 0.3 m, times the stiffness


@wp.func
def pull(params: myowarp.MujocoMuscleParams, m: int, length: float, fiber: float, act: float) -> wp.vec3:
    """Return the forces of the tendon, active and passive fibers [F_max]; the fiber has no unit."""
    path = (length - params.tendon_slack_length[0, m]) / params.optimal_fiber_length[0, m]
    active, stretch = act * wp.exp(-4.0 * (fiber - 1.0) * (fiber - 1.0)), wp.max(fiber - 1.0, 0.0)
    return wp.vec3(STIFFNESS * wp.max(path - fiber, 0.0), active, 4.0 * stretch * stretch)


@wp.kernel(enable_backward=False)
def contract(
    timestep: wp.array[float],
    params: myowarp.MujocoMuscleParams,
    anatomy: myowarp.Anatomy,
    activation: wp.array2d[float],
    fiber: wp.array2d[float],
    results: myowarp.MuscleResults,
    actuator_biasprm: wp.array2d[myowarp.BiasParams],
):
    """dl/dt = v_max (tendon - active - passive) / (active + damping), linearly implicit."""
    w, m = wp.tid()
    step = timestep[myowarp.batched(w, timestep.shape[0])] * params.max_contraction_velocity[0, m]
    f = pull(params, m, results.length[w, m], fiber[w, m], activation[w, m])
    fiber[w, m] += step * (f[0] - f[1] - f[2]) / (f[1] + DAMPING + step * STIFFNESS)
    results.tension[w, m] = params.max_isometric_force[0, m] * f[0]
    actuator = anatomy.path[myowarp.batched(w, anatomy.path.shape[0]), m]
    actuator_biasprm[w, actuator] = myowarp.affine_bias(results.tension[w, m], 0.0, 0.0)


@wp.kernel(enable_backward=False)
def balance(
    params: myowarp.MujocoMuscleParams,
    activation: wp.array2d[float],
    length: wp.array2d[float],
    mask: wp.array[bool],
    fiber: wp.array2d[float],
):
    """tendon = active + passive; from below, each step leaves half of the error at most."""
    w, m = wp.tid()
    if mask[w]:
        fiber[w, m] = 0.0
        for _ in range(40):
            f = pull(params, m, length[w, m], fiber[w, m], activation[w, m])
            fiber[w, m] += (f[0] - f[1] - f[2]) / (2.0 * STIFFNESS)


class TendonMuscle(myowarp.MujocoMuscle):
    STATE = (*myowarp.MujocoMuscle.STATE, "fiber")
    TAKES_HILL, coarse_step = True, STEP

    def __init__(self, model, num_worlds, parameters=None):
        super().__init__(model, num_worlds, parameters)
        self.fiber = wp.zeros_like(self.activation)

    def launch(self, model, data):
        super().launch(model, data)
        myowarp.launch(contract, self.tension.shape, self, model, model.opt)

    def settle(self, mask):
        myowarp.launch(balance, self.tension.shape, self, mask=mask)

    def sample_state(self, rng):
        return super().sample_state(rng) | {"fiber": rng.uniform(0.8, 1.2, self.fiber.shape)}

    def geometry(self):
        own = super().geometry()
        return own._replace(tendon_length=self.length.numpy() - self.fiber.numpy() * own.optimal_fiber_length)


@pytest.fixture(scope="module", params=["elbow", "arm26"])
def task(request, tmp_path_factory):
    """Register the muscle; yield a task and the model's file, None for the elbow."""
    path = None if request.param == "elbow" else muscled(tmp_path_factory.mktemp("arm"), "arm26")
    with as_before():
        myowarp.MUSCLES.add(NAME, TendonMuscle)
        yield myowarp.from_mjcf(path) if path else myowarp.TASKS["myoElbowPose1D6MRandom-v0"], path


def measured(env):
    """Return forces of tendons on the paths that MuJoCo C finds, and how far resting fibers are off them."""
    scene, data, found = env.sim.scene, mujoco.MjData(env.sim.scene.oracle), []
    own, fiber = scene.muscles.geometry(), scene.muscles.fiber.numpy()
    for qpos in scene.data.qpos.numpy():
        pose(scene.oracle, data, qpos)
        found.append(data.ten_length[scene.oracle.actuator_trnid[scene.muscles.actuator_id, 0]])
    path = (np.array(found) - own.tendon_slack_length) / own.optimal_fiber_length
    force = 20.0 * np.maximum(path - fiber, 0.0)
    return force, np.abs(force - 4.0 * np.maximum(fiber - 1.0, 0.0) ** 2).max(axis=1)


def test_settled_stepped_filmed_plotted_and_restored(task, tmp_path):
    env = gym.make_vec(task[0].env_id, 3, muscle=NAME, device="cpu", progress=False).unwrapped
    pytest.importorskip("viser")
    signals, film = myowarp.Signals(env.sim), Film(env.sim, [0], color="fiber_length")
    env.reset(seed=0)
    assert measured(env)[1].max() < BALANCE
    actions = [env.action_space.sample() for _ in range(10)]
    for action in actions[:5]:
        env.step(action)
    film.add()
    force = measured(env)[0] * env.sim.scene.muscles.geometry().max_isometric_force
    assert signals.muscles.force.numpy() == pytest.approx(force, abs=BALANCE * force.max())
    seen, model = film.frames[0][0], env.sim.full_model
    pose(model, data := mujoco.MjData(model), seen.qpos)
    shown = Muscles(model, 1.0).values("fiber_length", seen.muscles, data)
    assert shown == pytest.approx(env.sim.scene.muscles.fiber.numpy()[0], abs=1e-4)
    write(tmp_path / "film.html", [film])
    env.get_state().save(tmp_path / "state.npz")
    ends = []
    for _ in range(2):
        env.set_state(myowarp.State.load(tmp_path / "state.npz"))
        ends.append([array for action in actions[5:] for array in env.step(action)[:2]])
    assert all(np.array_equal(*pair) for pair in zip(*ends, strict=True))
    env.reset(options={"reset_mask": np.array([True, False, False])})  # it settles, others go on
    assert (gap := measured(env)[1])[0] < BALANCE < 0.1 * gap[1:].max()
    env.reset(options={"qpos": env.sim.scene.oracle.qpos0 + 0.5})
    assert measured(env)[1].max() < BALANCE
    if task[1]:
        stated = [muscle.optimal_fiber_length for muscle in read_model(OSIM / "arm26.osim").muscles.values()]
        assert env.sim.scene.muscles.geometry().optimal_fiber_length[0] == pytest.approx(stated, rel=1e-6)
    norm, tension, peak, _ = contraction_curves(Setup(task=task[0], muscle=NAME), "force-length")
    law = np.array([[0.0], [1.0]])[..., None] * np.exp(-4.0 * (norm - 1.0) ** 2)
    assert tension / peak == pytest.approx(law + 4.0 * np.maximum(norm - 1.0, 0.0) ** 2, abs=1e-3)


@pytest.mark.slow
def test_trained_and_evaluated(task, tmp_path):
    pytest.importorskip("torch")
    from myowarp.apps.reports.evaluation import evaluate_policy, plan_evaluation
    from myowarp.apps.train.plan import plan
    from myowarp.apps.train.run import train

    setup = Setup(task=task[1] or task[0].key, muscle=NAME, device="cpu")
    small = {"num_worlds": 8, "rollout_steps": 4, "samples": 32, "minibatches": 1, "selections": 1}
    train(plan(setup, output=tmp_path / "run", **small))
    head, figures = evaluate_policy(plan_evaluation(tmp_path / "run", setup, episodes=4, mode="sampled"))
    assert (head["muscle"], figures["sampled"]["episodes"], figures["sampled"]["faults"]) == (NAME, 4, 0)
