"""Gait cycles: from a heel strike to the next one of the same foot, as the ground's force on it has them.

A foot is on the ground where the vertical force on it is above 20 N, as with force plates in Zeni et al.
(2008), doi:10.1016/j.gaitpost.2007.07.007. Left and right are what OpenSim's names say, `_l` and `_r`.
"""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from myowarp.motion.loads import read_loads
from myowarp.motion.storage import read_storage

CONTACT = 20.0
"""Vertical force above which a foot is on the ground [N]."""
BOUNCE = 0.1
"""Time that a foot is off the ground before a heel strike, at least [s]."""
BRUSH = 0.05
"""Time on the ground below which a foot does not stand on it [s]; sprinters stand for 0.09 s."""
SIDE = re.compile(r"_([lr])(?=_|$)")
PERCENT = np.linspace(0.0, 100.0, 101)
"""Places in a gait cycle [%]."""


def side_of(name: str) -> tuple[str, str]:
    """Return a name without its side, and the side: "l" or "r"; "" where the name says none or both."""
    sides = set(SIDE.findall(name))
    return (SIDE.sub("", name), sides.pop()) if len(sides) == 1 else (name, "")


def mirrored(name: str) -> str:
    """Return the name of the same thing on the other side; its own where it says none."""
    side = side_of(name)[1]
    return SIDE.sub("_r" if side == "l" else "_l", name) if side else name


def contacts(time: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return when a foot comes to the ground and when it leaves it [s], on straight lines between the rows.

    A contact goes on through gaps shorter than `BOUNCE`, and a foot that touches the ground for less than
    `BRUSH` swings on. The begin or end of one that the recording does not see is infinite.

    Args:
        time: Increasing [s], shape (rows,).
        force: Vertical force on the foot [N], shape (rows,).
    """
    on = force > CONTACT
    turns = np.flatnonzero(on[1:] != on[:-1])
    share = (CONTACT - force[turns]) / (force[turns + 1] - force[turns])
    at = time[turns] + share * (time[turns + 1] - time[turns])
    at = np.concatenate([[-np.inf] * bool(on[0]), at, [np.inf] * bool(on[-1])])
    begin, end = at[::2], at[1::2]
    apart = begin[1:] - end[:-1] >= BOUNCE
    begin, end = begin[np.append(True, apart)[: len(begin)]], end[np.append(apart, True)[: len(end)]]
    stands = end - begin >= BRUSH
    return begin[stands], end[stands]


def heel_strikes(time: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return when a foot comes to the ground [s], see `contacts`."""
    begin, _ = contacts(time, force)
    return begin[np.isfinite(begin)]


def gait_cycles(path: Path) -> dict[str, list[tuple[float, float]]]:
    """Return the cycles of each side that a recording of ground reactions has whole.

    Args:
        path: A file of OpenSim's `ExternalLoads`; forces in the ground's frame, whose y is up.

    Returns:
        Begin and end [s] of each cycle by side, "l" or "r"; nothing where a side has no two heel strikes.

    Raises:
        ValueError: A file is not what it should be.
        OSError: A file cannot be read.
    """
    forces = vertical_forces(path)
    if forces is None:
        return {}
    time, up = forces
    strikes = {side: heel_strikes(time, force).tolist() for side, force in up.items()}
    return {s: list(pairwise(at)) for s, at in strikes.items() if len(at) > 1}


def vertical_forces(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]] | None:
    """Return times [s] and the vertical force on the bodies of each side [N], "l" or "r", (rows,) each.

    Args:
        path: As `gait_cycles` takes it; None is returned for a file that names no recording.

    Raises:
        As `gait_cycles`.
    """
    columns, source = read_loads(path)
    if source is None:
        return None
    table, force = read_storage(source), dict[str, np.ndarray]()
    for load in columns:
        if (side := side_of(load.body)[1]) and load.force and load.force_frame == "ground":
            up = load.at(table, table.time).force[:, 1]
            force[side] = force.get(side, np.zeros(len(table.time))) + up
    return table.time, force


def over_cycle(time: np.ndarray, values: np.ndarray, cycle: tuple[float, float]) -> np.ndarray:
    """Return a quantity at `PERCENT` of a cycle, shape (101,); NaN where it is not known.

    Args:
        time: Increasing [s], shape (rows,).
        values: The quantity, shape (rows,).
        cycle: Begin and end [s].
    """
    begin, end = cycle
    return np.interp(begin + PERCENT / 100.0 * (end - begin), time, values, left=np.nan, right=np.nan)
