"""The physics step that a model asks for: the engine's, or one in free coordinates."""

import logging

import mujoco
import mujoco_warp as mjw

from myowarp.engine.stage import or_the_engines
from myowarp.engine.step import Step, uncovered
from myowarp.engine.stepped import Stepped
from myowarp.osim.bundle.couplings import Couplings, couplings
from myowarp.osim.bundle.loops import loop_rows

logger = logging.getLogger("myowarp")


def step_of(stepped: Stepped) -> Step:
    """Return the physics step of a model: its joints follow exactly where it asks for that and they can.

    A line is logged where it asks for it and they cannot. The model loses equalities that its step does
    without.
    """
    if not _asks(stepped.oracle):
        return Step(stepped)
    with or_the_engines("free_coordinates"):
        from myowarp.coordinates.free_coordinates import FreeCoordinates

        reason = uncovered(stepped) or FreeCoordinates.obstacle(stepped)
        if reason is None:
            return FreeCoordinates(stepped)
        logger.warning("joints follow others by the engine's springs, not exactly: %s", reason)
    return Step(stepped)


def data_beside(model: mujoco.MjModel, worlds: int, contacts: int, rows: int) -> mjw.Data | None:
    """Return what the step of a model allocates beside the engine's arrays, to be counted; None: nothing.

    Args:
        model: The model.
        worlds: Number of worlds.
        contacts: Contacts a world.
        rows: Rows of constraints a world.
    """
    if _asks(model):
        with or_the_engines("free_coordinates"):
            from myowarp.coordinates.free_coordinates import chain, free_data

            return free_data(chain(model, couplings(model)), worlds, contacts, rows)
    return None


def _asks(model: mujoco.MjModel) -> bool:
    """Return whether a model asks for joints that follow or loops that close exactly, and has some."""
    said = Couplings.of(model)
    return said is not None and bool(couplings(model) or said.acts or loop_rows(model))
