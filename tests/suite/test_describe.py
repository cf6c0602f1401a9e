"""What `myowarp describe` says is complete for everything registered, and true.

The simple columns, the distances and the rewards are computed here from MuJoCo C's data and from what the
description says, not from our kernels.
"""

import dataclasses
import json
import re
from functools import lru_cache

import gymnasium as gym
import mujoco
import numpy as np
import pytest
import test_draws
from often import covering, goals, of_each, often

from myowarp.apps.reports.describe import describe
from myowarp.apps.reports.describe_text import as_text
from myowarp.definitions.body import BODIES
from myowarp.definitions.condition import CONDITIONS, attributes_of
from myowarp.definitions.registry import Registry
from myowarp.definitions.task import PHYSICS, RESETS, TASKS, Column, RewardTerm
from myowarp.kernels.action import excitation
from myowarp.models.conditions.exoskeleton import Exoskeleton
from myowarp.models.conditions.fatigue_3ccr import Fatigue3CCR
from myowarp.sim.build import full_model, num_substeps_of
from myowarp.sim.simulation import Simulation
from myowarp.tasks.pose import PoseTask
from myowarp.tasks.variants import variants

KEYS = sorted(TASKS)
SCENES = sorted({TASKS[key].scene_key: key for key in TASKS}.values())
VARIANTS = variants()
CONDITIONED = sorted(
    {(v.conditions, TASKS[v.task].body): i for i, v in VARIANTS.items() if v.conditions}.values()
)
"""An id for each condition of each body."""


def worn(env_id):
    """Return conditions and body of an id."""
    return VARIANTS[env_id].conditions, TASKS[VARIANTS[env_id].task].body


ELBOW = "myoElbowPose1D6MRandom-v0"
WORLDS, STEPS = 4, 4
ROUNDING = 2e-5  # float32 sums of up to 23 squares, and poses of ours against MuJoCo C's
SUMS = 2e-6  # of a reward's size, float32


@lru_cache
def facts_of(key):
    return describe(TASKS[key])


def blocks_of(key):
    return {block["name"]: block for block in facts_of(key)["observation"]["blocks"]}


def meant(text):
    """Whether a text says something: words, and no placeholder that was left empty."""
    return len(text.split()) >= 2 and "{" not in text and "None" not in text


@pytest.mark.parametrize("key", of_each(KEYS, goals))
def test_everything_has_a_meaning_and_a_unit(key):
    facts = facts_of(key)
    assert meant(facts["summary"])
    for block in facts["observation"]["blocks"]:
        assert meant(block["doc"]), block["name"]
        assert block["unit"], block["name"]
        assert all(entry["name"] and entry["unit"] for entry in block["entries"])
        names = [entry["name"] for entry in block["entries"]]
        assert len(set(names)) == len(names) == block["last"] - block["first"] + 1
    for term in facts["reward"]["terms"]:
        assert meant(term["doc"]), term["name"]
        assert term["unit"], term["name"]
    for actuator in facts["action"]["actuators"]:
        assert actuator["name"]
        assert actuator["unit"]
        assert actuator["low"] < actuator["high"]
    assert meant(facts["success"]["solved"])
    assert meant(facts["failure"]["failed"])
    assert list(facts["resets"]["kinds"]) == list(RESETS)
    assert all(meant(kind["start"]) for kind in facts["resets"]["kinds"].values())
    for draw in facts["draws"]:
        assert meant(draw["doc"])
        assert draw.get("choices") or all(e["low"] <= e["high"] and e["unit"] for e in draw["entries"])
    assert facts["draws"], "a task has a goal"
    assert meant(facts["body"]["doc"])
    assert json.loads(json.dumps(facts, allow_nan=False)) == facts


