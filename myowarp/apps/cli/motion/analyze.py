"""The step `myowarp motion analyze`."""

from __future__ import annotations

from dataclasses import dataclass

from myowarp.apps.cli.motion.steps import (
    OUT,
    Contact,
    Filter,
    FunctionPaths,
    Model,
    Output,
    Recorded,
    Span,
    ToolFile,
    along,
    bones_of,
    check_results,
    needed,
    page_of,
    say_saved,
    setup_of,
)
from myowarp.apps.cli.options import Overwrite

FILES = (
    *("lengths.sto", "velocities.sto", "moment_arms.sto", "active_forces.sto", "passive_forces.sto"),
    *("full_powers.sto", "passive_moments.sto", "contact_forces.sto", "report.html"),
)


@dataclass
class Analyze:
    """Follow muscles along a motion: lengths, velocities, moment arms, greatest forces; and a page on them.

    Example: myowarp motion analyze gait.osim --motion ik.mot
    """

    model: Model
    motion: Recorded = None
    setup: ToolFile = None
    function_paths: FunctionPaths = None
    contact: Contact = None
    filter: Filter = None
    span: Span = None
    output: Output = OUT
    overwrite: Overwrite = False

    def __call__(self) -> None:
        """Check, solve, write."""
        from myowarp.motion import trial
        from myowarp.motion.streams import is_long

        setup = setup_of(
            self.setup, motion=self.motion, contact=self.contact, cutoff=self.filter, span=self.span
        )
        motion = needed(setup.motion, "analyze", "motion")
        check_results(self.output, FILES, self.overwrite, ("passive_moments.sto", "report.html"))
        bones = bones_of(self.model, setup, self.function_paths)
        lines = along(
            bones, setup, motion, self.output, lambda part, tables, _: trial.analyze(bones, part, tables)
        )
        long = is_long(motion)
        lines += (
            ["no page: the motion is too long for one"] if long else page_of(self.output, self.model, motion)
        )
        say_saved(lines, FILES, self.output)
