"""Tables over time: files of OpenSim, recordings for it, and excitations that are played back."""

import time
from pathlib import Path

import numpy as np
import pytest

from myowarp.apps.policies.find import acting, find_policy
from myowarp.apps.rollouts.recording import recording
from myowarp.apps.rollouts.rollout import roll_out
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.task import TASKS
from myowarp.motion.movement import read_motion
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.osim.body.skeleton import Bones

ARM = Path(__file__).parents[1] / "data" / "osim" / "arm26.osim"
ELBOW = "myoElbowPose1D6MRandom-v0"
# As OpenSim 4.6 writes a table, and as OpenSim 3 wrote a motion.
OPENSIM_4 = """inDegrees=no
DataType=double
version=3
OpenSimVersion=4.6
endheader
time\ta\tb
0\t1\t2
0.5\t1\t2.5
"""
OPENSIM_3 = """Coordinates
version=1
nRows=2
nColumns=3
inDegrees = yes

endheader
 time  a  b
 0     1  2
 .5    1  2.5
"""


@pytest.fixture
def elbow():
    """Return a function that makes elbows."""
    made = []

    def make(num_worlds=1, **options):
        made.append(MyoWarpVectorEnv(ELBOW, num_worlds, device="cpu", progress=False, **options))
        return made[-1]

    yield make
    for env in made:
        env.close()


@pytest.mark.parametrize(
    ("text", "suffix", "in_degrees"),
    [(OPENSIM_4, ".sto", False), (OPENSIM_3, ".mot", True), ("time,a,b\n0,1,2\n0.5,1,2.5\n", ".csv", False)],
    ids=["opensim4", "opensim3", "csv"],
)
def test_files_of_others(tmp_path, text, suffix, in_degrees):
    path = tmp_path / f"file{suffix}"
    path.write_text(text)
    storage = read_storage(path)
    assert (storage.labels, storage.in_degrees) == (("a", "b"), in_degrees)
    np.testing.assert_array_equal(storage.time, [0.0, 0.5])
    np.testing.assert_array_equal(storage.values, [[1.0, 2.0], [1.0, 2.5]])


def test_what_is_written_is_read(tmp_path):
    path, at = tmp_path / "run.sto", np.arange(3) / 3
    write_storage(path, "run", Storage(("a",), at, np.sin(at)[:, None]))
    storage = read_storage(path)
    np.testing.assert_allclose(storage.time, at, rtol=1e-8)
    np.testing.assert_allclose(storage.values[:, 0], np.sin(at), rtol=1e-8)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time\ta\n0\t1\n", "has no line 'endheader'"),
        ("endheader\ntime\ta\n", "at least one row of numbers"),
        ("endheader\na\ttime\n0\t1\n", "first column 'time'"),
        ("endheader\ntime\ta\n0\t1\n0.1\n", "row 2 .* must have 2 cells, got 1"),
        ("endheader\ntime\ta\n0\tx\n", "a cell that is no number"),
        ("endheader\ntime\ta\n0\tnan\n", "finite numbers below .* row 1 has nan in column 'a'"),
        ("endheader\ntime\ta\n0\t1e15\n", "below 1e.15 in size; row 1 has 1e.15 in column 'a'"),
        ("endheader\ntime\ta\n-1e30\t1\n", "row 1 has -1e.30 in column 'time'"),
        ("endheader\ntime\ta\n0\t1_0\n", "row 1 of .* no number: '1_0' in column 'a'"),
        ("endheader\ntime\ta\n0\t\u0663\n", "row 1 of .* no number: '\u0663' in column 'a'"),
        ("endheader\ntime\ta\tb\n0\t\t1\n", "row 1 of .* has an empty cell in column 'a'"),
        (
            "endheader\ntime\ta\n0\t1\n0.00000001\t1\n",
            "1e-07 s apart at least; those of rows 1 and 2 are 1e-08",
        ),
        ("nRows=2\nendheader\ntime\ta\n0\t1\n", "says nRows=2 and has 1 rows; restore what is missing"),
        ("datarows 1\nendheader\ntime\ta\n0\t1\n1\t1\n", "says nRows=1 and has 2 rows"),
        (
            "nColumns=3\nendheader\ntime\ta\n0\t1\n",
            "says nColumns=3 and has 2 columns; .* correct its header",
        ),
        ("a\0b\nendheader\ntime\ta\n0\t1\n", "is no text file in UTF-8 or Latin-1"),
        ("endheader\ntime\ta\n0\t1\n0\t2\n", "must differ; those of rows 1 and 2 are both 0 s"),
        ("endheader\ntime\ta\ta\n0\t1\t1\n", "column 'a' twice"),
    ],
)
def test_bad_files_are_refused(tmp_path, text, message):
    path = tmp_path / "file.sto"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_storage(path)
    with pytest.raises(ValueError, match=message):
        find_policy(str(path), TASKS["myoElbowPose1D6MRandom-v0"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,a\n0,x\n", "row 1 of .* has a cell that is no number: 'x' in column 'a'"),
        ("time,a,b\n0,,1\n", "row 1 of .* has an empty cell in column 'a'"),
        ("time,a,b\n0,1,2\n1,2,\n", "row 2 of .* has an empty cell in column 'b'"),
        ("time,a\n0,1e400\n", "row 1 has inf in column 'a'"),
        ("time;a\n0;1\n", "must have a first column 'time', and at least one more, got 'time;a'"),
        ("time,,b\n0,1,2\n", "has a column without a name, before 'b'"),
        (",,\n,,", "must have a first column 'time'"),
        ("time,a\n0,1\n,\n", "row 2 of .* has an empty cell in column 'time'"),
        ("time,a,\n0,1,\n,\n", "row 2 of .* has an empty cell in column 'time'"),
        ("time,a,\n0,1,\n,,", "row 2 of .* has an empty cell in column 'time'"),
        ("time,a\n0,1\n1,2,3\n", "row 2 of .* must have 2 cells, got 3"),
    ],
)
def test_bad_tables_of_commas_are_refused(tmp_path, text, message):
    path = tmp_path / "file.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_storage(path)


