"""What pictures are made of: camera, tubes, colours, ghosts, captions; every registered body and family."""

from contextlib import closing

import mujoco
import numpy as np
import pytest
from often import of_each

from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.body import BODIES
from myowarp.definitions.task import TASKS
from myowarp.models.muscles.mujoco import peak_force
from myowarp.sim.build import full_model
from myowarp.sim.simulation import Simulation
from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import Framing, acting_bodies, view_axes
from myowarp.view.drawing.muscles import QUANTITIES, RELAXED_RGB, TENSED_RGB, UNKNOWN_RGB, Muscles
from myowarp.view.drawing.render import NoGraphicsError, WorldRenderer
from myowarp.view.drawing.skeleton import Skeleton
from myowarp.view.drawing.snapshot import snapshot
from myowarp.view.pictures import Pictures
from myowarp.view.window import check_window

ASPECT = 4 / 3
SPHERE = mujoco.mjtGeom.mjGEOM_SPHERE
SCENES = {(TASKS[key].family, TASKS[key].body): key for key in TASKS}.values()
LEG = """
<mujoco>
  <worldbody>
    <body name="ground">
      <body name="pelvis" pos="0 0 0.9">
        <inertial mass="10" pos="0 0 0.1" diaginertia="1 1 1"/>
        <joint name="x" type="slide" axis="1 0 0"/>
        <joint name="z" type="slide" axis="0 0 1"/>
        <site name="origin" pos="0.05 0 0"/>
        <body name="thigh" pos="0 0 0">
          <inertial mass="5" pos="0 0 -0.2" diaginertia="1 1 1"/>
          <joint name="hip" axis="0 1 0" range="-1 1"/>
          <body name="shank" pos="0 0 -0.4">
            <inertial mass="3" pos="0 0 -0.2" diaginertia="1 1 1"/>
            <joint name="knee_slide" type="slide" axis="1 0 0" range="-0.1 0.1"/>
            <joint name="knee" axis="0 1 0" range="-1 1"/>
            <site name="insertion" pos="0.05 0 -0.1"/>
            <site name="heel" pos="0 0 -0.4"/>
          </body>
          <body name="moving_point" pos="0 0.3 -0.4">
            <inertial mass="0.001" pos="0 0 0" diaginertia="1e-6 1e-6 1e-6"/>
            <joint type="slide" axis="1 0 0"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon><spatial name="t"><site site="origin"/><site site="insertion"/></spatial></tendon>
  <actuator><muscle name="m" tendon="t" lengthrange="0.3 0.7" force="900"/></actuator>
</mujoco>
"""
OURS = tuple(BODIES)  # before tests add some


@pytest.fixture(scope="module")
def leg():
    """A body without geoms whose root slides away."""
    return mujoco.MjModel.from_xml_string(LEG)


HELD = (
    "myoChallengeBaodingP1-v2",
    "myoHandKeyTurnRandom-v1",
    "myoHandPenTwirlRandom-v1",
    "myoHandReorient8-v0",
)


def posed(model, qpos=None):
    data = mujoco.MjData(model)
    look.pose(model, data, model.qpos0 if qpos is None else qpos)
    return data


def place_in_picture(model, camera, points):
    """Where points are, in half widths and half heights from the middle of the picture."""
    axes = view_axes(camera.azimuth, camera.elevation)
    seen = (points - camera.lookat) @ axes.T
    half = np.tan(np.radians(model.vis.global_.fovy) / 2) * np.array((ASPECT, 1.0))
    return seen[:, :2] / (half * (seen[:, 2:] + camera.distance))


@pytest.fixture(scope="module", params=of_each(SCENES))
def sim(request):
    made = Simulation(TASKS[request.param], 2, device="cpu", graph=False, progress=False)
    made.reset(seeds=np.arange(2))
    action = np.random.default_rng(0).uniform(-1.0, 1.0, made.action.shape)
    made.action.assign(action.astype(np.float32))
    for _ in range(3):
        made.step()
    return made


