"""The loop: act, step, record, update; save now and then; stop on success, at the end, when asked, on NaN.

skrl's trainer and wrappers are not used, because truncation is right only with all of: no autoreset, so that
the observation that an episode ended with is recorded; resets of what ended by mask; bootstrap at the time
limit from that observation; and rewards that the learner may change.
"""

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
from myowarp.apps.train import agents
from myowarp.apps.train.ranks import ALONE, Ranks
from myowarp.apps.train.settings import DAggerSettings, Settings
from myowarp.apps.train.tally import Tally
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.sim.state import State

GENERATORS = ("agent.torch_generator", "agent.cuda_generator")
"""Arrays of which every rank has one of its own."""

RANK_SEEDS = 1_000_003  # from the seed of one rank's actions to that of the next

INHERITED_STEPS = 32
"""Control steps of every world as which all counts that a parent's normaliser has seen in another task."""


FAULTY_STEPS = 50
"""Control steps in a row in which every world has a fault, after which none will ever be without."""


class DivergedError(RuntimeError):
    """A loss or a weight is not finite."""


class FaultyTaskError(RuntimeError):
    """No world of the task can be stepped."""


@dataclasses.dataclass
class Clock:
    """Seconds spent in parts of a run.

    Attributes:
        simulation: In control steps and resets.
        learner: In actions and updates.
        total: In iterations; what other work on the same cores took is part of it.
        cpu: Of all cores, in iterations; what other work on the same cores took is no part of it.
    """

    simulation: float = 0.0
    learner: float = 0.0
    total: float = 0.0
    cpu: float = 0.0

    def shares(self) -> dict[str, float]:
        """Return the shares of simulation, learner and rest."""
        total = max(self.total, 1e-9)
        rest = self.total - self.simulation - self.learner
        return {
            "simulation": self.simulation / total,
            "learner": self.learner / total,
            "rest": max(rest, 0.0) / total,
        }


