"""The command `myowarp motion` on files, against what OpenSim 4.6 recorded."""

import functools
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from myowarp.apps.cli.motion import analyze
from myowarp.apps.cli.motion.analyze import Analyze
from myowarp.apps.cli.motion.dynamics import Dynamics
from myowarp.apps.cli.motion.forces import FILES, Forces
from myowarp.apps.cli.motion.kinematics import Kinematics
from myowarp.apps.cli.motion.report import Report
from myowarp.apps.cli.motion.steps import RENEWED, absent_from
from myowarp.motion import steps
from myowarp.motion.markers import Markers, say_unmatched, write_trc
from myowarp.motion.movement import read_motion, write_angles
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.read.model import read_model

DATA = Path(__file__).parents[1] / "data"
GAIT, LEG = (DATA / "osim" / f"{name}.osim" for name in ("gait10dof18musc", "leg6dof9musc"))
ARM, BEND = (DATA.parents[1] / "examples" / name for name in ("arm.osim", "arm_bend.mot"))
DIGITS = 1e-5
"""Share of the greatest value: nine digits in files, twice differentiated."""

LOADS = """<OpenSimDocument Version="40000"><ExternalLoads name="l"><objects><ExternalForce name="push">
<applied_to_body>BODY</applied_to_body><force_identifier>f</force_identifier>
<point_identifier>p</point_identifier></ExternalForce></objects><datafile>push.mot</datafile></ExternalLoads>
</OpenSimDocument>"""


@pytest.fixture
def gait(tmp_path):
    """Return a folder with a motion and its loads, and what OpenSim made of them."""
    there = np.load(DATA / "opensim/motion_gait10dof18musc.npz")
    bones = Bones(read_model(GAIT))
    write_angles(tmp_path / "motion.mot", bones.model, bones.coordinates, there["time"], there["values"])
    labels = tuple(part + axis for part in "fp" for axis in "xyz")
    table = Storage(labels, there["time"], np.hstack([there["force"], there["point"]]))
    write_storage(tmp_path / "push.mot", "push", table)
    (tmp_path / "push.xml").write_text(LOADS.replace("BODY", "calcn_r"))
    return tmp_path, there


def test_a_recording_of_another_model_is_doubted(caplog):
    """By markers and coordinates that hardly occur in it."""

    def markers(*names):
        caplog.clear()
        say_unmatched(("hip", "knee"), Markers(names, np.zeros(1), np.zeros((1, len(names), 3))))
        return caplog.messages

    assert not markers("hip", "knee")
    assert not markers("hip")
    left = "markers are not in the model, and left out"
    assert markers("hip", "knee", "nose") == [f"1 of 3 {left}: nose"]
    other = "the recording has no knee: rename markers that are the same"
    assert markers("hip", "nose") == [f"1 of 2 {left}: nose; {other}"]
    doubt = ", or take the model of this trial"
    assert markers("hip", *"abcdef") == [f"6 of 7 {left}: a, b, c, d, e and 1 more; {other}{doubt}"]
    few = SimpleNamespace(absent=("knee", "ankle"), values=np.zeros((9, 3)))
    assert absent_from(few)[0].endswith("knee, ankle (is it of this model? 1 of 3 are there)")
    assert absent_from(SimpleNamespace(absent=("knee",), values=np.zeros((9, 3))))[0].endswith(
        "default: knee"
    )


def test_the_examples_markers_are_those_of_its_angles(tmp_path, capsys):
    """They were placed by two rotations about z, written by hand, with 1 mm of noise."""
    examples = DATA.parents[1] / "examples"
    arm, markers, own = (examples / name for name in ("arm.osim", "arm_bend.trc", "arm_markers.xml"))
    Kinematics(arm, markers=markers, marker_set=own, output=tmp_path)()
    found, wanted = (read_storage(path) for path in (tmp_path / "ik.mot", examples / "arm_bend.mot"))
    columns = [found.labels.index(label) for label in wanted.labels]
    off = found.values[:, columns] - wanted.values
    assert 0.1 < np.sqrt(np.mean(off**2)) < 0.6, "degrees"
    assert "not in the model" not in capsys.readouterr().err


