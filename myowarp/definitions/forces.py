"""Forces along a model's joints besides those of engine, muscles and motors."""

from typing import Protocol

import mujoco_warp as mjw
import warp as wp


class Forces(Protocol):
    """Springs and dampers that the engine does not have."""

    def launch_damping(self, model: mjw.Model, data: mjw.Data) -> None:
        """Write `dof_damping`, which the engine's passive force and integrator read, from `qpos`."""

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Add all other forces to `qfrc_passive`; tendons, their Jacobian and velocities are those of now."""

    def launch_implicit(self, model: mjw.Model, data: mjw.Data, directions: wp.array) -> None:
        """Add - h dF/dv of forces that are stiff in velocity to `M`, behind `launch`.

        Speeds are along `directions`, shape (num_worlds, nv), spatial vectors as `cdof`.
        """
