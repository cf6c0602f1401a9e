"""Ranks: processes that torchrun started, each with worlds of its own; they share one policy.

    torchrun --nproc-per-node 2 -m myowarp train myoElbowPose1D6MRandom-v0

Rank r of R owns worlds r n to (r + 1) n - 1 of one numbered set, n = --num-worlds / R. Every rank has the
same weights: gradients are averaged over ranks, and so is the KL divergence that sets the learning rate;
moments of normalisers are those of all samples. Gloo carries what is on the host, NCCL what is on CUDA.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.process import CORES, num_cores

if TYPE_CHECKING:
    import torch


class LostRankError(RuntimeError):
    """Another rank ended."""


@dataclass(frozen=True)
class Ranks:
    """This process among those of a run.

    Attributes:
        rank: Its number, from 0.
        size: How many there are.
        local: Its number among those of this machine.
        local_size: How many there are on this machine.
        restarts: How often torchrun has started them again.
    """

    rank: int = 0
    size: int = 1
    local: int = 0
    local_size: int = 1
    restarts: int = 0

    @classmethod
    def started(cls) -> Ranks:
        """Return what torchrun says in the environment; without it, a run of one process."""
        names = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE", "TORCHELASTIC_RESTART_COUNT")
        return cls(*(int(os.environ.get(name, "01010"[i])) for i, name in enumerate(names)))

    @property
    def part(self) -> tuple[int, int]:
        """Rank and number of ranks, as an environment takes them."""
        return self.rank, self.size

    @property
    def leads(self) -> bool:
        """Whether this rank logs and saves."""
        return self.rank == 0

    def share(self, option: str, number: int) -> int:
        """Return this rank's share of a number.

        Raises:
            ValueError: It cannot be divided by the number of ranks.
        """
        if number % self.size:
            raise ValueError(f"{option} must be a multiple of the {self.size} ranks, got {number}")
        return number // self.size

    def device(self, wanted: str | None) -> str | None:
        """Return the Warp device of this rank, None for the usual one: one CUDA device a rank.

        Raises:
            ValueError: There are fewer devices than ranks on this machine, or one is asked for by number.
        """
        if self.size == 1 or wanted == "cpu":
            return wanted
        import warp as wp

        number = wp.get_cuda_device_count()
        if wanted not in (None, "cuda"):
            raise ValueError(f"--device of {self.size} ranks must be cpu, cuda or left out, got {wanted!r}")
        if not number and not wanted:
            return "cpu"
        if number < self.local_size:
            raise ValueError(
                f"{self.local_size} ranks of one machine need as many CUDA devices, got {number}; start "
                "fewer ranks, or pass --device cpu"
            )
        return f"cuda:{self.local}"

    @contextmanager
    def together(self, device: str | None) -> Iterator[None]:
        """Meet the other ranks, and part from them after the block.

        Args:
            device: Warp device of this rank.

        Raises:
            LostRankError: Another rank ended.
        """
        if self.size == 1:
            yield
            return
        import torch

        self._join(device)
        try:
            yield
            self.everyones(None)  # nobody leaves while another one still reads
        except RuntimeError as error:
            if type(error).__module__.startswith("myowarp."):
                raise
            reason = str(error).strip().splitlines()[0]
            raise LostRankError(
                f"rank {self.rank} cannot go on with the others of {self.size} ({reason}); with "
                "--max-restarts torchrun goes on from the last checkpoint"
            ) from error
        torch.distributed.destroy_process_group()

    def _join(self, device: str | None) -> None:
        """Meet the other ranks."""
        import torch

        # Functions of this module keep the group that they find when they are imported, as Adam does later;
        # its threads would outlive `destroy_process_group` and abort the process at its end.
        import torch.distributed.nn.functional

        os.environ.setdefault(CORES, str(max(1, num_cores() // self.local_size)))
        on_cuda = str(device).startswith("cuda")
        if on_cuda:
            torch.cuda.set_device(device)
        # After a restart torchrun's store still holds the addresses of the processes before.
        store, rank, size = next(torch.distributed.rendezvous("env://"))
        store = torch.distributed.PrefixStore(f"attempt {self.restarts}", store)
        backend = "cpu:gloo,cuda:nccl" if on_cuda else "gloo"
        torch.distributed.init_process_group(backend, store=store, rank=rank, world_size=size)

    def mean(self, tensor: torch.Tensor) -> torch.Tensor:
        """Return the mean of a tensor over all ranks."""
        if self.size == 1:
            return tensor
        import torch

        torch.distributed.all_reduce(tensor := tensor.clone())
        return tensor / self.size

    def average_gradients(self, parameters: Sequence[torch.nn.Parameter]) -> None:
        """Give all ranks the mean of their gradients, in one message."""
        if self.size == 1 or not parameters:
            return
        import torch

        gradients = [p.grad for p in parameters if p.grad is not None]
        means = self.mean(torch.cat([gradient.view(-1) for gradient in gradients]))
        for gradient, mean in zip(gradients, means.split([g.numel() for g in gradients]), strict=True):
            gradient.copy_(mean.view_as(gradient))

    def everyones(self, value: Any) -> list[Any]:
        """Return the values of all ranks, in their order."""
        if self.size == 1:
            return [value]
        import torch

        values: list[Any] = [None] * self.size
        torch.distributed.all_gather_object(values, value)
        return values

    def rows(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the arrays of the worlds of all ranks, in their order; none but on the rank that saves."""
        if self.size == 1:
            return arrays
        import torch

        parts: list[Any] | None = [None] * self.size if self.leads else None
        torch.distributed.gather_object(arrays, parts)
        return {name: np.concatenate([part[name] for part in parts]) for name in arrays} if parts else {}

    def own(self, rows: np.ndarray) -> np.ndarray:
        """Return this rank's rows of an array over the worlds of all."""
        number = len(rows) // self.size
        return rows[self.rank * number : (self.rank + 1) * number]


ALONE = Ranks()
