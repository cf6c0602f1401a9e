"""A policy with a memory: its unit against torch's, its samples, what it learns, where it is played."""

import dataclasses

import numpy as np
import onnx
import pytest
import torch
from learners import DrawnWorlds, make_learner
from onnx.reference import ReferenceEvaluator
from test_train_policy import CONTRACT, REST

from myowarp.apps.policies.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from myowarp.apps.policies.export import write_onnx, write_torchscript
from myowarp.apps.policies.find import acting, find_policy
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.rollouts.episodes import Trace
from myowarp.apps.rollouts.run import run
from myowarp.apps.train.plan import plan
from myowarp.apps.train.recurrent import Unrolled
from myowarp.apps.train.run import train
from myowarp.apps.train.worlds import Step
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.disk import plain
from myowarp.sim.simulation import Simulation
from myowarp.view.browser.session import Session

NUM_OBS, NUM_ACTIONS, UNITS, WORLDS, STEPS = 7, 3, 5, 8, 12
SAME = 1e-6
TASK = "myoElbowPose1D6MRandom-v0"


def learner_of(**given):
    """Return a learner whose memory matters."""
    torch.manual_seed(3)
    sizes = {"num_worlds": WORLDS, "rollout_steps": STEPS, "hidden": (9, 8), "minibatches": 2}
    own = {"precision": "float32", "memory": UNITS}
    learner = make_learner("ppo", NUM_OBS, NUM_ACTIONS, **sizes | own | given)
    with torch.no_grad():
        for parameter in learner.policy.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
    learner.normaliser.see(10.0 + 3.0 * torch.randn(500, NUM_OBS))
    return learner


def saved(learner, folder):
    """Write what the learner has learned; return its checkpoint."""
    learner.follow(0.0)
    settings = dataclasses.asdict(learner.settings) | Setup(physics="fast", muscle="mujoco", seed=0).plain()
    manifest = REST | {"algorithm": "ppo", "settings": settings, "contract": CONTRACT}
    save_checkpoint(folder, 12, plain(manifest | {"policy": learner.form()}), learner.acting(), {})
    return load_checkpoint(folder)


def sequence():
    """Return observations (STEPS, WORLDS, NUM_OBS), and where episodes begin, at the first step, too."""
    rng = np.random.default_rng(0)
    begins = rng.random((STEPS, WORLDS)) < 0.2
    begins[0] = True
    return rng.normal(10.0, 3.0, (STEPS, WORLDS, NUM_OBS)).astype(np.float32), begins


def by_torch(learner, obs, begins):
    """Return means and memories by torch's own unit, step by step."""
    memory, means, memories = torch.zeros(WORLDS, UNITS), [], []
    with torch.no_grad():
        for seen, new in zip(obs, begins, strict=True):
            memory[torch.from_numpy(new)] = 0.0
            x = learner.normaliser(torch.from_numpy(seen))
            memory = learner.policy.memory(x, memory)
            mean = learner.policy.net(torch.cat((x, memory), dim=1))
            means.append(learner.policy.bounded(mean).clamp(-1.0, 1.0).numpy())
            memories.append(memory.numpy().copy())
    return np.array(means), np.array(memories)


def test_it_remembers_as_torchs_unit_does_wherever_it_is_played(tmp_path):
    """By NumPy, by ONNX under the reference evaluator of its own package, as TorchScript; over episodes."""
    learner, (obs, begins) = learner_of(), sequence()
    checkpoint, (means, memories) = saved(learner, tmp_path / "run"), by_torch(learner, obs, begins)
    act = LearnedPolicy(checkpoint)
    got = np.array([act(seen, new) for seen, new in zip(obs, begins, strict=True)])
    assert np.abs(got - means).max() < SAME
    without = LearnedPolicy(checkpoint)
    assert np.abs(np.array([without(seen) for seen in obs]) - means).max() > 0.1
    write_onnx(checkpoint, tmp_path / "policy.onnx")
    write_torchscript(checkpoint, tmp_path / "policy.pt")
    evaluator = ReferenceEvaluator(onnx.load(tmp_path / "policy.onnx"))
    script = torch.jit.load(str(tmp_path / "policy.pt"))
    memory = np.zeros((WORLDS, UNITS), np.float32)
    for t in range(STEPS):
        memory = memory * ~begins[t][:, None]
        action, after = evaluator.run(None, {"obs": obs[t], "memory": memory})
        other, other_after = script(torch.from_numpy(obs[t]), torch.from_numpy(memory))
        for found in (action, other.numpy()):
            assert np.abs(found - means[t]).max() < SAME
        for found in (after, other_after.numpy()):
            assert np.abs(found - memories[t]).max() < SAME
        memory = after


