"""All that a world is: taken as arrays, kept in a file, given to the same worlds or to others.

    before = env.get_state()
    env.step(actions)
    env.set_state(before)  # as it was, bit for bit
    env.set_state(before[3])  # every world is what world 3 was: a planner's candidates
    before.save("before.npz")
    env.set_state(State.load("before.npz"))  # in another process, over any number of shards

What a world is from one step to the next is what its owners have allocated with `Scene.zeros` or named with
`Scene.adopt`: the engine's state, activations, goals, what conditions remember and have drawn, counters,
random keys. Everything else follows from it, and is brought up to date when a state is set. Other arrays with
a row for each world, which a task or a condition of one's own has allocated, are taken for state, too.
"""

from __future__ import annotations

import io
import logging
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import numpy.typing as npt
import warp as wp

from myowarp.disk import array_from_bytes, check_output, in_place, is_ours
from myowarp.kernels.write import write
from myowarp.process import warn_once

if TYPE_CHECKING:
    from myowarp.sim.shard import Shard
    from myowarp.sim.simulation import Simulation

logger = logging.getLogger("myowarp")

Worlds = int | Sequence[int] | npt.NDArray[np.integer] | npt.NDArray[np.bool_] | None
"""A choice of worlds: None for all, a number, numbers, or a mask (num_worlds,) bool."""

CONDITION = "condition."  # begin of the names of what belongs to conditions
UNLISTED = "unlisted."  # begin of the names of what is only taken for state
KEYS = "keys."  # begin of the names of random keys; worlds keep theirs where a state has none
CTRL = "data.ctrl"
MUSCLES = "muscles."  # begin of the names of muscle state
COUNTER = "episode."  # begin of the names of counters
MOST_COUNTED = 2**31 - 2  # one step later still an int32
BEYOND = 1.5  # rad out of the range of a hinge from which angles may be degrees
UNIT = 1e-3  # how far from 1 the length of a given quaternion may be
TASK, PHYSICS = "task", "physics"  # entries of a file that name these
ENCRYPTED = 1  # bit of an entry of a zip file
DAMAGES = (
    *(ValueError, TypeError, KeyError, EOFError, MemoryError, OverflowError),
    *(NotImplementedError, IsADirectoryError, zipfile.BadZipFile),
)
"""Errors of reading a damaged file: of zipfile, and of NumPy for the head of an array."""


@dataclass(frozen=True, eq=False)
class State:
    """The state of some worlds of a task.

    Attributes:
        task: Name and version of the task.
        arrays: Arrays (num_worlds, ...) by name, such as `data.qpos` or `task.target`; copies.
        physics: The physics under which they were so, a name in `PHYSICS`; empty: not known.
    """

    task: str
    arrays: dict[str, np.ndarray]
    physics: str = ""

    def __post_init__(self) -> None:
        """Check that there is a row for each world.

        Raises:
            ValueError: There are no arrays, or they are of different numbers of worlds.
        """
        arrays = self.arrays if isinstance(self.arrays, dict) else {}
        numbers = {
            len(array) if isinstance(array, np.ndarray) and array.ndim else None for array in arrays.values()
        }
        if len(numbers) != 1 or None in numbers:
            raise ValueError(
                "arrays of a State must be NumPy arrays by name, each with a row for every world, got "
                f"{str(self.arrays)[:40]!r} with {', '.join(map(str, numbers)) or 'no'} rows"
            )

    def __len__(self) -> int:
        """Number of worlds."""
        return len(next(iter(self.arrays.values())))

    def __getitem__(self, worlds: Worlds) -> State:
        """Return copies of the states of some worlds; a number may be named more than once.

        Raises:
            ValueError: There are no such worlds.
        """
        rows = rows_of(worlds, len(self), repeated=True)
        return State(self.task, {name: array[rows] for name, array in self.arrays.items()}, self.physics)

    def save(self, path: str | Path) -> None:
        """Write an .npz file, whole or not at all.

        Raises:
            ValueError: The path has another ending, or its folder is not there or not writable.
            OSError: The file cannot be written.
        """
        path = Path(path)
        check_output(path, ".npz")
        with in_place(path) as scratch, scratch.open("wb") as file:
            names = {TASK: np.array(self.task), PHYSICS: np.array(self.physics)}
            np.savez(file, **names, **self.arrays)  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: str | Path) -> State:
        """Read a file that `save` has written; no code in it is run.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: The file is damaged, or holds something else.
        """
        try:
            with zipfile.ZipFile(io.BytesIO(Path(path).read_bytes())) as file:
                entries = file.infolist()
                if any(e.compress_type != zipfile.ZIP_STORED or e.flag_bits & ENCRYPTED for e in entries):
                    raise ValueError("it is compressed or encrypted")  # a small file could fill the memory
                arrays = {e.filename.removesuffix(".npy"): array_from_bytes(file.read(e)) for e in entries}
            task, physics = str(arrays.pop(TASK)[()]), str(arrays.pop(PHYSICS, np.array(""))[()])
            return cls(task, arrays, physics)
        except DAMAGES as error:
            reason = " ".join(str(error).split())
            raise ValueError(
                f"state {str(path)!r} must be an .npz file of State.save(), undamaged ({reason})"
            ) from error


