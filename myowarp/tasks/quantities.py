"""Quantities that a function of one world can read: its state and its muscles."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import warp as wp

from myowarp.definitions.scene import Scene
from myowarp.engine.patch import engine_kernels_alone
from myowarp.kernels.launch import launch
from myowarp.sim.metabolics import LAWS, known_metabolics
from myowarp.sim.present import present_muscles


@dataclass(frozen=True)
class Quantity:
    """A quantity that a function's parameter can name.

    Attributes:
        dtype: Type of the entries of a world's row.
        unit: Their unit.
        meaning: What they are.
    """

    dtype: type
    unit: str
    meaning: str


QUANTITIES = {
    "qpos": Quantity(wp.float32, "rad or m", "configuration, (nq,)"),
    "qvel": Quantity(wp.float32, "rad/s or m/s", "velocity, (nv,)"),
    "ctrl": Quantity(wp.float32, "1", "what all actuators were told, (nu,)"),
    "excitation": Quantity(wp.float32, "1", "what the muscles were told, after conditions, (num_muscles,)"),
    "activation": Quantity(wp.float32, "1", "activation, (num_muscles,)"),
    "tension": Quantity(wp.float32, "N", "force that the tendon transmits, >= 0, (num_muscles,)"),
    "length": Quantity(wp.float32, "m", "musculotendon length, (num_muscles,)"),
    "velocity": Quantity(wp.float32, "m/s", "its rate, lengthening > 0, (num_muscles,)"),
    "bhargava2004": Quantity(wp.float32, "W", "metabolic rate after Bhargava 2004, (num_muscles,)"),
    "umberger2010": Quantity(wp.float32, "W", "metabolic rate after Umberger 2010, (num_muscles,)"),
    "site_xpos": Quantity(wp.vec3f, "m", "positions of `sites`, in their order, (num_sites,)"),
}
"""Quantities of every task: parameters of the type `wp.array[float]`, of `site_xpos` `wp.array[wp.vec3]`."""

SITES = "site_numbers"  # all coordinates of `site_xpos` in a row, to be observed
OF_STATE = ("qpos", "qvel", "ctrl")
OF_MUSCLES = ("tension", "length", "velocity")  # they are computed anew for the present state


@wp.kernel(enable_backward=False)
def pick_excitations(
    # Params:
    actuator_id: wp.array[int],
    # Data in:
    ctrl_in: wp.array2d[float],
    # Out:
    excitation: wp.array2d[float],
):
    """excitation[world, muscle] = ctrl[world, actuator_id[muscle]]."""
    worldid, muscleid = wp.tid()
    excitation[worldid, muscleid] = ctrl_in[worldid, actuator_id[muscleid]]


@wp.kernel(enable_backward=False)
def pick_sites(
    # Params:
    site_id: wp.array[int],
    # Data in:
    site_xpos_in: wp.array2d[wp.vec3],
    # Out:
    position: wp.array2d[wp.vec3],
):
    """position[world, i] = site_xpos[world, site_id[i]]."""
    worldid, i = wp.tid()
    position[worldid, i] = site_xpos_in[worldid, site_id[i]]


class Present:
    """Quantities of the present state of a scene.

    Attributes:
        arrays: By name in `QUANTITIES`, (num_worlds, n).
    """

    def __init__(self, scene: Scene, names: Iterable[str], sites: Iterable[str]) -> None:
        """Allocate what is not there already.

        Args:
            scene: The scene.
            names: What is read.
            sites: Names of the sites of `site_xpos`.

        Raises:
            ValueError: A metabolic rate is read, and the muscle model does not tell what its fibers do.
        """
        self.scene, self.names = scene, frozenset(names)
        self.actuator_id = wp.array(scene.muscles.actuator_id, dtype=int)
        self.site_id = wp.array([scene.site_id(name) for name in sites], dtype=int)
        self.excitation = wp.zeros((scene.num_worlds, len(self.actuator_id)), dtype=float)
        self.position = wp.zeros((scene.num_worlds, len(self.site_id)), dtype=wp.vec3)
        self.arrays = {name: getattr(scene.data, name) for name in OF_STATE}
        self.arrays |= {name: getattr(scene.muscles, name) for name in ("activation", *OF_MUSCLES)}
        self.arrays |= {
            "excitation": self.excitation,
            "site_xpos": self.position,
            SITES: _flat(self.position),
        }
        self._compute_muscles = present_muscles(scene)
        laws = self.names.intersection(LAWS)
        self._metabolics = known_metabolics(scene, min(laws)) if laws else None
        if self._metabolics is not None:
            self.arrays |= {name: getattr(self._metabolics.rates, name) for name in LAWS}

    def update(self) -> None:
        """Launch what brings the quantities that are read to the present state."""
        data = self.scene.data
        if self.names.intersection(OF_MUSCLES) or self._metabolics is not None:
            with engine_kernels_alone():
                self._compute_muscles()
        if self._metabolics is not None:
            self._metabolics.launch()
        if "excitation" in self.names:
            launch(pick_excitations, self.excitation.shape, self, data)
        if self.names & {"site_xpos", SITES}:
            launch(pick_sites, self.position.shape, self, data)


def _flat(points: wp.array) -> wp.array:
    """Return points (num_worlds, n) as the same memory, (num_worlds, 3 n) of floats."""
    shape = (points.shape[0], 3 * points.shape[1])
    return wp.array(ptr=points.ptr, dtype=float, shape=shape, device=points.device)
