"""The base of every algorithm: a policy, a normaliser, optimisers, a memory; and all their numbers by name.

An algorithm is a file: `ppo.py`, `trpo.py`, `sac.py`, `dagger.py`, `improve.py`. Its class says in `iterate`
what one iteration is, from the worlds' first step to the last step of an optimiser.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from functools import partial

import numpy as np
import torch
from torch import nn

from myowarp.apps.rollouts.ranks import Ranks
from myowarp.apps.train.arrays import Arrays, below, taken, tensor
from myowarp.apps.train.networks import CLIP, EPSILON, GaussianPolicy, Normaliser, SquashedPolicy
from myowarp.apps.train.replay import Replay
from myowarp.apps.train.settings import Settings
from myowarp.apps.train.worlds import Worlds

OBSERVING = ("net.0.weight", "memory.weight_ih")
"""Weights of a policy with a column for each number observed, and behind those one for each remembered."""


class Learner(nn.Module):
    """A policy that learns.

    Attributes:
        policy: What acts.
        normaliser: Of its observations.
        average: Of the policy's weights over the iterations. It acts in evaluations and is what a run leaves,
            while the policy itself takes the samples.
        optimizers: By name.
        replay: Samples that are used more than once; None: none.
        noted: Figures since the last iteration, by name.
    """

    policy: GaussianPolicy | SquashedPolicy
    optimizers: dict[str, torch.optim.Optimizer]
    replay: Replay | None = None

    def __init__(self, settings: Settings, worlds: Worlds, ranks: Ranks) -> None:
        """Make the normaliser; the algorithm makes all else, with torch's generator."""
        super().__init__()
        self.settings, self.device, self.ranks = settings, worlds.device, ranks
        self.normaliser = Normaliser(worlds.num_obs).to(self.device)
        self.average: dict[str, torch.Tensor] = {}
        self.noted: dict[str, list[torch.Tensor]] = {}

    def iterate(self, worlds: Worlds) -> None:
        """Do one iteration: control steps, and the updates that belong to them."""
        raise NotImplementedError

    def products(self) -> AbstractContextManager[object]:
        """Return the context in which matrix products have the run's precision; all else stays float32."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.settings.precision == "bfloat16")

    def adam(
        self, parameters: Iterable[nn.Parameter], rate: float, decay: float = 0.0
    ) -> torch.optim.Optimizer:
        """Return an optimiser whose rate falls as the run goes on."""
        # A graph reads the rate, and what it counts, from tensors of the device.
        captured = self.device.type == "cuda"
        first = torch.tensor(rate, device=self.device) if captured else rate
        group = {"params": list(parameters), "lr": first, "first_rate": rate}
        return torch.optim.AdamW([group], weight_decay=decay, fused=True, capturable=captured)

    def set_rates(self, share: float) -> None:
        """Let all rates of learning fall along half a cosine, over the share of samples that is taken."""
        last = self.settings.last_rate
        factor = last + (1.0 - last) * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0)))
        for optimizer in self.optimizers.values():
            set_rate(optimizer, factor * optimizer.param_groups[0]["first_rate"])

    def descend(
        self, name: str, loss: torch.Tensor, clipped: Iterable[nn.Parameter] = (), norm: float = 0.0
    ) -> None:
        """Do one step of an optimiser, on the mean gradient of all ranks; `clipped` have a norm, if not 0."""
        self.optimizers[name].zero_grad()
        loss.backward()
        clipped = [*clipped]
        self.ranks.average_gradients(clipped)
        if norm:
            nn.utils.clip_grad_norm_(clipped, norm)
        self.optimizers[name].step()

    def note(self, **figures: torch.Tensor) -> None:
        """Keep figures of the iteration."""
        for name, value in figures.items():
            self.noted.setdefault(name, []).append(value.detach())

    def figures(self) -> dict[str, float]:
        """Return the means of what was noted since the last call."""
        means = {name: float(torch.stack(values).mean()) for name, values in self.noted.items()}
        self.noted.clear()
        if "policy" in self.optimizers:
            means["learning_rate"] = float(self.optimizers["policy"].param_groups[0]["lr"])
        return means

    def inherit(self, parent: Mapping[str, np.ndarray], samples: int, count: int, places: np.ndarray) -> None:
        """Start from the policy of another run, with a spread and a value function of this one.

        Of a policy whose spread depends on the state, the first outputs are the means. What is observed or
        remembered here alone says nothing at first.

        Args:
            parent: Arrays of that policy.
            samples: Samples that its normaliser of observations has seen.
            count: Samples as which they count here, few enough for the new task's to outweigh them soon.
            places: Where its observations stand in those of this task, shape (its obs_size,).
        """
        mean, variance = parent["observation_mean"], parent["observation_variance"]
        # A column that never changed, such as a fixed goal, has weights that nothing trained, and no more
        # variance than a normaliser starts with: that of one sample beside the mean 0.
        unseen = variance * samples < 1.01 * (1.0 + mean * mean)
        own = self.policy.state_dict()
        for name in own.keys() & parent.keys() - {"log_std"}:
            theirs = tensor(parent[name])[: len(own[name])]
            if name in OBSERVING:
                theirs[:, : len(mean)][:, torch.from_numpy(unseen)] = 0.0
                remembered = len(self.normaliser.mean) + np.arange(theirs.shape[1] - len(mean))
                given = theirs
                theirs = torch.zeros_like(own[name])
                theirs[:, torch.from_numpy(np.append(places, remembered))] = given.to(theirs)
            own[name] = theirs
        self.policy.load_state_dict(own)
        for name, values in {"mean": mean, "variance": variance, "count": np.full(len(mean), count)}.items():
            moments = getattr(self.normaliser, name)
            moments[places] = tensor(values).to(moments)

    def follow(self, keep: float) -> None:
        """Take the policy into its average, w <- keep w + (1 - keep) policy; at first they are the same."""
        for name, weights in self.policy.state_dict().items():
            self.average.setdefault(name, weights.clone()).lerp_(weights, 1.0 - keep)

    def acting(self) -> Arrays:
        """Return what acts: the average of the weights, and the normaliser of observations."""
        moments = {"mean": self.normaliser.mean, "variance": self.normaliser.variance}
        return taken(self.average | {f"observation_{name}": moment for name, moment in moments.items()})

    def form(self) -> dict[str, object]:
        """Return what the arrays of the policy leave open, for `myowarp.apps.policies.learned`."""
        return {
            "mean_bound": self.policy.mean_bound,
            "activation": self.settings.activation,
            "clip": CLIP,
            "epsilon": EPSILON,
            "log_std_bounds": list(self.policy.log_std_bounds),
        }

    def arrays(self) -> Arrays:
        """Return all that the next iteration depends on; the samples of PPO and TRPO are none of it."""
        tensors = dict(self.state_dict()) | {"torch_generator": torch.get_rng_state()[None]}
        if self.device.type == "cuda":
            tensors["cuda_generator"] = torch.cuda.get_rng_state(self.device)[None]
        for name, optimizer in self.optimizers.items():
            for index, entries in optimizer.state_dict()["state"].items():
                tensors |= {f"optimizer.{name}.{index}.{key}": value for key, value in entries.items()}
        return taken(tensors) | ({} if self.replay is None else self.replay.arrays())

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Put all numbers back; torch's generators too.

        Raises:
            KeyError: An array is missing.
            RuntimeError: An array has another shape.
        """
        own = {name: tensor(arrays[name]) for name in self.state_dict()}
        # Runs of before have one count of all columns.
        own["normaliser.count"] = own["normaliser.count"].expand_as(self.normaliser.count)
        self.load_state_dict(own)
        for name, optimizer in self.optimizers.items():
            states: dict[int, dict[str, torch.Tensor]] = {}
            for key, value in below(arrays, f"optimizer.{name}.").items():
                index, _, entry = key.partition(".")
                states.setdefault(int(index), {})[entry] = tensor(value)
            groups = optimizer.state_dict()["param_groups"]
            optimizer.load_state_dict({"state": states, "param_groups": groups})
        if self.replay is not None:
            self.replay.restore(arrays)
        torch.set_rng_state(tensor(arrays["torch_generator"]).flatten())
        if "cuda_generator" in arrays:
            torch.cuda.set_rng_state(tensor(arrays["cuda_generator"]).flatten(), self.device)


