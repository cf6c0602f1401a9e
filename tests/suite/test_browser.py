"""The page of `myowarp view`, by a client on its socket: what it gets, may ask for, and cannot break."""

import contextlib
import logging
import re
import socket
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
import viser
from socket_client import LIGHTS, MISSTATED, Client, until
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from myowarp.apps.cli.options import Said
from myowarp.apps.cli.view import View, policies_for
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.extras import to_install
from myowarp.process import warn_once
from myowarp.sim.patient import Knob
from myowarp.view.browser import live as live_module
from myowarp.view.browser.controls import Wishes
from myowarp.view.browser.live import Live
from myowarp.view.browser.patient_tab import BESIDE, PatientTab
from myowarp.view.browser.server import check_port, close_server, open_server
from myowarp.view.browser.task_tree import OWN, place_of
from myowarp.view.browser.updates import take_values_alone
from myowarp.view.browser.widgets import Widgets

KEY = "myoElbowPose1D6MRandom-v0"
OWN_POLICY = """
import numpy as np

def bend(obs):
    return np.ones((len(obs), 1), dtype=np.float32)
"""
OWN_MODEL = """
<mujoco><worldbody><body name="arm" pos="0 0 1">
  <joint name="elbow" axis="0 1 0" range="-1 1" limited="true"/>
  <geom name="bone" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03"/>
</body></worldbody><actuator><motor name="torque" joint="elbow" ctrlrange="-1 1"/></actuator></mujoco>
"""


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    (folder / "bend.py").write_text(OWN_POLICY)
    (folder / "arm.xml").write_text(OWN_MODEL)
    return View(Said(Setup(task=folder / "arm.xml")), policy=f"{folder}/bend.py:bend", worlds=2)


@pytest.fixture(scope="module")
def page(command):
    session = command.open(KEY, "random")
    server = open_server(0, "test")
    live = Live(server, session, command.choices())
    thread = threading.Thread(target=live.run, daemon=True)
    thread.start()
    yield live, f"ws://127.0.0.1:{server.get_port()}"
    assert thread.is_alive()
    live.stop()
    thread.join(30)
    close_server(server)


@pytest.fixture
def client(page):
    found = Client(page[1])
    until(found.status)
    until(lambda: page[0].server.get_clients())
    yield found
    found.leave()


def steps(live):
    return live.session.steps


def test_body_muscles_and_readings_arrive(page, client):
    live = page[0]
    names = {"FrameMessage", "MeshMessage", "BatchedMeshesMessage", "GuiPanelMessage"}
    until(lambda: names <= client.types.keys())
    until(lambda: any("<polyline" in p.get("content", "") for p in list(client.parts.values())))
    assert "success" in client.status() or "return" in client.status()
    assert any("bonus" in part.get("content", "") for part in client.parts.values())
    first = steps(live)
    until(lambda: steps(live) > first + 5)
    tubes = live.figure.tubes.handle
    seen, places = live.session.seen(0), tubes.batched_positions.copy()
    assert np.isfinite(places).all()
    assert len(places) >= len(seen.activation)
    until(lambda: not np.array_equal(tubes.batched_positions, places))


def test_pause_stops_the_step_counter(page, client):
    live = page[0]
    until(lambda: live.playing and steps(live) > 3)
    client.press("Pause")
    until(lambda: "paused" in client.status())
    halted = steps(live)
    time.sleep(0.5)
    assert steps(live) == halted
    client.press("Step")
    until(lambda: steps(live) == halted + 1)
    time.sleep(0.3)
    assert steps(live) == halted + 1
    client.press("Reset")
    until(lambda: live.session.time == 0.0)
    client.press("Play")
    until(lambda: steps(live) > halted + 3)


