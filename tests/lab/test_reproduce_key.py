"""The experiments of the hand, of validation, speed and learning: each runs once in its `--quick` form."""

import dataclasses
import json
from itertools import islice
from pathlib import Path

import mujoco
import numpy as np
import pytest
from rich.console import Console
from scipy import stats

from myowarp.apps.cli.options import Said
from myowarp.apps.cli.reproduce import Reproduce
from myowarp.apps.policies.baselines import load_baseline
from myowarp.apps.policies.checkpoint import CheckpointError, load_checkpoint
from myowarp.apps.rollouts.run import stepped
from myowarp.apps.studies.reproduce import (
    adaptation,
    baselines,
    conditions,
    grid,
    motor,
    speed,
    transfer,
    validation,
)
from myowarp.apps.studies.reproduce.catalog import EXPERIMENTS
from myowarp.apps.studies.reproduce.experiment import Lab
from myowarp.apps.studies.reproduce.policies import Training, committed, retrained
from myowarp.apps.studies.reproduce.report import FILES
from myowarp.definitions.body import BODIES
from myowarp.definitions.setup import Setup
from myowarp.sim.simulation import Simulation

pytest.importorskip("matplotlib").use("agg")

ROOT = Path(__file__).parents[2]
ARM26 = ROOT / "tests/data/osim/arm26.osim"


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Return the result of an experiment and its folder; it runs when it is first asked for."""
    done = {}

    def find(name, **options):
        if name not in done:
            folder = tmp_path_factory.mktemp(name)
            given = {"seeds": 1, "num_worlds": 2, "device": "cpu"} | options
            read = {key: value for key, value in given.items() if key not in EXPERIMENTS[name].ignores}
            setup = Setup(device=read.pop("device", None))
            Reproduce(Said(setup), name=name, quick=True, output=folder, **read)()
            assert all((folder / file).stat().st_size for file in FILES)
            assert not {"{", "}"} & set((folder / "page.md").read_text())  # every field was filled
            done[name] = json.loads((folder / "result.json").read_text()), folder
        return done[name]

    return find


def ours(result, quantity):
    """Return our means of a quantity by condition."""
    return {row["condition"]: row["ours"] for row in result["merits"] if row["quantity"] == quantity}


def claims(result):
    """Return what was found of each claim, by its first words."""
    return {claim["claim"][:40]: claim["verdict"] for claim in result["claims"]}


@pytest.mark.slow
def test_what_a_tear_takes_is_missed(found):
    """One policy of two worlds: nothing is decided; torn muscles of the thumb take what extensors do not."""
    result, _ = found("tear")
    rotation = ours(result, "rotation of the key, mean actions")
    assert rotation["without FPL"] < rotation["all muscles"] - 20.0
    assert min(rotation[who] for who in ("all muscles", "without EPB", "without APL")) > 180.0
    changes = ours(result, "rotation, change to all muscles, mean actions")
    for who, change in changes.items():
        assert change == pytest.approx(rotation[who] - rotation["all muscles"])
    assert "agrees" not in claims(result).values()


@pytest.mark.slow
def test_gains_of_adaptation_are_differences_in_the_same_episodes(found):
    """Whoever was trained on patients who change is no worse in them than who was not, save by chance."""
    result, folder = found("adaptation")
    after = ours(result, "solved after the change")
    for kind, over in (("blind", "baseline"), ("told", "blind"), ("memory", "blind")):
        for task, gain in ours(result, f"gain of {kind} over {over}").items():
            assert gain == pytest.approx(after[f"{task}, {kind}"] - after[f"{task}, {over}"])
            assert gain > -10.0 or kind != "blind"
    cases = {tuple(row["condition"].split(", ")[:2]) for row in result["merits"]}
    assert cases == set(adaptation.CASES)
    assert json.loads((folder / "result.json").read_text())["policies"] == "of the package"


def test_claims_of_adaptation_are_of_every_seed_of_a_change():
    """Memory gains 10 points with the device in both seeds, 10 and -1 after weakness."""
    rng, told = np.random.default_rng(0), {"weakness": (0.7, 0.8), "device": (0.75, 0.7)}
    shares = {}
    for change, of_memory in {"weakness": (0.7, 0.59), "device": (0.7, 0.7)}.items():
        means = [
            np.array([0.5, 0.6, of_told, m, 0.75]) for of_told, m in zip(told[change], of_memory, strict=True)
        ]
        shares[change] = [m[:, None] + rng.uniform(-0.05, 0.05, (5, 200)) for m in means]

    def one_run(share):
        return {
            "seconds": np.arange(3.0),
            "curves": np.ones((5, 3)),
            "shares": share,
            "falls": np.ones((5, 3)),
        }

    cases = {(adaptation.ELBOW, change): list(map(one_run, each)) for change, each in shares.items()}
    result = adaptation.findings(cases)
    assert result.holds == {"trained": True, "told": True, "memory": False, "kept": False}
    assert result.measured["memory"] == result.measured["kept"] == "elbow (device)"
    assert result.measured["told"] == "elbow (weakness), elbow (device)"
    row = {(row.quantity, row.condition): row for row in result.merits}
    gain = row["gain of memory over blind", f"{adaptation.ELBOW}, weakness"]
    pairs = [100.0 * (own[3] - own[1]) for own in shares["weakness"]]
    np.testing.assert_allclose(gain.values, np.mean(pairs, axis=1), atol=1e-9)
    low, high = stats.ttest_1samp(pairs[1], 0.0).confidence_interval()
    assert f"{pairs[1].mean():+.2f}, {low:.2f} to {high:.2f}" in gain.note


@pytest.mark.slow
def test_conditions_take_success_from_policies(found):
    """The elbow loses nothing, the key's turn what a torn FPL gave it."""
    result, _ = found("conditions", num_worlds=8)
    success = ours(result, "success")
    assert set(success) == {
        *(f"{conditions.QUICK_TASKS[0]}, {c}" for c in ("none", "sarcopenia", "fatigue", "exoskeleton")),
        *(f"{conditions.QUICK_TASKS[1]}, {c}" for c in ("none", *conditions.ADAPTED)),
    }
    key = {name: success[f"{conditions.QUICK_TASKS[1]}, {name}"] for name in ("none", "tear")}
    assert key["none"] > 80.0
    assert key["tear"] < 60.0
    assert success[f"{conditions.QUICK_TASKS[0]}, none"] == 100.0
    after = ours(result, "success after more training")
    assert set(after) == {f"{conditions.QUICK_TASKS[1]}, {name}" for name in ("none", "tear")}


