"""A study of recorded motions: draws are what they say, parts are done once, a bad trial stops no other."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pd = pytest.importorskip("pandas")

from myowarp.apps.cli.motion.forces import Forces  # noqa: E402
from myowarp.apps.cli.motion.kinematics import Kinematics  # noqa: E402
from myowarp.apps.cli.motion.study import Study  # noqa: E402
from myowarp.apps.studies.motion import plan  # noqa: E402
from myowarp.disk import SCRATCH  # noqa: E402
from myowarp.motion.draws import Recording, Uncertainty, draw_trial, normal  # noqa: E402
from myowarp.motion.inverse_kinematics import inverse_kinematics  # noqa: E402
from myowarp.motion.markers import Markers, write_trc  # noqa: E402
from myowarp.motion.movement import read_motion, write_angles  # noqa: E402
from myowarp.motion.setup import TrialSetup  # noqa: E402
from myowarp.motion.storage import Storage, read_storage, write_storage  # noqa: E402
from myowarp.osim.body.skeleton import Bones  # noqa: E402
from myowarp.osim.document.read.model import read_model  # noqa: E402
from myowarp.process import warn_once  # noqa: E402

DATA = Path(__file__).parents[1] / "data"
ARM, LEG, GAIT = (DATA / f"osim/{name}.osim" for name in ("arm26", "leg6dof9musc", "gait10dof18musc"))
ROUNDING = 1e-6


def bend(mode="opensim"):
    """Return an arm that bends against gravity."""
    bones, time = Bones(read_model(ARM)), np.linspace(0.0, 1.0, 21)
    values = 0.6 + np.outer(np.sin(np.pi * time), [0.1, 0.5])
    return Recording(bones, time, values, TrialSetup(mode=mode))


def of_draws(array, draws):
    """Return an array of all frames by draw."""
    return array.reshape(draws, -1, array.shape[1])


def test_masses_by_hand():
    """Moments are sums over bodies, each times the factor of its draw."""
    trial, count = bend(), 4
    strong = draw_trial(trial, Uncertainty(mass=0.1), range(count), seed=5)
    bodies = [name for name, number in trial.bones.bodies.items() if number >= 0]
    moments = []
    for k in range(len(bodies)):
        one = {f"mass:{name}": 2.0 if name == bodies[k] else 1.0 for name in bodies}
        moments.append(draw_trial(replace(trial, factors=one), Uncertainty(), [0]))
    plain = strong.joint_moment[0]
    own = np.stack([found.joint_moment[0] - plain for found in moments])
    np.testing.assert_allclose(own.sum(axis=0), plain, atol=ROUNDING)
    for draw in range(count):
        factor = np.exp(0.1 * normal(5, draw, "mass", len(bodies)))
        wanted = np.einsum("b,bfk->fk", factor, own)
        np.testing.assert_allclose(strong.joint_moment[draw], wanted, atol=ROUNDING)
    assert np.abs(strong.joint_moment[1] - plain).max() > 1000 * ROUNDING


@pytest.mark.parametrize("mode", ["opensim", "equilibrium"])
def test_factors_are_those_of_another_model(mode):
    """Strength and slack length of a draw are as if the document said so."""
    trial = bend(mode)
    factors = {
        "max_isometric_force": 1.3,
        "max_isometric_force:BRA": 0.7,
        "tendon_slack_length:BIClong": 0.98,
    }
    found = draw_trial(replace(trial, factors=factors), Uncertainty(), [0]).forces
    muscles = {
        name: replace(
            muscle,
            max_isometric_force=muscle.max_isometric_force * (1.3 * 0.7 if name == "BRA" else 1.3),
            tendon_slack_length=muscle.tendon_slack_length * (0.98 if name == "BIClong" else 1.0),
        )
        for name, muscle in trial.bones.model.muscles.items()
    }
    other = Bones(replace(trial.bones.model, muscles=muscles))
    wanted = draw_trial(replace(trial, bones=other), Uncertainty(), [0]).forces
    np.testing.assert_allclose(found.force, wanted.force, atol=1e-6)
    plain = draw_trial(trial, Uncertainty(), [0]).forces
    assert np.abs(plain.force - wanted.force).max() > 1.0, "N"


def test_a_draw_is_the_same_alone():
    """Bit for bit; draw 0 is the trial as it is, and the slack length matters."""
    trial, spread = bend("equilibrium"), Uncertainty(max_isometric_force=0.2, tendon_slack_length=0.03)
    many = draw_trial(trial, spread, range(5), seed=2)
    force = of_draws(many.forces.force, 5)
    for draw in (0, 3):
        np.testing.assert_array_equal(draw_trial(trial, spread, [draw], seed=2).forces.force, force[draw])
    np.testing.assert_array_equal(draw_trial(trial, Uncertainty(), [4]).forces.force, force[0])
    less = draw_trial(trial, Uncertainty(max_isometric_force=0.2), range(5), seed=2)
    assert np.abs(of_draws(less.forces.force, 5)[3] - force[3]).max() > 1.0, "N"


def test_noise_of_markers():
    """Angles of a draw are those of the markers that it sees; the error of markers is the noise."""
    there = np.load(DATA / "opensim/motion_leg6dof9musc.npz")
    bones, names = Bones(read_model(LEG)), tuple(there["markers"])
    markers = Markers(names, there["time"], there["seen"])
    fitted = inverse_kinematics(bones, markers)
    weights = {"marker_weights": dict.fromkeys(names, 1.0)}
    trial = Recording(bones, fitted.time, fitted.values, markers=markers, targets=weights)
    found = draw_trial(trial, Uncertainty(marker_noise=0.01), range(3), seed=1)
    noise = 0.01 * normal(1, 2, "marker_noise", *there["seen"].shape)
    alone = inverse_kinematics(bones, Markers(names, there["time"], there["seen"] + noise))
    np.testing.assert_allclose(found.values[2], alone.values, atol=ROUNDING)
    assert np.abs(found.values[2] - found.values[0]).max() > 1000 * ROUNDING
    assert found.marker_rms[0] < 0.5 * found.marker_rms[1]
    assert found.marker_rms[1] == pytest.approx(np.sqrt(3) * 0.01, rel=0.3)
    weighed = draw_trial(trial, Uncertainty(marker_weight=1.0), range(2), seed=1)
    assert np.abs(weighed.values[1] - weighed.values[0]).max() > 1e-4


@pytest.fixture
def table(tmp_path):
    """Return a table of three trials; the second one has no file of its angles."""
    trial = bend()
    write_angles(tmp_path / "bend.mot", trial.bones.model, trial.bones.coordinates, trial.time, trial.values)
    write_trc(tmp_path / "x.trc", Markers(("a",), trial.time, np.zeros((21, 1, 3))))
    rows = [
        {"trial": "one", "motion": "bend.mot", "max_isometric_force_spread": 0.1, "mass:r_humerus": 1.5},
        {"trial": "lost", "motion": "nowhere.mot"},
        {"trial": "two", "motion": "bend.mot", "start": 0.2},
    ]
    pd.DataFrame([{"model": str(ARM), **row} for row in rows]).to_csv(tmp_path / "trials.csv", index=False)
    return tmp_path / "trials.csv"


def test_a_study_says_what_is_left_at_the_root(tmp_path, capsys):
    """Of one who stands still without a floor: his weight."""
    bones, time = Bones.read(GAIT), np.linspace(0.0, 1.0, 11)
    still = np.tile([bones.model.coordinates[name].default for name in bones.coordinates], (11, 1))
    write_angles(tmp_path / "still.mot", bones.model, bones.coordinates, time, still)
    (tmp_path / "trials.csv").write_text(f"trial,model,motion\nstill,{GAIT},still.mot\n")
    Study(tmp_path / "trials.csv", reserve=1e4, output=tmp_path / "out")()
    weight = sum(body.mass for body in bones.model.bodies.values()) * np.linalg.norm(bones.model.gravity)
    left = f"still: residuals at the root {weight:.0f} N (100 % of the weight): check its loads, filter and"
    assert left in capsys.readouterr().err


def test_a_study(table, capsys):
    """The lost trial is named and the others are there; what is missing is done, and nothing else."""
    output = table.parent / "out"
    study = Study(table, draws=60, reserve=1.0, output=output)
    with pytest.raises(RuntimeError, match=r"1 of 3 trials failed, such as 'lost': .*nowhere\.mot") as caught:
        study()
    assert "the same command tries these again" in str(caught.value)
    assert "lost" in (output / "failed.csv").read_text()
    results, summary = (pd.read_parquet(output / folder) for folder in ("results", "summary"))
    assert set(results["trial"]) == {"one", "two"}
    assert summary.groupby("trial").size().to_dict() == {"one": 61, "two": 61}
    assert results[(results["trial"] == "two") & (results["draw"] == 7)]["time"].min() >= 0.2
    ends = [read_storage(output / f"trials/one/forces{end}.sto") for end in ("_low", "", "_high")]
    muscle = ends[1].labels[int(ends[1].values.max(axis=0).argmax())]
    own = results[(results["trial"] == "one") & (results["draw"] > 0)].pivot_table(
        index="time", columns="draw", values=f"force.{muscle}", observed=True
    )
    low, _, high = (table.values[:, table.labels.index(muscle)] for table in ends)
    np.testing.assert_allclose(low, own.quantile(0.05, axis=1), rtol=1e-5)
    np.testing.assert_allclose(high, own.quantile(0.95, axis=1), rtol=1e-5)
    assert (high - low).max() > 1.0, "N"
    assert (output / "trials/one/forces.png").stat().st_size > 10_000

    before = {path.name: path.stat().st_mtime_ns for path in (output / "summary").iterdir()}
    assert len(before) == 4
    (output / "summary/part-00001.parquet").unlink()
    (output / "results/part-00004.parquet").write_bytes(b"")
    (table.parent / "nowhere.mot").write_bytes((table.parent / "bend.mot").read_bytes())
    study()
    after = {path.name: path.stat().st_mtime_ns for path in (output / "summary").iterdir()}
    assert len(after) == 6
    kept = {name for name, written in after.items() if before.get(name) == written}
    assert kept == {"part-00000.parquet", "part-00005.parquet"}
    again = pd.read_parquet(output / "results")
    first = results.sort_values(["trial", "draw", "time"], ignore_index=True)
    rest = again[again["trial"] != "lost"].sort_values(["trial", "draw", "time"], ignore_index=True)
    np.testing.assert_array_equal(rest["force.BIClong"], first["force.BIClong"])
    assert "done again" in capsys.readouterr().err
    with pytest.raises(
        ValueError, match=r"holds a motion study of other settings \(draws is 60 there and 2 here\)"
    ):
        Study(table, draws=2, reserve=1.0, output=output)()


def test_a_factor_in_percent_is_said(table, caplog):
    frame = pd.read_csv(table).assign(mass=[1.0, 3.0, 40.0])
    frame.to_csv(table, index=False)
    warn_once.cache_clear()
    plan.plan_study(table)
    assert caplog.messages == ["mass of 40 is 40 times the model's; for 40 % write 0.4"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"strength": 1.0}, "motion column 'strength' unknown; available: trial, model"),
        ({"filter": "six"}, r"motion row 1 \(trial 'one'\), column 'filter': needs a number, got 'six'"),
        ({"filter": "1_0"}, r"column 'filter': needs a number, got '1_0'"),
        ({"filter": "\u0666"}, r"column 'filter': needs a number, got '\u0666'"),
        ({"mass": "1e308"}, r"column 'mass': needs a number below 1e.15 in size, got '1e.*308'"),
        ({"filter": "inf"}, r"column 'filter': needs a number, got 'inf'"),
        ({"markers": "x.trc"}, "needs one of markers"),
        ({"fill": 0.1}, r"row 1 .*, column 'fill': is of markers; leave it empty beside joint angles"),
        ({"model": None}, "column 'model': needs an .osim file, got nothing"),
        ({"trial": "../one"}, "a name has letters"),
        ({"trial": 300 * "x"}, "a name has letters, .*, and at most 200 bytes"),
        ({"trial": 101 * "é"}, "a name has letters, .*, and at most 200 bytes"),
        ({"trial": "two"}, "has the trial 'two' twice"),
        ({"mass:nose": 2.0}, "factor mass:nose: 'nose' unknown; available: base"),
        ({"mass": -1.0}, r"row 1 \(trial 'one'\): factor mass must be above 0 and finite, got -1"),
        ({"mass_spread": -0.1}, "row 1 .*: the spread of mass must be at least 0 and finite, got -0.1"),
        ({"mass": "1e308"}, r"row 1 .*, column 'mass': needs a number below 1e\+15 in size, got '1e308'"),
        ({"filter": "NAN"}, r"row 1 .*, column 'filter': needs a number, got 'NAN'"),
        ({"mass_spread": 1000}, "a spread of 1000 gives factors on mass that no number holds"),
        ({"marker_noise": 0.1}, "noise and weights of markers need markers"),
    ],
)
def test_bad_tables_are_one_sentence(table, change, message):
    frame = pd.read_csv(table).iloc[[0, 2]].astype(object)
    for name, cell in change.items():
        if name not in frame:
            frame[name] = None
        frame.loc[0, name] = cell
    frame.to_csv(table, index=False)
    with pytest.raises((ValueError, RuntimeError), match=message) as caught:
        Study(table, draws=1, output=table.parent / "out")()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": 3}, "--seed is of draws; give their number with --draws"),
        ({"exponent": float("nan")}, "--exponent must be at least 1 and finite, got nan"),
        ({"reserve": float("inf")}, "--reserve must be at least 0 and finite, got inf"),
        (
            {"draws": 10**12},
            "a study has at most 100000 parts of 50 draws, got 60000000003, with --draws 1000000000000 of 3 "
            "trials; ask for fewer draws, or divide the table",
        ),
    ],
)
def test_bad_options_are_refused_at_once(table, options, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        Study(table, **options, output=table.parent / "out")()
    assert not (table.parent / "out").exists()


def test_a_table_of_many_rows_is_read_once(table, monkeypatch):
    """Each file once, whatever the number of rows that name it; names are compared in linear time."""
    rows = [{"trial": f"r{k}", "model": str(ARM), "motion": "bend.mot"} for k in range(3000)]
    pd.DataFrame(rows).to_csv(table, index=False)
    begin, read = time.process_time(), []
    digest = plan.files_digest
    monkeypatch.setattr(plan, "files_digest", lambda files: read.append(files) or digest(files))
    inputs = plan.plan_study(table).inputs()
    assert len(set(inputs.values())) == 3000
    assert len(read) == 2
    assert time.process_time() - begin < 3.0, "s"


IK = """<OpenSimDocument Version="40000"><InverseKinematicsTool name="k"><IKTaskSet><objects>{}
<IKCoordinateTask name="knee_angle_r"><value_type>from_file</value_type><weight>1e3</weight>
</IKCoordinateTask></objects></IKTaskSet><marker_file>walk.trc</marker_file>
<coordinate_file>held.mot</coordinate_file><time_range>0.1 0.4</time_range></InverseKinematicsTool>
</OpenSimDocument>"""
SO = """<OpenSimDocument Version="40000"><AnalyzeTool name="a"><force_set_files>r.xml</force_set_files>
<initial_time>0.2</initial_time><final_time>0.8</final_time><AnalysisSet><objects><StaticOptimization>
<activation_exponent>3</activation_exponent></StaticOptimization></objects></AnalysisSet>
<external_loads_file>push.xml</external_loads_file><coordinates_file>bend.mot</coordinates_file>
<lowpass_cutoff_frequency_for_coordinates>6</lowpass_cutoff_frequency_for_coordinates>
</AnalyzeTool></OpenSimDocument>"""
RESERVES = """<OpenSimDocument Version="40000"><ForceSet><objects><CoordinateActuator name="e">
<coordinate>r_elbow_flex</coordinate><optimal_force>7</optimal_force></CoordinateActuator></objects></ForceSet>
</OpenSimDocument>"""
PUSH = """<OpenSimDocument Version="40000"><ExternalLoads name="l"><objects><ExternalForce name="push">
<applied_to_body>r_ulna_radius_hand</applied_to_body><force_identifier>f</force_identifier></ExternalForce>
</objects><datafile>push.mot</datafile></ExternalLoads></OpenSimDocument>"""


def test_a_set_up_means_what_it_means_to_kinematics(tmp_path):
    """Markers, times, weights and a knee that is held where a file has it: the same angles, digits aside."""
    there = np.load(DATA / "opensim/motion_leg6dof9musc.npz")
    bones, names = Bones(read_model(LEG)), tuple(map(str, there["markers"]))
    write_trc(tmp_path / "walk.trc", Markers(names, there["time"], there["seen"]))
    held = np.tile(
        [bones.model.coordinates[name].default for name in bones.coordinates], (len(there["time"]), 1)
    )
    held[:, (knee := bones.coordinates.index("knee_angle_r"))] = -0.9 + 0.3 * np.sin(5.0 * there["time"])
    write_angles(tmp_path / "held.mot", bones.model, bones.coordinates, there["time"], held)
    tasks = "".join(f'<IKMarkerTask name="{name}"><weight>1</weight></IKMarkerTask>' for name in names)
    (tmp_path / "ik.xml").write_text(IK.format(tasks))
    Kinematics(LEG, setup=tmp_path / "ik.xml", output=tmp_path / "k")()
    found = read_motion(tmp_path / "k/ik.mot", bones)
    trial = plan.Trial("a", {"model": LEG, "setup": tmp_path / "ik.xml"}, {}, {}, Uncertainty())
    recording = plan.recording_of(trial, plan.Study((trial,)))
    np.testing.assert_allclose(recording.time, found.time, atol=1e-8)
    assert recording.time[[0, -1]] == pytest.approx([0.1, 0.4], abs=0.02)
    np.testing.assert_allclose(recording.values, found.values, atol=1e-7)
    without = inverse_kinematics(bones, recording.markers)
    assert np.abs(without.values[:, knee] - recording.values[:, knee]).max() > 0.1
    drawn = draw_trial(recording, Uncertainty(marker_noise=1e-9), range(3), seed=1)
    np.testing.assert_allclose(drawn.values[2], recording.values, atol=1e-5)


@pytest.fixture
def tool(tmp_path):
    """Return a folder with an arm's motion, its load, and a set-up file of static optimisation."""
    trial = bend()
    write_angles(tmp_path / "bend.mot", trial.bones.model, trial.bones.coordinates, trial.time, trial.values)
    push = Storage(("fx", "fy", "fz"), trial.time, np.outer(np.sin(4.0 * trial.time), [3.0, 10.0, 1.0]))
    write_storage(tmp_path / "push.mot", "push", push)
    for name, text in (("so.xml", SO), ("r.xml", RESERVES), ("push.xml", PUSH)):
        (tmp_path / name).write_text(text)
    return tmp_path


