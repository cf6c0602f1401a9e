"""The command `myowarp score`: known errors, walks of a simulation, recorded trials, refusals."""

import json
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from striding import PEAK, striding

from myowarp.apps.reports.intervals import jackknife, student, wilson
from myowarp.apps.reports.walk_measures import (
    SHIPPED,
    as_reference,
    measured,
    pooled,
    read_reference,
    reference_dict,
)
from myowarp.apps.reports.walk_page import findings
from myowarp.apps.reports.walk_score import GROUPS, SCALES, group_of, price_at, score, write_json
from myowarp.apps.rollouts.walks import Legs, Pushes, pushed, walks_of
from myowarp.motion.gait import PERCENT
from myowarp.motion.movement import write_angles
from myowarp.motion.storage import Storage, write_storage
from myowarp.motion.strides import GRAVITY, MUSCLES, UNITS, Strides, strides_of
from myowarp.motion.trial_walk import read_walk
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.kinematics import complete, forward
from myowarp.osim.document.read.model import read_model
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import get_state

pytestmark = pytest.mark.usefixtures("registered")

ROUNDING = 1e-6
GAIT = Path(__file__).parents[1] / "data/osim/gait10dof18musc.osim"


def walked(**changes):
    return measured("a walk", [strides_of(striding(**changes))])


def errors(walk, reference):
    return {row.name: row.error for row in score(walk, reference).rows}


def test_a_walk_is_its_own_reference():
    walk = walked(late=0.04)
    found = score(walk, as_reference(walk))
    assert found.total == pytest.approx(0.0, abs=ROUNDING)
    assert all(row.error == pytest.approx(0.0, abs=ROUNDING) for row in found.rows)
    assert {row.name for row in found.rows} == {*walk.curves, *walk.values, "falls"} - {"weight"}


def test_errors_are_those_of_what_was_changed():
    """Each change has an error by the definition, and leaves the others at 0."""
    reference = as_reference(walked())
    changes = {
        "faster": (
            {"speed": 1.3 * 1.1},
            {"speed": 0.1, "step_length": 0.1, "cost_of_transport": 1.0 - 1.0 / 1.1},
        ),
        "costly": ({"rate": 6.0}, {"metabolic_rate": 0.5, "cost_of_transport": 0.5}),
        "bent": ({"lift": 10.0}, {"knee_angle_r": 10.0 / 40.0, "knee_angle_l": 10.0 / 40.0}),
        "wide": ({"width": 0.18}, {"step_width": 0.5, "margin_outwards": 0.03 / SCALES["margin_outwards"]}),
        "late": ({"late": 0.05}, {"step_length_asymmetry": 0.2, "step_time_asymmetry": 0.2}),
    }
    for change, wanted in changes.values():
        found = errors(walked(**change), reference)
        ahead = abs(0.13 * np.sqrt(0.95 / GRAVITY)) if "speed" in change else 0.0
        for name, error in found.items():
            near = wanted.get(name, ahead / SCALES["margin_ahead"] if name == "margin_ahead" else 0.0)
            # A time step of 1 ms moves heel strikes a little.
            assert error == pytest.approx(near, abs=5e-3), (change, name)
        for name, error in wanted.items():
            assert found[name] == pytest.approx(error, abs=1e-3), (change, name)


def test_a_muscle_is_wrong_where_it_is_on_and_should_be_off():
    """On for 40 % of the cycle, 10 % late is wrong at both ends; the knee's sine is late by 0.2 pi."""
    reference, late = as_reference(walked()), walked(shift=0.1)
    found = errors(late, reference)
    assert found["soleus_r"] == pytest.approx(0.2, abs=0.011)
    wanted = np.sqrt(2.0 * np.sin(0.1 * np.pi) ** 2) / 2.0  # rms of sin(x) - sin(x - 0.2 pi), over 2
    assert found["knee_angle_r"] == pytest.approx(wanted, abs=3e-3)
    row = next(row for row in score(late, reference).rows if row.name == "knee_angle_r")
    assert row.correlation == pytest.approx(np.cos(0.2 * np.pi), abs=0.01)