def test_tables_of_commas(tmp_path):
    """With quotes, blanks, and commas at the end of every line."""
    path = tmp_path / "file.csv"
    path.write_text('\ufefftime,"a, b",c,\n"0",1, 2,\n\n0.5,"3",4,\n', encoding="utf-8")
    table = read_storage(path)
    assert table.labels == ("a, b", "c")
    np.testing.assert_array_equal(table.values, [[1.0, 2.0], [3.0, 4.0]])


@pytest.mark.parametrize(
    "line", [" " * 10**6 + "x", "inDegrees" + " =" * 10**6 + "x", "a" * 10**6 + " " * 10**6]
)
def test_long_lines_cost_their_length(tmp_path, line):
    """A search that goes back at every blank would take hours."""
    path = tmp_path / "file.sto"
    path.write_text(f"{line}\nendheader\ntime\ta\n0\t1\n")
    begin = time.process_time()
    assert read_storage(path).labels == ("a",)
    assert time.process_time() - begin < 2.0, "s"


def test_recording_for_opensim(elbow, tmp_path):
    env = elbow(autoreset_mode="same_step", max_episode_steps=6)
    with (
        recording(env.sim, tmp_path / "run.npz") as arrays,
        recording(env.sim, tmp_path / "run.sto") as table,
    ):
        env.reset(seed=3)
        for step in range(12):
            env.step(np.full((1, 6), 0.1 * step, dtype=np.float32))
            arrays.add()
            table.add()
    muscles, joints = read_storage(tmp_path / "run.sto"), read_storage(tmp_path / "run.mot")
    with np.load(tmp_path / "run.npz") as file:
        for name in ("activation", "force", "power"):
            column = muscles.labels.index(f"BRA.{name}")
            expected = file[name][:, 0, list(file["muscles"]).index("BRA")]
            np.testing.assert_allclose(muscles.values[:, column], expected, rtol=1e-6)
        np.testing.assert_allclose(joints.values, file["angle"][:, 0], rtol=1e-6)
    np.testing.assert_allclose(muscles.time, 0.02 * np.arange(1, 13), rtol=1e-6)
    np.testing.assert_array_equal(muscles.values[:, 0], [1] * 6 + [2] * 6)
    assert joints.labels == ("r_elbow_flex",)
    assert not joints.in_degrees


