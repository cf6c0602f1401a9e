"""Files of markers and loads: what is written is read, files of others, and what is refused."""

import re

import numpy as np
import pytest
import reader_cases as cases

from myowarp.motion.loads import loads_at, read_loads
from myowarp.motion.markers import Markers, read_trc, write_trc
from myowarp.motion.storage import Storage, write_storage

TRC = """PathFileType\t4\t(X/Y/Z)\ta.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
100\t100\t3\t2\tmm\t100\t1\t3
Frame#\tTime\tHEEL\t\t\tTOE\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

1\t0.00\t1000\t20\t-30\t4\t5\t6
2\t0.01\t1001\t21\t-31\t\t\t
3\t0.02\t1002\t22\t-32\t7\t8\t9\t
"""


def written(folder, text, name="a.trc"):
    path = folder / name
    path.write_text(text)
    return path


def test_a_file_of_others(tmp_path):
    """Millimetres become metres, an empty cell is a gap, and tabs at the end of a line do not matter."""
    markers = read_trc(written(tmp_path, TRC))
    assert markers.names == ("HEEL", "TOE")
    np.testing.assert_allclose(markers.positions[2], [[1.002, 0.022, -0.032], [0.007, 0.008, 0.009]])
    assert np.isnan(markers.positions[1, 1]).all()
    assert markers.gaps() == {"TOE": [(0.01, 0.01)]}
    assert len(markers.between(0.01, 0.02).time) == 2


def test_what_is_written_is_read(tmp_path):
    random = np.random.default_rng(0)
    positions = random.normal(size=(7, 3, 3))
    positions[2:4, 1] = np.nan
    write_trc(tmp_path / "b.trc", Markers(("A", "B", "C"), np.arange(7) / 120, positions))
    back = read_trc(tmp_path / "b.trc")
    np.testing.assert_allclose(back.positions, positions, atol=1e-9)
    np.testing.assert_allclose(back.time, np.arange(7) / 120, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("\tmm\t", "\tinch\t"), "has the unit 'inch'; known are mm"),
        (("TOE", "HEEL"), "has the marker 'HEEL' twice"),
        (("0.02", "0.01"), "must differ; those of frames 2 and 3 are both 0.01 s"),
        (("0.02", ""), "must hold finite numbers .* frame 3 has nan in column 'time'"),
        (("1001", "one"), "frame 2 of .* has a cell that is no number: 'one' in column 'HEEL X'"),
        (("1001", "10_01"), "frame 2 of .* has a cell that is no number: '10_01' in column 'HEEL X'"),
        (("1001", "\u0661"), "frame 2 of .* has a cell that is no number: '\u0661' in column 'HEEL X'"),
        (("1001", "1e30"), "finite numbers below 1e.15 in size; frame 2 has 1e.30 in column 'HEEL X'"),
        (
            ("7\t8\t9", "7\t8\t9\t10"),
            "frame 3 of .* must have 8 cells for 2 markers, separated by tabs, got 9",
        ),
        (
            ("\t7\t8\t9\t", "\t7\t8"),
            "frame 3 of .* must have 8 cells for 2 markers, separated by tabs, got 7",
        ),
        (("1\t0.00\t1000\t20\t-30\t4", "1 0.00 1000 20 -30 4"), "frame 1 of .* separated by tabs, got 3"),
        (("3\t2\tmm", "3\t5\tmm"), "says NumMarkers=5 and has 2 markers; restore what is missing"),
        (("0.02", "0.01000001"), "1e-07 s apart at least; those of frames 2 and 3 are 1e-08 s apart"),
        (("PathFileType", "Path"), "must begin with 'PathFileType'"),
        (("HEEL\t\t\tTOE\t\t", ""), "names no marker in line 4"),
    ],
)
def test_bad_markers_are_refused(tmp_path, change, message):
    assert change[0] in TRC
    with pytest.raises(ValueError, match=message):
        read_trc(written(tmp_path, TRC.replace(*change)))


