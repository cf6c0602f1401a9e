"""Joints that follow others exactly: against OpenSim, and against the formulas in float64 on MuJoCo C."""

import logging
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import warp as wp
from converted import motorised, simulation
from scipy.interpolate import CubicSpline
from stepping import physics_of

from myowarp.coordinates.free_coordinates import FreeCoordinates
from myowarp.coordinates.reduction import Reduced
from myowarp.definitions.task import TASKS
from myowarp.engine.stages.arrays import filled
from myowarp.engine.step import Step
from myowarp.laws.pieces import Pieces
from myowarp.osim.bundle.couplings import NOTHING, Couplings, couplings, follow, jacobian
from myowarp.osim.convert.compose.binary import binary, stiff
from myowarp.process import warn_once
from myowarp.sim.build import full_model

RECORDED = Path(__file__).parents[1] / "data" / "opensim"

FLOAT32 = 2e-5
"""Share of the largest acceleration: rounding of positions, velocities and inertia, grown by the solve."""
MOTION = 2e-4  # rad or m after 0.2 s: roundings of 100 steps
COUPLED = 2e-6  # rad or m: a spline evaluated in float32

KNOTS = np.array([-2.1, -1.4, -0.6, 0.0, 0.4])
TRAVEL = CubicSpline(KNOTS, [0.03, 0.05, -0.01, 0.0, 0.04], bc_type="natural")
TURN = CubicSpline(KNOTS, [-0.9, -0.5, 0.4, 0.1, -0.7], bc_type="natural")
LEG = """
<mujoco model="leg">
  <option timestep="0.002" integrator="{integrator}"><flag contact="{contact}"/></option>
  <worldbody>
    <geom type="plane" size="2 2 .1" pos="0 0 -.82"/>
    <body name="thigh">
      <joint name="hip" axis="0 1 0" damping=".3"/>
      <inertial pos="0 0 -.2" mass="8" diaginertia=".12 .12 .02"/>
      <body name="shank" pos="0 0 -.4">
        <joint name="glide" type="slide" axis="1 0 0" damping="4" armature=".1"/>
        <joint name="knee" axis="0 1 0" range="-2 {upper}" limited="{limited}" damping=".2"/>
        <inertial pos="0 .01 -.2" mass="3" diaginertia=".05 .06 .01"/>
        <geom type="sphere" size=".05" pos="0 0 -.38" condim="3"/>
      </body>
      <body name="patella" pos=".04 0 -.38">
        <joint name="tilt" axis="0 1 0" armature=".1"/>
        <joint name="rise" type="slide" axis="0 .6 .8"/>
        <inertial pos=".02 0 0" mass=".1" diaginertia="1e-4 1e-4 1e-4"/>
      </body>
    </body>
    <body name="phantom">
      <joint name="ghost"/><inertial pos="0 0 0" mass=".1" diaginertia=".01 .01 .01"/>
    </body>
  </worldbody>
  <equality>
    <joint joint1="glide" joint2="knee" polycoef="0 .03 0 0 0"/>
    <joint joint1="tilt" joint2="ghost" polycoef=".1 .4 0 0 0"/>
    <joint joint1="ghost" joint2="knee" polycoef="0 .9 .2 0 0"/>
    <joint joint1="rise" polycoef=".01 0 0 0 0"/>
  </equality>
  <actuator>
    <motor name="hip" joint="hip" ctrlrange="-99 99"/>
    <general name="brake" joint="glide" biastype="affine" biasprm="0 0 -30"/>
    <motor name="knee" joint="knee" ctrlrange="-99 99"/>
  </actuator>
</mujoco>
"""
NAMES = ("hip", "glide", "knee", "tilt", "rise", "ghost")


def pieces(spline):
    """Return a natural spline with straight ends, as OpenSim continues it."""
    inside = [tuple(row[::-1]) for row in spline.c.T]
    ends = [(float(spline(x)), float(spline(x, 1))) for x in (KNOTS[0], KNOTS[-1])]
    return Pieces((KNOTS[0], *KNOTS), (ends[0], *inside, ends[1]))


SAID = Couplings(
    {
        "glide": ("knee", (pieces(TRAVEL),)),
        "tilt": ("knee", (Pieces((0.0,), ((0.1, 0.8),)), pieces(TURN))),
    },
    {"phantom": (0.0, (0.0, 0.0, 0.0))},
)


