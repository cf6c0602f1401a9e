"""C3D recordings: markers, force plates beside the load that they measured, channels, and bad files."""

import contextlib
import logging
import re
from pathlib import Path

import numpy as np
import pytest
from recordings import CENTERS, FRAMES, RATE, ROWS, UP, measured, write

from myowarp.apps.cli.motion.c3d import C3d
from myowarp.motion.c3d import read_c3d
from myowarp.motion.loads import read_loads
from myowarp.motion.markers import read_trc
from myowarp.motion.storage import read_storage


def test_markers_channels_and_plates(tmp_path):
    places, emg = write(tmp_path / "walk.c3d")
    out = tmp_path / "out"
    C3d(
        tmp_path / "walk.c3d", plates=("calcn_r", "calcn_l"), names=("EMG1=soleus_r", "LASI=hip"), output=out
    )()
    markers = read_trc(out / "markers.trc")
    assert markers.names == ("hip", "RASI")
    np.testing.assert_allclose(markers.time, np.arange(FRAMES) / RATE)
    np.testing.assert_allclose(markers.positions, places, atol=1e-6)  # of the .trc file
    channels = read_storage(out / "analog.sto")
    assert channels.labels == ("soleus_r", "EMG1_2")
    np.testing.assert_allclose(channels.values, emg, rtol=1e-6)
    loads, file = read_loads(out / "grf.xml")
    assert [load.body for load in loads] == ["calcn_r", "calcn_l"]
    recording = read_storage(file)
    force, place, free = measured(0)
    for k, load in enumerate(loads):
        found = load.at(recording, recording.time)
        np.testing.assert_allclose(found.force, force[k] @ UP.T, rtol=1e-5, atol=1e-3)
        # The wrench about any point says the same: here that of the laboratory's origin.
        moment = np.cross(found.point, found.force) + found.torque
        wanted = (np.cross(place[k], force[k]) + free[k]) @ UP.T
        np.testing.assert_allclose(moment, wanted, atol=2e-3)
        np.testing.assert_allclose(found.point, np.tile(UP @ CENTERS[k], (ROWS, 1)), atol=1e-6)


def test_a_plate_that_pulls_down_is_said(tmp_path, caplog):
    write(tmp_path / "walk.c3d", sign=-1.0)
    with caplog.at_level(logging.WARNING, "myowarp"):
        read_c3d(tmp_path / "walk.c3d")
    assert re.search(r"force plate 1 pulls the person down by \d+ N; check --up", caplog.text)


def test_the_vertical_axis_of_the_file_and_of_the_user(tmp_path):
    places, _ = write(tmp_path / "walk.c3d", POINT={"Y_SCREEN": ["+Y"]})
    lab = places @ UP
    np.testing.assert_allclose(read_c3d(tmp_path / "walk.c3d").markers.positions, lab, atol=1e-6)
    stood = read_c3d(tmp_path / "walk.c3d", "x").markers.positions
    np.testing.assert_allclose(stood[..., 1], lab[..., 0], atol=1e-6)


def test_what_is_no_recording(tmp_path):
    path = tmp_path / "walk.c3d"
    write(path)
    with pytest.raises(
        ValueError, match=r"has no marker or channel 'EMG9'; available: EMG1, EMG1_2, LASI, RASI"
    ):
        read_c3d(path, names={"EMG9": "soleus_r"})
    with pytest.raises(ValueError, match=r"--plates must name one body for each of 2 force plates, got 1"):
        C3d(path, plates=("calcn_r",), output=tmp_path / "out")()
    with pytest.raises(ValueError, match=r"--names takes OLD=NEW, such as EMG1=soleus_r, got 'EMG1'"):
        C3d(path, names=("EMG1",), output=tmp_path / "out")()
    write(path, kind=7)
    with pytest.raises(ValueError, match=r"cannot be read as a C3D file: Type 7 is not supported"):
        read_c3d(path)
    path.write_text("no recording")
    with pytest.raises(ValueError, match=r"is no C3D file; its second byte must be 0x50"):
        read_c3d(path)


@pytest.mark.slow
def test_damaged_recordings_end_in_a_sentence(tmp_path):
    """Cut or changed bytes, by a seed; what is still read is no traceback either."""
    whole, path = tmp_path / "walk.c3d", tmp_path / "bad.c3d"
    write(whole)
    raw, rng = whole.read_bytes(), np.random.default_rng(0)
    for _ in range(12):
        damaged = bytearray(raw)
        if rng.random() < 0.3:
            del damaged[int(rng.integers(len(damaged))) :]
        for _ in range(int(rng.integers(1, 8))):
            damaged[int(rng.integers(min(len(damaged), 2600)))] = int(rng.integers(256)) if damaged else 0
        Path(path).write_bytes(damaged)
        with contextlib.suppress(ValueError):
            read_c3d(path)
