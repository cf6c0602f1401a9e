"""Cohorts: each patient as if alone, results recomputed by hand, files read back, the command."""

import dataclasses
import os
import re
from functools import partial

import numpy as np
import pytest

from myowarp.apps.policies.hold import Hold
from myowarp.definitions.task import TASKS, Column
from myowarp.disk import locked
from myowarp.models.conditions.exoskeleton import Exoskeleton
from myowarp.models.conditions.fatigue_3ccr import Fatigue3CCR
from myowarp.models.conditions.load import Load
from myowarp.models.conditions.motor_noise import MotorNoise
from myowarp.models.conditions.sarcopenia import Sarcopenia
from myowarp.models.conditions.tendon_tear import TendonTear
from myowarp.models.conditions.tendon_transfer import TendonTransfer
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation

pd = pytest.importorskip("pandas")
pytest.importorskip("pyarrow")

from myowarp.apps.studies.cohort import run, run_cohort  # noqa: E402
from myowarp.apps.studies.cohort.job import repeated  # noqa: E402
from myowarp.apps.studies.parts import LOCK  # noqa: E402

ELBOW, HAND, REACH = "myoElbowPose1D6MRandom-v0", "myoHandPoseRandom-v1", "myoHandReachFixed-v0"
STEPS = 8

PATIENTS = pd.DataFrame(
    {
        "patient": ["Ada", "Ben", "Cleo", "Dan", "Eve"],
        "strength": [1.0, 0.4, 0.7, 0.2, 0.9],
        "fatigue_rate": [0.01, 0.5, 0.02, 0.03, 0.2],
        "load_mass": [0.0, 2.0, 5.0, 1.0, 0.5],
        "exo_assistance": [0.0, 0.5, 0.0, 1.0, 0.25],
        "noise_signal": [0.0, 0.0, 0.3, 0.1, 0.0],
        "tendon_tear": ["", "BRA", "BRA+TRIlat", None, "BIClong"],
        "tear_time": [0.0, 0.0, 0.06, 0.0, 0.1],
    }
)


def cohort(table, task=ELBOW, policy="hold", steps=STEPS, **options):
    return run_cohort(table, task, policy, steps, **{"device": "cpu"} | options)


@pytest.fixture(scope="module")
def five():
    return cohort(PATIENTS, seed=3, trials=2)


@pytest.mark.parametrize("who", [0, 2, 4])
def test_patients_are_as_if_alone(five, who):
    """Bit for bit, and each trial too."""
    alone = cohort(PATIENTS.iloc[[who]], seed=4, policy="hold")
    name = PATIENTS["patient"][who]
    for table in ("samples", "summary"):
        mine, other = getattr(alone, table), getattr(five, table)
        other = other[(other["patient"] == name) & (other["trial"] == 1)]
        columns = [column for column in mine if column not in ("patient", "trial")]
        pd.testing.assert_frame_equal(
            mine[columns].reset_index(drop=True), other[columns].reset_index(drop=True), check_exact=True
        )
    courses = five.samples.pivot_table(
        index="time", columns=["patient", "trial"], values="total_force", observed=True
    )
    assert len(np.unique(courses.to_numpy().round(4), axis=1).T) == 10


NEUTRAL = {"exo_assistance": 0.0, "load_mass": 0.0, "noise_signal": 0.0, "tendon_tear": "", "tear_time": ""}


@pytest.mark.parametrize("tiring", [{"fatigue_rate": 0.0}, {"force_loss_rate": 0.0}])
def test_columns_that_say_nothing_of_a_patient_change_nothing(tiring):
    """Bit for bit, and beside patients of whom they do say something."""
    patients = {"strength": [1.0, 0.4]}
    bare = cohort(pd.DataFrame(patients)).samples
    ill = {
        "exo_assistance": 0.5,
        "load_mass": 1.0,
        "noise_signal": 0.1,
        "tendon_tear": "BRA",
        "tear_time": 0.06,
    }
    rows = {name: [entry, entry, ill.get(name, 0.5)] for name, entry in (NEUTRAL | tiring).items()}
    full = cohort(pd.DataFrame({"strength": [1.0, 0.4, 0.4]} | rows)).samples
    columns = ["time", "tracking_error", "mean_activation", "total_force", "reward"]
    own = full[full["patient"] != full["patient"].iloc[-1]]
    pd.testing.assert_frame_equal(
        bare[columns].reset_index(drop=True), own[columns].reset_index(drop=True), check_exact=True
    )
    assert not np.allclose(full["total_force"][-STEPS:], bare["total_force"][-STEPS:], rtol=0.01)