def leg(folder, said=SAID, **settings):
    """Write the leg and its couplings."""
    given = {
        "integrator": "implicitfast",
        "contact": "disable",
        "limited": "false",
        "upper": ".35",
    } | settings
    path = folder / "model.xml"
    path.write_text(LEG.format(**given))
    (folder / "couplings.json").write_text(said.as_json())
    return path


def straight(spline, x):
    """Return value, slope and second derivative, straight beyond the knots."""
    end = np.clip(x, KNOTS[0], KNOTS[-1])
    inside = KNOTS[0] <= x <= KNOTS[-1]
    return (
        float(spline(end) + spline(end, 1) * (x - end)),
        float(spline(end, 1)),
        float(spline(end, 2)) * inside,
    )


def leg_joints(hip, knee):
    """Return q, J (6, 2) and d2q/dknee2 of all joints by the formulas, in the order of the model."""
    glide = straight(TRAVEL, knee)
    value, slope, bend = straight(TURN, 0.1 + 0.8 * knee)
    table = {
        "hip": (hip, (1, 0), 0),
        "glide": (glide[0], (0, glide[1]), glide[2]),
        "knee": (knee, (0, 1), 0),
        "tilt": (value, (0, 0.8 * slope), 0.64 * bend),
        "rise": (0.01, (0, 0), 0),
        "ghost": (0.9 * knee + 0.2 * knee**2, (0, 0.9 + 0.4 * knee), 0.4),
    }
    q, J, bends = zip(*(table[name] for name in NAMES), strict=True)
    return np.array(q), np.array(J, float), np.array(bends)


class Leg:
    """The leg in float64: MuJoCo C's inertia and bias of the bare tree, projected."""

    def __init__(self, model):
        self.model, self.data = model, mujoco.MjData(model)
        phantom = model.body("phantom").id
        # Light enough; its own place in M does not matter, and zero is refused.
        model.body_mass[phantom], model.body_inertia[phantom] = 1e-12, 1e-12
        model.dof_armature[[model.joint(name).dofadr[0] for name in SAID.curves]] = 0.0
        mujoco.mj_setConst(model, self.data)
        assert [model.joint(i).name for i in range(model.njnt)] == list(NAMES)

    def smooth(self, u, du, ctrl):
        """Return M_r, J, J' D J and J'(forces - M a) at coordinates and speeds."""
        model, data = self.model, self.data
        data.qpos, J, bends = leg_joints(*u)
        data.qvel = J @ du
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_comVel(model, data)
        M, bias = np.zeros((6, 6)), np.zeros(6)
        mujoco.mj_fullM(model, data, M)
        mujoco.mj_rne(model, data, 0, bias)
        excess = bends * du[1] ** 2
        force = -bias - model.dof_damping * data.qvel - M @ excess
        force[[0, 2]] += ctrl[0], ctrl[1]
        force[1] += -30 * data.qvel[1]
        drag = np.diag(model.dof_damping + 30.0 * (np.arange(6) == 1))
        return J.T @ M @ J, J, J.T @ drag @ J, J.T @ force


def place(sim, u, du, ctrl):
    """Put worlds into states whose followers are wrong, and control them."""
    data = sim.scene.data
    qpos, qvel = np.full((len(u), 6), 0.123), np.full((len(u), 6), 4.5)
    qpos[:, [0, 2]], qvel[:, [0, 2]] = u, du
    data.qpos.assign(qpos)
    data.qvel.assign(qvel)
    data.qacc_warmstart.zero_()
    data.ctrl.assign(np.stack([ctrl[:, 0], 0 * ctrl[:, 0], ctrl[:, 1]], axis=1))


def physics(sim):
    physics_of(sim)()


