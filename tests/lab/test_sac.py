"""SAC's parts beside float64 NumPy, and gradient steps beside their definition."""

import dataclasses

import numpy as np
import pytest
import torch
from learners import DrawnWorlds, make_learner
from torch import nn

from myowarp.apps.train.networks import REPEATS, Critics, RepeatedNoise
from myowarp.apps.train.sac import BOUND, RewardScale, project

ATOMS = torch.linspace(-BOUND, BOUND, 21)
FLOAT32 = 1e-6
BFLOAT16 = 2.0**-8  # its rounding, relative
OBS, ACTIONS, WORLDS = 6, 3, 8
SMALL = {"num_worlds": WORLDS, "replay": 64, "batch_size": 16, "gradient_steps": 1, "random_steps": 0}
SMALL |= {
    "hidden": (16,),
    "critic_width": 8,
    "critic_blocks": 1,
    "precision": "float32",
    "discount": 0.5,
    "learning_rate": 3e-3,
    "rollout_steps": 8,
}


def projected(values, probabilities, atoms):
    """Return the projection of Bellemare et al. 2017 by its definition: triangles around atoms."""
    gap = atoms[1] - atoms[0]
    shares = np.clip(1.0 - np.abs(np.clip(values, atoms[0], atoms[-1])[:, :, None] - atoms) / gap, 0.0, 1.0)
    return (probabilities[:, :, None] * shares).sum(axis=1)


def test_the_projection_is_that_of_the_paper_and_keeps_the_mean():
    rng = np.random.default_rng(0)
    probabilities = rng.dirichlet(np.ones(21), size=50).astype(np.float32)
    values = (0.9 * ATOMS.numpy() + rng.uniform(-2.0, 2.0, (50, 1))).astype(np.float32)
    values[0] = ATOMS.numpy()  # on the atoms, the outermost ones among them
    got = project(torch.from_numpy(values), torch.from_numpy(probabilities), ATOMS).numpy()
    want = projected(values.astype(float), probabilities.astype(float), ATOMS.numpy().astype(float))
    np.testing.assert_allclose(got, want, atol=5 * FLOAT32)
    inside = np.abs(values).max(axis=1) <= BOUND
    assert 5 < inside.sum() < 50
    mean = (probabilities * values).sum(axis=1)
    np.testing.assert_allclose((got @ ATOMS.numpy())[inside], mean[inside], atol=2e-5)
    assert np.abs(got - probabilities)[1:].max() > 0.01


def test_noise_stays_as_long_as_the_law_says_and_is_normal():
    torch.manual_seed(0)
    noise, rows = RepeatedNoise(500, 2), []
    for _ in range(1000):
        rows.append(noise.next().numpy().copy())
    seen = np.array(rows)[:, :, 0]
    changed = np.diff(seen, axis=0) != 0.0
    lengths = np.concatenate([np.diff(np.flatnonzero(world)) for world in changed.T])
    law = 1.0 / np.arange(1, REPEATS + 1) ** 2
    law /= law.sum()
    share = np.bincount(lengths, minlength=REPEATS + 1)[1:] / len(lengths)
    assert lengths.max() == REPEATS
    np.testing.assert_allclose(share, law, atol=0.005)
    fresh = seen[1:][changed]
    assert abs(fresh.mean()) < 0.02
    assert abs(fresh.std() - 1.0) < 0.02


def test_the_scale_follows_discounted_sums_of_episodes():
    rng = np.random.default_rng(1)
    scale, sums, seen = RewardScale(WORLDS, 0.8), np.zeros(WORLDS), []
    for _ in range(300):
        rewards, ended = rng.normal(1.0, 2.0, WORLDS).astype(np.float32), rng.random(WORLDS) < 0.1
        scale.see(torch.from_numpy(rewards), torch.from_numpy(ended))
        sums = 0.8 * sums + rewards
        seen.append(sums.copy())
        sums[ended] = 0.0
    deviation, most = np.std(seen), np.abs(seen).max()
    assert scale.value() == pytest.approx(max(deviation, most / BOUND), rel=1e-6)
    assert abs(deviation - most / BOUND) > 0.01
    scale.see(torch.full((WORLDS,), 1000.0), torch.ones(WORLDS, dtype=torch.bool))
    assert scale.value() == pytest.approx((1000.0 + 0.8 * sums).max() / BOUND, rel=1e-6)


def filled(terminated, **given):
    """Return a learner that has seen control steps with rewards of one sign and ends as given."""
    torch.manual_seed(2)
    torch.set_num_threads(1)
    learner = make_learner("sac", OBS, ACTIONS, **SMALL | {"batch_size": 64} | given)
    worlds = DrawnWorlds(WORLDS, OBS, ACTIONS, terminated=terminated)
    learner.iterate(worlds)
    learner.settings = dataclasses.replace(learner.settings, batch_size=16)
    return learner