def test_a_memory_that_begins_from_a_policy_without_one_acts_like_it_at_every_step():
    """The unit remembers from the first step on, and what it remembers says nothing yet."""
    parent, child, (obs, begins) = learner_of(memory=0), learner_of(), sequence()
    with torch.no_grad():
        expected = parent.means(parent.inputs(torch.from_numpy(obs))).clamp(-1.0, 1.0).numpy()
    assert np.abs(by_torch(child, obs, begins)[0] - expected).max() > 0.1
    parent.follow(0.0)
    child.inherit(parent.acting(), 500, 96, np.arange(NUM_OBS))
    means, memories = by_torch(child, obs, begins)
    assert np.abs(means - expected).max() < SAME
    assert np.abs(memories).max() > 0.1


class EndingWorlds(DrawnWorlds):
    """Worlds whose episodes end at random, some because the time is over."""

    def step(self, action):
        """Return what a control step led to."""
        step = super().step(action)
        drawn = torch.rand(self.num_worlds)
        return step._replace(terminated=drawn < 0.1, truncated=drawn > 0.9)


def test_an_update_sees_the_means_that_acted():
    """Before its first gradient step it computes them anew, from the memories that episodes began with."""
    learner, worlds = learner_of(), EndingWorlds(WORLDS, NUM_OBS, NUM_ACTIONS)
    for _ in range(2):  # the second begins in mid-episode
        rollout = learner.collect(worlds)
        begins = (rollout.obs[:, NUM_OBS:] == 0.0).all(dim=1).view(STEPS, WORLDS)[1:]
        assert 0.1 < begins.float().mean() < 0.35
        for part in rollout.parts(2, learner.together, WORLDS):
            np.testing.assert_allclose(learner.means(part.obs).detach(), part.mean, atol=SAME)
    backwards = (v.view(STEPS, WORLDS, -1).flip(0) for v in (rollout.obs, rollout.mean))
    inputs, mean = (v.contiguous() for v in backwards)
    assert (learner.policy(inputs).detach() - mean.flatten(0, 1)).abs().max() > 0.1


def test_parts_keep_the_steps_of_a_world_together_in_their_order():
    learner, worlds = learner_of(), DrawnWorlds(WORLDS, NUM_OBS, NUM_ACTIONS)
    rollout = learner.collect(worlds)
    numbered = torch.arange(STEPS * WORLDS, dtype=torch.float32)
    steps = learner.together
    assert steps == 6  # the largest part of 12 steps up to 8
    parts = rollout._replace(advantage=numbered).parts(2, steps, WORLDS)
    rows = torch.cat([part.advantage.view(steps, -1) for part in parts], dim=1).numpy()
    np.testing.assert_array_equal(np.diff(rows, axis=0), WORLDS)
    first = [*range(WORLDS), *range(steps * WORLDS, (steps + 1) * WORLDS)]
    np.testing.assert_array_equal(np.sort(rows[0]), first)
    assert (rows[0] != first).any()


def test_gradients_are_those_of_torchs_unit():
    """Over steps with two begins of episodes, of all that is learned and of the first memory."""
    torch.manual_seed(5)
    unit = torch.nn.GRUCell(NUM_OBS, UNITS).double()
    x, first = torch.randn(6, 3, NUM_OBS).double(), torch.randn(3, UNITS).double().requires_grad_()
    same, weight = torch.ones(6, 3, 1).double(), torch.randn(6, 3, UNITS).double()
    same[0, 1], same[4, 2] = 0.0, 0.0
    learned = [*unit.parameters(), first]
    memory, after = first, []
    for t in range(6):
        memory = unit(x[t], same[t] * memory)
        after.append(memory)
    expected = torch.autograd.grad((weight * torch.stack(after)).sum(), learned)
    gates = torch.nn.functional.linear(x, unit.weight_ih, unit.bias_ih)
    found = Unrolled.apply(gates, unit.weight_hh, unit.bias_hh, first, same)
    np.testing.assert_allclose(found.detach(), torch.stack(after).detach(), atol=1e-12)
    got = torch.autograd.grad((weight * found).sum(), learned)
    for own, wanted in zip(got, expected, strict=True):
        np.testing.assert_allclose(own, wanted, atol=1e-12)
        assert wanted.abs().max() > 0.1


