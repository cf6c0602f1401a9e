"""The command `myowarp plot`: what muscles did, what they can do, and how a policy learned."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from myowarp.apps.cli.options import Asked, Overwrite, environment, optional
from myowarp.definitions.registry import check_least
from myowarp.extras import check_installed

if TYPE_CHECKING:
    from myowarp.definitions.setup import Setup

BODY = ("moment-arms", "force-length", "force-velocity")
LEARNING, ASSISTANCE, MOTION = "learning", "assistance", "motion"
RECORDER = "`myowarp rollout ID --signals run.parquet`"
WRITERS = {LEARNING: "`myowarp train`", ASSISTANCE: "`myowarp cohort`", MOTION: "`myowarp motion`"}
"""Commands that write what is drawn."""


@dataclass
class Plot:
    """Draw a figure to a .png or .pdf.

    Of a recording of `myowarp rollout --signals`, over time: activation, excitation, force, length, velocity
    or power of muscles, and what conditions show, such as fatigue.
    myowarp plot activation run.parquet --muscles BIClong BRA

    Of a body, by task id or MJCF file: moment-arms over a joint's range; force-length and force-velocity.
    myowarp plot moment-arms myoElbowPose1D6MRandom-v0 --joint r_elbow_flex
    myowarp plot force-length myoElbowPose1D6MRandom-v0 --models mujoco millard2012 thelen2003

    Of a cohort of strengths and exoskeletons, the folder of `myowarp cohort`: assistance, heat maps of the
    outcome, effort, and effort saved per newton metre.
    myowarp plot assistance out/cohort

    Of a table of `myowarp motion` or OpenSim, .sto or .mot: motion, left beside right, at a journal's size.
    myowarp plot motion out/trial/moments.sto --cycle 0.6 1.8 --mass 70 -o moments.pdf
    myowarp plot motion out/trial/forces.sto --columns thigh=rect_fem,vas_int calf=soleus -o out/thigh.pdf

    Of one or several trainings, CSV files with a column `samples`: learning.
    myowarp plot learning runs/a/progress.csv runs/b/progress.csv --columns return
    """

    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="WHAT")]
    """A signal, such as activation or fatigue; moment-arms, force-length, force-velocity; assistance;
    motion; or learning."""
    sources: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE ...")]
    """A recording (.parquet, .npz), a task id or MJCF file, a cohort's folder, a .sto, or CSV files."""
    asked: Annotated[Asked, environment(only=("muscle", "muscle_parameters"))]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out/plot.png")
    """File to write, .png or .pdf."""
    muscles: Annotated[tuple[str, ...], optional("[NAME ...]")] = ()
    """Muscles to show; by default the twelve that do most."""
    models: Annotated[tuple[str, ...], optional("[NAME ...]")] = ()
    """Muscle models of force-length and force-velocity, side by side; by default that of --muscle."""
    joint: Annotated[str | None, optional("NAME")] = None
    """Joint over whose range moment arms are shown; by default the first that the muscles move."""
    world: int = 0
    """World of the recording."""
    episode: Annotated[int | None, optional("INT")] = None
    """Episode of that world; by default its first in the recording."""
    columns: Annotated[tuple[str, ...], optional("[NAME ...]")] = ()
    """Columns of the CSV files; by default those with `return` or `success` in their name. Of motion:
    quantities without their side, such as knee_angle, or groups of them, NAME=a,b; by default the groups of
    --model, or the greatest."""
    model: Annotated[Path | None, optional("FILE")] = None
    """Of motion: the OpenSim model, whose groups of muscles become panels."""
    cycle: Annotated[tuple[float, float] | None, optional("START END")] = None
    """Of motion: first and last time [s], drawn from 0 to 100 %; by default all is drawn over time."""
    cycle_left: Annotated[tuple[float, float] | None, optional("START END")] = None
    """The same of the left side; by default --cycle."""
    mass: Annotated[float | None, optional("KG")] = None
    """Of motion: mass of the person, by which forces (as weight), moments and powers are divided."""
    overwrite: Overwrite = False

    def __call__(self) -> None:
        """Check, read, draw."""
        from myowarp.apps.reports import panel
        from myowarp.disk import check_folder, check_output, check_overwrite, make_folder

        check_installed("plot", "matplotlib", "plot")
        self._check_motion()
        self._check_sources()
        check_folder(self.output.parent)
        make_folder(self.output.parent)
        check_output(self.output, ".png", ".pdf")
        check_overwrite((self.output,), self.overwrite)
        look, dpi = (7.0, 300) if self.what == MOTION else (10.0, 150)
        with panel.style(look):
            panel.save(self._draw(), self.output, dpi=dpi)
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"Saved {self.output}")

    def _draw(self):
        """Return the figure."""
        from myowarp.apps.reports import figures
        from myowarp.sim.build import oracle_model

        if self.what == LEARNING:
            return figures.learning([Path(source) for source in self.sources], self.columns)
        if len(self.sources) != 1:
            raise ValueError(f"plot {self.what} shows one recording, body or cohort, got {len(self.sources)}")
        source = self.sources[0]
        if self.what == MOTION:
            from myowarp.apps.reports.motion_curves import curves

            cycles = None if self.cycle is None else {"": self.cycle, "l": self.cycle_left or self.cycle}
            return curves(Path(source), self.columns, cycles, self.mass, self.model)
        if self.what == ASSISTANCE:
            from myowarp.apps.studies.cohort.assistance import assistance_map, read_summary

            return assistance_map(*read_summary(Path(source)))
        if self.what in BODY:
            setup, title = find_setup(source, self.asked.setup)
            if self.what == "moment-arms":
                return figures.moment_arms(oracle_model(setup.spec), title, self.joint, self.muscles)
            return figures.contraction(setup, title, self.what, self.muscles, self.models)
        check_least(0, world=self.world)
        course = figures.read_course(Path(source), self.what, self.world, self.episode)
        return figures.over_time(course, self.muscles)

    def _check_sources(self) -> None:
        """Raise ValueError if there is no source, or one is a file or folder that does not exist."""
        if not self.sources:
            raise ValueError(
                f"plot needs WHAT and a SOURCE behind it, such as activation run.parquet, got {self.what!r} "
                "alone; myowarp plot --help lists them"
            )
        for source in () if self.what in BODY else self.sources:
            if not Path(source).exists():
                raise ValueError(f"{source!r} does not exist; {WRITERS.get(self.what, RECORDER)} writes one")

    def _check_motion(self) -> None:
        """Raise ValueError if options of motion are of something else, or no person's."""
        for name in ("cycle", "cycle_left", "mass", "model"):
            if getattr(self, name) is not None and self.what != MOTION:
                raise ValueError(f"--{name.replace('_', '-')} belongs to plot motion, got plot {self.what}")
        if self.cycle_left is not None and self.cycle is None:
            raise ValueError("--cycle-left needs --cycle, the times of the right side")
        if self.mass is not None and not 0.0 < self.mass < float("inf"):
            raise ValueError(f"--mass must be positive and finite, got {self.mass:g}")


def find_setup(source: str, asked: Setup) -> tuple[Setup, str]:
    """Return the setup of a task id or of an MJCF file, with what was asked, and a name for its body.

    Raises:
        ValueError: It is neither.
    """
    from myowarp.tasks.setups import complete

    is_file = Path(source).suffix.lower() == ".xml"
    setup = complete(dataclasses.replace(asked, task=Path(source) if is_file else source))
    return setup, source if is_file else setup.spec.body