@pytest.mark.parametrize("terminated", [True, False])
def test_critics_learn_what_follows(terminated):
    """After a termination the value is the reward alone, from 1 to 2; else a geometric series follows."""
    learner = filled(terminated, temperature=1e-6, target_rate=0.05)
    for _ in range(250):
        learner.update()
    kept = learner.replay.arrays()
    obs, action = (torch.from_numpy(kept[f"replay.{name}"]) for name in ("obs", "action"))
    with torch.no_grad():
        values = learner.critics(learner.normaliser(obs), action).softmax(dim=-1) @ learner.atoms
    got = values.amin(dim=0).numpy() * learner.scale.value()
    immediate = kept["replay.reward"][:, 0]
    if terminated:
        assert np.abs(got - immediate).mean() < 0.25
    else:
        # Mean reward 1.5, discount 0.5: 3.0 on average, less what the smaller of two critics costs.
        assert 2.7 < got.mean() < 3.1


def test_the_memory_holds_what_was_seen_and_done():
    learner = filled(False)
    assert learner.replay.filled == 64
    kept = learner.replay.arrays()
    for step in range(7):  # a row is followed by the one of the next step
        rows, after = (
            slice(step * WORLDS, (step + 1) * WORLDS),
            slice((step + 1) * WORLDS, (step + 2) * WORLDS),
        )
        np.testing.assert_array_equal(kept["replay.next_obs"][rows], kept["replay.obs"][after])
    assert (kept["replay.reward"] >= 1.0).all()
    assert (kept["replay.terminated"] == 0.0).all()


def test_noise_scale_and_temperature_are_in_a_checkpoint():
    learner = filled(False)
    arrays = learner.arrays()
    assert {"noise.noise", "noise.left", "scale.sums", "log_temperature", "gradient_steps"} <= arrays.keys()
    assert np.abs(arrays["noise.noise"]).min() > 0.0


def test_the_temperature_follows_the_entropy():
    """It falls while the entropy of an action is above the aim, and rises below it."""
    for aim, sign in ((-5.0, -1.0), (5.0, 1.0)):
        learner = filled(False, target_entropy=aim, temperature=0.02)  # one update was due
        moved = learner.log_temperature.item() - np.log(0.02)
        assert moved == pytest.approx(sign * 3e-3, rel=1e-2)  # Adam's first step


def test_without_a_rate_nothing_is_learned():
    """Weights do not decay either."""
    learner = filled(False, learning_rate=0.0)
    before = {name: array.copy() for name, array in learner.arrays().items() if name.startswith("critics")}
    learner.update()
    for name, array in before.items():
        np.testing.assert_array_equal(array, learner.arrays()[name], err_msg=name)


def apart(critics, number):
    """Return one of the two critics as layers of torch's own."""

    def linear(pair):
        layer = nn.Linear(*pair.weight.shape[1:])
        layer.weight.data, layer.bias.data = pair.weight[number].T.clone(), pair.bias[number, 0].clone()
        return layer

    def norm(pair):
        layer = nn.LayerNorm(pair.weight.shape[-1])
        layer.weight.data, layer.bias.data = pair.weight[number, 0].clone(), pair.bias[number, 0].clone()
        return layer

    blocks = [
        nn.Sequential(norm(block[0]), linear(block[1]), nn.ReLU(), linear(block[3]))
        for block in critics.blocks
    ]
    last = nn.Sequential(norm(critics.last[0]), linear(critics.last[1]))
    return nn.ModuleList([linear(critics.first), *blocks, last])


def test_two_critics_side_by_side_are_two_critics():
    """Values and gradients of each are those of a network that was built from its weights alone."""
    torch.manual_seed(0)
    critics = Critics(OBS + ACTIONS, 8, 2, 21)
    with torch.no_grad():
        for parameter in critics.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
    obs, action = torch.randn(40, OBS), torch.rand(40, ACTIONS)
    logits = critics(obs, action)
    (logits.square().sum() / 40).backward()
    assert (logits[0] - logits[1]).abs().max() > 0.1
    for number in (0, 1):
        first, *blocks, last = layers = apart(critics, number)
        x = first(torch.cat((obs, action), dim=1))
        for block in blocks:
            x = x + block(x)
        own = last(x)
        np.testing.assert_allclose(logits[number].detach(), own.detach(), atol=10 * FLOAT32)
        (own.square().sum() / 40).backward()
        for pair, layer in ((critics.first, layers[0]), (critics.last[1], layers[-1][1])):
            np.testing.assert_allclose(pair.weight.grad[number], layer.weight.grad.T, atol=20 * FLOAT32)
        np.testing.assert_allclose(critics.last[0].weight.grad[number, 0], last[0].weight.grad, atol=1e-4)


def test_losses_in_bfloat16_are_near_those_in_float32():
    """Products alone are rounded; weights, sums and the optimiser stay float32."""
    learner = filled(False)
    batch = learner.replay.draw(64)
    obs, losses = learner.normaliser(batch["obs"]), {}
    target = torch.full((2, 64), 10)
    for precision in ("float32", "bfloat16"):
        learner.settings = dataclasses.replace(learner.settings, precision=precision)
        with learner.products():
            logits = learner.critics(obs, batch["action"])
        assert logits.dtype == torch.float32
        losses[precision] = nn.functional.cross_entropy(logits.flatten(0, 1), target.flatten()).item()
    assert 0.0 < abs(losses["bfloat16"] / losses["float32"] - 1.0) < BFLOAT16
    assert {parameter.dtype for parameter in learner.parameters()} == {torch.float32}
