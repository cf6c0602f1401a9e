"""Degrees and radians: headers as OpenSim reads them, and angles that cannot be what a header says."""

import json
import logging
import re
from pathlib import Path

import numpy as np
import pytest
import reader_cases as cases

from myowarp.apps.cli.motion.dynamics import Dynamics
from myowarp.apps.reports.motion import angles_of
from myowarp.motion import streams
from myowarp.motion.loads import Loads
from myowarp.motion.movement import read_motion, read_parts
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.motion.streams import Margin, Stream
from myowarp.motion.units import doubtful_times
from myowarp.osim.body.skeleton import Bones

DATA = Path(__file__).parents[1] / "data"
THEIRS = json.loads((DATA / "opensim/readers.json").read_text())["headers"]
ARM = DATA / "osim/arm26.osim"
ROWS, RATE = 60, 100.0
DEGREES = np.stack(
    [20.0 + 10.0 * np.sin(0.2 * np.arange(ROWS)), 60.0 + 30.0 * np.cos(0.1 * np.arange(ROWS))], axis=1
)
NAMES = ("r_shoulder_elev", "r_elbow_flex")


@pytest.fixture(scope="module")
def arm():
    return Bones.read(ARM)


def recording(folder, head, values, name="walk.mot"):
    """Write a recording, and return its path."""
    rows = ["\t".join(f"{x:.9g}" for x in (k / RATE, *row)) for k, row in enumerate(values)]
    path = folder / name
    path.write_text("\n".join([*head, "endheader", "\t".join(("time", *NAMES)), *rows]) + "\n")
    return path


@pytest.mark.parametrize(("header", "theirs"), list(zip(cases.HEADERS, THEIRS, strict=True)))
def test_headers_are_read_as_opensim_reads_them(tmp_path, header, theirs):
    """By the reader of short files, and by that of long ones."""
    for suffix, in_degrees in zip((".mot", ".sto"), theirs, strict=True):
        path = tmp_path / f"walk{suffix}"
        path.write_text(f"{header}\nendheader\n{cases.NAMES}{cases.ROWS}")
        assert read_storage(path).in_degrees == in_degrees
        with Stream(path) as stream:
            ((part, _),) = stream.parts(Margin())
        assert part.in_degrees == in_degrees


@pytest.mark.parametrize(("head", "message"), [
    (["walk", "inDegrees=no"], "header of .* says radians, and OpenSim reads it in degrees; write the lines"),
    (["walk", "Angles are in radians."], "says radians, and OpenSim reads it in degrees"),
    (["walk", "version=1", "indegrees=yes"], "says degrees, and OpenSim reads it in radians"),
    (["walk", "version=1", "inDegrees=true"], "says degrees, and OpenSim reads it in radians"),
    (["walk", "version=1", "inDegrees=yes,,"], "says degrees, and OpenSim reads it in radians"),
    (["walk", "version=1", "Angles are in degrees."], "says degrees, and OpenSim reads it in radians"),
    (["walk", "version=1", "inDegrees=perhaps"], "has inDegrees=perhaps; it must be yes or no"),
    (["walk", "version=1"], r"r_elbow_flex of .* goes to 90, in radians 5157 degrees; its range is 0 to 130 "
     r"degrees; a \.mot or \.sto file says which by a line inDegrees=yes or inDegrees=no"),
    (["walk", "version=1", "inDegrees=no"], "r_elbow_flex of .* goes to 90, in radians 5157 degrees; .* its "
     "header says inDegrees=no, so correct it to inDegrees=yes, or write true turns in degrees"),
])  # fmt: skip
def test_headers_that_leave_it_open_are_refused(tmp_path, arm, monkeypatch, head, message):
    path = recording(tmp_path, head, DEGREES)
    with pytest.raises(ValueError, match=message):
        read_motion(path, arm)
    monkeypatch.setattr(streams, "FRAMES", 16)
    with pytest.raises(ValueError, match=message):
        list(read_parts(path, arm))