def test_a_set_up_means_what_it_means_to_forces(tool):
    """Motion, loads, filter over the whole motion, times, exponent and reserves; the row comes before it."""
    Forces(ARM, setup=tool / "so.xml", output=tool / "f")()
    trial = plan.Trial("a", {"model": ARM, "setup": tool / "so.xml"}, {}, {}, Uncertainty())
    drawn = draw_trial(plan.recording_of(trial, plan.Study((trial,))), Uncertainty(), [0])
    for name, values in (("moments", drawn.joint_moment[0]), ("activations", drawn.forces.activation),
                         ("reserves", drawn.forces.reserve)):  # fmt: skip
        wanted = read_storage(tool / f"f/{name}.sto").values
        assert np.abs(wanted).max() > 1e-3, name
        np.testing.assert_allclose(values, wanted, atol=1e-6 * np.abs(wanted).max(), err_msg=name)
    stated = replace(trial, numbers={"filter": 4.0, "start": 0.3})
    setup = stated.setup().stating(exponent=2.0, reserve=1.0)
    assert (setup.cutoff, setup.span, setup.exponent) == (4.0, (0.3, 0.8), 2.0)
    assert setup.reserves_of(bend().bones) == dict.fromkeys(bend().bones.coordinates, 1.0)


@pytest.mark.parametrize("file", ["so.xml", "r.xml", "push.xml", "push.mot", "bend.mot"])
def test_what_is_read_at_second_hand_is_in_the_key(tool, file):
    """A file that another one names changes, comes or goes: the trial is another one."""
    trial = plan.Trial("a", {"model": ARM, "setup": tool / "so.xml"}, {}, {}, Uncertainty())
    study, seen = plan.Study((trial,)), set()
    text = (tool / file).read_text()
    for content in (text, text + " \n", None):
        (tool / file).unlink()
        if content is not None:
            (tool / file).write_text(content)
        seen.add(study.inputs()["a"])
    assert len(seen) == 3


