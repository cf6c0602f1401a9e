"""A model and its worlds, as a physics step takes them, whatever they are for."""

from dataclasses import dataclass

import mujoco
import mujoco_warp as mjw
import warp as wp

from myowarp.definitions.forces import Forces
from myowarp.definitions.ground import Ground
from myowarp.definitions.muscle import MuscleModel
from myowarp.definitions.paths import Paths


@dataclass(frozen=True)
class Stepped:
    """A model and the state of all worlds.

    Attributes:
        oracle: Model with MuJoCo's built-in muscles, host; what our kernels must reproduce.
        model: Stepped model, stateless actuators.
        data: State and results of all worlds.
        muscles: The muscles of all worlds.
        sites: Ids of the sites whose poses are read outside of the step.
        qpos_start: Configuration to start from, shape (nq,).
        num_substeps: Physics steps in a control step.
        batched: Fields of the model that each world has for itself.
        paths: Of tendons, where the model brings its own; None: they are the engine's.
        forces: Springs and dampers that the model brings along; None: it brings none.
        ground: Height field whose contacts are ours; None: there is none.
        remaining: How many of them are left, shape (1,), where all that acts within them is of this package;
            None: what they compute may be read in each.
    """

    oracle: mujoco.MjModel
    model: mjw.Model
    data: mjw.Data
    muscles: MuscleModel
    sites: tuple[int, ...]
    qpos_start: wp.array
    num_substeps: int
    batched: frozenset[str] = frozenset()
    paths: Paths | None = None
    forces: Forces | None = None
    ground: Ground | None = None
    remaining: wp.array | None = None

    @property
    def device(self) -> wp.Device:
        """Device of the worlds."""
        return self.data.qpos.device
