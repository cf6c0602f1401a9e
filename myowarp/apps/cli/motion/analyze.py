"""The step `myowarp motion analyze`."""

from __future__ import annotations

from dataclasses import dataclass

from myowarp.apps.cli.motion import options as of
from myowarp.apps.cli.motion.steps import along, page_of, say_saved, setup_of

FILES = (
    *("lengths.sto", "velocities.sto", "moment_arms.sto", "active_forces.sto", "passive_forces.sto"),
    *("full_powers.sto", "passive_moments.sto", "contact_forces.sto", "report.html"),
)


@dataclass
class Analyze(of.Along):
    """Follow muscles along a motion: lengths, velocities, moment arms, greatest forces; and a page on them.

    Example: myowarp motion analyze gait.osim --motion ik.mot
    """

    def __call__(self) -> None:
        """Check, solve, write."""
        from myowarp.motion.steps import analyze

        setup = setup_of(self)
        lines = along(self, setup, analyze, FILES, ("passive_moments.sto", "report.html"))
        say_saved([*lines, *page_of(self, setup.angles)], FILES, self.output)
