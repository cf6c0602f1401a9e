"""The learner beside our own arithmetic: advantages, losses, gradients, rates, averages, its arrays."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from elbows import learner_env
from learners import make_learner, parents

from myowarp.apps.reports import machine
from myowarp.apps.train import learner as learner_module
from myowarp.apps.train import ppo
from myowarp.apps.train.learner import Captured
from myowarp.apps.train.loop import INHERITED_STEPS, DivergedError, Run, precision
from myowarp.apps.train.networks import CLIP, Normaliser
from myowarp.apps.train.ppo import RATE_FACTOR, Rollout
from myowarp.apps.train.replay import Replay
from myowarp.apps.train.settings import ALGORITHMS, Replaying, choose
from myowarp.apps.train.trpo import conjugate_gradient

ELBOW = "myoElbowPose1D6MRandom-v0"
HORIZON = 5  # steps: two truncations and a piece in a rollout of 12
STEPS, WORLDS = 12, 3
SMALL = {"num_worlds": WORLDS, "rollout_steps": STEPS, "hidden": (16,), "discount": 0.9}
SMALL |= {"precision": "float32"}
FLOAT32 = 2e-5  # of advantages of order 1, sums of a dozen float32
SLOPE = 2e-5  # of a gradient of order 0.1 to 1 in float32
KEPT = {"replay": 60, "batch_size": 30, "gradient_steps": 1}


def make_run(algorithm, seed=0, parent=None, **settings):
    """Return a run of a few elbows with short episodes."""
    env = learner_env(WORLDS, HORIZON, seed)
    return Run(env, choose("none", algorithm, SMALL | parents(algorithm) | settings), parent)


@pytest.mark.parametrize(
    ("task", "settings", "count"),
    [
        (ELBOW, {}, 7777),
        ("myoElbowPose1D6MFixed-v0", {}, WORLDS * INHERITED_STEPS),
        (ELBOW, {"parent_samples": 55}, 55),
    ],
)
def test_an_inherited_normaliser_counts_what_it_has_seen_in_the_same_task(task, settings, count):
    """Else a rollout from the begin of all episodes would move it, and with it a policy that was good."""
    first = make_run("ppo", minibatches=2)
    arrays, contract = first.learner.acting(), {"columns": [[c.name] for c in first.env.sim.columns]}
    arrays["observation_mean"] = arrays["observation_mean"] + 3.0
    parent = SimpleNamespace(task=task, policy=arrays, manifest={"samples": 7777, "contract": contract})
    run = make_run("ppo", parent=parent, minibatches=2, **settings)
    np.testing.assert_array_equal(run.learner.normaliser.count, count)
    np.testing.assert_allclose(run.learner.normaliser.mean, arrays["observation_mean"])
    np.testing.assert_array_equal(run.learner.acting()["net.0.weight"], run.learner.policy.net[0].weight.data)


def record(run):
    """Let a run note every transition as the environment gave it, before anything is reset."""
    rows, step = [], run.env.step

    def noted(action):
        before = torch.from_numpy(run.env.sim.transition.obs.numpy()).clone()
        obs, reward, terminated, truncated, info = step(action)
        rows.append([x.clone().double().numpy() for x in (before, obs, reward, terminated, truncated)])
        return obs, reward, terminated, truncated, info

    run.env.step = noted
    return rows


def hand_computed(rows, value, discount, decay, *, bootstrap=True):
    """Return advantages (steps, worlds) by their definition, world by world, in float64.

    A_t = sum_k (discount decay)^k delta_{t+k} within the episode, delta = r + discount V(s') - V(s), with
    V(s') = 0 after a termination, and V of the observation that the episode ended with after a truncation.
    """
    advantages = np.zeros((len(rows), WORLDS))
    for world in range(WORLDS):
        for first in range(len(rows)):
            weight = 1.0
            for before, after, reward, terminated, truncated in rows[first:]:
                following = 0.0 if terminated[world] else value(after[world])
                if truncated[world] and not bootstrap:
                    following = 0.0
                delta = reward[world] + discount * following - value(before[world])
                advantages[first, world] += weight * delta
                if terminated[world] or truncated[world]:
                    break
                weight *= discount * decay
    return advantages


def standardized(x):
    return (x - x.mean()) / x.std(ddof=1)


@pytest.mark.parametrize("algorithm", ["ppo", "trpo"])
def test_truncated_episodes_bootstrap_from_the_observation_they_ended_with(algorithm):
    run = make_run(algorithm, minibatches=1, epochs=1, trace_decay=0.8)
    run.iterate()  # a normaliser and a value function that are not those of the start
    rows, learner, seen = record(run), run.learner, {}
    normaliser, returns, network = copy.deepcopy((learner.normaliser, learner.returns, learner.value))
    learner.update = lambda rollout: seen.update(rollout=rollout)
    run.iterate()

    def value(obs):
        with torch.no_grad():
            x = normaliser(torch.tensor(obs, dtype=torch.float32)[None])
            return returns.inverse(network(x)).item()

    plain = {kind: hand_computed(rows, value, 0.9, 0.8, bootstrap=kind) for kind in (True, False)}
    got = seen["rollout"].advantage.view(STEPS, WORLDS).numpy()
    assert sum(row[4].sum() for row in rows) >= 2 * WORLDS
    assert np.abs(got - standardized(plain[True])).max() < FLOAT32
    assert np.abs(standardized(plain[False]) - standardized(plain[True])).max() > 10 * FLOAT32
    # The value function is to say V(s) + A, normalised by all that it was to say so far.
    wanted = plain[True] + np.array([[value(obs) for obs in row[0]] for row in rows])
    before = returns.mean.item(), returns.variance.item(), returns.count.item()
    after = merged(*before, wanted.ravel())
    got = seen["rollout"].returns.view(STEPS, WORLDS).numpy()
    assert np.abs(got - (wanted - after[0]) / np.sqrt(after[1])).max() < 10 * FLOAT32


def merged(mean, variance, count, more):
    """Return mean and variance of a sample that is known by its moments, and of more numbers."""
    total = count + len(more)
    whole = (mean * count + more.sum()) / total
    return whole, ((variance + mean**2) * count + (more**2).sum()) / total - whole**2


@pytest.mark.parametrize("chunks", [(1,), (40, 1, 7, 333)])
def test_a_normaliser_has_the_moments_of_all_that_it_saw(chunks):
    """Beside one sample of mean 0 and variance 1, with which it begins."""
    rng = np.random.default_rng(0)
    rows = [rng.normal([0.0, 50.0, -3.0], [1.0, 0.01, 20.0], (number, 3)) for number in chunks]
    normaliser = Normaliser(3)
    for part in rows:
        normaliser.see(torch.from_numpy(part.astype(np.float32)))
    whole = np.concatenate(rows).astype(np.float32).astype(float)
    want = np.array([merged(0.0, 1.0, 1.0, column) for column in whole.T]).T
    np.testing.assert_allclose(normaliser.mean, want[0], rtol=1e-9)
    np.testing.assert_allclose(normaliser.variance, want[1], rtol=1e-7)
    np.testing.assert_array_equal(normaliser.count, 1 + sum(chunks))
    far = np.array([[1e9, 50.0, -1e9]], np.float32)
    shown = normaliser(torch.from_numpy(far)).numpy()[0]
    assert (shown[0], shown[2]) == (CLIP, -CLIP)
    assert shown[1] == pytest.approx((50.0 - want[0][1]) / np.sqrt(want[1][1]), abs=1e-3)
    back = normaliser.inverse(normaliser(torch.from_numpy(whole[:5].astype(np.float32))))
    inside = np.abs((whole[:5] - want[0]) / np.sqrt(want[1])) < CLIP
    np.testing.assert_allclose(back.numpy()[inside], whole[:5][inside], rtol=1e-4, atol=1e-4)


ROWS, INPUTS, HIDDEN, OUTPUTS = 60, 4, 5, 2


def rollout_of(learner, apart=0.6):
    """Return samples of a policy that is not the learner's: many ratios lie beyond the clip."""
    generator = torch.Generator().manual_seed(7)

    def normal(*shape):
        return torch.randn(*shape, generator=generator)

    obs, std = normal(ROWS, learner.normaliser.mean.shape[0]), torch.full((OUTPUTS,), 0.4)
    with torch.no_grad():
        mean = learner.policy(obs) + apart * 0.4 * normal(ROWS, OUTPUTS)
    action = mean + std * normal(ROWS, OUTPUTS)
    density = ppo.log_density(action, mean, std)
    return Rollout(obs, action, mean, normal(ROWS), normal(ROWS), std, density)


def unpacked(vector):
    """Return weights and biases of a network with one hidden layer, and a spread, of a vector."""
    sizes = (HIDDEN * INPUTS, HIDDEN, OUTPUTS * HIDDEN, OUTPUTS, OUTPUTS)
    parts = np.split(vector, np.cumsum(sizes)[:-1])
    return parts[0].reshape(HIDDEN, INPUTS), parts[1], parts[2].reshape(OUTPUTS, HIDDEN), *parts[3:]


def packed(policy):
    """Return a policy's parameters in that order, float64."""
    net = policy.net
    parts = net[0].weight, net[0].bias, net[2].weight, net[2].bias, policy.log_std
    return torch.cat([part.detach().flatten() for part in parts]).double().numpy()


def acts(vector, obs):
    """Return means and spread of a policy, in NumPy."""
    first, bias, last, shift, log_std = unpacked(vector)
    return np.tanh(np.tanh(obs @ first.T + bias) @ last.T + shift), np.exp(log_std)


def log_density(action, mean, std):
    """Return log N(action; mean, std) of all rows."""
    return (-0.5 * ((action - mean) / std) ** 2 - np.log(std) - 0.5 * np.log(2 * np.pi)).sum(axis=1)


def arrays_of(rollout):
    """Return a rollout in float64."""
    names = ("obs", "action", "mean", "advantage", "returns", "std")
    return SimpleNamespace(**{name: getattr(rollout, name).double().numpy() for name in names})


def clipped_loss(vector, rollout, clip, entropy):
    """Return PPO's loss, equation 7 of arXiv:1707.06347, minus the weight times the spread's logarithms."""
    mean, std = acts(vector, rollout.obs)
    old = log_density(rollout.action, rollout.mean, rollout.std)
    ratio = np.exp(log_density(rollout.action, mean, std) - old)
    low = np.minimum(ratio * rollout.advantage, np.clip(ratio, 1 - clip, 1 + clip) * rollout.advantage)
    return -low.mean() - entropy * np.log(std).sum()


def differences(function, vector, step=1e-6):
    """Return a gradient by central differences."""
    ways = step * np.eye(len(vector))
    return np.array([(function(vector + way) - function(vector - way)) / (2 * step) for way in ways])


def small(algorithm, **given):
    """Return a learner whose policy has one hidden layer, away from its first weights."""
    torch.manual_seed(4)
    common = {"hidden": (HIDDEN,), "activation": "tanh", "num_worlds": 6, "rollout_steps": 10}
    learner = make_learner(algorithm, INPUTS, OUTPUTS, **common | given)
    with torch.no_grad():
        for parameter in learner.policy.parameters():
            parameter += 0.5 * torch.randn_like(parameter)
    return learner


def slopes(learner):
    """Return the gradient of the policy's parameters, in the order of `packed`."""
    net = learner.policy.net
    parts = net[0].weight, net[0].bias, net[2].weight, net[2].bias, learner.policy.log_std
    return torch.cat([part.grad.flatten() for part in parts]).double().numpy()


def test_a_gradient_step_of_ppo_is_one_of_the_clipped_loss():
    """Loss and gradient beside float64 NumPy; Adam's first step is the rate times the gradient's sign."""
    given = {"clip": 0.2, "entropy": 0.03, "learning_rate": 1e-3, "spread_rate": 4e-3}
    learner = small("ppo", gradient_norm=0.0, **given)
    rollout, before = rollout_of(learner), packed(learner.policy)
    learner.update_policy(rollout)
    want = arrays_of(rollout)
    assert learner.figures()["policy_loss"] == pytest.approx(clipped_loss(before, want, 0.2, 0.03), abs=1e-6)
    slope = differences(lambda vector: clipped_loss(vector, want, 0.2, 0.03), before)
    np.testing.assert_allclose(slopes(learner), slope, atol=SLOPE)
    without = differences(lambda vector: clipped_loss(vector, want, 1e9, 0.03), before)
    assert np.abs(without - slope).max() > 100 * SLOPE
    moved, rates = packed(learner.policy) - before, np.repeat([1e-3, 4e-3], [len(before) - OUTPUTS, OUTPUTS])
    clear = np.abs(slope) > 1e-3
    assert clear.sum() > 30
    np.testing.assert_allclose(moved[clear], (-rates * np.sign(slope))[clear], rtol=1e-3)


def test_gradients_of_a_policy_are_clipped_together():
    learner, other = small("ppo", gradient_norm=0.1), small("ppo", gradient_norm=0.0)
    for each in (learner, other):
        each.update_policy(rollout_of(each))
    assert np.linalg.norm(slopes(other)) > 0.3
    want = slopes(other) * 0.1 / np.linalg.norm(slopes(other))
    np.testing.assert_allclose(slopes(learner), want, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("algorithm", ["ppo", "trpo"])
def test_the_value_function_has_a_rate_of_its_own(algorithm):
    learner = small(algorithm, value_rate=5e-3, gradient_norm=0.0)
    rollout, policy = rollout_of(learner), packed(learner.policy)
    with torch.no_grad():
        want = (learner.value(rollout.obs)[:, 0] - rollout.returns).square().mean().item()
    before = learner.value[2].weight.clone()
    learner.update_value(rollout)
    assert learner.figures()["value_loss"] == pytest.approx(want, rel=1e-5)
    moved, slope = learner.value[2].weight - before, learner.value[2].weight.grad
    np.testing.assert_allclose(moved.detach(), -5e-3 * slope.sign(), rtol=1e-3)
    np.testing.assert_array_equal(packed(learner.policy), policy)


def test_a_policy_waits_until_its_value_function_knows_something():
    learner = small("ppo", value_first=2)
    for iteration, waits in enumerate((True, True, False)):
        before, value = packed(learner.policy), learner.value[2].weight.clone()
        learner.update(rollout_of(learner))
        learner.iterations += 1
        assert (packed(learner.policy) == before).all() == waits, iteration
        assert not learner.optimizers["policy"].state_dict()["state"] or not waits  # Adam has seen nothing
        assert (learner.value[2].weight != value).any()


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_a_captured_step_has_the_numbers_of_a_plain_one(algorithm, monkeypatch):
    """A graph replays a step on inputs of its own; on the CPU a call on those stands for it."""
    found, graphs = {}, []
    monkeypatch.setattr(learner_module, "warm_up", lambda step: step())
    monkeypatch.setattr(learner_module, "capture", lambda step: graphs.append(step) or step)
    for captures in (False, True):
        learner = small(algorithm, **({} if algorithm == "ppo" else KEPT))
        steps = [value for value in vars(learner).values() if isinstance(value, Captured)]
        assert steps
        for step in steps:
            step.captures = captures
        if algorithm == "sac":
            rows = torch.Generator().manual_seed(1)
            sizes = {name: (KEPT["replay"], width) for name, width in learner.replay.widths.items()}
            learner.replay.add(**{name: torch.rand(shape, generator=rows) for name, shape in sizes.items()})
            learner.scale.see(torch.ones(6), torch.zeros(6, dtype=torch.bool))
        for _ in range(10):
            learner.update(rollout_of(learner)) if algorithm == "ppo" else learner.update()
        found[captures] = learner.arrays() | learner.figures()
    assert len(graphs) == len(steps)
    for name, array in found[False].items():
        np.testing.assert_array_equal(array, found[True][name], err_msg=name)


def shifted(learner, by):
    """Return samples of a policy whose means lie some standard deviations beside the learner's."""
    rollout = rollout_of(learner, apart=0.0)
    with torch.no_grad():
        learner.policy.log_std.copy_(rollout.std.log())
    rollout.mean.add_(by * rollout.std)
    return rollout


@pytest.mark.parametrize(("divergence", "factor"), [(2.2, 1 / RATE_FACTOR), (0.45, RATE_FACTOR), (1.0, 1.0)])
def test_the_rate_follows_the_divergence_of_an_entry_of_the_action(divergence, factor):
    """KL of equal spreads is shift^2 / 2 an entry, however many there are."""
    aim = 1e-3
    for worlds in (1, 2):
        learner = small("ppo", kl=aim, learning_rate=2e-3, num_worlds=6 * worlds)
        rollout = shifted(learner, np.sqrt(2 * divergence * aim))
        learner.update_policy(rollout)
        figures = learner.figures()
        assert figures["kl"] == pytest.approx(OUTPUTS * divergence * aim, rel=1e-3)
        assert learner.rate.item() == pytest.approx(2e-3 * factor)
        assert figures["learning_rate"] == pytest.approx(2e-3 * factor)  # what was stepped with
        learner.set_rates(0.0)  # a new iteration goes on with the rate that was found
        learner.update_policy(shifted(learner, np.sqrt(2 * aim)))
        assert learner.figures()["learning_rate"] == pytest.approx(2e-3 * factor)


def test_the_rate_stays_within_its_bounds():
    given = {"kl": 1e-3, "learning_rate": 1e-3, "least_rate": 9e-4, "largest_rate": 1.1e-3}
    for shift, bound in ((1.0, 9e-4), (0.0, 1.1e-3)):
        learner = small("ppo", **given)
        learner.update_policy(shifted(learner, shift))
        assert learner.rate.item() == pytest.approx(bound)


@pytest.mark.parametrize("algorithm", ["ppo", "sac", "dagger"])
def test_rates_fall_along_half_a_cosine(algorithm):
    learner = small(algorithm, last_rate=0.25, **({} if algorithm == "ppo" else KEPT))
    for share in (0.0, 0.3, 0.5, 1.0, 1.7):
        learner.set_rates(share)
        factor = 0.25 + 0.75 * (1.0 + np.cos(np.pi * min(share, 1.0))) / 2.0
        for optimizer in learner.optimizers.values():
            (group,) = optimizer.param_groups
            assert group["lr"] == pytest.approx(factor * group["first_rate"])
    assert learner.optimizers["policy"].param_groups[0]["lr"] == pytest.approx(
        0.25 * learner.settings.learning_rate
    )


def test_a_run_tells_its_learner_how_far_it_is():
    run = make_run("ppo", minibatches=1, samples=3 * STEPS * WORLDS, last_rate=0.0)
    rates = []
    for _ in range(3):
        run.iterate()
        rates.append(run.losses["learning_rate"])
    expected = 1e-3 * (1.0 + np.cos(np.pi * np.arange(3) / 3)) / 2.0
    np.testing.assert_allclose(rates, expected, rtol=1e-6)


def test_conjugate_gradients_solve_a_system():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(12, 12))
    matrix, right = root @ root.T + np.eye(12), rng.normal(size=12)
    product = torch.from_numpy(matrix)
    got = conjugate_gradient(lambda vector: product @ vector, torch.from_numpy(right), 30)
    np.testing.assert_allclose(got, np.linalg.solve(matrix, right), rtol=1e-4, atol=1e-6)
    # Two different eigenvalues take two steps; the first one goes along the right side.
    product = torch.diag(torch.tensor([2.0, 2.0, 5.0], dtype=torch.float64))
    right = torch.tensor([1.0, 0.0, 1.0], dtype=torch.float64)
    got = conjugate_gradient(lambda vector: product @ vector, right, 2)
    np.testing.assert_allclose(got, [0.5, 0.0, 0.2], rtol=1e-9)
    got = conjugate_gradient(lambda vector: product @ vector, right, 1)
    np.testing.assert_allclose(got, right * 2.0 / 7.0, rtol=1e-9)


def divergence(rollout, vector):
    """Return the KL divergence from the policy of a rollout to that of a vector, in NumPy."""
    mean, std = acts(vector, rollout.obs)
    squares = rollout.std**2 + (rollout.mean - mean) ** 2
    return (np.log(std / rollout.std) + squares / (2 * std**2) - 0.5).sum(axis=1).mean()


@pytest.mark.parametrize("max_kl", [1e-3, 0.02, 0.3])
def test_a_step_of_trpo_gains_and_stays_within_its_divergence(max_kl):
    learner = small("trpo", max_kl=max_kl, damping=0.1, conjugate_steps=40)
    rollout = shifted(learner, 0.0)
    before, want = packed(learner.policy), arrays_of(rollout)

    def surrogate(vector):
        return -clipped_loss(vector, want, 1e9, 0.0)

    learner.step_policy(rollout)
    after = packed(learner.policy)
    assert divergence(want, before) < 1e-6
    assert 0.2 * max_kl < divergence(want, after) < max_kl * (1 + 1e-3)
    assert learner.figures()["kl"] == pytest.approx(divergence(want, after), rel=1e-3)
    assert surrogate(after) > surrogate(before) + 1e-4
    # Along the natural gradient, F^-1 g, with F the curvature of the divergence, damped.
    if max_kl == 1e-3:
        slope = differences(surrogate, before)
        curvature = np.array([
            differences(lambda vector: divergence(want, vector), before + way, 1e-4)
            - differences(lambda vector: divergence(want, vector), before - way, 1e-4)
            for way in 1e-4 * np.eye(len(before))
        ]) / 2e-4  # fmt: skip
        direction = np.linalg.solve(curvature + 0.1 * np.eye(len(before)), slope)
        moved = after - before
        assert moved @ direction / np.linalg.norm(moved) / np.linalg.norm(direction) > 0.999


def test_a_step_of_trpo_that_gains_nothing_is_not_made():
    """Advantages that are all the same have no gradient; the policy stays, and the run goes on."""
    learner = small("trpo")
    rollout, before = shifted(learner, 0.0), packed(learner.policy)
    rollout.advantage.fill_(0.0)
    learner.step_policy(rollout)
    np.testing.assert_allclose(packed(learner.policy), before, atol=1e-6)


@pytest.mark.parametrize("keep", [0.8, 0.0])
def test_an_average_follows_the_policy(keep):
    """w <- keep w + (1 - keep) policy, written out."""
    learner = small("ppo")
    learner.follow(keep)
    weights = [packed(learner.policy)]
    for _ in range(6):
        with torch.no_grad():
            for parameter in learner.policy.parameters():
                parameter += torch.randn_like(parameter)
        weights.append(packed(learner.policy))
        learner.follow(keep)
    shares = np.array([keep**6, *((1 - keep) * keep ** np.arange(5.0, -1.0, -1.0))])
    assert shares.sum() == pytest.approx(1.0)

    def vector(arrays):
        names = ("net.0.weight", "net.0.bias", "net.2.weight", "net.2.bias", "log_std")
        return np.concatenate([arrays[name].ravel() for name in names])

    wanted, tolerance = shares @ np.array(weights), 1e-5 if keep else 0.0
    np.testing.assert_allclose(vector(learner.acting()), wanted, rtol=0, atol=tolerance)
    learner.normaliser.see(torch.full((3, INPUTS), 9.0))
    np.testing.assert_array_equal(learner.acting()["observation_mean"], learner.normaliser.mean)


def test_a_run_averages_once_an_iteration():
    run = make_run("ppo", minibatches=1, average=0.75)
    before = run.learner.acting()["net.0.weight"]
    run.iterate()
    now, own = run.learner.acting()["net.0.weight"], run.learner.policy.net[0].weight.detach().numpy()
    np.testing.assert_allclose(now, 0.75 * before + 0.25 * own, atol=1e-7)
    assert np.abs(own - before).max() > 1e-4


def test_the_memory_forgets_the_oldest():
    replay = Replay(6, torch.device("cpu"), obs=2, reward=1)
    numbers = torch.arange(20.0)
    for first in range(0, 10, 2):  # ten rows into six
        rows = numbers[first : first + 2]
        replay.add(obs=torch.stack((rows, -rows), dim=1), reward=10.0 * rows)
        assert replay.filled == min(first + 2, 6)
    kept = {name: array.copy() for name, array in replay.arrays().items()}
    assert sorted(kept["replay.reward"][:, 0]) == [40, 50, 60, 70, 80, 90]
    np.testing.assert_array_equal(kept["replay.obs"][:, 1], -kept["replay.reward"][:, 0] / 10)
    drawn = replay.draw(50, 4)
    assert drawn["obs"].shape == (50, 4, 2)
    assert set(drawn["reward"].flatten().tolist()) == {40, 50, 60, 70, 80, 90}
    other = Replay(6, torch.device("cpu"), obs=2, reward=1)
    other.restore(kept)
    for each in (replay, other):
        each.add(obs=torch.full((2, 2), 7.0), reward=torch.full((2,), 7.0))
    for name, array in replay.arrays().items():
        np.testing.assert_array_equal(array, other.arrays()[name])
    assert sorted(other.arrays()["replay.reward"][:, 0]) == [7, 7, 60, 70, 80, 90]


def test_a_memory_that_is_not_full_comes_back_as_it_was():
    replay, other = (Replay(6, torch.device("cpu"), obs=1) for _ in range(2))
    replay.add(obs=torch.ones(2, 1))
    arrays = replay.arrays()
    assert arrays["replay.obs"].shape == (2, 1)
    other.restore(arrays)
    assert other.filled == 2
    other.add(obs=torch.zeros(2, 1))
    assert other.arrays()["replay.obs"][:, 0].tolist() == [1, 1, 0, 0]


def test_sac_keeps_the_observation_that_an_episode_ended_with():
    run = make_run("sac", **KEPT, random_steps=0)
    rows = record(run)
    run.iterate()
    arrays = run.learner.replay.arrays()
    kept, firsts = (
        arrays[f"replay.{name}"][: STEPS * WORLDS].reshape(STEPS, WORLDS, -1) for name in ("next_obs", "obs")
    )
    np.testing.assert_array_equal(kept, np.stack([row[1] for row in rows]).astype(np.float32))
    np.testing.assert_array_equal(firsts, np.stack([row[0] for row in rows]).astype(np.float32))
    ended = np.flatnonzero(rows[HORIZON - 1][4])
    assert ended.size
    assert np.abs(kept[HORIZON - 1, ended] - firsts[HORIZON, ended]).max() > 1e-3  # not the next episode's


def test_noise_of_ppo_may_last():
    """Where it does, actions minus means are those of the step before, in most steps."""
    shares = {}
    for noise in ("white", "repeated"):
        run, seen = make_run("ppo", minibatches=1, noise=noise, initial_std=0.5), {}
        run.learner.update = lambda rollout, seen=seen: seen.update(rollout=rollout)
        run.iterate()
        rollout = seen["rollout"]
        drawn = ((rollout.action - rollout.mean) / rollout.std).view(STEPS, WORLDS, -1)
        shares[noise] = (drawn.diff(dim=0).abs().amax(dim=2) < 1e-5).float().mean().item()
    assert shares["white"] == 0.0
    assert 0.1 < shares["repeated"] < 0.9


def test_a_loss_that_is_not_finite_stops_the_run():
    run = make_run("ppo", minibatches=1)
    run.iterate()
    with torch.no_grad():
        run.learner.value[0].weight[0, 0] = float("nan")
    with pytest.raises(DivergedError, match="value loss was not finite in update 2"):
        run.iterate()


def test_a_weight_that_is_not_finite_stops_the_run():
    """Also one that no loss of the iteration depends on."""
    run = make_run("ppo", minibatches=1, value_first=5)
    with torch.no_grad():
        run.learner.policy.log_std[0] = float("inf")
    with pytest.raises(DivergedError, match="a weight was not finite in update 1"):
        run.iterate()


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_a_learner_made_anew_from_arrays_is_the_same(algorithm):
    given = KEPT if issubclass(ALGORITHMS[algorithm], Replaying) else {"minibatches": 2}
    given = given | ({"copies": WORLDS} if algorithm == "improve" else {})
    run = make_run(algorithm, **given)
    run.iterate()
    run.iterate()
    before = {name: array.copy() for name, array in run.learner.arrays().items()}
    other = make_run(algorithm, **given, seed=5)
    own = other.learner.arrays()
    assert not np.array_equal(own["policy.net.0.weight"], before["policy.net.0.weight"])
    other.learner.restore(before)
    after = other.learner.arrays()
    assert before.keys() == after.keys()
    for name, array in before.items():
        np.testing.assert_array_equal(array, after[name], err_msg=name)


def test_auto_is_bfloat16_where_the_processor_multiplies_it(tmp_path, monkeypatch):
    flags = {"flags\t\t: fpu avx2 avx512f": "float32", "flags\t\t: fpu amx_bf16 amx_tile": "bfloat16"}
    flags |= {
        "flags : avx512_bf16": "bfloat16",
        "Features : fp asimd bf16": "bfloat16",
    }  # the last one is ARM's
    settings = choose("none", "ppo", {})
    monkeypatch.setattr(machine, "Path", lambda name: tmp_path / "cpuinfo")
    assert precision(settings, "cpu") == "float32"  # nothing tells
    for text, wanted in flags.items():
        (tmp_path / "cpuinfo").write_text(f"processor : 0\n{text}\n")
        assert precision(settings, "cpu") == wanted, text
    assert precision(choose("none", "ppo", {"precision": "float32"}), "cpu") == "float32"
    (tmp_path / "cpuinfo").write_text("flags : fpu\n")
    assert precision(choose("none", "ppo", {"precision": "bfloat16"}), "cpu") == "bfloat16"
    assert precision(settings, "cuda:0") == "bfloat16"


def test_a_loss_in_bfloat16_is_near_that_in_float32():
    """Products alone are rounded, to 8 bits: weights, losses and what is stepped stay float32."""
    found = {}
    for kind in ("float32", "bfloat16"):
        learner = small("ppo", precision=kind, gradient_norm=0.0)
        learner.update_policy(rollout_of(learner))
        found[kind] = learner.figures()["policy_loss"], slopes(learner)
        assert learner.policy(torch.zeros(1, INPUTS)).dtype == torch.float32
    assert 0.0 < abs(found["bfloat16"][0] - found["float32"][0]) < 0.02
    apart = np.abs(found["bfloat16"][1] - found["float32"][1]).max()
    assert 0.0 < apart < 0.1 * np.abs(found["float32"][1]).max()
    with small("ppo", precision="float32").products():
        assert (torch.ones(2, 2) @ torch.ones(2, 2)).dtype == torch.float32


def test_a_run_that_counted_all_columns_at_once_goes_on():
    run = make_run("ppo", minibatches=2)
    run.iterate()
    kept = run.learner.arrays()
    kept["normaliser.count"] = kept["normaliser.count"][0]
    other = make_run("ppo", minibatches=2)
    other.learner.restore(kept)
    np.testing.assert_array_equal(other.learner.normaliser.count, run.learner.normaliser.count)
