"""Muscle models: a class with its parameters, its state, one kernel and its launcher.

It reads musculotendon length and velocity from MuJoCo's tendons and writes the force; it never knows how the
path was computed.
"""

import abc
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco import MjModel, mjtDyn

from myowarp.definitions.registry import Registry, did_you_mean
from myowarp.kernels.reset import masked_fill


@wp.struct
class Anatomy:
    """Properties that a condition can change in any muscle model; arrays (1 or num_worlds, num_muscles).

    Attributes:
        path: Actuator whose tendon the muscle pulls; its control stays its own.
        strength: Factor on the active force [1].
        transmission: Factor on the whole force [1]; 0 for a torn tendon.
    """

    path: wp.array2d[int]
    strength: wp.array2d[float]
    transmission: wp.array2d[float]


@wp.struct
class MuscleResults:
    """Results of a muscle model in every physics step; arrays (num_worlds, num_muscles).

    Attributes:
        tension: Force that the tendon transmits [N], >= 0.
        length: Musculotendon length [m] of the present path.
        velocity: Its rate [m/s], lengthening > 0.
        damping: implicitness dtension/dvelocity [N s/m], >= 0.
        workload: Time integral of the normalized active force a f_L f_V [s]; empty until `record_workload`.
    """

    tension: wp.array2d[float]
    length: wp.array2d[float]
    velocity: wp.array2d[float]
    damping: wp.array2d[float]
    workload: wp.array2d[float]


@wp.struct
class FiberStates:
    """States of the fibers of a muscle model; arrays (num_worlds, num_muscles).

    Attributes:
        norm_length: Fiber length over its optimum [1].
        velocity: Rate of the fiber length [m/s], lengthening > 0.
        norm_velocity: The same [optimal fiber lengths / s].
        active_force: Active force along the fibers, as far as the tendon transmits it [N].
        passive_force: Elastic and damping force along the fibers, likewise [N].
        active_force_length: Multiplier of the active force at this length [1].
    """

    norm_length: wp.array2d[float]
    velocity: wp.array2d[float]
    norm_velocity: wp.array2d[float]
    active_force: wp.array2d[float]
    passive_force: wp.array2d[float]
    active_force_length: wp.array2d[float]


def new_fiber_states(like: wp.array) -> FiberStates:
    """Return fiber states for as many worlds and muscles as an array has."""
    kind: Any = FiberStates
    fibers = FiberStates()
    for name in kind.vars:
        setattr(fibers, name, wp.zeros_like(like))
    return fibers


class BiasParams(wp.types.vector(10, float)):  # type: ignore[misc]  # mypy follows no call here
    """MuJoCo's `biasprm`."""


@wp.func
def affine_bias(tension: float, damping: float, velocity: float) -> BiasParams:
    """b0 = damping velocity - tension, b2 = -damping: b0 + b1 length + b2 velocity = -tension."""
    bias = BiasParams()
    bias[0] = damping * velocity - tension
    bias[2] = -damping
    return bias


@wp.kernel(enable_backward=False)
def restore_anatomy(
    # Out:
    anatomy: Anatomy,
):
    """strength = transmission = 1, from where the conditions of a control step start."""
    worldid, muscleid = wp.tid()
    anatomy.strength[worldid, muscleid] = 1.0
    anatomy.transmission[worldid, muscleid] = 1.0


class MuscleGeometry(NamedTuple):
    """Geometry of muscles for pictures and plots; host arrays (1 or num_worlds, num_muscles), NaN: not known.

    Attributes:
        max_isometric_force: Peak active force of a healthy muscle [N].
        optimal_fiber_length: Fiber length at which it has it [m].
        tendon_slack_length: Length of the tendon that no force stretches [m].
        max_contraction_velocity: Velocity at which the active force ends [optimal fiber lengths / s].
        tendon_length: Its present length [m], that of a rigid one too; fibers are the rest of the path.
    """

    max_isometric_force: np.ndarray
    optimal_fiber_length: np.ndarray
    tendon_slack_length: np.ndarray
    max_contraction_velocity: np.ndarray
    tendon_length: np.ndarray


