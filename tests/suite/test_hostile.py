"""What nobody should pass: each is refused in one sentence before anything is built, and nothing is lost.

Properties instead of lists where the inputs are many: seeds, masks, actions, options, cells of tables. The
caches are in test_kernel_cache.py and test_cache.py, threads in test_threads.py, the `.osim` files in
test_opensim_fuzz.py.
"""

import math
import re
import warnings
from pathlib import Path

import gymnasium as gym
import mujoco_warp as mjw
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from benchmarks.memory import asked_for, count
from myowarp.definitions.condition import CONDITIONS, resolve
from myowarp.definitions.muscle_table import MuscleTable
from myowarp.definitions.task import TASKS
from myowarp.disk import number_in
from myowarp.extras import to_install
from myowarp.models.conditions.exoskeleton import Exoskeleton
from myowarp.sim import memory, simulation
from myowarp.sim.patient_columns import COLUMNS, CohortColumn
from myowarp.sim.patient_table import read_population
from myowarp.tasks.variants import variants
from myowarp.view import modes

TASK = "myoElbowPose1D6MRandom-v0"
ID = f"MyoWarp/{TASK}"
NUM_ENVS, NUM_ACTIONS = 3, 6
MUSCLES = ("TRIlong", "TRIlat", "TRImed", "BIClong", "BICshort", "BRA")
ROOT = Path(__file__).parents[2]

fixtures = HealthCheck.function_scoped_fixture
several = settings(max_examples=25, deadline=None, suppress_health_check=[fixtures])
anything = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.floats(),
    st.text(max_size=5),
    st.binary(max_size=5),
    st.lists(st.integers(-3, 3), max_size=4),
    st.sets(st.integers(0, 9), max_size=4),
    st.dictionaries(st.integers(0, 3), st.integers(0, 3), max_size=3),
    st.complex_numbers(),
)


@pytest.fixture(scope="module")
def env():
    made = gym.make_vec(ID, num_envs=NUM_ENVS, device="cpu", progress=False)
    made.reset(seed=0)
    return made


def is_sentence(error):
    """One line of words for people."""
    return "\n" not in str(error) and re.match(r"\w.{9,}", str(error)) is not None


def is_seed(value):
    return type(value) is int and 0 <= value < 2**64


@several
@given(seed=st.one_of(anything, st.lists(anything, min_size=3, max_size=3)))
def test_seeds(env, seed):
    """Refused, or those numbers and no others: a seed's reset differs from that of 2**64 more."""
    entries = seed if isinstance(seed, list) else NUM_ENVS * [seed]
    right = all(entry is None or is_seed(entry) for entry in entries) and len(entries) == NUM_ENVS
    if type(seed) is int:
        right = 0 <= seed <= 2**64 - NUM_ENVS
    if right:
        first = env.reset(seed=seed)[0]
        if seed is not None and None not in entries:
            np.testing.assert_array_equal(env.reset(seed=seed)[0], first)
        return
    before = env.unwrapped.sim.scene.keys.episode.numpy().copy()
    with pytest.raises(ValueError, match=r"^seeds? must ") as caught:
        env.reset(seed=seed)
    assert is_sentence(caught.value)
    np.testing.assert_array_equal(env.unwrapped.sim.scene.keys.episode.numpy(), before)


