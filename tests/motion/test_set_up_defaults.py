"""Set-ups as OpenSim's tools and OpenCap write them where nothing is stated, and what OpenSim does then."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from myowarp.apps.cli.motion.dynamics import Dynamics
from myowarp.motion.loads import loads_at, read_loads
from myowarp.motion.markers import Markers, write_trc
from myowarp.motion.scaling import read_setup, scale
from myowarp.motion.setup import TrialSetup
from myowarp.motion.steps import kinematics
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.motion.tasks import tasks_of
from myowarp.motion.tool_setup import read_tool_setup
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.read.element import parse

ARM = Path(__file__).parents[1] / "data/osim/arm26.osim"
ALL = (-math.inf, math.inf)
TASKS = "<IKTaskSet><objects /><groups /></IKTaskSet>"
STATIC = """<AnalysisSet name="Analyses"><objects><StaticOptimization name="StaticOptimization"><on>true</on>
<start_time>-Inf</start_time><end_time>Inf</end_time><step_interval>1</step_interval>
<activation_exponent>2</activation_exponent></StaticOptimization></objects><groups /></AnalysisSet>"""
CMC = """<desired_points_file /><desired_kinematics_file /><task_set_file /><constraints_file />
<rra_controls_file /><lowpass_cutoff_frequency>-1</lowpass_cutoff_frequency>"""
ABSTRACT = """<model_file /><replace_force_set>false</replace_force_set><force_set_files />
<results_directory>./</results_directory><output_precision>8</output_precision>
<initial_time>0</initial_time><final_time>1</final_time>
<maximum_integrator_step_size>1</maximum_integrator_step_size>
<ControllerSet name="Controllers"><objects /><groups /></ControllerSet><external_loads_file />"""
# As OpenSim 4.6 writes each tool before anything is set, without what has no meaning here; the last three are
# what OpenCap and the GUI write, and what a tool takes where a file leaves an element out.
TOOLS = {
    "kinematics": ("<InverseKinematicsTool></InverseKinematicsTool>", TrialSetup()),
    "kinematics, all": (
        f"<InverseKinematicsTool><model_file></model_file><time_range>-Inf 2</time_range>{TASKS}"
        "<marker_file></marker_file><coordinate_file></coordinate_file></InverseKinematicsTool>",
        TrialSetup(span=(-math.inf, 2.0)),
    ),
    "dynamics": (
        "<InverseDynamicsTool><model_file>Unassigned</model_file><time_range> -inf inf</time_range>"
        "<forces_to_exclude /><external_loads_file>Unassigned</external_loads_file>"
        "<coordinates_file>Unassigned</coordinates_file><lowpass_cutoff_frequency_for_coordinates>-1"
        "</lowpass_cutoff_frequency_for_coordinates></InverseDynamicsTool>",
        TrialSetup(),
    ),
    "analysis": (
        f"<AnalyzeTool>{ABSTRACT}<states_file /><coordinates_file /><speeds_file />"
        "<lowpass_cutoff_frequency_for_coordinates>-1</lowpass_cutoff_frequency_for_coordinates></AnalyzeTool>",
        TrialSetup(span=(0.0, 1.0)),
    ),
    "static optimization": (
        f"<AnalyzeTool>{ABSTRACT}{STATIC}</AnalyzeTool>",
        TrialSetup(span=(0.0, 1.0), exponent=2.0),
    ),
    "tracking": (f"<CMCTool>{ABSTRACT}{CMC}</CMCTool>", TrialSetup(span=(0.0, 1.0))),
    "OpenCap": (
        f"<InverseKinematicsTool><model_file>Unassigned</model_file><constraint_weight>Inf</constraint_weight>"
        f"<time_range>-Inf Inf</time_range>{TASKS}<marker_file>Unassigned</marker_file>"
        "<coordinate_file>Unassigned</coordinate_file></InverseKinematicsTool>",
        TrialSetup(),
    ),
    "unassigned times": (
        "<InverseKinematicsTool><time_range>Unassigned</time_range></InverseKinematicsTool>",
        TrialSetup(),
    ),
    "no times": ("<AnalyzeTool><force_set_files>Unassigned</force_set_files></AnalyzeTool>",
                 TrialSetup(span=(0.0, 1.0))),
}  # fmt: skip
SCALING = """<ScaleTool><mass>-1</mass><height>-1</height><age>-1</age><notes>Unassigned</notes>
<GenericModelMaker><model_file>Unassigned</model_file><marker_set_file>Unassigned</marker_set_file>
</GenericModelMaker><ModelScaler><apply>true</apply><scaling_order />
<MeasurementSet><objects /><groups /></MeasurementSet><ScaleSet><objects /><groups /></ScaleSet>
<marker_file>Unassigned</marker_file><time_range> -1 -1</time_range>
<preserve_mass_distribution>false</preserve_mass_distribution>
<output_model_file>Unassigned</output_model_file><output_scale_file>Unassigned</output_scale_file>
</ModelScaler><MarkerPlacer><apply>true</apply><IKTaskSet><objects /><groups /></IKTaskSet>
<marker_file>Unassigned</marker_file><coordinate_file /><time_range> -1 -1</time_range>
<output_motion_file>Unassigned</output_motion_file><output_model_file>Unassigned</output_model_file>
<output_marker_file>Unassigned</output_marker_file><max_marker_movement>-1</max_marker_movement>
</MarkerPlacer></ScaleTool>"""


def written(folder, text, name="setup.xml"):
    """Write a document, and return its path."""
    path = folder / name
    path.write_text(f'<?xml version="1.0"?>\n<OpenSimDocument Version="40600">{text}</OpenSimDocument>')
    return path


@pytest.mark.parametrize("name", TOOLS)
def test_tools(tmp_path, name):
    text, expected = TOOLS[name]
    found, kinematics = read_tool_setup(written(tmp_path, text)), "InverseKinematicsTool" in text
    assert (found.tasks is not None, found.excluded) == (
        kinematics,
        () if "InverseDynamics" in text else None,
    )
    assert found.sources == (found.file,)
    assert replace(found, file=None, tool="", sources=(), tasks=None, excluded=None) == expected


def test_scale_tool(tmp_path):
    """All of it; and without the elements, which stand for the same."""
    setup = read_setup(written(tmp_path, SCALING))
    files = setup.model, setup.markers, setup.mass, setup.static, setup.pose
    assert files == (None,) * 5
    assert (setup.order, setup.measurements, setup.manual, setup.keep_masses) == ((), (), {}, False)
    assert setup.span == setup.pose_span == (-1.0, -1.0)
    bare = read_setup(written(tmp_path, "<ScaleTool><ModelScaler/><MarkerPlacer/></ScaleTool>"))
    assert (bare.span, bare.pose_span, bare.keep_masses, bare.tasks) == (
        *(setup.span, setup.pose_span, setup.keep_masses),
        setup.tasks,
    )


@pytest.mark.parametrize(("text", "message"), [
    ("<InverseKinematicsTool><time_range>2 1</time_range></InverseKinematicsTool>",
     "<time_range> must have a first time that is not after the last, got 2 and 1"),
    ("<InverseKinematicsTool><time_range>1</time_range></InverseKinematicsTool>", "two times, got '1'"),
    ("<InverseDynamicsTool><time_range>0 nan</time_range></InverseDynamicsTool>", "two times, got '0 nan'"),
    ("<InverseDynamicsTool><time_range>0 1_0</time_range></InverseDynamicsTool>", "numbers, got '0 1_0'"),
    ("<AnalyzeTool><initial_time>3</initial_time></AnalyzeTool>", "is not after the last, got 3 and 1"),
])  # fmt: skip
def test_times_that_are_none(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        read_tool_setup(written(tmp_path, text))


def test_one_frame(tmp_path):
    """A range of one time is that frame, not all."""
    text = "<InverseDynamicsTool><time_range>0.5 0.5</time_range></InverseDynamicsTool>"
    assert read_tool_setup(written(tmp_path, text)).span == (0.5, 0.5)


def test_paths_of_windows(tmp_path):
    (tmp_path / "in").mkdir()
    text = "<InverseDynamicsTool><coordinates_file>in\\walk.mot</coordinates_file></InverseDynamicsTool>"
    assert read_tool_setup(written(tmp_path, text)).motion == tmp_path / "in/walk.mot"
    text = text.replace("in\\walk.mot", "..\\walk.mot")
    assert read_tool_setup(written(tmp_path, text)).motion == tmp_path / "../walk.mot"


MEASURE = """<ScaleTool><ModelScaler><scaling_order> measurements</scaling_order><MeasurementSet><objects>
<Measurement name="arm"><MarkerPairSet><objects><MarkerPair><markers>r_acromion r_humerus_epicondyle</markers>
</MarkerPair></objects></MarkerPairSet><BodyScaleSet><objects><BodyScale name="/bodyset/r_humerus">
<axes>X Y Z</axes></BodyScale></objects></BodyScaleSet></Measurement></objects></MeasurementSet>
{}</ModelScaler><MarkerPlacer><apply>false</apply></MarkerPlacer></ScaleTool>"""
# Of OpenSim 4.6's ModelScaler: time range, factor of the humerus.
FACTORS = {
    "": 1.1,
    "<time_range>-1 -1</time_range>": 1.1,
    "<time_range>0 0.09</time_range>": 1.2,
    "<time_range>0.05 0.09</time_range>": 1.25556,
    "<time_range>0.05 0.05</time_range>": 1.21111,
    "<time_range>0.051 0.052</time_range>": 1.22222,
    "<time_range>-1 0.05</time_range>": 1.15556,
    "<time_range>-1e15 1e15</time_range>": 1.2,
}
APART = 0.3387309  # m, of these markers in arm26


@pytest.mark.parametrize("times", [*FACTORS, "<time_range>-Inf Inf</time_range>"])
def test_times_of_scaling(tmp_path, times):
    """Markers move apart, from 1.1 to 1.3 times as far as in the model; unstated: the first frame."""
    time = np.arange(10) / 100
    places = np.full((10, 2, 3), 0.1)
    places[:, 0, 2] += APART * (1.1 + 0.2 * np.arange(10) / 9)
    write_trc(tmp_path / "still.trc", Markers(("r_acromion", "r_humerus_epicondyle"), time, places))
    setup = read_setup(written(tmp_path, MEASURE.format(times)))
    scaled = scale(ARM, setup, tmp_path / "still.trc")
    assert scaled.unknown == ()
    np.testing.assert_allclose(scaled.factors["r_humerus"], FACTORS.get(times, 1.2), atol=1e-5)


def test_no_tasks_are_all_markers(tmp_path):
    """OpenSim 4.6 then weighs all markers alike: the elbow at 19.567°, the shoulder at 9.795°."""
    bones = Bones.read(ARM)
    seen = ((0, 0.01, 0.02), (0.1, 0.11, 0.12), (0.2, 0.21, 0.22))
    names = ("r_acromion", "r_humerus_epicondyle", "r_radius_styloid")
    markers = Markers(names, np.arange(7) / 60, np.tile(np.array(seen), (7, 1, 1)))
    write_trc(tmp_path / "arm.trc", markers)
    setup = written(tmp_path, f"<InverseKinematicsTool>{TASKS}</InverseKinematicsTool>")
    found = kinematics(bones, read_tool_setup(setup).stating(markers=tmp_path / "arm.trc")).fitted
    angles = dict(zip(found.coordinates, np.degrees(found.values[0]), strict=True))
    np.testing.assert_allclose(
        [angles["r_elbow_flex"], angles["r_shoulder_elev"]], [19.567117, 9.79453502], atol=1e-3
    )
    with pytest.raises(ValueError, match="has no <IKMarkerTask>"):
        tasks_of(parse(written(tmp_path, "<InverseDynamicsTool></InverseDynamicsTool>"))[0])


FORCE = """<ExternalLoads name="l"><objects><ExternalForce name="hand">{}</ExternalForce></objects><groups/>
<datafile>grf.mot</datafile></ExternalLoads>"""
BODY = "<applied_to_body>{}</applied_to_body>"
COLUMNS = {part: f"<{part}_identifier>{part[0]}</{part}_identifier>" for part in ("force", "point", "torque")}


@pytest.mark.parametrize(("parts", "message"), [
    ((), "has neither a force nor a torque; it needs the columns of one in <force_identifier>, or in"),
    (("point",), "has a point of no force; it needs the columns of one"),
    (("point", "torque"), "has a point of no force; it needs the columns of one"),
])  # fmt: skip
def test_loads_that_add_nothing_are_refused(tmp_path, parts, message):
    """As OpenSim fails at them."""
    text = FORCE.format(BODY.format("r_ulna_radius_hand") + "".join(COLUMNS[part] for part in parts))
    with pytest.raises(ValueError, match=message) as caught:
        read_loads(written(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_loads_that_are_off_are_said(tmp_path, caplog):
    text = FORCE.format(BODY.format("r_ulna_radius_hand") + "<appliesForce>false</appliesForce>")
    assert read_loads(written(tmp_path, text))[0] == ()
    assert "has no <ExternalForce> that acts" in caplog.text


@pytest.mark.parametrize("body", ["{}", "/bodyset/{}", "bodyset/{}", "/{}"])
@pytest.mark.parametrize("frame", ["ground", "/ground", "/bodyset/r_humerus"])
def test_bodies_by_path(tmp_path, body, frame):
    """As OpenSim 4 writes them."""
    frames = "".join(f"<{p}_expressed_in_body>{frame}</{p}_expressed_in_body>" for p in ("force", "point"))
    text = FORCE.format(BODY.format(body.format("r_ulna_radius_hand")) + frames + "".join(COLUMNS.values()))
    labels = tuple(part + axis for part in "fpt" for axis in "xyz")
    table = Storage(labels, np.arange(6) / 10, np.tile(np.arange(9.0), (6, 1)))
    write_storage(tmp_path / "grf.mot", "grf", table)
    (load,) = loads_at(written(tmp_path, text), np.array([0.1, 0.2]))
    expected = "r_ulna_radius_hand", frame.rpartition("/")[2], frame.rpartition("/")[2]
    assert (load.body, load.force_frame, load.point_frame) == expected


def test_moments_with_a_load_on_a_path(tmp_path):
    """OpenSim 4.6's moments, with the body's path as with its name."""
    wave = np.sin(2.0 * np.pi * np.arange(50) / 100)
    time = np.arange(50) / 100
    angles = np.stack([10.0 + 10.0 * wave, 40.0 + 20.0 * wave], axis=1)
    motion = Storage(("r_shoulder_elev", "r_elbow_flex"), time, angles, in_degrees=True)
    write_storage(tmp_path / "walk.mot", "walk", motion)
    labels = tuple(part + axis for part in "fpt" for axis in "xyz")
    push = np.tile([5.0, -10.0, 0.0, 0.1, 0.5, 0.17, 0.0, 0.0, 0.3], (50, 1))
    write_storage(tmp_path / "grf.mot", "grf", Storage(labels, time, push))
    text = FORCE.format(BODY.format("/bodyset/r_ulna_radius_hand") + "".join(COLUMNS.values()))
    loads = written(tmp_path, text)
    Dynamics(ARM, motion=tmp_path / "walk.mot", loads=loads, output=tmp_path / "out")()
    found = read_storage(tmp_path / "out/moments.sto").values[10]
    np.testing.assert_allclose(found, [1.2014, 1.4502], atol=1e-4)