def test_random_actions_are_a_trials_own():
    """The same for every patient, however many there are."""
    many = cohort(PATIENTS, policy="random", trials=3).samples
    alone = cohort(PATIENTS.iloc[[3]], policy="random", trials=2, seed=1).samples
    for trial in (0, 1):
        pd.testing.assert_series_equal(
            many[(many["patient"] == "Dan") & (many["trial"] == trial + 1)]["total_force"],
            alone[alone["trial"] == trial]["total_force"],
            check_exact=True,
            check_index=False,
        )


BEN = (
    Sarcopenia(0.4),
    Fatigue3CCR(fatigue_rate=0.5),
    Load(2.0),
    Exoskeleton(0.5, forearm_mass=0.111),
    MotorNoise(0.0, 0.0),
    TendonTear("BRA"),
)
CLEO = (
    Sarcopenia(0.7),
    Fatigue3CCR(fatigue_rate=0.02),
    Load(5.0),
    Exoskeleton(0.0, forearm_mass=0.0),
    MotorNoise(0.3, 0.0),
    TendonTear(("BRA", "TRIlat"), time=0.06),
)


@pytest.mark.parametrize(("name", "conditions"), [("Ben", BEN), ("Cleo", CLEO)])
def test_results_are_those_of_the_conditions_by_hand(five, name, conditions):
    """A simulation with this patient's conditions, without the table and without the tally."""
    sim = Simulation(
        TASKS[ELBOW], 1, device="cpu", conditions=conditions, progress=False, autoreset="disabled"
    )
    signals, policy = Signals(sim), Hold(sim.scene)
    sim.reset(seeds=np.array([3]))
    rows, fatigue, rewards, solved = [], None, [], []
    for step in range(1, STEPS + 1):
        sim.action.assign(policy(sim.transition.obs.numpy()))
        sim.step()
        error = np.abs(sim.shards[0].program.target.numpy() - signals.qpos.numpy())[0, 0]
        fatigue = (
            sim.shards[0].effects[[c.name for c in sim.conditions].index("fatigue_3ccr")].info["fatigue"]
        )
        muscles = signals.muscles
        rewards.append(float(sim.transition.reward.numpy()[0]))
        solved.append(bool(sim.transition.solved.numpy()[0]))
        row = (
            0.02 * step,
            error,
            muscles.activation.numpy().mean(),
            muscles.force.numpy().sum(),
            rewards[-1],
        )
        rows.append((*row, fatigue.numpy().mean()))
    mine = five.samples[(five.samples["patient"] == name) & (five.samples["trial"] == 0)]
    columns = ["time", "tracking_error", "mean_activation", "total_force", "reward", "fatigue"]
    np.testing.assert_allclose(mine[columns].to_numpy(dtype=float), np.array(rows), rtol=1e-6, atol=1e-9)
    assert mine["solved"].tolist() == solved
    summary = five.summary.set_index(["patient", "trial"]).loc[(name, 0)]
    errors = np.array(rows)[:, 1]
    assert summary["return"] == pytest.approx(sum(rewards))
    assert summary["mean_error"] == pytest.approx(errors.mean())
    assert summary["final_error"] == pytest.approx(errors[6:].mean())
    assert summary["mean_activation"] == pytest.approx(np.array(rows)[:, 2].mean())
    assert summary["fatigue"] == pytest.approx(rows[-1][-1])
    assert summary["success"] == (sum(solved) > 5)
    assert summary["success_last"] == solved[-1]
    assert summary["solved_share"] == np.mean(solved)
    assert summary["duration"] == pytest.approx(0.02 * STEPS)
    first = 0.02 * (1 + solved.index(True)) if any(solved) else np.nan
    assert summary["time_to_solve"] == pytest.approx(first, nan_ok=True)