def test_intervals_are_over_episodes():
    """Errors of means have the interval of the mean; a curve's error, the jackknife's."""
    speeds = np.array((1.1, 1.2, 1.4, 1.5))
    walk = measured("walks", [strides_of(striding(speed=speed)) for speed in speeds])
    row = next(row for row in score(walk, as_reference(walked(speed=1.0))).rows if row.name == "speed")
    assert (walk.over, walk.episodes, walk.strides) == ("episodes", 4, 36)
    np.testing.assert_allclose(row.interval, student(speeds), rtol=1e-6)
    np.testing.assert_allclose(row.error_interval, np.array(student(speeds)) - 1.0, atol=1e-6)
    np.testing.assert_allclose(jackknife(speeds, np.mean), student(speeds), rtol=1e-9)
    spread = np.std([np.delete(speeds, i).max() for i in range(4)]) * np.sqrt(
        3.0
    )  # Miller 1974, (n - 1) / n sum
    np.testing.assert_allclose(
        jackknife(speeds, np.max), 1.5 + 3.182446 * spread * np.array((-1, 1)), rtol=1e-6
    )
    near = score(walk, as_reference(walked(speed=1.3))).rows
    low, high = next(row.error_interval for row in near if row.name == "speed")
    assert low == 0.0
    assert high == pytest.approx((student(speeds)[1] - 1.3) / 1.3, abs=1e-3)


def test_falls_are_counted_and_said():
    walks = [strides_of(striding(fell=k == 0)) for k in range(4)]
    walk = measured("walks", [*walks, Strides(steps=1, fell=True)])
    assert (walk.strides, len(walk.values["speed"])) == (27, 3)
    reference = as_reference(walked())
    assert errors(walk, reference)["falls"] == pytest.approx(0.4)
    said = [text for text, bad in findings(walk, score(walk, reference), reference) if bad]
    assert said[0] == "2 of 5 episodes ended with a fall, one in 22.5 steps."
    with pytest.raises(ValueError, match=r"falls in 2 of 2 episodes, once in 6 steps"):
        measured("a drunkard", [walks[0], Strides(steps=1, fell=True)])


def test_every_measure_has_a_group():
    for name in [*UNITS, *(f"{muscle}_l" for muscle in MUSCLES), "hip_angle_r", "ground_force_l", "falls"]:
        assert name == "weight" or group_of(name) in GROUPS


def test_price_is_ralstons():
    """2.9 kcal/min at rest for 100 kg; least cost of transport where 0.0053 v^2 = 29, 1.23 m/s."""
    assert price_at(0.0) == pytest.approx(29.0 * 4.184 / 60.0)
    speeds = np.linspace(0.5, 2.0, 1501)
    least = speeds[np.argmin([price_at(v) / v for v in speeds])]
    assert least == pytest.approx(np.sqrt(29.0 / 0.0053) / 60.0, abs=1e-3)


def test_a_reference_in_a_file_is_the_one_that_was_written(tmp_path):
    reference = as_reference(walked(shift=0.1))
    write_json(tmp_path / "score.json", {"walk": reference_dict(reference, every=1)})
    found = read_reference(tmp_path / "score.json")
    for name, rows in reference.curves.items():
        np.testing.assert_allclose(found.curves[name], rows, rtol=1e-3, atol=1e-3)
    for name, on in reference.active.items():
        np.testing.assert_array_equal(found.active[name], on)
    assert found.values["speed"] == pytest.approx(reference.values["speed"], rel=1e-3)


def test_people_are_pooled_alike():
    """Somebody's nine strides count as much as somebody else's four; both sides are one."""
    people = [walked(speed=1.0), walked(speed=1.4, seconds=3.2)]
    found = pooled("two", people, ())
    n, m = (len(person.values["speed"]) for person in people)
    assert n > m
    assert found.values["speed"] == pytest.approx((1.2, 0.2), abs=ROUNDING)
    assert found.curves["knee_angle"].shape == (2, 101)
    assert not any(name.endswith(("_r", "_l")) for name in found.curves)


def test_the_shipped_reference_walks_as_people_do():
    """Landmarks of Perry 1992 and Winter 1991, wide enough for anybody who is healthy."""
    found = read_reference(SHIPPED)
    knee, ankle, hip = (found.curves[f"{joint}_angle"][0] for joint in ("knee", "ankle", "hip"))
    assert 55.0 < knee.max() < 75.0
    assert 65 <= knee.argmax() <= 78
    assert -25.0 < ankle.min() < -5.0
    assert 58 <= ankle.argmin() <= 72
    assert 25.0 < np.ptp(hip) < 55.0
    force, moment = found.curves["ground_force"][0], found.curves["ankle_moment"][0]
    assert 0.9 < force[:30].max() < 1.4
    assert 0.9 < force[30:60].max() < 1.4
    assert force[20:40].min() < 0.9
    assert 1.0 < moment.max() < 2.0
    assert 42 <= moment.argmax() <= 55
    assert 1.0 < found.values["speed"][0] < 1.6
    assert set(found.active) == set(MUSCLES)
    assert len(found.sources) == 3