def test_draws_follow_the_name():
    """An id with Random in its name draws; the goal of one without does not differ between episodes."""
    drawing = ("Random", "Rough", "TerrainWalk-v1", "P2", "Reorient", "Relocate")
    wrong = [
        key
        for key in KEYS
        if any(draw.varies for draw in TASKS[key].draws if draw.when in ("goal", "start"))
        != any(name in key for name in drawing)
    ]
    assert wrong == []


@pytest.mark.parametrize("key", of_each(SCENES))
def test_sizes_and_weights_are_those_of_the_environment(key):
    facts, sim = facts_of(key), walked(key)
    blocks = facts["observation"]["blocks"]
    spans = [(block["first"], block["last"] + 1) for block in blocks]
    assert [first for first, _ in spans] == [0, *(end for _, end in spans[:-1])]
    assert spans[-1][1] == facts["observation"]["size"] == sim.transition.obs.shape[1]
    assert facts["action"]["size"] == len(facts["action"]["actuators"]) == sim.action.shape[1]
    np.testing.assert_allclose(
        [t["weight"] for t in facts["reward"]["terms"]], sim.shards[0].weights.numpy(), rtol=1e-6
    )
    assert [row["name"] for row in facts["muscles"]["muscles"]] == list(sim.scene.muscles.names)


@pytest.mark.parametrize("env_id", often(CONDITIONED, covering(CONDITIONED, worn)))
def test_ids_with_conditions(env_id):
    """What a condition adds is described too; the sizes are those of the simulation."""
    variant = VARIANTS[env_id]
    facts = describe(TASKS[variant.task], env_id, reset=variant.reset, conditions=variant.conditions)
    assert facts["id"] == env_id
    assert facts["task"] == TASKS[variant.task].env_id
    assert facts["resets"]["own"] == variant.reset
    names = [text.partition("(")[0] for text in variant.conditions]
    assert [c["name"] for c in facts["conditions"]] == names
    for condition in facts["conditions"]:
        assert meant(condition["doc"])
        assert all(len(parameter["doc"].split()) > 1 for parameter in condition["parameters"])
    assert facts["observation"]["size"] == facts_of(variant.task)["observation"]["size"]
    assert facts["action"]["size"] == facts_of(variant.task)["action"]["size"]
    assert max(map(len, as_text(facts).splitlines())) <= 80


def test_every_condition_documents_its_parameters():
    for name in CONDITIONS:
        fields = {field.name for field in dataclasses.fields(CONDITIONS[name])}
        assert fields <= set(attributes_of(CONDITIONS[name])), name


def test_conditions_that_add_columns_terms_and_actions():
    """A motor is one more action and term, observed fatigue one more block."""
    motor = Exoskeleton(motor=True, max_torque=7.0, effort_weight=0.5)
    facts = describe(TASKS[ELBOW], conditions=[motor, Fatigue3CCR(observe=True)])
    last = facts["action"]["actuators"][-1]
    assert (last["quantity"], last["unit"], last["low"], last["high"]) == (
        "torque on r_elbow_flex",
        "N m",
        -7.0,
        7.0,
    )
    assert facts["reward"]["terms"][-1]["name"] == "exo_effort"
    assert facts["reward"]["terms"][-1]["weight"] == 0.5
    assert meant(facts["reward"]["terms"][-1]["doc"])
    block = facts["observation"]["blocks"][-1]
    assert (block["name"], block["first"], block["last"]) == ("fatigue", 9, 14)
    assert [entry["name"] for entry in block["entries"]][:2] == ["TRIlong", "TRIlat"]
    assert meant(block["doc"])
    assert facts["action"]["size"] == 7


@lru_cache
def walked(key):
    """Return what a few random steps of some worlds led to, and the simulation in the last state."""
    sim = Simulation(TASKS[key], WORLDS, device="cpu", autoreset="disabled", graph=False, progress=False)
    sim.reset(seeds=np.arange(WORLDS))
    random = np.random.default_rng(0)
    for _ in range(STEPS):
        sim.action.assign(random.uniform(-1, 1, sim.action.shape).astype(np.float32))
        sim.step()
    return sim