def states(count, seed=0):
    random = np.random.default_rng(seed)
    u = random.uniform((-1.5, -2.6), (1.5, 0.8), (count, 2)).astype(np.float32)
    return u.astype(float), random.uniform(-6, 6, (count, 2)), random.uniform(-30, 30, (count, 2))


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
@pytest.mark.parametrize("stages", [(), None])
def test_a_step_is_that_of_float64(tmp_path, integrator, stages):
    """Accelerations, and 0.2 s of motion, of the engine's solver and integrator and of ours."""
    sim = simulation(leg(tmp_path, integrator=integrator), 37, stages=stages)
    assert isinstance(sim.shards[0].physics_step, FreeCoordinates)
    assert bool(sim.shards[0].stages) == (stages is None)
    reference, (u, du, ctrl) = Leg(mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))), states(37)
    place(sim, u, du, ctrl)
    h, launch = sim.scene.oracle.opt.timestep, physics_of(sim)
    for step in range(100):
        launch()
        wanted = []
        for world in range(37):
            M, J, drag, force = reference.smooth(u[world], du[world], ctrl[world])
            wanted.append(np.linalg.solve(M, force))
            if integrator == "Euler":
                drag = J.T @ np.diag(reference.model.dof_damping) @ J
            du[world] += h * np.linalg.solve(M + h * drag, force)
            u[world] += h * du[world]
        if step == 0:
            found, wanted = sim.scene.data.qacc.numpy()[:, [0, 2]], np.array(wanted)
            size = np.abs(wanted).max(axis=1, keepdims=True)
            np.testing.assert_array_less(np.abs(found - wanted) / size, FLOAT32)
    qpos, qvel = sim.scene.data.qpos.numpy(), sim.scene.data.qvel.numpy()
    np.testing.assert_allclose(qpos[:, [0, 2]], u, atol=MOTION, rtol=0)
    for world in range(37):
        q, J, _ = leg_joints(*qpos[world, [0, 2]].astype(float))
        np.testing.assert_allclose(qpos[world], q, atol=COUPLED, rtol=0)
        np.testing.assert_allclose(qvel[world], J @ qvel[world, [0, 2]], atol=1e-4, rtol=0)


def test_readable_kernel_reduces_as_lanes_do(tmp_path):
    """It is that of other devices; a world has the same bits in lanes and alone, as the 17th is."""
    sim = simulation(leg(tmp_path), 17)
    step, state, found = sim.shards[0].physics_step, states(17), []
    for values in state:
        values[16] = values[0]
    assert step.in_lanes
    for step.in_lanes in (True, False):
        place(sim, *state)
        physics(sim)
        arrays = filled(Reduced, step.free.data, step.free.model)
        found.append([getattr(arrays, name).numpy().copy() for name in Reduced.vars])
    for ours, readable in zip(*found, strict=True):
        size = np.abs(readable).max()
        assert np.ptp(readable, axis=0).max() > 0.1 * size
        np.testing.assert_allclose(ours, readable, atol=1e-5 * size, rtol=0)
        np.testing.assert_array_equal(ours[16], ours[0])


def test_energy_stays(tmp_path):
    """Without damping, as the step gets shorter: Euler's error is of first order, and nothing is left."""
    path = leg(tmp_path, integrator="Euler")
    still = (
        path.read_text().replace('damping=".3"', "").replace('damping="4"', "").replace('damping=".2"', "")
    )
    lost = []
    for h in (2e-3, 5e-4):
        path.write_text(still.replace('timestep="0.002"', f'timestep="{h}"').replace("-30", "0"))
        sim = simulation(path, 4)
        reference = Leg(mujoco.MjModel.from_xml_path(str(path)))

        def energy(sim=sim, reference=reference):
            total = []
            for q, v in zip(sim.scene.data.qpos.numpy(), sim.scene.data.qvel.numpy(), strict=True):
                M, _, _, _ = reference.smooth(q[[0, 2]].astype(float), v[[0, 2]].astype(float), (0, 0))
                mujoco.mj_energyPos(reference.model, reference.data)
                total.append(0.5 * v[[0, 2]] @ M @ v[[0, 2]] + reference.data.energy[0])
            return np.array(total)

        u, du, ctrl = states(4, seed=2)
        place(sim, np.clip(u, -1.9, 0.3), du / 3, 0 * ctrl)
        launch = physics_of(sim)
        launch()
        before, speed = energy(), np.abs(sim.scene.data.qvel.numpy()).max()
        for _ in range(round(0.3 / h)):
            launch()
        assert speed > 1
        lost.append(energy() - before)
    assert np.abs(lost[0]).max() > 0.1
    assert np.abs(4 * lost[1] - lost[0]).max() / 3 < 0.05 * np.abs(lost[0]).max()