def test_patients_with_hands():
    """Switches and muscles reach the right worlds: each patient as by hand."""
    table = pd.DataFrame({"tendon_transfer": [0, 1, 0], "tendon_tear": ["", "FPL", "EPL+OP"]})
    result = cohort(table, HAND, steps=3)
    bodies = ((), (TendonTransfer(1.0), TendonTear("FPL")), (TendonTear(("OP", "EPL")),))
    ends = []
    for conditions, (_, samples) in zip(bodies, result.samples.groupby("patient"), strict=True):
        sim = Simulation(TASKS[HAND], 1, device="cpu", conditions=conditions, progress=False)
        signals, policy = Signals(sim), Hold(sim.scene)
        sim.reset(seeds=np.array([0]))
        for row in samples.itertuples():
            sim.action.assign(policy(sim.transition.obs.numpy()))
            sim.step()
            errors = sim.shards[0].program.target.numpy() - signals.qpos.numpy()
            assert row.tracking_error == pytest.approx(np.linalg.norm(errors), rel=1e-5)
            assert row.total_force == pytest.approx(signals.muscles.force.numpy().sum(), rel=1e-5)
        ends.append((row.tracking_error, row.total_force))
    assert len(np.unique(np.round(ends, 4), axis=0)) == 3


def test_a_patient_with_neutral_entries_is_healthy():
    """Bit for bit; who has no assistance wears no exoskeleton."""
    neutral = {"strength": 1, "load_mass": 0, "exo_assistance": 0, "noise_signal": 0, "force_loss_rate": 0}
    sick = {"strength": 0.5, "load_mass": 3, "exo_assistance": 1, "noise_signal": 0.2, "force_loss_rate": 60}
    both = cohort(pd.DataFrame([neutral, sick]))
    healthy = cohort(pd.DataFrame({"patient": ["1"]}))
    assert healthy.settings["conditions"] == []
    columns = ["tracking_error", "mean_activation", "total_force", "reward"]
    first, second = (both.samples[both.samples["patient"] == name][columns] for name in ("1", "2"))
    np.testing.assert_array_equal(first, healthy.samples[columns])
    assert np.abs(second.to_numpy() - first.to_numpy()).max(axis=0).min() > 1e-3


def test_every_second_step_is_sampled():
    result, dense = cohort(PATIENTS, every=3), cohort(PATIENTS)
    kept = dense.samples[
        np.isclose(dense.samples["time"] % 0.06, 0) | np.isclose(dense.samples["time"] % 0.06, 0.06)
    ]
    pd.testing.assert_frame_equal(result.samples, kept.reset_index(drop=True), check_exact=True)
    pd.testing.assert_frame_equal(result.summary, dense.summary, check_exact=True)
    assert len(result.samples) == 2 * 5


def test_rows_end_with_the_episode():
    """At rest the hand fails to reach soon; what is torn changes when."""
    table = pd.DataFrame({"tendon_tear": ["", "FPL"], "tendon_transfer": [0, 1]})
    result = cohort(table, REACH, "zero", 40)
    summary = result.summary
    assert summary["failed"].all()
    for row in summary.itertuples():
        mine = result.samples[result.samples["patient"] == row.patient]
        assert mine["time"].max() == pytest.approx(row.duration)
        assert row.duration < 0.5
        assert row.final_error == mine["tracking_error"].iloc[-1] > 0.22
        assert (mine["tracking_error"].iloc[:-1] <= 0.22).all()
        assert row.mean_error == pytest.approx(mine["tracking_error"].mean())


def test_a_fault_is_named(monkeypatch):
    """A world whose state breaks ends; the others do not notice."""
    whole, step = cohort(PATIENTS), Simulation.step

    def breaking(sim):
        if sim.episode.step_count.numpy()[1] == 3:
            sim.scene.data.qvel.numpy()[1] = np.nan
        step(sim)

    monkeypatch.setattr(Simulation, "step", breaking)
    hurt = cohort(PATIENTS)
    assert hurt.summary["fault"].fillna("").tolist() == ["", "state not finite", "", "", ""]
    assert hurt.summary["duration"][1] == pytest.approx(0.06)
    assert np.isfinite(hurt.samples.select_dtypes("number").to_numpy()).all()
    others = whole.samples["patient"] != "Ben"
    pd.testing.assert_frame_equal(
        hurt.samples[hurt.samples["patient"] != "Ben"].reset_index(drop=True),
        whole.samples[others].reset_index(drop=True),
        check_exact=True,
    )