@pytest.fixture(scope="module")
def sim():
    """Two worlds of legs in the middle of a step."""
    return Simulation("myoLegWalk-v0", 2, autoreset="same_step", device="cpu", horizon=40, shards=1)


def test_forces_and_moments_are_what_moves_the_legs(sim):
    """Newton and Euler, by MuJoCo's recursion and its contact Jacobians: M a + c = moment + J^T f."""
    legs = Legs(sim.scene)
    model, data = legs.model, legs.data
    rng = np.random.default_rng(0)
    qpos = sim.scene.qpos_start.numpy().astype(float)
    data.qpos[:] = qpos
    while not data.ncon:  # until a foot stands
        data.qpos[2] -= 0.005
        mujoco.mj_forward(model, data)
    qpos[2] = data.qpos[2]
    for _ in range(3):
        force = -rng.uniform(0.0, 300.0, model.nu)
        qvel = rng.normal(0.0, 0.3, model.nv)
        qpos[2] -= 0.004
        center, _, up, moment = legs.pose(qpos, qvel, force)
        assert data.ncon > 0
        equal = np.isin(data.efc_type, (mujoco.mjtConstraint.mjCNSTR_EQUALITY,))
        assert equal.any()
        inertia = np.zeros(model.nv)
        mujoco.mj_mulM(model, data, inertia, data.qacc)
        pushed, jacobian = np.zeros(model.nv), np.zeros((3, model.nv))
        for k in range(data.ncon):
            contact, wrench = data.contact[k], np.zeros(6)
            mujoco.mj_contactForce(model, data, k, wrench)
            frame = contact.frame.reshape(3, 3)
            for geom, sign in zip(contact.geom, (-1.0, 1.0), strict=True):
                turning = np.zeros((3, model.nv))
                mujoco.mj_jac(model, data, jacobian, turning, contact.pos, model.geom_bodyid[geom])
                pushed += sign * (jacobian.T @ frame.T @ wrench[:3] + turning.T @ frame.T @ wrench[3:])
        np.testing.assert_allclose(inertia + data.qfrc_bias - pushed, moment, atol=1e-4)
        right, left = up  # in this pose the left foot stands
        assert left > 20.0
        assert right == 0.0
        # Along the root's vertical nothing acts but the ground.
        np.testing.assert_allclose((inertia + data.qfrc_bias)[2], left, rtol=1e-6)
        np.testing.assert_allclose(moment[:6], 0.0, atol=1e-6)
        assert center[2] == pytest.approx(data.subtree_com[0, 2], abs=0.05)


def test_pushes_come_at_a_beat_and_change_the_velocity_of_the_root(sim):
    sim.reset()
    pushes, seen = Pushes(sim, 0.3, every=0.1), []
    for number in (9, 10, 11, 20):
        before = get_state(sim).arrays["data.qvel"]
        pushes.see(SimpleNamespace(number=number))
        seen.append(get_state(sim).arrays["data.qvel"] - before)
    for changed, size in zip(seen, (0.0, 0.3, 0.0, 0.3), strict=True):
        np.testing.assert_allclose(np.linalg.norm(changed[:, :2], axis=1), size, atol=ROUNDING)
        assert not changed[:, 2:].any()
    found = pushed(sim, lambda obs: np.zeros((2, sim.action.shape[1]), np.float32), 0.3)
    assert found.episodes == 2
    assert found.seconds == pytest.approx(0.8) or found.falls
    beside = score(walked(), as_reference(walked()), (1, 4))
    row = next(row for row in beside.rows if "pushed" in row.name)
    assert (row.error, row.error_interval) == (0.25, wilson(1, 4))
    assert beside.total == score(walked(), as_reference(walked())).total


def test_walks_are_those_of_the_simulation(sim):
    """The ground pushes as the mass centre accelerates; a fall ends a walk."""
    walks = walks_of(sim, lambda obs: np.zeros((2, sim.action.shape[1]), np.float32))
    assert walks.one_episode
    (walk,) = walks.walks
    up = walk.force["r"] + walk.force["l"]
    rise = np.gradient(np.gradient(walk.center[:, 2], walk.time), walk.time)
    error = (up / (walk.mass * GRAVITY) - 1.0 - rise / GRAVITY)[3:-3]
    assert np.abs(np.mean(error)) < 0.1
    assert set(walk.curves) > {"hip_angle_r", "ankle_moment_l", "soleus_r", "vasti_l"}
    assert walk.metabolic_rate is not None
    assert (walk.metabolic_rate > 1.0).all()