@pytest.mark.slow
def test_the_grid_shows_the_policies_of_the_package(found):
    """The elbow's 24 cells; where nothing is changed the evaluation of the baseline holds."""
    result, folder = found("grid", num_worlds=8)
    success = ours(result, "success, the package's policy")
    assert set(success) == {cell.id for cell in grid.grid() if cell.family == "ElbowPose"}
    for task, cell in (("Fixed", "paperElbowPoseEasyF-v0"), ("Random", "paperElbowPoseHardF-v0")):
        baseline = load_baseline(f"myoElbowPose1D6M{task}-v0").runs[0]["evaluation"]["sampled"]
        assert success[f"MyoWarp/{cell}"] == pytest.approx(100.0 * baseline["success_myosuite"], abs=15.0)
    assert "24 of 24 cells" in (folder / "page.md").read_text()


def test_cells_of_the_grid_are_compared_by_their_reset():
    cells = [cell for cell in grid.grid() if (cell.family, cell.difficulty) == ("FingerPose", "easy")]
    healthy = {cell.reset: cell for cell in cells if cell.condition == "none"}
    counts = {"fixed": 200, "random": 100, "none": 196}
    shipped = {healthy[reset]: np.arange(200) < count for reset, count in counts.items()}
    trained = {healthy["random"]: np.arange(200) < 180, healthy["none"]: np.arange(200) < 190}
    found = grid.findings(cells, shipped, trained)
    assert found.holds == {"resets": False, "reset-free": True, "trained": True, "own": False}
    names = ("cells", "numbers", "empty", "pairs", "changed", "kept", "gained", "lost")
    assert [found.measured[name] for name in names] == [9, 3, 6, 2, 1, 1, 1, 0]