def test_phantoms_stop_beyond_the_range(tmp_path):
    """Inside they follow the quartics of model.xml; beyond, quartics of quartics would run away."""
    converted, path = motorised(tmp_path, "gait10dof18musc")
    spec = mujoco.MjSpec.from_file(str(path))
    converted.couplings.put_into(spec)
    model = spec.compile()
    quartics, found = {d.joint: d for d in converted.coordinates.dependents}, 0
    for tie in couplings(model):
        name, low_high = model.joint(tie.joint).name, model.joint(tie.driver).range
        if "phantom" not in name:
            continue
        chain = [quartics[name]]
        while chain[0].of in quartics:
            chain.insert(0, quartics[chain[0].of])
        wanted = np.linspace(*low_high, 9)
        values, _, _ = tie.derivatives(wanted)
        for quartic in chain:
            wanted = np.polyval(quartic.polynomial[::-1], wanted)
        np.testing.assert_allclose(values, wanted, rtol=0, atol=1e-9)
        beyond, slopes, _ = tie.derivatives(low_high + np.array([-5.0, 5.0]))
        np.testing.assert_allclose(beyond, wanted[[0, -1]], rtol=0, atol=1e-9)
        assert not slopes.any()
        found += 1
    assert found == 14


def test_limits_and_contacts_act_along_coordinates(tmp_path):
    """M_r u'' = forces_r + (row J)' f, with f = -D (row q'' - aref) >= 0 of each row."""
    sim = simulation(leg(tmp_path, contact="enable", limited="true", upper="-.2"), 37)
    reference, (u, du, ctrl) = Leg(mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))), states(37)
    u[:, 0] /= 10
    u[:, 1] = np.random.default_rng(1).uniform(-0.3, 0.2, 37)
    place(sim, u, du, ctrl)
    physics(sim)
    data, seen = sim.scene.data, {"limit": 0, "contact": 0}
    numbers, J_full = data.nefc.numpy(), data.efc.J.numpy()
    D, aref, found = data.efc.D.numpy(), data.efc.aref.numpy(), data.qacc.numpy()
    for world in range(37):
        M, J, _, force = reference.smooth(u[world], du[world], ctrl[world])
        rows = J_full[world, : numbers[world], :6]
        excess = leg_joints(*u[world])[2] * du[world, 1] ** 2
        accelerations = found[world].astype(float)
        np.testing.assert_allclose(accelerations, J @ accelerations[[0, 2]] + excess, rtol=1e-4, atol=1e-2)
        pull = np.maximum(0, -D[world, : len(rows)] * (rows @ accelerations - aref[world, : len(rows)]))
        pushed = J.T @ rows.T @ pull
        kind = "contact" if len(rows) > 1 else "limit"
        seen[kind] += bool(pull.any())
        size = np.abs(M @ accelerations[[0, 2]]).max() + np.abs(force).max()
        np.testing.assert_allclose(M @ accelerations[[0, 2]], force + pushed, atol=2e-4 * size, rtol=0)
    assert min(seen.values()) > 5


@pytest.mark.parametrize("name", ["gait10dof18musc", "leg6dof9musc"])
def test_accelerations_are_those_of_opensim(name, tmp_path):
    """In states with velocities, gravity and torques; converted for MuJoCo alone they are off by a third."""
    recorded = np.load(RECORDED / f"accelerations_{name}.npz")

    converted, path = motorised(tmp_path, name)
    sim = simulation(path, len(recorded["values"]))
    assert isinstance(sim.shards[0].physics_step, FreeCoordinates)
    model, data = sim.scene.oracle, sim.scene.data
    entries = {entry.name: entry for entry in converted.coordinates.coordinates}
    joints = [model.joint(entries[str(c)].joint).id for c in recorded["coordinates"]]
    scale = np.array([entries[str(c)].scale for c in recorded["coordinates"]])
    arrays = {key: np.zeros((len(recorded["values"]), model.nv)) for key in ("values", "speeds", "forces")}
    for key, power in (("values", 1), ("speeds", 1), ("forces", -1)):
        arrays[key][:, joints] = recorded[key] * scale**power
    data.qpos.assign(arrays["values"])
    data.qvel.assign(arrays["speeds"])
    data.qfrc_applied.assign(arrays["forces"])
    data.qacc_warmstart.zero_()
    physics(sim)
    found, wanted = data.qacc.numpy()[:, joints] / scale, recorded["accelerations"]
    error = np.linalg.norm(found - wanted, axis=1) / np.linalg.norm(wanted, axis=1)
    assert np.linalg.norm(wanted, axis=1).min() > 10
    assert np.median(error) < FLOAT32
    assert error.max() < 10 * FLOAT32