def without_keys(state: State) -> State:
    """Return a state without random numbers to come, of which the worlds that take it keep their own."""
    arrays = {name: array for name, array in state.arrays.items() if not name.startswith(KEYS)}
    return State(state.task, arrays)


def rows_of(worlds: Worlds, num_worlds: int, *, repeated: bool = False) -> np.ndarray:
    """Return the numbers of worlds, shape (number,).

    Args:
        worlds: Which worlds.
        num_worlds: How many there are.
        repeated: Whether one may be named more than once.

    Raises:
        ValueError: There are no such worlds, or one is named twice and may not be.
    """
    if worlds is None:
        return np.arange(num_worlds)
    rows = np.atleast_1d(np.asarray(worlds))
    if rows.dtype == np.bool_ and rows.shape == (num_worlds,):
        rows = np.flatnonzero(rows)
    good = rows.ndim == 1 and rows.size and np.issubdtype(rows.dtype, np.integer)
    twice = good and not repeated and len(np.unique(rows)) != len(rows)
    if not good or rows.min() < 0 or rows.max() >= num_worlds or twice:
        raise ValueError(
            f"worlds must be {'' if repeated else 'different '}numbers from 0 to {num_worlds - 1}, or a bool "
            f"mask of shape ({num_worlds},) with a True entry, got {worlds!r}"
        )
    return rows


def _state_of(shard: Shard) -> dict[str, wp.array]:
    """Return the state of a shard by name, and what users' own tasks and conditions have for every world."""
    state, num_worlds = dict(shard.scene.state), shard.num_worlds
    listed = {array.ptr for array in state.values()}
    for owner in (owner for owner in (shard.program, *shard.effects) if not is_ours(type(owner))):
        for attribute, value in vars(owner).items():
            is_struct = hasattr(value, "__ctype__") and not isinstance(value, wp.array)
            fields = vars(value) if is_struct else {"": value}
            for name, array in fields.items():
                is_array = isinstance(array, wp.array) and array.ndim > 0
                if is_array and array.shape[0] == num_worlds and array.ptr not in listed:
                    state[f"{UNLISTED}{type(owner).__name__}.{attribute}.{name}".rstrip(".")] = array
    return state


def get_state(sim: Simulation, worlds: Worlds = None) -> State:
    """Return what worlds are now.

    Args:
        sim: The simulation.
        worlds: Which worlds, in this order; None: all.

    Raises:
        ValueError: There are no such worlds.
    """
    rows = rows_of(worlds, sim.num_worlds)
    shards = [{name: array.numpy() for name, array in _state_of(shard).items()} for shard in sim.shards]
    names = [name for name in shards[0] if all(name in shard for shard in shards)]
    arrays = {name: np.concatenate([shard[name] for shard in shards])[rows] for name in names}
    return State(sim.scene.spec.key, arrays, str(sim.setup.physics))


