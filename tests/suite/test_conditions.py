"""What holds for every registered condition, and for parameters, without a condition being named here."""

import dataclasses
import json
from functools import cache
from itertools import combinations, pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from often import often

import myowarp
from myowarp.definitions.body import BODIES
from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase, condition_from, resolve
from myowarp.definitions.parameter import Clock, Curve, Parameter, Ramp, Uniform, value_of
from myowarp.definitions.task import TASKS
from myowarp.definitions.worlds import Worlds
from myowarp.models.conditions import Fatigue3CCR, Sarcopenia, TendonTear
from myowarp.sim.patient import every_condition
from myowarp.sim.simulation import Simulation

ELBOW = "myoElbowPose1D6MRandom-v0"

NAMES = sorted(CONDITIONS)
OF_BODY = {TASKS[key].body: key for key in reversed(list(TASKS))}  # the first task of each
EVERY_BODY = [
    OF_BODY[body] for body in BODIES if body in OF_BODY and BODIES[body].groups
]  # a task of each with muscles
HOSTS = ("myoElbowPose1D6MRandom-v0", "myoHandPoseRandom-v1", "myoLegWalkHuman-v0")  # of most, of others
NUM_STEPS = 8
HORIZON = 5  # so that resets happen within the test


@cache
def host_of(name):
    """Return the first task whose body can have a condition."""
    for key in HOSTS:
        try:
            resolve(name, TASKS[key])
            Simulation(TASKS[key], 1, device="cpu", conditions=name, graph=False, progress=False)
        except ValueError:
            continue
        return key
    raise AssertionError(f"no task can have condition {name!r}")


@pytest.fixture(scope="module", params=NAMES)
def hosted(request):
    """Return a condition's name and a task that can have it."""
    return request.param, host_of(request.param)


def trajectory(key, conditions, worlds, **options):
    """Return observations, rewards and qpos of a short run of some worlds with resets."""
    worlds = np.atleast_1d(worlds)
    settings = {"device": "cpu", "autoreset": "same_step", "horizon": HORIZON, "progress": False} | options
    sim = Simulation(TASKS[key], len(worlds), conditions=conditions, **settings)
    sim.reset(seeds=1000 + worlds)
    rows = []
    for step in range(NUM_STEPS):
        draws = [np.random.default_rng((world, step)).uniform(-1, 1, sim.action.shape[1]) for world in worlds]
        sim.action.assign(np.array(draws, dtype=np.float32))
        sim.step()
        parts = (sim.transition.obs, sim.transition.terms, sim.scene.data.qpos, sim.scene.data.qvel)
        rows.append(np.concatenate([part.numpy() for part in parts], axis=1))
    assert not sim.transition.fault.numpy().any()
    return np.stack(rows)


def between(name, share):
    """Return a condition between neutral (0) and its defaults (1), one share a world."""
    kind = CONDITIONS[name]
    default = {f.name: f.default for f in dataclasses.fields(kind)}
    values = {n: low + share * (default[n] - low) for n, low in kind.NEUTRAL.items()}
    return kind(**{n: np.atleast_1d(v) for n, v in values.items()})


@cache
def seven(key, *names):
    """Return how seven worlds go with conditions of these names."""
    return trajectory(key, names, np.arange(7))


def test_a_condition_acts(hosted):
    """With its defaults the trajectory differs from a healthy one."""
    name, key = hosted
    sick, healthy = seven(key, name), seven(key)
    width = healthy.shape[2]
    assert sick.shape[2] >= width
    difference = np.abs(sick[..., -1] - healthy[..., -1]).max()
    assert difference > 1e-5


def test_neutral_changes_nothing(hosted):
    """Bit for bit."""
    name, key = hosted
    neutral = CONDITIONS[name](**CONDITIONS[name].NEUTRAL)
    np.testing.assert_array_equal(trajectory(key, neutral, np.arange(7)), seven(key))


def test_every_world_has_its_own_patient(hosted):
    """Worlds with different parameters go as each does alone, bit for bit, resets included."""
    name, key = hosted
    n = 24
    share = np.linspace(0.0, 1.0, n)
    together = trajectory(key, between(name, share), np.arange(n))
    assert len(np.unique(together[3].round(7), axis=0)) == n
    for world in (5, 23):
        alone = trajectory(key, between(name, share[world]), world)
        np.testing.assert_array_equal(together[:, world], alone[:, 0], err_msg=str(world))