def test_a_slider_weakens_the_chosen_muscle_beside_its_twin(page, client):
    live = page[0]
    session = live.session
    client.set("muscles", "BIClong")
    until(lambda: live.panel.patient.muscles == "BIClong")
    client.set("beside: the same without the change", True)
    until(lambda: live.session.beside)
    client.set("remaining strength", 0.25)
    knob = session.patient.knobs["sarcopenia strength"]
    until(lambda: session.patient.value(knob, 0, ["BIClong"]) == pytest.approx(0.25))
    first = steps(live)
    until(lambda: steps(live) > first + 2)
    strength = session.sim.scene.muscles.anatomy.strength.numpy()
    index = list(session.sim.scene.muscles.names).index("BIClong")
    expected = np.ones_like(strength)
    expected[: session.twin, index] = 0.25
    np.testing.assert_array_equal(strength, expected)
    until(lambda: live.twin is not None and "before the change" in client.status())
    client.push("Undo all changes")
    until(lambda: session.patient.value(knob, 0, ["BIClong"]) == 1.0)
    client.set("beside: the same without the change", False)
    until(lambda: not live.session.beside)


@pytest.mark.parametrize(
    ("label", "value", "says"),
    [
        ("preset", "pirate", "preset 'pirate' unknown; available"),
        ("remaining strength", float("nan"), "sarcopenia strength must be"),
        ("remaining strength", -5.0, "sarcopenia strength must be from 0 to 2, got -5"),
        ("remaining strength", 3.0, "sarcopenia strength must be from 0 to 2, got 3"),
        ("forearm mass [kg]", 1e308, "exoskeleton forearm_mass must be from 0 to 2, got 1e+308"),
        ("share of muscles", 9.2e18, "joint_device assistance must be from 0 to 1, got 9.2e+18"),
        ("force passed on", 1e9, "tendon_tear transmission must be from 0 to 1, got 1e+09"),
        ("× real time", 1e300, "speed must be from 0.05 to 10, got 1e+300"),
        ("muscles", "no such muscle", "muscles 'no such muscle' unknown"),
        ("color", "<script>", "unknown; available"),
        ("policy", "hold it", "policy 'hold it' unknown"),
        ("world", "99", "world '99' unknown"),
    ],
)
def test_hostile_values_are_refused_in_a_sentence(page, client, label, value, says):
    live = page[0]
    before = client.parts[client.uuid(label)]["value"]
    live.message = ""
    client.set(label, value)
    until(lambda: says in live.message)
    assert "<script>" not in client.status()
    until(lambda: client.parts[client.uuid(label)]["value"] == before)
    halted = steps(live)
    until(lambda: steps(live) > halted + 2)


def test_what_is_no_message_changes_nothing(page, client, capfd, caplog):
    live, address = page
    with caplog.at_level(logging.ERROR):
        rude = Client(address)
        uuid = rude.uuid("remaining strength") if until(rude.status) else ""
        rude.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": "much"}})
        rude.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"nothing": 1}})
        private = {"update_cb": 5, "removed": True, "is_button": True, "value": 0.5}
        rude.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": private})
        rude.send({"type": "ShareUrlRequest"})
        rude.send({"type": "no such type"})
        rude.vanish()
        half = socket.create_connection(("127.0.0.1", live.server.get_port()))
        half.send(b"GET / HTTP/1.1\r\n\x00\xff")
        half.close()
        halted = steps(live)
        until(lambda: steps(live) > halted + 5)
        time.sleep(0.3)
    said = "".join(capfd.readouterr())
    of_page = [record for record in caplog.records if not record.name.startswith("websockets.client")]
    assert "Traceback" not in said
    assert not of_page
    assert not client.done
    patient, chosen = live.session.patient, live.panel.patient.muscles
    knob = patient.knobs["sarcopenia strength"]
    assert live.panel.patient.sliders[knob,].value == 1.0
    for value in (0.75, 1.0):
        client.set("remaining strength", value)
        until(lambda value=value: patient.value(knob, 0, patient.groups[chosen]) == pytest.approx(value))


@pytest.mark.parametrize("camera", MISSTATED, ids=str)
def test_a_camera_that_cannot_be_is_dropped(page, client, camera):
    """And so it is when all pages are aimed anew."""
    live, address = page
    rude = Client(address, **camera)  # some of these viser itself drops: it then is no client
    halted, aimed = steps(live), client.types["SetCameraPositionMessage"]
    live.ask("test", lambda: live.show_twin(True))
    live.ask("test again", lambda: live.show_twin(False))
    until(lambda: client.types["SetCameraPositionMessage"] > aimed and steps(live) > halted + 2)
    assert live.message == ""
    rude.leave()


