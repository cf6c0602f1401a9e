"""Figures of `myowarp plot`: signals over time, moment arms, force curves, learning curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import warp as wp

from myowarp.apps.reports import panel
from myowarp.apps.reports.table import read_numbers
from myowarp.definitions.body import POINT_JOINTS
from myowarp.definitions.muscle import muscle_index
from myowarp.definitions.registry import check_choice
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import PHYSICS
from myowarp.definitions.worlds import Worlds
from myowarp.osim.bundle.couplings import couplings, follow
from myowarp.sim import build
from myowarp.sim.signals import UNITS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 8.0  # inches
MOST = 12
"""Lines in a figure where none were chosen."""
POINTS = 201
STEP = 1e-4
"""Half the step of a coordinate over which a moment arm is the difference of lengths [rad, m]."""
NORM_LENGTHS = (0.4, 1.7)
NORM_VELOCITIES = (-1.1, 1.1)
CONTRACTION_AXES = {
    "length": "Fiber length / optimal fiber length",
    "velocity": "Fiber velocity / maximum contraction velocity (lengthening > 0)",
}
LEAST_ARM = 1e-4
"""m: a muscle with less about a joint is not shown where none were chosen."""


@dataclass(frozen=True)
class Course:
    """A signal of the muscles of one world in one episode.

    Attributes:
        name: The signal.
        title: What it is of.
        muscles: Names of the muscles.
        time: Time since the episode began [s], shape (num_samples,).
        values: The signal, shape (num_samples, num_muscles).
    """

    name: str
    title: str
    muscles: tuple[str, ...]
    time: np.ndarray
    values: np.ndarray


def read_course(path: Path, name: str, world: int, episode: int | None) -> Course:
    """Return a signal of a recording that `myowarp rollout --signals` has written.

    Args:
        path: The recording, .parquet, .csv or .npz.
        name: Signal, such as `activation` or `fatigue`.
        world: Number of the world.
        episode: Number of the episode; None: the first of the world.

    Raises:
        ValueError: There is no such signal, world or episode.
        OSError: The file cannot be read.
    """
    readers = {".parquet": _read_table, ".csv": _read_table, ".npz": _read_npz}
    if path.suffix.lower() not in readers:
        raise ValueError(f"plot {name} needs a recording, .parquet, .csv or .npz, got {str(path)!r}")
    muscles, keys, values = readers[path.suffix.lower()](path, name)
    present = keys["world"] == world
    if not present.any():
        raise ValueError(
            f"recording {str(path)!r} has no world {world}; --world goes to {keys['world'].max()}"
        )
    own = int(keys["episode"][present].min()) if episode is None else episode
    rows = present & (keys["episode"] == own)
    if not rows.any():
        known = ", ".join(map(str, np.unique(keys["episode"][present])))
        raise ValueError(f"world {world} has no episode {own}; available: {known}")
    order = np.argsort(keys["time"][rows], kind="stable")
    title = f"{path.name}, world {world}, episode {own}"
    return Course(name, title, muscles, keys["time"][rows][order], values[rows][order])


def _read_npz(path: Path, name: str) -> tuple[tuple[str, ...], dict[str, np.ndarray], np.ndarray]:
    """Return muscles, keys of the samples (n,), values (n, num_muscles)."""
    with np.load(path, allow_pickle=False) as file:
        if "muscles" not in file.files or "valid" not in file.files:
            raise ValueError(f"{str(path)!r} must be a recording of `myowarp rollout --signals`")
        muscles = tuple(file["muscles"].tolist())
        known = [
            entry for entry in file.files if file[entry].ndim == 3 and file[entry].shape[2] == len(muscles)
        ]
        check_choice("signal", name, tuple(entry for entry in known if not entry.startswith("angl")))
        valid, values = file["valid"].astype(bool), file[name]
        world = np.broadcast_to(np.arange(valid.shape[1]), valid.shape)
        keys = {"world": world[valid], "episode": file["episode"][valid], "time": file["time"][valid]}
    return muscles, keys, values[valid]


def _read_table(path: Path, name: str) -> tuple[tuple[str, ...], dict[str, np.ndarray], np.ndarray]:
    """Return muscles, keys of the samples (n,), values (n, num_muscles)."""
    import pandas as pd

    table = pd.read_parquet(path) if path.suffix.lower() == ".parquet" else pd.read_csv(path)
    if "muscle" not in table:
        raise ValueError(f"{str(path)!r} must be the muscles' table of `myowarp rollout --signals`")
    keys = ["world", "episode", "time"]
    check_choice(
        "signal", name, tuple(column for column in table if column not in (*keys, "muscle", "group"))
    )
    wide = table.pivot(index=keys, columns="muscle", values=name)[list(table["muscle"].unique())]
    index = wide.index.to_frame(index=False)
    return tuple(wide.columns), {key: index[key].to_numpy() for key in keys}, wide.to_numpy()


def over_time(course: Course, muscles: Sequence[str] = ()) -> Figure:
    """Return a signal of muscles over time, a line each.

    Raises:
        ValueError: There is no such muscle.
    """
    figure, axes = _axes(f"{course.name.replace('_', ' ').capitalize()}: {course.title}")
    shown, left_out = _chosen(course.muscles, muscles, np.nanmean(np.abs(course.values), axis=0))
    for index in shown:
        axes.plot(course.time, course.values[:, index], label=course.muscles[index])
    unit = UNITS.get(course.name, "1")
    _finish(axes, "Time [s]", f"{course.name.replace('_', ' ')} [{unit}]", left_out)
    if unit == "1":
        axes.set_ylim(min(0.0, axes.get_ylim()[0]), max(1.0, axes.get_ylim()[1]))
    return figure


def moment_arms(model: mujoco.MjModel, title: str, joint: str | None, muscles: Sequence[str] = ()) -> Figure:
    """Return the moment arms of muscles over the range of a joint, a line each.

    Raises:
        ValueError: There is no such joint or muscle, or the joint has no range.
    """
    names = [model.joint(j).name for j in range(model.njnt)]
    tied = {tie.joint for tie in couplings(model)}
    free = [j for j in range(model.njnt) if model.jnt_type[j] in POINT_JOINTS and j not in tied]
    movable = [j for j in free if np.ptp(model.jnt_range[j]) > 0]
    if joint is not None:
        check_choice("joint", joint, tuple(names[j] for j in movable))
        chosen = names.index(joint)
    else:
        largest = [np.abs(arms_over_range(model, j, 5)[1]).max() for j in movable]
        if not movable or max(largest) < LEAST_ARM:
            raise ValueError(f"{title} has no joint with a range that muscles move")
        chosen = next(j for j, arm in zip(movable, largest, strict=True) if arm > LEAST_ARM)
    angles, arms = arms_over_range(model, chosen, POINTS)
    hinge = model.jnt_type[chosen] == mujoco.mjtJoint.mjJNT_HINGE
    figure, axes = _axes(f"Moment arms about {names[chosen]}: {title}")
    labels = tuple(model.actuator(int(a)).name for a in _pullers(model))
    strength = np.abs(arms).max(axis=0)
    shown, left_out = _chosen(labels, muscles, np.where(strength > LEAST_ARM, strength, np.nan))
    for index in shown:
        axes.plot(np.degrees(angles) if hinge else angles, 100.0 * arms[:, index], label=labels[index])
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    _finish(axes, f"{names[chosen]} [{'°' if hinge else 'm'}]", "Moment arm −dl/dq [cm]", left_out)
    return figure


def arms_over_range(model: mujoco.MjModel, joint: int, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return moment arms -dl/dq over a joint's range, with the joints that follow it following.

    The other joints stay at the rest pose.

    Returns:
        Values of the coordinate (points,), and arms [m] (points, num_pullers) of actuators on tendons.
    """
    data, address = mujoco.MjData(model), model.jnt_qposadr[joint]
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "default")
    rest = (model.qpos0 if key < 0 else model.key_qpos[key]).copy()
    coordinate = np.linspace(model.jnt_range[joint, 0], model.jnt_range[joint, 1], points)
    tendons = model.actuator_trnid[_pullers(model), 0]
    lengths = np.zeros((2, points, len(tendons)))
    for side, shift in enumerate((-STEP, STEP)):
        for row, value in enumerate(coordinate):
            data.qpos[:] = rest
            data.qpos[address] = value + shift
            follow(model, data.qpos)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_tendon(model, data)
            lengths[side, row] = data.ten_length[tendons]
    return coordinate, -(lengths[1] - lengths[0]) / (2.0 * STEP)