def test_gradients_go_back_to_the_begin_of_an_episode_and_no_further():
    learner = learner_of()
    with torch.no_grad():
        inputs = torch.randn(4, 1, NUM_OBS + UNITS)
        inputs[2, :, NUM_OBS:] = 0.0  # an episode begins with the third step
    inputs.requires_grad_()
    learner.policy(inputs)[3:].sum().backward()
    size = inputs.grad[:, 0, :NUM_OBS].abs().sum(dim=1)
    assert (size[:2] == 0.0).all()
    assert (size[2:] > 1e-3).all()


def test_where_the_time_is_over_the_memory_of_the_last_step_counts():
    """The value of what would have followed is that of the observation and of all that came before it."""
    learner, worlds = learner_of(minibatches=1), EndingWorlds(WORLDS, NUM_OBS, NUM_ACTIONS)
    given, worth = [], learner.worth
    learner.worth = lambda inputs: given.append(inputs.clone()) or worth(inputs)
    rollout = learner.collect(worlds)
    further = torch.cat(given[:-1])[:, NUM_OBS:]
    assert (further != 0.0).all()
    before = rollout.obs[:, NUM_OBS:].reshape(STEPS, WORLDS, UNITS)
    cut = (given[-1][1:, :, NUM_OBS:] == 0.0).all(dim=-1)  # a new episode follows
    x = rollout.obs[:, :NUM_OBS].reshape(STEPS, WORLDS, NUM_OBS)
    after = learner.policy.memory(x[cut], before[cut]).detach()
    apart = (after[None] - further[:, None]).abs().amax(dim=-1).amin(dim=1)
    assert apart.max() < SAME


class Cues:
    """A sign that the first observation of an episode shows alone; reward for actions that have it."""

    LENGTH = 6

    def __init__(self, num_worlds):
        self.num_worlds, self.num_obs, self.num_actions = num_worlds, 1, 1
        self.device, self.steps = torch.device("cpu"), 0
        self._begin()

    def _begin(self):
        self.sign = torch.randint(0, 2, (self.num_worlds, 1)) * 2.0 - 1.0
        self.obs = self.sign.clone()

    def step(self, action):
        """Return what a control step led to."""
        self.steps += 1
        reward = 1.0 - (action.clamp(-1.0, 1.0) - self.sign).abs()[:, 0]
        over, no = self.steps % self.LENGTH == 0, torch.zeros(self.num_worlds) > 0
        self.obs = torch.zeros_like(self.obs)
        step = Step(self.obs.clone(), reward, no | over, no, no)
        if over:
            self._begin()
        return step


@pytest.mark.slow
@pytest.mark.parametrize(("memory", "least", "most"), [(8, 0.8, 1.0), (0, 0.0, 0.3)])
def test_it_learns_to_keep_what_was_seen_once(memory, least, most):
    """Without a memory a sixth of the steps can be right, and the others no more than 0 on average."""
    torch.manual_seed(0)
    sizes = {"num_worlds": 64, "rollout_steps": 24, "hidden": (16,), "minibatches": 2, "memory": memory}
    learner = make_learner("ppo", 1, 1, learning_rate=1e-2, precision="float32", **sizes)
    worlds, rewards = Cues(64), []
    step = worlds.step
    worlds.step = lambda action: rewards.append(float((taken := step(action)).reward.mean())) or taken
    for _ in range(50):
        learner.iterate(worlds)
    assert least < np.mean(rewards[-240:]) < most


def test_a_parent_without_memory_acts_on_where_more_is_observed_and_remembered():
    parent, obs = learner_of(memory=0), np.random.default_rng(1).normal(10.0, 3.0, (40, NUM_OBS))
    obs = torch.from_numpy(obs.astype(np.float32))
    places = np.array([2, 3, 4, 5, 0, 1, 8])  # of its observations among ten
    sizes = {"num_worlds": WORLDS, "hidden": (9, 8), "minibatches": 2}
    child = make_learner("ppo", 10, NUM_ACTIONS, memory=UNITS, **sizes)
    parent.follow(0.0)
    child.inherit(parent.acting(), 500, 96, places)
    wider = torch.randn(40, 10)
    wider[:, places] = obs
    inputs = torch.cat((child.normaliser(wider), torch.randn(40, UNITS)), dim=1)
    expected = parent.policy(parent.normaliser(obs))
    np.testing.assert_allclose(child.policy(inputs[None]).detach(), expected.detach(), atol=SAME)
    assert expected.std(dim=0).min() > 0.05
    new = np.setdiff1d(np.arange(10), places)
    np.testing.assert_array_equal(child.normaliser.count[places], 96)
    np.testing.assert_array_equal(child.normaliser.count[new], 1)  # the next rollout says what they are
    loss = child.policy(inputs[None]).square().sum()
    loss.backward()
    assert child.policy.net[0].weight.grad[:, 10:].abs().min() > 0.0  # and soon the memory counts


