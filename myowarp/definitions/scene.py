"""A task made concrete: names resolved to ids, the body slimmed, all arrays allocated.

Every shape is fixed; the step only launches kernels over these arrays.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.definitions.forces import Forces
from myowarp.definitions.ground import Ground
from myowarp.definitions.muscle import MuscleModel
from myowarp.definitions.paths import Paths
from myowarp.definitions.task import TaskSpec
from myowarp.definitions.worlds import Worlds
from myowarp.kernels.random import RandomKeys


@dataclass(frozen=True)
class Capacity:
    """Sizes for one world.

    Attributes:
        contacts: Contacts, and candidate pairs of the broad phase.
        rows: Constraint rows.
        peak_contacts: Largest number of contacts seen.
    """

    contacts: int
    rows: int
    peak_contacts: int


class Starts(NamedTuple):
    """Random start configurations of a task.

    Attributes:
        values: Coordinates, shape (num_starts, num_coordinates).
        address: Which of `qpos` they are, shape (num_coordinates,).
    """

    values: np.ndarray
    address: np.ndarray


@dataclass
class Scene:
    """A compiled task.

    Attributes:
        spec: The task.
        worlds: Worlds stepped together.
        num_substeps: Physics steps in a control step, after the physics preset.
        num_actions: Actuators that the policy commands, the first ones.
        oracle: Slim model with MuJoCo's built-in muscles, host; what our kernels must reproduce.
        model: Stepped model, stateless actuators.
        data: State and results of all worlds. Where stages of ours act, only the sites in `spec.sites`
            have their pose in it; `mujoco_warp.kinematics(model, data)` brings up the others.
        muscles: The muscles of all worlds.
        keys: What random numbers are drawn from.
        qpos_start: Start configuration of an episode, shape (nq,).
        reset: What episodes start from, one of `definitions.task.RESETS`.
        actuator_kind: How an action becomes a control, MUSCLE or MOTOR (linear), shape (nu,).
        capacity: Contacts and constraint rows that the arrays hold.
        batched: Fields of the model that each world has for itself, by the task and the conditions.
        state: All that a world is from one step to the next, by name: arrays (num_worlds, ...).
        parameters: Those of the conditions (`Parameter`), in the order of their binding.
        paths: Of tendons, where the model brings its own; None: they are the engine's.
        forces: Springs and dampers that the model brings along; None: it brings none.
        ground: Height field whose contacts are ours; None: there is none.
    """

    spec: TaskSpec
    worlds: Worlds
    num_substeps: int
    num_actions: int
    oracle: mujoco.MjModel
    model: mjw.Model
    data: mjw.Data
    muscles: MuscleModel
    keys: RandomKeys
    qpos_start: wp.array
    reset: str
    actuator_kind: wp.array
    capacity: Capacity
    batched: frozenset[str]
    device: wp.Device = field(repr=False)
    state: dict[str, wp.array] = field(default_factory=dict, repr=False)
    parameters: list[Any] = field(default_factory=list, repr=False)
    paths: Paths | None = None
    forces: Forces | None = None
    ground: Ground | None = None

    @property
    def num_worlds(self) -> int:
        """Worlds stepped together."""
        return self.worlds.number

    @property
    def control_dt(self) -> float:
        """Duration of a control step [s]."""
        return self.spec.control_dt

    def zeros(self, name: str, *shape: int, dtype: type = float) -> wp.array:
        """Allocate state of the worlds: it is saved and restored with them (`myowarp.sim.state`).

        Args:
            name: What it is called, with its owner: `task.target`, `condition.fatigue_3ccr.rounding`.
            shape: Its shape in one world.
            dtype: Warp type.

        Returns:
            Zeros on the current Warp device, shape `(num_worlds, *shape)`.

        Raises:
            ValueError: The name is taken.
        """
        return self._keep(name, wp.zeros((self.num_worlds, *shape), dtype=dtype))

    def adopt(
        self, owner: str, holder: Any, names: Iterable[str] | None = None, *, state: bool = True
    ) -> None:
        """Make arrays of an object visible from outside a part, where they are rows of those over all worlds.

        Args:
            owner: What the object is called.
            holder: The object, whose arrays (num_worlds, ...) no launch has been captured with yet.
            names: Its attributes; None: all arrays of a Warp struct.
            state: Whether they are state of the worlds, as those of `zeros` are.

        Raises:
            ValueError: The name of a state is taken.
        """
        take = self._keep if state else self.worlds.rows
        arrays = (name for name, value in vars(holder).items() if isinstance(value, wp.array))
        for name in tuple(arrays) if names is None else names:
            setattr(holder, name, take(f"{owner}.{name}", getattr(holder, name)))

    def _keep(self, name: str, array: wp.array) -> wp.array:
        """Return what is state in place of an array."""
        if name in self.state:
            raise ValueError(f"state {name!r} is there already; give it a name of its own")
        self.state[name] = self.worlds.rows(name, array)
        return self.state[name]

    def site_id(self, name: str) -> int:
        """Return the id of a site of the stepped model."""
        return self.oracle.site(name).id
