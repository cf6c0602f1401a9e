"""Muscle models of `hill_law`: parameters from tables or from the body's MuJoCo muscles, and launches."""

from collections.abc import Mapping
from typing import Any, ClassVar

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.definitions.muscle import MUSCLES, FiberStates, MuscleGeometry, MuscleModel
from myowarp.kernels.lanes import block_scratch
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_of
from myowarp.laws.curves import KNOTS, CurveTables
from myowarp.laws.muscles.hill_law import DEGROOTE, MILLARD, SCHUTTE, THELEN, HillMuscle
from myowarp.laws.muscles.hill_parameters import COMMON, LAWS, defaults_of, hill_parameters
from myowarp.models.muscles.hill_kernels import (
    Fibers,
    HillParams,
    contract_hill,
    read_hill_fibers,
    sample_curves,
    set_lengths,
    settle_hill,
)
from myowarp.models.muscles.hill_native import PLACES, native_contract_hill
from myowarp.models.muscles.mujoco import length_scale, peak_force

FIBER_STATE = ("fiber_length", "expected_length", "fiber_share")
"""State of a muscle with an elastic tendon beside its activation, see `Fibers`."""

TIME_CONSTANTS = ("activation_time_constant", "deactivation_time_constant")


LEAST_TENDON = 0.1
"""A tendon derived from MuJoCo's muscle that is shorter than this is rigid [optimal fiber lengths]."""


LONGEST = 50.0
"""Longest paths that an optimal fiber may have; MuJoCo's torso has 15, a length in mm has 100 or more."""

GRID = 4001


