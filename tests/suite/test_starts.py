"""Random starts: where they put what lies in the hand, what they may not touch, and that they do not fail."""

from functools import lru_cache

import mujoco
import numpy as np
import pytest
from often import of_each, often

from myowarp.definitions.body import BODIES
from myowarp.definitions.task import TASKS
from myowarp.sim import starts
from myowarp.sim.build import oracle_model
from myowarp.sim.palm import Palm, coordinates, joint_address
from myowarp.sim.simulation import Simulation
from myowarp.sim.starts import FAIL_STEPS, PENETRATION, posture_joints, start_address

SCENES = sorted({TASKS[key].scene_key: key for key in TASKS if "Random" in key or "P2" in key}.values())
TOUCHING = [key for key in SCENES if TASKS[key].body == "contact_hand"]
CARRYING = [key for key in SCENES if TASKS[key].carried]
ELBOW, KEY = "myoElbowPose1D6MRandom-v0", "myoHandKeyTurnRandom-v1"

NUM_STARTS = 256  # the first rows of the full table: starts are found one after the other
NUM_WORLDS = 256
NUM_ROWS = 50  # of a table, checked in MuJoCo C
FAILING = 0.01  # share of random starts that may fail at once
DOUBLE = 1e-9  # m and 1, rounding of poses in double precision
FLOAT32 = 1e-6  # rad, rounding of joint angles
SPREAD = 0.3  # mean standard deviation of the joints, over that of a draw uniform in their ranges
DIE_SPREAD, DIE_STILL = 0.2, 2  # a die on the palm leaves the hand less room, and two joints none
MOVED = 0.01  # m; the palm carries objects farther than this
LARGEST = (0.03, 0.03, 0.03)  # m, semi-axes of the largest object to hold


@pytest.fixture(autouse=True)
def few_starts(monkeypatch):
    """Look for fewer starts; the cache keeps these tables apart from the full ones."""
    monkeypatch.setattr(starts, "NUM_STARTS", NUM_STARTS)


@lru_cache
def model_of(key):
    """Return the model of a task in MuJoCo C."""
    return oracle_model(TASKS[key])


def table_of(key):
    """Return whole configurations with the random starts of a task in them, shape (num_starts, nq)."""
    spec, model = TASKS[key], model_of(key)
    table = starts.find_starts(spec, progress=False).values
    qpos = np.tile(spec.start(model), (len(table), 1))
    qpos[:, start_address(spec, model)] = table
    return qpos


def simulation(key, reset="random", num_worlds=NUM_WORLDS):
    """Return a freshly reset simulation."""
    settings = {"device": "cpu", "graph": False, "progress": False, "autoreset": "disabled"}
    sim = Simulation(TASKS[key], num_worlds, shards=1, reset=reset, **settings)
    sim.reset(seeds=np.arange(num_worlds))
    return sim


def share_failing(key):
    """Return the share of random starts that fail within five steps under zero action."""
    sim = simulation(key)
    failed = np.zeros(NUM_WORLDS, dtype=bool)
    for _ in range(FAIL_STEPS):
        sim.step()
        failed |= sim.transition.terminated.numpy()
    return failed.mean()


def posed(model, qpos):
    """Return data of MuJoCo C with the positions and contacts of a configuration."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)
    return data


def random_rotation(rng):
    """Return a rotation matrix, uniformly drawn."""
    quat, matrix = rng.normal(size=4), np.empty(9)
    mujoco.mju_quat2Mat(matrix, quat / np.linalg.norm(quat))
    return matrix.reshape(3, 3)


@pytest.mark.parametrize("key", of_each(CARRYING))
def test_coordinates_give_the_pose(key):
    """Free joint, and three slides and hinges: MuJoCo's forward kinematics finds the pose asked for."""
    model, rng = model_of(key), np.random.default_rng(0)
    for name in TASKS[key].carried:
        body = model.body(name).id
        for _ in range(20):
            rotation, position = random_rotation(rng), rng.normal(size=3)
            qpos = model.qpos0.copy()
            qpos[joint_address(model, body)] = coordinates(model, body, rotation, position)
            data = posed(model, qpos)
            np.testing.assert_allclose(data.xpos[body], position, atol=DOUBLE)
            np.testing.assert_allclose(data.xmat[body].reshape(3, 3), rotation, atol=DOUBLE)