def columns_of(key, name):
    """Return a block of the observations, shape (worlds, n), found by the described indices."""
    block = blocks_of(key)[name]
    return walked(key).transition.obs.numpy()[:, block["first"] : block["last"] + 1]


@lru_cache
def poses(key):
    """Return the full model, and MuJoCo C's data of it in each world's state."""
    sim = walked(key)
    model = full_model(TASKS[key])
    found = []
    for world in range(WORLDS):
        data = mujoco.MjData(model)
        data.qpos[:] = sim.scene.data.qpos.numpy()[world]
        data.qvel[:] = sim.scene.data.qvel.numpy()[world]
        data.act[:] = sim.scene.muscles.activation.numpy()[world]
        mujoco.mj_forward(model, data)
        found.append(data)
    return model, found


@pytest.mark.parametrize("key", of_each(SCENES))
def test_joint_columns_are_the_joints_that_they_name(key):
    """Positions, and velocities times the control step, entry by entry by name; activations too."""
    model, data = poses(key)
    dt = facts_of(key)["episode"]["control_dt"]
    joints = {model.joint(i).name for i in range(model.njnt)}
    seen = set()
    for name, block in blocks_of(key).items():
        for i, entry in enumerate(block["entries"]):
            values = columns_of(key, name)[:, i]
            if "activation" in block["doc"]:
                address = model.actuator_actadr[model.actuator(entry["name"]).id]
                expected = [d.act[address] for d in data]
            elif entry["name"] in joints and "error" not in block["doc"]:
                joint = model.joint(entry["name"])
                units = {mujoco.mjtJoint.mjJNT_HINGE: "rad", mujoco.mjtJoint.mjJNT_SLIDE: "m"}
                unit = units[mujoco.mjtJoint(joint.type[0])]
                rate = entry["unit"] == f"{unit} per control step"
                assert rate or entry["unit"] == unit
                expected = [dt * d.qvel[joint.dofadr[0]] if rate else d.qpos[joint.qposadr[0]] for d in data]
            else:
                continue
            np.testing.assert_allclose(values, expected, atol=ROUNDING, err_msg=f"{name} {entry['name']}")
            seen.add(entry["name"])
    assert len(seen) >= 4 or TASKS[key].body.startswith("elbow")


@pytest.mark.parametrize("key", [key for key in SCENES if "Reach" in key])
def test_tip_columns_are_the_tips_that_they_name(key):
    _, data = poses(key)
    for i, entry in enumerate(blocks_of(key)["tip_pos"]["entries"]):
        site, axis = entry["name"].split()
        expected = [d.site(site).xpos["xyz".index(axis)] for d in data]
        np.testing.assert_allclose(columns_of(key, "tip_pos")[:, i], expected, atol=ROUNDING)
    markers = [walked(key).shards[0].program.goal_markers(world) for world in range(WORLDS)]
    names = [f"{tip}_target" for tip in BODIES[TASKS[key].body].tips]
    goal = np.array([[marker[name] for name in names] for marker in markers]).reshape(WORLDS, -1)
    tips = columns_of(key, "tip_pos")
    np.testing.assert_allclose(columns_of(key, "reach_err"), goal - tips, atol=ROUNDING)


OBJECTS = {
    "keyturn": ("IFtip_approach", lambda d: d.site("keyhead").xpos - d.site("IFtip_r").xpos),
    "objecthold": ("obj_pos", lambda d: d.body("object").xpos),
    "pentwirl": ("obj_rot", lambda d: d.body("Object").xmat.reshape(3, 3)[:, 2]),
    "baoding": ("object2_pos", lambda d: d.body("ball2").xpos),
}


