"""A run between two iterations: worlds, learner, the average of its policy, and what a checkpoint holds."""

from __future__ import annotations

import dataclasses
import math
import time
from itertools import chain
from typing import Any

import numpy as np
import torch

from myowarp.apps.policies.checkpoint import Checkpoint
from myowarp.apps.policies.find import acting, find_policy
from myowarp.apps.reports.machine import multiplies_bfloat16
from myowarp.apps.rollouts.ranks import ALONE, Ranks
from myowarp.apps.train import bonus
from myowarp.apps.train.arrays import Arrays, below, put
from myowarp.apps.train.dagger import DAgger, Imitation
from myowarp.apps.train.improve import Improve
from myowarp.apps.train.learner import Learner
from myowarp.apps.train.ppo import PPO
from myowarp.apps.train.recurrent import RecurrentPPO
from myowarp.apps.train.sac import SAC
from myowarp.apps.train.settings import Settings
from myowarp.apps.train.trpo import TRPO
from myowarp.apps.train.worlds import Worlds
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.sim.state import State

LEARNERS = {"ppo": PPO, "trpo": TRPO, "sac": SAC, "dagger": DAgger, "improve": Improve}
RANK_SEEDS = 1_000_003  # from the seed of one rank's actions to that of the next
INHERITED_STEPS = 32
"""Control steps of every world as which all counts that a parent's normaliser has seen in another task."""
AGENT = "agent."
OF_RANKS = ("agent.noise.", "agent.remembered", "agent.torch_generator", "agent.cuda_generator")
"""Begins of names of the learner's arrays of which every rank has rows of its own: one a world, or one."""
FIGURES = ("policy_loss", "value_loss", "critic_loss", "action_std", "kl", "learning_rate", "entropy_weight")
"""Columns of `progress.csv` in every run; NaN where an algorithm has none."""


class DivergedError(RuntimeError):
    """A loss or a weight is not finite."""