def test_whatever_a_wish_raises_the_page_goes_on(page, client):
    """Also what no list of exceptions has."""
    live = page[0]
    for error in (ZeroDivisionError("no such camera"), AssertionError("never"), Exception("unheard of")):
        live.ask("test", lambda error=error: (_ for _ in ()).throw(error))
        until(lambda error=error: live.message == str(error))
        halted = steps(live)
        until(lambda halted=halted: steps(live) > halted + 2)
    live.ask("test", lambda: setattr(live, "message", ""))
    until(lambda: not live.message)


def test_a_page_is_lit_after_another_task_is_shown_too(page, client):
    live, address = page
    assert client.lights() == LIGHTS
    live.ask("test", lambda: live.open(KEY, "random"))
    drawn = client.frames
    until(lambda: client.frames > drawn + 3)
    later = Client(address)
    assert later.lights() == LIGHTS
    later.leave()


def test_reset_recovers_whatever_happened(page, client):
    """An infinite mass, which no slider gives, leaves a state that no reset of the worlds makes finite."""
    live = page[0]
    session = live.session
    knob = session.patient.knobs["exoskeleton forearm_mass"]
    start = knob.parameter.curve.start
    start.assign(np.full(start.shape, np.inf, dtype=np.float32))
    until(lambda: not live.playing)
    assert "must be finite" in live.message
    buttons = client.uuid("")
    client.press("Reset")
    until(lambda: client.uuid("") != buttons)
    assert "the task is opened anew, without changes to the patient" in live.message
    client.press("Play")
    frames = client.frames
    until(lambda: client.frames > frames + 3)
    assert live.playing
    assert live.session.patient.value(live.session.patient.knobs[knob.name], 0) == 0.0


def test_sliders_without_effect_say_why(client):

    def hints():
        parts = list(client.parts.values())
        return [p["visible"] for p in parts if "while 'share that tires' is 0" in p.get("_markdown", "")]

    assert until(lambda: [shown for shown in hints() if shown]) == [True]
    client.set("share that tires", 0.5)
    until(lambda: not any(hints()))
    client.set("share that tires", 0.0)
    until(lambda: any(hints()))


class Standing(Wishes):
    """A page of a patient who does not move."""

    def __init__(self, server, session):
        super().__init__(server)
        self.session = session

    def view(self, width, height):
        return np.ones(3), np.zeros(3), 1.0

    def single_step(self):
        pass

    def reset(self):
        pass

    def show_twin(self, beside):
        pass


def test_a_device_acts_where_it_is_worn():
    """On both ankles, until another joint is chosen; what is no joint of the list changes nothing."""
    joints = ("ankle_angle_r", "ankle_angle_l", "knee_angle_l")
    knobs = [Knob("joint_device", "peak", None, -50.0, 50.0, joint) for joint in joints]
    knobs.append(Knob("tendon_tear", "transmission", None, 0.0, 1.0, "ECRL_r, ECRB_r"))  # no list of one
    torque = dict.fromkeys(knobs, 0.0)
    patient = SimpleNamespace(
        knobs={knob.name: knob for knob in knobs},
        groups={"all muscles": ()},
        value=lambda knob, world, muscles: torque[knob],
        idle=lambda knob, world, muscles: "",
    )
    session = SimpleNamespace(patient=patient, preset="as it began", beside=False, world=0)
    session.turn = lambda knob, value, muscles: torque.update({knob: value})
    server = open_server(0, "test")
    try:
        live = Standing(server, session)
        PatientTab(live, Widgets(live))
        client = Client(f"ws://127.0.0.1:{server.get_port()}")
        until(lambda: server.get_clients())

        def ask(label, value, done):
            client.set(label, value)
            until(lambda: (live.obey(), done())[1])

        assert client.parts[client.uuid("worn at")]["value"] == "both: ankle"
        ask("motor [N m]", 20.0, lambda: list(torque.values()) == [20.0, 20.0, 0.0, 0.0])
        ask("worn at", "left knee", lambda: client.parts[client.uuid("worn at")]["value"])
        ask("motor [N m]", -5.0, lambda: list(torque.values()) == [20.0, 20.0, -5.0, 0.0])
        ask("worn at", "third knee", lambda: live.message.startswith("worn at 'third knee' unknown"))
        ask("motor [N m]", 99.0, lambda: live.message == "joint_device peak must be from -50 to 50, got 99")
        assert list(torque.values()) == [20.0, 20.0, -5.0, 0.0]
        assert [part.get("label") for part in client.parts.values()].count("worn at") == 1
        client.leave()
    finally:
        close_server(server)