def contraction(
    setup: Setup, title: str, what: str, muscles: Sequence[str] = (), models: Sequence[str] = ()
) -> Figure:
    """Return the force of muscles over length or velocity at full and at no activation.

    Args:
        setup: A task of the body, and its muscle model.
        title: Name of the body.
        what: "force-length" or "force-velocity".
        muscles: Muscles to show; empty: the strongest.
        models: Muscle models, a panel each; empty: that of the setup.

    Raises:
        ValueError: There is no such muscle or model.
    """
    setups = [Setup.of(setup, muscle=model) for model in models] or [setup]
    axis = "length" if what == "force-length" else "velocity"
    figure = panel.blank(max(WIDTH, 3.4 * len(setups) + 1.6), 4.8)
    panels = figure.subplots(1, len(setups), sharex=True, sharey=True, squeeze=False)[0]
    left_out = 0
    for axes, one in zip(panels, setups, strict=True):
        norm, tension, peak, names = contraction_curves(one, what)
        shown, left_out = _chosen(names, muscles, peak)
        said = f"Force over {axis}: {title}" if not models else one.muscles.model
        axes.set_title(said, color=panel.INK)
        axes.set_prop_cycle(**panel.LINES)
        for index in shown:
            line = axes.plot(norm[1, :, index], tension[1, :, index], label=names[index])[0]
            axes.plot(norm[0, :, index], tension[0, :, index], color=line.get_color(), linestyle=":")
        axes.margins(x=0.0)
    if models:
        figure.suptitle(f"Force over {axis}: {title}", x=0.02, ha="left", color=panel.INK)
        figure.supxlabel(CONTRACTION_AXES[axis], fontsize="medium")
    x_label = "" if models else CONTRACTION_AXES[axis]
    _finish(panels[-1], x_label, "", left_out)
    panels[0].set_ylabel("Force [N]; dotted: without activation")
    return figure