def test_work_of_motors_is_mujocos_torque_times_the_speed():
    """MuJoCo C's torques in the states that steps lead to; ours are those of 2 ms before."""
    sim = Simulation(Setup(task="motorFingerPoseFixed-v1", physics="parity", device="cpu"), 3, progress=False)
    sim.reset(seeds=np.arange(3))
    action = np.random.default_rng(0).uniform(-1.0, 1.0, (3, sim.scene.num_actions)).astype(np.float32)
    watched, work, host = motor.Movement(sim, lambda share: None), np.zeros(3), mujoco.MjData(sim.full_model)
    for step in islice(stepped(sim, lambda obs: action), 40):
        watched.see(step)
        qpos, qvel, ctrl = (getattr(sim.scene.data, name).numpy() for name in ("qpos", "qvel", "ctrl"))
        for world in range(3):
            host.qpos, host.qvel, host.ctrl = qpos[world], qvel[world], ctrl[world]
            mujoco.mj_forward(sim.full_model, host)
            power = np.maximum(host.qfrc_actuator * host.qvel, 0.0).sum()
            work[world] += power * sim.scene.control_dt
    assert work.min() > 1e-3
    np.testing.assert_allclose(watched.work, work, rtol=0.02)
    assert len(watched.velocity) == 20


@pytest.mark.slow
def test_fingers_are_compared_by_the_packages_policies(found):
    """Both hold the fixed posture; means of two seeds, whose samples are those of their trainings."""
    result, _ = found("motor", num_worlds=4)
    assert ours(result, "success, last step, means") == {
        "PoseFixed, muscles": 100.0,
        "PoseFixed, motors": 100.0,
    }
    for finger in motor.FINGERS:
        own = [committed(motor.training(finger, "PoseFixed"), seed).manifest["samples"] for seed in (0, 1)]
        taken = ours(result, "samples of the training")[f"PoseFixed, {finger}"]
        assert taken == pytest.approx(np.mean(own) / 1e6)
    assert "seeds" not in result


def test_one_kind_that_contradicts_decides_about_all_kinds():
    """Motors need fewer samples for the first, and the second is open; they accelerate less in both."""
    names = ("success", "kicked", "work", "acceleration", "samples")
    rows = {
        ("PoseFixed", "muscles"): ([99, 98, 99], [90, 90, 90], [8, 9, 8.5], [40, 41, 42], [1, 1.1, 1.2]),
        ("PoseFixed", "motors"): ([99, 99, 98], [90, 90, 90], [2, 2.1, 2.2], [10, 11, 12], [0.2, 0.2, 0.3]),
        ("PoseRandom", "muscles"): ([91, 95, 92], [80, 70, 95], [5, 5.1, 5.2], [20, 21, 22], [1, 3, 2]),
        ("PoseRandom", "motors"): ([97, 98, 99], [90, 70, 80], [7, 7.5, 7.1], [10, 11, 11], [2, 1, 2.5]),
    }
    found = motor.findings({k: dict(zip(names, map(np.array, v), strict=True)) for k, v in rows.items()})
    assert found.holds == {"learned": True, "samples": None, "smooth": False, "work": False, "robust": False}
    assert (found.measured["muscles"], found.measured["motors"]) == ("96", "98")
    assert found.measured["work"] == f"{(8.5 / 2.1 * 5.1 / 7.2) ** 0.5:.2g}"


def test_losses_are_judged_by_intervals():
    """Counts of 200 episodes: what is lost, gained and restored follows Newcombe's intervals."""
    task, other = conditions.QUICK_TASKS

    def runs(**successes):
        return {
            tuple(name.split("__")): {"success": np.arange(200) < count, "fault": np.zeros(200, int)}
            for name, count in successes.items()
        }

    def cells(**counts):
        found = runs(**counts)
        return {({"a": task, "b": other}[t], c): run for (t, c), run in found.items()}

    before = cells(a__none=200, a__sarcopenia=100, a__fatigue=196, b__none=190, b__tear=20)
    after = cells(a__none=200, a__sarcopenia=198, b__none=150, b__tear=60)
    found = conditions.findings(before, after)
    assert found.holds == {
        "harmed": True,
        "every": False,
        "gained": True,
        "restored": False,
        "control": False,
    }
    assert [found.measured[name] for name in ("pairs", "harmed", "spared", "gained", "restored")] == [
        *(3, 2, 1, 2, 1)
    ]
    assert found.measured["worst"] == f"{other} under tear"
    assert found.measured["worst_loss"] == pytest.approx(85.0)
    assert found.measured["short"] == f"{other} (tear)"
    open_ = conditions.findings(cells(a__none=200, a__tear=178), {})
    assert open_.holds["every"] is None  # 11 points, 7 to 16: neither less than 10 nor more
    assert open_.holds["gained"] is None