def test_what_cannot_be_carried_is_refused():
    model = model_of(KEY)
    expected = (
        r"^body 'key' cannot lie in the hand: in the world it needs a free joint, or three slides and then "
        r"three hinges along x, y, z that are 0 at rest$"
    )
    with pytest.raises(ValueError, match=expected):
        coordinates(model, model.body("key").id, np.eye(3), np.zeros(3))
    with pytest.raises(
        ValueError, match=r"^key cannot lie in the hand: the body names no palm; name one where"
    ):
        Palm(model, model.qpos0, None, ("key",))


def test_palm_is_one_rigid_body():
    """The metacarpals of the four fingers and the frame of the baoding targets move as the palm does."""
    model = model_of("myoChallengeBaodingP2-v1")
    palm = model.body(BODIES["contact_hand"].palm).id
    for name in ("secondmc_r", "thirdmc_r", "fourthmc_r", "fifthmc_r"):
        assert model.body_weldid[model.body(name).id] == palm
    assert model.body_weldid[model.site_bodyid[model.site("palm_frame").id]] == palm


@pytest.mark.parametrize("key", often(CARRYING, ["myoHandObjHoldRandom-v0"]))
def test_objects_keep_their_place_in_the_palm(key):
    """T_palm^-1 T_object is that of the task's own start, in every row of the table."""
    spec, model = TASKS[key], model_of(key)
    palm = model.body(BODIES[spec.body].palm).id
    places, moves = [], []
    for qpos in (spec.start(model), *table_of(key)[:NUM_ROWS]):
        data = posed(model, qpos)
        frame = data.xmat[palm].reshape(3, 3)
        for body in (model.body(name).id for name in spec.carried):
            place = frame.T @ (data.xpos[body] - data.xpos[palm])
            places.append([*place, *(frame.T @ data.xmat[body].reshape(3, 3)).ravel()])
            moves.append(data.xpos[body].copy())
    own = len(spec.carried)
    expected = np.tile(places[:own], (NUM_ROWS, 1))
    np.testing.assert_allclose(places[own:], expected, atol=DOUBLE)
    assert np.linalg.norm(np.ptp(moves, axis=0)) > MOVED


@pytest.mark.parametrize("key", of_each(SCENES))
def test_starts_are_rows_of_the_table(key):
    """They differ and lie within the ranges; what does not lie in the hand is where the task puts it."""
    sim, fixed = simulation(key, num_worlds=24), simulation(key, "fixed", num_worlds=24)
    model, table = sim.scene.oracle, sim.shards[0].starts.numpy()
    address = start_address(TASKS[key], model)
    assert table.shape == (NUM_STARTS, len(address))
    qpos = sim.scene.data.qpos.numpy()
    distance = np.abs(table[None] - qpos[:, None, address]).max(axis=2)
    assert distance.min(axis=1).max() == 0
    assert len(np.unique(distance.argmin(axis=1))) > 12
    others = np.setdiff1d(np.arange(model.nq), address)
    np.testing.assert_array_equal(qpos[:, others], fixed.scene.data.qpos.numpy()[:, others])
    posture = table[:, : len(posture_joints(model))]
    low, high = model.jnt_range[posture_joints(model)].T
    assert (posture >= low - FLOAT32).all()
    assert (posture <= high + FLOAT32).all()
    spread = posture.std(axis=0) / ((high - low) / np.sqrt(12))
    die = TASKS[key].family == "diereorient"
    assert spread.mean() > (DIE_SPREAD if die else SPREAD)
    assert (spread <= 0.01).sum() <= (DIE_STILL if die else 0), "a joint does not move"


def test_key_keeps_the_angle_that_the_task_draws():
    sim = simulation(KEY)
    hinge = model_of(KEY).joint("keyjoint").qposadr[0]
    assert hinge not in start_address(TASKS[KEY], model_of(KEY))
    angle = sim.scene.data.qpos.numpy()[:, hinge]
    assert angle.min() < -1.4
    assert angle.max() > 1.4