def test_camera_axes_are_those_of_mujoco(leg):
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = 140.0, -25.0, 2.0
    camera.lookat[:] = (0.1, 0.2, 0.3)
    scene = mujoco.MjvScene(leg, 100)
    mujoco.mjv_updateScene(leg, posed(leg), mujoco.MjvOption(), None, camera, 7, scene)
    axes = view_axes(camera.azimuth, camera.elevation)
    np.testing.assert_allclose(axes[2], scene.camera[0].forward, atol=1e-6)
    np.testing.assert_allclose(axes[1], scene.camera[0].up, atol=1e-6)
    eyes = (np.array(scene.camera[0].pos) + scene.camera[1].pos) / 2
    np.testing.assert_allclose(eyes, camera.lookat - 2.0 * axes[2], atol=1e-6)


def test_everything_that_matters_is_in_the_picture(sim):
    """Limb, tips, targets, objects and muscles, of the worlds as they are; and they fill it."""
    model, tips = sim.full_model, BODIES[sim.scene.spec.body].tips
    framing = Framing(model, tips, ASPECT)
    for world in range(2):
        seen = snapshot(sim, world)
        data = mujoco.MjData(model)
        look.pose(model, data, seen.qpos, seen.shape)
        camera = framing.camera(data, seen.goals)
        targets = np.array(list(seen.goals.values())).reshape(-1, 3)
        movable = look.moving_bodies(model)[model.geom_bodyid]
        hand = np.flatnonzero(movable & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH))
        points = np.concatenate((targets, data.site_xpos[look.tip_sites(model, tips)], data.geom_xpos[hand]))
        assert np.abs(place_in_picture(model, camera, points)).max() < 1.0
        close = Framing(model, tips, ASPECT)
        close.fit([(data, seen.goals)])
        # Where the framed points touch the border: they span all of the picture between its borders one way.
        inside = place_in_picture(model, close.camera(data, seen.goals), close.points(data, seen.goals))
        assert np.abs(inside).max() == pytest.approx(0.9, abs=0.01)
        assert np.ptp(inside, axis=0).max() == pytest.approx(1.8, abs=0.02)


def test_camera_goes_along_with_a_root(leg):
    framing = Framing(leg, aspect=ASPECT)
    assert framing.follows
    still, gone = posed(leg), posed(leg, np.array((25.0, -3.0, 0.0, 0.0, 0.0, 0.0)))
    cameras = [framing.camera(data, {}) for data in (still, gone)]
    np.testing.assert_allclose(cameras[1].lookat - cameras[0].lookat, (25.0, 0.0, -3.0), atol=1e-9)
    assert cameras[1].distance == pytest.approx(cameras[0].distance)
    assert not Framing(BODIES["elbow"].build().compile()).follows


@pytest.mark.parametrize("body", ["legs", "full_body"])
def test_a_body_that_walks_is_seen_from_its_right(body):
    """The right hip is nearer to the camera than the left one, and hides it."""
    model = BODIES[body].build().compile()
    data = posed(model)
    camera = Framing(model, BODIES[body].tips, ASPECT).camera(data, {})
    forward = view_axes(camera.azimuth, camera.elevation)[2]
    apart = data.body("femur_l").xpos - data.body("femur_r").xpos
    assert forward @ apart > 0.9 * np.linalg.norm(apart)


@pytest.mark.parametrize(
    "key", ["myoChallengeBaodingP1-v2", "myoHandKeyTurnRandom-v1", "myoHandPenTwirlRandom-v1"]
)
def test_what_a_hand_holds_is_before_it(key):
    """Balls on a palm are not seen from its back."""
    spec = TASKS[key]
    model = full_model(spec)
    data = posed(model)
    camera = Framing(model, BODIES[spec.body].tips, ASPECT).camera(data, {})
    forward = view_axes(camera.azimuth, camera.elevation)[2]
    limb = look.limb_trees(model)
    ways = data.xpos[look.mobile_bodies(model) & ~limb] - data.xpos[acting_bodies(model) & limb].mean(axis=0)
    assert forward @ ways[np.linalg.norm(ways, axis=1).argmin()] < -0.01  # m