@several
@given(
    values=st.lists(st.floats(width=32), min_size=18, max_size=18),
    dtype=st.sampled_from(["f2", "f4", "f8", "i4", "u1", "?", "O", "c8"]),
    shape=st.sampled_from([(3, 6), (6, 3), (18,), (3, 6, 1), (1, 3, 6)]),
)
def test_actions(env, values, dtype, shape):
    """Finite floating point in the right shape, clipped; the rest is refused and no world is stepped."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        actions = np.nan_to_num(np.array(values)).astype(dtype) if dtype in ("i4", "u1", "?") else None
        actions = np.array(values).astype(dtype) if actions is None else actions
    actions = actions.reshape(shape)
    right = dtype[0] == "f" and shape == (NUM_ENVS, NUM_ACTIONS) and bool(np.isfinite(actions).all())
    env.reset(seed=1)
    steps = env.unwrapped.sim.episode.step_count
    if right:
        obs, reward, *_, info = env.step(actions)
        assert np.isfinite(obs).all()
        assert np.isfinite(reward).all()
        assert not info["fault"].any()
        env.reset(seed=1)
        np.testing.assert_array_equal(env.step(actions.clip(-1, 1))[0], obs)
        return
    with pytest.raises(ValueError, match=r"^actions must be ") as caught:
        env.step(actions)
    assert is_sentence(caught.value)
    assert not steps.numpy().any()


FLAGS = [
    (name, field)
    for name in CONDITIONS
    for field, default in vars(CONDITIONS[name]).items()
    if isinstance(default, bool)
]


def test_there_are_flags():
    known = {("exoskeleton", "motor"), ("fatigue_3ccr", "carry_over"), ("fatigue_ma2009", "observe")}
    assert known <= set(FLAGS)


@several
@given(which=st.sampled_from(FLAGS), value=anything)
def test_flags_of_conditions(which, value):
    assume(not isinstance(value, bool))
    name, field = which
    with pytest.raises(ValueError, match=rf"^{name} {field} must be True or False, got ") as caught:
        resolve([CONDITIONS[name](**{field: value})], TASKS[TASK])
    assert is_sentence(caught.value)


def test_numpy_flags_are_flags():
    assert resolve(Exoskeleton(motor=np.True_), TASKS[TASK])[0].undriven == ()


@pytest.fixture
def nothing_is_built(monkeypatch):
    monkeypatch.setattr(simulation, "compile_scene", lambda *args, **options: pytest.fail("built"))


@several
@given(option=st.sampled_from(["copy", "deterministic", "progress"]), value=anything)
def test_flags_of_environments(nothing_is_built, option, value):
    assume(not isinstance(value, bool) and not (option == "copy" and value is None))
    with pytest.raises(ValueError, match=rf"^{option} must be True or False, got ") as caught:
        gym.make_vec(ID, num_envs=2, device="cpu", **{option: value})
    assert is_sentence(caught.value)


@several
@given(option=st.sampled_from(["num_envs", "max_episode_steps", "shards"]), value=anything)
def test_counts(nothing_is_built, option, value):
    """More worlds than memory holds are below."""
    assume(not (type(value) is int and value >= 1 and (value < 2**31 or option == "num_envs")))
    assume(value is not None or option == "num_envs")
    with pytest.raises(ValueError, match=rf"^{option} must be ") as caught:
        gym.make_vec(ID, **({"num_envs": 2, "device": "cpu", "progress": False} | {option: value}))
    assert is_sentence(caught.value)


@several
@given(size=st.one_of(anything, st.tuples(st.integers(-5, 10**7), st.integers(4097, 10**7))))
def test_sizes_of_pictures(nothing_is_built, size):
    assume(not (isinstance(size, list) and len(size) == 2 and min(size) > 0))
    with pytest.raises(ValueError, match=r"^render_size must be two integers from 1 to 4096") as caught:
        gym.make_vec(ID, num_envs=2, device="cpu", render_mode="rgb_array", render_size=size)
    assert is_sentence(caught.value)


@pytest.mark.parametrize("num_envs", [200_000_000, 10**9, 2**40])
def test_more_worlds_than_memory(num_envs, monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda device: 10**10)
    sentence = rf"^{num_envs:,} worlds need at least [\d,.]+ GB of memory, got 10\.0 GB on cpu; use at most "
    with pytest.raises(ValueError, match=sentence) as caught:
        gym.make_vec(ID, num_envs=num_envs, device="cpu", progress=False)
    fitting = int(str(caught.value).split()[-2].replace(",", ""))
    assert 10**10 / 100_000 < fitting < 10**10 / 1_000


def test_estimated_memory_is_what_the_arrays_take():
    """Held against the arrays of a larger scene."""
    sim = simulation.Simulation(TASKS["myoHandReachRandom-v1"], 40, device="cpu", progress=False)
    capacity = sim.scene.capacity

    def make(number):
        return mjw.make_data(sim.scene.oracle, nworld=number, nconmax=capacity.contacts, njmax=capacity.rows)

    one, two, forty = (memory.num_bytes(make(number)) for number in (1, 2, 40))
    assert forty == pytest.approx(one + 39 * (two - one), rel=0.02)
    assert memory.num_bytes(sim.scene.data) == pytest.approx(forty, rel=0.05)


@pytest.mark.parametrize("physics", ["fast", pytest.param("parity", marks=pytest.mark.slow)])
def test_legs_are_asked_for_nearly_all_that_they_take(physics):
    """Beside Warp's count of arrays; under `fast` they have free coordinates, too."""
    key = "myoLegStandRandom-v0"
    taken = count(key, physics, (2, 34))["arrays"]
    assert 0.85 * taken < asked_for(key, physics) <= taken