def depths(model, qpos):
    """Return how deep each pair of touching geoms penetrates [m]."""
    deepest = {}
    contact = posed(model, qpos).contact
    for pair, distance in zip(map(tuple, contact.geom.tolist()), contact.dist, strict=True):
        deepest[pair] = max(deepest.get(pair, 0.0), -distance)
    return deepest


@pytest.mark.parametrize("key", of_each(TOUCHING))
def test_nothing_penetrates_deeper_than_in_the_start(key):
    """No pair of geoms; objects to hold at their largest, balls and keys nominal."""
    spec, model = TASKS[key], oracle_model(TASKS[key])
    if spec.family == "objecthold":
        geom = model.geom("object").id
        model.geom_size[geom] = model.geom_aabb[geom, 3:] = LARGEST
        model.geom_rbound[geom] = max(LARGEST)
    allowed = depths(model, spec.start(model))
    for qpos in table_of(key)[:NUM_ROWS]:
        for pair, depth in depths(model, qpos).items():
            assert depth <= allowed.get(pair, 0.0) + 1.1 * PENETRATION, [model.geom(g).name for g in pair]


@pytest.mark.parametrize("key", of_each(SCENES))
def test_starts_do_not_fail_at_once(key):
    """With sizes, masses, places and goals as the task draws them, in seeds that the search did not use."""
    assert share_failing(key) < FAILING


@pytest.mark.slow
def test_without_the_trial_starts_fail_at_once(monkeypatch, tmp_path):
    """What the test above measures is due to the trial in the engine."""
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(starts, "NUM_STARTS", 64)
    monkeypatch.setattr(starts.Search, "fails", lambda self, age: np.zeros(starts.BATCH, dtype=bool))
    assert share_failing(KEY) > 10 * FAILING


def test_an_object_that_leaves_its_place_is_lost():
    """Balls that fall off count as lost long before the task fails: 0.2 m lower."""
    spec = TASKS["myoChallengeBaodingP1-v1"]
    search = starts.Search(spec, simulation(spec.key, "fixed").shards[0])
    search.shard.step()
    age = np.ones(NUM_WORLDS, dtype=np.int32)
    assert not search.lost(age).any()
    qpos = search.shard.scene.data.qpos.numpy().copy()
    qpos[3, joint_address(search.model, search.model.body("ball2").id)[2]] -= starts.HOLD_DISTANCE
    search.shard.scene.data.qpos.assign(qpos)
    assert np.flatnonzero(search.lost(age)).tolist() == [3]


def test_search_is_made_once_with_a_bar_if_wanted(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(starts, "PATIENCE", -1.0)
    table = starts.find_starts(TASKS[ELBOW], progress=True).values
    assert f"{NUM_STARTS}/{NUM_STARTS}" in (shown := capsys.readouterr()).err
    assert "Finding random starts" in shown.err
    assert not shown.out
    monkeypatch.setattr(starts, "Search", lambda *args: pytest.fail("searched again"))
    np.testing.assert_array_equal(starts.find_starts(TASKS[ELBOW], progress=True).values, table)
    assert not capsys.readouterr().err


def test_no_bar_where_none_is_wanted(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(starts, "PATIENCE", -1.0)
    assert len(starts.find_starts(TASKS[ELBOW], progress=False).values) == NUM_STARTS
    assert not capsys.readouterr().err


def test_too_few_starts_is_an_error(monkeypatch, tmp_path):
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(starts, "MAX_DRAWS", 100)
    message = (
        f"^task '{ELBOW}' has too few random starts: 0 of {NUM_STARTS} after 100 draws; use reset='fixed'$"
    )
    with pytest.raises(ValueError, match=message):
        starts.find_starts(TASKS[ELBOW], progress=False)


def test_an_edit_of_the_code_renews_the_table(monkeypatch):
    """Imports of a family's file count, and so does the code of the search."""
    read = []
    original = starts.Path.read_bytes
    monkeypatch.setattr(starts.Path, "read_bytes", lambda path: read.append(path.name) or original(path))
    starts.find_starts(TASKS[ELBOW], progress=False)
    assert {"baoding_balls.py", "pose.py", "contact_hand.py", "slim.py", "build.py", "starts.py"} <= set(read)
