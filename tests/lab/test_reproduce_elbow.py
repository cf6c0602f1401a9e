"""The frame of `myowarp reproduce`, and the elbow's experiments: each runs once in its `--quick` form."""

import importlib.util
import json
import re
import sys

import mujoco
import numpy as np
import pytest
from often import often
from rich.console import Console

from benchmarks import experiments
from myowarp.apps.cli.options import Said
from myowarp.apps.cli.reproduce import Reproduce
from myowarp.apps.policies.checkpoint import CheckpointError
from myowarp.apps.studies.reproduce import (
    arm,
    cohort_exo,
    endurance,
    exo1,
    exo2,
    key,
    recovery,
    sarcopenia,
    transfer,
    validation,
)
from myowarp.apps.studies.reproduce.catalog import EXPERIMENTS
from myowarp.apps.studies.reproduce.policies import FOLDER, Training, committed, retrained
from myowarp.apps.studies.reproduce.report import FILES, output_folder
from myowarp.definitions.body import BODIES
from myowarp.definitions.setup import Setup
from myowarp.extras import to_install
from myowarp.models.bodies.arm_muscles import ELBOW_EXTENSOR, ELBOW_FLEXOR
from myowarp.models.conditions import Exoskeleton, Load
from myowarp.sim.signals import Signals

pytest.importorskip("matplotlib").use("agg")

ELBOW = [
    name
    for name in EXPERIMENTS
    if {"arms", "run_groups"} & vars(sys.modules[EXPERIMENTS[name].run.__module__]).keys()
]
POLICIES = (
    *(arm.HEALTHY, arm.SARCOPENIC, arm.FATIGUED, arm.ASSISTED, arm.MOTOR, arm.THRIFTY),
    *(key.INTACT, transfer.TRANSFER, transfer.REDIRECT),
)
MAX_POLICY_BYTES, MAX_HAND_BYTES = 100_000, 150_000
G = 9.81


