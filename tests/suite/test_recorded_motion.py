"""Recorded motions in pictures: bones, paths and arrows are the files'; a picture is one moment."""

import re
import threading
from pathlib import Path

import mujoco
import numpy as np
import pytest
from socket_client import LIGHTS, MISSTATED, Client, until

from myowarp.apps.cli.motion.forces import Forces
from myowarp.apps.cli.options import Said, Trial
from myowarp.apps.cli.record import Record
from myowarp.apps.cli.view import View
from myowarp.definitions.setup import Setup
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.motion.trial import read_motion
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.kinematics import complete, forward
from myowarp.view.browser.server import close_server, open_server
from myowarp.view.browser.trial_page import TrialPage
from myowarp.view.drawing import style as look
from myowarp.view.drawing.recorded import LONGEST, Recorded
from myowarp.view.drawing.render import NoGraphicsError

ROOT = Path(__file__).parents[2]
ARM, BEND = ROOT / "examples/arm.osim", ROOT / "examples/arm_bend.mot"
PLACE = 1e-9
"""[m] of rounding."""
LOADS = """<OpenSimDocument Version="40000"><ExternalLoads name="l"><objects><ExternalForce name="push">
<applied_to_body>ground</applied_to_body><force_identifier>f</force_identifier>
<point_identifier>p</point_identifier></ExternalForce></objects><datafile>push.mot</datafile></ExternalLoads>
</OpenSimDocument>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder of `myowarp motion forces`, with electromyograms and a load that grows."""
    folder = tmp_path_factory.mktemp("arm")
    Forces(ARM, motion=BEND, reserve=1.0, output=folder)()
    table = read_storage(folder / "activations.sto")
    write_storage(
        folder / "emg.sto", "emg", Storage(table.labels[:1], table.time, 0.5 + 0 * table.values[:, :1])
    )
    push = np.zeros((len(table.time), 6))
    push[:, 1], push[:, 3] = 100.0 * table.time, 0.2
    labels = tuple(part + axis for part in "fp" for axis in "xyz")
    write_storage(folder / "push.mot", "push", Storage(labels, table.time, push))
    (folder / "push.xml").write_text(LOADS)
    return folder


@pytest.fixture(scope="module")
def recorded(folder):
    return Recorded(ARM, BEND, folder, folder / "push.xml")


def test_bones_and_paths_are_those_of_the_model(recorded):
    """Origins of bodies as forward kinematics has them; a path without wraps is as long as its muscle."""
    bones = Bones.read(ARM, "cpu")
    motion = read_motion(BEND, bones)
    frames = forward(
        bones.model, complete(bones.model, dict(zip(bones.coordinates, motion.values.T, strict=True)), 61)
    )
    data = mujoco.MjData(recorded.model)
    lengths = muscle_paths(bones, motion.values, motion.speeds)
    for frame in (0, 17, 60):
        seen = recorded.seen(frame)
        look.pose(recorded.model, data, seen.qpos, paths=seen.paths)
        for name in bones.model.bodies:
            x, y, z = frames[name][1][frame]
            np.testing.assert_allclose(data.body(name).xpos, (x, -z, y), atol=PLACE)
        starts, ends, owner = look.tendon_segments(recorded.model, data, look.muscle_tendons(recorded.model))
        for k, muscle in enumerate(lengths.muscles):
            own = owner == k
            straight = np.linalg.norm(ends[own] - starts[own], axis=1).sum()
            if not bones.model.muscles[muscle].path.wraps:
                np.testing.assert_allclose(straight, lengths.length[frame, k], atol=PLACE)
            assert straight <= lengths.length[frame, k] + PLACE
    assert np.ptp(lengths.length, axis=0).min() > 1e-3, "they move"


def test_an_arrow_begins_where_the_load_acts_and_is_as_long_as_it_is_strong(recorded):
    arrows = [recorded.seen(frame).arrows for frame in (0, 30, 60)]
    assert [len(arrow) for arrow in arrows] == [0, 1, 1], "no force, no arrow"
    for arrow, time in zip(arrows[1:], recorded.time[[30, 60]], strict=True):
        np.testing.assert_allclose(arrow[0, 0], (0.2, 0.0, 0.0), atol=PLACE)
        along = (arrow[0, 1] - arrow[0, 0]) * recorded.newtons_per_metre
        np.testing.assert_allclose(along, (0.0, 0.0, 100.0 * time), atol=1e-5)
    assert np.ptp(arrows[2][0], axis=0).max() > 0.5 * LONGEST * 0.3