def test_memory_of_ground_per_world(monkeypatch):
    """Is that of its heights, beside what the engine's arrays take."""
    key = "myoLegHillyTerrainWalk-v1"
    sim = simulation.Simulation(TASKS[key], 2, device="cpu", graph=False, progress=False)
    heights, scene = sim.shards[0].program.heights, sim.scene

    def engine(number):
        rows = {"nconmax": scene.capacity.contacts, "njmax": scene.capacity.rows}
        return memory.num_bytes(mjw.make_data(scene.oracle, nworld=number, **rows))

    monkeypatch.setattr(memory, "available_memory", lambda device: 10**10)
    with pytest.raises(ValueError, match="worlds need at least") as caught:
        simulation.Simulation(TASKS[key], 10**6, device="cpu", progress=False)
    fitting = int(str(caught.value).split()[-2].replace(",", ""))
    by_heights = 1e10 / fitting - (engine(2) - engine(1))
    assert by_heights == pytest.approx(heights.capacity / 2, rel=0.1)


def as_people_write_it(text):
    """A decimal number in ASCII, as RFC 4180 tables and spreadsheets have it."""
    digits, rest = "0123456789", text.strip(" \t").removeprefix("+").removeprefix("-")
    return set(text.strip(" \t")) <= {*digits, *".eE+-"} and rest[:1] in {*digits, "."} and _is_float(rest)


def _is_float(text):
    try:
        return math.isfinite(float(text)) or "e" in text.lower()
    except ValueError:
        return False


NUMBERS = [name for name in COLUMNS if type(COLUMNS[name]) is CohortColumn]
numerals = st.text(alphabet="0123456789.eE+-_ \t\u0661\uff11\u00b2\u00bdinfa\x00", max_size=8)


@several
@given(name=st.sampled_from(NUMBERS), cell=st.one_of(numerals, st.text(max_size=8)))
def test_cells_of_a_cohort(tmp_path, name, cell):
    """A number as people write it, in its range, or a sentence that names row and column."""
    assume(".." not in cell)  # what is drawn
    column = COLUMNS[name]
    number = float(cell) if as_people_write_it(cell) else math.nan
    table = tmp_path / "patients.csv"
    quoted = '"' + cell.replace('"', '""') + '"'
    assume(_encodes(cell))
    table.write_text(f"patient,{name}\nanna,{quoted}\n", encoding="utf-8", newline="")
    if column.low <= number <= column.high and number < math.inf:
        assert read_population(table, MUSCLES).entries[name] == [number]
        return
    with pytest.raises(ValueError, match=r"^cohort ") as caught:
        read_population(table, MUSCLES)
    assert is_sentence(caught.value)


