"""Noise of actions that lasts for some control steps: it moves a limb where white noise only shakes it.

Source: FlashSAC, arXiv:2604.04539.
"""

from __future__ import annotations

import torch
from torch import nn

REPEATS = 16  # largest number of control steps for which noise stays


class RepeatedNoise(nn.Module):
    """Normal noise for each world, drawn anew after n control steps, P(n) proportional to 1 / n^2."""

    noise: torch.Tensor
    left: torch.Tensor

    def __init__(self, num_worlds: int, num_actions: int) -> None:
        super().__init__()
        self.register_buffer("noise", torch.zeros(num_worlds, num_actions))
        self.register_buffer("left", torch.zeros(num_worlds, 1, dtype=torch.int64))
        self.weights = 1.0 / torch.arange(1, REPEATS + 1, dtype=torch.float32).square()

    def next(self) -> torch.Tensor:
        """Return the noise of the next control step, shape (num_worlds, num_actions)."""
        due = self.left == 0
        steps = 1 + torch.multinomial(self.weights, len(due), replacement=True).to(due.device)[:, None]
        self.left.copy_(torch.where(due, steps, self.left) - 1)
        self.noise.copy_(torch.where(due, torch.randn_like(self.noise), self.noise))
        return self.noise