def test_what_falls_far_away_does_not_shrink_the_limb(leg):
    framing, data = Framing(leg, aspect=ASPECT), posed(leg)
    usual = framing.camera(data, {}).distance
    assert framing.camera(data, {"ball": np.array((0.0, 0.0, -50.0))}).distance < 1.5 * usual


def test_bones_without_meshes_go_from_joint_to_joint(leg):
    skeleton, qpos = Skeleton(leg), np.array((0.0, 0.0, 0.3, 0.05, -0.2, 0.0))
    data = posed(leg, qpos)
    starts, ends, radii = skeleton.bones(data)
    assert len(radii) == 2  # thigh and shank; the point that slides is no bone
    np.testing.assert_allclose(starts, data.xpos[[leg.body("thigh").id, leg.body("shank").id]])
    np.testing.assert_allclose(ends, [data.body("shank").xpos, data.site("heel").xpos])


@pytest.mark.parametrize("large", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_bones_of_our_bodies_are_meshes(large):
    for body in (body for body in OURS if BODIES[body].large == large):
        assert not len(Skeleton(BODIES[body].build().compile()).radii), body


def test_tubes_are_as_wide_as_muscles_are_strong(sim):
    """Cross sections go with peak forces; the path is that of MuJoCo, and a belly lies in it."""
    model = sim.full_model
    muscles, data = Muscles(model, 1.0), posed(model)
    is_muscle = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_MUSCLE
    on_tendon = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
    tubes = muscles.tubes(data)
    lengths = np.bincount(tubes.owner, np.linalg.norm(tubes.ends - tubes.starts, axis=1))
    starts, ends, owner = look.tendon_segments(model, data, muscles.tendons)
    np.testing.assert_allclose(lengths, np.bincount(owner, np.linalg.norm(ends - starts, axis=1)), rtol=1e-9)
    if not is_muscle.any():
        assert not tubes.belly.any()
        return
    force = peak_force(model.actuator_gainprm[on_tendon], model.actuator_acc0[on_tendon])
    radii = muscles.belly_radius()
    np.testing.assert_allclose(radii**2 / radii.max() ** 2, force / force.max(), rtol=1e-9)
    widest = np.zeros(len(radii))
    np.maximum.at(widest, tubes.owner[tubes.belly], tubes.radii[tubes.belly])
    assert (widest > 0.75 * radii).all()
    assert (widest < 1.3 * radii).all()
    thin = np.full(len(radii), np.inf)
    np.minimum.at(thin, tubes.owner, tubes.radii)
    assert (thin < 0.5 * radii).all()
    weak = muscles.belly_radius(0.25 * muscles.peak_force)
    np.testing.assert_allclose(weak, 0.5 * radii)


def test_a_belly_keeps_to_one_branch_of_a_path():
    """The extensor of the finger has a pulley; its rings follow each other all the same."""
    model = full_model(TASKS["myoFingerPoseRandom-v0"])
    data, muscles = posed(model, [0.0, 0.9, 0.6, 0.4]), Muscles(model, 0.1)
    assert (model.wrap_type == mujoco.mjtWrap.mjWRAP_PULLEY).any()
    steps = np.diff(muscles.bellies(data, {}, 0.0, 11).centers, axis=1)
    assert (np.einsum("mrk,mrk->mr", steps[:, 1:], steps[:, :-1]) > 0.0).all()


def test_colours_are_those_of_the_values(sim):
    activation = QUANTITIES["activation"].rgb(np.array((0.0, 0.5, 1.0, 7.0, np.nan)))
    np.testing.assert_allclose(activation[0], RELAXED_RGB)
    np.testing.assert_allclose(activation[1], (RELAXED_RGB + TENSED_RGB) / 2)
    np.testing.assert_allclose(activation[2:4], [TENSED_RGB, TENSED_RGB])
    np.testing.assert_allclose(activation[4], UNKNOWN_RGB)
    names = sim.scene.muscles.names
    if not names:
        return
    seen, model = snapshot(sim, 1), sim.full_model
    data = posed(model, seen.qpos)
    muscles = Muscles(model, 1.0)
    own = [
        list(names).index(model.actuator(int(a)).name)
        for a in np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON)
    ]
    stepped = sim.scene.muscles
    np.testing.assert_array_equal(
        muscles.values("activation", seen.muscles, data), stepped.activation.numpy()[1, own]
    )
    params = stepped.params
    norm = (stepped.length.numpy()[1, own] - params.tendon_slack_length.numpy()[0, own]) / (
        params.optimal_fiber_length.numpy()[0, own]
    )
    # The simulation's lengths are those of the last physics step's begin; a die has one path jump since.
    apart = np.abs(muscles.values("fiber_length", seen.muscles, data) - norm)
    assert (apart >= 0.05).sum() <= (sim.scene.spec.family == "diereorient")
    assert np.isnan(muscles.values("force", seen.muscles, data)).all()
    known = {"force": np.full(len(own), 10.0), "strength": np.full(len(own), 40.0)}
    np.testing.assert_allclose(muscles.values("force", known, data), 0.25)


