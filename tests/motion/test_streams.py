"""Long files are read a part at a time: rows are those of the file, results those of the whole motion."""

from pathlib import Path

import numpy as np
import pytest

from myowarp.apps.cli.motion import analyze
from myowarp.apps.cli.motion.analyze import Analyze
from myowarp.apps.cli.motion.dynamics import Dynamics
from myowarp.apps.cli.motion.forces import Forces
from myowarp.apps.cli.motion.kinematics import Kinematics
from myowarp.motion import streams
from myowarp.motion.markers import Markers, write_trc
from myowarp.motion.movement import marker_places, write_angles
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.motion.streams import Margin, Stream
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.read.model import read_model

LEG = Path(__file__).parents[1] / "data/osim/leg6dof9musc.osim"
ROWS, SIZE, RATE = 700, 48, 100.0  # Hz
DIGITS = 2e-8
"""Of nine digits in files, share of the greatest value."""
LOADS = """<OpenSimDocument Version="40000"><ExternalLoads name="l"><objects><ExternalForce name="push">
<applied_to_body>pelvis</applied_to_body><force_identifier>f</force_identifier>
</ExternalForce></objects><datafile>push.mot</datafile></ExternalLoads></OpenSimDocument>"""


@pytest.fixture(autouse=True)
def short_parts(monkeypatch):
    monkeypatch.setattr(streams, "FRAMES", SIZE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a motion and a load at another rate."""
    folder, bones = tmp_path_factory.mktemp("long"), Bones(read_model(LEG))
    random = np.random.default_rng(0)
    time = np.arange(ROWS) / RATE
    waves = np.sin(time[:, None] * random.uniform(2.0, 6.0, len(bones.coordinates)))
    values = 0.1 * waves + 1e-3 * random.normal(size=waves.shape)
    write_angles(folder / "motion.mot", bones.model, bones.coordinates, time, values)
    fine = np.arange(3 * ROWS) / 250.0
    push = Storage(("fx", "fy", "fz"), fine, 50.0 * np.sin(fine[:, None] * [3.0, 4.0, 5.0]))
    write_storage(folder / "push.mot", "push", push)
    (folder / "push.xml").write_text(LOADS)
    return folder


def test_rows_are_those_of_the_file(folder):
    """Each once; and no more of them are kept than a part and its margins have."""
    margin = Margin(rows=10, seconds=0.2)
    with Stream(folder / "motion.mot") as stream:
        found = [(table.time[own], table.values[own], len(table.time)) for table, own in stream.parts(margin)]
    whole = read_storage(folder / "motion.mot")
    np.testing.assert_array_equal(np.concatenate([time for time, _, _ in found]), whole.time)
    np.testing.assert_array_equal(np.concatenate([rows for _, rows, _ in found]), whole.values)
    assert len(found) == -(-ROWS // SIZE)
    assert max(kept for _, _, kept in found) == SIZE + 2 * 20
    with Stream(folder / "push.mot") as stream:
        for begin in (0.0, 2.0, 2.5):
            part = stream.around(begin, begin + 0.4, rows=5)
            assert len(part.time) == 101 + (5 if begin == 0.0 else 10)
            assert part.time[0] <= begin
            assert part.time[-1] > begin + 0.4


@pytest.mark.parametrize(("what", "options"), [
    (Forces, {"loads": "push.xml", "mode": "opensim", "reserve": 100.0}), (Analyze, {}),
    (Dynamics, {"loads": "push.xml", "span": (1.0, 5.5)}),
])  # fmt: skip
def test_results_are_those_of_the_whole_motion(folder, tmp_path, monkeypatch, capsys, what, options):
    monkeypatch.setattr(analyze, "page_of", lambda *rest: [])
    options = options | ({"loads": folder / options["loads"]} if "loads" in options else {})
    options |= {"motion": folder / "motion.mot", "filter": 6.0}
    what(LEG, **options, output=tmp_path / "parts")()
    said = capsys.readouterr().err
    monkeypatch.setattr(streams, "FRAMES", ROWS)
    what(LEG, **options, output=tmp_path / "whole")()
    files = sorted(path.name for path in (tmp_path / "whole").iterdir())
    assert files == sorted(path.name for path in (tmp_path / "parts").iterdir())
    for name in files:
        parts, whole = (read_storage(tmp_path / part / name) for part in ("parts", "whole"))
        assert parts.labels == whole.labels
        np.testing.assert_array_equal(parts.time, whole.time)
        scale = max(np.abs(whole.values).max(), 1e-3)
        np.testing.assert_allclose(parts.values, whole.values, atol=DIGITS * scale, err_msg=name)
        head = (tmp_path / "parts" / name).read_text().splitlines()[:4]
        assert head == (tmp_path / "whole" / name).read_text().splitlines()[:4]
    if what is not Analyze:
        assert said.splitlines()[:-1] == capsys.readouterr().err.splitlines()[:-1]


@pytest.mark.parametrize(("fill", "span"), [(None, None), (0.05, (0.5, 3.0))])
def test_angles_are_those_of_all_markers(folder, tmp_path, monkeypatch, capsys, fill, span):
    """A gap goes over two parts, and another from one part into the next but one; a short one is bridged."""
    bones = Bones(read_model(LEG))
    time = np.arange(400) / RATE
    waves = np.sin(time[:, None] * np.random.default_rng(1).uniform(2.0, 5.0, len(bones.coordinates)))
    markers = marker_places(bones, time, 0.1 * waves)
    seen = markers.positions.copy()
    seen[94:98, 0] = np.nan
    seen[140:250, 1] = np.nan
    write_trc(tmp_path / "walk.trc", Markers(markers.names, time, seen))
    options = {"markers": tmp_path / "walk.trc", "fill": fill, "span": span}
    Kinematics(LEG, **options, output=tmp_path / "parts")()
    said = capsys.readouterr().err
    monkeypatch.setattr(streams, "FRAMES", ROWS)
    Kinematics(LEG, **options, output=tmp_path / "whole")()
    assert said.splitlines()[:-1] == capsys.readouterr().err.splitlines()[:-1]
    for name, off in (("ik.mot", 1e-4), ("marker_errors.sto", 1e-7)):
        parts, whole = (read_storage(tmp_path / part / name, gaps=True) for part in ("parts", "whole"))
        np.testing.assert_array_equal(parts.time, whole.time)
        np.testing.assert_allclose(parts.values, whole.values, atol=off)
    gaps = (tmp_path / "parts/gaps.csv").read_text()
    assert gaps == (tmp_path / "whole/gaps.csv").read_text()
    assert f"{markers.names[1]},1.4,2.49,no" in gaps
    assert f"{markers.names[0]},0.94,0.97,{'no' if fill is None else 'yes'}" in gaps


FILE = (
    "\n".join(
        ["a", "nRows=200", "endheader", "time\ta\tb", *(f"{0.01 * k:.2f}\t1.0\t2.0" for k in range(200))]
    )
    + "\n"
)
HALF = "\n0.60\t1.0\t2.0"


@pytest.mark.parametrize(("old", "new", "message"), [
    (HALF, "\n0.60\t1.0", "row 61 of .* must have 3 cells, got 2"),
    (HALF, "\n0.60\tx\tx", "row 61 of .* has a cell that is no number: 'x' in column 'a'"),
    (HALF, "\nabc\t1.0\t2.0", "row 61 of .* has a cell that is no number: 'abc' in column 'time'"),
    (HALF, "\n0.60\t1_0\t2.0", "row 61 of .* has a cell that is no number: '1_0' in column 'a'"),
    (HALF, "\n0.60\t\u0663\t2.0", "row 61 of .* has a cell that is no number: '\u0663' in column 'a'"),
    (HALF, "\n0.60\t\t2.0", "row 61 of .* has an empty cell in column 'a'"),
    (HALF, "\n0.60\tnan\t1.0", "must hold finite numbers below 1e.15 in size; row 61 has nan in column 'a'"),
    (HALF, "\n0.60\t1e30\t1.0", "finite numbers below 1e.15 in size; row 61 has 1e.30 in column 'a'"),
    (HALF, "\n0.59\t1.0\t1.0", "must differ; those of rows 60 and 61 are both 0.59 s"),
    (HALF, "\n0.59000001\t1.0\t1.0", "1e-07 s apart at least; those of rows 60 and 61 are 1e-08 s apart"),
    (HALF, HALF + HALF.replace("0.60", "0.605"), "says nRows=200 and has 201 rows; restore what is missing"),
    (HALF, "", "says nRows=200 and has 199 rows; restore what is missing, or correct its header"),
    ("time\ta\tb", "time\ta\ta", "has the column 'a' twice"),
    ("time\ta\tb", "frame\ta\tb", "must have a first column 'time', and at least one more"),
    ("endheader", "header", "has no line 'endheader'; a .sto or .mot file needs one"),
    ("a\nnRows", "a\0\nnRows", "is no text file in UTF-8 or Latin-1"),
    ("nRows=200", "nColumns=4", "says nColumns=4 and has 3 columns"),
])  # fmt: skip
def test_bad_files_are_one_sentence_the_same_for_long_and_short_ones(tmp_path, old, new, message):
    path, said = tmp_path / "a.sto", []
    assert FILE.count(old) == 1
    path.write_text(FILE.replace(old, new), encoding="utf-8")

    def parts():
        with Stream(path) as stream:
            stream.count((0.0, 0.1))
            return list(stream.parts(Margin(rows=0)))

    for read in (lambda: read_storage(path), parts):
        with pytest.raises(ValueError, match=message) as caught:
            read()
        assert "\n" not in str(caught.value)
        said.append(str(caught.value))
    assert said[0] == said[1]


def test_long_files_are_not_sorted(tmp_path):
    (tmp_path / "a.sto").write_text(FILE.replace(HALF, "\n0.30\t1.0\t2.0").replace("\n0.30", "\n0.305", 1))
    with (
        Stream(tmp_path / "a.sto") as stream,
        pytest.raises(
            ValueError, match=r"rows 60 and 61 of .* must be in the order of their times; sort the file"
        ),
    ):
        list(stream.parts(Margin(rows=0)))


@pytest.mark.parametrize("text", ["B\u00e4r", "B\u00e4r\t\t"])
@pytest.mark.parametrize("encoding", ["latin-1", "utf-8", "utf-8-sig"])
def test_letters_of_both_encodings(tmp_path, text, encoding):
    """In the header and in names, as in models."""
    (tmp_path / "a.sto").write_bytes(
        FILE.replace("a\n", f"{text}\n", 1).replace("\tb\n", "\t\u00fc\n").encode(encoding)
    )
    with Stream(tmp_path / "a.sto") as stream:
        ((part, _), *_) = stream.parts(Margin(rows=0))
    whole = read_storage(tmp_path / "a.sto")
    assert part.labels == whole.labels == ("a", "\u00fc")


@pytest.mark.parametrize(("cutoff", "message"), [
    (0.0, "must be at least 0.005 and below 50 Hz, half of the rate, got 0"), (np.nan, "got nan"),
    (1e-300, "got 1e-300"), (-1.0, "got -1"), (np.inf, "got inf"), (60.0, "below 50 Hz"),
])  # fmt: skip
def test_filters_of_long_files(folder, tmp_path, monkeypatch, cutoff, message):
    said = []
    for size in (SIZE, ROWS):
        monkeypatch.setattr(streams, "FRAMES", size)
        with pytest.raises(ValueError, match=message) as caught:
            Dynamics(LEG, motion=folder / "motion.mot", filter=cutoff, output=tmp_path / "out")()
        said.append(str(caught.value))
    assert said[0] == said[1]
