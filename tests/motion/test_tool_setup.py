"""Set-up files of OpenSim's tools, sets of markers, gaps and rows out of order, through `myowarp motion`."""

import logging
import re
from pathlib import Path

import numpy as np
import pytest

from myowarp.apps.cli.motion.dynamics import Dynamics
from myowarp.apps.cli.motion.forces import Forces
from myowarp.apps.cli.motion.kinematics import Kinematics
from myowarp.motion import streams
from myowarp.motion.markers import Markers, read_trc, write_trc
from myowarp.motion.movement import read_motion, write_angles
from myowarp.motion.setup import TrialSetup
from myowarp.motion.steps import dynamics, kinematics, moved_in_parts
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.motion.tool_setup import read_tool_setup
from myowarp.osim.body.skeleton import Bones

DATA = Path(__file__).parents[1] / "data"
GAIT, LEG = (DATA / "osim" / f"{name}.osim" for name in ("gait10dof18musc", "leg6dof9musc"))
LOADS = """<OpenSimDocument Version="40000"><ExternalLoads name="l"><objects><ExternalForce name="push">
<applied_to_body>calcn_r</applied_to_body><force_identifier>f</force_identifier>
<point_identifier>p</point_identifier></ExternalForce></objects><datafile>push.mot</datafile></ExternalLoads>
</OpenSimDocument>"""
DYNAMICS = """<OpenSimDocument Version="20302"><InverseDynamicsTool name="d">
<time_range> 0.2 0.8 </time_range>
<external_loads_file> push.xml </external_loads_file><coordinates_file> motion.mot </coordinates_file>
<lowpass_cutoff_frequency_for_coordinates> 6.0 </lowpass_cutoff_frequency_for_coordinates>
</InverseDynamicsTool></OpenSimDocument>"""
ANALYZE = """<OpenSimDocument Version="40000"><AnalyzeTool name="a"><force_set_files> r.xml </force_set_files>
<initial_time>0.3</initial_time><final_time>0.5</final_time><AnalysisSet><objects><StaticOptimization>
<activation_exponent>3</activation_exponent></StaticOptimization></objects></AnalysisSet>
<external_loads_file>push.xml</external_loads_file><coordinates_file>motion.mot</coordinates_file>
<lowpass_cutoff_frequency_for_coordinates>6</lowpass_cutoff_frequency_for_coordinates>
</AnalyzeTool></OpenSimDocument>"""
RESERVES = """<OpenSimDocument Version="40000"><ForceSet><objects>{}
<PointActuator name="FX"><body>pelvis</body></PointActuator></objects></ForceSet></OpenSimDocument>"""
RESERVE = """<CoordinateActuator name="{0}"><coordinate>{0}</coordinate><optimal_force>1000</optimal_force>
</CoordinateActuator>"""
KINEMATICS = """<OpenSimDocument Version="40000"><InverseKinematicsTool name="k"><IKTaskSet><objects>{}
<IKCoordinateTask name="knee_angle_r"><value_type>from_file</value_type><weight>1e6</weight>
</IKCoordinateTask>
</objects></IKTaskSet><marker_file>walk.trc</marker_file><coordinate_file>held.mot</coordinate_file>
</InverseKinematicsTool></OpenSimDocument>"""
MARKERS = """<OpenSimDocument Version="40000"><MarkerSet><objects><Marker name="{}">
<socket_parent_frame>/bodyset/{}</socket_parent_frame><location>{} {} {}</location></Marker></objects>
</MarkerSet></OpenSimDocument>"""


@pytest.fixture
def gait(tmp_path):
    """A folder with a motion, its loads at another rate, and set-up files."""
    there = np.load(DATA / "opensim/motion_gait10dof18musc.npz")
    bones = Bones.read(GAIT)
    write_angles(tmp_path / "motion.mot", bones.model, bones.coordinates, there["time"], there["values"])
    labels = tuple(part + axis for part in "fp" for axis in "xyz")
    table = Storage(labels, there["time"], np.hstack([there["force"], there["point"]]))
    write_storage(tmp_path / "push.mot", "push", table)
    (tmp_path / "push.xml").write_text(LOADS)
    (tmp_path / "id.xml").write_text(DYNAMICS)
    (tmp_path / "so.xml").write_text(ANALYZE)
    (tmp_path / "r.xml").write_text(RESERVES.format("".join(map(RESERVE.format, bones.coordinates))))
    return tmp_path, there


