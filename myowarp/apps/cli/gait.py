"""The command `myowarp gait`: reflexes that walk, searched by CMA-ES."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from rich.console import Console

from myowarp.apps.cli.options import Environment, optional
from myowarp.definitions.registry import check_least


@dataclass
class GaitCommand:
    """Search reflexes that walk: CMA-ES over their parameters, all candidates at once.

    Geyer and Herr's reflexes, with their delays, excite the muscles of both legs. Staying up comes first,
    then speed, then the metabolic rate. Writes the best so far as gait.json, a policy; the same command goes
    on with a search that was broken off, and to more --generations. Begin in a plane, with support of the
    pelvis, and go on with less of it from the gait that was found (--begin).

    Example: myowarp gait myoLegWalkHuman-v0 --physics fast --conditions 'pelvis_support(share=1)'

    Then: myowarp record myoLegWalkHuman-v0 --policy out/gait/gait.json --beside 'pelvis_support(share=1)'
    """

    asked: Environment
    output: Path = Path("out/gait")
    """Folder of the search."""
    speed: float = 1.2
    """Wanted speed [m/s]."""
    generations: int = 200
    """Generations in all."""
    population: int = 64
    """Candidates of a generation."""
    starts: int = 1
    """Worlds of each candidate, of different seeds; they differ where something is drawn, as motor_noise."""
    spread: float = 0.3
    """Standard deviation of scaled parameters at the begin."""
    begin: Annotated[Path | None, optional("FILE")] = None
    """Gait to begin with; by default one of equal scaled parameters, which falls."""

    def __call__(self) -> None:
        """Check, search, print."""
        from myowarp.apps.policies.reflex import Delays, read_gait
        from myowarp.apps.studies.gait import GAIT, Search, search
        from myowarp.sim.build import MOST_WORLDS

        check_least(1, generations=self.generations, starts=self.starts)
        check_least(4, MOST_WORLDS // self.starts, population=self.population)
        for name in ("speed", "spread"):
            if not 0.0 < (value := getattr(self, name)) < math.inf:
                raise ValueError(f"--{name} must be positive and finite, got {value:g}")
        begin = None if self.begin is None else read_gait(self.begin)
        sizes = {name: getattr(self, name) for name in ("speed", "population", "starts", "spread")}
        plan = Search(self.asked.setup, **sizes, begin=begin, delays=begin.delays if begin else Delays())
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        gait = search(plan, self.output, self.generations, console)
        held = f", searched with {', '.join(gait.conditions)}" if gait.conditions else ""
        console.print(f"Saved {self.output / GAIT}, cost {gait.provenance['cost']:.2f}{held}", markup=False)