def set_rate(optimizer: torch.optim.Optimizer, rate: float) -> None:
    """Give an optimiser its rate, in place where a captured step reads it."""
    for group in optimizer.param_groups:
        if isinstance(group["lr"], torch.Tensor):
            group["lr"].fill_(rate)
        else:
            group["lr"] = rate


WARM_UPS = 3  # plain calls before a capture, in which libraries allocate what they keep


class Captured:
    """A step of a learner that is the same every time: on CUDA one graph, elsewhere a plain call.

    A step of some hundred small kernels takes a GPU less time than it takes a CPU to launch them.

    Attributes:
        captures: Whether a graph is made of it.
    """

    def __init__(self, learner: Learner, step: Callable[..., None]) -> None:
        """Capture nothing yet: the first calls are plain ones.

        Args:
            learner: Whose step it is; what the step notes is noted at every call.
            step: Function of tensors whose shapes stay; it asks the host for nothing.
        """
        self._learner, self._step, self._calls = learner, step, 0
        self.captures = learner.device.type == "cuda"
        self._inputs: tuple[torch.Tensor, ...] = ()
        self._noted: dict[str, list[torch.Tensor]] = {}
        self._replay: Callable[[], object] | None = None

    def __call__(self, *tensors: torch.Tensor, alike: bool = True) -> None:
        """Do the step; a plain call does one that is not like the others."""
        if not (self.captures and alike):
            self._step(*tensors)
            return
        self._calls += 1
        if self._calls <= WARM_UPS:
            warm_up(partial(self._step, *tensors))
        else:
            if self._replay is None:
                self._inputs, others = tuple(each.clone() for each in tensors), self._learner.noted
                self._learner.noted = self._noted
                self._replay = capture(partial(self._step, *self._inputs))
                self._learner.noted = others
            for own, each in zip(self._inputs, tensors, strict=True):
                own.copy_(each)
            self._replay()
            for name, figures in self._noted.items():
                for figure in figures:
                    self._learner.note(**{name: figure.clone()})


def warm_up(step: Callable[[], object]) -> None:
    """Do a step beside the stream that others use, where a capture does it, too."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        step()
    torch.cuda.current_stream().wait_stream(stream)


def capture(step: Callable[[], object]) -> Callable[[], object]:
    """Return what replays a step as a CUDA graph; capturing it computes nothing."""
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        step()
    return graph.replay