def test_dynamics_of_a_set_up_file(gait):
    """Files, filter and times are the tool's; the moments those that OpenSim recorded. What is given wins."""
    folder, there = gait
    Dynamics(GAIT, setup=folder / "id.xml", output=folder / "out")()
    found = read_storage(folder / "out/moments.sto")
    kept = (there["time"] >= 0.2 - 1e-9) & (there["time"] <= 0.8 + 1e-9)
    np.testing.assert_allclose(found.time, there["time"][kept], atol=1e-8)
    scale = np.abs(there["moments"]).max()
    assert np.abs(found.values - there["moments"][kept]).max() < 1e-5 * scale
    Dynamics(GAIT, setup=folder / "id.xml", filter=2.0, output=folder / "slow")()
    other = read_storage(folder / "slow/moments.sto").values
    assert np.abs(other - found.values).max() > 1e-3 * scale


def test_forces_of_a_set_up_file(gait, capsys):
    """Its exponent and its actuators of coordinates count; others are named."""
    folder, _ = gait
    said = read_tool_setup(folder / "so.xml")
    assert (said.exponent, said.span, said.cutoff) == (3.0, (0.3, 0.5), 6.0)
    Forces(GAIT, setup=folder / "so.xml", output=folder / "out")()
    assert "left out of" in (err := capsys.readouterr().err)
    assert "PointActuator FX" in err
    assert np.abs(read_storage(folder / "out/missing.sto").values).max() < 1e-2, "N or N m"
    options = {
        "motion": folder / "motion.mot",
        "loads": folder / "push.xml",
        "filter": 6.0,
        "span": (0.3, 0.5),
    }
    Forces(GAIT, **options, exponent=3.0, reserve=1000.0, output=folder / "same")()
    Forces(GAIT, **options, exponent=2.0, reserve=1000.0, output=folder / "square")()
    cubic, same, square = (
        read_storage(folder / k / "activations.sto").values for k in ("out", "same", "square")
    )
    np.testing.assert_allclose(cubic, same, atol=1e-8)
    assert np.abs(square - cubic).max() > 0.01


def test_unequal_rates(gait):
    """Loads at a sixth of the step, between the motion's frames, on a spline: the same moments."""
    folder, there = gait
    from scipy.interpolate import CubicSpline

    fine = np.linspace(there["time"][0], there["time"][-1], 6 * (len(there["time"]) - 1) + 1)
    whole = np.hstack([there["force"], there["point"]])
    Dynamics(GAIT, setup=folder / "id.xml", output=folder / "out")()
    labels = tuple(part + axis for part in "fp" for axis in "xyz")
    write_storage(folder / "push.mot", "push", Storage(labels, fine, CubicSpline(there["time"], whole)(fine)))
    Dynamics(GAIT, setup=folder / "id.xml", output=folder / "fine")()
    ours, finer = (read_storage(folder / k / "moments.sto").values for k in ("out", "fine"))
    np.testing.assert_allclose(finer, ours, atol=1e-3)


@pytest.fixture
def leg(tmp_path):
    """Markers with gaps, rows out of order."""
    there = np.load(DATA / "opensim/motion_leg6dof9musc.npz")
    names = tuple(map(str, there["markers"]))
    seen = there["seen"].copy()
    seen[10:13, 0] = seen[20:45, 1] = seen[:4, 2] = np.nan
    write_trc(tmp_path / "walk.trc", Markers(names, there["time"], seen))
    return tmp_path, there, names


def test_gaps_are_listed_and_filled_up_to_a_length(leg, capsys):
    folder, there, names = leg
    recorded = read_trc(folder / "walk.trc")
    filled = recorded.filled(0.1)
    off = np.linalg.norm(filled.positions[10:13, 0] - there["seen"][10:13, 0], axis=1)
    assert off.max() < 0.01, "noise of 2 mm, and a spline"
    assert np.isnan(filled.positions[20:45, 1]).all(), "too long"
    assert np.isnan(filled.positions[:4, 2]).all(), "no end"
    np.testing.assert_array_equal(np.isnan(recorded.filled(1.0).positions[20:45, 1]).any(), False)
    Kinematics(LEG, markers=folder / "walk.trc", fill=0.1, output=folder / "out")()
    rows = (folder / "out/gaps.csv").read_text().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == [names[1], names[2], names[0]], "the longest first"
    assert [row.split(",")[3] for row in rows] == ["no", "no", "yes"]
    said = capsys.readouterr().err
    assert f"{names[1]} was not seen from" in said
    assert "1 gaps were filled; gaps.csv lists all 3" in said
    for wrong in (-1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match=f"must be above 0 s and finite, got {wrong:g} s"):
            recorded.filled(wrong)


