"""Recorded motions in pictures: bones, paths and arrows are the files'; a picture is one moment."""

import re
import threading
from pathlib import Path
from time import sleep
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from socket_client import LIGHTS, MISSTATED, Client, until

from myowarp.apps.cli.motion.forces import Forces
from myowarp.apps.cli.options import Said, Trial
from myowarp.apps.cli.record import Record
from myowarp.apps.cli.view import View
from myowarp.definitions.setup import Setup
from myowarp.motion.movement import read_motion
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.kinematics import complete, forward
from myowarp.view.browser.controls import Wishes
from myowarp.view.browser.server import close_server, open_server
from myowarp.view.browser.trial_page import TrialPage
from myowarp.view.browser.trial_traces import TrialTraces
from myowarp.view.browser.widgets import Widgets
from myowarp.view.drawing import style as look
from myowarp.view.drawing.recorded import LONGEST, Course, Recorded
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
    page = TrialPage(server, recorded)
    thread = threading.Thread(target=page.run, daemon=True)
    thread.start()
    seen = []
    draw = page.draw

    def watched():
        draw()
        written = float(re.search(r"([\d.]+) s</b> · frame", page.drive.status.content)[1])
        seen.append((page.time, page.traces.now, written, page.slider.value, page.figure.data.qpos.copy()))

    page.draw = watched
    try:
        browser = Client(f"ws://127.0.0.1:{server.get_port()}")
        assert until(lambda: browser.frames > 3), "it plays"
        browser.set("time [s]", asked := 0.5)
        assert until(lambda: not page.playing and abs(page.time - 0.5) < 0.01)
        page.ask("pick", lambda: page.pick("BRA"))
        assert until(lambda: ("force", "BRA") in page.traces.chosen and page.tag.visible)
        assert "BRA · activation" in page.tag.text
        labels = [curve.label for chart in page.traces.charts() for curve in chart.curves]
        assert f"{measured} EMG" in labels
        browser.leave()
    finally:
        page.stop()
        thread.join()
        close_server(server)
    assert len({time for time, *_ in seen}) > 3
    for time, traced, written, slider, qpos in seen:
        assert traced == time
        assert slider in (time, asked)  # the browser's own value comes at any time
        assert abs(written - time) < 1e-3
        np.testing.assert_allclose(qpos, recorded.seen(recorded.frame_at(time)).qpos, atol=1e-12)


def test_curves_are_over_the_cycle_of_their_side_and_by_the_bodys_weight():
    """Left over right, each over its own cycle; N over m g, N m over m; the other side only once."""
    time = np.linspace(0.0, 2.0, 201)
    moments = Course("N m", ("knee_r_moment", "knee_l_moment"), np.stack((time, 10.0 + time), axis=1))
    forces = Course("N", ("soleus_r", "soleus_l"), np.stack((100.0 * time, 50.0 * time), axis=1))
    cycles = {"r": (0.5, 1.5), "l": (1.0, 2.0)}
    trial = SimpleNamespace(
        time=time,
        courses={"joint moment": moments, "force": forces},
        cycles=cycles,
        cycle_of=lambda side: cycles[side or "r"],
        mass=70.0,
        gravity=9.81,
    )
    server = open_server(0, "test")
    try:
        traces = TrialTraces(page := Asked(server), Widgets(page), trial)
        traces.chosen, traces.now = [("joint moment", "knee_r_moment"), ("force", "soleus_l")], 1.0
        plain = traces.charts()
        assert [chart.title for chart in plain] == ["joint moment / N m", "force / N"]
        assert [curve.label for curve in plain[1].curves] == ["soleus_l", "soleus_r"]
        assert [bool(curve.dash) for curve in plain[0].curves] == [False, True]
        assert [bool(curve.dash) for curve in plain[1].curves] == [True, False]  # left is, whichever is first
        np.testing.assert_allclose(plain[0].curves[0].values, plain[0].along)
        traces.percent = traces.by_weight = True
        moment, force = traces.charts()
        assert (moment.title, force.title) == ("joint moment / N m/kg", "force / body weight")
        assert moment.axis == "% gait cycle"
        assert moment.now == pytest.approx(50.0)
        share = np.linspace(0.0, 1.0, 101)
        np.testing.assert_allclose(moment.curves[0].values, (0.5 + share) / 70.0)
        np.testing.assert_allclose(moment.curves[1].values, (11.0 + share) / 70.0)
        np.testing.assert_allclose(force.curves[0].values, 50.0 * (1.0 + share) / (70.0 * 9.81))
        rows = traces.table().splitlines()
        assert rows[0].startswith("% gait cycle,")
        assert len(rows) == 102
        traces.sides = False
        assert [len(chart.curves) for chart in traces.charts()] == [1, 1]
        traces.sides, traces.chosen = True, [("force", "soleus_l"), ("force", "soleus_r")]
        assert [curve.label for curve in traces.charts()[0].curves] == ["soleus_l", "soleus_r"]
    finally:
        close_server(server)


class Asked(Wishes):
    """A page that shows nothing."""

    def view(self, width, height):
        return np.ones(3), np.zeros(3), 1.0

    def single_step(self):
        pass

    def reset(self):
        pass


@pytest.mark.slow
def test_a_slow_browser_sees_the_trial_move(recorded, monkeypatch):
    """Where a picture takes longer than the trial, frames still follow one another."""
    server = open_server(0, "test")
    page = TrialPage(server, recorded)
    shown = []

    def slow():
        shown.append(page.frame)
        sleep(1.5 * float(np.ptp(recorded.time)))
        if len(shown) == 3:
            page.stop()

    monkeypatch.setattr(page, "draw", slow)
    monkeypatch.setattr(server, "get_clients", lambda: {0: None})
    try:
        page.run()
    finally:
        close_server(server)
    assert len(set(shown)) == 3


def test_the_page_is_lit_and_no_message_ends_it(recorded):
    server = open_server(0, "test")
    page = TrialPage(server, recorded)
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