class MuscleModel(abc.ABC):
    """The muscles of a body in all worlds: parameters, state and force.

    In the stepped model the muscles are stateless actuators, force = b0 + b1 length + b2 velocity
    (MuJoCo's AFFINE bias with gain 0). `launch`, called by the engine in every physics step between
    velocity and force stage, publishes `RESULTS` and writes `affine_bias` of them: exactly the tension, and
    for integrators that are implicit in velocity damping = implicitness dtension/dvelocity.

    A model with more state than the activation appends the names of its arrays to `STATE` and allocates them
    in `__init__`; reset, faults, shards and signals follow from the list. An elastic tendon finds its
    equilibrium in `settle`; `sample_state`, `coarse_step` and `geometry` are what others then have to know.

    Attributes:
        STATE: Names of the attributes that are state: float32 arrays (num_worlds, num_muscles, ...).
        RESULTS: Names of the attributes that `launch` writes anew.
        PARAMETERS: Least and greatest value of every parameter that a `MuscleTable` may set, by name.
        TAKES_HILL: Whether the Hill parameters of a converted model (`Body.muscles`) are its own, rather than
            what the compiled model has for MuJoCo's muscle.
        TAKES_CURVES: Whether it takes the splines of a converted model: a parameter "curves", shape (1,
            num_muscles, 3, 2, most knots), see `MuscleTable.knots`.
        actuator_id: Actuator of each muscle, shape (num_muscles,), host.
        names: Muscle names, in that order.
        activation: State [1], shape (num_worlds, num_muscles); so are the following four.
        tension: Force that the tendon transmits [N], >= 0.
        length: Musculotendon length [m] of the present path.
        velocity: Its rate [m/s], lengthening > 0.
        damping: implicitness dtension/dvelocity [N s/m], >= 0.
        coarse_step: Longest physics step that it stands [s]; preset `fast` takes none that is longer.
        midstep: Whether forces come from the activation in the middle of a physics step, exactly integrated,
            rather than from the one at its start.
        implicitness: Share of dtension/dvelocity in `damping`, 0 for explicit integrators.
        individual: Whether conditions change the anatomy, which every world then has for itself.
        anatomy: What they change in it.
        activation_time_constant: Time constant at full rise [s], shape (1 or num_worlds, num_muscles).
        deactivation_time_constant: Time constant of decay [s], shape (1 or num_worlds, num_muscles).
        workload: Time integral of the normalized active force a f_L f_V [s], shape (num_worlds,
            num_muscles), empty until `record_workload`. Whoever uses it sets it back to 0, in a reset too.
    """

    STATE: ClassVar[tuple[str, ...]] = ("activation",)
    RESULTS: ClassVar[tuple[str, ...]] = ("tension", "length", "velocity", "damping")
    PARAMETERS: ClassVar[Mapping[str, tuple[float, float]]] = {}
    TAKES_HILL: ClassVar[bool] = True
    TAKES_CURVES: ClassVar[bool] = False

    coarse_step = math.inf
    midstep = False
    implicitness = 0.0
    individual = False

    def __init__(
        self, model: MjModel, num_worlds: int, parameters: Mapping[str, np.ndarray] | None = None
    ) -> None:
        """Allocate the state for the muscles found in `model`, on the current Warp device.

        Args:
            model: Compiled model with MuJoCo's built-in muscles.
            num_worlds: Number of worlds.
            parameters: Parameters other than the model's, names in `PARAMETERS`, as `MuscleTable.of` returns
                them: shape (1 or num_worlds, num_muscles), NaN where the model's own stays.
        """
        is_muscle = model.actuator_dyntype == mjtDyn.mjDYN_MUSCLE
        self.actuator_id = np.flatnonzero(is_muscle).astype(np.int32)
        self.names = tuple(model.actuator(i).name for i in self.actuator_id)
        shape = num_worlds, len(self.names)
        self.activation = wp.zeros(shape, dtype=float)
        self.tension = wp.zeros(shape, dtype=float)
        self.length = wp.zeros(shape, dtype=float)
        self.velocity = wp.zeros(shape, dtype=float)
        self.damping = wp.zeros(shape, dtype=float)
        self.workload = wp.zeros((0, 0), dtype=float)
        self.anatomy = Anatomy()
        self._set_anatomy(1)
        self._given = dict(parameters or {})
        dynprm = model.actuator_dynprm[self.actuator_id]
        self.activation_time_constant = self._parameter("activation_time_constant", dynprm[:, 0])
        self.deactivation_time_constant = self._parameter("deactivation_time_constant", dynprm[:, 1])

    @property
    def results(self) -> MuscleResults:
        """The arrays of `RESULTS` and the workload, for a kernel."""
        results = MuscleResults()
        for name in (*self.RESULTS, "workload"):
            setattr(results, name, getattr(self, name))
        return results

    @property
    def state(self) -> dict[str, wp.array]:
        """All that the muscles remember from one physics step to the next, by name."""
        return {name: getattr(self, name) for name in self.STATE}

    def _parameter(self, name: str, own: np.ndarray) -> wp.array:
        """Return a parameter as given, shape (1 or num_worlds, num_muscles); else `own`, (num_muscles,)."""
        given = self._given.get(name, np.full((1, 1), np.nan))
        return wp.array(np.where(np.isnan(given), own, given), dtype=float)

    def individualize(self) -> None:
        """Give every world an anatomy of its own; before anything is captured."""
        self.individual = True
        self._set_anatomy(self.activation.shape[0])

    def _set_anatomy(self, rows: int) -> None:
        """Allocate a healthy anatomy."""
        shape = (rows, len(self.names))
        self.anatomy.path = wp.array(np.broadcast_to(self.actuator_id, shape).copy(), dtype=int)
        self.anatomy.strength = wp.ones(shape, dtype=float)
        self.anatomy.transmission = wp.ones(shape, dtype=float)

    @abc.abstractmethod
    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Publish `RESULTS`, write the muscles' `actuator_biasprm`, advance the state by one physics step.

        With a time step of 0 the tension is that of the present state; what this does to the state is undone.
        """

    def reset(self, mask: wp.array) -> None:
        """Put the worlds of `mask` (num_worlds,) bool to rest: all state is 0."""
        for values in self.state.values():
            masked_fill(mask, values, 0.0)

    def settle(self, mask: wp.array) -> None:  # noqa: B027 (a rigid tendon has nothing to settle)
        """Bring the state into equilibrium at the start of an episode, in the worlds of `mask` (num_worlds,).

        A reset launches it after `reset`, once the start pose is known: `length` and `velocity` are those of
        the paths in that pose. Fibers move as the path does, at constant length of the tendon.
        """

    @property
    def settles(self) -> bool:
        """Whether the model has a `settle`: for others nothing is launched."""
        return type(self).settle is not MuscleModel.settle

    def sample_state(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Return a state that the muscles may be in, by name; stages of the physics step are verified there.

        By default everything is drawn from U(0, 1).
        """
        return {name: rng.uniform(size=array.shape) for name, array in self.state.items()}

    def geometry(self) -> MuscleGeometry:
        """Return what pictures and plots show, in the present state; by default nothing is known."""
        return MuscleGeometry(*np.full((5, 1, len(self.names)), np.nan))

    def read_fibers(self, fibers: FiberStates) -> None:  # noqa: B027 (not every model has fibers to tell of)
        """Write what the fibers do in the present state; a launch.

        `length` and `velocity` are those of the present paths already. Metabolic rates come from it.
        """

    @property
    def tells_fibers(self) -> bool:
        """Whether the model has a `read_fibers`: of others no metabolic rate is known."""
        return type(self).read_fibers is not MuscleModel.read_fibers

    def record_workload(self) -> None:
        """Integrate the workload from now on; before anything is captured.

        Raises:
            ValueError: The model does not integrate it.
        """
        raise ValueError(f"fatigue_ma2009 needs a muscle model with a workload, got {type(self).__name__}")

    def set_length_range(self, muscleid: int, length_range: tuple[float, float], mask: wp.array) -> None:
        """Fit a muscle to lengths of its path, in some worlds; a launch, after `individualize`.

        Args:
            muscleid: The muscle.
            length_range: Least and greatest musculotendon length [m], over which its fibers operate.
            mask: The worlds, shape (num_worlds,) bool.

        Raises:
            ValueError: The model cannot be fitted.
        """
        raise ValueError(
            f"tendon_transfer needs a muscle model that can be fitted to a path, got {type(self).__name__}"
        )


def muscle_names(model: MjModel) -> list[str]:
    """Return the names of the actuators that are muscles, in their order."""
    muscles = np.flatnonzero(model.actuator_dyntype == mjtDyn.mjDYN_MUSCLE)
    return [model.actuator(i).name for i in muscles]


def muscle_index(muscle: str, names: Sequence[str]) -> int:
    """Return the index of a muscle; the side suffix `_r` may be left out.

    Raises:
        ValueError: No such muscle; the message lists the close names.
    """
    for name in (muscle, f"{muscle}_r"):
        if name in names:
            return list(names).index(name)
    hint = did_you_mean(muscle, names, cutoff=0.4) or f"available: {', '.join(names) or 'none'}"
    raise ValueError(f"muscle {muscle!r} unknown; {hint}")


MUSCLES: Registry[type[MuscleModel]] = Registry("muscle model")