def test_names_with_commas(leg, capsys):
    """A gap of a marker "a,b" is none that was filled."""
    folder, there, names = leg
    seen = there["seen"].copy()
    seen[20:45, 1] = np.nan
    names = (names[0], f"{names[1]},b", *names[2:])
    write_trc(folder / "walk.trc", Markers(names, there["time"], seen))
    Kinematics(LEG, markers=folder / "walk.trc", output=folder / "out")()
    assert f"{names[1]} was not seen from" in (said := capsys.readouterr().err)
    assert "filled" not in said


def test_a_spline_of_a_parabola_is_exact():
    """Natural cubic splines bridge a straight line exactly, and a parabola away from its ends."""
    time = np.linspace(0.0, 1.0, 101)
    line = np.stack([time, 2.0 - time, 0.0 * time], axis=1)[:, None]
    gone = line.copy()
    gone[40:60] = np.nan
    np.testing.assert_allclose(Markers(("A",), time, gone).filled(0.5).positions, line, atol=1e-12)
    bent = gone**2
    np.testing.assert_allclose(Markers(("A",), time, bent).filled(0.5).positions, line**2, atol=1e-5)


def test_rows_out_of_order_are_sorted(leg, caplog):
    folder, _, _ = leg
    lines = (folder / "walk.trc").read_text().splitlines()
    lines[8:30] = lines[8:30][::-1]
    (folder / "mixed.trc").write_text("\n".join(lines) + "\n")
    with caplog.at_level(logging.WARNING):
        mixed = read_trc(folder / "mixed.trc")
    np.testing.assert_array_equal(mixed.positions, read_trc(folder / "walk.trc").positions)
    assert "frames are not in the order of their times" in caplog.text


def test_kinematics_of_a_set_up_file(leg):
    """Markers beside it, and a knee that is held where a file has it."""
    folder, there, names = leg
    bones = Bones.read(LEG)
    held = np.tile(
        [bones.model.coordinates[name].default for name in bones.coordinates], (len(there["time"]), 1)
    )
    knee = bones.coordinates.index("knee_angle_r")
    held[:, knee] = -0.4 + 0.1 * np.sin(there["time"])
    write_angles(folder / "held.mot", bones.model, bones.coordinates, there["time"], held)
    tasks = "".join(f'<IKMarkerTask name="{name}"><weight>1</weight></IKMarkerTask>' for name in names)
    (folder / "ik.xml").write_text(KINEMATICS.format(tasks))
    Kinematics(LEG, setup=folder / "ik.xml", output=folder / "out")()
    found = read_motion(folder / "out/ik.mot", bones)
    np.testing.assert_allclose(found.values[:, knee], held[:, knee], atol=1e-4)
    assert np.abs(there["fitted"][:, knee] - held[:, knee]).max() > 0.01


def test_markers_over_milliseconds_are_doubted(leg, caplog):
    folder, there, names = leg
    write_trc(folder / "ms.trc", Markers(names, 1e3 * there["time"], there["seen"]))
    with caplog.at_level(logging.WARNING):
        kinematics(Bones.read(LEG), TrialSetup(markers=folder / "ms.trc"))
    assert re.search(r"'.*ms\.trc' lasts [\d.e+]+ s at 0\.\d+ Hz; is its time in ms", caplog.text)


@pytest.mark.parametrize(("weight", "refused"), [("1e6", True), ("0", False)])
def test_a_value_in_degrees_is_refused_where_it_counts(leg, weight, refused):
    folder, _, names = leg
    tasks = "".join(f'<IKMarkerTask name="{name}"><weight>1</weight></IKMarkerTask>' for name in names)
    text = KINEMATICS.format(tasks).replace(
        "from_file</value_type>", "manual_value</value_type><value>-30</value>"
    )
    (folder / "ik.xml").write_text(text.replace("<weight>1e6<", f"<weight>{weight}<"))
    bones, setup = Bones.read(LEG), read_tool_setup(folder / "ik.xml")
    if not refused:
        assert np.isfinite(kinematics(bones, setup).fitted.values).all()
        return
    with pytest.raises(
        ValueError, match="'knee_angle_r' should have the value -30, in radians -1719 degrees; a"
    ):
        kinematics(bones, setup)


