"""A body that nothing holds: it falls freely, whatever its muscles do.

Muscles pull parts of a body at each other, so that its center of mass accelerates as gravity says until
something outside touches it. A model of OpenSim has no controller that keeps it on its feet, and often no
contact with its floor.
"""

import mujoco
import numpy as np

from myowarp.apps.rollouts.run import Step, Watcher
from myowarp.sim.simulation import Simulation
from myowarp.view.drawing.style import carried_root

FIRST = 0.3
"""s from the start of an episode; a body that is dropped falls half a metre."""
NEAR = 0.02
"""Of gravity: what is less away from it is a free fall."""


class Fall(Watcher):
    """Follows the center of mass of the first world's body from the start of its first episode."""

    def __init__(self, sim: Simulation) -> None:
        self._sim, self._data = sim, mujoco.MjData(sim.scene.oracle)
        self._root = carried_root(sim.scene.oracle)
        self._most = max(3, round(FIRST / sim.scene.control_dt)) if self._root else 0
        self._places: list[np.ndarray] = []
        self._begun = False

    def start(self, mask: np.ndarray) -> None:
        """Begin with the first start; episodes after it are not looked at."""
        if mask[0]:
            self._most = len(self._places) if self._begun else self._most
            self._begun = True
            self._look()

    def see(self, step: Step) -> None:
        """Keep where the body is; after the end of an episode it is where the next one starts."""
        if step.ended[0]:
            self._most = len(self._places)
        self._look()

    def _look(self) -> None:
        if len(self._places) < self._most:
            model, data = self._sim.scene.oracle, self._data
            data.qpos[:] = self._sim.scene.data.qpos[0:1].numpy()[0]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            self._places.append(data.subtree_com[self._root].copy())

    def text(self) -> str:
        """Return, in a sentence, that the body falls freely; "" where it does not, or has no free root."""
        if len(self._places) < 3:
            return ""
        model, dt = self._sim.scene.oracle, self._sim.scene.control_dt
        times = dt * np.arange(len(self._places))
        found, gravity = 2.0 * np.polyfit(times, np.array(self._places), 2)[0], model.opt.gravity
        if np.linalg.norm(found - gravity) >= NEAR * np.linalg.norm(gravity):
            return ""
        return (
            f"Nothing holds {model.body(self._root).name}: the model falls freely from the start; "
            "--held holds it in place, as in a harness"
        )
