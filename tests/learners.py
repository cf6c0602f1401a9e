"""Learners without a simulation, and worlds that are drawn."""

from types import SimpleNamespace

import torch

from myowarp.apps.rollouts.ranks import ALONE
from myowarp.apps.train.loop import learner_of
from myowarp.apps.train.settings import choose
from myowarp.apps.train.worlds import Clock, Step

HORIZON = 20


def parents(algorithm):
    """Return what an algorithm needs besides its sizes."""
    return {"expert": "hold"} if algorithm == "improve" else {}


class DrawnWorlds:
    """Observations and rewards from a distribution, for a learner in place of `Worlds`.

    Attributes:
        reward: Function from actions to rewards; by default they lie between 1 and 2.
        terminated: Whether each step ends the episode.
    """

    def __init__(self, num_worlds, num_obs, num_actions, *, terminated=False):
        self.num_worlds, self.num_obs, self.num_actions = num_worlds, num_obs, num_actions
        self.device, self.clock, self.steps = torch.device("cpu"), Clock(), 0
        self.obs = torch.randn(num_worlds, num_obs)
        self.terminated, self.reward = terminated, lambda action: 1.0 + torch.rand(num_worlds)
        self.env = SimpleNamespace(sim=SimpleNamespace(horizon=HORIZON))

    def step(self, action):
        """Return what a control step led to."""
        self.steps += 1
        self.obs = torch.randn_like(self.obs)
        ended, no = torch.full((self.num_worlds,), self.terminated), torch.zeros(self.num_worlds) > 0
        return Step(self.obs.clone(), self.reward(action), ended, no, no)


def make_learner(algorithm, num_obs=6, num_actions=3, **given):
    """Return a learner with the defaults of its algorithm, besides what is given."""
    settings = choose("none", algorithm, parents(algorithm) | given)
    worlds = DrawnWorlds(settings.num_worlds, num_obs, num_actions)
    return learner_of(settings)(settings, worlds, ALONE)