def set_state(sim: Simulation, state: State, worlds: Worlds = None, *, conditions: bool = True) -> np.ndarray:
    """Make worlds what others were; poses, observation and signals follow.

    Args:
        sim: The simulation.
        state: One world, given to all that are named, or as many as are named.
        worlds: Which worlds; None: all.
        conditions: Whether the conditions' own state is set, too. Without, the worlds keep their conditions
            as they are: the same movement goes on in another patient.

    Returns:
        The numbers of the worlds that were set.

    Raises:
        ValueError: The state does not fit the task, its conditions or the worlds; nothing was set.
    """
    rows = rows_of(worlds, sim.num_worlds)
    if not isinstance(state, State):
        raise ValueError(f"state must be a State, as get_state() returns it, got {type(state).__name__}")
    spec = sim.scene.spec
    if state.task != spec.key:
        raise ValueError(f"state is one of task {state.task!r}; this one is {spec.key!r}")
    if len(state) not in (1, len(rows)):
        raise ValueError(f"state must have 1 or {len(rows)} worlds, as many as are set, got {len(state)}")
    own = _state_of(sim.shards[0])
    # What only one of them takes for state, unlisted, is as long as worlds are many by chance: a constant.
    needed = {name for name in own if name in state.arrays or not name.startswith(KEYS)}
    differ = {name for name in state.arrays.keys() ^ needed if not name.startswith(UNLISTED)}
    unlike = {name for name in differ if not name.startswith(CONDITION)}
    if unlike:
        raise ValueError(
            "state must have the arrays that get_state() returns, they differ in "
            f"{', '.join(sorted(unlike))}; take it from an environment of this task and muscle model"
        )
    arrays = {name: array for name, array in state.arrays.items() if name in own}
    if not conditions:
        arrays = _body_alone(arrays, own)
    elif differ:
        raise ValueError(
            "state and environment must have the same conditions, they differ in "
            f"{', '.join(sorted(differ))}; pass conditions=False to leave the environment's as they are"
        )
    if state.physics not in ("", sim.setup.physics):
        logger.warning(
            "a state of physics %r goes on under %r: what follows is not, bit for bit, what followed there",
            *(state.physics, sim.setup.physics),
        )
    place(sim, arrays, rows)
    return rows


def _body_alone(arrays: Mapping[str, np.ndarray], own: Mapping[str, wp.array]) -> dict[str, np.ndarray]:
    """Return the arrays that do not belong to conditions."""
    found = {name: array for name, array in arrays.items() if not name.startswith((CONDITION, UNLISTED))}
    ctrl, width = found[CTRL], own[CTRL].shape[1]  # conditions append actuators, at the end
    found[CTRL] = np.pad(ctrl, ((0, 0), (0, max(0, width - ctrl.shape[1]))))[:, :width]
    return found


def place(sim: Simulation, arrays: Mapping[str, np.ndarray], rows: np.ndarray) -> None:
    """Overwrite state in some worlds, and bring up what follows from it.

    Args:
        sim: The simulation.
        arrays: Arrays (1 or number, ...) by name. Without the muscles' own, they settle in a configuration.
        rows: Numbers of the worlds, shape (number,).

    Raises:
        ValueError: An array does not fit, or is not finite; nothing was written.
    """
    states = [_state_of(shard) for shard in sim.shards]
    own = states[0]
    values = {name: _fitting(name, array, own[name].numpy(), len(rows)) for name, array in arrays.items()}
    settle = "data.qpos" in values and not any(name.startswith(MUSCLES) for name in values)
    for shard, state in zip(sim.shards, states, strict=True):
        worlds = shard.scene.worlds
        here = (rows >= worlds.first) & (rows < worlds.first + worlds.number)
        if not here.any():
            continue
        local = rows[here] - worlds.first
        for name, array in values.items():
            target = state.get(name)
            if target is None:  # a constant, see `set_state`
                continue
            whole = target.numpy()
            whole[local] = array[here]
            write(target, whole)
        mask = np.zeros(worlds.number, dtype=bool)
        mask[local] = True
        shard.bring_up(mask, settle=settle)