def test_forces(gait, capsys, monkeypatch):
    folder, there = gait
    monkeypatch.setattr(analyze, "page_of", lambda *rest: [])  # drawn in the tests of the documentation
    options = {"motion": folder / "motion.mot", "loads": folder / "push.xml", "filter": 6.0}
    Forces(GAIT, **options, mode="opensim", reserve=1000.0, output=folder / "out")()
    moments = read_storage(folder / "out/moments.sto")
    assert moments.labels[:2] == ("pelvis_tilt_moment", "pelvis_tx_force")
    scale = np.abs(there["moments"]).max()
    assert np.abs(moments.values - there["moments"]).max() < DIGITS * scale
    activation = read_storage(folder / "out/activations.sto").values
    assert ((activation >= 0.0) & (activation <= 1.0)).all()
    arms = Analyze(GAIT, motion=folder / "motion.mot", filter=6.0, output=folder / "arms")
    arms()
    arm, force = read_storage(folder / "arms/moment_arms.sto"), read_storage(folder / "out/forces.sto")
    total = read_storage(folder / "out/reserves.sto").values + read_storage(folder / "out/missing.sto").values
    coordinates = [label.rsplit("_", 1)[0] for label in moments.labels]
    for label, column in zip(arm.labels, arm.values.T, strict=True):
        muscle, coordinate = label.split(".")
        total[:, coordinates.index(coordinate)] += column * force.values[:, force.labels.index(muscle)]
    np.testing.assert_allclose(total, moments.values, atol=DIGITS * scale)
    at_root = [k for k, label in enumerate(moments.labels) if label.endswith("_force")]
    assert set(coordinates[k] for k in at_root) == {"pelvis_tx", "pelvis_ty"}
    most = np.abs(there["moments"][:, at_root]).max()
    said = capsys.readouterr().err
    assert f"residuals at the root: {most:.0f} N (" in said
    assert "reserve at pelvis" not in said
    of_others = {"passive_moments.sto", "actuators.sto", "contact_forces.sto"}  # the model has none of these
    assert {path.name for path in (folder / "out").iterdir()} == set(FILES) - of_others
    with pytest.raises(ValueError, match="exists; choose another folder with --output, or"):
        arms()


def test_without_reserves_the_weak_are_named(gait, capsys):
    folder, _ = gait
    Forces(GAIT, motion=folder / "motion.mot", loads=folder / "push.xml", filter=6.0,
           output=folder / "out")()  # fmt: skip
    said = capsys.readouterr().err
    assert "muscles cannot hold" in said
    assert "iliopsoas_r is fully active in" in said
    assert "reserve at" not in said


def test_weak_reserves_hold_what_muscles_cannot(gait, capsys):
    """They have no bound; what the softness of the solver leaves beside them is said, and is no lack."""
    folder, _ = gait
    Forces(GAIT, motion=folder / "motion.mot", loads=folder / "push.xml", filter=6.0, reserve=0.03,
           output=folder / "weak")()  # fmt: skip
    said = capsys.readouterr().err
    missing, given = (read_storage(folder / f"weak/{name}.sto") for name in ("missing", "reserves"))
    greatest = np.abs(read_storage(folder / "weak/moments.sto").values).max(axis=0)
    joints = [k for k, label in enumerate(missing.labels) if not label.startswith("pelvis")]
    lacks = np.abs(missing.values[:, joints]).max(axis=0)
    assert (lacks > 1e-4 * greatest[joints]).any()
    assert "muscles cannot hold" not in said
    k = joints[int(lacks.argmax())]
    share = 100.0 * np.abs(given.values[:, k]).max() / greatest[k]
    assert f" at most, {share:.2g} % of the greatest moment there\n" in said