@pytest.mark.parametrize(("tip", "said"), [(0.0, False), (25.0, False), (-70.0, True), (90.0, True)])
def test_a_model_that_lies_is_named(leg, caplog, tip, said):
    """Markers about another vertical axis fit as well: the root turns with them."""
    folder, there, names = leg
    c, s = np.cos(np.radians(tip)), np.sin(np.radians(tip))
    turned = there["seen"] @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    write_trc(folder / "tipped.trc", Markers(names, there["time"], turned))
    bones = Bones.read(LEG)
    with caplog.at_level(logging.WARNING):
        kinematics(bones, TrialSetup(markers=folder / "tipped.trc"))
    texts = [record.getMessage() for record in caplog.records if "tipped by" in record.getMessage()]
    tilt = np.degrees(there["fitted"][:, bones.coordinates.index("pelvis_tilt")])
    least = np.abs(tilt + tip - np.degrees(bones.model.coordinates["pelvis_tilt"].default)).min()
    sentence = "degrees at least, in every frame; check which axis of the recording is up, unless"
    assert [text.split(" by ")[0] for text in texts] == ["the pelvis is tipped"] * said
    for text in texts:
        assert sentence in text
        assert float(re.search(r"by (\d+)", text)[1]) == pytest.approx(least, abs=2.0)


@pytest.mark.parametrize(("prefix", "left"), [("walker:", 2), ("", 1)])
def test_markers_that_are_called_otherwise_are_named(leg, caplog, prefix, left):
    """Two of them, which then count in no pose; not a recording that only has fewer or more."""
    folder, there, names = leg
    called = tuple(prefix + name if number < 2 else name for number, name in enumerate(names))
    bones, kept = Bones.read(LEG), slice(0 if prefix else 1, None)
    write_trc(folder / "named.trc", Markers(called[kept], there["time"], there["seen"][:, kept]))
    with caplog.at_level(logging.WARNING):
        found = kinematics(bones, TrialSetup(markers=folder / "named.trc"))
    assert len(found.fitted.names) == len(names) - left
    said = [text for text in caplog.messages if "are not in the model" in text]
    assert len(said) == bool(prefix)
    for text in said:
        assert f"left out: {called[0]}, {called[1]}; the recording has no {names[0]}" in text


@pytest.mark.parametrize(("span", "said"), [
    ((0.5, 9.0), "of 0.5 to 9 s, the motion is only from 0 to 1 s"),
    ((-3.0, 0.5), "of -3 to 0.5 s, the motion is only from 0 to 1 s"),
    ((0.0, 1.01), ""), ((-np.inf, np.inf), ""), ((0.2, 0.8), ""),
])  # fmt: skip
def test_times_that_are_not_there_are_said(gait, monkeypatch, caplog, span, said):
    """Of a short motion and of a long one; a frame's breadth is nothing."""
    folder, there = gait
    assert (there["time"][0], there["time"][-1]) == (0.0, 1.0)
    bones, setup = Bones.read(GAIT), TrialSetup(motion=folder / "motion.mot", span=span)
    for rows in (streams.FRAMES, 16):
        monkeypatch.setattr(streams, "FRAMES", rows)
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            list(moved_in_parts(bones, setup))
        whose = "recording" if rows == 16 else "motion"
        expected = [said.replace("motion", whose)] if said else []
        assert [record.getMessage() for record in caplog.records] == expected


def test_a_set_of_markers(leg):
    """A marker that is elsewhere on its body is where the set says."""
    folder, there, names = leg
    bones = Bones.read(LEG)
    old = bones.model.markers[names[0]]
    (folder / "set.xml").write_text(
        MARKERS.format(names[0], old.body, *(old.location + np.array((0.05, 0.0, 0.0))))
    )
    write_trc(folder / "walk.trc", Markers(names, there["time"], there["seen"]))
    options = {"markers": folder / "walk.trc"}
    Kinematics(LEG, **options, output=folder / "as_is")()
    Kinematics(LEG, **options, marker_set=folder / "set.xml", output=folder / "moved")()
    as_is, moved = (read_storage(folder / k / "marker_errors.sto") for k in ("as_is", "moved"))
    own = moved.labels.index(names[0])
    assert moved.values[:, own].mean() > 3 * as_is.values[:, own].mean()
    (folder / "set.xml").write_text(MARKERS.format(names[0], "nose", 0, 0, 0))
    with pytest.raises(ValueError, match="is on the body 'nose', which the model does not have"):
        Kinematics(LEG, **options, marker_set=folder / "set.xml", output=folder / "nose")()