def test_a_finished_tear_is_not_run_again(found, monkeypatch):
    result, folder = found("tear")
    monkeypatch.setattr("myowarp.apps.studies.reproduce.key.Simulation", None)
    Reproduce(Said(Setup(device="cpu")), name="tear", quick=True, output=folder, seeds=1, num_worlds=2)()
    assert json.loads((folder / "result.json").read_text())["merits"] == result["merits"]


@pytest.mark.slow
def test_retraining_turns_the_key_again(found):
    result, _ = found("transfer")
    rotation = ours(result, "rotation of the key, mean actions")
    assert rotation["intact"] > 180.0
    assert rotation["transfer"] < rotation["transfer, retrained"]


def test_pairs_that_changed_places():
    first = np.array([0.1, 0.2, 0.3, 0.4])
    assert transfer.exchanged(first, first + 1.0) == 0
    assert transfer.exchanged(first, first[::-1]) == 6
    assert transfer.exchanged(first, np.array([0.2, 0.1, 0.3, 0.4])) == 1
    assert (
        transfer.exchanged(first, np.array([np.nan, 0.4, 0.3, 0.2])) == 3
    )  # what is not recruited has no place


# Two bars of lengths a and b on a hinge, a tendon between their ends: l^2 = a^2 + b^2 - 2 a b cos(q - c).
A, B, C, FMAX = 0.2, 0.05, -0.3, 300.0
HINGE = f"""
<mujoco><compiler angle="radian"/><worldbody><site name="a" pos="{A * np.cos(C)} {A * np.sin(C)} 0"/><body>
<joint name="q" axis="0 0 1"/><geom size="0.01" mass="1"/><site name="b" pos="{B} 0 0"/></body></worldbody>
<tendon><spatial name="t"><site site="a"/><site site="b"/></spatial></tendon> <actuator><muscle name="m"
tendon="t" force="{FMAX}" lengthrange="0.15 0.25" range="0.75 1.05" lmin="0.5" lmax="1.6"/>
</actuator></mujoco>"""


def closed_form(angle):
    """Return length and moment arm of the tendon."""
    length = np.sqrt(A * A + B * B - 2.0 * A * B * np.cos(angle - C))
    return length, -A * B * np.sin(angle - C) / length


def test_curves_are_those_of_a_crossbow():
    model = mujoco.MjModel.from_xml_string(HINGE)
    angle = np.linspace(0.2, 2.6, 15)
    length, arm, force = validation.curves(model, 0, angle, (0.0, 0.5, 1.0))
    expected_length, expected_arm = closed_form(angle)
    np.testing.assert_allclose(length[:, 0], expected_length, atol=1e-12)
    np.testing.assert_allclose(arm[:, 0], expected_arm, atol=1e-9)
    # Fibers run from 0.75 to 1.05 of their optimum over 0.1 m; below it the gain is a parabola.
    norm = 0.75 + 0.3 * (expected_length - 0.15) / 0.1
    middle = (norm >= 0.75) & (norm <= 1.0)
    assert middle.sum() >= 5
    gain = 1.0 - 0.5 * ((1.0 - norm[middle]) / 0.25) ** 2
    np.testing.assert_allclose(force[middle, :, 0], FMAX * np.outer(gain, (0.0, 0.5, 1.0)), atol=1e-9)


def crossbow_record(angle, arm, length, force, passive):
    """Return a record as OpenSim's, of one muscle."""
    row = {"muscle": "m", "coordinate": "q", "max_isometric_force": FMAX, "length": length.tolist()}
    row |= {"moment_arm": arm.tolist(), "slope": arm.tolist(), "force": force.tolist()}
    row["passive"] = passive.tolist()
    return {"ranges": {"q": (angle[0], angle[-1])}, "curves": [row]}


