"""An experiment of the paper, from its plan to its page: `reproduce(plan_experiment("exo1", quick=True))`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from myowarp.apps.studies.reproduce import report
from myowarp.apps.studies.reproduce.catalog import EXPERIMENTS
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.definitions.registry import check_flag, check_least
from myowarp.definitions.setup import Setup
from myowarp.disk import check_folder, make_folder
from myowarp.extras import check_installed
from myowarp.sim.build import MOST_WORLDS, check_device_name, resolve_device

SEEDS, WORLDS = 5, 64
QUICK_SEEDS, QUICK_WORLDS = 2, 4
MOST_SEEDS = 10_000


@dataclass(frozen=True)
class ExperimentJob:
    """An experiment that was checked and can be run.

    Attributes:
        experiment: What is done.
        folder: Folder of the results.
        seeds: Number of seeds, each with a policy of its own.
        num_worlds: Worlds of each seed and condition.
        quick: Whether protocols are shorter, for a first look.
        retrain: Whether policies are trained here.
        overwrite: Whether to measure again what the folder holds with other settings, or damaged.
        setup: What the environments have in common.
        models: OpenSim models that `validation` converts, too.
    """

    experiment: Experiment
    folder: Path
    seeds: int
    num_worlds: int
    quick: bool
    retrain: bool
    overwrite: bool
    setup: Setup
    models: tuple[Path, ...]


def plan_experiment(
    name: str,
    *,
    quick: bool = False,
    retrain: bool = False,
    seeds: int | None = None,
    num_worlds: int | None = None,
    output: Path | None = None,
    overwrite: bool = False,
    models: Sequence[Path] = (),
    setup: Setup = Setup(),
) -> ExperimentJob:
    """Return the experiment that is asked for, checked; nothing is built or written.

    Args:
        name: Name in `EXPERIMENTS`.
        quick: Whether protocols are shorter, for a first look within two minutes.
        retrain: Whether policies are trained here, instead of taking those of the package.
        seeds: Number of seeds, each with a policy of its own; None: 5, 2 if quick.
        num_worlds: Worlds of each seed and condition; None: 64, 4 if quick.
        output: Folder of the results; None: out/reproduce/<name>, with -quick and -retrain where chosen.
        overwrite: Whether to measure again what the folder holds with other settings, or damaged.
        models: OpenSim models that `validation` converts, too.
        setup: What the environments of all experiments have in common, such as device and muscle model.

    Raises:
        ValueError: An argument is wrong.
        ImportError: A package is not installed.
    """
    experiment = EXPERIMENTS[name]
    asked: dict[str, object] = {"quick": quick, "retrain": retrain, "seeds": seeds, "num_worlds": num_worlds}
    said = {name: value for name, value in setup.plain().items() if value}
    asked |= {"models": tuple(models), "device": None, **said}
    for option in (*experiment.ignores, *(said if "device" in experiment.ignores else ())):
        if asked.get(option) not in (None, False, ()):
            flag = "--" + option.replace("_", "-")
            raise ValueError(f"experiment {name!r} does not read {flag}; leave it out")
    number = seeds if seeds is not None else QUICK_SEEDS if quick else SEEDS
    worlds = num_worlds if num_worlds is not None else QUICK_WORLDS if quick else WORLDS
    check_least(1, MOST_SEEDS, seeds=number)
    check_least(1, MOST_WORLDS, num_worlds=worlds)
    check_flag("quick", quick)
    check_flag("retrain", retrain)
    setup.check()
    check_device_name(setup.device)
    if missing := [path for path in models if not path.is_file()]:
        raise ValueError(f"--models {str(missing[0])!r} is no file; give the path of an .osim file")
    for package in ("matplotlib", "scipy"):
        check_installed("reproduce", package, "plot")
    folder = output or report.output_folder(name, quick, retrain)
    check_folder(folder)
    return ExperimentJob(experiment, folder, number, worlds, quick, retrain, overwrite, setup, tuple(models))


def reproduce(job: ExperimentJob) -> Findings:
    """Run an experiment, and write figures, table, numbers and page into its folder.

    Raises:
        ValueError: The device is not there, or a kept run is another one's.
        OSError: A file cannot be written.
    """
    resolve_device(job.setup.device)
    make_folder(job.folder)
    lab = Lab(
        *(job.folder, tuple(range(job.seeds)), job.num_worlds, job.quick),
        *(job.retrain, job.overwrite, job.setup, job.models),
    )
    try:
        findings = job.experiment.run(lab)
    finally:
        lab.close()
    report.write(job.experiment, lab, findings)
    return findings