def command(name, folder, **options):
    """Run a command in its quick form, with one seed and few worlds."""
    given = {"seeds": 1, "num_worlds": 4, "device": "cpu"} | options
    read = {key: value for key, value in given.items() if key not in EXPERIMENTS[name].ignores}
    setup = Setup(device=read.pop("device", None))
    Reproduce(Said(setup), name=name, quick=True, output=folder, **read)()


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Return what an experiment found, and the folder; it runs when it is first asked for."""
    done = {}

    def find(name):
        if name not in done:
            folder = tmp_path_factory.mktemp(name)
            command(name, folder)
            done[name] = folder, json.loads((folder / "result.json").read_text())
        return done[name]

    return find


def values(result, quantity):
    """Return our means of a quantity by condition, in the order of the table."""
    rows = {row["condition"]: row["ours"] for row in result["merits"] if row["quantity"] == quantity}
    assert rows, quantity
    return rows


@pytest.mark.parametrize("name", often(ELBOW, ("exo1",)))
def test_an_experiment_writes_all_it_should(name, found):
    folder, result = found(name)
    assert {path.name for path in folder.iterdir()} == {*FILES, "runs"}
    assert (folder / "figure.png").stat().st_size > 20_000
    page = (folder / "page.md").read_text()
    for row in result["merits"]:
        assert row["quantity"] in page
        if row["paper"] is not None and row["ours"] is not None:
            assert row["difference"] == pytest.approx(row["ours"] - row["paper"])
    assert all(claim["claim"] in page for claim in result["claims"])
    assert EXPERIMENTS[name].paper in page
    assert not {"{", "}"} & set(page)  # every field of the essay was filled
    assert len((folder / "table.csv").read_text().splitlines()) == len(result["merits"]) + 1


@pytest.mark.slow
def test_a_run_is_not_repeated(found, tmp_path, monkeypatch):
    """Its arrays come from the folder; other settings and damaged files are refused, or replaced if asked."""
    folder, result = found("exo1")
    monkeypatch.setattr(arm, "follow", None)
    command("exo1", folder)
    assert json.loads((folder / "result.json").read_text()) == result
    with pytest.raises(ValueError, match=r"other settings \(num_worlds is 4 there and 5 here\); choose"):
        command("exo1", folder, num_worlds=5)
    run, _ = sorted((folder / "runs").iterdir())
    whole = run.read_bytes()
    run.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"is damaged \(.*\); delete it, or pass --overwrite"):
        command("exo1", folder)
    with pytest.raises(TypeError):  # it is measured again
        command("exo1", folder, overwrite=True)
    run.write_bytes(whole)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("exo3",), "experiment 'exo3' unknown; did you mean exo2, exo1?"),
        ((), "reproduce needs an experiment; available: validation, speed"),
        (("exo1", "--seeds", 0), "--seeds must be at least 1, got 0"),
        (
            ("exo1", "--seeds", 9),
            "policy 'assisted' of seed 5 does not come with the package, which has seeds 0,",
        ),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(arguments, sentence, run, tmp_path):
    status, _, err = run("reproduce", *arguments, "--output", tmp_path, "--device", "cpu")
    assert status == 2
    assert sentence in " ".join(err.split())


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_options_that_an_experiment_does_not_read_are_refused(name, tmp_path):
    given = {"seeds": 2, "num_worlds": 3, "retrain": True, "models": (tmp_path,)}
    assert EXPERIMENTS[name].ignores
    for option in EXPERIMENTS[name].ignores:
        said = Setup(device="cpu" if option == "device" else None)
        read = {key: value for key, value in given.items() if key == option}
        flag = option.replace("_", "-")
        with pytest.raises(ValueError, match=f"{name}' does not read --{flag}; leave it out"):
            Reproduce(Said(said), name=name, output=tmp_path / "out", **read)()
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("package", ["matplotlib", "scipy"])
def test_what_is_not_installed_is_named(package, monkeypatch, tmp_path):
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == package else find(name))
    said = f"reproduce needs {package}, which is not installed; run {to_install('plot')}"
    with pytest.raises(ImportError, match=re.escape(said)):
        Reproduce(Said(Setup()), name="speed", output=tmp_path / "out")()
    assert not (tmp_path / "out").exists()


def test_list_names_every_experiment(run):
    status, out, _ = run("reproduce", "--list")
    assert status == 0
    assert all(name in out for name in EXPERIMENTS)


def test_policies_are_small_and_of_five_seeds():
    for training in POLICIES:
        for seed in range(5):
            manifest = committed(training, seed).manifest
            assert manifest["settings"]["seed"] == seed
            assert manifest["samples"] >= training.samples or training is key.INTACT  # which stops early
            assert manifest["conditions"] == [condition.name for condition in training.conditions()]
            assert manifest["task"] == training.task
            effort = training.task_fields.get("effort_weight", 1.0)
            assert training.task != arm.TASK or dict(manifest["contract"]["reward"])["act_reg"] == effort
            folder = FOLDER / training.name / str(seed)
            most = MAX_POLICY_BYTES if training.task == arm.TASK else MAX_HAND_BYTES
            assert sum(path.stat().st_size for path in folder.iterdir()) < most


def test_a_policy_is_trained_again(tmp_path):
    """Its conditions act in the training; a finished one is taken; another one's folder is refused."""
    pytest.importorskip("torch")
    console = Console(quiet=True)
    settings = {"num_worlds": 4, "hidden": (8,)}
    training = Training("x", arm.TASK, arm.ASSISTED.conditions, 2560, settings)

    def train(seed):
        return retrained(training, Setup(seed=seed, device="cpu"), tmp_path, console, quick=True)

    first = train(3)
    assert first.manifest["samples"] == 256
    assert first.manifest["conditions"] == ["exoskeleton"]
    assert train(3).folder == first.folder
    with pytest.raises(CheckpointError, match=r"with seed 3, ppo in .* with seed 4 is needed; choose"):
        train(4)