@pytest.mark.parametrize("key", of_each([key for key in SCENES if TASKS[key].family in OBJECTS]))
def test_object_columns(key):
    sim, model = walked(key), full_model(TASKS[key])
    name, read = OBJECTS[TASKS[key].family]
    for world in range(WORLDS):
        data = mujoco.MjData(model)
        if TASKS[key].family == "keyturn":
            model.body("key").pos[:] = sim.scene.model.body_pos.numpy()[world, sim.shards[0].program.key_body]
        data.qpos[:] = sim.scene.data.qpos.numpy()[world]
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(columns_of(key, name)[world], read(data), atol=ROUNDING)


@pytest.mark.parametrize("key", of_each(SCENES))
def test_reward_is_the_formula(key):
    """The formula as printed, read as arithmetic, with the terms of `info`."""
    sim, facts = walked(key), facts_of(key)
    left, formula = facts["reward"]["formula"].split(" = ")
    assert left == "reward"
    terms = dict(
        zip([t["name"] for t in facts["reward"]["terms"]], sim.transition.terms.numpy().T, strict=True)
    )
    total = np.zeros(WORLDS)
    for part in formula.replace(" - ", " + -").split(" + "):
        *weight, name = part.split()
        total += float(weight[0] if weight else 1) * terms[name]
    np.testing.assert_allclose(sim.transition.reward.numpy(), total, rtol=SUMS, atol=SUMS)
    assert np.abs(total).min() > 100 * SUMS


def numbers(text):
    return [float(found) for found in re.findall(r"(?<![\w.])\d+\.?\d*(?:e-?\d+)?(?=\s|$|,|;)", text)]


@pytest.mark.parametrize("key", of_each([key for key in SCENES if TASKS[key].family in ("pose", "reach")]))
def test_errors_bonus_and_endings_are_as_described(key):
    """Error, bonus and the two thresholds from the observation and the printed numbers alone."""
    sim, facts = walked(key), facts_of(key)
    name = "pose_err" if TASKS[key].family == "pose" else "reach_err"
    docs = {t["name"]: t["doc"] for t in facts["reward"]["terms"]}
    terms = dict(zip(docs, sim.transition.terms.numpy().T, strict=True))
    error = np.linalg.norm(columns_of(key, name), axis=1)
    main = "pose" if TASKS[key].family == "pose" else "reach"
    np.testing.assert_allclose(terms[main], -error, rtol=1e-5)
    _, wide, _, near = numbers(docs["bonus"])
    np.testing.assert_array_equal(terms["bonus"], 1.0 * (error < wide) + (error < near))
    assert numbers(facts["success"]["solved"]) == [near]
    np.testing.assert_array_equal(sim.transition.solved.numpy(), error < near)
    far = numbers(facts["failure"]["failed"])[0]
    np.testing.assert_array_equal(sim.transition.failed.numpy(), error > far)
    if "act" in blocks_of(key):
        act = columns_of(key, "act").astype(float)
        np.testing.assert_allclose(terms["act_reg"], -np.linalg.norm(act, axis=1) / act.shape[1], atol=1e-6)