class Run:
    """A training run between two iterations.

    Attributes:
        worlds: The worlds of this rank.
        learner: What learns.
        updates: Iterations so far.
        losses: Figures of the last iteration's updates.
        faults: Kinds of faults that worlds of any rank had in this process, in words.
    """

    def __init__(
        self,
        env: MyoWarpVectorEnv,
        settings: Settings,
        parent: Checkpoint | None = None,
        start: State | None = None,
        ranks: Ranks = ALONE,
    ) -> None:
        """Seed everything and make the learner.

        Args:
            env: Environment, with this rank's worlds; its seed is that of networks and actions, too.
            settings: Settings of all ranks together.
            parent: Whose policy the run starts from; None: networks are drawn.
            start: States that episodes start in, world i in the i-th, over and over; None: resets.
            ranks: This process among those of the run.
        """
        settings = dataclasses.replace(settings, precision=precision(settings, str(env.sim.scene.device)))
        self.settings, self.ranks, seed = settings, ranks, env.sim.setup.seed or 0
        torch.manual_seed(seed)
        self.worlds = Worlds(env, start, bonus.weights(settings.bonus), settings.start_share)
        own = dataclasses.replace(settings, num_worlds=env.num_envs)
        self.learner = learner_of(settings)(own, self.worlds, ranks)
        self._let_expert_act()
        if parent is not None:
            blocks = (env.sim.blocks[name] for name, *_ in parent.manifest["contract"]["columns"])
            places = np.concatenate([np.arange(block.start, block.stop) for block in blocks])
            seen, same = parent.manifest["samples"], parent.task == env.sim.scene.spec.key
            known = seen if same else settings.num_worlds * INHERITED_STEPS
            self.learner.inherit(parent.policy, seen, settings.parent_samples or known, places)
        self.learner.follow(settings.average)
        if not ranks.leads:  # one policy, but actions of its own
            torch.manual_seed(seed + RANK_SEEDS * ranks.rank)
        self.updates = 0
        self.losses: dict[str, float] = {}
        self.faults: list[str] = []

    @property
    def env(self) -> MyoWarpVectorEnv:
        """The environment."""
        return self.worlds.env

    @property
    def samples(self) -> int:
        """Control steps of all worlds so far, those of other ranks included."""
        return self.worlds.steps * self.settings.num_worlds

    def iterate(self) -> None:
        """Do one iteration: control steps, and the updates that belong to them.

        Raises:
            DivergedError: A loss or a weight is not finite.
            FaultyTaskError: All worlds have had faults for a while.
        """
        clock, begin, cpu = self.worlds.clock, time.perf_counter(), time.process_time()
        simulation, learner, tally = clock.simulation, self.learner, self.worlds.tally
        learner.set_rates(self.samples / self.settings.samples)
        learner.iterate(self.worlds)
        losses = learner.figures()
        clock.learner += time.perf_counter() - begin - (clock.simulation - simulation)
        learner.follow(self.settings.average)
        self.updates += 1
        # All ranks have the episodes that ended on any, the mean of their losses, and the faults.
        own = tally.take(), losses, [*self.worlds.kinds.values()]
        episodes, all_losses, kinds = zip(*self.ranks.everyones(own), strict=True)
        self.faults = list(dict.fromkeys(chain(self.faults, *kinds)))
        tally.keep(np.concatenate(episodes))
        self.losses = {name: float(np.mean([rank[name] for rank in all_losses])) for name in losses}
        clock.total += time.perf_counter() - begin
        clock.cpu += time.process_time() - cpu
        wrong = [name.replace("_", " ") for name, value in self.losses.items() if not math.isfinite(value)]
        finite = torch.stack([weights.detach().sum() for weights in learner.parameters()]).isfinite().all()
        if wrong or not finite:
            raise DivergedError(f"{[*wrong, 'a weight'][0]} was not finite in update {self.updates}")

    def move(self, env: MyoWarpVectorEnv) -> None:
        """Let the worlds go on, as they are, in another environment of the task; the one before is closed."""
        self.worlds.move(env)
        self._let_expert_act()

    def _let_expert_act(self) -> None:
        """Bind the expert of an imitation to the environment."""
        if isinstance(self.learner, Imitation) and self.learner.settings.expert:
            sim = self.env.sim
            self.learner.expert = acting(find_policy(self.learner.settings.expert, sim.scene.spec), sim)

    def row(self) -> dict[str, float]:
        """Return the figures of the last iteration."""
        clock = self.worlds.clock
        shares = {f"share_{name}": value for name, value in clock.shares().items()}
        figures = {"samples": self.samples, "updates": self.updates, "seconds": clock.total}
        rate = {"samples_per_s": self.samples / max(clock.total, 1e-9)}
        losses = dict.fromkeys(FIGURES, math.nan) | self.losses
        return {**figures, **self.worlds.tally.figures(), **rate, **shares, **losses}

    def manifest(self) -> dict[str, Any]:
        """Return the plain numbers of a checkpoint."""
        return {
            "samples": self.samples,
            "steps": self.worlds.steps,
            "updates": self.updates,
            "ranks": self.ranks.size,
            "clock": dataclasses.asdict(self.worlds.clock),
            "figures": self.worlds.tally.figures(),
            "policy": self.learner.form(),
        }

    def arrays(self) -> Arrays:
        """Return what a resumed run needs besides the average policy; on the rank that saves."""
        state = {AGENT + name: array for name, array in self.learner.arrays().items()}
        own = {name: state.pop(name) for name in [*state] if name.startswith(OF_RANKS)}
        return state | self.ranks.rows(self.worlds.rows() | own) | self.worlds.arrays()

    def restore(self, checkpoint: Checkpoint) -> None:
        """Put back everything that a checkpoint of this run holds.

        Raises:
            KeyError: An array is missing.
            RuntimeError: An array of the learner does not fit.
            ValueError: An array of the environment does not fit.
        """
        state, manifest, rows = checkpoint.state(), checkpoint.manifest, self.worlds.rows()
        own = [name for name in state if name in rows or name.startswith(OF_RANKS)]
        state |= {name: self.ranks.own(state[name]) for name in own}
        self.worlds.restore(state, manifest["steps"], manifest["clock"])
        self.updates = manifest["updates"]
        put(self.learner.average, checkpoint.policy)
        self.learner.restore(below(state, AGENT))


def learner_of(settings: Settings) -> type[Learner]:
    """Return what learns by some settings."""
    return RecurrentPPO if getattr(settings, "memory", 0) else LEARNERS[settings.algorithm]


def precision(settings: Settings, device: str) -> str:
    """Return the precision of products; auto is bfloat16 where the device multiplies it."""
    if settings.precision != "auto":
        return settings.precision
    return "bfloat16" if device.startswith("cuda") or multiplies_bfloat16() else "float32"