@pytest.mark.slow
def test_a_study_begins_again_where_a_file_at_second_hand_changed(tool):
    table = pd.DataFrame([{"trial": "a", "model": str(ARM), "motion": "bend.mot", "loads": "push.xml"}])
    table.to_csv(tool / "t.csv", index=False)
    moments = []
    for output, factor in (("out", 1.0), ("out", 50.0), ("new", 50.0)):
        time = bend().time
        push = Storage(("fx", "fy", "fz"), time, factor * np.outer(np.sin(4.0 * time), [3.0, 10.0, 1.0]))
        write_storage(tool / "push.mot", "push", push)
        Study(tool / "t.csv", reserve=1.0, output=tool / output)()
        moments.append((tool / output / "trials/a/moments.sto").read_bytes())
    assert moments[1] == moments[2] != moments[0]


def test_what_a_dead_process_left_is_swept_and_what_is_no_part_is_named(tool):
    table = pd.DataFrame([{"trial": "a", "model": str(ARM), "motion": "bend.mot"}])
    table.to_csv(tool / "t.csv", index=False)
    study = Study(tool / "t.csv", reserve=1.0, output=tool / "out")
    study()
    (tool / f"out/summary/{SCRATCH}left.parquet").touch()
    study()
    assert [path.name for path in (tool / "out/summary").iterdir()] == ["part-00000.parquet"]
    (tool / "out/summary/tmp5c9_2sbf.parquet").touch()
    with pytest.raises(ValueError, match=r"tmp5c9_2sbf\.parquet' is no part of a motion study but is"):
        study()