def test_files_read_back(five, tmp_path):
    folder = tmp_path / "new" / "results"
    paths = five.save(folder)
    assert sorted(p.name for p in folder.iterdir()) == ["results.parquet", "settings.json", "summary.csv"]
    pd.testing.assert_frame_equal(pd.read_parquet(paths[0]), five.samples)
    summary = pd.read_csv(paths[1])
    assert summary["patient"].tolist() == [name for name in PATIENTS["patient"] for _ in range(2)]
    assert summary["tendon_tear"].fillna("").tolist()[::2] == ["", "BRA", "BRA+TRIlat", "", "BIClong"]
    np.testing.assert_allclose(summary["final_error"], five.summary["final_error"])
    settings = pd.read_json(paths[2], typ="series")
    assert settings["units"]["final_error"] == "rad"
    assert settings["units"]["mean_exo_torque"] == settings["units"]["exo_torque"] == "N m"
    assert (settings["seed"], settings["trials"], settings["policy"]) == (3, 2, "hold")
    five.save(folder, ".csv")
    table = pd.read_csv(folder / "results.csv")
    np.testing.assert_allclose(table["total_force"], five.samples["total_force"])
    array = five.samples.set_index(["patient", "trial", "time"])["tracking_error"].unstack("time")
    assert array.shape == (10, STEPS)


def test_names_are_no_formulas_in_spreadsheets(tmp_path):
    """As OWASP has it: a single quote in front; a name that has one gets another."""
    names = ["=cmd|' /C calc'!A0", "'=cmd|' /C calc'!A0", "+1", "-1", "@sum", "Ada", "'Ada", "a=b"]
    found = cohort(pd.DataFrame({"patient": names, "strength": 1.0}), steps=1)
    found.save(tmp_path, ".csv")
    safe = ["'=cmd|' /C calc'!A0", "''=cmd|' /C calc'!A0", "'+1", "'-1", "'@sum", "Ada", "'Ada", "a=b"]
    for file in ("results.csv", "summary.csv"):
        assert pd.read_csv(tmp_path / file)["patient"].tolist() == safe
    assert found.summary["patient"].tolist() == names


@pytest.mark.parametrize(
    ("columns", "blocks", "unit"),
    [
        ([("qpos", 2, "rad"), ("pose_err", 3, "rad"), ("act", 1, "1")], [slice(2, 5)], "rad"),
        (
            [("target1_err", 3, "m"), ("act", 1, "1"), ("target2_err", 3, "m")],
            [slice(0, 3), slice(4, 7)],
            "m",
        ),
        ([("obj_err_pos", 3, "m"), ("obj_err_rot", 3, "1")], [slice(0, 3)], "m"),
        ([("qpos", 2, "rad"), ("terror", 1, "m")], [], ""),
    ],
)
def test_tracking_error_is_the_norm_of_observed_errors(columns, blocks, unit):
    assert run.tracking_blocks([Column(*column) for column in columns]) == (blocks, unit)


def test_a_task_without_an_error():
    result = cohort(pd.DataFrame({"strength": [1, 0.5]}), "myoHandKeyTurnFixed-v0", "random", 3)
    assert "tracking_error" not in result.samples
    assert "final_error" not in result.summary
    assert result.summary["total_force"][0] > 1.5 * result.summary["total_force"][1]


@pytest.fixture
def command(run):
    """Run `myowarp cohort`; see `run` in conftest."""
    return partial(run, "cohort")


def test_trials_that_are_one_are_said(five):
    """A return of one trial apart from the other is enough, of any patient."""
    assert repeated(five.summary) == ""
    twice = five.summary[five.summary["trial"] == 0]
    twice = pd.concat([twice, twice.assign(trial=1)])
    assert "one tells as much" in repeated(twice)
    other = twice.assign(**{"return": [*twice["return"][:-1], 0.0]})
    assert repeated(other) == repeated(twice[twice["trial"] == 0]) == ""


