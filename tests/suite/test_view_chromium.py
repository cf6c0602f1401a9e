"""The page of `myowarp view` in a real browser: `make test-view`.

Pictures of tasks and converted models are left in out/view, to be looked at. `make test-view MINUTES=10`
watches the memory for ten minutes instead of one.
"""

import contextlib
import functools
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from chromium import NAME, Chromium
from socket_client import Client, until

from myowarp.apps.cli.options import Said
from myowarp.apps.cli.view import View
from myowarp.definitions.body import BODIES
from myowarp.definitions.setup import Setup
from myowarp.view.browser import controls as controls_module
from myowarp.view.browser import server as server_module
from myowarp.view.browser.live import Live
from myowarp.view.browser.page import Page
from myowarp.view.browser.patient_tab import FIRST
from myowarp.view.browser.playback import Take, write_playback
from myowarp.view.browser.server import close_server, open_server
from myowarp.view.browser.traces import TRACES_HEIGHT
from myowarp.view.browser.trial_page import TrialPage
from myowarp.view.drawing import style as look
from myowarp.view.drawing.recorded import Recorded
from myowarp.view.drawing.snapshot import Snapshot
from myowarp.view.drawing.style import SKY_RGB

pytestmark = [pytest.mark.view, pytest.mark.skipif(NAME is None, reason="needs chromium")]
ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "out" / "view"
OSIM = ROOT / "tests" / "data" / "osim"
ELBOW, HAND = "myoElbowPose1D6MRandom-v0", "myoHandPoseFixed-v0"
SHOWN = (
    *(
        "myoFingerPoseRandom-v0",
        "myoHandReachRandom-v1",
        "myoHandKeyTurnRandom-v1",
        "myoHandObjHoldRandom-v1",
    ),
    *("myoHandPenTwirlRandom-v1", "myoChallengeBaodingP1-v2", "arm26.osim", "gait10dof18musc.osim"),
)
SIZE = (1000, 700)
MINUTES = float(os.environ.get("MYOWARP_VIEW_MINUTES", "1"))
FRAMES, BYTES, GROWTH, CHANGE = 29.5, 2e6, 20.0, 0.1  # 1/s, 1/s, MB, of a signal
USUAL_SCREEN = (1280, 800)
LIT, GREY = (
    90.0,
    60.0,
)  # of 255, the mean colour of bones: 164 in a trial, 9 without lights; what is no colour
PAINTED = 30.0  # least spread of what has a colour
SMALLEST = 200  # px, of a body above the traces
WAITING = 0.1  # of the time
TYPING = 0.1  # s; viser's page sends what was typed 20 times a second
PANEL = 350  # px, with a border
EFFORT = """
import itertools
import numpy as np

count = itertools.count()

def effort(obs):
    return np.full((len(obs), 6), 1.0 if next(count) % 30 < 15 else -1.0, dtype=np.float32)
"""
COUNTED = """
window.seen = {}
let sent = new Set(), drawn = false
const gl = WebGL2RenderingContext.prototype
for (const [name, place] of [["bufferSubData", 2], ["texSubImage2D", 8]]) {
  const own = gl[name]
  gl[name] = function (...given) { sent.add(given[place]?.byteLength); return own.apply(this, given) }
}
for (const name of ["drawElements", "drawElementsInstanced"]) gl[name] = () => { drawn = true }
const tick = () => {
  if (drawn) for (const size of sent) if (size > 4096) window.seen[size] = (window.seen[size] ?? 0) + 1
  sent = new Set()
  drawn = false
  requestAnimationFrame(tick)
}
requestAnimationFrame(tick)
"""
"""Counts pictures with new places of muscles, by the size of what is new; software draws them too slowly."""