LOADS = """<OpenSimDocument Version="40000"><ExternalLoads name="l"><objects>{}</objects>
<datafile>plates.mot</datafile></ExternalLoads></OpenSimDocument>"""
LOAD = """<ExternalForce name="{0}"><applied_to_body>{0}</applied_to_body>
<force_identifier>{0}_v</force_identifier><point_identifier>{0}_p</point_identifier></ExternalForce>"""
BENT, FLEXING, SWING, POWER, TORQUE = 0.5, 0.3, 0.4, 3.0, 40.0  # rad, rad, rad, W of each muscle, N m


@pytest.fixture
def trial(tmp_path):
    """Return a folder as steps of `motion` write it: a person on a treadmill, with forces of half sines."""
    model = read_model(GAIT)
    bones, folder = Bones(model), tmp_path / "trial"
    folder.mkdir()
    time = np.arange(0.0, 5.0, 0.005)
    values = np.tile([model.coordinates[name].default for name in bones.coordinates], (len(time), 1))
    begins = {"r": 0.3, "l": 0.85}
    for side, begin in begins.items():
        knee = bones.coordinates.index(f"knee_angle_{side}")
        values[:, knee] = -BENT - FLEXING * np.sin(2.0 * np.pi * (time - begin) / 1.1)
        hip = bones.coordinates.index(f"hip_flexion_{side}")
        values[:, hip] = SWING * np.cos(2.0 * np.pi * (time - begin) / 1.1)
    write_angles(folder / "ik.mot", model, bones.coordinates, time, values)
    labels, columns = [], []
    for side, begin in begins.items():
        up = 800.0 * np.maximum(np.sin(2.0 * np.pi * (time - begin) / 1.1), 0.0)
        labels += [f"calcn_{side}_{part}{axis}" for part in "vp" for axis in "xyz"]
        columns += [0.0 * up, up, *(0.0 * up for _ in range(4))]
    write_storage(folder / "plates.mot", "plates", Storage(tuple(labels), time, np.stack(columns, axis=1)))
    (folder / "grf.xml").write_text(LOADS.format("".join(LOAD.format(f"calcn_{side}") for side in "rl")))

    def constant(file, labels, value):
        write_storage(folder / file, file, Storage(labels, time, np.full((len(time), len(labels)), value)))

    constant("moments.sto", ("knee_angle_r_moment", "knee_angle_l_moment"), TORQUE)
    constant("passive_moments.sto", ("knee_angle_r_moment", "knee_angle_l_moment"), -TORQUE / 4.0)
    constant("metabolic_powers.sto", ("soleus_r", "soleus_l"), POWER)
    constant("activations.sto", ("soleus_r", "vasti_l"), 0.3)
    return folder


def test_a_trial_is_read_as_it_was_recorded(trial):
    walk = read_walk(trial, GAIT)
    mass = sum(body.mass for body in read_model(GAIT).bodies.values())
    found = strides_of(walk)
    turn = 2.0 * np.pi * np.array((0.1, 0.2))  # of the cycle, at 20 and 40 % of the contact
    posed = {"knee_angle_r": -BENT - FLEXING * np.sin(turn), "hip_flexion_r": SWING * np.cos(turn)}
    model = read_model(GAIT)
    heel = forward(model, complete(model, posed, 2))["calcn_r"][1][:, 0]
    np.testing.assert_allclose(found.values["speed"], float(heel[0] - heel[1]) / 0.11, rtol=0.01)
    np.testing.assert_allclose(found.values["cadence"], 120.0 / 1.1, rtol=1e-3)
    wanted = np.degrees(BENT + FLEXING * np.sin(2.0 * np.pi * PERCENT / 100.0))  # flexion > 0
    np.testing.assert_allclose(found.curves["knee_angle_r"][1], wanted, atol=0.5)
    # Its flexion is < 0, so that extension is > 0 as it is.
    np.testing.assert_allclose(found.curves["knee_moment_l"], 0.75 * TORQUE / mass, rtol=1e-6)
    np.testing.assert_allclose(found.values["metabolic_rate"], 2.0 * POWER / mass + 1.2, rtol=1e-6)
    np.testing.assert_allclose(found.curves["soleus_r"], 0.3, rtol=1e-6)
    assert "soleus_l" not in found.curves
    assert found.curves["ground_force_l"].max() == pytest.approx(800.0 / (mass * GRAVITY), rel=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("<gravity>0 -9.8", "<gravity>0 0 -9.8", "a model whose y is up; gravity of .* is 0 0 -9.8"),
        ("<gravity>0 -9.8", "<gravity>0 9.8 0", "a model whose y is up"),
        ("<range>-2.0943950999999998 0.17453293", "<range>-2 2", "must be longer where it flexes"),
    ],
)
def test_a_trial_whose_directions_are_not_known_is_refused(old, new, sentence, trial):
    text = GAIT.read_text()
    begin = text.index(old)
    end = text.index("</", begin)
    model = trial / "other.osim"
    model.write_text(text[:begin] + new + text[end:])
    with pytest.raises(ValueError, match=sentence):
        read_walk(trial, model)