def gravity_torque(model, angle, masses):
    """Return what gravity does about the elbow at an angle: sum m g l sin, l sin the horizontal distance.

    masses: mass [kg] and center in the frame of the forearm [m].
    """
    data = mujoco.MjData(model)
    data.qpos[0] = angle
    mujoco.mj_kinematics(model, data)
    joint, body = model.joint("r_elbow_flex"), model.body("r_ulna_radius_hand").id
    axis, anchor = data.xaxis[joint.id], data.xanchor[joint.id]
    torque = 0.0
    for mass, center in masses:
        lever = data.xpos[body] + data.xmat[body].reshape(3, 3) @ center - anchor
        torque += axis @ np.cross(lever, (0.0, 0.0, -mass * G))
    return torque


def test_a_hold_carries_the_moment_of_the_load():
    """Muscles and exoskeleton together, (1 + 1 / a) times its torque, balance m g l sin of all that hangs."""
    loads, assistance = np.repeat([0.0, 1.0, 2.0], 2), np.tile([0.5, 1.0], 3)
    sim = arm.arms((Load(loads), Exoskeleton(assistance)), 6, Setup(device="cpu"))
    policies = [(committed(arm.ASSISTED, 0), slice(None))]
    trace = arm.follow(Signals(sim), policies, np.arange(6), np.array([[60.0]]), 8.0)
    angle, torque = np.radians(trace.angle[-1]), trace.shown["exo_torque"][-1]
    for world in range(6):
        hanging = [
            (1.534315, (0.0, -0.181479, 0.0)),  # forearm and hand; tasks.md of the model, section 2.2
            (loads[world], (0.05, -0.35, 0.07)),
            (0.1, (0.0, -0.12, 0.035)),  # cuff, bar and hinge
            (0.01, (0.0, -0.05, 0.06)),
            (0.001, (0.0, 0.0, 0.05)),
        ]
        needed = -gravity_torque(sim.scene.oracle, angle[world], hanging)
        assert torque[world] * (1.0 + 1.0 / assistance[world]) == pytest.approx(needed, rel=0.01)
    assert torque[5] > 2.0 * torque[1]  # what is tested depends on the load


def held_for(load, rates, dt=0.01, longest=2000.0):
    """Return how long 3CC-r holds a load, by integration: all three compartments, float64."""
    active, fatigued, t = load, 0.0, 0.0
    while t < longest:
        fatigued += dt * (rates.fatigue_rate * active - rates.recovery_rate * fatigued)
        t += dt
        if 1.0 - fatigued < load:
            return t
    return np.inf


@pytest.mark.parametrize("rates", [ELBOW_FLEXOR, ELBOW_EXTENSOR], ids=["flexor", "extensor"])
@pytest.mark.parametrize("load", [0.2, 0.4, 0.6, 0.8])
def test_endurance_is_that_of_the_differential_equation(load, rates):
    assert endurance.closed_form(load, rates) == pytest.approx(held_for(load, rates), rel=2e-3)


@pytest.mark.slow
def test_endurance_in_the_simulation_and_in_people(found):
    """Half of the maximum: 83 s in people (Frey Law, Avin 2010); the simulation holds what the rates say."""
    _, result = found("fatigue")
    assert endurance.measured(0.5) == pytest.approx(83.0, abs=0.5)
    own = values(result, "endurance of 3CC-r")
    exact = {load: endurance.closed_form(load, ELBOW_FLEXOR) for load in (0.5, 0.6, 0.7, 0.8)}
    for load, seconds in exact.items():
        assert own[f"flexors hold {100 * load:.0f} %"] == pytest.approx(seconds, rel=0.02)
        assert 0.5 < seconds / endurance.measured(load) < 2.0
    assert own["flexors hold 20 %"] is None
    assert endurance.closed_form(0.2, ELBOW_FLEXOR) == np.inf