def test_thresholds_of_the_held_object():
    """A goal just within and just beyond the printed distances."""
    key = "myoHandObjHoldRandom-v1"
    facts = facts_of(key)
    sim = Simulation(TASKS[key], 1, device="cpu", graph=False, progress=False)
    (near,), (far,) = numbers(facts["success"]["solved"]), numbers(facts["failure"]["failed"])
    for distance, solved, failed in (
        (0.99 * near, True, False),
        (1.01 * near, False, False),
        (0.99 * far, False, False),
        (1.01 * far, False, True),
    ):
        sim.shards[0].program.goal.assign(
            sim.scene.data.qpos.numpy()[:, 23:26] + np.float32([distance, 0.0, 0.0])
        )
        sim.shards[0].launch_scoring()
        judged = sim.transition.solved.numpy()[0], sim.transition.failed.numpy()[0]
        assert judged == (solved, failed), distance


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_thresholds_of_key_pen_and_balls(factor):
    """A key turned, a pen and a ball displaced, to just within or beyond what is printed."""
    beyond = factor > 1

    def judged(key, change):
        sim = Simulation(TASKS[key], 1, device="cpu", graph=False, progress=False)
        qpos = sim.scene.data.qpos.numpy().copy()
        change(qpos[0])
        sim.scene.data.qpos.assign(qpos)
        sim.shards[0].refresh()
        sim.shards[0].launch_scoring()
        return bool(sim.transition.solved.numpy()[0]), bool(sim.transition.failed.numpy()[0])

    def limit(key, part, kind):
        return numbers(facts_of(key)[part][kind])[-1]

    key = "myoHandKeyTurnFixed-v1"
    angle = limit(key, "success", "solved")
    assert judged(key, lambda q: q.__setitem__(23, factor * angle))[0] == beyond
    pen = "myoHandPenTwirlFixed-v1"
    lost = limit(pen, "failure", "failed")
    assert judged(pen, lambda q: q.__setitem__(23, q[23] + factor * lost))[1] == beyond
    balls = "myoHandBaodingFixed-v1"
    height = numbers(facts_of(balls)["failure"]["failed"])[0]
    assert judged(balls, lambda q: q.__setitem__(32, height / factor))[1] == beyond


@pytest.mark.parametrize("key", of_each(SCENES))
def test_actions_do_what_is_said(key):
    """Controls and forces at actions -1, 0 and 1, and beyond."""
    sim, asked = walked(key), np.array([-1.0, 0.0, 1.0, 7.0])
    sim.action.assign(np.repeat(asked[:, None], sim.action.shape[1], axis=1).astype(np.float32))
    sim.shards[0].launch_action()
    ctrl, model = sim.scene.data.ctrl.numpy(), sim.scene.oracle
    for row in facts_of(key)["action"]["actuators"]:
        i = row["index"]
        assert model.actuator(i).name == row["name"]
        given = ctrl[:, i]
        if row["kind"] == "muscle":
            at = facts_of(key)["action"]["maps"]["muscle"]["at"]
            np.testing.assert_allclose(given[:3], list(at.values()), rtol=1e-5)
            np.testing.assert_allclose(given[[0, 2]], (row["low"], row["high"]), rtol=1e-5)
            half = 0.5 if TASKS[key].linear_excitation else 0.0758582
            assert given[1] == pytest.approx(half, abs=1e-7)
        else:
            data = mujoco.MjData(model)
            forces = []
            for value in given[:3]:
                data.ctrl[:] = 0
                data.ctrl[i] = value
                mujoco.mj_forward(model, data)
                forces.append(data.actuator_force[i] * model.actuator_gear[i, 0])
            assert forces == pytest.approx([row["low"], (row["low"] + row["high"]) / 2, row["high"]])
            joint = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
            assert row["unit"] == ("N m" if joint else "N")
        assert given[3] == given[2]
    assert excitation(0.5) == 0.5


@pytest.mark.parametrize("key", of_each(SCENES))
def test_physics_steps_are_those_of_the_presets(key):
    physics = facts_of(key)["episode"]["physics"]
    assert list(physics) == list(PHYSICS)
    for name, said in physics.items():
        assert said["steps"] * said["dt"] == pytest.approx(TASKS[key].control_dt)
        assert said["steps"] == num_substeps_of(TASKS[key], PHYSICS[name])


def test_fast_physics_takes_fewer_steps():
    sim = Simulation(TASKS[ELBOW], 1, device="cpu", physics="fast", graph=False, progress=False)
    assert sim.scene.num_substeps == facts_of(ELBOW)["episode"]["physics"]["fast"]["steps"] == 2