def test_command(command, five, tmp_path):
    """What the command writes is what `run_cohort` returns."""
    pytest.importorskip("matplotlib")
    PATIENTS.to_csv(tmp_path / "patients.csv", index=False)
    out = tmp_path / "results"
    arguments = (
        "--task",
        ELBOW,
        "--output",
        out,
        "--steps",
        STEPS,
        "--seed",
        3,
        "--trials",
        2,
        "--device",
        "cpu",
    )
    status, printed, err = command(tmp_path / "patients.csv", *arguments)
    assert status == 0, err
    names = [LOCK, "assistance.png", "plot.png", "results.parquet", "settings.json", "summary.csv"]
    assert sorted(path.name for path in out.iterdir()) == names
    pd.testing.assert_frame_equal(pd.read_parquet(out / "results.parquet"), five.samples)
    assert (out / "plot.png").read_bytes().startswith(b"\x89PNG")
    assert "error in the last quarter" in printed
    bare = 100 * five.summary.loc[five.summary["exo_assistance"] == 0.0, "success_last"].mean()
    assert re.search(rf"by exo_assistance +│ {bare:.0f} % \(0\), ", printed)
    assert "5 patients" in err


def test_a_failing_policy_leaves_nothing(command, tmp_path):
    policy = tmp_path / "policy.py"
    policy.write_text("def act(obs):\n    return obs[:, :3] * 0\n")
    PATIENTS.to_csv(tmp_path / "patients.csv", index=False)
    out = tmp_path / "results"
    status, _, err = command(
        tmp_path / "patients.csv",
        "--task",
        ELBOW,
        "--policy",
        f"{policy}:act",
        "--output",
        out,
        "--device",
        "cpu",
    )
    assert status == 2
    assert "actions must be floating point of shape (5, 6), got float32 of shape (5, 3)" in err
    assert [file.name for file in out.iterdir()] == [LOCK]


def test_a_folder_that_another_process_writes_into_is_left_alone(command, tmp_path, monkeypatch):
    """What the other one writes later is not there yet when this one begins."""
    monkeypatch.setattr(run, "Simulation", None)
    PATIENTS.to_csv(tmp_path / "patients.csv", index=False)
    with locked(tmp_path / LOCK, wait=False):
        status, _, err = command(
            tmp_path / "patients.csv", "--task", ELBOW, "--device", "cpu", "--output", tmp_path
        )
    assert status == 2
    assert f"folder '{tmp_path}' is in use by process {os.getpid()} on " in err
    assert "wait for it, or choose another --output" in err


def test_an_output_that_is_a_file(command, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "Simulation", None)
    PATIENTS.to_csv(tmp_path / "patients.csv", index=False)
    status, _, err = command(
        tmp_path / "patients.csv", "--task", ELBOW, "--output", tmp_path / "patients.csv"
    )
    assert status == 2
    assert "cannot be written; it must be a folder, or a new one, and writable" in err


def test_groups_of_patients():
    """Quarters of equal size; few entries and names by entry."""
    pytest.importorskip("matplotlib")
    from myowarp.apps.studies.cohort.plot import group_patients

    quarters = group_patients(pd.Series(np.random.default_rng(0).permutation(101) / 100))
    assert quarters.members.sum(axis=1).tolist() == [25, 25, 25, 26]
    assert quarters.labels == ["0.00–0.24", "0.25–0.49", "0.50–0.74", "0.75–1.00"]
    few = group_patients(pd.Series([0.0, 0.5, 0.0]))
    assert (few.labels, few.members.tolist()) == (["0", "0.5"], [[True, False, True], [False, True, False]])
    named = group_patients(pd.Series(["", "BRA", "BRA"]))
    assert (named.labels, named.members.sum(axis=1).tolist()) == (["none", "BRA"], [1, 2])
    tied = group_patients(pd.Series([0.0] * 90 + list(np.linspace(0.1, 1, 10))))
    assert tied.members.sum(axis=1).tolist() == [90, 3, 3, 4]
    assert tied.labels == ["0", "0.10–0.30", "0.40–0.60", "0.70–1.00"]