def test_assistance_relieves_every_flexor(found):
    _, result = found("exo1")
    for quantity in ("activation", "force"):
        for muscle in arm.FLEXORS:
            changes = values(result, f"change of {quantity}, {muscle}")
            assert changes[f"{exo1.BRACE}, 2 kg"] < -10.0
            assert changes[f"{exo1.DRIVEN}, 2 kg"] < -10.0
    by_level = list(values(result, "change of force, mean of the flexors").values())
    assert 0.0 > by_level[0] > by_level[1] > by_level[2] > -100.0
    error = values(result, "error of the elbow angle")
    own = {who: f"{exo1.BRACE}, {who} assistance" for who in ("2 kg, with", "2 kg, without", "0 kg, without")}
    assert error[own["2 kg, with"]] < error[own["2 kg, without"]]
    assert error[own["2 kg, without"]] > error[own["0 kg, without"]]


@pytest.mark.slow
def test_weak_and_tiring_arms_err_more(found):
    _, result = found("exo2")
    error = values(result, "error of the elbow angle")
    for with_ in ("with", "without"):
        normal, weak, tired = (
            error[f"{exo1.BRACE}, {who}, {with_} assistance"] for who in ("normal", "sarcopenia", "fatigue")
        )
        assert normal < weak < tired
    # What flexors save is half of the weight, over weight and passive pull of the triceps: 2.7 and 3.6 N m.
    gravity, (ours, theirs) = exo2.gravity_torque(), validation.passive_torque(np.pi / 2)
    assert gravity == pytest.approx(2.728, abs=2e-3)
    assert exo2.ideal_change(-ours, gravity) == pytest.approx(-100.0 * 1.364 / (2.728 + 3.597), abs=0.2)
    # OpenSim 4.6, arm26 at 90 degrees: the passive fiber of TRIlong pulls with 72.28 N at 19.9 mm.
    assert theirs == pytest.approx(-72.28 * 0.0199, rel=5e-3)
    change = values(result, "change of force, mean of the flexors")
    assert change[f"{exo1.BRACE}, normal"] == pytest.approx(-21.6, abs=5.0)
    lost = {
        who.removeprefix(f"{exo1.BRACE}, "): value
        for who, value in values(result, "peak force lost, mean of the flexors").items()
    }
    assert lost["fatigue, with assistance"] < lost["fatigue, without assistance"]
    assert lost["fatigue, k = 1/min, without assistance"] < 10.0 < lost["fatigue, without assistance"]


def test_a_motor_without_command_is_no_motor():
    """Arms whose motor gets nothing move as arms without one do under the same muscles."""
    policy, targets = committed(arm.MOTOR, 0), np.array([[60.0]])
    traces = []
    for still in (np.array([True, False]), None):
        sim = arm.arms((Exoskeleton(motor=True, forearm_mass=0.0),), 2, Setup(device="cpu"))
        follow = arm.follow(
            Signals(sim), [(policy, slice(None))], np.zeros(2, int), targets, 1.0, still=still
        )
        traces.append(follow)
    off, on = traces
    assert np.abs(off.shown["exo_torque"][:, 0]).max() == 0.0
    np.testing.assert_array_equal(off.angle[:, 1], on.angle[:, 0])
    assert np.abs(off.angle[-1, 0] - on.angle[-1, 0]) > 0.5


@pytest.mark.slow
def test_a_weak_arm_works_harder(found):
    _, result = found("sarcopenia")
    for quantity in ("error of the elbow angle", "effort, mean activation of the six muscles"):
        rows = values(result, quantity)
        for angles in ("30 to 90°", "20 to 110°", "60 to 120°"):
            assert rows[f"weak, {angles}"] > 1.1 * rows[f"healthy, {angles}"]


def test_shares_of_least_norm_are_those_of_a_pseudoinverse():
    """Of MuJoCo C's joint torques, muscle by muscle, 30 to 90 degrees."""
    model = BODIES["elbow"].build().compile()
    data, shares = mujoco.MjData(model), []
    for angle in np.linspace(30.0, 90.0, 13):
        torque = []
        for active in np.vstack((np.zeros(6), np.eye(6)[3:])):
            data.qpos[:], data.act[:] = np.radians(angle), active
            mujoco.mj_forward(model, data)
            torque.append(data.qfrc_actuator[0])
        activation = np.linalg.pinv(np.subtract(torque[1:], torque[0])[None]) @ [10.0]
        shares.append(activation / activation.sum())
    assert [model.actuator(i).name for i in range(3, 6)] == list(arm.FLEXORS)
    np.testing.assert_allclose(sarcopenia.least_norm(), np.mean(shares, axis=0), atol=1e-6)
    assert np.ptp(np.mean(shares, axis=0)) > 0.1