def test_other_files_are_refused(tmp_path):
    (tmp_path / "a.trc").write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match="is no text file"):
        read_trc(tmp_path / "a.trc")
    empty = "\n".join(TRC.splitlines()[:6]) + "\n"
    with pytest.raises(ValueError, match="must have at least one frame of numbers"):
        read_trc(written(tmp_path, empty))
    with pytest.raises(ValueError, match="no frame between 3 and 4 s"):
        read_trc(written(tmp_path, TRC)).between(3.0, 4.0)


LOADS = """<?xml version="1.0"?><OpenSimDocument Version="40000"><ExternalLoads name="l"><objects>
<ExternalForce name="right"><applied_to_body>calcn_r</applied_to_body>
<force_expressed_in_body>ground</force_expressed_in_body>
<point_expressed_in_body>ground</point_expressed_in_body>
<force_identifier>f_v</force_identifier><point_identifier>f_p</point_identifier></ExternalForce>
<ExternalForce name="left"><isDisabled>true</isDisabled>
<applied_to_body>calcn_l</applied_to_body></ExternalForce>
</objects><datafile>forces.mot</datafile></ExternalLoads></OpenSimDocument>"""


@pytest.fixture
def loads(tmp_path):
    time = np.linspace(0.0, 1.0, 51)
    values = np.stack([np.polyval([k, 1.0], time) for k in range(6)], axis=1)
    labels = tuple(f"f_{part}{axis}" for part in "vp" for axis in "xyz")
    write_storage(tmp_path / "forces.mot", "forces", Storage(labels, time, values))
    return written(tmp_path, LOADS, "loads.xml")


def test_loads_between_the_rows(loads):
    """A spline goes through straight lines; a load that is off is left out."""
    times = np.array([0.003, 0.5, 0.997])
    (load,) = loads_at(loads, times)
    assert (load.body, load.force_frame, load.point_frame) == ("calcn_r", "ground", "ground")
    np.testing.assert_allclose(load.force, 1.0 + times[:, None] * [0, 1, 2], atol=1e-8)
    np.testing.assert_allclose(load.point, 1.0 + times[:, None] * [3, 4, 5], atol=1e-8)
    assert not load.torque.any()


def test_bad_loads_are_refused(loads, tmp_path):
    with pytest.raises(ValueError, match="is recorded from 0 to 1 s; the motion is from 0 to 2 s"):
        loads_at(loads, np.array([0.0, 2.0]))
    text = loads.read_text()
    with pytest.raises(ValueError, match="needs the column 'g_vx'; the recording has f_vx"):
        loads_at(written(tmp_path, text.replace(">f_v<", ">g_v<"), "c.xml"), np.zeros(1))
    with pytest.raises(ValueError, match=re.escape("names no <datafile>")):
        loads_at(written(tmp_path, text.replace("forces.mot", ""), "d.xml"), np.zeros(1))
    with pytest.raises(ValueError, match="says not on which body it acts"):
        read_loads(written(tmp_path, text.replace("calcn_r", ""), "e.xml"))
    with pytest.raises(ValueError, match="holds no <ExternalLoads>"):
        read_loads(written(tmp_path, '<OpenSimDocument Version="40000"></OpenSimDocument>', "f.xml"))


def test_markers_at_the_origin_are_unseen(tmp_path, caplog):
    """No camera gives exactly 0 0 0; exporters do where nothing was seen."""
    text = TRC.replace("2\t0.01\t1001\t21\t-31\t\t\t", "2\t0.01\t1001\t21\t-31\t0\t0.00\t-0")
    assert read_trc(written(tmp_path, text)).gaps() == {"TOE": [(0.01, 0.01)]}
    (said,) = (record.getMessage() for record in caplog.records)
    assert said.endswith("a.trc: markers at exactly 0 0 0 count as not seen, first TOE at 0.01 s")
    caplog.clear()
    text = TRC.replace("\t4\t5\t6", "\t0\t0\t6")
    assert read_trc(written(tmp_path, text)).gaps() == {"TOE": [(0.01, 0.01)]}
    assert not caplog.records


SECOND = "2\t0.01\t1001\t21\t-31\t\t\t\n"


