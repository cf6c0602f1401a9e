"""C3D recordings: markers, ground forces of force plates, and other analog channels, in OpenSim's axes.

The file is read by ezc3d (Michaud and Begon 2021, doi:10.21105/joss.02911), whose force plates of types 1 to
4 give force and moment in the laboratory's axes. A plate acts at the middle of its corners with its force and
its whole moment, as OpenSim's adapter has it with `OriginOfForcePlate`: a centre of pressure has no value
while nobody stands on the plate. Times begin at 0, as in OpenSim.

Source: the C3D file format, user guide (Motion Lab Systems 2021), POINT, ANALOG and FORCE_PLATFORM groups.
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from myowarp.disk import in_place, make_folder
from myowarp.extras import check_installed
from myowarp.motion.markers import UNITS, Markers, write_trc
from myowarp.motion.storage import Storage, logger, write_storage

UP = {
    "x": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "y": np.eye(3),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}
"""By the laboratory's vertical axis, the rotation into OpenSim's axes, of which y is up."""

DERIVED = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")
"""Parameters of the group POINT that list points which are no markers."""

PROBE = "import sys, ezc3d; ezc3d.ezc3d.ForcePlatforms(ezc3d.c3d(sys.argv[1]).c3d_swig)"

PATIENCE = 300.0
"""[s] after which a file is given up."""

PULL = 20.0
"""[N] that a plate may pull a person down, on average where it is loaded, unsaid."""


@dataclass(frozen=True, eq=False)
class Plate:
    """A force plate.

    Attributes:
        force: On the person [N], shape (rows, 3).
        moment: On the person about `point` [N m], shape (rows, 3).
        point: Middle of its corners [m], shape (3,).
    """

    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray


@dataclass(frozen=True, eq=False)
class C3dRecording:
    """Content of a C3D file, in OpenSim's axes.

    Attributes:
        markers: NaN where one was not seen; None: it has none.
        time: Of plates and channels [s], shape (rows,).
        plates: In the order of the file.
        channels: Analog channels that are no plate's, in the file's units.
        skipped: Points that are no markers, such as angles.
    """

    markers: Markers | None
    time: np.ndarray
    plates: tuple[Plate, ...]
    channels: Storage | None
    skipped: tuple[str, ...]

    def write(self, folder: Path, bodies: Sequence[str] = ()) -> tuple[str, ...]:
        """Write `markers.trc`, `grf.mot`, `grf.xml`, `analog.sto`, as far as there is anything; return which.

        Args:
            folder: Folder, which is made.
            bodies: On which each plate acts, in the order of plates; none: no `grf.xml` is written.

        Raises:
            ValueError: There are not as many bodies as plates.
            OSError: A file cannot be written.
        """
        if bodies and len(bodies) != len(self.plates):
            raise ValueError(
                f"--plates must name one body for each of {len(self.plates)} force plates, got {len(bodies)}"
            )
        make_folder(folder)
        written = []
        if self.markers is not None:
            write_trc(folder / "markers.trc", self.markers)
            written.append("markers.trc")
        if self.plates:
            write_storage(folder / "grf.mot", "forces and moments of force plates", ground_forces(self))
            written.append("grf.mot")
        if bodies:
            with in_place(folder / "grf.xml") as scratch:
                scratch.write_text(_external_loads(bodies), encoding="utf-8")
            written.append("grf.xml")
        if self.channels is not None:
            write_storage(folder / "analog.sto", "analog channels", self.channels)
            written.append("analog.sto")
        return tuple(written)


def read_c3d(path: Path, up: str | None = None, names: Mapping[str, str] | None = None) -> C3dRecording:
    """Read a C3D file.

    Args:
        path: The file.
        up: The laboratory's vertical axis, x, y or z; None: what the file says (POINT:Y_SCREEN), or z.
        names: New names of markers and channels, by their old ones.

    Raises:
        ValueError: It is no such file, has a force plate of another type, or a name is not in it.
        ImportError: ezc3d is not installed.
        OSError: It cannot be read.
    """
    check_installed(repr(str(path)), "ezc3d", "c3d")
    import ezc3d

    with path.open("rb") as file:
        if file.read(2)[1:] != b"\x50":
            raise ValueError(f"{str(path)!r} is no C3D file; its second byte must be 0x50")
    _probe(path)
    try:
        file = ezc3d.c3d(str(path), extract_forceplat_data=False)
        plates = _plates(file, ezc3d)
    except Exception as error:  # of ezc3d's C++, under many names
        text = " ".join(str(error).split())[:200]
        raise ValueError(f"{str(path)!r} cannot be read as a C3D file: {text}") from error
    axes = UP[up or _vertical(file)]
    renamed, used = dict(names or {}), set[str]()

    def called(label: str) -> str:
        used.add(label)
        return renamed.get(label, label)

    markers, skipped = _markers(path, file, axes, called)
    time, channels = _channels(file, called)
    if missing := [name for name in renamed if name not in used]:
        raise ValueError(
            f"{str(path)!r} has no marker or channel {missing[0]!r}; available: {', '.join(sorted(used))}"
        )
    turned = tuple(Plate(one.force @ axes.T, one.moment @ axes.T, axes @ one.point) for one in plates)
    for number, plate in enumerate(turned, 1):
        loaded = np.abs(plate.force[:, 1]) > PULL
        if loaded.any() and (pull := -plate.force[loaded, 1].mean()) > PULL:
            logger.warning(
                "%s: force plate %d pulls the person down by %.0f N; check --up and the sign of its channels",
                path,
                number,
                pull,
            )
    return C3dRecording(markers, time, turned, channels, skipped)


def _probe(path: Path) -> None:
    """Read the file in another process, which ezc3d ends at some damaged files."""
    command = [sys.executable, "-c", PROBE, str(path)]
    try:
        code = subprocess.run(command, capture_output=True, timeout=PATIENCE, check=False).returncode
    except subprocess.TimeoutExpired:
        code = -1
    if code < 0:
        raise ValueError(f"{str(path)!r} cannot be read as a C3D file: it is damaged; export it once more")


def _value(file: Any, group: str, name: str) -> Any:
    """Return a parameter, None where there is none."""
    found = file["parameters"].get(group, {}).get(name)
    return None if found is None or not len(np.atleast_1d(found["value"])) else found["value"]


def _labels(file: Any, group: str, count: int) -> list[str]:
    """Return labels, with numbers where one is empty or there a second time."""
    found: list[str] = []
    for name in ("LABELS", *(f"LABELS{k}" for k in range(2, 256))):
        value = _value(file, group, name)
        if value is None and name != "LABELS":
            break
        found += [str(label).strip() for label in value or []]
    found = (found + [""] * count)[:count]
    found = [label.rpartition(":")[2] or f"{group.lower()}_{k + 1}" for k, label in enumerate(found)]
    seen = Counter[str]()
    for k, label in enumerate(found):
        seen[label] += 1
        if seen[label] > 1:
            found[k] = f"{label}_{seen[label]}"
    return found


def _scale(path: Path, unit: str) -> float:
    """Return the metres of a unit."""
    if unit.strip().lower() not in UNITS:
        raise ValueError(f"{str(path)!r} has the unit {unit!r}; known are {', '.join(UNITS)}")
    return UNITS[unit.strip().lower()]


def _vertical(file: Any) -> str:
    """Return the vertical axis that a file says, or z."""
    said = _value(file, "POINT", "Y_SCREEN")
    axis = str(said[0]).strip().lower().lstrip("+-") if said is not None else ""
    return axis if axis in UP else "z"


def _markers(path: Path, file: Any, axes: np.ndarray, called: Any) -> tuple[Markers | None, tuple[str, ...]]:
    """Return markers, and the points that are none."""
    points = np.asarray(file["data"]["points"])[:3]
    labels = _labels(file, "POINT", points.shape[1])
    derived = {str(label).strip() for name in DERIVED for label in (_value(file, "POINT", name) or [])}
    derived |= {label.rpartition(":")[2] for label in derived}
    kept = [k for k, label in enumerate(labels) if label not in derived]
    skipped = tuple(label for label in labels if label in derived)
    if not kept or not points.shape[2]:
        return None, skipped
    rate = float(file["header"]["points"]["frame_rate"])
    if not 0.0 < rate < np.inf:
        raise ValueError(f"{str(path)!r} has the frame rate {rate:g}; it must be above 0 Hz")
    scale = _scale(path, str((_value(file, "POINT", "UNITS") or ["mm"])[0]))
    places = scale * np.moveaxis(points[:, kept], 0, 2).swapaxes(0, 1) @ axes.T
    places[~np.isfinite(places).all(axis=2) | (places == 0.0).all(axis=2)] = np.nan
    names = tuple(called(labels[k]) for k in kept)
    return Markers(names, np.arange(len(places)) / rate, places), skipped


def _channels(file: Any, called: Any) -> tuple[np.ndarray, Storage | None]:
    """Return times of analog rows, and the channels that are no plate's."""
    analogs = np.asarray(file["data"]["analogs"])[0]
    rate = float(file["header"]["analogs"]["frame_rate"])
    if not analogs.size or not 0.0 < rate < np.inf:
        return np.zeros(0), None
    time = np.arange(analogs.shape[1]) / rate
    taken = np.ravel(_value(file, "FORCE_PLATFORM", "CHANNEL")) if _count(file) else np.zeros(0)
    kept = [k for k in range(len(analogs)) if k + 1 not in taken]
    if not kept:
        return time, None
    labels = _labels(file, "ANALOG", len(analogs))
    return time, Storage(tuple(called(labels[k]) for k in kept), time, analogs[kept].T)


