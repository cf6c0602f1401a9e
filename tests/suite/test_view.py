"""Pictures show the state they are given; videos hold the frames; failures leave files alone."""

import imageio_ffmpeg
import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
from often import often
from stepping import engine_alone

from myowarp.definitions.task import TASKS
from myowarp.sim.build import full_spec
from myowarp.sim.simulation import Simulation
from myowarp.view.drawing import style as look
from myowarp.view.drawing.render import NoGraphicsError, WorldRenderer, tiled
from myowarp.view.drawing.snapshot import Snapshot, snapshot
from myowarp.view.drawing.video import write_picture, write_video

SIZE = (160, 120)
BODIES = {TASKS[key].body: key for key in TASKS}


@pytest.fixture(scope="module", params=often(BODIES, ("elbow", "contact_hand")))
def model(request):
    return full_spec(TASKS[BODIES[request.param]]).compile()


@pytest.fixture
def renderer(model):
    try:
        with WorldRenderer(model, *SIZE) as opened:
            yield opened
    except NoGraphicsError as error:
        pytest.skip(str(error))


def middle(model):
    qpos = model.qpos0.copy()
    limited = np.flatnonzero(model.jnt_limited)
    qpos[model.jnt_qposadr[limited]] = model.jnt_range[limited].mean(axis=1)
    return qpos


def test_picture_shows_pose_activation_and_target(model, renderer):
    rest = renderer.frame(Snapshot(model.qpos0))
    assert rest.shape == (SIZE[1], SIZE[0], 3)
    assert rest.dtype == np.uint8
    assert rest.std() > 5
    np.testing.assert_array_equal(rest, renderer.frame(Snapshot(model.qpos0)))
    assert not np.array_equal(rest, renderer.frame(Snapshot(middle(model))))
    number = len(renderer.muscles.tendons)
    calm, strained = (
        renderer.frame(Snapshot(model.qpos0, {"activation": np.full(number, a)})) for a in (0.0, 1.0)
    )
    redness = [
        float(image[..., 0].astype(int).sum() - image[..., 2].astype(int).sum()) for image in (calm, strained)
    ]
    assert redness[1] > redness[0]
    hidden = renderer.frame(Snapshot(model.qpos0, {"activation": np.full(number, np.nan)}))
    assert (hidden != calm).any(axis=2).sum() > 50
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    above = np.array((0.0, 0.0, 0.3 * renderer.framing.radius))
    place = data.geom_xpos[look.drawn_geoms(model)].mean(axis=0) + above
    marked = renderer.frame(Snapshot(model.qpos0, goals={"anywhere": place}))
    green = marked.astype(int) - rest
    assert (green[..., 1] > green[..., 0] + 30).sum() > 2  # the marker of a body 2 m high is small


def test_grid_holds_the_tiles(model, renderer):
    frames = [renderer.frame(Snapshot(pose)) for pose in (model.qpos0, middle(model))]
    grid = tiled([*frames, frames[0]], columns=2)
    np.testing.assert_array_equal(grid[: SIZE[1], : SIZE[0]], frames[0])
    np.testing.assert_array_equal(grid[: SIZE[1], -SIZE[0] :], frames[1])


@pytest.mark.parametrize(
    ("seen", "text"),
    [
        ({"muscles": {"activation": np.zeros(1)}}, "activation needs one value per muscle"),
        ({"goals": {"there": np.array((0, 0, np.nan))}}, "site 'there' needs a finite world position"),
        ({"qpos": np.zeros(0)}, "qpos needs shape"),
    ],
)
def test_what_does_not_fit_is_not_drawn(model, renderer, seen, text):
    with pytest.raises(ValueError, match=text):
        renderer.frame(Snapshot(model.qpos0)._replace(**seen))


