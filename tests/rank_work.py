"""What each rank does in `test_ranks.py`: `torchrun tests/rank_work.py FOLDER` writes FOLDER/rank_<r>.npz."""

import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from myowarp.apps.rollouts.ranks import Ranks
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.models.conditions import MotorNoise, Sarcopenia, Uniform

TASK = "myoElbowPose1D6MRandom-v0"
ALL_WORLDS, STEPS, SEED = 10, 12, 5
SETTINGS = {
    "num_worlds": 8,
    "rollout_steps": 16,
    "minibatches": 4,
    "epochs": 3,
    "hidden": [16, 16],
    "noise": "repeated",
    "device": "cpu",
}
ITERATIONS = 8  # past the first end of an episode, at 100 steps


def moved(rank=(0, 1)):
    """Return what worlds show under the same actions: patients of every kind, resets in between."""
    rng = np.random.default_rng(1)
    actions = rng.uniform(-1.0, 1.0, (STEPS, ALL_WORLDS, 6)).astype(np.float32)
    again = rng.random((STEPS, ALL_WORLDS)) < 0.2
    number = ALL_WORLDS // rank[1]
    own = slice(rank[0] * number, (rank[0] + 1) * number)
    patients = (
        Sarcopenia(np.linspace(0.3, 1.0, ALL_WORLDS)),
        MotorNoise(signal=Uniform(0.0, 0.2), constant=np.arange(ALL_WORLDS) / 100),
    )
    env = MyoWarpVectorEnv(
        TASK, number, rank=rank, conditions=patients, device="cpu", autoreset_mode="disabled", progress=False
    )
    seen = [env.reset(seed=SEED)[0]]
    for action, mask in zip(actions[:, own], again[:, own], strict=True):
        obs, reward, *_ = env.step(action)
        seen += [obs, reward[:, None]]
        if mask.any():
            seen.append(env.reset(options={"reset_mask": mask})[0])
        else:
            seen.append(obs)
    env.close()
    return np.concatenate(seen, axis=1)


def learned(**settings):
    """Return everything that a learner holds after a few iterations, and what a checkpoint has of it."""
    from myowarp.apps.train.plan import plan
    from myowarp.apps.train.run import start

    run, actions = start(plan(TASK, algorithm="ppo", output=Path("unwritten"), **SETTINGS | settings)), []
    update = run.learner.update

    def noted(rollout):
        actions[:] = [rollout.action.numpy().copy()]
        update(rollout)

    run.learner.update = noted
    for _ in range(ITERATIONS):
        run.iterate()
    arrays = {f"learned.{name}": array.copy() for name, array in run.learner.arrays().items()}
    arrays |= {f"average.{name}": array for name, array in run.learner.acting().items()}
    arrays["actions"] = actions[0]
    arrays["figures"] = np.array(list(run.worlds.tally.figures().values()))
    arrays |= {f"saved.{name}": array.copy() for name, array in run.arrays().items()}
    run.env.close()
    return arrays


@contextmanager
def counted():
    """Count the sums over ranks while the block lasts."""
    import torch

    reduce, calls = torch.distributed.all_reduce, []
    torch.distributed.all_reduce = lambda *of, **options: calls.append(1) or reduce(*of, **options)
    try:
        yield calls
    finally:
        torch.distributed.all_reduce = reduce


def main():
    """Do the work of a rank."""
    import torch

    ranks = Ranks.started()
    with ranks.together("cpu"):
        from myowarp.apps.train.networks import Normaliser

        normaliser = Normaliser(3)
        normaliser.see(torch.from_numpy(batch()[ranks.rank]), ranks)
        with counted() as calls:
            arrays = learned()
        with counted() as aimed:
            learned(kl=1e-3)
        arrays |= {"sums": np.array(len(calls)), "sums with an aim": np.array(len(aimed))}
    arrays["threads"] = np.array(
        [path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm")]
    )
    arrays |= {name: tensor.numpy() for name, tensor in normaliser.state_dict().items()}
    arrays |= {"moved": moved(ranks.part)}
    np.savez(Path(sys.argv[1]) / f"rank_{ranks.rank}.npz", **arrays)


def batch():
    """Return samples of two ranks whose means lie ten standard deviations apart, shape (2, 40, 3)."""
    rng = np.random.default_rng(2)
    return rng.normal(size=(2, 40, 3)) * [1.0, 0.1, 5.0] + np.array([0.0, 10.0])[:, None, None]


def alone():
    """Return the moments of the samples of both, by NumPy, beside one of mean 0 and variance 1."""
    both = np.concatenate(batch())
    count = len(both) + 1
    mean = both.sum(axis=0) / count
    return mean, (1.0 + (both**2).sum(axis=0)) / count - mean**2, count


if __name__ == "__main__":
    main()
