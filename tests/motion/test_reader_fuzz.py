"""Wrong recordings, set-ups and tables: read as they are written and as OpenSim reads them, or refused.

2,000 files, each with one or two things wrong (`reader_cases`). What is read has the numbers of the file, and
is what OpenSim 4.6 reads where it reads the file at all (`readers.json`, by `record_opensim_readers.py`).
"""

import csv
import io
import json
import logging
import math
import re
import time
from pathlib import Path

import numpy as np
import reader_cases as cases

from myowarp.apps.studies.motion.plan import NUMBERS, plan_study
from myowarp.motion.loads import read_loads
from myowarp.motion.markers import MarkerStream, read_trc
from myowarp.motion.scaling import read_setup
from myowarp.motion.storage import read_storage
from myowarp.motion.streams import Margin, Stream
from myowarp.motion.tasks import tasks_of
from myowarp.motion.tool_setup import read_tool_setup
from myowarp.osim.document.read.element import parse

THEIRS = json.loads((Path(__file__).parents[1] / "data/opensim/readers.json").read_text())
SLOWEST = 5.0
"""s of processor time of one file."""
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def outcome(read, path, named=True):
    """Return what is read; None where it is refused in one sentence, which names the file or its row."""
    begin, fault, found = time.process_time(), "", None
    try:
        found = read(path)
    except (ValueError, OSError) as error:
        fault = str(error)
    assert "\n" not in fault
    assert not fault or path.name in fault or not named
    assert time.process_time() - begin < SLOWEST
    return found


def written(text, name):
    """Return the rows of a recording as they are written, in the order of times, NaN for empty cells."""
    lines = text.replace("\r\n", "\n").split("\n")
    if name.endswith(".trc"):
        rows = [line.split("\t")[1:] for line in lines[5:] if line.strip()]
    else:
        head = [line.split("=")[0].split() for line in lines]
        first = next(k for k, words in enumerate(head) if words and words[0].lower() == "endheader")
        rows = [line.split() for line in lines[first + 1 :] if line.strip()][1:]
    most = max(map(len, rows))
    cells = [[cell.strip() for cell in row] + [""] * (most - len(row)) for row in rows]
    assert all(NUMBER.fullmatch(cell) or cell.lower() in ("", "nan") for row in cells for cell in row)
    found = np.array([[float(cell or "nan") for cell in row] for row in cells])
    return once(found)


def once(rows):
    """Return rows in the order of times; one that says the same as the row before is left out."""
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    same = (rows[1:] == rows[:-1]) | (np.isnan(rows[1:]) & np.isnan(rows[:-1]))
    return rows[np.concatenate([[True], ~same.all(axis=1)])]


def table_of(path):
    """Return head and rows of a recording; of markers in the file's unit."""
    if path.suffix == ".trc":
        found = read_trc(path)
        unit = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[
            path.read_text(encoding="utf-8").split("\n")[2].split()[4].lower()
        ]
        return [list(found.names)], np.column_stack(
            [found.time, found.positions.reshape(len(found.time), -1) / unit]
        )
    found = read_storage(path)
    return [found.in_degrees, ["time", *found.labels]], np.column_stack([found.time, found.values])


def in_parts(path):
    """Return the rows of a recording as long ones are read; of markers in the file's unit."""
    with (MarkerStream if path.suffix == ".trc" else Stream)(path) as stream:
        stream.count()
        ((table, _),) = stream.parts(Margin())
    return np.column_stack([table.time, table.values])


def test_recordings(tmp_path, caplog):
    """What OpenSim reads otherwise is named: its slips, a few. Long files are those that are in order."""
    caplog.set_level(logging.ERROR)
    counts = dict.fromkeys(("same", "refused", "alone", "slips", "sorted"), 0)
    for name, text in cases.recordings():
        path = tmp_path / name
        path.write_text(text, encoding="utf-8", newline="")
        ours, long = outcome(table_of, path), outcome(in_parts, path)
        if ours is None:
            assert long is None, name
            counts["refused"] += 1
            continue
        head, rows = ours
        if long is None:
            counts["sorted"] += 1
        else:
            np.testing.assert_allclose(rows, np.where(rows == rows, long, np.nan), rtol=1e-12, err_msg=name)
        wanted = written(text, name)
        np.testing.assert_allclose(rows, wanted[:, : rows.shape[1]], rtol=1e-12, atol=1e-12, err_msg=name)
        assert np.isnan(wanted[:, rows.shape[1] :]).all(), name
        theirs = THEIRS["recordings"][name]
        if theirs is None:
            counts["alone"] += 1
            continue
        *there, numbers = THEIRS["right"][theirs] if isinstance(theirs, str) else theirs
        if len(numbers) < len(rows):
            # Of a file of version 1 without nRows, nothing; of others what is before an empty line.
            assert "\n\n" in text or not re.search(r"^(nRows=|datarows )\d", text, re.MULTILINE), name
            counts["slips"] += 1
        elif head != there:
            assert any(" " in label for label in head[-1]), name  # a name with a blank is two there
            counts["slips"] += 1
        else:
            found = once(np.array(numbers, dtype=float))
            np.testing.assert_allclose(rows, found, rtol=1e-12, atol=1e-9, equal_nan=True, err_msg=name)
            counts["same"] += 1
    assert sum(counts.values()) == 1500 + counts["sorted"]
    assert counts["sorted"] < 150
    assert counts["same"] > 500
    assert counts["slips"] < 40