def test_traces_show_what_is_chosen_and_the_twin_dashed(page, client):
    traces = page[0].panel.traces

    def curves():
        parts = list(client.parts.values())
        return next((p["content"] for p in parts if "time / s" in p.get("content", "")), "")

    def offered():
        return client.parts[client.uuid("of")]["options"]

    until(lambda: curves() and "BIClong" not in curves())
    assert "joint angle / °" in curves()
    client.set("quantity", "joint angle")  # which no muscle has: so it is seen when another is offered
    until(lambda: "BIClong" not in offered())
    client.set("quantity", "force")
    until(lambda: "BIClong" in offered())
    client.set("of", "BIClong")
    until(lambda: ("force", "BIClong") in traces.chosen)
    until(lambda: "force / N" in curves() and "BIClong" in curves())
    assert "BIClong before" not in curves()
    client.set("beside: the same without the change", True)
    until(lambda: "BIClong before" in curves() and 'stroke-dasharray="6 4"' in curves())
    client.set("beside: the same without the change", False)
    until(lambda: "BIClong before" not in curves())
    client.push("Save CSV")
    until(lambda: client.types["FileTransferPart"])
    client.push("Clear traces")
    until(lambda: not traces.chosen)
    traces.add("activation", "TRIlong")


def test_a_muscle_that_is_clicked_is_named_and_traced(page, client):
    live = page[0]
    live.figure.pick("BRA")
    until(lambda: ("force", "BRA") in live.panel.traces.chosen)
    until(lambda: live.tag.visible and live.tag.text.startswith("BRA (elbow flexors) · activation "))
    live.figure.pick("BRA")
    until(lambda: not live.tag.visible)


def test_looking_back_shows_what_was_seen(page, client):
    live = page[0]
    until(lambda: len(live.history.moments) > 30)
    client.set("seconds ago", 0.5)
    until(lambda: "0.5 s back" in client.status())
    then = live.history.back(0.5).seen[0].qpos
    until(lambda: np.array_equal(live.figure.data.qpos, then))
    assert not np.array_equal(then, live.history.moments[-1].seen[0].qpos)
    client.press("Play")
    until(lambda: live.back == 0.0 and live.playing)


def test_keys_play_step_and_reset(page, client):
    live = page[0]
    keys = {part["hotkey"]: uuid for uuid, part in list(client.parts.items()) if part.get("hotkey")}

    def strike(key):
        client.send({"type": "CommandTriggerMessage", "uuid": keys[key]})

    strike("space")
    until(lambda: not live.playing)
    halted = steps(live)
    strike("arrowright")
    until(lambda: steps(live) == halted + 1)
    strike("R")
    until(lambda: live.session.time == 0.0)
    strike("space")
    until(lambda: live.playing)


def test_two_pages_show_the_same_and_one_may_leave(page, client, capfd):
    live, address = page
    other = Client(address)
    until(other.status)
    until(lambda: len(live.server.get_clients()) == 2)
    other.set("color", "force")
    until(lambda: client.parts[client.uuid("color")]["value"] == "force")
    other.leave()
    until(lambda: len(live.server.get_clients()) == 1)
    halted = steps(live)
    until(lambda: steps(live) > halted + 5)
    client.set("color", "activation")
    until(lambda: live.color == "activation")
    assert "Traceback" not in "".join(capfd.readouterr())


def test_nothing_moves_while_no_page_is_open(page):
    live = page[0]
    until(lambda: not live.server.get_clients())
    time.sleep(0.1)
    halted = steps(live)
    time.sleep(0.4)
    assert steps(live) == halted


