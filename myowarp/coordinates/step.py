"""The physics step that a model asks for: the engine's, or one in free coordinates."""

import logging

from myowarp.coordinates.couplings import couplings, exact
from myowarp.engine.stage import or_the_engines
from myowarp.engine.step import Step, uncovered
from myowarp.engine.stepped import Stepped

logger = logging.getLogger("myowarp")


def step_of(stepped: Stepped) -> Step:
    """Return the physics step of a model: its joints follow exactly where it asks for that and they can.

    A line is logged where it asks for it and they cannot. The model loses equalities that its step does
    without.
    """
    said = exact(stepped.oracle)
    if said is None or not (couplings(stepped.oracle) or said.turns_otherwise):
        return Step(stepped)
    with or_the_engines("free_coordinates"):
        from myowarp.coordinates.free_coordinates import FreeCoordinates

        reason = uncovered(stepped) or FreeCoordinates.obstacle(stepped)
        if reason is None:
            return FreeCoordinates(stepped)
        logger.warning("joints follow others by the engine's springs, not exactly: %s", reason)
    return Step(stepped)