def test_ghost_is_the_wanted_posture(sim):
    seen = snapshot(sim, 1)
    if sim.scene.spec.family != "pose":
        assert seen.ghost is None
        return
    program = sim.shards[0].program
    np.testing.assert_allclose(seen.ghost[program.address.numpy()], program.target.numpy()[1], atol=1e-6)
    data = posed(sim.full_model, seen.ghost)
    for name, place in seen.goals.items():
        np.testing.assert_allclose(data.site(name.removesuffix("_target")).xpos, place, atol=1e-9)


def test_every_family_is_drawn_with_tips_ghosts_and_captions(sim):
    seen, tips = snapshot(sim, 0), BODIES[sim.scene.spec.body].tips
    assert tips
    try:
        with WorldRenderer(sim.full_model, 200, 150, tips=tips) as renderer:
            plain = renderer.frame(seen)
            scene = renderer.scene
            balls = np.array([g.pos for g in scene.geoms[: scene.ngeom] if g.type == SPHERE])
            written = renderer.frame(seen, ["0.10 s"])
            legend = renderer.frame(seen, legend=True)
            without_ghost = renderer.frame(seen._replace(ghost=None))
    except NoGraphicsError as error:
        pytest.skip(str(error))
    marked = posed(sim.full_model, seen.qpos).site_xpos[look.tip_sites(sim.full_model, tips)]
    for place in (*marked, *seen.goals.values()):
        assert np.linalg.norm(balls - place, axis=1).min() < 1e-6
    assert not np.array_equal(written[:30, :80], plain[:30, :80])
    np.testing.assert_array_equal(written[60:], plain[60:])
    assert np.array_equal(legend, plain) == (not sim.scene.muscles.names)  # motors have no activation
    np.testing.assert_array_equal(legend[:60], plain[:60])
    assert np.array_equal(without_ghost, plain) == (seen.ghost is None)


def test_a_body_that_has_walked_away_looks_the_same():
    """Its floor has no end, its lamps go along, and there is no room that it could walk out of."""
    sim = Simulation(TASKS["myoLegWalk-v0"], 1, device="cpu", graph=False, progress=False)
    with closing(sim):
        sim.reset()
        seen, model = snapshot(sim, 0), sim.full_model
    far = seen.qpos.copy()
    far[1] -= 20.0  # squares have sides of 0.5 m or of a power of ten
    try:
        with WorldRenderer(model, 200, 150) as renderer:
            near, gone = (renderer.frame(one).astype(int) for one in (seen, seen._replace(qpos=far)))
    except NoGraphicsError as error:
        pytest.skip(str(error))
    assert np.abs(gone - near).mean() < 0.5
    assert np.abs(near - np.roll(near, 10, axis=1)).mean() > 5.0


