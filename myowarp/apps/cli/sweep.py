"""The command `myowarp sweep`: a study of many runs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from myowarp.apps.cli.options import optional
from myowarp.definitions.registry import check_least


@dataclass
class Sweep:
    """Run a study: tasks x conditions x seeds x settings, over a Ray cluster, each run once.

    The study is a YAML file (docs/scale.md). Every run has a folder of its own; the same command goes on
    where it was broken off, and does only what is missing. Writes runs.csv, table.csv and study.png: means
    over seeds with 95 % intervals.

    Example: myowarp sweep examples/study.yaml --dry-run
    """

    study: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STUDY")]
    """The study, .yaml."""
    output: Annotated[Path | None, optional("FOLDER")] = None
    """Folder of the runs, which every node must see; by default out/<name of the study>."""
    address: Annotated[str | None, optional("HOST:PORT")] = None
    """Head of a Ray cluster, or auto; by default this machine alone."""
    cpus: int = 1
    """Cores of each run."""
    gpus: float = 0.0
    """CUDA devices of each run; 0.5: two runs share one."""
    dry_run: bool = False
    """Check the study, say how many runs it has and how long they take, and start nothing."""

    def __call__(self) -> None:
        """Check, run, report."""
        from myowarp.apps.studies.sweep import run as command

        check_least(1, cpus=self.cpus)
        if not 0.0 <= self.gpus < float("inf"):
            raise ValueError(f"--gpus must be at least 0, got {self.gpus}")
        output = self.output or Path("out") / self.study.stem
        command.run(self.study, output, self.address, self.cpus, self.gpus, self.dry_run)
