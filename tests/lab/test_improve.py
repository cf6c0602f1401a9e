"""A search by copies of states: which copies live on, that its ways can be gone, and that it helps."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from elbows import learner_env

from myowarp.apps.train.improve import survivors
from myowarp.apps.train.loop import Run
from myowarp.apps.train.plan import plan
from myowarp.apps.train.settings import choose
from myowarp.sim.state import State

ELBOW = "myoElbowPose1D6MRandom-v0"
WORLDS, COPIES, HORIZON = 12, 4, 23
SMALL = {
    "num_worlds": WORLDS,
    "copies": COPIES,
    "every": 5,
    "expert": "hold",
    "hidden": (16,),
    "replay": 10 * HORIZON,
    "batch_size": 32,
    "gradient_steps": 3,
    "initial_std": 0.5,
    "samples": WORLDS * HORIZON * 4,
    "selections": 0,
}


def make_run(**settings):
    """Return a run over a few elbows with short episodes."""
    return Run(learner_env(WORLDS, HORIZON), choose("none", "improve", SMALL | settings))


def test_the_best_copies_of_each_start_live_on():
    score = torch.tensor([[3.0, -torch.inf, 7.0, 5.0], [1.0, 2.0, -torch.inf, -torch.inf]])
    assert survivors(score, 2).tolist() == [2, 3, 2, 3, 5, 4, 5, 4]
    assert survivors(score, 1).tolist() == [2, 2, 2, 2, 5, 5, 5, 5]


def test_the_way_of_every_copy_can_be_gone_from_its_start():
    """Actions of a way, played from the start without any copying, lead to its observations bit for bit."""
    run = make_run()
    worlds = run.worlds
    starts, restart = [], worlds.copy

    def noted(rows):
        restart(rows)
        starts.append(worlds.env.get_state())

    worlds.copy = noted
    obs, output, success = run.learner.search(worlds)
    assert len(starts) == 1 + (HORIZON - 1) // SMALL["every"]
    assert success.shape == (WORLDS // COPIES, COPIES)
    other = learner_env(WORLDS, HORIZON)
    other.reset(seed=9)
    begin = {name: rows for name, rows in starts[0].arrays.items() if not name.startswith("keys.")}
    seen = other.set_state(State(starts[0].task, begin), conditions=False).clone()
    for t in range(HORIZON):
        np.testing.assert_array_equal(seen.numpy(), obs[t].numpy())
        seen = other.step(output[t].tanh())[0].clone()
    # Copies of a start begin alike, and most of them end otherwise than they would have without copying.
    first = obs[0].view(WORLDS // COPIES, COPIES, -1)
    assert (first == first[:, :1]).all()
    assert (first[0] != first[1]).any()


def test_only_episodes_that_succeeded_are_imitated():
    run = make_run()
    run.iterate()
    kept = run.learner.replay.filled
    assert kept % HORIZON == 0
    assert kept > 0
    search = run.learner.search

    def failing(worlds):
        obs, output, success = search(worlds)
        return obs, output, torch.zeros_like(success)

    run.learner.search = failing
    run.iterate()
    assert run.learner.replay.filled == kept
    assert run.losses["solved_starts"] == 0.0


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"num_worlds": 100}, "--num-worlds must be a multiple of the 32 --copies, got 100"),
        ({"expert": ""}, "improve needs a policy to search around; name it with --parent or --expert"),
        ({"keep": 40}, "--keep must be at most --copies, 32, got 40"),
        ({"expert": "nobody"}, "policy 'nobody' unknown; available: random, zero"),
    ],
)
def test_what_cannot_be_searched_is_refused_before_anything_is_built(settings, sentence, tmp_path):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        plan(ELBOW, algorithm="improve", output=tmp_path / "run", **{"expert": "hold"} | settings)
    assert not (tmp_path / "run").exists()


def test_copies_of_a_start_are_one_patient(tmp_path):
    (tmp_path / "patients.csv").write_text("patient,strength\nwell,1.0\nweak,0.4\n")
    given = {"expert": "hold", "cohort": str(tmp_path / "patients.csv"), "copies": 12}
    sentence = (
        "--num-worlds must give each of the 2 patients of --cohort a multiple of the 12 --copies, which are"
        " one patient, got 36"
    )
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        plan(ELBOW, algorithm="improve", output=tmp_path / "run", num_worlds=36, **given)
    assert plan(ELBOW, algorithm="improve", output=tmp_path / "run", num_worlds=48, **given)


def test_a_memory_that_holds_no_episode_is_refused():
    with pytest.raises(
        ValueError, match=f"^--replay must hold an episode of {HORIZON} control steps, got 22$"
    ):
        make_run(replay=22, batch_size=16)


def test_a_run_of_searches_is_resumed_bit_for_bit(tmp_path):
    whole = make_run()  # torch's generator is one for all: one run after the other
    for _ in range(4):
        whole.iterate()
    wanted = whole.arrays()
    first = make_run()
    for _ in range(2):
        first.iterate()
    saved = SimpleNamespace(manifest=first.manifest(), policy=first.learner.acting())
    arrays = first.arrays()
    saved.state = lambda: arrays
    second = make_run()
    second.restore(saved)
    for _ in range(2):
        second.iterate()
    assert first.learner.replay.filled > 0
    for name, array in wanted.items():
        np.testing.assert_array_equal(array, second.arrays()[name], err_msg=name)


@pytest.mark.slow
def test_a_policy_that_nearly_succeeds_gets_better(run, tmp_path):
    """From a parent that was hardly trained, in a few searches."""
    small = ("--hidden", 32, 32, "--selections", 1, "--device", "cpu", "--stop-success", 2)
    status, _, err = run(
        *("train", ELBOW, "--algorithm", "ppo", "--samples", 4096, "--output", tmp_path / "parent", *small)
    )
    assert status == 0, err
    status, _, err = run(
        *("improve", tmp_path / "parent", "--output", tmp_path / "child", "--samples", 512 * 100 * 10),
        *("--num-worlds", 512, "--copies", 16, "--learning-rate", 1e-3, "--selections", 4),
        *("--device", "cpu", "--stop-success", 2),
    )
    assert status == 0, err
    scores = [
        float((tmp_path / who / "report.json").read_text().split('"success": ')[1].split(",")[0])
        for who in ("parent", "child")
    ]
    assert scores[1] > scores[0] + 0.15