def start_arrays(sim: Simulation, options: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return configuration and velocity from a reset's options, for `place`.

    Args:
        sim: The simulation.
        options: `qpos` and `qvel`, each one row for all worlds or (num_worlds, n); others are not looked at.

    Returns:
        Arrays (num_worlds, n) of those that are given.

    Raises:
        ValueError: One is no array of finite numbers of that shape, or has a quaternion of length 0.
    """
    start = {}
    for name in options.keys() & {"qpos", "qvel"}:
        size = sim.shards[0].scene.state[f"data.{name}"].shape[1]
        shape = (sim.num_worlds, size)
        try:
            values = np.asarray(options[name], dtype=np.float32)
        except (TypeError, ValueError):
            values = np.full(shape, np.nan, dtype=np.float32)
        if values.shape not in ((size,), shape) or not np.isfinite(values).all():
            raise ValueError(
                f"reset option {name!r} must be finite numbers of shape ({size},) or {shape}, "
                f"got {str(options[name])[:40]!r} of shape {np.shape(options[name])}"
            )
        start[f"data.{name}"] = np.broadcast_to(values, shape)
    if "data.qpos" in start:
        _check_quaternions(sim.scene.oracle, start["data.qpos"])
        _say_degrees(sim.scene.oracle, start["data.qpos"])
    return start


def _check_quaternions(model: mujoco.MjModel, qpos: np.ndarray) -> None:
    """Raise ValueError if an orientation in configurations (num_worlds, nq) is no unit quaternion."""
    for joint, offset in ((mujoco.mjtJoint.mjJNT_FREE, 3), (mujoco.mjtJoint.mjJNT_BALL, 0)):
        for j in np.flatnonzero(model.jnt_type == joint):
            first = model.jnt_qposadr[j] + offset
            lengths = np.linalg.norm(qpos[:, first : first + 4], axis=1)
            wrong = lengths[np.abs(lengths - 1.0) > UNIT]
            if wrong.size:
                raise ValueError(
                    f"reset option 'qpos' must have a unit quaternion in entries {first} to {first + 3}, the "
                    f"orientation of joint {model.joint(j).name!r}, got one of length {wrong[0]:.3g}"
                )


def _say_degrees(model: mujoco.MjModel, qpos: np.ndarray) -> None:
    """Say which hinge of configurations (num_worlds, nq) is out of its range as angles in degrees are."""
    for j in np.flatnonzero((model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) & (model.jnt_limited != 0)):
        angles, (low, high) = qpos[:, model.jnt_qposadr[j]], model.jnt_range[j]
        far = angles[(angles < low - BEYOND) | (angles > high + BEYOND)]
        if far.size:
            warn_once(
                f"reset option 'qpos' has joint {model.joint(j).name!r} at {far[0]:.4g} rad, far out of its "
                f"range, {low:.3g} to {high:.3g} rad; is it in degrees?"
            )


def _fitting(name: str, array: np.ndarray, own: np.ndarray, number: int) -> np.ndarray:
    """Return an array with a row for each of `number` worlds, checked against a simulation's own."""
    array = np.asarray(array)
    shape = (number, *own.shape[1:])
    if not np.can_cast(array.dtype, own.dtype, "same_kind"):
        raise ValueError(f"state {name!r} must be of type {own.dtype}, got {array.dtype}")
    if array.shape not in (shape, (1, *shape[1:])):
        raise ValueError(f"state {name!r} must have shape {shape}, got {array.shape}")
    with np.errstate(over="ignore"):
        values = array.astype(own.dtype)
    if not np.isfinite(values).all():
        raise ValueError(
            f"state {name!r} must be finite in {own.dtype}, got NaN, infinity or too large a number"
        )
    if values.dtype.kind in "iu":
        limits = np.iinfo(values.dtype)
        least, most = (0, MOST_COUNTED) if name.startswith(COUNTER) else (limits.min, limits.max)
        if (array < least).any() or (array > most).any():
            raise ValueError(
                f"state {name!r} must be from {least} to {most}, got {array.min()} to {array.max()}"
            )
    return np.broadcast_to(values, shape)
