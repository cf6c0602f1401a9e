"""Hill muscles as functions of arrays: curves, equilibrium, forces, activation, power, with gradients.

    from myowarp.muscle import Muscles

    flexors = Muscles(
        "millard2012", max_isometric_force=[624.3, 435.6], optimal_fiber_length=[0.1157, 0.1321],
        tendon_slack_length=[0.2723, 0.1923],
    )
    held = flexors.equilibrium(activation=0.5, length=[[0.40, 0.34], [0.38, 0.32]])
    held.tendon_force  # N, (2, 2): two poses of two muscles

Arrays are NumPy's, torch's or Warp's, numbers and lists NumPy's; results are of the same kind. The last axis
of an array is that of the muscles; NumPy and torch arrays broadcast. All is computed in float64, on the
device of `Muscles`. Warp arrays are float64, have all axes, and are recorded by `wp.Tape`:

    flexors = Muscles(..., requires_grad=True)
    with wp.Tape() as tape:
        held = flexors.equilibrium(activation, length)  # Warp arrays
    tape.backward(grads={held.tendon_force: wp.ones_like(held.tendon_force)})
    flexors.parameters["tendon_slack_length"].grad

Newton's method finds an equilibrium, whose derivatives are those of the implicit function theorem. Kernels
and laws are in `laws/muscles/hill_arrays.py` and `hill_law.py`. Shapes of Millard's curves are tables and
have no gradient; torch does not record what happens here.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.registry import check_choice
from myowarp.kernels.structs import struct_of
from myowarp.laws.curves import CurveTables64
from myowarp.laws.muscles.hill_arrays import (
    ACTIVE,
    CURVES,
    PASSIVE,
    TENDON,
    VELOCITY,
    Parameters,
    contract_muscles,
    evaluate_curve,
    find_equilibrium,
    find_velocity,
    hold_muscles,
    rate_of_activation,
)
from myowarp.laws.muscles.hill_law import DEGROOTE, MILLARD, THELEN, HillMuscle64
from myowarp.laws.muscles.hill_parameters import LAWS, hill_parameters
from myowarp.models.muscles.hill import Hill

NAMES = {
    f"{name}{tail}": (law, bool(tail))
    for name, law in (("thelen2003", THELEN), ("millard2012", MILLARD), ("degroote_fregly2016", DEGROOTE))
    for tail in ("", "_rigid")
}
"""Models: law, and whether the tendon keeps its slack length."""

NEEDED = ("max_isometric_force", "optimal_fiber_length", "tendon_slack_length")
DIRECT = (
    *NEEDED,
    *("pennation_angle_at_optimal", "max_contraction_velocity", "fiber_damping", "minimum_activation"),
    *("activation_time_constant", "deactivation_time_constant"),
)
OWN = {"pennation_angle_at_optimal": 0.0, "max_contraction_velocity": 10.0}
SHARES, ROUNDING = ("activation", "excitation"), 1e-6
TIMES = {THELEN: (0.015, 0.05), MILLARD: (0.01, 0.04), DEGROOTE: (0.015, 0.06)}  # s, rise and fall


class Equilibrium(NamedTuple):
    """Equilibrium of fiber and tendon.

    Attributes:
        fiber_length: [m].
        tendon_force: [N], >= 0.
    """

    fiber_length: Any
    tendon_force: Any


class Contraction(NamedTuple):
    """Velocity and powers of fibers of a given length; power flows out of a part that shortens under tension.

    Attributes:
        fiber_velocity: [m/s], lengthening > 0.
        tendon_force: [N], >= 0.
        fiber_power: -fiber force times fiber velocity [W].
        tendon_power: -tendon force times the tendon's velocity [W]; the sum of both is what the path gives,
            -tendon force times path velocity.
    """

    fiber_velocity: Any
    tendon_force: Any
    fiber_power: Any
    tendon_power: Any


class Muscles:
    """Muscles under one law.

    Attributes:
        model: Name of the law, with `_rigid` behind where no tendon stretches.
        num_muscles: Their number.
        parameters: By OpenSim's name, float64 Warp arrays (num_muscles,), to be written in place; with
            `requires_grad` they have gradients. Those that shape Millard's curves are not among them.
    """

    def __init__(
        self,
        model: str,
        *,
        device: Any = "cpu",
        requires_grad: bool = False,
        **parameters: Any,
    ) -> None:
        """Check the parameters and put them on a device.

        Args:
            model: thelen2003, millard2012 or degroote_fregly2016, with `_rigid` behind for a rigid tendon.
            device: Warp device.
            requires_grad: Whether `wp.Tape` finds gradients with respect to them.
            **parameters: Under OpenSim's names, SI units: numbers, or one for each muscle. Peak force,
                optimal fiber length and slack length are needed; the others are OpenSim's defaults.

        Raises:
            ValueError: A parameter is missing, unknown, out of its range, or of another number of muscles.
        """
        check_choice("muscle model", model, NAMES)
        kind = MUSCLES[model]
        assert issubclass(kind, Hill)
        self.model, self.device, (law, rigid) = model, wp.get_device(device), NAMES[model]
        if missing := [name for name in NEEDED if name not in parameters]:
            raise ValueError(f"muscles need {', '.join(NEEDED)}; {missing[0]} is missing")
        values: dict[str, np.ndarray] = {}
        own = OWN | dict(
            zip(("activation_time_constant", "deactivation_time_constant"), TIMES[law], strict=True)
        )
        for name, value in {**own, **parameters}.items():
            check_choice(f"parameter of muscle model {model!r}", name, kind.PARAMETERS)
            low, high = kind.PARAMETERS[name]
            values[name] = np.atleast_1d(_numbers(name, value))
            inside = (values[name] >= low) & (values[name] <= high) & np.isfinite(values[name])
            wrong = values[name][~inside]
            if wrong.size or values[name].ndim > 1:
                got = f"{wrong.flat[0]:g}" if wrong.size else f"shape {values[name].shape}"
                raise ValueError(f"{name} must be numbers, one a muscle, from {low:g} to {high:g}, got {got}")
        sizes = {name: len(value) for name, value in values.items() if len(value) > 1}
        self.num_muscles = max(sizes.values(), default=1)
        if odd := [name for name, size in sizes.items() if size != self.num_muscles]:
            raise ValueError(f"{odd[0]} must be one number or {self.num_muscles}, got {sizes[odd[0]]}")
        values = {name: np.broadcast_to(value, self.num_muscles) for name, value in values.items()}
        rows, tables, spans = hill_parameters(law, values, rigid, real=wp.float64)
        self._rows = np.broadcast_to(rows[0], self.num_muscles).copy()
        fields = {name: field for name, (field, *_) in LAWS[law].items() if field is not None}
        self._struct = Parameters()
        self.parameters: dict[str, wp.array] = {}
        with wp.ScopedDevice(self.device):
            self._struct.kind = wp.array(self._rows, dtype=HillMuscle64)
            self._struct.tables = struct_of(CurveTables64, values=tables, spans=spans)
            shown = {name: name for name in DIRECT} | {field: name for name, field in fields.items()}
            for field in (*DIRECT, *CURVES):
                stated = self._rows[field] if field in (self._rows.dtype.names or ()) else values[field]
                array = wp.array(stated, dtype=wp.float64, requires_grad=requires_grad and field in shown)
                setattr(self._struct, field, array)
                if field in shown:
                    self.parameters[shown[field]] = array

    def active_force_length(self, norm_length: Any) -> Any:
        """Return f_L [1] at normalized fiber lengths [1]."""
        return self._curve(ACTIVE, norm_length)

    def passive_force(self, norm_length: Any) -> Any:
        """Return f_P [1] at normalized fiber lengths [1]."""
        return self._curve(PASSIVE, norm_length)

    def tendon_force(self, strain: Any) -> Any:
        """Return f_T [1], at least 0, at tendon strains [1]."""
        return self._curve(TENDON, strain)

    def force_velocity(self, norm_velocity: Any, activation: Any = 1.0) -> Any:
        """Return f_V [1] at fiber velocities [largest contraction velocity]; Thelen's by activation, too."""
        return self._curve(VELOCITY, norm_velocity, activation)

    def equilibrium(self, activation: Any, length: Any, velocity: Any = 0.0) -> Equilibrium:
        """Return fibers and forces where fiber and tendon agree, tendons keeping their length.

        Args:
            activation: [1].
            length: Of fiber and tendon [m].
            velocity: Its rate [m/s], lengthening > 0.
        """

        def compute(
            activation: wp.array, length: wp.array, velocity: wp.array, new: Callable[[], wp.array]
        ) -> tuple:
            p, root = self._renewed(), wp.zeros(length.shape[0], dtype=wp.vec2d, device=self.device)
            wp.launch(
                find_equilibrium,
                dim=length.shape[0],
                inputs=[p, activation, length, velocity],
                outputs=[root],
                device=self.device,
                record_tape=False,
            )
            fiber_length, tendon_force = new(), new()
            wp.launch(
                hold_muscles,
                dim=length.shape[0],
                inputs=[p, activation, length, velocity, root],
                outputs=[fiber_length, tendon_force],
                device=self.device,
            )
            return fiber_length, tendon_force

        return Equilibrium(*self._apply(compute, activation=activation, length=length, velocity=velocity))

    def contraction(self, activation: Any, length: Any, velocity: Any, fiber_length: Any) -> Contraction:
        """Return velocities, forces and powers of fibers of a given length, which rigid tendons do not read.

        Args:
            activation: [1].
            length: Of fiber and tendon [m].
            velocity: Its rate [m/s], lengthening > 0.
            fiber_length: [m].
        """

        def compute(
            activation: wp.array,
            length: wp.array,
            velocity: wp.array,
            fiber_length: wp.array,
            new: Callable[[], wp.array],
        ) -> tuple:
            p, root = self._renewed(), wp.zeros(length.shape[0], dtype=wp.vec2d, device=self.device)
            wp.launch(
                find_velocity,
                dim=length.shape[0],
                inputs=[p, activation, length, fiber_length],
                outputs=[root],
                device=self.device,
                record_tape=False,
            )
            speed, tendon_force, fiber_power, tendon_power = new(), new(), new(), new()
            wp.launch(
                contract_muscles,
                dim=length.shape[0],
                inputs=[p, activation, length, velocity, fiber_length, root],
                outputs=[speed, tendon_force, fiber_power, tendon_power],
                device=self.device,
            )
            return speed, tendon_force, fiber_power, tendon_power

        given = {"activation": activation, "length": length, "velocity": velocity}
        return Contraction(*self._apply(compute, **given, fiber_length=fiber_length))

    def activation_rate(self, excitation: Any, activation: Any) -> Any:
        """Return da/dt [1/s]."""

        def compute(excitation: wp.array, activation: wp.array, new: Callable[[], wp.array]) -> tuple:
            p, rate = self._struct, new()
            wp.launch(
                rate_of_activation,
                dim=rate.shape[0],
                inputs=[p, excitation, activation],
                outputs=[rate],
                device=self.device,
            )
            return (rate,)

        return self._apply(compute, excitation=excitation, activation=activation)[0]

    def _curve(self, which: int, x: Any, activation: Any = 1.0) -> Any:
        """Return a curve's multiplier."""

        def compute(x: wp.array, activation: wp.array, new: Callable[[], wp.array]) -> tuple:
            p, multiplier = self._struct, new()
            wp.launch(
                evaluate_curve,
                dim=x.shape[0],
                inputs=[p, which, x, activation],
                outputs=[multiplier],
                device=self.device,
            )
            return (multiplier,)

        return self._apply(compute, x=x, activation=activation)[0]

    def _renewed(self) -> Parameters:
        """Return the parameters; shortest fibers follow those that were written."""
        rows, values = self._rows, {name: array.numpy() for name, array in self.parameters.items()}
        scale = values["optimal_fiber_length"] / rows["optimal_fiber_length"]
        if (scale != 1.0).any():
            rows["shortest_fiber"] *= scale
            rows["optimal_fiber_length"] = values["optimal_fiber_length"]
            self._struct.kind.assign(rows)
        return self._struct

    def _apply(self, compute: Callable[..., tuple], **given: Any) -> tuple:
        """Return results of a computation on flat arrays, as arrays of the kind and shape of what was given.

        Raises:
            ValueError: Something is no number, activation or excitation is beyond 0 to 1, shapes do not fit
                each other or the muscles, or Warp arrays are not float64.
        """
        if any(isinstance(value, wp.array) for value in given.values()):
            return self._apply_warp(compute, given)
        torch = next((type(v) for v in given.values() if type(v).__module__.startswith("torch")), None)
        arrays = {name: _numbers(name, value) for name, value in given.items()}
        try:
            shape = np.broadcast_shapes((self.num_muscles,), *(array.shape for array in arrays.values()))
        except ValueError:
            shapes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
            raise ValueError(
                f"arrays must broadcast with {self.num_muscles} muscles on the last axis, got {shapes}"
            ) from None
        if shape[-1] != self.num_muscles:
            raise ValueError(f"the last axis must be that of {self.num_muscles} muscles, got shape {shape}")
        full = [np.broadcast_to(array, shape).ravel() for array in arrays.values()]
        flat = [wp.array(values, dtype=wp.float64, device=self.device) for values in full]
        number = int(np.prod(shape))
        found = compute(*flat, lambda: wp.zeros(number, dtype=wp.float64, device=self.device))
        results = tuple(array.numpy().reshape(shape) for array in found)
        if torch is None:
            return results
        import torch as library

        like = next(value for value in given.values() if isinstance(value, library.Tensor))
        return tuple(library.as_tensor(array, dtype=like.dtype, device=like.device) for array in results)

    def _apply_warp(self, compute: Callable[..., tuple], given: dict[str, Any]) -> tuple:
        """Return the same of Warp arrays, which the tape records."""
        shape = next(value.shape for value in given.values() if isinstance(value, wp.array))
        number, flat = int(np.prod(shape)), []
        for name, value in given.items():
            if not isinstance(value, wp.array):
                numbers = np.broadcast_to(_numbers(name, value), shape)
                value = wp.array(numbers, dtype=wp.float64, device=self.device)
            if value.dtype is not wp.float64 or value.shape != shape or shape[-1] != self.num_muscles:
                raise ValueError(
                    f"{name} must be a float64 Warp array (..., {self.num_muscles}), shaped like the others, "
                    f"got {value.dtype.__name__} of shape {value.shape}"
                )
            _check_share(name, value.numpy())
            flat.append(value.reshape((number,)))
        found = compute(
            *flat, lambda: wp.zeros(number, dtype=wp.float64, device=self.device, requires_grad=True)
        )
        return tuple(array.reshape(shape) for array in found)


def _numbers(name: str, value: Any) -> np.ndarray:
    """Return numbers as a float64 array.

    Raises:
        ValueError: It has something else, or activation or excitation is beyond 0 to 1.
    """
    try:
        array = np.asarray(value.detach().cpu() if type(value).__module__.startswith("torch") else value)
    except (TypeError, ValueError, RuntimeError):  # a ragged list; a tensor without values
        array = np.array(None)
    if array.dtype.kind not in "biuf":
        got = "an integer beyond float64" if isinstance(value, int) else reprlib.repr(value)
        raise ValueError(f"{name} must be numbers, got {got}")
    array = array.astype(float)
    _check_share(name, array)
    return array


def _check_share(name: str, array: np.ndarray) -> None:
    """Raise ValueError where activation or excitation is beyond 0 to 1; NaN goes through."""
    if name in SHARES and (wrong := array[(array < -ROUNDING) | (array > 1.0 + ROUNDING)]).size:
        raise ValueError(f"{name} must be from 0 to 1, got {wrong.flat[0]:g}")
