"""Signals of a rollout on disk: every n-th control step of every world.

    with recording(sim, Path("run.parquet"), every=5) as recorder:
        run(sim, act, 500, recorder)

or, in a loop of one's own, `recorder.add()` after every step.

`.parquet`: two tidy tables, `run.parquet` with a row for every world, time and muscle, and
`run_joints.parquet` with one for every world, time and joint; names are categories. Worlds that were not
stepped or had a fault are left out. For pandas and xarray:

    table = pandas.read_parquet("run.parquet")
    table.groupby(["group", "time"], observed=True)["force"].mean()
    table.set_index(["world", "episode", "time", "muscle"])["force"].to_xarray()

`.csv`: the same two tables as text.

`.sto`: one world, for OpenSim and SCONE: columns such as `BIClong.activation`; joint angles [rad] go to the
`.mot` file beside it.

`.npz`: arrays (samples, num_worlds, num_muscles) by signal, (samples, num_worlds, num_joints) for the joints,
`time`, `episode` and `valid` (samples, num_worlds), and the names. Entries that are not valid are NaN.

Samples go to disk while they come. A file appears under its name when it is complete, or not at all.
"""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.rollouts.recording_formats import (
    Write,
    joints_path,
    open_csv,
    open_npz,
    open_parquet,
    open_storage,
)
from myowarp.apps.rollouts.run import Step, Watcher
from myowarp.definitions.registry import is_integer
from myowarp.disk import check_output
from myowarp.extras import to_install
from myowarp.sim.signals import JOINT_UNITS, UNITS, Signals

if TYPE_CHECKING:
    from myowarp.sim.simulation import Simulation

FORMATS = {".parquet": open_parquet, ".csv": open_csv, ".npz": open_npz, ".sto": open_storage}
NEED_PYARROW = (".parquet", ".csv")
CHUNK = 1 << 20  # entries of one signal that are held in memory


def recording_files(path: Path | None) -> tuple[Path, ...]:
    """Return the files of a recording."""
    if path is None:
        return ()
    return (path,) if path.suffix.lower() == ".npz" else (path, joints_path(path))


def check_recording(path: Path | None, num_worlds: int) -> None:
    """Raise now if a recording could not be written to `path`.

    Args:
        path: File to be written; None: none.
        num_worlds: Worlds that would be recorded.

    Raises:
        ValueError: Wrong suffix, no such folder, no permission, or several worlds in a `.sto` file.
        ImportError: Tables without pyarrow.
    """
    check_output(path, *FORMATS)
    if path is None:
        return
    suffix = path.suffix.lower()
    if suffix == ".sto" and num_worlds > 1:
        raise ValueError(
            f"output {str(path)!r} holds the motion of one world, got {num_worlds} worlds; simulate one "
            "(world i of seed s is the one world of seed s + i), or write .parquet"
        )
    if suffix in NEED_PYARROW and importlib.util.find_spec("pyarrow") is None:
        raise ImportError(
            f"output {str(path)!r} needs pyarrow, which is not installed; run "
            f"{to_install('cohort')} or write .npz"
        )


@contextlib.contextmanager
def recording(
    sim: Simulation, path: Path, every: int = 1, signals: Signals | None = None
) -> Iterator[SignalRecorder]:
    """Record a simulation in the block; the file is complete after it, and deleted if the block fails.

    Args:
        sim: The simulation.
        path: File to write, ending in .parquet, .csv, .npz or .sto.
        every: Control steps from one sample to the next.
        signals: Signals that the simulation has already; None: new ones.

    Raises:
        ValueError: The file cannot be written, `every` is no positive integer, or there are no muscles.
        ImportError: Tables without pyarrow.
    """
    check_recording(path, sim.scene.num_worlds)
    if not is_integer(every) or every < 1:
        raise ValueError(f"every must be a positive number of control steps, got {every!r}")
    signals = signals or Signals(sim)
    with FORMATS[path.suffix.lower()](path, signals) as write:
        recorder = SignalRecorder(signals, every, write)
        yield recorder
        recorder.flush()


class SignalRecorder(Watcher):
    """Samples signals; `recording` makes one.

    Attributes:
        signals: The signals that are recorded.
        every: Control steps from one sample to the next.
    """

    def __init__(self, signals: Signals, every: int, write: Write) -> None:
        self.signals, self.every = signals, every
        self._write = write
        self._steps = 0
        self._held: list[dict[str, np.ndarray]] = []

    def add(self) -> None:
        """Count a step, and sample it if its turn has come."""
        self._steps += 1
        if self._steps % self.every:
            return
        self._held.append(sample_of(self.signals))
        num_worlds, num_muscles = self.signals.muscles.force.shape
        if len(self._held) * num_worlds * max(num_muscles, len(self.signals.joint_names)) >= CHUNK:
            self.flush()

    def see(self, step: Step) -> None:
        """Count a step of a run."""
        self.add()

    def flush(self) -> None:
        """Hand what is held to the file."""
        if self._held:
            self._write({name: np.stack([held[name] for held in self._held]) for name in self._held[0]})
            self._held = []


def sample_of(signals: Signals) -> dict[str, np.ndarray]:
    """Return copies of all signals by name.

    Returns:
        `valid`, `time` [s] and `episode` (num_worlds,); muscle signals and what conditions show (num_worlds,
        num_muscles); `angle` and `angular_velocity` (num_worlds, num_joints).
    """
    shape = signals.muscles.force.shape
    sample = {
        "valid": signals.valid.numpy().copy(),
        "time": signals.step_count.numpy() * signals.sim.scene.control_dt,
        "episode": signals.episode.numpy().copy(),
    }
    sample |= {name: getattr(signals.muscles, name).numpy().copy() for name in UNITS}
    for name, array in signals.info.items():
        values = array.numpy()
        sample[name] = np.broadcast_to(values if values.ndim == 2 else values[:, None], shape).copy()
    joints = (signals.joint_angles, signals.joint_velocities)
    return sample | dict(zip(JOINT_UNITS, joints, strict=True))
