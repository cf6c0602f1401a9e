"""The step `myowarp motion dynamics`."""

from __future__ import annotations

from dataclasses import dataclass

from myowarp.apps.cli.motion import options as of
from myowarp.apps.cli.motion.said import Left
from myowarp.apps.cli.motion.steps import along, say_saved, setup_of

FILES = "moments.sto", "passive_moments.sto", "contact_forces.sto"


@dataclass
class Dynamics(of.Along):
    """Find the joint moments of a motion under external loads.

    Example: myowarp motion dynamics gait.osim --motion ik.mot --loads grf.xml --filter 6
    """

    loads: of.Loads = None

    def __call__(self) -> None:
        """Check, solve, write."""
        from myowarp.motion.steps import dynamics

        left = Left()
        lines = along(self, setup_of(self), dynamics, FILES, ("passive_moments.sto",), left.add)
        say_saved([*lines, *left.lines()], FILES, self.output)