@pytest.mark.parametrize(("head", "values", "message"), [
    (["inDegrees=yes"], np.degrees(DEGREES), "goes to 5157, .* the file is read in degrees, as its header"),
    ([], np.radians(DEGREES), "'.*' is read in radians: its header does not say inDegrees"),
    (["inDegrees=yes"], np.radians(DEGREES), r"within 1\.57 degrees; if they are radians, up to 90 degrees, "
     "its header must say version=1 and inDegrees=no"),
])  # fmt: skip
def test_angles_that_cannot_be_are_said_once(tmp_path, arm, monkeypatch, caplog, head, values, message):
    path = recording(tmp_path, ["walk", "version=1", *head], values)
    scale = np.pi / 180.0 if head else 1.0
    for size in (ROWS, 16):
        monkeypatch.setattr(streams, "FRAMES", size)
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            found = np.concatenate([part.values for part in read_parts(path, arm)])
        np.testing.assert_allclose(found, scale * values, atol=1e-6)
        (said,) = (record.getMessage() for record in caplog.records)
        assert re.search(message, said)
        assert "\n" not in said


@pytest.mark.parametrize(("head", "values"), [
    (["version=1", "inDegrees=no"], np.radians(DEGREES)),
    (["nRows=60"], DEGREES),
    *((["version=1", "inDegrees=yes"], scale * DEGREES) for scale in (1.0, 0.0, 0.003, 0.05, -0.02, 3.0)),
])  # fmt: skip
def test_angles_that_can_be_are_not_doubted(tmp_path, arm, caplog, head, values):
    """Small ones, too, where they would be no pose in radians; and 90 degrees out of range."""
    with caplog.at_level(logging.WARNING):
        read_motion(recording(tmp_path, ["walk", *head], values), arm)
    assert not caplog.records


def test_columns_that_are_not_read_are_not_doubted(tmp_path, caplog):
    """Of a knee cap that follows, in degrees among radians, as in a public trial."""
    leg = Bones.read(DATA / "osim/leg6dof9musc.osim")
    time = np.arange(30) / RATE
    rows = "".join(f"{t:.2f}\t{-0.5 - t:.3f}\t{57.0 + t:.3f}\n" for t in time)
    path = tmp_path / "walk.sto"
    labels = "/jointset/knee_r/knee_angle_r/value\t/jointset/pat_r/knee_angle_pat_r/value"
    path.write_text(f"inDegrees=no\nnColumns=9\nversion=3\nendheader\ntime\t{labels}\n{rows}")
    with caplog.at_level(logging.WARNING):
        motion = read_motion(path, leg)
    np.testing.assert_allclose(
        motion.values[:, leg.coordinates.index("knee_angle_r")], -0.5 - time, atol=1e-9
    )
    assert [record.getMessage() for record in caplog.records] == [
        f"{str(path)!r} says nColumns=9 and has 3 columns"
    ]


def test_a_coordinate_twice(tmp_path, arm):
    path = recording(tmp_path, ["walk", "version=1", "inDegrees=yes"], DEGREES)
    path.write_text(path.read_text().replace(NAMES[1], f"/jointset/r_shoulder/{NAMES[0]}/value"))
    with pytest.raises(ValueError, match="has two columns of the coordinate 'r_shoulder_elev'"):
        read_motion(path, arm)


@pytest.mark.parametrize(("label", "refused"), [
    ("r_elbow_flexion", True), ("R_Elbow_Flex", True), ("elbow_flex", True),
    ("/jointset/r_elbow/r_elbow_flexion/value", True), ("r_shoulder_elev_u", False), ("wrist", False),
])  # fmt: skip
def test_columns_that_are_called_nearly_like_a_coordinate(tmp_path, arm, monkeypatch, caplog, label, refused):
    """An elbow that stood at its default over a column of the elbow; other columns are named, once."""
    path = recording(tmp_path, ["walk", "version=1", "inDegrees=yes"], DEGREES)
    path.write_text(path.read_text().replace(NAMES[1], label))
    name = label.split("/")[-2] if "/" in label else label
    for size in (ROWS, 16):
        monkeypatch.setattr(streams, "FRAMES", size)
        caplog.clear()
        if refused:
            message = f"has no 'r_elbow_flex', and a column '{name}', .*; rename the column"
            with pytest.raises(ValueError, match=message):
                list(read_parts(path, arm))
            continue
        with caplog.at_level(logging.WARNING):
            parts = list(read_parts(path, arm))
        assert parts[0].absent == ("r_elbow_flex",)
        assert [record.getMessage() for record in caplog.records] == [
            f"no coordinate of the model reads these columns of {str(path)!r}: {name}"
        ]