@pytest.mark.slow
def test_traffic_is_bounded(page, client, monkeypatch):
    """With room for a fifth of what is moved, fewer frames are sent, not more bytes."""
    live = page[0]
    until(lambda: client.types and live.panel)
    rates = []
    for bound in (live_module.TRAFFIC, 5e4):
        monkeypatch.setattr(live_module, "TRAFFIC", bound)
        time.sleep(0.5)
        begin, first = time.monotonic(), client.bytes
        time.sleep(2.0)
        rates.append((client.bytes - first) / (time.monotonic() - begin))
    assert 0 < rates[0] < 2e6
    assert rates[1] < 1.5e5


def test_other_tasks_are_shown_and_the_users_own_again(page, client, command):
    """Its model and its policy stay in the lists, wherever the page has been in between."""
    live = page[0]
    model, policy = str(command.asked.setup.task), command.policy
    for task in ("pose, finger", OWN, "pose, elbow"):
        client.set("task", task)
        until(lambda task=task: place_of(live.session.title)[0] == task, 240.0)
        if task == OWN:  # at rest, until one plays
            until(lambda: not live.playing)
            until(lambda: live.playing or client.press("Play"))  # until the new button is there
        until(lambda: steps(live) > 3, 240.0)  # its kernels may have to be compiled
        if task == OWN:
            assert live.session.title == model
            client.set("policy", policy)
            until(lambda: live.session.policy == policy)
            halted = steps(live)
            until(lambda halted=halted: steps(live) > halted + 3)
            assert (live.session.sim.action.numpy() == 1.0).all()
            client.set("policy", "random")
            until(lambda: live.session.policy == "random")
        options = client.parts[client.uuid("task")]["options"]
        assert options[0] == OWN
        assert "pose, elbow" in options
        assert policy in client.parts[client.uuid("policy")]["options"]
    until(lambda: client.types["GuiModalMessage"] == client.types["GuiCloseModalMessage"] == 3)
    client.set("variant", "hard")
    until(lambda: live.session.title == KEY, 240.0)
    until(client.status)


def admitted(port, origin=None):
    """Whether a socket opens and is spoken to."""
    given = {"origin": origin, "max_size": None}
    try:
        with connect(f"ws://127.0.0.1:{port}", subprotocols=[f"viser-v{viser.__version__}"], **given) as line:
            return bool(line.recv(timeout=60))
    except InvalidStatus as refused:
        return refused.response.status_code != 403


def test_pages_of_other_sites_are_refused(page):
    port = page[0].server.get_port()
    for foreign in (
        "http://evil.example",
        f"http://evil.example:{port}",
        "http://localhost.evil.example",
        "null",
    ):
        assert not admitted(port, foreign)
    for own in (f"http://localhost:{port}", "http://127.0.0.1:1", None):
        assert admitted(port, own)


def test_other_machines_are_not_listened_to(page):
    """The socket is bound to the loopback address alone."""
    table = Path("/proc/net/tcp").read_text() + Path("/proc/net/tcp6").read_text()
    listening = {line.split()[1] for line in table.splitlines() if line.split()[3] == "0A"}
    suffix = f":{page[0].server.get_port():04X}"
    assert {address for address in listening if address.endswith(suffix)} == {f"0100007F{suffix}"}


def test_a_viser_that_admits_other_sites_serves_no_page(monkeypatch):
    """As if it called another function of websockets than the one that is exchanged."""
    monkeypatch.setattr("myowarp.view.browser.server.refusing_other_sites", contextlib.nullcontext)
    before = threading.active_count()
    with pytest.raises(
        RuntimeError, match=r"^viser [\d.]+ has changed, so that pages of other sites could use"
    ):
        open_server(0, "test")
    until(lambda: threading.active_count() <= before, 10.0)


def test_a_viser_without_its_private_names_is_told_of_once(caplog):
    warn_once.cache_clear()
    for _ in range(2):
        take_values_alone(SimpleNamespace(gui=None))
    (line,) = [record.message for record in caplog.records]
    assert line.startswith(f"viser {viser.__version__} has changed, a browser may set more than values: ")