def test_results_that_are_not_finite_are_an_error():
    trial = replace(bend(), factors={"mass": 1e300}, values=1e8 * bend().values)
    with pytest.raises(
        ValueError, match="joint moments of draw 0 are not finite; its motion, factors or loads"
    ):
        draw_trial(trial, Uncertainty(), [0])


@pytest.mark.slow
def test_over_a_cluster_the_files_are_the_same(tmp_path):
    """Byte for byte; and what is there is not done again."""
    pytest.importorskip("ray")
    examples = Path(__file__).parents[2] / "examples"
    for name, options in (("here", {}), ("there", {"ray": True})):
        Study(examples / "arm_trials.csv", draws=60, reserve=1.0, output=tmp_path / name, **options)()
    files = sorted(path.relative_to(tmp_path / "here") for path in (tmp_path / "here").rglob("*.parquet"))
    assert len(files) == 8
    for file in files:
        assert (tmp_path / "here" / file).read_bytes() == (tmp_path / "there" / file).read_bytes(), file
    before = {file: (tmp_path / "there" / file).stat().st_mtime_ns for file in files}
    Study(examples / "arm_trials.csv", draws=60, reserve=1.0, output=tmp_path / "there", ray=True)()
    assert before == {file: (tmp_path / "there" / file).stat().st_mtime_ns for file in files}