@pytest.mark.parametrize(("step", "tool", "message"), [
    (Forces, "InverseKinematicsTool", "OpenSim's InverseKinematicsTool; this step takes .*, AnalyzeTool"),
    (Dynamics, "InverseKinematicsTool", "OpenSim's InverseKinematicsTool; this step takes those of InverseD"),
    (Forces, "ScaleTool", "OpenSim's ScaleTool; .*, steps along a motion those of InverseDynamicsTool, Ana"),
    (Kinematics, "ScaleTool", "OpenSim's ScaleTool; kinematics takes those of InverseKinematicsTool"),
    (Kinematics, "CMCTool", "OpenSim's CMCTool; this step takes those of InverseKinematicsTool, IMU"),
    (Dynamics, "RRATool", "OpenSim's RRATool; .*, steps along a motion those of InverseDynamicsTool"),
])  # fmt: skip
def test_files_of_another_tool_are_refused(gait, step, tool, message):
    """Whose weights, times and filter were taken, or none of them, without a word."""
    folder, _ = gait
    tasks = '<IKTaskSet><objects><IKMarkerTask name="toe"/></objects></IKTaskSet>'
    (folder / "other.xml").write_text(
        f'<OpenSimDocument Version="40000"><{tool}><MarkerPlacer>{tasks}</MarkerPlacer>{tasks}</{tool}>'
        "</OpenSimDocument>"
    )
    source = {"markers": folder / "walk.trc"} if step is Kinematics else {"motion": folder / "motion.mot"}
    with pytest.raises(ValueError, match=message) as caught:
        step(GAIT, **source, setup=folder / "other.xml", output=folder / "out")()
    assert "\n" not in str(caught.value)
    assert not (folder / "out").exists()


def test_a_step_in_python_refuses_files_of_another_tool(gait):
    folder, _ = gait
    bones, path = Bones.read(GAIT), folder / "ik.xml"
    path.write_text(KINEMATICS.format('<IKMarkerTask name="toe"/>'))
    with pytest.raises(ValueError, match="is a set-up file of OpenSim's InverseKinematicsTool"):
        dynamics(bones, read_tool_setup(path).stating(motion=folder / "motion.mot"))
    with pytest.raises(ValueError, match="is a set-up file of OpenSim's InverseDynamicsTool"):
        kinematics(bones, read_tool_setup(folder / "id.xml").stating(markers=folder / "walk.trc"))


def test_what_a_set_up_file_comes_to_is_said(gait, capsys):
    """Times and filter of static optimisation, which dynamics takes, too; what an option states wins."""
    folder, _ = gait
    Dynamics(GAIT, setup=folder / "so.xml", output=folder / "out")()
    said = "With so.xml (AnalyzeTool): 0.3 to 0.5 s, a filter of 6 Hz, loads push.xml"
    assert said in capsys.readouterr().err
    time = read_storage(folder / "out/moments.sto").time
    assert (time[0], time[-1]) == pytest.approx((0.3, 0.5))
    Dynamics(GAIT, setup=folder / "so.xml", filter=3.0, span=(0.4, 0.5), output=folder / "own")()
    assert "0.4 to 0.5 s, a filter of 3 Hz, loads push.xml" in capsys.readouterr().err


@pytest.mark.parametrize(("option", "name"), [("motion", "motion.mot"), ("loads", "push.xml")])
def test_a_file_that_a_set_up_names_and_is_not_there_is_asked_for(gait, option, name):
    """What is given takes its place."""
    folder, _ = gait
    given = (folder / name).rename(folder / f"moved{Path(name).suffix}")
    with pytest.raises(ValueError, match=f"names '.*{name}', which is not there; give --{option} FILE$"):
        Dynamics(GAIT, setup=folder / "id.xml", output=folder / "out")()
    Dynamics(GAIT, **{option: given}, setup=folder / "id.xml", output=folder / "out")()
    assert (folder / "out/moments.sto").is_file()


def test_other_files_are_refused(gait):
    folder, _ = gait
    with pytest.raises(ValueError, match="holds none of <InverseKinematicsTool>") as caught:
        Dynamics(GAIT, setup=folder / "push.xml", output=folder / "out")()
    assert "\n" not in str(caught.value)
