"""A training of two iterations, its options, and the one sentence of a command that failed."""

import pytest

from myowarp.apps.train.plan import plan
from myowarp.apps.train.run import train

ELBOW = "myoElbowPose1D6MRandom-v0"
TINY = ("--num-worlds", 8, "--rollout-steps", 8, "--minibatches", 2, "--hidden", 16, "--device", "cpu")
TINY += ("--selections", 0)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Return the folder of a run of two iterations."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    settings = {"num_worlds": 8, "rollout_steps": 8, "minibatches": 2, "hidden": (16,), "samples": 128}
    train(plan(ELBOW, output=folder, device="cpu", selections=0, **settings))
    return folder


@pytest.fixture
def no_simulation(monkeypatch):
    """Whoever builds a simulation fails."""

    def refuse(*args, **options):
        pytest.fail("a simulation was built")

    monkeypatch.setattr("myowarp.bridge_gym.MyoWarpVectorEnv.__init__", refuse)


def said(result):
    """Return the one sentence of a command that failed."""
    status, _, err = result
    assert status == 2, err
    (line,) = [line for line in err.splitlines() if line.startswith("myowarp: ")]
    return line.removeprefix("myowarp: ")