@pytest.fixture(scope="module")
def elbow(tmp_path_factory):
    """A run of an elbow that remembers, whose memory matters, selections and all."""
    folder = tmp_path_factory.mktemp("recurrent") / "run"
    small = {"hidden": (16,), "rollout_steps": 8, "num_worlds": 16, "samples": 1024, "selections": 1}
    fast = {"learning_rate": 1e-2, "average": 0.0, "minibatches": 2}
    train(plan(TASK, output=folder, device="cpu", memory=UNITS, **small, **fast))
    return folder


def test_a_memory_ends_with_its_episode_wherever_a_policy_acts(elbow):
    """What it does in an episode is what it does in the same one when no other went before."""
    length, steps = 10, 24
    sim = Simulation(TASKS[TASK], 4, autoreset="same_step", horizon=length, device="cpu", progress=False)
    trace = Trace()
    run(sim, acting(find_policy(str(elbow), TASKS[TASK]), sim), steps, trace)
    act = LearnedPolicy(load_checkpoint(elbow))
    for begin in range(0, steps, length):
        part = slice(begin, min(begin + length, steps))
        act(np.zeros((1, act.obs_size), np.float32))  # another number of rows: all begin
        expected = [act(obs) for obs in trace.arrays["obs"][part]]
        np.testing.assert_array_equal(expected, trace.arrays["action"][part])
        kept = LearnedPolicy(load_checkpoint(elbow))
        alone = np.array([kept(obs, np.ones(4, bool)) for obs in trace.arrays["obs"][part]])
        assert (alone[1:] != np.array(expected)[1:]).any()


def test_the_twin_of_a_page_remembers_what_the_shown_world_does(elbow):
    """Of the same memory, the policy does the same in the same state."""
    setup, twin = Setup(task=TASKS[TASK], device="cpu", seed=1), 2
    policy = find_policy(str(elbow), TASKS[TASK])
    session = Session(TASK, setup, twin, "remembers", lambda _, sim: acting(policy, sim))
    for _ in range(6):
        session.step()
    before = session.sim.action.numpy().copy()
    session.show(1)
    session.step()
    after = session.sim.action.numpy().copy()
    assert (before[1] != before[twin]).any()
    assert np.array_equal(after[1], after[twin])
    forgetful = LearnedPolicy(load_checkpoint(elbow))
    fresh = forgetful(session.sim.transition.obs.numpy())
    session.step()
    assert (np.abs(fresh[1] - session.sim.action.numpy()[1]) > 1e-4).any()


AGENT = """
import numpy as np

step = np.zeros(4)


def act(obs, begins):
    step[begins] = 0
    step[:] += 1
    return np.repeat(np.sin(step)[:, None], 6, axis=1)
"""


def test_a_users_policy_is_told_where_episodes_begin(tmp_path):
    (tmp_path / "my_agent.py").write_text(AGENT)
    sim = Simulation(TASKS[TASK], 4, autoreset="same_step", horizon=10, device="cpu", progress=False)
    trace = Trace()
    run(sim, acting(find_policy(f"{tmp_path}/my_agent.py:act", TASKS[TASK]), sim), 24, trace)
    expected = np.sin(np.arange(24) % 10 + 1)
    np.testing.assert_allclose(np.array(trace.arrays["action"])[:, 3, 2], expected, atol=1e-6)


def test_a_parents_memory_is_kept_or_refused(elbow, tmp_path):
    own = {"parent": str(elbow), "output": tmp_path / "child", "minibatches": 2, "device": "cpu"}
    assert plan(TASK, **own).settings.memory == UNITS
    with pytest.raises(CheckpointError, match=rf"^--memory must be that of --parent '.*', {UNITS}; got 4;"):
        plan(TASK, **own, memory=4)
    own.pop("minibatches")
    with pytest.raises(CheckpointError, match=r"^--parent '.*' has a memory, which trpo cannot train$"):
        plan(TASK, **own, algorithm="trpo")


def test_steps_that_stay_together_are_divided():
    with pytest.raises(ValueError, match=r"--minibatches must divide the 6 sequences of 4 steps of an iter"):
        make_learner("ppo", num_worlds=6, rollout_steps=4, minibatches=4, memory=2)


def test_a_memory_that_overflows_is_no_policy(tmp_path):
    learner = learner_of()
    learner.policy.memory.weight_hh.data.fill_(2e38)
    with pytest.raises(CheckpointError, match="actions are not finite"):
        saved(learner, tmp_path)