def composed(key, names):
    """Return as many of the conditions of these names as a body can have together, from the first on."""
    chosen = []
    for name in names:
        try:
            Simulation(TASKS[key], 1, device="cpu", conditions=(*chosen, name), graph=False, progress=False)
        except ValueError:
            continue
        chosen.append(name)
    return chosen


@pytest.mark.slow
@pytest.mark.parametrize("key", HOSTS[:2])
@pytest.mark.parametrize("names", [NAMES, NAMES[::-1]], ids=["forward", "backward"])
def test_256_patients_are_256_simulations(key, names):
    """Worlds with 256 sets of parameters of several conditions go as each does alone, bit for bit."""
    n, chosen = 256, composed(key, names)
    assert len(chosen) > 3
    shares = np.random.default_rng(0).uniform(0.0, 1.0, (n, len(chosen)))

    def patients(share):
        return [between(*pair) for pair in zip(chosen, share, strict=True)]

    together = trajectory(key, patients(shares.T), np.arange(n), graph=False)
    assert len(np.unique(together[3].round(7), axis=0)) == n
    for world in range(n):
        alone = trajectory(key, patients(shares[world]), world, graph=False)
        np.testing.assert_array_equal(together[:, world], alone[:, 0], err_msg=str(world))


def having(conditions, patients):
    """Return conditions for patients 0, 1, ..., each of whom has those of the given numbers and no others."""
    found = []
    for number, condition in enumerate(conditions):
        default = {field.name: field.default for field in dataclasses.fields(condition)}
        has = [number in patient for patient in patients]
        values = {
            parameter: np.where(has, default[parameter], neutral)
            for parameter, neutral in condition.NEUTRAL.items()
        }
        found.append(dataclasses.replace(condition, **values))
    return found


@cache
def patients_of(key):
    """Return a healthy patient, and one for each condition of a body that has it alone."""
    return [(), *((number,) for number in range(len(every_condition(TASKS[key]))))]


@cache
def side_by_side(key):
    """Return how all patients of a body go from one state with the same actions."""
    patients = patients_of(key)
    return trajectory(key, having(every_condition(TASKS[key]), patients), np.zeros(len(patients), int))


@pytest.mark.parametrize("key", often(EVERY_BODY, [OF_BODY[body] for body in ("elbow", "finger", "hand")]))
def test_every_body_has_its_patients(key):
    """Of patients side by side the healthy one goes as without conditions, bit for bit, and no other."""
    conditions, together = every_condition(TASKS[key]), side_by_side(key)
    assert len(conditions) >= 4
    difference = np.abs(together - trajectory(key, (), 0)).max(axis=(0, 2))
    assert difference[0] == 0.0
    for condition, moved in zip(conditions, difference[1:], strict=True):
        assert moved > 1e-5, condition.name


@pytest.mark.parametrize("key", often(EVERY_BODY, (OF_BODY["elbow"], OF_BODY["finger"])))
def test_patients_of_every_body_go_as_alone(key):
    """Bit for bit, launched one kernel after the other."""
    together, conditions = side_by_side(key), every_condition(TASKS[key])
    for number, patient in enumerate(patients_of(key)):
        alone = trajectory(key, having(conditions, [patient]), 0, graph=False)
        np.testing.assert_array_equal(together[:, number], alone[:, 0], err_msg=str(patient))


@cache
def last_joint(key, *names):
    """Return how the last joint moves in four worlds with conditions."""
    return trajectory(key, names, np.arange(4))[..., -1]


@pytest.mark.parametrize(
    ("key", "chosen"),
    [
        pytest.param(HOSTS[0], [*pairwise(NAMES)], id="elbow, neighbours"),
        pytest.param(HOSTS[0], [*combinations(NAMES, 2)], id="elbow", marks=pytest.mark.slow),
        pytest.param(HOSTS[1], [*combinations(NAMES, 2)], id="hand", marks=pytest.mark.slow),
    ],
)
def test_any_two_act_together(key, chosen):
    """Pairs that a body can have: no fault, and neither hides the other."""
    pairs = 0
    for pair in chosen:
        try:
            both = last_joint(key, *pair)
        except ValueError:
            continue
        for alone in pair:
            assert not np.array_equal(both, last_joint(key, alone)), pair
        pairs += 1
    assert pairs > len(chosen) / 5


def test_eager_is_the_graph(hosted):
    name, key = hosted
    np.testing.assert_array_equal(seven(key, name), trajectory(key, name, np.arange(7), graph=False))


