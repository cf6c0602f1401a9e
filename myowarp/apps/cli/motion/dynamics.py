"""The step `myowarp motion dynamics`."""

from __future__ import annotations

from dataclasses import dataclass

from myowarp.apps.cli.motion.steps import (
    OUT,
    Contact,
    Filter,
    FunctionPaths,
    Loading,
    Model,
    Output,
    Recorded,
    Span,
    ToolFile,
    along,
    bones_of,
    check_results,
    needed,
    say_saved,
    setup_of,
)
from myowarp.apps.cli.options import Overwrite

FILES = "moments.sto", "passive_moments.sto", "contact_forces.sto"


@dataclass
class Dynamics:
    """Find the joint moments of a motion under external loads.

    Example: myowarp motion dynamics gait.osim --motion ik.mot --loads grf.xml --filter 6
    """

    model: Model
    motion: Recorded = None
    setup: ToolFile = None
    function_paths: FunctionPaths = None
    loads: Loading = None
    contact: Contact = None
    filter: Filter = None
    span: Span = None
    output: Output = OUT
    overwrite: Overwrite = False

    def __call__(self) -> None:
        """Check, solve, write."""
        from myowarp.motion import trial

        setup = setup_of(
            self.setup,
            motion=self.motion,
            contact=self.contact,
            loads=self.loads,
            cutoff=self.filter,
            span=self.span,
        )
        motion = needed(setup.motion, "dynamics", "motion")
        check_results(self.output, FILES, self.overwrite, ("passive_moments.sto",))
        bones = bones_of(self.model, setup, self.function_paths)
        lines = along(
            bones,
            setup,
            motion,
            self.output,
            lambda part, tables, loads: trial.dynamics(bones, part, tables, loads),
        )
        say_saved(lines, FILES, self.output)