def contraction_curves(setup: Setup, what: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return forces of a body's muscles, as the simulation computes them; elastic tendons are settled.

    Args:
        setup: A task of the body, and its muscle model.
        what: "force-length", without velocity, or "force-velocity", where a tendon at its slack length leaves
            fibers of optimal length.

    Returns:
        Normalized length or velocity of fibers, and forces [N], without and with full activation, each (2,
        points, num_muscles); peak forces [N] and names of the muscles.

    Raises:
        ValueError: The body has no muscles, or the muscle model does not say how long fibers are.
    """
    spec, table, model = setup.spec, setup.muscles, build.oracle_model(setup.spec)
    over_length = what == "force-length"
    with wp.ScopedDevice("cpu"):
        muscles = build.new_muscles(table, model, Worlds.all(2 * POINTS), spec, PHYSICS["parity"])
        if not muscles.names:
            raise ValueError("force curves are those of muscles; the body has none")
        rigid, ids = muscles.geometry(), muscles.actuator_id
        if np.isnan(optimal := rigid.optimal_fiber_length.astype(float)).any():
            raise ValueError(f"force curves need the geometry of fibers, which {table.model!r} does not say")
        norm = np.linspace(*(NORM_LENGTHS if over_length else NORM_VELOCITIES), POINTS)
        each = np.tile(norm, 2)[:, None]
        length, velocity = np.zeros((2 * POINTS, model.nu)), np.zeros((2 * POINTS, model.nu))
        length[:, ids] = rigid.tendon_slack_length + (each if over_length else 1.0) * optimal
        velocity[:, ids] = (0.0 if over_length else each) * optimal * rigid.max_contraction_velocity
        muscles.activation.assign(np.repeat((0.0, 1.0), POINTS)[:, None] * np.ones(len(ids)))
        opt = SimpleNamespace(timestep=wp.zeros(1, dtype=float))
        forms = wp.zeros(length.shape, dtype=wp.types.vector(10, float))
        data = SimpleNamespace(
            ctrl=wp.zeros(length.shape, dtype=float),
            actuator_length=wp.array(length, dtype=float),
            actuator_velocity=wp.array(velocity, dtype=float),
        )
        still = SimpleNamespace(opt=opt, actuator_biasprm=forms)
        muscles.launch(still, data)
        if muscles.settles:
            muscles.settle(wp.ones(2 * POINTS, dtype=bool))
            muscles.launch(still, data)
        fibers = (length[:, ids] - muscles.geometry().tendon_length) / optimal
    shown = fibers if over_length else np.broadcast_to(each, fibers.shape)
    shape = 2, POINTS, -1
    peak = rigid.max_isometric_force[0]
    return shown.reshape(shape), muscles.tension.numpy().reshape(shape), peak, muscles.names


def learning(paths: Sequence[Path], columns: Sequence[str] = ()) -> Figure:
    """Return columns of CSV files over their column `samples`, a panel a column, a line a file.

    Raises:
        ValueError: A file is no such table, or has no such column.
        OSError: A file cannot be read.
    """
    if not paths:
        raise ValueError("plot learning needs at least one CSV file, got none")
    tables = [read_numbers(path) for path in paths]
    for path, table in zip(paths, tables, strict=True):
        if "samples" not in table:
            raise ValueError(f"{str(path)!r} must be a CSV with a column 'samples' and at least one row")
    common = [name for name in tables[0] if name != "samples" and all(name in table for table in tables)]
    usual = [name for name in common if "return" in name or "success" in name] or common[:4]
    for name in columns:
        check_choice("column", name, tuple(common))
    shown = list(columns) or usual
    if not shown:
        raise ValueError(f"{str(paths[0])!r} has no column of numbers besides samples")
    figure = panel.blank(WIDTH, 3.0 * len(shown) + 0.8)
    panels = figure.subplots(len(shown), 1, squeeze=False, sharex=True)[:, 0]
    for name, axes in zip(shown, panels, strict=True):
        for path, table in zip(paths, tables, strict=True):
            axes.plot(table["samples"], table[name], label=path.parent.name or path.stem)
        _finish(axes, "Samples" if name == shown[-1] else "", name.replace("_", " "), 0)
    return figure


def _pullers(model: mujoco.MjModel) -> np.ndarray:
    """Return the actuators on tendons."""
    return np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON)


def _chosen(names: tuple[str, ...], muscles: Sequence[str], size: np.ndarray) -> tuple[list[int], int]:
    """Return the muscles to show, and how many are left out: those named, else the largest; NaN never."""
    if muscles:
        return [muscle_index(name, names) for name in muscles], 0
    known = np.flatnonzero(~np.isnan(size))
    largest = known[np.argsort(-size[known], kind="stable")][:MOST]
    return sorted(largest.tolist()), len(known) - len(largest)


def _axes(title: str) -> tuple[Figure, Axes]:
    """Return a figure with one panel."""
    figure = panel.blank(WIDTH, 4.8)
    axes = figure.subplots()
    axes.set_title(title, color=panel.INK)
    axes.set_prop_cycle(**panel.LINES)
    return figure, axes


def _finish(axes: Axes, x_label: str, y_label: str, left_out: int) -> None:
    """Label a panel; the legend stands beside the lines, not on them."""
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.margins(x=0.0)
    note = f"{left_out} more, see --muscles" if left_out else None
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8.5, title=note)