@contextlib.contextmanager
def serving(*arguments):
    """Run the command; yields the process and the address that it prints."""
    command = [
        sys.executable,
        "-m",
        "myowarp",
        "view",
        *map(str, arguments),
        "--port",
        "0",
        "--device",
        "cpu",
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    found = next((m[1] for line in process.stderr if (m := re.search(r"Open (http://\S+)", line))), None)
    assert found, "the command ended"
    try:
        yield process, found
    finally:
        process.send_signal(2)
        assert process.wait(30) == 0
    assert "Traceback" not in process.stderr.read()


@contextlib.contextmanager
def joined(address):
    """A second client."""
    client = Client(address.replace("http", "ws"))
    until(client.status)
    yield client
    client.leave()


@pytest.fixture(scope="module")
def served():
    with serving(ELBOW) as found:
        yield found


@pytest.fixture(scope="module")
def window(served):
    with Chromium(SIZE) as found:
        found.open(served[1])
        found.wait_for("real time")
        yield found


def step_of(window):
    """Return the number of the episode, and its time."""
    time_, episode = re.search(r"([\d.]+) s of .*\s*episode (\d+)", window.text()).groups()
    return int(episode), float(time_)


def pixels(window, path):
    """Return the picture without the panel and the traces, (height, width, 3)."""
    path.write_bytes(window.screenshot())
    reader = imageio_ffmpeg.read_frames(str(path), pix_fmt="rgb24")
    width, height = next(reader)["size"]
    picture = np.frombuffer(next(reader), np.uint8).reshape(height, width, 3)
    return picture.astype(int)[: height - TRACES_HEIGHT, : width - PANEL]


def settled(window, path):
    """Return the picture when it has stopped to change."""
    before = pixels(window, path)
    while not np.array_equal(now := pixels(window, path), before):
        before = now
        time.sleep(0.5)
    return now


def filled(picture):
    """Return a mask of pixels that are not the sky's."""
    return np.abs(picture - (255 * SKY_RGB).round()).max(axis=-1) > 12


def body_and_muscles(window, client, path):
    """Pause, and return masks of pixels: of all that is there, and of what another colour mode changes."""
    window.press("Run")
    client.press("Pause")
    window.wait_for("paused")
    picture = settled(window, path)
    client.set("color", "fiber_length")
    window.wait_for("fiber length / optimal")
    recolored = settled(window, path.with_suffix(".fiber_length.png"))
    body, muscles = filled(picture), np.abs(picture - recolored).max(axis=-1) > 20
    assert picture[body & ~muscles].mean() > LIT, "bones are dark"
    return body, muscles


def test_pause_stops_the_counter_and_the_picture(window, tmp_path):
    first = step_of(window)
    time.sleep(2.0)
    assert step_of(window) > first
    window.press("Pause")
    window.wait_for("paused")
    halted = step_of(window)
    before = settled(window, tmp_path / "a.png")
    red, green, blue = np.moveaxis(before, -1, 0)
    assert ((green > red + 25) & (green > blue + 15)).sum() > 50, "no ghost or target"
    time.sleep(1.0)
    assert step_of(window) == halted
    np.testing.assert_array_equal(pixels(window, tmp_path / "b.png"), before)
    window.press("Step")
    until(lambda: step_of(window) > halted)


def test_the_picture_is_never_pale(window):
    """viser lets it fade in, frame by frame."""
    faded = "(c => {c.style.opacity = '0.05'; return getComputedStyle(c).opacity})"
    assert window.run(f"{faded}(document.querySelector('canvas'))") == "1"


def test_the_patient_is_at_hand(window):
    window.press("Patient")
    window.wait_for("sarcopenia")
    window.wait_for("exoskeleton")
    window.click("input[type=checkbox]")
    window.press("Run")
    window.wait_for("before the change")


NUMBERS = "[...document.querySelectorAll('input.mantine-NumberInput-input')].filter(e => e.offsetParent)"


def number_input(window, index, value):
    """Paste a value into the box of a slider, which is one control with it.

    Another value goes first: viser 1.1.1 ignores the one that it sent last, though the server has set the
    box since.
    """
    for text in (f"{value / 2:g}", f"{value:g}"):
        window.run(f"(e => {{e.focus(); e.select()}})({NUMBERS}[{index}])")
        window.call("Input.insertText", text=text)
        time.sleep(TYPING)
    window.call("Input.dispatchKeyEvent", type="keyDown", key="Enter", code="Enter", windowsVirtualKeyCode=13)
    window.run("document.activeElement.blur()")


def signals_of(session):
    """Return muscle signals over an episode of effort and rest, (T, 2, num_muscles) each: world and twin."""
    session.restart()
    rows, pair = [], [session.world, session.twin]
    for _ in range(30):
        session.step()
        muscles = session.signals.muscles
        arrays = (muscles.excitation, muscles.activation, muscles.force, muscles.length)
        shown = [array.numpy() for array in (*arrays, *session.signals.info.values())]
        rows.append([values[pair].reshape(2, -1).copy() for values in shown])
    return [np.stack([row[k] for row in rows]) for k in range(len(rows[0]))]


def test_each_slider_moves_a_signal_of_the_muscles(tmp_path):
    """Each slider of the page to its far end, beside the twin that it does not move."""
    (tmp_path / "effort.py").write_text(EFFORT)
    command = View(Said(Setup(task=ELBOW, device="cpu")), policy=f"{tmp_path}/effort.py:effort")
    server = open_server(0, "test")
    live = Live(server, command.open(ELBOW, command.policy), command.choices())
    live.playing = False
    thread = threading.Thread(target=live.run, daemon=True)
    thread.start()
    session = live.session
    knobs = list(session.patient.knobs.values())
    order = list(dict.fromkeys((*FIRST, *(knob.condition for knob in knobs))))
    knobs.sort(key=lambda knob: order.index(knob.condition))  # as the page has them
    neutral = {kind.name: type(kind).NEUTRAL for kind in session.sim.conditions}
    value, found, change = session.patient.value, [], {}
    with Chromium((700, 900)) as window:
        window.before_opening(COUNTED)
        window.open(f"http://localhost:{server.get_port()}")
        window.wait_for("paused")
        window.press("Patient")
        window.wait_for("exoskeleton")
        numbers = functools.partial(window.run, f"{NUMBERS}.map(e => e.value)")
        at_first = numbers()
        assert len(at_first) == len(knobs)
        for knob in knobs:
            wanted = {}
            for other in knobs:  # a rate matters to a muscle that tires
                if other.condition == knob.condition and other is not knob:
                    wanted[other] = other.high if other.field in neutral[knob.condition] else other.high / 4
            wanted[knob] = knob.low if abs(value(knob, 0) - knob.low) > 1e-6 else knob.high
            for other, target in wanted.items():
                number_input(window, knobs.index(other), target)
                until(lambda: abs(value(other, 0) - target) <= other.step, 60.0)  # noqa: B023
            live.ask("test", lambda: found.append(signals_of(session)))
            signals = until(lambda: found and found.pop(), 120.0)
            change[knob.name] = max(
                np.abs(s[:, 0] - s[:, 1]).max() / np.abs(s).max() for s in signals if s.any()
            )
            window.press("Undo all changes")
            until(lambda: numbers() == at_first)
            time.sleep(TYPING)
            assert value(knob, 0) == value(knob, session.twin)
    live.stop()
    thread.join(30)
    close_server(server)
    assert len(change) >= 8
    assert {name: moved for name, moved in change.items() if moved < CHANGE} == {}


@pytest.mark.parametrize("shown", SHOWN)
def test_body_and_muscles_are_seen(shown, tmp_path):
    PICTURES.mkdir(parents=True, exist_ok=True)
    path = PICTURES / f"{Path(shown).stem}.png"
    task = [shown]
    if shown.endswith(".osim"):
        convert = [sys.executable, "-m", "myowarp", "convert", str(OSIM / shown), "--output", str(tmp_path)]
        subprocess.run(convert, check=True, capture_output=True)
        task = ["--model", tmp_path / "model.xml", "--free"]
    with serving(*task) as (_, address), joined(address) as client, Chromium(SIZE) as window:
        window.open(address)
        window.wait_for("real time")
        if shown.endswith(".osim"):  # a model of one's own begins at rest
            window.wait_for("paused")
            client.press("Play")
        until(lambda: "0.00 s of" not in client.status())
        if shown.startswith("gait"):  # it falls, and stays in the picture
            first = pixels(window, path.with_suffix(".first.png"))
            until(lambda: float(re.search(r"([\d.]+) s of", client.status())[1]) >= 1.5, 240.0)  # of 2
        body, muscles = body_and_muscles(window, client, path)
        assert muscles.sum() > 200
        assert (body & ~muscles).sum() > 1000
        if shown.startswith("gait"):
            assert body.sum() > 0.5 * filled(first).sum()


@contextlib.contextmanager
def played(page):
    """Run a page of this process; yields its address."""
    thread = threading.Thread(target=page.run, daemon=True)
    thread.start()
    try:
        yield f"http://localhost:{page.server.get_port()}"
    finally:
        page.stop()
        thread.join(60)
        close_server(page.server)


def lit(picture):
    """Return the mean colour of what has none above the horizon: of bones, lit or not."""
    above = picture[: len(picture) // 4]
    bones = above[filled(above) & (np.ptp(above, axis=-1) < GREY)]
    assert len(bones) > 300
    return bones.mean()


@pytest.mark.parametrize("lamps", [True, False], ids=["lit", "dark"])
def test_bones_of_a_trial_are_lit(lamps, monkeypatch):
    """With its lights out the page of a trial is black, and is found to be. The body keeps its size."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    if not lamps:
        for module in (server_module, controls_module):
            monkeypatch.setattr(module, "add_lights", lambda *_: None)
    recorded = Recorded(ROOT / "examples/arm.osim", ROOT / "examples/arm_bend.mot")
    page = TrialPage(open_server(0, "bend"), recorded)
    page.playing = False
    with played(page) as address, Chromium(USUAL_SCREEN) as window:
        window.open(address)
        window.wait_for("paused")
        picture = settled(window, PICTURES / f"trial_{'lit' if lamps else 'dark'}.png")
        assert window.run("document.title") == "bend · MyoWarp"
    assert (lit(picture) > LIT) == lamps
    if lamps:  # muscles, as neither floor nor sky has a colour
        muscles = filled(picture) & (np.ptp(picture, axis=-1) > PAINTED)
        assert np.ptp(np.flatnonzero(muscles.any(axis=1))) > SMALLEST


def still(body):
    """Return a body's model, its tips, and what it looks like at rest."""
    model = BODIES[body].build().compile()
    return model, BODIES[body].tips, Snapshot(look.rest_pose(model), {})


def test_bones_of_a_page_without_a_panel_are_lit(tmp_path):
    page = Page(*still("legs")[:2], "activation", "legs")
    try:
        page.show(still("legs")[2])
        with Chromium(SIZE) as window:
            window.open(f"http://localhost:{page.server.get_port()}")
            until(lambda: window.run("document.title") == "legs · MyoWarp")
            until(lambda: filled(pixels(window, tmp_path / "wait.png")).mean() > 0.02)
            assert lit(settled(window, PICTURES / "legs.png")) > LIT
    finally:
        page.close()


def test_bones_of_a_film_to_turn_are_lit(tmp_path):
    model, tips, seen = still("elbow")
    film = tmp_path / "elbow.html"
    write_playback(film, [[Take(model, tips, [seen, seen], [["0 s"], ["1 s"]])]], "activation", 2.0)
    with Chromium(SIZE) as window:
        window.open(film.as_uri())
        until(lambda: window.run("document.readyState") == "complete")  # no picture while it navigates
        until(lambda: filled(pixels(window, tmp_path / "wait.png")).mean() > 0.02)
        assert lit(settled(window, PICTURES / "film.png")) > LIT
        assert window.run("document.title") == "elbow · MyoWarp"


def test_the_first_sight_has_a_slider_and_a_title(served):
    """At 1280 x 800, without a click: the slider of strength is on the page, and its tab says what it is."""
    with Chromium(USUAL_SCREEN) as window:
        window.open(served[1])
        window.wait_for("remaining strength")
        label = (
            "[...document.querySelectorAll('label')].find(e => e.innerText.trim() === 'remaining strength')"
        )
        top, bottom = window.run(f"(b => [b.top, b.bottom])({label}.getBoundingClientRect())")
        assert 0 < top < bottom < USUAL_SCREEN[1]
        assert window.run("document.title") == "Elbow: pose · MyoWarp"
        window.wait_for("Elbow: pose")


def test_a_hand_comes_with_30_frames_a_second():
    """What the server sends, and what the page makes of it, in the best seconds: cores may be shared."""
    with serving(HAND) as (process, address), joined(address) as client:
        sent, traffic = rates(process, lambda: (client.frames, client.bytes))
        with Chromium(SIZE) as window:
            window.before_opening(COUNTED)
            window.open(address)
            window.wait_for("real time")
            made, _ = rates(process, lambda: (max(window.run("window.seen").values()), client.frames))
    print(f"hand: {sent:.1f} frames/s sent, {traffic / 1e6:.2f} MB/s, {made:.1f} pictures/s made")
    assert traffic <= BYTES
    assert sent >= FRAMES
    assert made >= FRAMES


def rates(process, count, seconds=3.0, windows=10):
    """Return what two counters do in a second, while the server waits least for a core."""
    time.sleep(5.0)
    found = []
    for _ in range(windows):
        begin, late, before = time.monotonic(), waited(process), np.array(count())
        time.sleep(seconds)
        took = time.monotonic() - begin
        found.append(((waited(process) - late) / took, *(np.array(count()) - before) / took))
    late, *best = min(found)
    if late > WAITING:
        pytest.skip(f"other programs use the cores: the server waits {100 * late:.0f} % of the time")
    return best


def waited(process):
    """Return how long a process has been ready and without a core [s]."""
    return int(Path(f"/proc/{process.pid}/schedstat").read_text().split()[1]) / 1e9


def test_a_page_that_leaves_costs_nothing(served, window):
    """And memory does not grow while pages are open."""
    other = Chromium((400, 300))
    other.open(served[1])
    other.wait_for("real time")
    other.close()
    if window.has("Play"):  # an earlier test paused it
        window.press("Play")

    def memory():
        with open(f"/proc/{served[0].pid}/status") as file:  # noqa: PTH123
            return int(re.search(r"VmRSS:\s+(\d+)", file.read())[1]) / 1024

    with joined(served[1]) as client:
        time.sleep(15.0)
        first, halted, begin = memory(), step_of(window), client.bytes
        time.sleep(60.0 * MINUTES)
        grown, traffic = memory() - first, (client.bytes - begin) / (60.0 * MINUTES)
    print(
        f"{MINUTES:g} minutes, two pages: {grown:+.1f} MB on {first:.0f} MB, {traffic / 1e6:.2f} MB/s to each"
    )
    assert grown < GROWTH
    assert traffic <= BYTES
    assert step_of(window) > halted