def test_a_broken_world_comes_back(hosted):
    name, key = hosted
    assert_a_broken_world_comes_back(key, name, (0, 3))


@pytest.mark.parametrize("key", often(EVERY_BODY, (OF_BODY["elbow"], OF_BODY["finger"])))
def test_a_broken_patient_of_every_body_comes_back(key):
    conditions = having(every_condition(TASKS[key]), patients_of(key)[:4])
    assert_a_broken_world_comes_back(key, conditions, (3,))


def assert_a_broken_world_comes_back(key, conditions, moments):
    """NaN in one world: it is reset and healthy again; the others do not notice."""
    options = {"device": "cpu", "progress": False, "horizon": 100}
    sim = Simulation(TASKS[key], 4, conditions=conditions, **options)

    def last(moment):
        sim.reset(seeds=np.arange(4))
        for step in range(7):
            sim.action.fill_(0.3)
            if step == moment:
                sim.scene.data.qvel.numpy()[2] = np.nan
                sim.scene.muscles.activation.numpy()[2] = np.nan
            sim.step()
        return sim.transition.obs.numpy().copy()

    whole, others = last(None), np.arange(4) != 2
    for moment in moments:
        hurt = last(moment)
        np.testing.assert_array_equal(whole[others], hurt[others])
        assert np.isfinite(hurt).all()
        assert not np.array_equal(whole[2], hurt[2])
        assert not sim.transition.fault.numpy().any()
        for effect in sim.shards[0].effects:
            for array in effect.info.values():
                assert np.isfinite(array.numpy()).all()


def test_order_of_naming_does_not_matter():
    """What acts when follows from the stages."""
    spec = TASKS[HOSTS[1]]
    chosen = []
    for name in NAMES:
        try:
            resolve([*chosen, name], spec)
        except ValueError:
            continue
        chosen.append(name)
    assert len(chosen) > 1
    forward, backward = resolve(chosen, spec), resolve(chosen[::-1], spec)
    assert [c.name for c in forward] == [c.name for c in backward]
    stages = [c.PHASE for c in forward]
    assert stages == sorted(stages)


@wp.kernel(enable_backward=False)
def read_parameter(curve: Curve, clock: Clock, out: wp.array2d[float]):
    worldid, i = wp.tid()
    out[worldid, i] = value_of(curve, clock, worldid, i)