def test_frames_fit_their_limits():
    elbow = BODIES["elbow"].build().compile()
    with pytest.raises(ValueError, match="a picture needs 1 to 4096 px on each side, got 9000 by 10"):
        WorldRenderer(elbow, 9000, 10)
    with pytest.raises(ValueError, match="muscle color 'pain' unknown"):
        Pictures((100, 100), color="pain")
    with pytest.raises(ValueError, match="two integers from 1 to 4096"):
        Pictures((100, 5000))


def test_environment_draws_chosen_worlds():
    options = {"render_mode": "rgb_array", "render_size": (64, 48), "device": "cpu", "progress": False}
    key = "myoElbowPose1D6MRandom-v0"
    env = MyoWarpVectorEnv(key, 4, render_worlds=[3, 1], muscle_color="force", **options)
    env.reset(seed=0)
    env.step(np.ones((4, 6), dtype=np.float32))
    try:
        three, one = env.render()
    except NoGraphicsError as error:
        pytest.skip(str(error))
    for picture, world in ((three, 3), (one, 1)):
        again = env.pictures.frame(env.sim, world)
        # What the renderer drew before may change the last bits of translucent pixels.
        assert np.abs(picture.astype(int) - again).max() < 10
    assert np.abs(three.astype(int) - one).max() > 100
    assert env.pictures.snapshot(env.sim, 3).muscles["force"].max() > 1.0
    env.close()
    with pytest.raises(ValueError, match="worlds must be different numbers from 0 to 3"):
        MyoWarpVectorEnv(key, 4, render_worlds=[4], **options)


@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_environment_writes_the_episode_on_pictures(mode):
    options = {"render_mode": "rgb_array", "render_size": (320, 120), "device": "cpu", "progress": False}
    options |= {"max_episode_steps": 3, "autoreset_mode": mode, "render_worlds": [1]}
    key = "myoElbowPose1D6MRandom-v0"
    env = MyoWarpVectorEnv(key, 2, render_text=True, **options)
    plain = MyoWarpVectorEnv(key, 2, **options)
    for each in (env, plain):
        each.reset(seed=0)
    time = total = 0.0
    actions = np.random.default_rng(0).uniform(-1, 1, (8, 2, 6)).astype(np.float32)
    for number, action in enumerate(actions):
        if mode == "disabled" and time > 0.05:
            for each in (env, plain):
                each.reset(options={"reset_mask": np.array([True, True])})
            time = total = 0.0
        resets = mode == "next_step" and time > 0.05
        _, reward, _, truncated, info = env.step(action)
        plain.step(action)
        time, total = (0.0, 0.0) if resets else (time + env.sim.scene.control_dt, total + reward[1])
        if mode == "same_step" and truncated[1]:
            time = total = 0.0
        success = "  success" if info["success"][1] and time else ""
        assert env.captions.lines() == [[f"{time:.2f} s  return {total:.1f}{success}"]]
        if number % 4:
            continue  # a picture takes a tenth of a second
        try:
            (written,), (drawn,) = env.render(), plain.render()
        except NoGraphicsError as error:
            pytest.skip(str(error))
        differs = np.abs(written.astype(int) - drawn).max(axis=2) > 20
        assert differs[:40].sum() > 100
        assert not differs[40:].any()
    state = env.get_state()
    env.set_state(state)
    assert env.captions.lines() == [["0.00 s  return 0.0"]]
    env.close()
    plain.close()


def test_pictures_are_drawn_after_a_display_that_did_not_answer(leg, monkeypatch):
    """MuJoCo ends the process when it draws without OpenGL a second time."""
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    for _ in range(2):
        monkeypatch.setenv("DISPLAY", ":4711")
        with pytest.raises(NoGraphicsError, match=r"got none at ':4711' \(GLFW opens no window\)$"):
            check_window()
        monkeypatch.delenv("DISPLAY")
        try:
            renderer = WorldRenderer(leg, 64, 48)
        except NoGraphicsError as error:
            pytest.skip(str(error))
        renderer.close()
