"""The command `myowarp reproduce`: the paper's experiments."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from myowarp.apps.cli.options import Asked, environment, optional

PROTOCOLS = ("task", "physics", "reset", "conditions", "stops", "horizon", "seed")
"""Options that the experiments set themselves."""


@dataclass
class Reproduce:
    """Run an experiment of the MyoSuite paper, and put its numbers beside ours.

    Writes a folder with figure.png and figure.pdf, table.csv, result.json (the paper's value, ours with a
    95 % interval over seeds, the difference) and page.md: where we differ, why, and the protocol. Runs that
    are done stay in the folder, so that the same command goes on where it was broken off.

    Example: myowarp reproduce exo1 --quick
    """

    asked: Annotated[Asked, environment(leave_out=PROTOCOLS)]
    name: Annotated[
        str | None, tyro.conf.Positional, tyro.conf.arg(metavar="NAME", help_behavior_hint="")
    ] = None
    """Experiment; --list names them."""
    list: bool = False
    """List the experiments."""
    quick: bool = False
    """A first look within two minutes: fewer seeds and worlds, shorter protocols."""
    retrain: bool = False
    """Train the policies here instead of taking those of the package (needs the extra `train`)."""
    seeds: Annotated[int | None, optional("INT")] = None
    """Number of seeds, each with a policy of its own; by default 5, with --quick 2."""
    num_worlds: Annotated[int | None, optional("INT")] = None
    """Worlds of each seed and condition; by default 64; with --quick 4."""
    output: Annotated[Path | None, optional("FOLDER")] = None
    """Folder of the results; by default out/reproduce/NAME, with -quick and -retrain where these were
    chosen."""
    overwrite: bool = False
    """Measure again what the folder holds with other settings, or damaged."""
    models: tuple[Path, ...] = ()
    """OpenSim models that `validation` converts, too: arm26.osim (github.com/opensim-org/opensim-models) and
    MoBL_ARMS.osim (simtk.org/projects/upexdyn)."""

    def __call__(self) -> None:
        """Check everything, run and report."""
        from myowarp.apps.studies.reproduce import report
        from myowarp.apps.studies.reproduce.catalog import EXPERIMENTS
        from myowarp.apps.studies.reproduce.run import plan_experiment, reproduce

        console = Console(highlight=False)
        if self.list:
            report.print_list({name: EXPERIMENTS[name] for name in EXPERIMENTS}, console)
            return
        if self.name is None:
            raise ValueError(f"reproduce needs an experiment; available: {', '.join(EXPERIMENTS)}")
        options = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        setup = options.pop("asked").setup
        job = plan_experiment(setup=setup, **{k: value for k, value in options.items() if k != "list"})
        report.print_table(job.experiment, reproduce(job), console)
        said = Console(stderr=True, highlight=False, soft_wrap=True)
        said.print(f"Saved {', '.join(report.FILES)} in {job.folder}", markup=False)