class TestParameter:
    """Closed forms; independence of the batch."""

    @staticmethod
    def values(value, num_worlds=3, names=("a", "b", "c_r"), steps=0, dt=0.1, **options):
        """Return a parameter's values after some control steps of dt [s], shape (num_worlds, num_names)."""
        scene = SimpleNamespace(
            worlds=Worlds.all(num_worlds),
            control_dt=dt,
            zeros=lambda name, *shape: wp.zeros((num_worlds, *shape), dtype=float),
            parameters=[],
        )
        parameter = Parameter("thing", value, scene, names, neutral=1.0, **options)
        clock = Clock()
        clock.step_count = wp.full(num_worlds, steps, dtype=int)
        clock.life_count = wp.full(num_worlds, 10 * steps, dtype=int)
        clock.control_dt = dt
        out = wp.full((num_worlds, len(names)), np.nan, dtype=float)
        wp.launch(read_parameter, dim=out.shape, inputs=[parameter.curve, clock], outputs=[out])
        return out.numpy()

    def test_shapes(self):
        np.testing.assert_array_equal(self.values(0.25), np.full((3, 3), np.float32(0.25)))
        np.testing.assert_array_equal(self.values([1, 2, 3]), np.repeat([[1], [2], [3]], 3, axis=1))
        table = np.arange(9.0).reshape(3, 3)
        np.testing.assert_array_equal(self.values(table), table)
        np.testing.assert_array_equal(self.values({"b": 5, "c": 7}), np.tile([1.0, 5.0, 7.0], (3, 1)))

    @pytest.mark.parametrize("of", ["episode", "life"])
    def test_ramp(self, of):
        ramp = Ramp(2.0, [4.0, 6.0, 8.0], onset=0.3, duration=0.4, of=of)
        for steps in (0, 2, 3, 5, 7, 20):
            time = 0.1 * steps * (10 if of == "life" else 1)
            share = np.clip((time - 0.3) / 0.4, 0, 1)
            expected = 2.0 + (np.array([[4.0], [6.0], [8.0]]) - 2.0) * share
            got = self.values(ramp, steps=steps)
            np.testing.assert_allclose(got, np.repeat(expected, 3, axis=1), rtol=1e-6)

    def test_step(self):
        ramp = Ramp(0.0, 1.0, onset=0.25)
        assert not self.values(ramp, steps=2).any()
        assert (self.values(ramp, steps=3) == 1).all()

    def test_step_is_on_time(self):
        """A change at n dt comes with step n, also where n dt is below it in float32."""
        dt, n = 0.02, np.arange(1, 200)
        late = n[np.float32(dt) * np.float32(n) < np.float32(dt * n)]
        assert len(late) > 20
        for step in (*late.tolist(), 180_000):
            ramp = Ramp(0.0, 1.0, onset=step * dt)
            assert (self.values(ramp, dt=dt, steps=step) == 1).all()
            assert (self.values(ramp, dt=dt, steps=step - 1) == 0).all()

    def test_onset_of_each_world(self):
        ramp = Ramp(0.0, 1.0, onset=[0.1, 0.2, 0.45])
        for steps in range(7):
            expected = 0.1 * steps + 1e-6 >= np.array([0.1, 0.2, 0.45])
            np.testing.assert_array_equal(self.values(ramp, steps=steps)[:, 0], expected)

    def test_drawn_change(self):
        """Every episode draws anew what a world becomes and when; bounds are each world's own."""
        late = np.where(np.arange(64) < 32, 0.1, 0.3)
        ramp = Ramp(1.0, Uniform(np.linspace(0.1, 0.5, 64), 0.6), onset=Uniform(0.1, late))
        sim = Simulation(
            TASKS[HOSTS[0]], 64, device="cpu", conditions=Sarcopenia(ramp), graph=False, progress=False
        )
        sim.reset(seeds=np.arange(64))
        episodes = []
        for _ in range(2):
            changed, last = np.full(64, -1), np.ones(64)
            for step in range(20):
                sim.step()
                now = sim.scene.muscles.anatomy.strength.numpy()[:, 0]
                changed[(now != last) & (changed < 0)] = step
                assert ((now == last) | (changed == step)).all()
                last = now.copy()
            dt = sim.scene.control_dt
            assert (changed >= np.floor(0.1 / dt)).all()
            assert (changed <= np.ceil(late / dt - 1e-6)).all()
            assert np.ptp(changed[:32]) == 0
            assert np.ptp(changed[32:]) > 3
            assert (last >= np.linspace(0.1, 0.5, 64) - 1e-6).all()
            assert (last <= 0.6).all()
            episodes.append((changed, last))
            sim.reset()
        assert (episodes[0][0] != episodes[1][0]).any()
        assert (episodes[0][1] != episodes[1][1]).all()

    def test_ends_are_exact(self):
        """Start before, end after, to the last bit; 0.3 + (1 - 0.3) is no 1 in float32."""
        ends = [(0.3, 1.0), (0.1, 0.7), (5.0, 1e-3)]
        assert any(np.float32(a) + (np.float32(b) - np.float32(a)) != np.float32(b) for a, b in ends)
        for start, end in ends:
            ramp = Ramp(start, end, onset=0.3, duration=0.4)
            assert (self.values(ramp, steps=3) == np.float32(start)).all()
            assert (self.values(ramp, steps=7) == np.float32(end)).all()

    @pytest.mark.parametrize("per", ["episode", "life"])
    def test_uniform_is_drawn_per_episode_or_life(self, per):
        """Within the bounds, different between worlds; anew in an episode, or only with a new seed."""
        strength = Sarcopenia(Uniform(0.2, 0.9, per=per))
        sim = Simulation(TASKS[HOSTS[0]], 64, device="cpu", conditions=strength, graph=False, progress=False)

        def drawn():
            sim.shards[0].launch_conditions()
            return sim.scene.muscles.anatomy.strength.numpy().copy()

        sim.reset(seeds=np.arange(64))
        first = drawn()
        assert 0.2 <= first.min() < 0.25 < 0.85 < first.max() <= 0.9
        assert (first == first[:, :1]).all()
        sim.reset()
        assert np.array_equal(drawn(), first) == (per == "life")
        sim.reset(seeds=1 + np.arange(64))
        np.testing.assert_array_equal(drawn()[:-1], first[1:])

    def test_each_muscle_may_draw(self):
        strength = Sarcopenia(Uniform(0.2, 0.9, each=True))
        sim = Simulation(TASKS[HOSTS[0]], 3, device="cpu", conditions=strength, graph=False, progress=False)
        sim.reset(seeds=np.arange(3))
        sim.shards[0].launch_conditions()
        assert len(np.unique(sim.scene.muscles.anatomy.strength.numpy())) == 18

    @pytest.mark.parametrize(
        ("value", "message"),
        [
            (-1, r"^thing must be >= 0, got -1$"),
            (np.nan, r"^thing must be finite and >= 0, got nan$"),
            (np.inf, r"^thing must be finite and >= 0, got inf$"),
            (1e300, r"^thing must be finite in float32 and >= 0, got 1e\+300$"),
            pytest.param(10**400, r"^thing must be numbers, got 1000", id="beyond float64"),
            ({"a": 1e39}, r"^thing must be finite in float32 and >= 0, got 1e\+39$"),
            (Uniform(0, 1e39), r"^thing must be finite in float32 and >= 0, got 1e\+39$"),
            (None, r"^thing must be numbers, got None$"),
            ({"a": [1, 2, 3]}, r"^thing of muscle 'a' must be one number, got \[1, 2, 3\]$"),
            ([1, 2], r"^thing must be one number or of shape \(3,\) or \(3, 3\), got shape \(2,\)$"),
            ("much", r"^thing must be numbers, got 'much'$"),
            ({"d": 1}, r"^muscle 'd' unknown; available: a, b, c_r$"),
            ({"cr": 1}, r"^muscle 'cr' unknown; did you mean c_r\?$"),
            (Uniform(2, 1), r"^thing must be drawn with low <= high, got 2 and 1$"),
            (Uniform(-2, 1), r"^thing must be >= 0, got -2$"),
            (Uniform(0, 1, per="day"), r"^thing drawn per 'day' unknown; available: episode, life$"),
            (Ramp(0, 1, onset=-1), r"^thing onset must be a finite time >= 0 s, got -1$"),
            (Ramp(0, 1, onset=1e300), r"^thing onset must be a finite time >= 0 s, got 1e\+300$"),
            (Ramp(0, 1, onset=[0, 1, -2]), r"^thing onset must be .* >= 0 s, got -2 for one of its worlds$"),
            (Ramp(0, 1, onset=Uniform(2, 1)), r"^thing onset must be drawn with low <= high, got 2 and 1$"),
            (Uniform([0, 2, 0], 1), r"^thing must be drawn with low <= high, got 2 and 1$"),
            (Ramp(0, 1, 0, [1, 2, 3]), r"^thing duration must be one time for all worlds, got \[1, 2, 3\]$"),
            (Ramp(0, 1, of="day"), r"^thing ramp of 'day' unknown; available: episode, life$"),
            (Ramp(0, -3), r"^thing must be >= 0, got -3$"),
        ],
    )
    def test_bad_values(self, value, message):
        with pytest.raises(ValueError, match=message):
            self.values(value, low=0.0)

    def test_range_with_two_ends(self):
        with pytest.raises(ValueError, match=r"^thing must be in 0\.\.1, got 2$"):
            self.values(2.0, low=0.0, high=1.0)