def test_differences_are_root_mean_squares():
    model = mujoco.MjModel.from_xml_string(HINGE)
    angle = np.linspace(0.2, 2.6, 15)
    length, arm = closed_form(angle)
    passive, force = np.split(validation.curves(model, 0, angle, (0.0, 1.0))[2][:, :, 0], [1], axis=1)
    passive = passive[:, 0]
    assert passive.max() > 0.01 * FMAX
    record = crossbow_record(
        angle, arm + 3e-3 * np.sign(angle - 1.6), length, force + 0.1 * FMAX, 2.0 * passive
    )
    (pair,) = validation.pairs(model, record, {"q": ("q", 1.0)}, {"m": "m"}, (1.0,), 15)
    assert pair.arm_rms == pytest.approx(3.0, rel=1e-5)
    assert validation.force_rms([pair])["m"] == pytest.approx(10.0, rel=1e-9)
    expected = 100.0 * np.sqrt(np.mean((passive / FMAX) ** 2))
    assert validation.force_rms([pair], passive=True)["m"] == pytest.approx(expected, rel=1e-9)
    assert not validation.pairs(model, record, {"q": ("q", 1.0)}, {}, (1.0,), 15)
    # A coordinate that counts the other way round has the mirrored curve.
    record = crossbow_record(-angle[::-1], -arm[::-1], length[::-1], force[::-1], passive[::-1])
    (same,), (other,) = (
        validation.pairs(model, record, {"q": ("q", sign)}, {"m": "m"}, (1.0,), 15) for sign in (-1.0, 1.0)
    )
    assert same.arm_rms < 1e-5
    assert other.arm_rms > 1.0


@pytest.mark.slow
def test_validation_has_the_sign_and_size_of_the_paper(found):
    result, _ = found("validation", models=(ARM26,))
    arms = ours(result, "moment arms, RMS difference")
    assert arms["elbow"] < 0.1
    assert arms["arm26, our converter"] < 0.1
    assert 1.0 < arms["hand"] < sum(validation.PAPER_ARM["MoBL_ARMS"])
    forces = ours(result, "static force, RMS difference")
    assert forces["arm26, our converter"] < sum(validation.PAPER_FORCE["arm26"]) < forces["elbow"]
    assert forces["hand, muscles within their range"] < forces["hand"]
    plain = "arm26, our converter without its fits"
    assert arms[plain] > 10.0 * arms["arm26, our converter"]
    assert forces[plain] > 2.0 * forces["arm26, our converter"]
    assert ours(result, "markers, RMS distance")["arm26, our converter, 3 markers"] < 1e-3


def test_a_marker_in_another_place_is_seen():
    """OpenSim's paths, beside a model of our own whose marker sits on a crossbow's arm."""
    xml = HINGE.replace("<worldbody>", '<worldbody><body name="ground"/>')
    model = mujoco.MjModel.from_xml_string(xml)
    angle = np.linspace(0.2, 2.6, validation.recorded()["points"])
    b = A * np.ones(3)  # replaced below by where MuJoCo C has the site
    data, paths = mujoco.MjData(model), []
    for value in angle:
        data.qpos[0] = value
        mujoco.mj_kinematics(model, data)
        paths.append(data.site("b").xpos.copy())
    record = {"ranges": {"q": (0.2, 2.6)}, "markers": {"q": {"b": (np.array(paths) + 3e-3 * b / A).tolist()}}}
    (path,) = validation.markers(model, record, {"q": ("q", 1.0)})
    assert path.apart == pytest.approx(3.0 * np.sqrt(3.0), rel=1e-6)


def test_the_hands_deviation_is_counted_the_other_way_round():
    record, model = validation.recorded(), BODIES["hand"].build().compile()
    names = validation.muscles_of(model, record["models"]["MoBL_ARMS"], "_r")
    assert names["FDSL"] == "FDS5_r"
    assert names["FCR"] == "FCR_r"
    means = []
    for sign in (-1.0, 1.0):
        joints = validation.JOINTS | {"deviation": ("deviation_r", sign)}
        found = validation.pairs(model, record["models"]["MoBL_ARMS"], joints, names, (0.5, 1.0), 21)
        means.append(np.mean([pair.arm_rms for pair in found if pair.coordinate == "deviation"]))
    assert means[0] < 0.4 * means[1]


def test_validation_refuses_other_models(tmp_path):
    gait = ROOT / "tests/data/osim/gait10dof18musc.osim"
    with pytest.raises(
        ValueError, match=r"--models compares arm26 and MoBL_ARMS, got '.*gait10dof18musc\.osim'"
    ):
        Reproduce(Said(Setup()), name="validation", output=tmp_path, models=(gait,))()
    with pytest.raises(ValueError, match="is no file; give the path of"):
        Reproduce(Said(Setup()), name="validation", output=tmp_path, models=(tmp_path / "none.osim",))()