def name_of(path, folder):
    """Return a path as a set-up file has it; empty for none."""
    return "" if path is None else path.as_posix().removeprefix(f"{folder.as_posix()}/")


def said_of(path):
    """Return what a set-up file says, as `readers.json` has it; None where a time is open."""
    kind, folder = path.name.lstrip("0123456789"), path.parent
    if kind == "loads.xml":
        found, file = read_loads(path)
        return [
            name_of(file, folder),
            [
                [one.name, True, one.body, one.force, one.point, one.torque, one.force_frame, one.point_frame]
                for one in found
            ],
        ]
    if kind == "scaling.xml":
        setup = read_setup(path)
        times = [x if math.isfinite(x) else None for x in (*setup.span, *setup.pose_span)]
        files = name_of(setup.static, folder), name_of(setup.pose, folder)
        return [setup.mass or -1.0, list(setup.order), *files, times, setup.keep_masses]
    setup = read_tool_setup(path)
    times = [x if math.isfinite(x) else None for x in setup.span or (-math.inf, math.inf)]
    if kind == "kinematics.xml":
        weights = tasks_of(parse(path)[0]).markers
        return [name_of(setup.markers, folder), name_of(setup.coordinates, folder), *times, weights]
    return [name_of(setup.motion, folder), name_of(setup.loads, folder), *times, setup.cutoff or -1.0]


def plain(theirs, kind):
    """Return what OpenSim says of a set-up file in the words of `said_of`."""
    if isinstance(theirs, list):
        theirs = [plain(one, "") for one in theirs]
    if kind == "scaling.xml":
        mass, order, *files, times, on, _, keeps = theirs
        return [mass if mass > 0 else -1.0, order if on else [], *files, times, keeps]
    if kind in ("dynamics.xml", "analysis.xml"):
        return [*theirs[:-1], theirs[-1] if theirs[-1] > 0.0 else -1.0]
    if kind == "loads.xml":
        file, forces = theirs
        # Without a frame OpenSim ends; the default is ground.
        return [file, [[*one[:6], *(frame or "ground" for frame in one[6:])] for one in forces if one[1]]]
    return "" if theirs == "Unassigned" else theirs


def test_set_up_files(tmp_path):
    counts = dict.fromkeys(("same", "refused", "alone", "slips"), 0)
    for name, text in (*cases.SETUPS.items(), *cases.setups()):
        path, kind = tmp_path / name, name.lstrip("0123456789")
        path.write_text(text, encoding="utf-8", newline="")
        ours, theirs = outcome(said_of, path), THEIRS["setups"][name]
        if ours is None or theirs is None:
            counts["refused" if ours is None else "alone"] += 1
            continue
        there = plain(theirs, kind)
        if kind == "kinematics.xml" and there[2:4] == [None, 2.0]:
            there[3] = ours[3]  # by a slip, OpenSim 4.6 ends at 2 s where no time is stated
        if "" in there[:1] and ours != there:
            assert f"<{kind}" not in text, name  # an element out of place, at which OpenSim reads no more
            counts["slips"] += 1
            continue
        assert ours == there, name
        counts["same"] += 1
    assert sum(counts.values()) == 305
    assert counts["same"] > 100
    assert counts["slips"] < 10


def test_tables_of_studies(tmp_path):
    """A number is the one that the cell has; an empty cell is none."""
    read = 0
    for number, text in enumerate(cases.tables()):
        path = tmp_path / f"{number}.csv"
        path.write_text(text, encoding="utf-8", newline="")
        study = outcome(plan_study, path, named=False)
        if study is None:
            continue
        read += 1
        delimiter = max(",;\t", key=text.split("\n")[0].count)
        header, *rows = (
            row
            for row in csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
            if any(map(str.strip, row))
        )
        for trial, row in zip(study.trials, rows, strict=True):
            cells = {name.strip(): cell.strip() for name, cell in zip(header, row, strict=True)}
            found = {**trial.numbers, **trial.factors, "mass_spread": trial.uncertain.mass}
            for name in (*NUMBERS, "max_isometric_force", "mass_spread"):
                if cell := cells.get(name, "").replace("nan", ""):
                    assert NUMBER.fullmatch(cell), (number, cell)
                    assert found[name] == float(cell)
                else:
                    assert not found.get(name)
    assert read > 60
