"""How tasks are written: ids in full, sources of columns and terms, scores that only look, free roots."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import warp as wp
from often import of_each
from structs import is_struct

import myowarp.tasks
from myowarp.definitions.body import BODIES, CAUTIOUS_STEP, CoarseStep
from myowarp.definitions.task import TASKS, task
from myowarp.kernels.world_function import Row, num_numbers
from myowarp.models.bodies.from_file import register_body
from myowarp.sim.simulation import Simulation
from myowarp.tasks.pose import PoseTask, sample_configuration
from myowarp.tasks.reach import ReachTask

FILES = Path(myowarp.tasks.__file__).parent.glob("*.py")
IDS = {key for key in TASKS if TASKS[key].name not in BODIES}  # before tests add some
CALL = re.compile(r'^(?:@task|sign)\("([^"]+)"', re.MULTILINE)
WRITTEN = [key for path in FILES for key in CALL.findall(path.read_text())]
SCENES = sorted({TASKS[key].scene_key: key for key in WRITTEN}.values())
NUM_WORLDS = 7
VALUE_TOLERANCE = 1e-6  # float32

FREE_ROOT = """
<mujoco model="free root">
  <compiler angle="radian"/>
  <worldbody>
    <body name="trunk" pos="0.1 0.2 1"><freejoint/><geom size="0.1" mass="5"/>
      <body pos="0 0 -0.2"><joint name="hip" type="ball" range="0 1" damping="1"/><geom size="0.05" mass="1"/>
        <body pos="0 0 -0.2"><joint name="knee" axis="0 1 0" range="0.2 1.5" damping="1"/>
          <geom size="0.04" pos="0 0 -0.1" mass="1"/><site name="foot" pos="0 0 -0.2"/>
          <body pos="0 0 -0.2"><joint name="wheel" axis="0 1 0" damping="1"/>
            <geom size="0.02" mass="0.1"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="knee" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
KNEE, WHEEL = 11, 12  # in qpos


@pytest.fixture(scope="module")
def trunk(tmp_path_factory):
    """Return the name of a body with a free root, a ball joint, a hinge with a range and one without."""
    path = tmp_path_factory.mktemp("bodies") / "free_root.xml"
    path.write_text(FREE_ROOT)
    return register_body(path, tips=("foot",))[0]


def test_every_id_is_written_in_full():
    """`grep` finds the one line that registers an id."""
    assert len(WRITTEN) == len(set(WRITTEN))
    assert set(WRITTEN) == IDS


@pytest.mark.parametrize("key", WRITTEN)
def test_every_block_and_term_has_its_source(key):
    """A block is a whole number of what its function returns, and a term is one number."""
    for column in TASKS[key].columns(40, 39, 39):
        if not isinstance(column.source, Row):
            assert column.size % num_numbers(column.source) == 0, column.name
    for term in TASKS[key].reward_terms():
        assert num_numbers(term.source) == 1, term.name
    assert {"solved", "failed"} <= TASKS[key].measures.keys()


def test_an_id_has_a_version():
    message = "^task id 'myReach' must be a name and a version, such as 'myoHandPoseFixed-v0'$"
    with pytest.raises(ValueError, match=message):
        task("myReach")


def test_docstring_is_the_doc():
    """Its lines are joined, and the reason for the version follows."""
    wide = (
        "Bring all five fingertips to points drawn anew each episode, all within reach at once. In v0, as in"
    )
    assert TASKS["myoHandReachRandom-v1"].doc.startswith(wide)
    assert TASKS["myoHandPose3Fixed-v0"].doc == "Sign the digit 3 in American Sign Language."
    why = "Sign the digit 3 in American Sign Language. Thumb base angles belong to their axes; in v0,"
    assert TASKS["myoHandPose3Fixed-v1"].doc.startswith(why)


def test_coarse_step_is_the_family_s_or_the_body_s():
    assert TASKS["myoHandReachFixed-v0"].coarse_step is BODIES["hand"].coarse_step
    assert TASKS["motorFingerPoseFixed-v0"].coarse_step is CAUTIOUS_STEP
    assert BODIES["contact_hand"].coarse_step is CAUTIOUS_STEP
    assert TASKS["myoHandKeyTurnFixed-v0"].coarse_step == CoarseStep(0.004, 0.35)


def state(sim):
    """Return a copy of all that a score could change: data, episode, and the program's arrays."""
    owners = [sim.shards[0].program, sim.scene.data, sim.episode, sim.scene.muscles]
    owners += [value for value in vars(sim.shards[0].program).values() if is_struct(value)]
    arrays = {}
    for i, owner in enumerate(owners):
        for name, value in vars(owner).items():
            if isinstance(value, wp.array):
                arrays[i, name] = value.numpy().copy()
    return arrays