@pytest.mark.parametrize(("default", "said"), [(0.0, True), (np.radians(60.0), False)])
def test_a_locked_coordinate_that_moves_in_the_file_is_named(tmp_path, caplog, default, said):
    """OpenSim 4.6 finds the same moments of the arm whether its elbow is locked or not."""
    begin, text = ARM.read_text().split('<Coordinate name="r_elbow_flex">')
    text = re.sub(r"<default_value>[^<]*", f"<default_value>{float(default)!r}", text, count=1)
    locked = text.replace("<locked>false", "<locked>true", 1)
    (tmp_path / "arm.osim").write_text(f'{begin}<Coordinate name="r_elbow_flex">{locked}')
    path = recording(tmp_path, ["walk", "version=1", "inDegrees=yes"], np.tile([20.0, 60.0], (ROWS, 1)))
    with caplog.at_level(logging.WARNING):
        read_motion(path, Bones.read(tmp_path / "arm.osim"))
    texts = [record.getMessage() for record in caplog.records]
    assert [text.split(";")[0] for text in texts] == (
        [f"locked in the model, and not where {str(path)!r} has it: r_elbow_flex"] if said else []
    )


def test_states_of_others_than_coordinates_are_not_named(tmp_path, arm, caplog):
    path = recording(tmp_path, ["walk", "version=1", "inDegrees=yes"], DEGREES)
    path.write_text(path.read_text().replace(NAMES[1], "/forceset/BRA/activation"))
    with caplog.at_level(logging.WARNING):
        assert read_motion(path, arm).absent == ("r_elbow_flex",)
    assert not caplog.records


@pytest.mark.parametrize(("factor", "said"), [(1.0, ""), (1e3, "lasts 590 s at 0.1 Hz"),
                                              (100.0 / 0.59, "lasts 100 s at 0.59 Hz")])  # fmt: skip
def test_times_that_are_hardly_seconds(tmp_path, arm, caplog, factor, said):
    """60 frames at 100 Hz, in ms and in percent."""
    path = recording(tmp_path, ["walk", "version=1", "inDegrees=yes"], DEGREES)
    head, rows = path.read_text().split("flex\n")
    rows = [(float(row.split()[0]) * factor, row.split(maxsplit=1)[1]) for row in rows.splitlines()]
    path.write_text(f"{head}flex\n" + "".join(f"{time:.9g}\t{rest}\n" for time, rest in rows))
    with caplog.at_level(logging.WARNING):
        read_motion(path, arm)
    texts = [record.getMessage() for record in caplog.records]
    assert texts == (
        [f"the recording {str(path)!r} {said}; is its time in ms, or in percent?"] if said else []
    )


@pytest.mark.parametrize(("without", "said"), [
    (range(20, 25), "has no rows between 0.19 and 0.25 s (5 are missing), which a spline bridges; fill the "
     "gap, or cut the file there"),
    ([20], ""),
    (range(1, 60, 2), ""),
])  # fmt: skip
def test_missing_rows_are_said(tmp_path, arm, caplog, without, said):
    """Not a single one, and not times of a solver that takes steps as it needs them."""
    path = recording(tmp_path, ["walk", "version=1", "inDegrees=yes"], DEGREES)
    lines = path.read_text().splitlines(keepends=True)
    first = len(lines) - ROWS
    path.write_text("".join(line for i, line in enumerate(lines) if i - first not in without))
    time = np.arange(ROWS) / 100.0
    uneven = np.cumsum(np.where(np.arange(ROWS) % 7, 0.01, 0.08))
    with caplog.at_level(logging.WARNING):
        read_motion(path, arm)
    assert [*doubtful_times(path, uneven)] == []
    assert [*doubtful_times(path, time[:1])] == []
    texts = [record.getMessage() for record in caplog.records]
    assert texts == ([f"{str(path)!r} {said}"] if said else [])


