"""Films: frames of equal steps, what differs side by side from the same state, captions, bad input."""

import imageio_ffmpeg
import msgspec
import numpy as np
import pytest
import zstandard

from myowarp.apps.cli.main import main
from myowarp.apps.cli.record import told_apart
from myowarp.apps.rollouts.beside import Beside
from myowarp.apps.rollouts.film import Film, write
from myowarp.apps.rollouts.run import run as roll
from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation
from myowarp.view.drawing.muscles import QUANTITIES
from myowarp.view.drawing.render import NoGraphicsError

ELBOW = "myoElbowPose1D6MRandom-v0"
WORLDS, STEPS, HORIZON = 2, 7, 5


@pytest.fixture(scope="module")
def films():
    """A healthy and a weak elbow over one episode and a bit."""
    options = {"device": "cpu", "progress": False, "autoreset": "disabled", "horizon": HORIZON, "seed": 3}
    sets = ((), ("sarcopenia",))
    sims = [Simulation(TASKS[ELBOW], WORLDS, conditions=conditions, **options) for conditions in sets]
    made = [Film(sim, range(WORLDS), (64, 48), title=name) for sim, name in zip(sims, "ab", strict=True)]
    full = np.ones((WORLDS, 6), dtype=np.float32)
    roll(sims[0], lambda obs: full, STEPS, made[0], Beside(*sims, lambda obs: full, made[1]))
    yield made
    for sim, film in zip(sims, made, strict=True):
        film.close()
        sim.close()


def test_worlds_start_from_the_same_state_and_part(films):
    healthy, weak = ([[seen.qpos[0] for seen in row] for row in film.frames] for film in films)
    assert len(healthy) == len(weak) == STEPS + 1
    np.testing.assert_array_equal(healthy[0], weak[0])
    assert np.abs(np.subtract(healthy[HORIZON], weak[HORIZON])).min() > 1e-3
    goals = [[seen.ghost for seen in row] for row in films[0].frames]
    other = [[seen.ghost for seen in row] for row in films[1].frames]
    np.testing.assert_array_equal(goals, other)
    assert np.abs(np.subtract(goals[HORIZON], goals[HORIZON + 1])).min() > 1e-3  # a new episode, a new goal
    strengths = [film.frames[0][0].muscles["strength"] for film in films]
    np.testing.assert_allclose(strengths[1], 0.5 * strengths[0])


def test_the_last_frame_of_an_episode_is_its_own(films):
    """It is one step from the frame before, and the next one is one step from the new start."""
    captions = [row[1] for row in films[0].captions]
    dt = films[0].sim.scene.control_dt
    assert [caption[0] for caption in captions] == ["a"] * (STEPS + 1)
    times = [float(caption[1].split("  ")[1].removesuffix(" s")) for caption in captions]
    expected = [0, *range(1, HORIZON + 1), *range(1, STEPS - HORIZON + 1)]
    np.testing.assert_allclose(times, np.multiply(expected, dt), atol=0.006)
    returns = [float(caption[1].split("return ")[1].split()[0]) for caption in captions]
    assert returns[0] == 0.0
    assert abs(returns[HORIZON]) > 0.1


@pytest.mark.slow
def test_films_stand_side_by_side(films, tmp_path):
    try:
        write(tmp_path / "a.mp4", films)
        write(tmp_path / "a.gif", films[:1])
    except NoGraphicsError as error:
        pytest.skip(str(error))
    count, _ = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))
    assert count == STEPS + 1
    about = next(imageio_ffmpeg.read_frames(str(tmp_path / "a.mp4")))
    assert about["size"] == (2 * 64 + 2, 2 * 48 + 2)
    assert about["fps"] == pytest.approx(1.0 / films[0].sim.scene.control_dt)
    about = next(imageio_ffmpeg.read_frames(str(tmp_path / "a.gif")))
    assert about["size"] == (2 * 64 + 2, 48)


@pytest.mark.slow
def test_what_the_reader_turns_holds_every_body_at_every_step(films, tmp_path):
    """Viser's own format: size, then compressed the length of the messages, messages with times, arrays."""
    write(tmp_path / "a.viser", films)
    unpacked = zstandard.ZstdDecompressor().decompress((tmp_path / "a.viser").read_bytes()[8:])
    length = int.from_bytes(unpacked[:8], "little")
    scene = msgspec.msgpack.decode(unpacked[8 : 8 + length])
    dt = films[0].sim.scene.control_dt
    assert scene["durationSeconds"] == pytest.approx((STEPS + 1) * dt)
    shown = {at for at, message in scene["messages"] if "return" in str(message)}
    every = np.arange(0, STEPS + 1, 2)  # 50 steps a second: every other one is kept
    np.testing.assert_allclose(sorted(shown), dt * every, atol=1e-9)
    names = str([message.get("name") for _, message in scene["messages"]])
    assert all(f"/{row}_{column}/" in names for row in range(WORLDS) for column in range(len(films)))
    write(tmp_path / "a.html", films[:1])
    page = (tmp_path / "a.html").read_text()
    assert "__VISER_EMBED_DATA__" in page
    assert f"<span>{QUANTITIES['activation'].label}</span>" in page