@pytest.mark.parametrize("key", of_each(SCENES))
def test_score_only_looks(key):
    """Twice the same terms, whatever stood there, and nothing moves; late in the episode, too."""
    sim = Simulation(TASKS[key], NUM_WORLDS, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    sim.step()
    before, results = state(sim), []
    assert len(before) > 20
    step_count = wp.full(NUM_WORLDS, 77, dtype=int, device="cpu")
    for poison in (np.nan, 1e3):
        terms = wp.full((NUM_WORLDS, len(TASKS[key].reward_terms())), poison, dtype=float, device="cpu")
        flags = [wp.full(NUM_WORLDS, bool(poison > 0), dtype=bool, device="cpu") for _ in range(2)]
        sim.shards[0].program.score(step_count, terms, *flags)
        results.append([array.numpy() for array in (terms, *flags)])
    for first, second in zip(*results, strict=True):
        assert np.isfinite(first).all()
        np.testing.assert_array_equal(first, second)
    for name, values in state(sim).items():
        np.testing.assert_array_equal(values, before[name], err_msg=str(name))


def test_arguments_that_are_not_there():
    spec = TASKS["myoElbowPose1D6MFixed-v0"]
    sim = Simulation(spec, 1, device="cpu", graph=False, progress=False)
    message = (
        "^kernel sample_configuration needs 'mask'; it is not given, and no attribute of PoseProgram, Po"
    )
    with pytest.raises(TypeError, match=message):
        sim.shards[0].program.launch(sample_configuration)
    with pytest.raises(TypeError, match=r"^kernel sample_configuration takes .*, qpos, got step_count too$"):
        sim.shards[0].program.launch(sample_configuration, step_count=sim.episode.step_count)
    program = sim.shards[0].program
    message = (
        f"^task '{spec.key}' needs 'no_such_array'; it is not given, and no attribute of PoseProgram, Po"
    )
    with pytest.raises(ValueError, match=message):
        program.around((of_nothing,), (), ())
    message = "^measure 'b' must not need its own value, but those that it reads do$"
    with pytest.raises(ValueError, match=message):
        program.around((of_a,), (("a", of_b), ("b", of_a)), ())
    program = Simulation(spec, 2, device="cpu", graph=False, progress=False).shards[0].program
    message = f"^task '{spec.key}' reads 'body_mass' world by world, of which there is one for all; a field"
    with pytest.raises(ValueError, match=message):
        program.around((of_model,), (), ())


@wp.func
def of_a(a: float) -> float:
    return a


@wp.func
def of_b(b: float) -> float:
    return b


@wp.func
def of_model(body_mass: wp.array[float]) -> float:
    return body_mass[0]


@wp.func
def of_nothing(no_such_array: wp.array[float]) -> float:
    return no_such_array[0]


def by_name(sim):
    """Return the observation, block by block."""
    ends = np.cumsum([column.size for column in sim.columns])
    parts = np.split(sim.transition.obs.numpy(), ends, axis=1)
    assert parts.pop().shape[1] == 0, "columns that no block has"
    return {column.name: part for column, part in zip(sim.columns, parts, strict=True)}


def moved(spec):
    """Return a simulation after a step in which the root falls."""
    sim = Simulation(spec, NUM_WORLDS, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    sim.step()
    assert np.abs(sim.scene.data.qvel.numpy()[:, 2]).min() > 0.05
    return sim


def assert_observed(sim, seen):
    """Assert that angles and rates are observed where the columns say."""
    data = sim.scene.data
    assert (seen["qpos"].shape[1], seen["qvel"].shape[1]) == (13, 11)
    np.testing.assert_allclose(seen["qpos"], data.qpos.numpy(), atol=VALUE_TOLERANCE)
    np.testing.assert_allclose(seen["qvel"], sim.scene.control_dt * data.qvel.numpy(), atol=VALUE_TOLERANCE)


def test_reach_with_a_free_root(trunk):
    point = (0.1, 0.2, 0.3)
    spec = ReachTask(
        name="footReach", body=trunk, center=point, low=(0.0,) * 3, high=(0.0,) * 3, far_per_tip=9
    )
    sim = moved(spec)
    seen = by_name(sim)
    assert_observed(sim, seen)
    foot = sim.scene.data.site_xpos.numpy()[:, sim.scene.site_id("foot")]
    np.testing.assert_allclose(seen["tip_pos"], foot, atol=VALUE_TOLERANCE)
    np.testing.assert_allclose(seen["reach_err"], point - foot, atol=VALUE_TOLERANCE)


def test_pose_with_a_free_root(trunk):
    """Targets are of hinges and slides; a random start leaves root, ball and what has no range alone."""
    low, high = (0.3, -0.1), (0.3, 0.1)
    spec = PoseTask(
        name="trunkPose", body=trunk, target_low=low, target_high=high, near=0.1, random_start=True
    )
    sim = Simulation(spec, NUM_WORLDS, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    drawn, start = sim.scene.data.qpos.numpy().copy(), mujoco.MjModel.from_xml_string(FREE_ROOT).qpos0
    rest = np.arange(13) != KNEE
    np.testing.assert_allclose(drawn[:, rest], np.tile(start[rest], (NUM_WORLDS, 1)), atol=VALUE_TOLERANCE)
    assert ((drawn[:, KNEE] > 0.2) & (drawn[:, KNEE] < 1.5)).all()
    assert np.ptp(drawn[:, KNEE]) > 0.3
    sim = moved(spec)
    seen = by_name(sim)
    assert_observed(sim, seen)
    error = sim.shards[0].program.target.numpy() - sim.scene.data.qpos.numpy()[:, [KNEE, WHEEL]]
    np.testing.assert_allclose(seen["pose_err"], error, atol=VALUE_TOLERANCE)