@pytest.mark.slow
def test_a_dearer_effort_is_a_smaller_one(found):
    _, result = found("sarcopenia")
    effort = values(result, "effort, mean activation of the six muscles")
    assert effort["healthy, effort × 10, 30 to 90°"] < 0.9 * effort["healthy, 30 to 90°"]
    shares = [values(result, f"share of {muscle}") for muscle in arm.FLEXORS]
    for who in ("healthy, 30 to 90°", "healthy, effort × 10, 30 to 90°"):
        assert sum(row[who] for row in shares) == pytest.approx(1.0)


@pytest.mark.slow
def test_fatigue_raises_the_error(found):
    _, result = found("fatigue")
    first, last = (values(result, f"error, {which} repetition") for which in ("first", "last"))
    assert last["k = 1/s"] > 1.2 * last["fresh"]
    assert last["k = 1/s"] > first["k = 1/s"]
    lost = values(result, "fatigue at the end, mean of the flexors")
    assert lost["fresh"] == 0.0
    assert 1.0 < lost["3CC-r"] < lost["3CC-r, 2 kg"] < lost["k = 1/s"]


def test_what_a_patient_needs_is_the_least_level_that_holds():
    error = np.full((4, len(cohort_exo.LEVELS)), 9.0)
    error[0] = 1.0
    error[1, 2:] = 1.0
    error[2, :2] = 1.0  # holds with little, not with much
    np.testing.assert_array_equal(cohort_exo.needed(error, 5.0), (0.0, 1.0, 0.0, np.inf))
    # Ranks 1 2 3 4 and 3 1.5 1.5 4: covariance 0.375, variances 1.25 and 1.125.
    need = np.array((9.0, 4.0, 4.0, np.inf))
    assert cohort_exo.slope(np.arange(4.0), need) == pytest.approx(0.375 / np.sqrt(1.25 * 1.125))


@pytest.mark.slow
def test_the_weaker_need_more_assistance(found):
    _, result = found("cohort-exo")
    assert values(result, "rank correlation of need and strength")["all patients"] < -0.5
    assert values(result, "error saved by 100 % assistance")["the weaker half"] > 1.0


@pytest.mark.slow
def test_slow_recovery_carries_fatigue_over(found):
    folder, result = found("recovery")
    morning = values(result, "fatigued fraction, third morning")
    assert morning["recovery at 1 of the rate, 4 kg"] < 1e-3
    assert morning["recovery at 0.001 of the rate, 4 kg"] > 0.5
    assert values(result, "M_F after 20 s of rest: jump against simulation")["largest difference"] < 2e-3
    assert [recovery.pause(shift) for shift in range(3)] == [4.0, 4.0, 16.0]
    (run,) = (folder / "runs").iterdir()
    with np.load(run) as arrays:
        assert (arrays["after"] > arrays["before"]).all()  # work tires


def test_the_page_is_that_of_the_committed_results():
    assert experiments.PAGE.read_text() == experiments.page()
    for name in ELBOW:
        result = json.loads((experiments.RESULTS / name / "result.json").read_text())
        assert not result["quick"]
        assert f"experiments/{name}/figure.png" in experiments.PAGE.read_text()


def test_other_runs_have_other_folders():
    """What `--retrain` measures has other policies than what is there without it."""
    switches = [(quick, retrain) for quick in (False, True) for retrain in (False, True)]
    assert [output_folder("exo1", *both).name for both in switches] == [
        "exo1",
        "exo1-retrain",
        "exo1-quick",
        "exo1-quick-retrain",
    ]