def _count(file: Any) -> int:
    """Return how many force plates a file has."""
    used = _value(file, "FORCE_PLATFORM", "USED")
    return 0 if used is None else int(np.ravel(used)[0])


def _plates(file: Any, ezc3d: Any) -> list[Plate]:
    """Return the force plates in the laboratory's axes."""
    if not _count(file):
        return []
    read = ezc3d.ezc3d.ForcePlatforms(file.c3d_swig).forcePlatforms()
    return [_plate(read[k]) for k in range(len(read))]


def _plate(read: Any) -> Plate:
    """Return a force plate in the laboratory's axes."""
    length = UNITS.get(read.positionUnit().strip().lower())
    if length is None or read.forceUnit().strip() not in ("N", ""):
        raise RuntimeError(f"a force plate has the units {read.forceUnit()!r} and {read.positionUnit()!r}")

    def rows(vectors: Any) -> np.ndarray:
        return np.array([np.ravel(one.to_array()) for one in vectors]).reshape(-1, 3)

    point = np.ravel(read.meanCorners().to_array())
    return Plate(rows(read.forces()), length * rows(read.moments()), length * point)


def ground_forces(recording: C3dRecording) -> Storage:
    """Return force, point and moment of each plate, under OpenSim's usual names, `ground_force_1_vx`."""
    labels: list[str] = []
    columns: list[np.ndarray] = []
    for number, plate in enumerate(recording.plates, 1):
        names = f"ground_force_{number}_v", f"ground_force_{number}_p", f"ground_torque_{number}_"
        labels += [f"{name}{axis}" for name in names for axis in "xyz"]
        columns += [plate.force, np.tile(plate.point, (len(plate.force), 1)), plate.moment]
    return Storage(tuple(labels), recording.time, np.concatenate(columns, axis=1))


def _external_loads(bodies: Sequence[str]) -> str:
    """Return a file of OpenSim's `ExternalLoads` for `grf.mot`."""
    forces = "".join(
        f"""
      <ExternalForce name="plate_{number}">
        <applied_to_body>{body}</applied_to_body>
        <force_expressed_in_body>ground</force_expressed_in_body>
        <point_expressed_in_body>ground</point_expressed_in_body>
        <force_identifier>ground_force_{number}_v</force_identifier>
        <point_identifier>ground_force_{number}_p</point_identifier>
        <torque_identifier>ground_torque_{number}_</torque_identifier>
      </ExternalForce>"""
        for number, body in enumerate(bodies, 1)
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000">
  <ExternalLoads name="plates">
    <objects>{forces}
    </objects>
    <datafile>grf.mot</datafile>
  </ExternalLoads>
</OpenSimDocument>
"""
