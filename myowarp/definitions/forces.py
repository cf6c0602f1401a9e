"""Forces along a model's joints besides those of engine, muscles and motors."""

from typing import Protocol

import mujoco_warp as mjw


class Forces(Protocol):
    """Springs and dampers that the engine does not have."""

    def launch_damping(self, model: mjw.Model, data: mjw.Data) -> None:
        """Write `dof_damping`, which the engine's passive force and integrator read, from `qpos`."""

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Add all other forces to `qfrc_passive`; tendons, their Jacobian and velocities are those of now."""