@pytest.mark.parametrize("name", ["sarcopenia", "motor_noise", "fatigue_3ccr", "fatigue_ma2009"])
def test_motors_have_no_muscles(name):
    key = "motorFingerPoseFixed-v0"
    with pytest.raises(ValueError, match=f"^{name} is about muscles; the body of task '{key}' has none$"):
        Simulation(TASKS[key], 2, device="cpu", conditions=name, graph=False, progress=False)


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        ("sarcopania", r"^condition 'sarcopania' unknown; did you mean sarcopenia\?$"),
        (3, r"^conditions must be names or Condition objects, got 3; available: .*sarcopenia.*$"),
    ],
)
def test_bad_conditions(conditions, message):
    with pytest.raises(ValueError, match=message):
        resolve(conditions, TASKS[HOSTS[0]])


def test_two_writers_of_one_quantity_are_refused(monkeypatch):
    class First(Condition):
        PHASE, WRITES, name = Phase.ROUTING, ("command",), "first"

        def bind(self, scene, clock):
            return Effect()

    class Second(First):
        name = "second"

    with pytest.raises(
        ValueError, match=r"^conditions 'first' and 'second' both set command; leave one out$"
    ):
        resolve((First(), Second()), TASKS[HOSTS[0]])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("sarcopenia", Sarcopenia()),
        ("sarcopenia(strength=0.3)", Sarcopenia(strength=0.3)),
        (" sarcopenia ( strength = 3e-1, ) ", Sarcopenia(strength=0.3)),
        (
            "sarcopenia(strength=Uniform(0.2, 0.8, per='life'))",
            Sarcopenia(strength=Uniform(0.2, 0.8, per="life")),
        ),
        (
            "sarcopenia(strength=Ramp(1.0, Uniform(0.1, 0.2), 0.5))",
            Sarcopenia(Ramp(1.0, Uniform(0.1, 0.2), 0.5)),
        ),
        ("fatigue_3ccr(carry_over=True)", Fatigue3CCR(carry_over=True)),
        ("tendon_tear(muscles=('BIClong', 'BRA'), time=-0.5)", TendonTear(("BIClong", "BRA"), time=-0.5)),
    ],
)
def test_text_stands_for_a_condition_with_values(text, expected):
    found = condition_from(text)
    assert type(found) is type(expected)
    assert dataclasses.asdict(found) == dataclasses.asdict(expected)