class Run:
    """A training run between two iterations.

    Attributes:
        env: Environment without autoreset, with views of the simulation as tensors.
        agent: skrl's agent.
        tally: Returns and successes.
        clock: Where the time went, earlier processes of a resumed run included.
        steps: Control steps of every world so far.
        updates: Iterations so far.
        losses: What the last update tracked.
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
        """Seed everything and make the agent.

        Args:
            env: Environment, with this rank's worlds; its seed is that of networks and actions, too.
            settings: Settings of all ranks together.
            parent: Whose policy the run starts from; None: networks are drawn.
            start: States that episodes start in, world i in the i-th, over and over; None: resets.
            ranks: This process among those of the run.
        """
        self.settings, self.ranks = settings, ranks
        self.device, seed = str(env.sim.scene.device), env.sim.setup.seed or 0
        torch.manual_seed(seed)
        observation, action = env.single_observation_space, env.single_action_space
        own = dataclasses.replace(settings, num_worlds=env.num_envs)
        self.agent = agents.make_agent(own, observation, action, self.device)
        self._enter(env)
        if parent is not None:
            seen, same = parent.manifest["samples"], parent.task == env.sim.scene.spec.key
            known = seen if same else settings.num_worlds * INHERITED_STEPS
            agents.inherit(self.agent, parent.policy, seen, settings.parent_samples or known)
        if not ranks.leads:
            torch.manual_seed(seed + RANK_SEEDS * ranks.rank)  # one policy, but actions of its own
        self.tally = Tally(env.num_envs, self.device)
        self.clock = Clock()
        self.steps = self.updates = 0
        self.losses: dict[str, float] = {}
        self.faults: list[str] = []
        self._kinds: dict[int, str] = {}  # of this rank, by bits
        self._faulty_steps = 0
        self._start = None
        if start is not None:
            rows = (env.sim.scene.worlds.offset + np.arange(env.num_envs)) % len(start)
            # Each episode has random numbers of its own, and draws its patients and noise anew.
            kept = {name: array for name, array in start.arrays.items() if not name.startswith("keys.")}
            self._start = State(start.task, {name: array[rows] for name, array in kept.items()})
        obs, _ = env.reset(seed=seed)
        if self._start is not None:
            obs = env.set_state(self._start, conditions=False)
        self._obs = obs.clone()  # what is acted on; `obs` is overwritten by the next step

    @property
    def samples(self) -> int:
        """Control steps of all worlds so far, those of other ranks included."""
        return self.steps * self.settings.num_worlds

    def iterate(self) -> None:
        """Do one iteration: control steps, and the updates that belong to them.

        Raises:
            DivergedError: A loss or a weight is not finite.
            FaultyTaskError: All worlds have had faults for a while.
        """
        begin, cpu = time.perf_counter(), time.process_time()
        alone = self.updates < getattr(self.settings, "value_first", 0)
        before = {name: tensor.clone() for name, tensor in self.agent.policy.state_dict().items()}
        for _ in range(self.settings.rollout_steps):
            self._step()
        if alone:
            # A policy that follows a value function which has seen nothing forgets what it could.
            self.agent.policy.load_state_dict(before)
        self.updates += 1
        self._exchange()
        self.clock.total += time.perf_counter() - begin
        self.clock.cpu += time.process_time() - cpu
        wrong = [name for name, value in self.losses.items() if not math.isfinite(value)]
        if wrong or not agents.is_finite(self.agent):
            what = wrong[0].replace("_", " ") if wrong else "a weight"
            raise DivergedError(f"{what} was not finite in update {self.updates}")

    def _exchange(self) -> None:
        """Let all ranks have the episodes that ended on any, the mean of their losses, and the faults."""
        own = self.tally.take(), agents.losses(self.agent), [*self._kinds.values()]
        episodes, losses, kinds = zip(*self.ranks.everyones(own), strict=True)
        self.faults = list(dict.fromkeys(chain(self.faults, *kinds)))
        self.tally.keep(np.concatenate(episodes))
        self.losses = {name: float(np.mean([own[name] for own in losses])) for name in losses[0]}

    def move(self, env: MyoWarpVectorEnv) -> None:
        """Let the worlds go on, as they are, in another environment of the task; the one before is closed."""
        state = self.env.get_state()
        self.env.close()
        self._enter(env)
        env.set_state(state)

    def _enter(self, env: MyoWarpVectorEnv) -> None:
        """Take an environment, in which an expert acts, too."""
        self.env = env
        if isinstance(self.settings, DAggerSettings):
            self.agent.expert = acting(find_policy(self.settings.expert, env.sim.scene.spec), env.sim)

    def row(self) -> dict[str, float]:
        """Return the figures of the last iteration."""
        shares = {f"share_{name}": value for name, value in self.clock.shares().items()}
        figures = {"samples": self.samples, "updates": self.updates, "seconds": self.clock.total}
        rate = {"samples_per_s": self.samples / max(self.clock.total, 1e-9)}
        tracked = dict.fromkeys(agents.TRACKED.values(), math.nan) | self.losses
        return {**figures, **self.tally.figures(), **rate, **shares, **tracked}

    def manifest(self) -> dict[str, Any]:
        """Return the plain numbers of a checkpoint."""
        return {
            "samples": self.samples,
            "steps": self.steps,
            "updates": self.updates,
            "ranks": self.ranks.size,
            "clock": dataclasses.asdict(self.clock),
            "figures": self.tally.figures(),
            "policy": agents.policy_form(self.settings),
        }

    def arrays(self) -> tuple[agents.Arrays, agents.Arrays]:
        """Return the arrays of a checkpoint: those of the policy, and all others; on the rank that saves."""
        state = {f"agent.{name}": array for name, array in agents.learner_arrays(self.agent).items()}
        rows = {f"world.{name}": array for name, array in self.env.get_state().arrays.items()}
        rows |= {"observation": self._obs.cpu().numpy().copy()} | self.tally.rows()
        if self.ranks.size > 1:
            rows |= {name: state.pop(name)[None] for name in GENERATORS if name in state}
        state |= self.ranks.rows(rows) | self.tally.arrays()
        return agents.policy_arrays(self.agent), state

    def restore(self, checkpoint: Checkpoint) -> None:
        """Put back everything that a checkpoint of this run holds.

        Raises:
            KeyError: An array is missing.
            RuntimeError: An array of the agent does not fit.
            ValueError: An array of the environment does not fit.
        """
        state, manifest = checkpoint.state(), checkpoint.manifest
        own = ("world.", "observation", *self.tally.rows())
        state = {name: self.ranks.own(a) if name.startswith(own) else a for name, a in state.items()}
        if self.ranks.size > 1:
            state |= {name: self.ranks.own(state[name])[0] for name in GENERATORS if name in state}
        worlds = {name.removeprefix("world."): a for name, a in state.items() if name.startswith("world.")}
        learner = {name.removeprefix("agent."): a for name, a in state.items() if name.startswith("agent.")}
        self.env.set_state(State(self.env.sim.scene.spec.key, worlds))
        self._obs.copy_(torch.from_numpy(state["observation"].copy()))
        self.tally.restore(state)
        self.steps, self.updates = manifest["steps"], manifest["updates"]
        self.clock = Clock(**{f.name: manifest["clock"][f.name] for f in dataclasses.fields(Clock)})
        agents.restore_agent(self.agent, checkpoint.policy, learner)

    def _restart(self, mask: np.ndarray) -> torch.Tensor:
        """Begin new episodes in the worlds of a mask; returns observations of all worlds."""
        obs, _ = self.env.reset(options={"reset_mask": mask})
        if self._start is not None:
            obs = self.env.set_state(self._start[mask], mask, conditions=False)
        return obs

    def _note_faults(self, bits: np.ndarray) -> None:
        """Remember what kinds of faults worlds had in the last step.

        Raises:
            FaultyTaskError: All worlds have had one for a while.
        """
        for kind in set(bits[bits != 0].tolist()) - self._kinds.keys():
            self._kinds[kind] = self.env.sim.describe_fault(int(np.argmax(bits == kind)))
        self._faulty_steps = self._faulty_steps + 1 if bits.all() else 0
        if self._faulty_steps >= FAULTY_STEPS:
            raise FaultyTaskError(
                f"every world of {self.env.sim.scene.spec.key!r} had a fault in each of {FAULTY_STEPS} "
                f"control steps ({'; '.join(self._kinds.values())}); nothing can be learned before the task "
                "is mended"
            )

    def _step(self) -> None:
        """One control step of all worlds."""
        env, agent, clock = self.env, self.agent, self.clock
        at = {"timestep": self.steps, "timesteps": 0}
        begin = time.perf_counter()
        with torch.no_grad():
            action, _ = agent.act(self._obs, None, **at)
        acted = time.perf_counter()
        obs, reward, terminated, truncated, info = env.step(action)
        stepped = time.perf_counter()
        ended = terminated | truncated
        any_ended = bool(ended.any())
        self.tally.add(reward, ended, any_ended, info)
        tallied = time.perf_counter()
        agent.record_transition(
            observations=self._obs,
            states=None,
            actions=action,
            rewards=reward[:, None].clone(),  # skrl adds to it
            next_observations=obs,
            next_states=None,
            terminated=terminated[:, None],
            truncated=(truncated & ~terminated)[:, None],
            infos=info,
            **at,
        )
        agent.post_interaction(**at)
        learned = time.perf_counter()
        if any_ended:
            self._note_faults(info["fault"].cpu().numpy())
            obs = self._restart(ended.cpu().numpy())
        else:
            self._faulty_steps = 0
        self._obs.copy_(obs)
        self.steps += 1
        clock.simulation += stepped - acted + time.perf_counter() - learned
        clock.learner += acted - begin + learned - tallied