def test_rows_without_tabs_at_the_end(tmp_path):
    """What an editor strips, markers at the end that were not seen, may be left out."""
    stripped = read_trc(written(tmp_path, TRC.replace(SECOND, SECOND.rstrip() + "\n")))
    np.testing.assert_array_equal(stripped.positions, read_trc(written(tmp_path, TRC, "b.trc")).positions)


@pytest.mark.parametrize(("row", "message"), [
    ("2\t0.01\t1001\t21\t-31\t4\t5\n", r"frame 2 of .* must have 8 cells for 2 markers, .* got 7"),
    ("2\t0.01\t1001\t21\t-31\t4\t5\t\n", r"frame 2 of .* a part of the coordinates of marker 'TOE'; it must"),
    ("2\t0.01\t21\t-31\t4\t5\t6\t\n", r"frame 2 of .* a part of the coordinates of marker 'TOE'"),
    ("2\t0.01\t1001\t\t-31\t4\t5\t6\n", r"frame 2 of .* a part of the coordinates of marker 'HEEL'"),
    ("2\t0.01\t1001\t21\t-31\t\n", r"frame 2 of .* must have 8 cells for 2 markers, .* got 6"),
])  # fmt: skip
def test_rows_with_a_cell_less_are_refused(tmp_path, row, message):
    """Its neighbours would be taken for it."""
    with pytest.raises(ValueError, match=message):
        read_trc(written(tmp_path, TRC.replace(SECOND, row)))


def test_a_file_that_ends_in_a_row_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"frame 2 of .* must have 8 cells for 2 markers, .* got 5"):
        read_trc(written(tmp_path, TRC[: TRC.index(SECOND)] + SECOND.rstrip()))


def test_numbers_of_frames_that_do_not_match_are_said(tmp_path, caplog):
    """OpenSim's kinematics reads the frames that are there."""
    assert len(read_trc(written(tmp_path, TRC.replace("100\t3\t2", "100\t5\t2"))).time) == 3
    (said,) = (record.getMessage() for record in caplog.records)
    assert said.endswith("a.trc' says NumFrames=5 and has 3 frames")


def test_a_file_that_ends_in_a_number_is_said(tmp_path, caplog):
    """Where all numbers above have more digits."""
    rows = "1\t0.00\t1\t2\t3\t4\t5\t6.25\n2\t0.01\t1\t2\t3\t4\t5\t57.30\n3\t0.02\t1\t2\t3\t4\t5\t"
    text = "\n".join([*TRC.splitlines()[:6], rows])
    for last in ("57.30\n", "57.3\n", "57.30"):
        read_trc(written(tmp_path, text + last))
    assert not caplog.records
    for last in ("57.3", "57.", "5"):
        read_trc(written(tmp_path, text + last))
        assert "ends without a line break, and its last number has fewer digits" in caplog.text
        caplog.clear()


@pytest.mark.parametrize(
    ("rate", "said"),
    [("200", "and its times are at 100 Hz; the times count"), ("110", ""), ("none", ""), ("1e5", "100 Hz")],
)
def test_a_rate_that_is_not_that_of_the_times_is_said(tmp_path, caplog, rate, said):
    path = written(tmp_path, TRC.replace("100\t100\t3", f"{rate}\t100\t3"))
    assert read_trc(path).time.tolist() == [0.0, 0.01, 0.02]
    assert len(caplog.messages) == bool(said)
    assert said in caplog.text
    assert not said or caplog.text.count(f"{str(path)!r} says DataRate={rate}") == 1


def test_latin_1(tmp_path):
    path = tmp_path / "a.trc"
    path.write_bytes(TRC.replace("HEEL", "Kn\u00f6chel").encode("latin-1"))
    assert read_trc(path).names == ("Kn\u00f6chel", "TOE")


def test_rows_are_written_as_opensim_reads_them(tmp_path):
    """It wants one more tab where the last marker was not seen, as in this file, which `readers.json` has."""
    path = tmp_path / "walk.trc"
    path.write_text(cases.MARKERS)
    write_trc(tmp_path / "again.trc", read_trc(path))
    read, again = (file.read_text().split("\n")[6:] for file in (path, tmp_path / "again.trc"))
    assert [row.count("\t") for row in again] == [row.count("\t") for row in read]
    assert again[2].endswith("\t\t\t\t")