def test_means_of_what_conditions_show_are_those_of_the_samples(five):
    """`five` samples every step."""
    means = five.samples.groupby(["patient", "trial"], sort=False, observed=True)["exo_torque"].mean()
    assert means.abs().max() > 0.1
    np.testing.assert_allclose(five.summary["mean_exo_torque"], means, rtol=1e-5)


def test_effort_saved_by_a_newton_metre():
    """Two strengths, three levels, by hand: (effort without - effort) / |torque|, of the medians."""
    pytest.importorskip("matplotlib")
    from myowarp.apps.studies.cohort import assistance

    entries = [(s, a) for s in (0.5, 1.0) for a in (0.0, 0.5, 1.0) for _ in range(3)]
    summary = pd.DataFrame(entries, columns=["strength", "exo_assistance"])
    effort = {0.5: (0.40, 0.31, 0.20), 1.0: (0.20, 0.18, 0.16)}
    level = summary["exo_assistance"].map({0.0: 0, 0.5: 1, 1.0: 2})
    middle = np.array([effort[s][i] for s, i in zip(summary["strength"], level, strict=True)])
    summary["mean_activation"] = middle + np.tile((-0.01, 0.0, 0.05), 6)  # the median is the middle one
    summary["mean_exo_torque"] = -2.0 * summary["exo_assistance"]
    summary["final_error"] = 0.1
    settings = {"columns": ["strength", "exo_assistance"], "units": {"final_error": "rad"}}
    figure = assistance.assistance_map(summary, settings | {"task": ELBOW, "policy": "hold"})
    drawn = [axes for axes in figure.axes if axes.get_images()]
    found = drawn[2].get_images()[0].get_array().filled(np.nan)
    np.testing.assert_allclose(found[:, 1:], [[9.0, 10.0], [2.0, 2.0]])  # points per N m
    assert np.isnan(found[:, 0]).all()
    np.testing.assert_allclose(drawn[0].get_images()[0].get_array(), np.degrees(0.1))
    assert {text.get_text().split("\n")[0] for text in drawn[0].texts} == {"5.7"}
    said = " ".join(figure.get_supxlabel().split())
    assert "`hold` has no integral part" in said
    other = assistance.assistance_map(summary, settings | {"task": ELBOW, "policy": "baseline"})
    assert "integral" not in other.get_supxlabel()
    worst = np.array([axes.get_images()[0].cmap(1.0)[:3] for axes in drawn])
    assert (worst[:2, 0] > worst[:2, 2]).all(), "red outweighs blue where much is bad"
    assert worst[2, 2] > worst[2, 0], "and not where much is good"
    assert not assistance.crosses(summary[summary["exo_assistance"] > 0.0])


def test_the_heat_map_of_a_folder(five, tmp_path, run):
    pytest.importorskip("matplotlib")
    five.save(tmp_path / "cohort")
    picture = tmp_path / "assistance.png"
    status, _, err = run("plot", "assistance", tmp_path / "cohort", "-o", picture)
    assert status == 0, err
    assert picture.stat().st_size > 10_000
    (tmp_path / "empty").mkdir()
    status, _, err = run("plot", "assistance", tmp_path / "empty", "-o", tmp_path / "no.png")
    assert status == 2
    assert "plot assistance needs a folder that `myowarp cohort` wrote" in err
    narrow = dataclasses.replace(five, summary=five.summary.assign(strength=1.0))
    narrow.save(tmp_path / "narrow")
    status, _, err = run("plot", "assistance", tmp_path / "narrow", "-o", tmp_path / "no.png")
    assert status == 2
    assert "needs a cohort with several entries of strength" in err


@pytest.mark.parametrize("columns", [["patient"], ["patient", "strength"], list(PATIENTS)])
def test_pictures_of_any_cohort(five, tmp_path, columns):
    """One patient, no varied column, more columns than panels."""
    pytest.importorskip("matplotlib")
    from myowarp.apps.studies.cohort.plot import draw_cohort

    entries = [name for name in columns if name != "patient"]
    result = dataclasses.replace(five, settings=five.settings | {"columns": entries})
    draw_cohort(result, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 10_000
