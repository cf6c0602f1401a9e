"""The command `myowarp cohort`: a table of patients."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from myowarp.apps.cli.options import Asked, Overwrite, Policy, Steps, environment, optional
from myowarp.definitions.registry import check_least


@dataclass
class Cohort:
    """Simulate a table of patients, all at once: results as tidy tables, and a plot.

    The table has one row per patient and a column for everything in which patients differ, such as
    strength (1 if healthy), fatigue_rate [1/s], load_mass [kg], exo_assistance, tendon_tear (names of
    muscles) or tendon_transfer (0 or 1); a wrong name lists all. Missing columns default to healthy. All
    patients get identical initial states, goals and noise seeds, so only their bodies differ.

    Example: raise the forearm from hanging down, and hold it for ten seconds:
    myowarp cohort examples/elbow_cohort.csv --task myoElbowPose1D6MFixed-v0 --reset fixed --steps 500
    """

    table: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TABLE")]
    """Patients, .csv or .parquet."""
    asked: Annotated[Asked, environment(flag=True, leave_out=("horizon",))]
    policy: Policy = "hold"
    output: Path = Path("out/cohort")
    """Folder for results, summary.csv, settings.json, plot.png; assistance.png if it and strength vary."""
    steps: Steps = None
    trials: int = 1
    """Episodes of each patient; trial k has the same start, goal and noise for all."""
    every: Annotated[int | None, optional("INT")] = None
    """Control steps from one row of the results to the next; by default steps / 100."""
    format: Literal["parquet", "csv"] = "parquet"
    """Format of the results."""
    overwrite: Overwrite = False
    ray: bool = False
    """Simulate chunk by chunk over a Ray cluster, into a Parquet dataset; the same command goes on."""
    address: Annotated[str | None, optional("HOST:PORT")] = None
    """With --ray: head of a cluster, or auto; by default this machine alone."""
    chunk: int = 4096
    """With --ray: patients that are simulated together."""
    cpus: int = 1
    """With --ray: cores of each chunk."""

    def __call__(self) -> None:
        """Check, run, write."""
        from myowarp.apps.studies.cohort import job as command

        settings = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        settings["what"] = settings.pop("asked").setup
        over = {name: settings.pop(name) for name in ("address", "chunk", "cpus")}
        if settings.pop("ray"):
            self._in_chunks(settings, over)
            return
        table, output, suffix = settings.pop("table"), settings.pop("output"), settings.pop("format")
        console, overwrite = Console(stderr=True, highlight=False, soft_wrap=True), settings.pop("overwrite")
        command.run(table, output, f".{suffix}", console, overwrite, **settings)

    def _in_chunks(self, settings: dict[str, Any], over: dict[str, Any]) -> None:
        """Check, and run over a cluster."""
        from myowarp.apps.studies.cohort import chunks

        check_least(1, chunk=self.chunk, cpus=self.cpus)
        if settings.pop("format") != "parquet" or settings.pop("overwrite"):
            raise ValueError(
                "--ray writes parquet and goes on with what is there; leave out --format and --overwrite"
            )
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        chunks.run(settings.pop("table"), settings.pop("output"), console, **over, **settings)