class Hill(MuscleModel):
    """Muscles under one of the laws; see the module.

    What no table gives is derived from the body's MuJoCo muscle: peak force, optimal length, velocities and
    time constants are its own, fibers have no pennation, and the slack length is the one with which the
    isometric force at full activation in the body's pose `qpos0` is MuJoCo's. Where this leaves a tendon
    shorter than a tenth of the optimal fiber length, the tendon of that muscle is rigid.

    Attributes:
        parameters: Parameters of all muscles, `HillMuscle`, shape (1 or num_worlds, num_muscles).
        fiber_length: State of muscles with an elastic tendon [m], shape (num_worlds, num_muscles), empty if
            all are rigid; so are `expected_length` and `fiber_share`, see `Fibers`.
    """

    LAW: ClassVar[int]
    RIGID: ClassVar[bool] = False
    fiber_length: wp.array
    expected_length: wp.array
    fiber_share: wp.array

    def __init__(
        self, model: mujoco.MjModel, num_worlds: int, parameters: Mapping[str, np.ndarray] | None = None
    ) -> None:
        """Collect the parameters; see `MuscleModel`.

        Raises:
            ValueError: A slack length is longer than the muscle's path ever is, or too many curves differ.
        """
        super().__init__(model, num_worlds, parameters)
        ids = self.actuator_id
        shape = (0, 0) if self.RIGID else self.activation.shape
        for name in FIBER_STATE:
            setattr(self, name, wp.zeros(shape, dtype=float))
        limited = model.actuator_ctrllimited[ids, None]
        bounds = np.clip(np.where(limited, model.actuator_ctrlrange[ids], (0.0, 1.0)), 0.0, 1.0)
        self.excitation_range = wp.array(bounds, dtype=wp.vec2)
        self._actuators = wp.array(ids, dtype=int)
        of_muscles, of_actuators = (len(PLACES) + 18) * len(ids), 3 * model.nu + 1
        # For the native kernel, which finds it by its name.
        self.scratch = block_scratch(self.activation.device, of_muscles, of_actuators)
        self._length_range = model.actuator_lengthrange[ids]
        if "ignore_activation_dynamics" in self._given:
            off = self._given["ignore_activation_dynamics"] == 1.0
            for name in TIME_CONSTANTS:
                own = getattr(self, name).numpy()
                setattr(self, name, wp.array(np.where(off, 1e-6, own), dtype=float))
        rows, tables, spans = self._collect(model)
        self.tables = struct_of(CurveTables, values=tables, spans=spans)
        self.parameters = wp.array(rows, dtype=HillMuscle)
        if ids.size and np.isnan(rows["tendon_slack_length"]).any():
            self._derive_slack(model, rows)
            self.parameters = wp.array(rows, dtype=HillMuscle)

    def _value(self, name: str, own: Any) -> np.ndarray:
        """Return a parameter in float64, shape (1 or num_worlds, num_muscles); `own` where none is given."""
        own = np.broadcast_to(np.asarray(own, float), (1, len(self.names)))
        given = self._given.get(name)
        return own if given is None else np.where(np.isnan(given), own, given)

    def _laws(self) -> np.ndarray:
        """Return the law of each muscle, shape (num_muscles,)."""
        return np.full(len(self.names), self.LAW)

    def _collect(self, model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return parameters, NaN where the slack length has to be derived, and the tables of curves."""
        laws, knots = self._laws(), self._given.get("curves")
        tables, spans = np.zeros((0, KNOTS, 2)), np.zeros((0, 2))
        rows = np.zeros((1, len(laws)), HillMuscle.numpy_dtype())
        for law in np.unique(laws):
            chosen = np.flatnonzero(laws == law)
            values, curves = (
                self._values(model, int(law), chosen),
                None if knots is None else knots[0, chosen],
            )
            own, more, where = hill_parameters(int(law), values, self.RIGID, knots=curves)
            own["curves"] += len(tables)
            rows = np.repeat(rows, len(own), axis=0) if len(rows) < len(own) else rows
            rows[:, chosen] = own
            tables, spans = np.concatenate([tables, more]), np.concatenate([spans, where])
        self._check_length("tendon_slack_length", rows["tendon_slack_length"], 1.0)
        self._check_length("optimal_fiber_length", rows["optimal_fiber_length"], LONGEST)
        if not len(tables):
            tables, spans = np.zeros((1, KNOTS, 2)), np.zeros((1, 2))
        return rows, tables, spans

    def _values(self, model: mujoco.MjModel, law: int, chosen: np.ndarray) -> dict[str, np.ndarray]:
        """Return the properties of muscles under a law, shape (1 or num_worlds, len(chosen)) each."""
        ids = self.actuator_id
        gain = model.actuator_gainprm[ids]
        optimal, _ = length_scale(gain, model.actuator_lengthrange[ids])
        own: dict[str, Any] = {
            "max_isometric_force": peak_force(gain, model.actuator_acc0[ids]),
            "optimal_fiber_length": optimal,
            "tendon_slack_length": np.nan,
            "pennation_angle_at_optimal": 0.0,
            "max_contraction_velocity": 10.0,
        }
        own |= defaults_of(law)
        return {name: self._value(name, default)[:, chosen] for name, default in own.items()}

    def _check_length(self, name: str, lengths: np.ndarray, most: float) -> None:
        """Raise ValueError if a part of a muscle is longer than so many times the longest path."""
        longest = self._length_range[:, 1]
        for world, muscle in np.argwhere(lengths > np.where(longest > 0.0, most * longest, np.inf))[:1]:
            times = f"at most {most:g} times" if most > 1.0 else "less than"
            raise ValueError(
                f"{name} of muscle {self.names[muscle]!r} must be {times} its path's greatest length "
                f"{longest[muscle]:.4g} m, got {lengths[world, muscle]:.4g}"
            )

    def _derive_slack(self, model: mujoco.MjModel, rows: np.ndarray) -> None:
        """Set slack lengths that are not given so that the force at rest is MuJoCo's, in place."""
        ids, ranges = self.actuator_id, self._length_range
        norm, strain = np.linspace(0.3, 1.9, GRID), np.linspace(0.0, 0.3, GRID)
        forces = wp.zeros((len(ids), GRID, 2), dtype=float)
        launch(
            sample_curves,
            (len(ids), GRID),
            self,
            norm_length=wp.array(norm, dtype=float),
            strain=wp.array(strain, dtype=float),
            forces=forces,
        )
        curves = forces.numpy().astype(float)
        for i, actuator in enumerate(ids):
            length = model.actuator_length0[actuator]
            prm = [array[actuator, :9] for array in (model.actuator_gainprm, model.actuator_biasprm)]
            acc0 = model.actuator_acc0[actuator]
            pull = -mujoco.mju_muscleGain(length, 0.0, ranges[i], acc0, prm[0])
            pull -= mujoco.mju_muscleBias(length, ranges[i], acc0, prm[1])
            own = peak_force(prm[0][None], acc0[None])[0]
            optimal, slack = length_scale(prm[0][None], ranges[i][None])
            target = pull / own
            at = np.clip((length - slack[0]) / optimal[0], 0.5, 1.7)
            gap = curves[i, :, 0] - target
            crossings = np.flatnonzero(gap[:-1] * gap[1:] <= 0.0)
            if crossings.size:
                k = crossings[np.argmin(np.abs(norm[crossings] - at))]
                share = gap[k] / (gap[k] - gap[k + 1]) if gap[k] != gap[k + 1] else 0.0
                fiber = norm[k] + share * (norm[1] - norm[0])
            else:
                fiber = norm[np.argmin(np.abs(gap))]
            held = np.interp(fiber, norm, curves[i, :, 0])
            stretch = np.interp(held, curves[i, :, 1], strain)
            width, lo = rows["fiber_width"][:, i], rows["optimal_fiber_length"][:, i]
            free = length - np.sqrt(np.maximum((fiber * lo) ** 2 - width**2, 0.0))
            missing = np.isnan(rows["tendon_slack_length"][:, i])
            rigid = (rows["rigid"][:, i] == 1) | (free / (1.0 + stretch) < LEAST_TENDON * lo)
            rows["rigid"][:, i] = np.where(missing, rigid, rows["rigid"][:, i])
            derived = np.where(rigid, free, free / (1.0 + stretch))
            rows["tendon_slack_length"][:, i] = np.where(missing, derived, rows["tendon_slack_length"][:, i])

    def individualize(self) -> None:
        """Give every world an anatomy and parameters of its own."""
        super().individualize()
        rows = np.broadcast_to(self.parameters.numpy(), self.activation.shape)
        self.parameters = wp.array(rows.copy(), dtype=HillMuscle)

    def geometry(self) -> MuscleGeometry:
        """Return lengths of fibers and tendons; see `MuscleModel.geometry`."""
        names = (*MuscleGeometry._fields[:4], "tendon_slack_length")
        rows = self.parameters.numpy()
        return MuscleGeometry(*(rows[name] for name in names))

    def record_workload(self) -> None:
        """Integrate the workload from now on; see `MuscleModel.record_workload`."""
        self.workload = wp.zeros_like(self.activation)

    def set_length_range(self, muscleid: int, length_range: tuple[float, float], mask: wp.array) -> None:
        """Let fibers run over the same normalized lengths on another path; see `MuscleModel`.

        A tendon for which this leaves no length becomes rigid.
        """
        row = self.parameters.numpy()[0, muscleid]
        low, high = self._length_range[muscleid]
        scale = (length_range[1] - length_range[0]) / max(high - low, 1e-15)
        optimal = float(row["optimal_fiber_length"]) * scale
        slack = length_range[0] - (low - float(row["tendon_slack_length"])) * scale
        rigid = int(row["rigid"] == 1 or slack < LEAST_TENDON * optimal)
        wp.launch(
            set_lengths,
            dim=mask.shape[0],
            inputs=[muscleid, optimal, slack, rigid, mask],
            outputs=[self.parameters],
        )

    def read_fibers(self, fibers: FiberStates) -> None:
        """Launch `read_hill_fibers`; see `MuscleModel.read_fibers`."""
        launch(read_hill_fibers, self.activation.shape, self, states=fibers)

    @property
    def params(self) -> HillParams:
        """All parameters, for a kernel."""
        params = HillParams()
        params.actuator_id, params.muscles = self._actuators, self.parameters
        for name in ("excitation_range", *TIME_CONSTANTS, "tables"):
            setattr(params, name, getattr(self, name))
        return params

    @property
    def fibers(self) -> Fibers:
        """The state, for a kernel."""
        fibers = Fibers()
        for name in ("activation", *FIBER_STATE):
            setattr(fibers, name, getattr(self, name))
        return fibers

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Engine callback; see `MuscleModel.launch`."""
        timestep = model.opt.timestep
        if self.activation.device.is_cpu:
            launch(native_contract_hill, 1, self, data, model, opt_timestep=timestep)
            return
        num_worlds, threads = self.activation.shape
        launch(
            contract_hill,
            (num_worlds, threads),
            self,
            data,
            model,
            opt_timestep=timestep,
            threads=threads,
        )


class ElasticHill(Hill):
    """Muscles with an elastic tendon."""

    STATE = (*MuscleModel.STATE, *FIBER_STATE)
    coarse_step = 0.005

    def geometry(self) -> MuscleGeometry:
        """Return lengths of fibers and stretched tendons; see `MuscleModel.geometry`."""
        rows, fiber = self.parameters.numpy(), self.fiber_length.numpy()
        along = np.sqrt(np.maximum(fiber**2 - rows["fiber_width"] ** 2, 0.0))
        along += self.fiber_share.numpy() * (self.length.numpy() - self.expected_length.numpy())
        tendon = np.where(rows["rigid"] == 1, rows["tendon_slack_length"], self.length.numpy() - along)
        return super().geometry()._replace(tendon_length=tendon)

    def sample_state(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Draw activations, and tendons that are stretched by up to 3 %; fibers have the rest of any path."""
        rows = self.parameters.numpy()
        along = rows["optimal_fiber_length"] * rng.uniform(0.8, 1.2, self.fiber_length.shape)
        tendon = rows["tendon_slack_length"] * rng.uniform(1.0, 1.03, along.shape)
        fiber = np.sqrt(along**2 + rows["fiber_width"] ** 2)
        own = {"fiber_length": fiber, "expected_length": along + tendon, "fiber_share": np.ones_like(along)}
        return super().sample_state(rng) | own

    def settle(self, mask: wp.array) -> None:
        """Launch `settle_hill`; see `MuscleModel.settle`."""
        launch(settle_hill, self.fiber_length.shape, self, mask=mask)


class OpenSimMuscles(ElasticHill):
    """Muscles of a converted OpenSim model, each under the law of its own class and with its own tendon.

    Where no class is known, as of a body that is not converted, the law is Millard's.
    """

    TAKES_CURVES = True

    def _laws(self) -> np.ndarray:
        """Return the law of each muscle, shape (num_muscles,).

        Raises:
            ValueError: Laws differ among worlds.
        """
        laws = self._value("law", MILLARD)
        if (laws != laws[0]).any():
            raise ValueError("law must be the same in all worlds; only parameters of it may differ")
        return laws[0].astype(int)


def _bounds(*laws: int) -> dict[str, tuple[float, float]]:
    """Return least and greatest value of what some laws have."""
    bounds = dict(COMMON)
    for law in laws:
        bounds |= {key: (low, high) for key, (_, _, low, high) in LAWS[law].items()}
    if DEGROOTE in laws:
        bounds["ignore_passive_fiber_force"] = 0.0, 1.0
    return bounds


def _add(name: str, law: int) -> None:
    """Register a law with an elastic and with a rigid tendon."""
    bounds = _bounds(law)
    fields = {"LAW": law, "PARAMETERS": bounds, "__doc__": f"`{name}`."}
    MUSCLES.add(name, type(name, (ElasticHill,), fields))
    MUSCLES.add(f"{name}_rigid", type(f"{name}_rigid", (Hill,), {**fields, "RIGID": True}))


_add("thelen2003", THELEN)
_add("millard2012", MILLARD)
_add("degroote_fregly2016", DEGROOTE)
OpenSimMuscles.PARAMETERS = _bounds(*LAWS) | {"law": (0.0, float(SCHUTTE))}
MUSCLES.add("opensim", OpenSimMuscles)
