"""A study of recorded motions: draws are what they say, parts are done once, a bad trial stops no other."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pd = pytest.importorskip("pandas")

from myowarp.apps.cli.motion import Motion  # noqa: E402
from myowarp.motion.draws import Recording, Uncertainty, draw_trial, normal  # noqa: E402
from myowarp.motion.inverse_kinematics import inverse_kinematics  # noqa: E402
from myowarp.motion.markers import Markers, write_trc  # noqa: E402
from myowarp.motion.skeleton import Bones  # noqa: E402
from myowarp.motion.storage import read_storage  # noqa: E402
from myowarp.motion.trial import write_angles  # noqa: E402
from myowarp.opensim.read.model import read_model  # noqa: E402

DATA = Path(__file__).parents[1] / "data"
ARM, LEG = (DATA / f"osim/{name}.osim" for name in ("arm26", "leg6dof9musc"))
ROUNDING = 1e-6


def bend(mode="opensim"):
    """Return an arm that bends against gravity."""
    bones, time = Bones(read_model(ARM)), np.linspace(0.0, 1.0, 21)
    values = 0.6 + np.outer(np.sin(np.pi * time), [0.1, 0.5])
    return Recording(bones, time, values, mode=mode)


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
    trial = Recording(bones, fitted.time, fitted.values, markers, dict.fromkeys(names, 1.0))
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


def test_a_study(table, capsys):
    """The lost trial is named and the others are there; what is missing is done, and nothing else."""
    output = table.parent / "out"
    study = Motion("study", table, draws=60, reserve=1.0, output=output)
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
        Motion("study", table, draws=2, reserve=1.0, output=output)()


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
        ({"model": None}, "column 'model': needs an .osim file, got nothing"),
        ({"trial": "../one"}, "a name has letters"),
        ({"trial": "two"}, "has the trial 'two' twice"),
        ({"mass:nose": 2.0}, "factor mass:nose: 'nose' unknown; available: base"),
        ({"mass": -1.0}, "factor mass must be above 0 and finite, got -1"),
        ({"mass_spread": -0.1}, "the spread of mass must be at least 0 and finite, got -0.1"),
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
        Motion("study", table, draws=1, output=table.parent / "out")()
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_over_a_cluster_the_files_are_the_same(tmp_path):
    """Byte for byte; and what is there is not done again."""
    pytest.importorskip("ray")
    examples = Path(__file__).parents[2] / "examples"
    for name, options in (("here", {}), ("there", {"ray": True})):
        Motion(
            "study", examples / "arm_trials.csv", draws=60, reserve=1.0, output=tmp_path / name, **options
        )()
    files = sorted(path.relative_to(tmp_path / "here") for path in (tmp_path / "here").rglob("*.parquet"))
    assert len(files) == 8
    for file in files:
        assert (tmp_path / "here" / file).read_bytes() == (tmp_path / "there" / file).read_bytes(), file
    before = {file: (tmp_path / "there" / file).stat().st_mtime_ns for file in files}
    Motion("study", examples / "arm_trials.csv", draws=60, reserve=1.0, output=tmp_path / "there", ray=True)()
    assert before == {file: (tmp_path / "there" / file).stat().st_mtime_ns for file in files}