@pytest.mark.parametrize(
    "key", ["myoHandObjHoldRandom-v1", "myoHandKeyTurnRandom-v1", "myoHandPenTwirlRandom-v1"]
)
def test_worlds_are_drawn_with_their_own_objects(key):
    """Size, place or turn of what a world drew: the geometry of the picture is that of the simulation."""
    sim = Simulation(TASKS[key], 2, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(2))
    engine_alone(mjw.kinematics)(sim.scene.model, sim.scene.data)
    model, oracle = sim.full_model, sim.scene.oracle
    drawn = mujoco.MjData(model)
    for world in range(2):
        seen = snapshot(sim, world)
        assert seen.shape
        look.pose(model, drawn, seen.qpos, seen.shape)
        for body in set(seen.shape):
            name = oracle.geom(body[1]).bodyid[0] if body[0] == "geom_size" else oracle.body(body[1]).id
            theirs = sim.scene.data.xpos.numpy()[world, name], sim.scene.data.xquat.numpy()[world, name]
            ours = model.body(oracle.body(name).name).id
            np.testing.assert_allclose(drawn.xpos[ours], theirs[0], atol=1e-6)
            np.testing.assert_allclose(drawn.xquat[ours], theirs[1], atol=1e-6)
        if key.startswith("myoHandObjHold"):
            size = sim.shards[0].program.object_size.numpy()[world]
            np.testing.assert_array_equal(model.geom_size[model.geom("object").id], size)
    try:
        with WorldRenderer(model, *SIZE) as renderer:
            own, other = (renderer.frame(snapshot(sim, world)) for world in range(2))
            np.testing.assert_array_equal(renderer.frame(snapshot(sim, 0)), own)
            nominal = renderer.frame(snapshot(sim, 0)._replace(shape={}))
    except NoGraphicsError as error:
        pytest.skip(str(error))
    assert not np.array_equal(own, other)
    assert not np.array_equal(own, nominal)


def test_unknown_camera_lists_the_known(model):
    with pytest.raises(ValueError, match="camera 'nowhere' unknown; available: "):
        WorldRenderer(model, *SIZE, camera="nowhere")


def frames(count):
    return [np.full((32, 48, 3), 20 * i, dtype=np.uint8) for i in range(count)]


def test_video_holds_the_frames(tmp_path):
    path = write_video(tmp_path / "a.mp4", iter(frames(9)), fps=25)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert count == 9
    assert seconds == pytest.approx(9 / 25, abs=0.02)
    reader = imageio_ffmpeg.read_frames(str(path))
    assert next(reader)["size"] == (48, 32)
    brightness = [np.frombuffer(frame, np.uint8).mean() for frame in reader]
    np.testing.assert_allclose(brightness, 20 * np.arange(9), atol=4)


def test_gif_holds_the_frames_at_their_pace(tmp_path):
    path = write_video(tmp_path / "a.gif", iter(frames(9)), fps=25)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert count == 9
    assert seconds == pytest.approx(9 / 25, abs=0.02)


def test_png_holds_the_picture(tmp_path):
    picture = np.random.default_rng(0).integers(0, 255, (33, 47, 3), dtype=np.uint8)
    path = write_picture(tmp_path / "a.png", picture)
    reader = imageio_ffmpeg.read_frames(str(path))
    assert next(reader)["size"] == (47, 33)
    np.testing.assert_array_equal(np.frombuffer(next(reader), np.uint8).reshape(33, 47, 3), picture)
    with pytest.raises(ValueError, match=r"ends in \.png"):
        write_picture(tmp_path / "a.jpg", picture)


def test_broken_video_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"old")

    def failing():
        yield from frames(3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(path, failing(), fps=25)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "images", "text"),
    [
        ("a.avi", frames(2), "path that ends in .mp4 or .gif"),
        ("a.mp4", [], "at least one frame"),
        ("a.mp4", [np.zeros((4, 4))], "uint8 frames"),
    ],
)
def test_bad_video_is_refused(tmp_path, name, images, text):
    with pytest.raises((ValueError, OSError), match=text):
        write_video(tmp_path / name, images, fps=25)
    assert not any(tmp_path.iterdir())