def test_kinematics(tmp_path, capsys):
    there = np.load(DATA / "opensim/motion_leg6dof9musc.npz")
    write_trc(tmp_path / "walk.trc", Markers(tuple(there["markers"]), there["time"], there["seen"]))
    Kinematics(LEG, markers=tmp_path / "walk.trc", output=tmp_path / "out")()
    back = read_motion(tmp_path / "out/ik.mot", Bones(read_model(LEG)))
    np.testing.assert_allclose(back.values, there["fitted"], atol=2e-5)
    assert not back.absent
    off = read_storage(tmp_path / "out/marker_errors.sto").values
    assert f"markers: {1e3 * np.sqrt(np.nanmean(off**2)):.1f} mm rms\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"motion": None}, "motion forces needs --motion FILE"),
        ({"reserve": -1.0}, "--reserve must be at least 0 and finite, got -1"),
        ({"residual": np.nan}, "--residual must be at least 0 and finite, got nan"),
        ({"residual": np.inf}, "--residual must be at least 0 and finite, got inf"),
        ({"exponent": np.nan}, "--exponent must be at least 1 and finite, got nan"),
        (
            {"exponent": 30.0, "reserve": 1.0},
            "no least cost was found in .* frames with an exponent of 30; take",
        ),
        ({"reserve": 1e9}, r"at most 1e\+06 N m or N, got 1e\+09 on 'pelvis_tilt'"),
        ({"filter": 500.0}, "must be at least 0.003 and below 30 Hz, half of the rate, got 500"),
        ({"loads": "other.xml"}, "body 'nose' unknown; available: ground, pelvis"),
        ({"motion": "push.mot"}, "has no column of a coordinate; the model has pelvis_tilt"),
    ],
)
def test_bad_input_is_one_sentence(gait, change, message):
    folder, _ = gait
    (folder / "other.xml").write_text(LOADS.replace("BODY", "nose"))
    options = {"motion": folder / "motion.mot", "output": folder / "out"}
    options |= {k: folder / v if isinstance(v, str) else v for k, v in change.items()}
    with pytest.raises(ValueError, match=message) as caught:
        Forces(GAIT, **options)()
    assert "\n" not in str(caught.value)


def test_residuals_need_a_root(tmp_path):
    """An arm hangs on a wall: nothing carries it through space."""
    with pytest.raises(ValueError, match="--residual is of coordinates that carry a model through space; "):
        Forces(ARM, motion=BEND, residual=5.0, output=tmp_path / "out")()
    assert not (tmp_path / "out").exists()


def test_a_step_renews_what_an_earlier_one_wrote(tmp_path, monkeypatch, capsys):
    """`dynamics`, `forces`, `analyze`, `report` into one folder; what others wrote there stays."""
    monkeypatch.setattr("myowarp.apps.reports.motion.page", lambda *rest: RENEWED["report.html"])
    folder, options = tmp_path, {"motion": BEND, "output": tmp_path / "out"}
    Dynamics(ARM, **options)()
    rough = (folder / "out/moments.sto").read_bytes()
    assert "replaces" not in capsys.readouterr().err
    Forces(ARM, **options, filter=6.0)()
    assert f"An earlier step wrote moments.sto in {folder / 'out'}; this one replaces it" in (
        capsys.readouterr().err
    )
    smooth = (folder / "out/moments.sto").read_bytes()
    assert smooth != rough
    Analyze(ARM, **options)()
    Report(ARM, output=folder / "out")()
    Report(ARM, output=folder / "out")()
    for step in (Dynamics, Forces, Analyze):
        with pytest.raises(
            ValueError, match="exists; choose another folder with --output, or replace it with"
        ):
            step(ARM, **options)()
    (folder / "out/report.html").write_text("<!doctype html>mine")
    with pytest.raises(ValueError, match=r"report\.html' exists; choose another folder"):
        Report(ARM, output=folder / "out")()
    assert (folder / "out/moments.sto").read_bytes() == smooth


def test_a_result_that_came_meanwhile_is_left_alone(tmp_path, monkeypatch):
    """Of two steps that begin together in one folder, the second to end is refused and writes nothing."""
    options = {"motion": BEND, "output": tmp_path / "out"}

    @functools.wraps(steps.forces)
    def slow(*given, solve=steps.forces):
        monkeypatch.setattr(steps, "forces", solve)
        Forces(ARM, **options, filter=6.0)()
        kept.update((path, path.read_bytes()) for path in (tmp_path / "out").iterdir())
        return solve(*given)

    kept = {}
    monkeypatch.setattr(steps, "forces", slow)
    with pytest.raises(
        ValueError, match=r"activations\.sto' exists; choose another folder with --output, or"
    ):
        Forces(ARM, **options)()
    assert len(kept) > 5
    assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} == kept