def test_a_busy_port_is_one_sentence():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(OSError, match=rf"^port {port} cannot be used .*--port 0"):
            check_port(port)
        with pytest.raises(OSError, match=rf"^port {port} cannot be used"):
            View(Said(Setup(task=KEY)), port=port)()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"task": KEY, "port": 70000}, "--port must be from 0 to 65535"),
        ({"task": KEY, "worlds": 0}, "--worlds must be at least 1"),
        ({"task": "myoHandReachFixed-v0", "policy": "hold"}, "policy 'hold' follows joint errors"),
        ({"task": KEY, "policy": "baselines/myoHandReachFixed-v0"}, "cannot act in"),
        ({}, "a task id or --model"),
    ],
)
def test_a_wrong_argument_is_one_sentence(arguments, says):
    arguments = dict(arguments)
    with pytest.raises((ValueError, RuntimeError), match=says):
        View(Said(Setup(task=arguments.pop("task", None))), **arguments)()


def test_without_viser_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ImportError, match=f"needs viser.*{re.escape(to_install('view'))}"):
        View(Said(Setup(task=KEY)))()


@pytest.mark.parametrize("display", ["", ":4711"])
def test_human_mode_without_a_display_is_a_page(monkeypatch, display, caplog):
    """None is named, or one that does not answer, which one line says."""
    warn_once.cache_clear()
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    env = gym.make_vec(f"MyoWarp/{KEY}", num_envs=2, device="cpu", render_mode="human")
    env.reset(seed=0)
    page = Client(f"ws://127.0.0.1:{env.unwrapped.pictures.viewer.server.get_port()}")
    env.step(env.action_space.sample())
    until(lambda: {"MeshMessage", "BatchedMeshesMessage"} <= page.types.keys())
    assert page.lights() == LIGHTS
    env.close()
    until(lambda: page.done)
    said = [record.message for record in caplog.records if "a page in the browser" in record.message]
    assert len(said) == bool(display)
    assert all(line.startswith("a window needs a display with OpenGL, got none at ':4711'") for line in said)


@pytest.mark.parametrize(
    ("task", "policy", "starts"),
    [
        ("myoHandReachRandom-v1", "baseline", "baseline"),
        ("myoHandReachRandom-v1", "baselines/myoHandReachFixed-v0", "baseline"),
        ("myoHandKeyTurnRandom-v1", "hold", "random"),
        ("myoHandBaodingRandom-v1", "baseline", "random"),
        (KEY, "hold", "hold"),
    ],
)
def test_a_page_starts_no_policy_of_another_task(task, policy, starts, monkeypatch):
    monkeypatch.setattr("myowarp.view.browser.session.Session", lambda *args, **options: args[3])
    assert View(Said(Setup(task=KEY))).open(task, policy) == starts


def test_a_policy_that_was_asked_for_acts(monkeypatch):
    monkeypatch.setattr("myowarp.view.browser.session.Session", lambda *args, **options: args[3])
    policy = "baselines/myoHandReachFixed-v0"
    assert (
        View(Said(Setup(task="myoHandReachRandom-v1")), policy=policy).open("myoHandReachRandom-v1", policy)
        == policy
    )


def test_policies_offered_can_act():
    hand, elbow = TASKS["myoHandReachFixed-v0"], TASKS[KEY]
    assert policies_for(hand, "random")[:2] == ["random", "baseline"]
    assert not [name for name in policies_for(hand, "random") if name.startswith("baselines/")]
    assert "hold" not in policies_for(hand, "hold")
    assert policies_for(elbow, "hold")[0] == "hold"
    assert "baselines/myoHandReachFixed-v0" not in policies_for(elbow, "baselines/myoHandReachFixed-v0")


def test_a_preset_of_the_command_line_has_its_box_ticked(monkeypatch):
    """The healthy twin stands beside, and the page says so."""
    seen = []

    def look(live):
        client = Client(f"ws://127.0.0.1:{live.server.get_port()}")
        seen.append((live.twin is not None, client.parts[client.uuid(BESIDE)]["value"]))
        client.leave()

    monkeypatch.setattr(Live, "run", look)
    for preset in (None, "older adult"):
        View(Said(Setup(task=KEY, device="cpu")), policy="zero", preset=preset, port=0)()
    assert seen == [(False, False), (True, True)]
