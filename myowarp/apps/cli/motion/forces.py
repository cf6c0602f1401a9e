"""The step `myowarp motion forces`."""

from __future__ import annotations

from dataclasses import dataclass

from myowarp.apps.cli.motion import options as of
from myowarp.apps.cli.motion.said import Lacking
from myowarp.apps.cli.motion.steps import along, say_saved, setup_of

RENEWS = "moments.sto", "passive_moments.sto", "contact_forces.sto"
FILES = (
    *RENEWS,
    *("actuators.sto", "activations.sto", "forces.sto", "powers.sto", "metabolic_powers.sto"),
    *("joint_reactions.sto", "reserves.sto", "missing.sto"),
)


@dataclass
class Forces(of.Along):
    """Find the muscle forces of a motion by static optimisation.

    The sum of activations to a power is the least that gives every joint moment. --reserve adds an actuator
    to every coordinate for what muscles cannot give; the last lines say what is missing.

    Example: myowarp motion forces gait.osim --motion ik.mot --loads grf.xml --filter 6 --reserve 10
    """

    loads: of.Loads = None
    mode: of.Mode = "equilibrium"
    exponent: of.Exponent = None
    reserve: of.Reserve = None
    residual: of.Residual = None

    def __call__(self) -> None:
        """Check, solve, write."""
        from myowarp.motion.steps import forces

        lacking = Lacking()
        lines = along(self, setup_of(self), forces, FILES, RENEWS, lacking.add)
        say_saved([*lines, *lacking.lines()], FILES, self.output)
