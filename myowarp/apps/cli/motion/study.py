"""The step `myowarp motion study`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from myowarp.apps.cli.motion import options as of
from myowarp.apps.cli.options import optional
from myowarp.definitions.registry import check_least


@dataclass
class Study:
    """Solve a table of trials, one a row, with random draws of their uncertain parameters.

    Columns are a trial's files (trial, model, markers or motion, setup, loads), factors on its model
    (max_isometric_force, tendon_slack_length, mass) and the spread of their draws
    (max_isometric_force_spread, ..., marker_noise [m]). Writes tidy Parquet, .sto with intervals and plots;
    the same command continues an interrupted study.

    Example: myowarp motion study trials.csv --draws 100 --reserve 10 -o out/study
    """

    table: Annotated[Path, tyro.conf.Positional]
    """The table of trials, .csv or .parquet."""
    draws: int = 0
    """Random draws of each trial, besides the trial as it is."""
    seed: int = 0
    """Seed of the draws."""
    mode: of.Mode = "equilibrium"
    exponent: of.Exponent = None
    reserve: of.Reserve = None
    ray: bool = False
    """Solve parts over a Ray cluster; every node sees the table, its files and the output."""
    address: Annotated[str | None, optional("HOST:PORT")] = None
    """With --ray: head of a cluster, or auto; by default this machine alone."""
    cpus: Annotated[int | None, optional("INT")] = None
    """With --ray: cores of each part; by default 1."""
    output: of.Output = of.OUT

    def __call__(self) -> None:
        """Check, solve what is missing."""
        from myowarp.apps.studies.motion import run

        for name in ("address", "cpus"):
            if getattr(self, name) is not None and not self.ray:
                raise ValueError(f"--{name} belongs to a cluster; give it with --ray")
        if self.seed and not self.draws:
            raise ValueError("--seed is of draws; give their number with --draws")
        cpus = 1 if self.cpus is None else self.cpus
        check_least(1, cpus=cpus)
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        names = "draws", "seed", "mode", "exponent", "reserve"
        cluster = run.Cluster(self.address, cpus) if self.ray else None
        run.run(self.table, self.output, console, cluster, **{name: getattr(self, name) for name in names})