def test_colours_and_traces_are_what_was_found(recorded, folder):
    """Forces and activations by muscle at the frame's time; frames without known forces are left out."""
    force = read_storage(folder / "forces.sto")
    seen = recorded.seen(30)
    order = [recorded.model.actuator(k).name for k in range(recorded.model.nu)]
    wanted = [force.values[30, force.labels.index(name)] for name in order]
    np.testing.assert_allclose(seen.muscles["force"], wanted)
    assert recorded.colored == "force"
    measured = recorded.courses["activation"].measured
    assert np.isfinite(measured).any(axis=0).sum() == 1
    short = folder / "short"
    short.mkdir()
    write_storage(short / "forces.sto", "f", Storage(force.labels, force.time[10:21], force.values[10:21]))
    part = Recorded(ARM, BEND, short)
    np.testing.assert_allclose(part.time, recorded.time[10:21])
    np.testing.assert_allclose(part.courses["force"].values, force.values[10:21])


def test_a_picture_is_one_moment(recorded):
    """What is drawn, traced and written is the shown frame's, while it plays and when one is asked for."""
    measured = recorded.courses["activation"].items[0]
    server = open_server(0, "test")
    page = TrialPage(server, recorded, "bend")
    thread = threading.Thread(target=page.run, daemon=True)
    thread.start()
    seen = []
    draw = page.draw

    def watched():
        draw()
        written = float(re.search(r"([\d.]+) s</b> · frame", page._status.content)[1])
        seen.append(
            (page.time, page._history.now, written, page._slider.value, page._figure.data.qpos.copy())
        )

    page.draw = watched
    try:
        browser = Client(f"ws://127.0.0.1:{server.get_port()}")
        assert until(lambda: browser.frames > 3), "it plays"
        browser.set("time [s]", 0.5)
        assert until(lambda: not page.playing and abs(page.time - 0.5) < 0.01)
        page.ask("pick", lambda: page.pick("BRA"))
        assert until(lambda: ("force", "BRA") in page._traces.chosen and page._tag.visible)
        assert "BRA · activation" in page._tag.text
        labels = [curve.label for chart in page._traces.charts() for curve in chart.curves]
        assert f"{measured} EMG" in labels
        browser.leave()
    finally:
        page.stop()
        thread.join()
        close_server(server)
    assert len({time for time, *_ in seen}) > 3
    for time, traced, written, slider, qpos in seen:
        assert traced == slider == time
        assert abs(written - time) < 1e-3
        np.testing.assert_allclose(qpos, recorded.seen(recorded.frame_at(time)).qpos, atol=1e-12)


def test_the_page_is_lit_and_no_message_ends_it(recorded):
    server = open_server(0, "test")
    page = TrialPage(server, recorded, "bend")
    thread = threading.Thread(target=page.run, daemon=True)
    thread.start()
    address = f"ws://127.0.0.1:{server.get_port()}"
    try:
        browser = Client(address)
        assert browser.lights() == LIGHTS
        for camera in MISSTATED:
            rude = Client(address, **camera)
            frames = browser.frames
            until(lambda frames=frames: browser.frames > frames + 1)
            rude.leave()
        assert page.message == ""
        labels = [part["label"] for part in browser.parts.values() if part.get("label")]
        assert {"time [s]", "color", "Save CSV"} <= set(labels)
        for label in labels:
            for value in (float("nan"), 1e308, 2**63, "x", None, [], {}, True):
                browser.set(label, value)

        def asked_for():  # again, while a picture that plays moves the slider
            browser.set("time [s]", 0.5)
            return not page.playing and abs(page.time - 0.5) < 0.01

        until(asked_for)
        assert thread.is_alive()
    finally:
        page.stop()
        thread.join()
        close_server(server)


def test_a_film_of_a_motion_has_traces_below(folder, tmp_path):
    said = Said(Setup(task=ARM))
    film = Record(said, output=tmp_path / "arm.png", recording=Trial(BEND, folder), size=(160, 120))
    try:
        film()
    except NoGraphicsError as error:
        pytest.skip(str(error))
    from PIL import Image

    width, height = Image.open(tmp_path / "arm.png").size
    assert (width, height) == (160, 120 + round(110 / 480 * 160))
    Record(said, output=tmp_path / "arm.html", recording=Trial(BEND, folder))()
    assert (tmp_path / "arm.html").stat().st_size > 1e5


@pytest.mark.parametrize(
    ("task", "options", "message"),
    [
        (
            "myoElbowPose1D6MRandom-v0",
            {"motion": BEND},
            "--motion needs the model that moves, --model FILE.osim",
        ),
        (ARM, {"loads": BEND}, "--loads belongs to a recorded motion; give it with --motion FILE"),
        (ARM, {"motion": ROOT / "docs"}, "has neither of tracked.mot, ik.mot; give the file itself"),
    ],
)
def test_bad_input_is_one_sentence(task, options, message):
    with pytest.raises(ValueError, match=message) as caught:
        View(Said(Setup(task=task)), recording=Trial(**options))()
    assert "\n" not in str(caught.value)