def _encodes(text):
    """Whether a text is one that a file can hold in one line."""
    return text.isprintable() or (not re.search(r"[\ud800-\udfff]", text) and len(text.splitlines()) <= 1)


@pytest.mark.parametrize("cell", ["1_0", "\u0661", "\uff11\uff10", "nan", "inf", "0x10", "1,0", ""])
def test_numbers_that_python_takes_or_nobody(cell):
    if cell not in ("nan", "inf"):
        with pytest.raises(ValueError, match=r"number|float"):
            number_in(cell)


@pytest.mark.parametrize(
    "name", ["an\x00na", "\x1b[31mred", "a\x7f", "\u202eanna", "an\u200bna", "an\u2028na"]
)
def test_names_of_patients(tmp_path, name):
    table = tmp_path / "patients.csv"
    table.write_text("patient,strength\nعلی\u200cرضا,1\n")
    assert read_population(table, MUSCLES).patients == ("علی\u200cرضا",)
    table.write_text(f"patient,strength\n{name},1\n")
    with pytest.raises(ValueError, match=r"^cohort row 1, column 'patient': a name is printable text, got"):
        read_population(table, MUSCLES)


@pytest.mark.parametrize("length", [131_073, 10**6])
def test_long_cells(tmp_path, length):
    table = tmp_path / "patients.csv"
    table.write_text(f"patient,strength\nanna,{'1' * length}\n")
    with pytest.raises(ValueError, match=r"^cohort table .* is no CSV file \(field larger than field limit"):
        read_population(table, MUSCLES)
    table.write_text(f"muscle,max_isometric_force\nBRA,{'1' * length}\n")
    with pytest.raises(ValueError, match=r" is no CSV file \(field larger than field limit"):
        MuscleTable.read("mujoco", table)


def test_muscle_tables_have_the_same_numbers(tmp_path):
    table = tmp_path / "muscles.csv"
    table.write_text("muscle,max_isometric_force\nBRA,1_0\n")
    with pytest.raises(ValueError, match=r"max_isometric_force of muscle 'BRA' must be a number, got '1_0'"):
        MuscleTable.read("mujoco", table)


def test_gymnasium_checks_what_can_be_shown(monkeypatch):
    """Its checker makes an environment in each render mode that is listed."""
    lists = "human" in gym.make(ID, device="cpu").unwrapped.metadata["render_modes"]
    assert lists == ("human" in modes.render_modes())
    usual = modes.importlib.util.find_spec
    monkeypatch.setattr(
        modes.importlib.util, "find_spec", lambda name: None if name == "viser" else usual(name)
    )
    monkeypatch.setenv("DISPLAY", ":0")
    assert modes.render_modes() == ("human", "rgb_array")  # MuJoCo's window comes with MuJoCo
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert modes.render_modes() == ("rgb_array",)
    with monkeypatch.context() as on_macos:
        on_macos.setattr(modes.platform, "system", lambda: "Darwin")
        assert modes.render_modes() == ("rgb_array",)
        on_macos.setenv("MJPYTHON_BIN", "mjpython")  # only this opens windows there
        assert modes.render_modes() == ("human", "rgb_array")
    hint = f'^render_mode="human" without a display needs viser.*; run {re.escape(to_install("view"))}$'
    with pytest.raises(ImportError, match=hint):
        gym.make_vec(ID, num_envs=2, device="cpu", render_mode="human")


@pytest.mark.skipif("human" in modes.render_modes(), reason="opens a viewer")
def test_check_env_with_pictures():
    check_env(gym.make(ID, device="cpu", render_mode="rgb_array").unwrapped)


EXISTS = "exists; choose another name, or replace it with --overwrite\n"
ROLLOUT = ("rollout", TASK, "--num-worlds", 2, "--device", "cpu")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("def act(obs:\n", "cannot be imported: "),
        ("\x00", "cannot be imported: "),
        ("import nothing_of_this_name\n", "cannot be imported: line 1: ModuleNotFoundError"),
        ("act = 5\n", "must be a function of the observations, got int"),
    ],
)
def test_policy_files(run, tmp_path, text, sentence):
    file = tmp_path / "policy.py"
    file.write_text(text)
    status, _, err = run(*ROLLOUT, "--policy", f"{file}:act")
    assert status == 2
    assert err.startswith("myowarp: policy ")
    assert sentence in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("option", ["--save", "--signals", "--video"])