@pytest.mark.parametrize("key", of_each(test_draws.DRAWS))
def test_described_draws_are_those_of_upstream(key):
    """Bounds are the numbers of `test_draws`, of everything that varies."""
    expected = dict(test_draws.DRAWS[key])
    expected.pop("row", None)  # of a table
    varied = {draw["name"]: draw for draw in facts_of(key)["draws"] if draw["varies"]}
    if "row" in test_draws.DRAWS[key]:
        assert "row of a table" in varied.pop("target")["doc"]
    assert set(expected) <= set(varied) <= {*expected, "configuration"}
    for name, bounds in expected.items():
        if "choices" in varied[name]:
            assert set(varied[name]["choices"]) == bounds
            continue
        for end, numbers_ in zip(("low", "high"), bounds, strict=True):
            said = [entry[end] for entry in varied[name]["entries"]]
            said = np.tile(said, np.size(numbers_) // len(said))  # of each ball
            np.testing.assert_allclose(said, np.ravel(numbers_), atol=1e-9)


@pytest.mark.parametrize("reset", [reset for reset in RESETS if reset != "random"])
@pytest.mark.parametrize("key", [ELBOW, "myoHandObjHoldRandom-v1"])
def test_resets_draw_what_is_said(key, reset):
    """What a second episode renews, under each reset but the one whose starts take minutes to find."""
    sim = Simulation(
        TASKS[key],
        8,
        device="cpu",
        reset=reset,
        horizon=1,
        autoreset="same_step",
        graph=False,
        progress=False,
    )
    sim.reset(seeds=np.arange(8))

    def state():
        return {name: test_draws.read(sim.shards[0].program, name).copy() for name in said}

    said = [draw["name"] for draw in facts_of(key)["draws"] if draw["varies"]]
    before = state()
    sim.action.fill_(-1.0)
    sim.step()
    after = state()
    renewed = facts_of(key)["resets"]["kinds"][reset]["draws"]
    for name in said:
        if name == "configuration" and reset == "none":
            continue  # it moves on
        assert np.array_equal(before[name], after[name]) == (name not in renewed), name


def test_random_actions_pass_through_the_elbows_target():
    """The yardstick that a rollout prints."""
    from myowarp.apps.cli.rollout import RANDOM_ELBOW, RANDOM_ELBOW_ID

    env = gym.make_vec(f"MyoWarp/{RANDOM_ELBOW_ID}", num_envs=1024, device="cpu", autoreset_mode="disabled")
    env.reset(seed=0)
    random = np.random.default_rng(0)
    for _ in range(TASKS[RANDOM_ELBOW_ID].horizon):
        *_, info = env.step(random.uniform(-1, 1, (1024, 6)).astype(np.float32))
    env.close()
    assert 100 * info["success"].mean() == pytest.approx(RANDOM_ELBOW, abs=5)  # three standard deviations


@pytest.mark.parametrize("key", of_each(SCENES))
def test_text_fits_a_terminal_and_has_every_name(key):
    text = as_text(facts_of(key))
    assert max(map(len, text.splitlines())) <= 80
    words = set(re.split(r"[\s,:;()]+", text))
    for block in facts_of(key)["observation"]["blocks"]:
        assert block["name"] in words
        assert {part for entry in block["entries"] for part in entry["name"].split()} <= words
    assert {term["name"] for term in facts_of(key)["reward"]["terms"]} <= words
    assert "-0 " not in text
    assert "the task does not say" not in text


def test_command_prints_text_and_json(run):
    status, out, err = run("describe", ELBOW)
    assert status == 0, err
    assert out.startswith(f"MyoWarp/{ELBOW}\n")
    assert "0.076 at action 0" in " ".join(out.split())
    status, out, err = run("describe", f"MyoWarp/{ELBOW}", "--json")
    assert status == 0, err
    assert json.loads(out) == facts_of(ELBOW)
    status, out, _ = run("describe", "paperElbowPoseHardFSarc-v0", "--conditions", "load", "--json")
    facts = json.loads(out)
    assert status == 0
    assert (facts["id"], facts["resets"]["own"]) == ("MyoWarp/paperElbowPoseHardFSarc-v0", "fixed")
    assert [condition["name"] for condition in facts["conditions"]] == ["sarcopenia", "load"]


MODEL = """<mujoco model="mixed"><worldbody><body><joint name="base" type="slide" axis="1 0 0"/>
<geom size="0.1"/><body pos="0 0 -0.2"><joint name="hinge" axis="0 1 0" range="-1 1" limited="true"/>
<geom size="0.05"/></body></body></worldbody><actuator><motor name="m" joint="hinge" gear="3"/></actuator>
</mujoco>"""


@pytest.mark.usefixtures("registered")
def test_a_task_from_a_file_has_its_id(run, tmp_path):
    """Not the path of the file, by which Gymnasium knows nothing."""
    lines = ("import myowarp", f'calm = myowarp.extend("{ELBOW}", "myCalm-v0", rewards={{"act_reg": -2.0}})')
    (tmp_path / "my_tasks.py").write_text("\n".join(lines))
    status, out, err = run("describe", f"{tmp_path}/my_tasks.py:calm", "--json")
    assert status == 0, err
    assert json.loads(out)["id"] == "MyoWarp/myCalm-v0"


@pytest.mark.usefixtures("registered")
def test_a_model_from_a_file_has_units_of_its_own(run, tmp_path):
    """A slide is in metres; a motor's torque follows its gear and the control range that it gets."""
    (tmp_path / "mixed.xml").write_text(MODEL)
    status, out, err = run("describe", "--model", tmp_path / "mixed.xml", "--json")
    assert status == 0, err
    facts = json.loads(out)
    entries = {block["name"]: block["entries"] for block in facts["observation"]["blocks"]}
    assert entries["qpos"] == [{"name": "base", "unit": "m"}, {"name": "hinge", "unit": "rad"}]
    assert entries["qvel"][0]["unit"] == "m per control step"
    assert entries["pose_err"] == [{"name": "hinge", "unit": "rad"}]
    (motor,) = facts["action"]["actuators"]
    assert (motor["quantity"], motor["low"], motor["high"]) == ("torque on hinge", -3.0, 3.0)
    assert facts["muscles"]["muscles"] == []


class Silent(PoseTask):
    """A task from outside that says nothing of its columns and terms, as short as the tables allow."""

    solved_when = failed_when = ""
    draws = ()

    def columns(self, nq, nv, num_muscles):
        columns = super().columns(nq, nv, num_muscles)
        return tuple(dataclasses.replace(column, doc="", names=()) for column in columns)

    def reward_terms(self):
        return tuple(RewardTerm(t.name, t.weight, source=t.source) for t in super().reward_terms())


def test_a_task_that_says_nothing():
    """It need not be registered; names are numbers, and what is missing is said to be missing."""
    spec = Silent(name="silent", body="elbow", target_low=(1.0,), target_high=(1.0,), near=0.1)
    facts = describe(spec)
    assert facts["id"] == "MyoWarp/silent-v0"
    assert facts["observation"]["blocks"][-1]["entries"][5] == {"name": "5", "unit": "1"}
    assert [t["weight"] for t in facts["reward"]["terms"]] == [1, 4, 50, 1, 0]
    text = as_text(facts)
    assert text.count("(the task does not say)") == 4 + 5 + 2


def test_too_few_names():
    column = Column("tips", 3, "m", names=("x", "y"))
    with pytest.raises(ValueError, match="column 'tips' has 3 numbers, but 2 names"):
        column.entries(None)
    assert [entry.name for entry in Column("own", 2, "1").entries(None)] == ["0", "1"]


def test_unknown_name_in_a_long_list():
    """No message lists hundreds of names; it says where they are."""
    registry = Registry("task", listed_by="`myowarp tasks` lists them")
    for i in range(31):
        registry.add(f"task{i:02d}", i)
    with pytest.raises(
        ValueError, match=r"there are 31, such as task00, task01, task02; `myowarp tasks` lists"
    ):
        registry["zzz"]