def run(capsys, monkeypatch, *arguments):
    monkeypatch.setattr("sys.argv", ["myowarp", *map(str, arguments)])
    status = 0
    try:
        main()
    except SystemExit as end:
        status = end.code
    return status, " ".join(capsys.readouterr().err.split())


def test_command_writes_a_picture(capsys, monkeypatch, tmp_path):
    path = tmp_path / "new" / "a.png"
    options = ("--device", "cpu", "--steps", 2, "--size", 64, 48, "--color", "force", "--policy", "hold")
    status, said = run(capsys, monkeypatch, "record", ELBOW, "-o", path, "--beside", "none", *options)
    if "drawing needs OpenGL" in said:
        pytest.skip(said)
    assert status == 0, said
    assert f"Saved {path}".replace(" ", "") in said.replace(" ", "")
    assert said.endswith("orange balls are the tips of the limb, a green shadow is the wanted posture")
    assert next(imageio_ffmpeg.read_frames(str(path)))["size"] == (2 * 64 + 2, 48)


def test_titles_are_what_tells_policies_apart():
    assert told_apart(["runs/blind/0", "runs/memory/0"]) == ["blind", "memory"]
    assert told_apart(["runs/a/0", "runs/b/1"]) == ["a/0", "b/1"]
    assert told_apart(["baseline", "runs/memory"]) == ["baseline", "runs/memory"]
    assert told_apart(["hold", "hold"]) == ["hold", "hold"]
    folder = "runs/of_a_long_name/changing_key_tear_blind/0"
    assert told_apart(["baseline", folder]) == ["baseline", "...g_name/changing_key_tear_blind/0"]


@pytest.mark.slow
def test_policies_side_by_side_have_the_same_patient(capsys, monkeypatch, tmp_path):
    """The picture of a policy beside itself has equal halves though the strength is drawn; titles aside."""
    path = tmp_path / "a.png"
    options = ("--device", "cpu", "--steps", 30, "--size", 64, 48, "--policy", "hold", "--overwrite")
    patient = ("--conditions", "sarcopenia(strength=Ramp(1.0, Uniform(0.0, 0.5), onset=0.1))")
    halves = {}
    for other in ("hold", "zero"):
        command = ("record", ELBOW, "-o", path, *options, *patient, "--beside-policy", other)
        status, said = run(capsys, monkeypatch, *command)
        if "drawing needs OpenGL" in said:
            pytest.skip(said)
        assert status == 0, said
        frames = imageio_ffmpeg.read_frames(str(path))
        width, height = next(frames)["size"]
        picture = np.frombuffer(next(frames), np.uint8).reshape(height, width, 3)[16:].astype(int)
        halves[other] = np.abs(picture[:, :64] - picture[:, -64:]).max()
    assert halves["hold"] <= 8 < 80 <= halves["zero"]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--worlds", 0], "--worlds must be at least 1, got 0"),
        (["--steps", 0], "--steps must be at least 1, got 0"),
        (["--fps", 0], "--fps must be positive, got 0"),
        (["--size", 99999, 10], "a picture needs 1 to 4096 px on each side, got 99999 by 10"),
        (["-o", "a.avi"], "must end in .mp4 or .gif or .png"),
        (["--color", "pain"], "muscle color 'pain' unknown"),
        (["--beside", "old_age"], "condition 'old_age' unknown"),
        (["--policy", "best"], "policy 'best' unknown"),
        (["--beside-policy", "best"], "policy 'best' unknown"),
        (["--beside", "none", "--beside-policy", "zero"], "leave one of them out"),
        (["--camera", "nowhere"], "camera 'nowhere' unknown"),
    ],
)
def test_bad_input_is_one_sentence(capsys, monkeypatch, tmp_path, arguments, text):
    monkeypatch.chdir(tmp_path)
    status, said = run(capsys, monkeypatch, "record", ELBOW, "--device", "cpu", "--steps", 1, *arguments)
    assert status == 2
    assert text in said
    assert not list(tmp_path.rglob("*.*"))