def test_outputs_are_not_overwritten(run, tmp_path, nothing_is_built, option):
    file = tmp_path / {"--save": "a.npz", "--signals": "a.parquet", "--video": "a.mp4"}[option]
    file.write_bytes(b"of last night")
    status, _, err = run(*ROLLOUT, option, file)
    assert status == 2
    assert err == f"myowarp: output {str(file)!r} {EXISTS}"
    assert file.read_bytes() == b"of last night"


def test_outputs_are_overwritten_if_wanted(run, tmp_path):
    file = tmp_path / "a.npz"
    file.write_bytes(b"of last night")
    assert run(*ROLLOUT, "--steps", 2, "--save", file, "--overwrite")[0] == 0
    assert np.load(file)["obs"].shape[0] == 2


def test_two_outputs_in_one_file(run, tmp_path, nothing_is_built):
    file = tmp_path / "a.npz"
    status, _, err = run(*ROLLOUT, "--save", file, "--signals", file)
    assert (status, err) == (
        2,
        f"myowarp: output {str(file)!r} is asked for twice; give each output a file of its own\n",
    )


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (("cohort", ROOT / "examples/elbow_cohort.csv", "--task", TASK), "summary.csv"),
        (("audit", TASK), "audit.json"),
        (("convert", ROOT / "tests/data/none.osim"), "model.xml"),
    ],
)
def test_folders_are_not_overwritten(run, tmp_path, nothing_is_built, arguments, name):
    (tmp_path / name).write_text("of last night")
    status, _, err = run(*arguments, "--output", tmp_path)
    assert status == 2
    assert err.endswith(EXISTS)
    assert (tmp_path / name).read_text() == "of last night"


@pytest.mark.parametrize("seed", [-1, 2**64, 2**64 - 1])
def test_seeds_of_the_command(run, nothing_is_built, seed):
    status, _, err = run(*ROLLOUT, f"--seed={seed}")
    assert status == 2
    bound = "least 0" if seed < 0 else f"most {2**63 - 1}"
    assert err == f"myowarp: --seed must be at {bound}, got {seed}\n"


@pytest.mark.parametrize(
    ("option", "value"), [("seed", 2**63), ("trials", 10**7), ("steps", 2**31), ("every", 2**31)]
)
def test_counts_of_a_cohort(run, tmp_path, nothing_is_built, option, value):
    table = ROOT / "examples/elbow_cohort.csv"
    status, _, err = run("cohort", table, "--task", TASK, "--output", tmp_path, f"--{option}", value)
    assert status == 2
    assert re.match(rf"myowarp: --{option} must be at most \d+, got {value}\n$", err)


def test_examples_have_the_newest_ids():
    """Gymnasium warns of older ones; what is compared, and what was trained, may be older."""
    names = {env_id.removeprefix("MyoWarp/") for env_id in variants()}
    texts = {path: path.read_text() for path in [ROOT / "README.md", *ROOT.glob("examples/*.py")]}
    texts |= {path: path.read_text() for path in (ROOT / "myowarp").rglob("*.py")}
    checked = 0
    for path, text in texts.items():
        for line in text.splitlines():
            if not re.search(r"(gym|gymnasium)\.make|myowarp (rollout|cohort|train)\b|run_cohort\(", line):
                continue
            for name, version in re.findall(r"(?<!baselines/)\b((?:myo|motor)\w+)-v(\d+)", line):
                checked += 1
                assert f"{name}-v{int(version) + 1}" not in names, f"{path}: {line.strip()}"
    assert checked >= 10