def test_recording_of_many_worlds_is_refused(elbow, tmp_path):
    with (
        pytest.raises(ValueError, match=r"one world, got 2 worlds"),
        recording(elbow(2).sim, tmp_path / "a.sto"),
    ):
        pass


def test_a_recording_plays_itself(elbow, tmp_path):
    """Excitations come back through the map of actions: the same movement, to the rounding of the file."""
    env = elbow(autoreset_mode="same_step")
    angles = []
    for policy in ("random", str(tmp_path / "random.sto")):
        path = tmp_path / f"{policy if policy == 'random' else 'again'}.sto"
        with recording(env.sim, path) as recorder:
            roll_out(env.sim, find_policy(policy, TASKS["myoElbowPose1D6MRandom-v0"]), 60, recorder)
        angles.append(read_storage(path.with_suffix(".mot")).values[:, 0])
    assert np.ptp(angles[0]) > 0.1
    np.testing.assert_allclose(angles[1], angles[0], atol=1e-4)


def test_excitations_between_the_rows(elbow, tmp_path):
    """Linear between rows, kept beyond them, cut where an action gives no more; each world at its time."""
    env = elbow(2)
    names, path = env.muscle_names, tmp_path / "controls.csv"
    rows = [[0.02, *[0.1] * 6], [0.08, *[0.4] * 6], [0.1, *[1.0] * 6]]
    path.write_text("\n".join([",".join(("time", *names)), *(",".join(map(str, row)) for row in rows)]))
    act = acting(find_policy(str(path), TASKS["myoElbowPose1D6MRandom-v0"]), env.sim)
    most = 1.0 / (1.0 + np.exp(-2.5))
    obs, _ = env.reset(seed=0)
    for expected in (0.1, 0.2, 0.3, 0.4, most, most):
        obs = env.step(act(obs))[0]
        np.testing.assert_allclose(env.sim.scene.data.ctrl.numpy(), expected, rtol=1e-5)
    env.reset(options={"reset_mask": np.array([True, False])})
    env.step(act(obs))
    np.testing.assert_allclose(env.sim.scene.data.ctrl.numpy()[:, 0], [0.1, most], rtol=1e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,BRA\n0,0.1\n", "has no excitation of muscle 'TRIlong'"),
        ("time,{names}\n0,{values},1.5\n", "must be from 0 to 1; BRA has 1.5 at 0 s"),
    ],
)
def test_excitations_that_do_not_fit(elbow, tmp_path, text, message):
    env, path = elbow(), tmp_path / "controls.csv"
    path.write_text(text.format(names=",".join(env.muscle_names), values=",".join(["0.1"] * 5)))
    with pytest.raises(ValueError, match=message):
        acting(find_policy(str(path), TASKS["myoElbowPose1D6MRandom-v0"]), env.sim)


def test_a_recording_for_opensim_without_a_sample_is_refused(elbow, tmp_path):
    with pytest.raises(ValueError, match="has no sample"), recording(elbow().sim, tmp_path / "run.sto"):
        pass
    assert not list(tmp_path.iterdir())


def test_a_row_that_says_the_same_twice(tmp_path, caplog):
    """As the last one of RRA's files."""
    path = tmp_path / "rra.sto"
    path.write_text("endheader\ntime\ta\tb\n0\t1\t100\n0.1\t2\t200\n0.1\t2\t200.0000001\n")
    table = read_storage(path)
    np.testing.assert_array_equal(table.values, [[1, 100], [2, 200]])
    assert "row 3 says the same as 2; left out" in caplog.text


@pytest.mark.parametrize("title", ["Speeds", "Accelerations", "PositionErrors"])
def test_files_that_hold_no_motion(tmp_path, title):
    """OpenSim's RRA and CMC name their columns by coordinates in all of these files."""
    path = tmp_path / "walk_Kinematics_u.sto"
    path.write_text(f"{title}\nversion=1\ninDegrees=yes\nendheader\ntime\tr_elbow_flex\n0\t1\n0.1\t2\n")
    with pytest.raises(ValueError, match=f"calls itself '{title}'; a motion holds coordinates"):
        read_motion(path, Bones.read(ARM))