def test_a_model_asks_for_it(tmp_path, caplog):
    """Without the file joints follow by springs; with an empty one, exactly by the model's own equalities."""
    path = leg(tmp_path)
    (tmp_path / "couplings.json").unlink()
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        sim = simulation(path, 1)
    assert not isinstance(sim.shards[0].physics_step, FreeCoordinates)
    assert not caplog.records
    spec = mujoco.MjSpec.from_file(str(path))
    NOTHING.put_into(spec)
    (tmp_path / "couplings.json").write_text(Couplings({}, {}).as_json())
    sim = simulation(path, 1)
    assert isinstance(sim.shards[0].physics_step, FreeCoordinates)
    place(sim, np.array([[0.2, -0.7]]), np.zeros((1, 2)), np.zeros((1, 2)))
    sim.shards[0].physics_step.follow()
    ghost = 0.9 * -0.7 + 0.2 * 0.49
    wanted = (0.2, 0.03 * -0.7, -0.7, 0.1 + 0.4 * ghost, 0.01, ghost)
    np.testing.assert_allclose(sim.scene.data.qpos.numpy()[0], wanted, atol=1e-6)


def test_a_private_name_that_is_gone(tmp_path, monkeypatch, caplog):
    """Joints follow by the engine's springs, and one line says so."""
    monkeypatch.setitem(sys.modules, "myowarp.engine.inertia", None)
    for name in ("free_coordinates", "hinge_triples"):
        monkeypatch.delitem(sys.modules, f"myowarp.coordinates.{name}")
    warn_once.cache_clear()
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        sim = simulation(leg(tmp_path), 1)
    assert type(sim.shards[0].physics_step) is Step
    assert "free_coordinates is left to mujoco-warp" in caplog.text
    warn_once.cache_clear()


GHOST, RISE = '"ghost" joint2="knee"', 'joint1="rise" polycoef=".01 0 0 0 0"'


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({GHOST: '"ghost" joint2="rise"', RISE: 'joint1="rise" joint2="ghost"'}, "in a ring"),
        pytest.param({"<flag": '<flag energy="enable"'}, "energy is computed", marks=pytest.mark.slow),
        pytest.param(
            {'timestep="0.002"': 'timestep="0.002" cone="elliptic"'},
            "the friction cone is elliptic",
            marks=pytest.mark.slow,
        ),
        ({"</actuator>": ""}, ""),
    ],
)
def test_what_it_does_not_cover_is_said_once(tmp_path, caplog, changes, reason):
    path = leg(tmp_path)
    for old, new in changes.items():
        path.write_text(path.read_text().replace(old, new or old, 1))
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        sim = simulation(path, 1)
    assert isinstance(sim.shards[0].physics_step, FreeCoordinates) == (not reason)
    said = [
        record.getMessage() for record in caplog.records if "by the engine's springs" in record.getMessage()
    ]
    assert [reason in text for text in said] == ([True] if reason else [])


def test_massless_coordinates_are_refused(tmp_path, caplog):
    """A document that weighs nothing along a coordinate: MuJoCo's own small masses stay."""
    said = Couplings(
        SAID.curves, {name: (0.0, (0.0, 0.0, 0.0)) for name in ("thigh", "shank", "patella", "phantom")}
    )
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        sim = simulation(leg(tmp_path, said), 1)
    assert not isinstance(sim.shards[0].physics_step, FreeCoordinates)
    assert "the model's masses leave a coordinate without inertia" in caplog.text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nonsense", "must be JSON with 'joints' and 'bodies'"),
        ('{"joints": {}}', "KeyError: 'bodies'"),
        ('{"joints": {"glide": {"of": "knee", "curves": [[[0], [[NaN]]]]}}, "bodies": {}}', "not finite"),
        ('{"joints": {"glide": {"of": "knee", "curves": [[[1, 0], [[1], [1]]]]}}, "bodies": {}}', "ascend"),
        ('{"joints": {}, "bodies": {"thigh": {"mass": -1, "inertia": [0, 0, 0]}}}', "'thigh' needs a mass"),
        (
            '{"joints": {"lost": {"of": "knee", "curves": []}}, "bodies": {}}',
            "no hinge or slide of that name",
        ),
    ],
)
def test_broken_couplings_are_refused(tmp_path, text, message):
    path = leg(tmp_path)
    (tmp_path / "couplings.json").write_text(text)
    with pytest.raises(ValueError, match=r"couplings\.json' must belong to model\.xml") as refused:
        simulation(path, 1)
    assert message in str(refused.value)


