"""The worlds that a learner acts in: steps, restarts, figures of episodes, faults, times.

The environment has no autoreset, so that the observation that an episode ended with is seen; what ended is
reset by mask. A learner's reward may have terms that the task's has not (`--bonus`); figures are the task's.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from myowarp.apps.train import bonus
from myowarp.apps.train.arrays import Arrays, below, put, taken
from myowarp.apps.train.starts import Backplay
from myowarp.apps.train.tally import Tally
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.sim.state import State, without_keys

FAULTY_STEPS = 50
"""Control steps in a row in which every world has a fault, after which none will ever be without."""


class FaultyTaskError(RuntimeError):
    """No world of the task can be stepped."""


@dataclass
class Clock:
    """Seconds of a run: in simulation, in learning, in all of its iterations, and of all cores in these.

    Other work on the same cores is part of `total`, and no part of `cpu`.
    """

    simulation: float = 0.0
    learner: float = 0.0
    total: float = 0.0
    cpu: float = 0.0

    def shares(self) -> dict[str, float]:
        """Return the shares of simulation, learner and rest."""
        total = max(self.total, 1e-9)
        shares = {"simulation": self.simulation / total, "learner": self.learner / total}
        return shares | {"rest": max(1.0 - sum(shares.values()), 0.0) if self.total else 0.0}


class Step(NamedTuple):
    """Results of a control step before any reset; tensors of the learner's own.

    Attributes:
        obs: Observations, shape (num_worlds, obs_size).
        reward: Reward, with the bonus, shape (num_worlds,).
        terminated: Whether the task or a fault ended the episode.
        truncated: Whether the horizon ended it, and nothing else.
        success: Whether the episode has succeeded so far (more than 5 solved steps).
    """

    obs: torch.Tensor
    reward: torch.Tensor
    terminated: torch.Tensor
    truncated: torch.Tensor
    success: torch.Tensor

    @property
    def ended(self) -> torch.Tensor:
        """Whether the episode is over."""
        return self.terminated | self.truncated


class Worlds:
    """The worlds of one rank.

    Attributes:
        env: Environment without autoreset, with views of the simulation as tensors.
        obs: What is observed now, shape (num_worlds, obs_size).
        tally: Returns and successes.
        backplay: States that episodes start in; None: none do.
        clock: Where the time went, earlier processes of a resumed run included.
        steps: Control steps of every world so far.
        kinds: Faults that worlds had in this process, in words by bits.
    """

    def __init__(
        self,
        env: MyoWarpVectorEnv,
        start: State | None = None,
        weights: Mapping[str, float] | None = None,
        start_share: float = 0.0,
    ) -> None:
        """Reset all worlds.

        Args:
            env: Environment; its seed is that of the worlds.
            start: States that episodes start in, world i in the i-th, over and over; None: resets.
            weights: Of what is added to the reward, by the names of `bonus.py`.
            start_share: Share of the episodes that start on the way of an earlier success.
        """
        self.env, self._start, self._bonus = env, start, dict(weights or {})
        self.device, self.num_worlds = torch.device(str(env.sim.scene.device)), env.num_envs
        self.num_obs, self.num_actions = env.sim.transition.obs.shape[1], env.sim.action.shape[1]
        self.tally, self.clock = Tally(env.num_envs, self.device), Clock()
        self.steps = self._faulty_steps = 0
        self.kinds: dict[int, str] = {}
        obs, _ = env.reset(seed=env.sim.setup.seed or 0)
        if start is not None:
            rows = (env.sim.scene.worlds.offset + np.arange(env.num_envs)) % len(start)
            # Each episode has random numbers of its own, and draws its patients and noise anew.
            self._start = without_keys(start[rows])
            obs = env.set_state(self._start, conditions=False)
        self.backplay = Backplay(env, start_share) if start_share else None
        self.obs = obs.clone()

    def step(self, action: torch.Tensor) -> Step:
        """Do a control step of all worlds, and begin new episodes where it ended one.

        Raises:
            FaultyTaskError: All worlds have had faults for a while.
        """
        with self._simulating():
            obs, reward, terminated, truncated, info = self.env.step(action)
            ends = terminated.clone(), truncated & ~terminated
            step = Step(obs.clone(), reward.clone(), *ends, info["success"].clone())
            ended = step.ended
            any_ended = bool(ended.any())
            self.tally.add(reward, ended, any_ended, info)
            for name, weight in self._bonus.items():
                step.reward.add_(bonus.value(name, info, self.env.sim.scene.spec), alpha=weight)
            if self.backplay:
                self.backplay.see(self.env, step.success.cpu().numpy(), ended.cpu().numpy())
            if any_ended:
                self._note_faults(info["fault"].cpu().numpy())
                obs = self._restart(ended.cpu().numpy())
            else:
                self._faulty_steps = 0
            self.obs.copy_(obs)
            self.steps += 1
        return step

    def restart(self) -> None:
        """Begin a new episode in every world."""
        with self._simulating():
            self.tally.forget(torch.ones(self.num_worlds, dtype=torch.bool, device=self.device))
            if self.backplay:
                self.backplay.forget()
            self.obs.copy_(self._restart(np.ones(self.num_worlds, dtype=bool)))

    def copy(self, rows: torch.Tensor) -> None:
        """Make every world what another one is, shape (num_worlds,); random numbers to come stay its own."""
        with self._simulating():
            others = rows.cpu().numpy()
            put(self._own(), {name: values[others] for name, values in taken(self._own()).items()})
            state = without_keys(self.env.get_state()[others])
            self.obs.copy_(self.env.set_state(state, conditions=False))

    def move(self, env: MyoWarpVectorEnv) -> None:
        """Let the worlds go on, as they are, in another environment of the task; the one before is closed."""
        state = self.env.get_state()
        self.env.close()
        self.env = env
        env.set_state(state)

    def rows(self) -> Arrays:
        """Return what the worlds are, one row a world, by name."""
        state = {f"world.{name}": array for name, array in self.env.get_state().arrays.items()}
        return state | taken(self._own())

    def arrays(self) -> Arrays:
        """Return what belongs to no world: episodes that ended, and states to start from."""
        return taken(self.tally.ended) | (self.backplay.arrays() if self.backplay else {})

    def restore(self, arrays: Mapping[str, np.ndarray], steps: int, clock: Mapping[str, float]) -> None:
        """Put the worlds back, with what `rows` and `arrays` returned.

        Raises:
            KeyError: An array is missing.
            ValueError: An array does not fit.
        """
        self.env.set_state(State(self.env.sim.scene.spec.key, below(arrays, "world.")))
        put(self._own(), arrays)
        self.tally.ended = taken({name: arrays[name] for name in self.tally.ended})
        if self.backplay:
            self.backplay.restore(arrays)
        self.steps, self.clock = steps, Clock(**{name: clock[name] for name in vars(Clock())})

    def _own(self) -> dict[str, torch.Tensor | np.ndarray]:
        """Return what a world has besides its state, one row a world."""
        return {
            "observation": self.obs,
            **self.tally.worlds,
            **(self.backplay.notes if self.backplay else {}),
        }

    @contextmanager
    def _simulating(self) -> Iterator[None]:
        """Let the time of the block be that of the simulation."""
        begin = time.perf_counter()
        yield
        self.clock.simulation += time.perf_counter() - begin

    def _restart(self, mask: np.ndarray) -> torch.Tensor:
        """Begin new episodes in the worlds of a mask; returns observations of all worlds."""
        obs, _ = self.env.reset(options={"reset_mask": mask})
        if self._start is not None:
            obs = self.env.set_state(self._start[mask], mask, conditions=False)
        placed = self.backplay.place(self.env, mask) if self.backplay else None
        return obs if placed is None else placed

    def _note_faults(self, bits: np.ndarray) -> None:
        """Remember what kinds of faults worlds had in the last step, and whether any had none."""
        for kind in set(bits[bits != 0].tolist()) - self.kinds.keys():
            self.kinds[kind] = self.env.sim.describe_fault(int(np.argmax(bits == kind)))
        self._faulty_steps = self._faulty_steps + 1 if bits.all() else 0
        if self._faulty_steps >= FAULTY_STEPS:
            raise FaultyTaskError(
                f"every world of {self.env.sim.scene.spec.key!r} had a fault in each of {FAULTY_STEPS} "
                f"control steps ({'; '.join(self.kinds.values())}); nothing can be learned before the task "
                "is mended"
            )