@pytest.mark.parametrize("values", ['{"speed": [1]}', '{"speed": [1, 2, 3]}', '{"speed": ["a", 2]}'])
def test_a_reference_that_is_none_is_refused_in_a_sentence(values, tmp_path):
    path = tmp_path / "score.json"
    head = '{"name": "x", "sources": [], "percent": [0, 100], "curves": {}, "active": {}'
    path.write_text(f'{head}, "values": {values}}}')
    with pytest.raises(ValueError, match=r"must be score.json of `myowarp score`"):
        read_reference(path)


def test_the_command_scores_a_trial_and_takes_one_as_reference(trial, run, tmp_path, caplog):
    (trial / "scaled.osim").write_text(GAIT.read_text())
    words = ("--trial", trial, "--reference", trial, "--output", tmp_path / "score")
    status, out, err = run("score", *words, "--json")
    assert status == 0
    assert "feet stand on a belt that moves at 1.79 m/s" in caplog.text
    found = json.loads(out)
    assert found["score"] == pytest.approx(0.0, abs=1e-9)
    assert json.loads((tmp_path / "score/score.json").read_text()) == found
    assert run("score", *words)[0] == 2  # files that exist
    own = (*words[:2], "--reference", tmp_path / "score/score.json", *words[4:], "--overwrite")
    status, out, err = run("score", *own)
    assert status == 0
    assert "knee angle r [°]" in out
    assert "Saved score.json, score.html, score.png" in err
    status, _, err = run("score", "myoLegWalk-v0", *words, "--overwrite")
    assert status == 2
    assert "what is scored is a task or --trial, one of them" in err.replace("\n", " ")


def test_the_command_refuses_in_a_sentence(run, tmp_path):
    for words, sentence in (
        (["myoElbowPose1D6MFixed-v0", "--policy", "zero"], "a walk needs both legs"),
        (["myoLegWalk-v0", "--loads", "a.xml"], "--loads belongs to a recorded trial"),
        (["myoLegWalk-v0", "--push", "0"], "--push must be positive and finite, got 0"),
        (["--trial", tmp_path, "--push", "0.3"], "a recorded trial cannot be pushed"),
        (["--trial", tmp_path], "needs --model FILE, or scaled.osim in it"),
        (["myoLegWalk-v0", "--reference", tmp_path / "none.json"], "none.json"),
        (
            ["myoLegWalk-v0", "--policy", "zero", "--horizon", "30", "--num-worlds", "1"],
            "a score needs a whole stride",
        ),
    ):
        status, _, err = run("score", *words, "--output", tmp_path / "score")
        assert status == 2
        assert sentence in err.replace("\n", " ")
        assert not (tmp_path / "score").exists()


def test_the_page_and_the_json_hold_the_score(tmp_path):
    from myowarp.apps.reports.walk_page import write_page
    from myowarp.apps.reports.walk_score import as_dict

    walks = [strides_of(striding(late=0.05, fell=fell)) for fell in (False, True, False)]
    walk, reference = measured("walks", walks), read_reference()
    found = score(walk, reference)
    write_page(tmp_path, walk, found, reference)
    page = (tmp_path / "score.html").read_text()
    assert "knee angle, right" in page
    assert "18 strides of 2 episodes without a fall" in page
    assert "1 of 3 episodes ended with a fall, one in 33 steps." in page
    assert (tmp_path / "score.png").read_bytes().startswith(b"\x89PNG")
    said = json.loads(json.dumps(as_dict(walk, found, reference, {"task": "t"})))
    worst = said["measures"][0]
    assert worst["error"] == max(row["error"] for row in said["measures"] if row["error"] is not None)
    assert said["score"] == pytest.approx(np.mean([min(error, 1.0) for error in said["groups"].values()]))
    peak = next(row for row in said["measures"] if row["name"] == "first_peak")
    assert peak["value"] == pytest.approx(PEAK, abs=1e-3)