@pytest.mark.slow
def test_speed_grows_with_the_muscles(found):
    result, _ = found("speed")
    table = json.loads(speed.RECORD.read_text())["models"]["arm26"]["copies"]
    over = ours(result, "times as fast as OpenSim")
    for copies, muscles in (("1", 6), ("64", 384)):
        rounds = [
            table[copies]["MuJoCo C, 1 thread"]["over_opensim"][key] for key in ("median", "min", "max")
        ]
        assert over[f"arm26, {muscles} muscles, MuJoCo C, 1 thread"] == pytest.approx(np.mean(rounds))
    assert [claim["verdict"] for claim in result["claims"]] == ["agrees", "differs", "differs", "holds"]


def test_samples_until_it_is_learned():
    curve = np.array([1e6, 2e6, 3e6]), np.array([0.2, 0.95, 0.4])
    assert baselines.samples_to(curve) == 2.0
    assert np.isnan(baselines.samples_to(curve, 0.99))


@pytest.mark.slow
def test_success_is_that_of_the_evaluations(found):
    result, _ = found("baselines")
    for task in baselines.baseline_tasks():
        runs = load_baseline(task).runs
        for mode in ("deterministic", "sampled"):
            own = np.mean([100.0 * run["evaluation"][mode]["success_myosuite"] for run in runs])
            if task in baselines.TASKS:
                assert ours(result, f"success, {mode} actions")[task] == pytest.approx(own)
    needed = ours(result, "samples to 90 % in training")
    assert needed["myoElbowPose1D6MFixed-v0"] < needed["myoElbowPose1D6MRandom-v0"]
    assert len([name for name in needed if name.endswith("TRPO")]) >= 4


def test_the_papers_curves_end_where_its_table_does():
    published = json.loads((ROOT / "benchmarks/published_success.json").read_text())["tasks"]
    curves, checked = baselines.curves_of(baselines.NPG), 0
    for task in baselines.TASKS:
        if shown := published[task].get("npg"):
            ends = [round(100.0 * success[-1]) for _, success in curves[task]]
            assert shown.startswith(", ".join(map(str, ends))), task
            checked += 1
    assert checked == 16


def test_a_policy_is_trained_on_from_its_parent(tmp_path):
    pytest.importorskip("torch")
    small = {"num_worlds": 8, "rollout_steps": 8}
    parent = Training("parent", "myoElbowPose1D6MFixed-v0", samples=640, settings=small)
    given = small | {"value_first": 1}
    child = Training("child", parent.task, samples=640, settings=given, parent=parent)
    folder = tmp_path / "policies" / "child" / "0"
    found = retrained(child, Setup(seed=0, device="cpu"), folder, Console(stderr=True), quick=True)
    before = load_checkpoint(tmp_path / "policies" / "parent" / "0")
    assert found.manifest["parent"]["task"] == parent.task
    # In the one iteration that it had, the value function alone learned.
    for name, array in found.policy.items():
        if name.startswith("net."):
            np.testing.assert_array_equal(array, before.policy[name])


def test_policies_of_the_trainer_before_are_not_trained_on(tmp_path, monkeypatch):
    """Settings of baselines that it made are none of today's."""
    own = load_baseline(conditions.QUICK_TASKS[0])
    manifest = {name: entry for name, entry in own.checkpoint.manifest.items() if name != "learner"}
    old = dataclasses.replace(own, checkpoint=dataclasses.replace(own.checkpoint, manifest=manifest))
    monkeypatch.setattr(conditions, "baseline_of", lambda task: old)
    lab = Lab(tmp_path, (0,), 4, quick=True, retrain=True, setup=Setup(device="cpu"))
    with pytest.raises(CheckpointError, match=f"^baseline {own.task!r} is of the trainer before this one"):
        conditions.run(lab)


def test_trpo_is_trained_again(tmp_path, monkeypatch):
    """Its curves are those of the runs' folders."""
    pytest.importorskip("torch")
    elbow = baselines.QUICK_TASKS[1]
    monkeypatch.setattr(baselines, "SAMPLES", 10 * 4 * 2048)
    monkeypatch.setattr(baselines, "QUICK_TASKS", [elbow])
    lab = Lab(
        tmp_path, (0,), 4, quick=True, retrain=True, setup=Setup(device="cpu"), console=Console(quiet=True)
    )
    ((samples, success),) = baselines.trpo(lab)[elbow]
    assert samples[-1] == 4 * 2048
    assert ((success >= 0.0) & (success <= 1.0)).all()
