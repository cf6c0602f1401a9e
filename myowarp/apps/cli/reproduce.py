"""The command `myowarp reproduce`: the paper's experiments."""

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from myowarp.apps.cli.options import Device, check_least, optional
from myowarp.definitions.registry import check_flag

if TYPE_CHECKING:
    from myowarp.apps.studies.reproduce.experiment import Experiment

SEEDS, WORLDS = 5, 64
QUICK_SEEDS, QUICK_WORLDS = 2, 4
MOST_SEEDS = 10_000


@dataclass
class Reproduce:
    """Run an experiment of the MyoSuite paper, and put its numbers beside ours.

    Writes a folder with figure.png and figure.pdf, table.csv, result.json (the paper's value, ours with a
    95 % interval over seeds, the difference) and page.md: where we differ, why, and the protocol. Runs that
    are done stay in the folder, so that the same command goes on where it was broken off.

    Example: myowarp reproduce exo1 --quick
    """

    name: Annotated[
        str | None, tyro.conf.Positional, tyro.conf.arg(metavar="NAME", help_behavior_hint="")
    ] = None
    """Experiment; --list names them."""
    list: bool = False
    """List the experiments."""
    quick: bool = False
    """A first look within two minutes: fewer seeds and worlds, shorter protocols."""
    retrain: bool = False
    """Train the policies here instead of taking those of the package (needs "myowarp[train]")."""
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
    device: Device = None

    def __call__(self) -> None:
        """Check everything, run and report."""
        from myowarp.apps.studies.reproduce import report
        from myowarp.apps.studies.reproduce.catalog import EXPERIMENTS
        from myowarp.apps.studies.reproduce.experiment import Lab
        from myowarp.sim.build import resolve_device

        if self.list:
            report.print_list({name: EXPERIMENTS[name] for name in EXPERIMENTS}, Console(highlight=False))
            return
        experiment, folder, seeds, worlds = self.plan()
        resolve_device(self.device)
        folder.mkdir(parents=True, exist_ok=True)
        size = tuple(range(seeds)), worlds
        lab = Lab(folder, *size, self.quick, self.retrain, self.overwrite, self.device, self.models)
        try:
            findings = experiment.run(lab)
        finally:
            lab.close()
        report.write(experiment, lab, findings)
        report.print_table(findings, Console(highlight=False))
        lab.console.print(f"Saved {', '.join(report.FILES)} in {folder}", markup=False)

    def plan(self) -> tuple["Experiment", Path, int, int]:
        """Return the experiment, its folder, and how many seeds and worlds it has.

        Raises:
            ValueError: An argument is wrong; nothing was built or written.
            ImportError: A package is not installed.
        """
        from myowarp.apps.studies.reproduce import report
        from myowarp.apps.studies.reproduce.catalog import EXPERIMENTS
        from myowarp.disk import check_folder
        from myowarp.sim.build import MOST_WORLDS, check_device_name

        if self.name is None:
            raise ValueError(f"reproduce needs an experiment; available: {', '.join(EXPERIMENTS)}")
        experiment = EXPERIMENTS[self.name]
        for option in experiment.ignores:
            if getattr(self, option) not in (None, False, ()):
                flag = "--" + option.replace("_", "-")
                raise ValueError(f"experiment {self.name!r} does not read {flag}; leave it out")
        seeds = self.seeds if self.seeds is not None else QUICK_SEEDS if self.quick else SEEDS
        worlds = self.num_worlds if self.num_worlds is not None else QUICK_WORLDS if self.quick else WORLDS
        check_least(1, MOST_SEEDS, seeds=seeds)
        check_least(1, MOST_WORLDS, num_worlds=worlds)
        check_flag("quick", self.quick)
        check_flag("retrain", self.retrain)
        check_device_name(self.device)
        if missing := [path for path in self.models if not path.is_file()]:
            raise ValueError(f"--models {str(missing[0])!r} is no file; give the path of an .osim file")
        if importlib.util.find_spec("matplotlib") is None:
            raise ImportError('reproduce draws with matplotlib; run `pip install "myowarp[plot]"`')
        folder = self.output or report.output_folder(self.name, self.quick, self.retrain)
        check_folder(folder)
        return experiment, folder, seeds, worlds
