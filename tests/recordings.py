"""Recordings that tests of their readers and of the pages share: force plates, inertial sensors."""

from pathlib import Path

import numpy as np
import pytest

DATA = Path(__file__).parent / "data"
FRAMES, SUB, RATE = 6, 10, 100.0
ROWS = FRAMES * SUB
NAMES = ("S1:LASI", "S1:RASI", "S1:HipAngles")

# In the laboratory, whose z axis is up [m]: corners in the order of the format, x of the plate from corner 2
# to 1 and y from 4 to 1, so that z points down; a transducer below the surface.
CENTERS = np.array([[0.4, 0.3, 0.0], [0.4, 1.0, 0.05]])
PLATE = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]).T
HALF = 0.25, 0.2
BELOW = np.array([0.002, -0.003, 0.04])
"""From the middle of the surface to the transducer, in the plate [m]."""
UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Into OpenSim's axes."""


def measured(seed):
    """Return force on a person, its place and a free moment, of two plates [N, m, N m], (rows, 3) each."""
    rng = np.random.default_rng(seed)
    force = rng.normal(size=(2, ROWS, 3)) * 40 + [0, 0, 700]
    offset = np.zeros((2, ROWS, 3))
    offset[..., :2] = rng.uniform(-0.15, 0.15, (2, ROWS, 2))
    free = np.zeros((2, ROWS, 3))
    free[..., 2] = rng.normal(size=(2, ROWS)) * 5
    return force, CENTERS[:, None] + offset, free


def write(path, seed=0, sign=1.0, kind=2, **changed):
    """Write a recording of two plates, two markers, an angle and two channels."""
    ezc3d = pytest.importorskip("ezc3d")
    force, place, free = measured(seed)
    channels = []
    for k in range(2):
        transducer = CENTERS[k] + PLATE @ BELOW
        moment = np.cross(place[k] - transducer, force[k]) + free[k]
        channels += [*(sign * force[k] @ PLATE).T, *(sign * 1e3 * moment @ PLATE).T]
    rng = np.random.default_rng(1)
    channels += [*rng.normal(size=(2, ROWS))]
    file, points = ezc3d.c3d(), np.ones((4, 3, FRAMES))
    points[:3] = rng.normal(size=(3, 3, FRAMES)) * 1000
    points[:3, 1, 2] = np.nan
    values = {
        "POINT": {"RATE": [RATE], "LABELS": NAMES, "UNITS": ["mm"], "ANGLES": ["HipAngles"]},
        "ANALOG": {
            "RATE": [RATE * SUB],
            "LABELS": [f"{axis}{k}" for k in (1, 2) for axis in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")]
            + ["EMG1", "EMG1"],
            "UNITS": ["N"] * 12 + ["V", "V"],
        },
        "FORCE_PLATFORM": {
            "USED": [2],
            "TYPE": [kind, kind],
            "ZERO": [1, 0],
            "CHANNEL": np.arange(1, 13).reshape(2, 6).T,
            "ORIGIN": np.tile(-1e3 * BELOW, (2, 1)).T,
            "CORNERS": np.stack(
                [
                    1e3 * (center + PLATE @ [x * HALF[0], y * HALF[1], 0.0])
                    for center in CENTERS
                    for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))
                ]
            ).T.reshape(3, 2, 4).transpose(0, 2, 1),
        },
    }  # fmt: skip
    for group, parameters in values.items():
        for name, value in {**parameters, **changed.get(group, {})}.items():
            array = np.array(value)
            if array.dtype.kind != "i":
                file.add_parameter(group, name, value)
                continue
            parameter = ezc3d.ezc3d.Parameter(name)
            whole = ezc3d.ezc3d.VecInt([int(x) for x in array.ravel(order="F")])
            parameter.set(whole, list(array.shape))
            file["parameters"].add_parameter(group, parameter)
    file["data"]["points"], file["data"]["analogs"] = points, np.array(channels)[None]
    file.write(str(path))
    return points[:3, :2].transpose(2, 1, 0) / 1e3 @ UP.T, np.array(channels[-2:]).T


STILL, WALK = (DATA / "opensim" / f"sensors_{name}.sto" for name in ("still", "walk"))
ANGLES = (-np.pi / 2, 0.0, 0.0)
WEIGHTS = {"pelvis_imu": 1.0, "thigh_imu": 2.0, "shank_imu": 0.5}


def write_sensors(folder, names=None):
    """Write recordings of sensors, under other names if given, with `placer.xml` and `imu_ik.xml`."""
    names = names or {name: name for name in WEIGHTS}
    for path in (STILL, WALK):
        text = path.read_text()
        for old, new in names.items():
            text = text.replace(old, new)
        (folder / path.name).write_text(text)
    (folder / "placer.xml").write_text(
        f"""<OpenSimDocument Version="40500"><IMUPlacer>
        <sensor_to_opensim_rotations>{ANGLES[0]} 0 0</sensor_to_opensim_rotations>
        <orientation_file_for_calibration>{STILL.name}</orientation_file_for_calibration>
        <base_imu_label></base_imu_label></IMUPlacer></OpenSimDocument>"""
    )
    weights = "".join(
        f'<OrientationWeight name="{names[name]}"><weight>{weight}</weight></OrientationWeight>'
        for name, weight in WEIGHTS.items()
    )
    (folder / "imu_ik.xml").write_text(
        f"""<OpenSimDocument Version="40500"><IMUInverseKinematicsTool><time_range>0.5 1</time_range>
        <sensor_to_opensim_rotations>{ANGLES[0]} 0 0</sensor_to_opensim_rotations>
        <orientations_file>{WALK.name}</orientations_file>
        <orientation_weights><objects>{weights}</objects></orientation_weights>
        </IMUInverseKinematicsTool></OpenSimDocument>"""
    )


MARKERS = {"LASI": (0.0, -0.1), "RASI": (0.0, 0.1), "SACR": (-0.2, 0.0)}
"""On the pelvis: x and z [m]."""


def write_gait(folder):
    """Write `gait.osim`, a model with markers, `ik.xml` with these, and recordings of sensors."""
    marker = '<Marker name="{}"><body>pelvis</body><location>{} 0.1 {}</location></Marker>'
    text = (DATA / "osim/gait10dof18musc.osim").read_text()
    head, tail = text.split('<MarkerSet name="markerset">')
    markers = "".join(marker.format(name, *place) for name, place in MARKERS.items())
    tail = tail.replace("<objects />", f"<objects>{markers}</objects>", 1)
    (folder / "gait.osim").write_text(f'{head}<MarkerSet name="markerset">{tail}')
    tasks = "".join(f'<IKMarkerTask name="{name}"><weight>1</weight></IKMarkerTask>' for name in MARKERS)
    (folder / "ik.xml").write_text(
        f"""<OpenSimDocument Version="40000"><InverseKinematicsTool><IKTaskSet><objects>{tasks}
        </objects></IKTaskSet></InverseKinematicsTool></OpenSimDocument>"""
    )
    write_sensors(
        folder, {"pelvis_imu": "pelvis_imu", "thigh_imu": "femur_r_imu", "shank_imu": "tibia_r_imu"}
    )