def test_text_reads_back_the_same(tmp_path):
    assert Couplings.read(SAID.as_json()) == SAID
    spec = mujoco.MjSpec.from_file(str(leg(tmp_path)))
    NOTHING.put_into(spec)
    SAID.put_into(spec)
    model = spec.compile()
    assert Couplings.of(model) == SAID
    roots = {model.joint(tie.joint).name: tie.driver for tie in couplings(model)}
    knee = model.joint("knee").id
    assert roots == {"glide": knee, "tilt": knee, "ghost": knee, "rise": -1}


def test_a_part_takes_over_the_stages(tmp_path):
    first, second = simulation(leg(tmp_path), 6, shards=2).shards
    assert [type(stage) for stage in second.stages] == [type(stage) for stage in first.stages]
    assert isinstance(second.physics_step, FreeCoordinates)
    for part in (first, second):
        place(part, *states(3))
        with wp.ScopedDevice(part.scene.device):
            part.launch_physics()
    np.testing.assert_array_equal(second.scene.data.qpos.numpy(), first.scene.data.qpos.numpy())
    assert first.physics_step.stages(["contact_solve"])


@pytest.mark.parametrize("name", ["gait10dof18musc", "leg6dof9musc"])
def test_the_binary_model_is_near(name, tmp_path):
    """In MuJoCo C, against OpenSim; the XML, which cannot say how stiff rows are, is ten times as far off."""
    recorded, (converted, path) = np.load(RECORDED / f"accelerations_{name}.npz"), motorised(tmp_path, name)
    model = mujoco.MjModel.from_xml_path(str(path))
    (tmp_path / "model.mjb").write_bytes(binary(stiff(model, converted.couplings)))
    entries = {entry.name: entry for entry in converted.coordinates.coordinates}
    names = [str(c) for c in recorded["coordinates"]]
    joints = [model.joint(entries[c].joint).id for c in names]
    scale, errors = np.array([entries[c].scale for c in names]), {}
    for file in ("mjb", "xml"):
        stepped = model if file == "xml" else mujoco.MjModel.from_binary_path(str(tmp_path / "model.mjb"))
        stepped.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        data, errors[file] = mujoco.MjData(stepped), []
        for row in range(len(recorded["values"])):
            mujoco.mj_resetData(stepped, data)
            data.qpos[joints] = recorded["values"][row] * scale
            follow(stepped, data.qpos)
            _, J, _ = jacobian(stepped, couplings(stepped), data.qpos)
            data.qvel = J[:, np.argsort(np.argsort(joints))] @ (recorded["speeds"][row] * scale)
            data.qfrc_applied[joints] = recorded["forces"][row] / scale
            mujoco.mj_forward(stepped, data)
            wanted = recorded["accelerations"][row]
            error = np.linalg.norm(data.qacc[joints] / scale - wanted) / np.linalg.norm(wanted)
            errors[file].append(error)
    assert np.median(errors["mjb"]) < 0.005
    assert max(errors["mjb"]) < 0.05
    assert np.median(errors["xml"]) > 10 * np.median(errors["mjb"])


def test_ways_of_many_postures_break_no_equality_of_mujoco_c():
    """J_eq dq/du = 0, with MuJoCo's Jacobian of the equalities, in postures in which they hold."""
    model = full_model(TASKS["myoArmReachRandom-v0"])
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    postures = rng.uniform(*model.jnt_range.T, (5, model.nq))
    for qpos in postures:
        follow(model, qpos)
    free, slopes, _ = jacobian(model, couplings(model), postures)
    assert slopes.shape == (5, model.nv, model.nv - model.neq)
    np.testing.assert_array_equal(slopes[:, free], np.tile(np.eye(len(free)), (5, 1, 1)))
    for qpos, slope in zip(postures, slopes, strict=True):
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        rows = np.zeros((data.nefc, model.nv))
        if mujoco.mj_isSparse(model):
            mujoco.mju_sparse2dense(rows, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
        else:
            rows[:] = data.efc_J.reshape(rows.shape)
        np.testing.assert_allclose(rows[: data.ne] @ slope, 0.0, atol=1e-9)
        assert data.ne == model.neq