def test_missing_rows_of_loads_are_said(tmp_path, caplog):
    time = np.arange(40) / 100.0
    kept = (time < 0.1) | (time > 0.2)
    push = Storage(("fx", "fy", "fz"), time[kept], np.ones((int(kept.sum()), 3)))
    write_storage(tmp_path / "push.mot", "push", push)
    (tmp_path / "push.xml").write_text(
        '<ExternalLoads name="l"><objects><ExternalForce name="hand"><applied_to_body>hand</applied_to_body>'
        "<force_identifier>f</force_identifier></ExternalForce></objects><datafile>push.mot</datafile>"
        "</ExternalLoads>"
    )
    with caplog.at_level(logging.WARNING):
        Loads(tmp_path / "push.xml")
    (said,) = (record.getMessage() for record in caplog.records)
    assert said.startswith(
        f"{str(tmp_path / 'push.mot')!r} has no rows between 0.09 and 0.21 s (11 are missing)"
    )


def test_angles_that_wrap_are_said(tmp_path, arm, caplog):
    """A turn of the shoulder that an arc tangent brings back from 180 to -180 degrees."""
    turn = np.linspace(150.0, 210.0, ROWS)
    for values, said in ((turn, False), ((turn + 180.0) % 360.0 - 180.0, True)):
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            path = recording(
                tmp_path, ["walk", "version=1", "inDegrees=yes"], np.stack([values, 0 * turn], axis=1)
            )
            read_motion(path, arm)
        texts = [record.getMessage() for record in caplog.records]
        assert texts == (
            [f"r_shoulder_elev of {str(path)!r} goes from 179.5 to -179.5 degrees in one step, from 0.29 s "
             "on, which a spline follows; unwrap it"] if said else []
        )  # fmt: skip


def test_pages_show_degrees(tmp_path, arm):
    for head, values in ((["version=1", "inDegrees=yes"], DEGREES), (["version=1"], np.radians(DEGREES))):
        path = recording(tmp_path, ["walk", *head], values)
        table = angles_of(path, read_storage(path), arm.model)
        assert table.labels == NAMES
        np.testing.assert_allclose(table.values, DEGREES, atol=1e-6)


def test_a_table_of_commas_is_in_radians(tmp_path, arm):
    path = tmp_path / "walk.csv"
    rows = [",".join(f"{x:.9g}" for x in (k / RATE, *np.radians(row))) for k, row in enumerate(DEGREES)]
    path.write_text("\n".join([",".join(("time", *NAMES)), *rows]) + "\n")
    np.testing.assert_allclose(read_motion(path, arm).values, np.radians(DEGREES), atol=1e-6)
    rows = [",".join(f"{x:.9g}" for x in (k / RATE, *row)) for k, row in enumerate(DEGREES)]
    path.write_text("\n".join([",".join(("time", *NAMES)), *rows]) + "\n")
    with pytest.raises(ValueError, match=r"a \.mot or \.sto file says which"):
        read_motion(path, arm)


def test_moments_of_a_spreadsheet(tmp_path):
    """Tabs behind the lines of the header made 1770 N m of 1.79; those of OpenSim 4.6's inverse dynamics."""
    head = ["walk\t\t", "version=1\t\t", f"nRows={ROWS}\t\t", "nColumns=3\t\t", "inDegrees=yes\t\t"]
    wave = np.sin(2.0 * np.pi * np.arange(ROWS) / RATE)
    path = recording(tmp_path, head, np.stack([10.0 + 10.0 * wave, 40.0 + 20.0 * wave], axis=1))
    Dynamics(ARM, motion=path, output=tmp_path / "out")()
    found = read_storage(tmp_path / "out/moments.sto").values[[10, 30, 45]]
    theirs = [[1.78990678, 1.50756974], [1.40872827, 1.01560056], [2.28238741, 1.83371413]]
    np.testing.assert_allclose(found, theirs, atol=1e-6)