def test_every_parameter_can_be_written():
    for name in CONDITIONS:
        kind = CONDITIONS[name]
        for parameter, value in kind.NEUTRAL.items():
            assert getattr(condition_from(f"{name}({parameter}={value!r})"), parameter) == value


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sarcopeni(strength=1)", r"^condition 'sarcopeni' unknown"),
        ("sarcopenia(strenth=1)", r"^Sarcopenia parameter 'strenth' unknown; available: strength"),
        ("sarcopenia(0.3)", r"^condition 'sarcopenia\(0.3\)' must be a name, or a name with values such as"),
        ("sarcopenia(strength=0.3", r"^condition 'sarcopenia\(strength=0.3' must be a name, or"),
        (
            "sarcopenia(strength=__import__('os'))",
            r"must be a name, or .*, got __import__.*, which is code$",
        ),
        ("sarcopenia(strength=1 + x)", r"got x, which is no number; a text has quotes: \"x\"$"),
        ("sarcopenia(strength=(0.3, weak))", r"got weak, which is no number; a text has quotes: \"weak\"$"),
        ("joint_device(joint=hip_flexion_r, peak=20)", r"; a text has quotes: \"hip_flexion_r\"$"),
        ("sarcopenia()()", r"must be a name, or .*, got more than one pair of brackets$"),
        ("sarcopenia.x()", r"^condition 'sarcopenia.x' unknown"),
        ("sarcopenia(strength=Uniform())", r"must be a name, or .*, got .*missing 2 required positional"),
        ("sarcopenia(**{'strength': 1})", r"^Sarcopenia parameter 'None' unknown"),
        ("sarcopenia(strength=1)(2)", r"must be a name, or .* without names"),
        ("sarcopenia(strength=" + "(" * 5000, r"must be a name, or"),
    ],
)
def test_text_that_stands_for_no_condition(text, message):
    with pytest.raises(ValueError, match=message):
        resolve(text, TASKS[ELBOW])


def test_values_act_wherever_a_name_does(run, tmp_path):
    """In an environment as the object does; in commands, where the text is what a run remembers."""
    texts, objects = ("sarcopenia(strength=0.3)", "motor_noise"), (Sarcopenia(strength=0.3), "motor_noise")
    seen = []
    for conditions in (texts, objects, ("sarcopenia", "motor_noise")):
        env = myowarp.make_vec(ELBOW, 2, device="cpu", progress=False, conditions=conditions)
        env.reset(seed=0)
        seen.append(np.stack([env.step(np.ones((2, 6), np.float32))[0] for _ in range(5)]))
        env.close()
    np.testing.assert_array_equal(seen[0], seen[1])
    assert np.abs(seen[0] - seen[2]).max() > 0.01
    tiny = ("--num-worlds", 8, "--rollout-steps", 8, "--minibatches", 2, "--hidden", 8, "--samples", 64)
    tiny += ("--selections", 0)
    options = ("--output", tmp_path / "run", "--device", "cpu", "--conditions", texts[0])
    status, _, err = run("train", ELBOW, *tiny, *options)
    assert status == 0, err
    status, out, err = run("eval", tmp_path / "run", "--episodes", 2, "--device", "cpu", "--json")
    assert status == 0, err
    assert json.loads(out)["conditions"] == [texts[0]]
