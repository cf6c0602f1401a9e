"""State that the loop and the panel of a page share: how it runs, what it shows, requests of browsers."""

from __future__ import annotations

import abc
import threading
from collections.abc import Callable
from typing import Literal

import numpy as np
import viser

from myowarp.view.browser.lights import add_lights
from myowarp.view.browser.session import Choices, Session

NOTICE_SECONDS = 10.0
USUAL = (950, 760)
"""px of a picture beside the panel, of a page that has not said what it has."""
Hotkey = Literal["space", "arrowright", "R"]
View = tuple[np.ndarray, np.ndarray, float]
"""Position and aim of a camera [m], and its opening [rad]."""


class Wishes(abc.ABC):
    """Requests of browsers to a page, and how it plays; changed by its loop alone.

    Attributes:
        server: The page's server.
        playing: Whether it plays.
        speed: Shown time over the time that it is to take.
        color: What the colour of a muscle shows.
        follow: Whether a root that moves stays in the middle.
        message: What went wrong last.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        """Play."""
        self.server, self.playing, self.speed = server, True, 1.0
        self.color, self.follow, self.message = "activation", True, ""
        self._asked: dict[str, Callable[[], object]] = {}
        self._lock, self._stopped = threading.Lock(), threading.Event()
        server.on_client_connect(
            lambda client: self.ask(f"aim {client.client_id}", lambda: self._aim_client(client))
        )

    def stop(self) -> None:
        """End the loop, from any thread."""
        self._stopped.set()

    @property
    def beside(self) -> bool:
        """Whether a twin is shown."""
        return False

    def ask(self, key: str, wish: Callable[[], object]) -> None:
        """Have something done before the next step, in place of what was asked for under the same key."""
        with self._lock:
            self._asked[key] = wish

    def obey(self) -> bool:
        """Do what was asked for; say whether there was something."""
        with self._lock:
            asked, self._asked = self._asked, {}
        for wish in asked.values():
            self.attempt(wish)
        return bool(asked)

    def attempt(self, wish: Callable[[], object], aloud: bool = True) -> bool:
        """Do what a browser asks for, and return whether it was done; if `aloud`, all pages say why not."""
        try:
            wish()
        except Exception as error:  # noqa: BLE001 (whatever it is, the page goes on)
            if aloud:
                self.complain(str(error) or type(error).__name__)
            return False
        return True

    def bind_keys(self) -> None:
        """Have keys play and pause, step, and begin anew."""
        self._bind("Play or pause", "space", lambda: (self.pause if self.playing else self.play)())
        self._bind("Step", "arrowright", self.single_step)
        self._bind("Reset", "R", self.reset)

    def _bind(self, label: str, hotkey: Hotkey, wish: Callable[[], None]) -> None:
        """Have a key do something."""
        command = self.server.gui.add_command(label, hotkey=hotkey)
        command.on_trigger(lambda _: self.ask(label, wish))

    def play(self) -> None:
        """Go on from what is shown."""
        self.playing = True

    def pause(self) -> None:
        """Stand still."""
        self.playing = False

    @abc.abstractmethod
    def single_step(self) -> None:
        """Pause, and go one step on."""

    @abc.abstractmethod
    def reset(self) -> None:
        """Begin anew."""

    @abc.abstractmethod
    def view(self, width: int, height: int) -> View:
        """Return the camera for a picture of a size [px]."""

    def aim(self) -> None:
        """Point the camera of all pages, also of those that open later, and light the scene for it."""
        start = self.server.initial_camera
        start.position, start.look_at, start.fov = self.view(*USUAL)
        add_lights(self.server, start.look_at - start.position)
        for client in self.server.get_clients().values():
            self._aim_client(client)

    def _aim_client(self, client: viser.ClientHandle) -> None:
        """Point the camera of a page; a browser says what it likes of it, and one that cannot be stays."""

        def point() -> None:
            camera = client.camera
            with client.atomic():
                view = self.view(camera.image_width, camera.image_height)
                camera.position, camera.look_at, camera.fov = view

        self.attempt(point, aloud=False)

    def complain(self, text: str) -> None:
        """Show in all pages what went wrong."""
        self.message = text
        self.notify(text, "red")

    def notify(self, text: str, color: Literal["red", "blue"]) -> None:
        """Show a sentence in all pages, for some seconds."""
        for client in self.server.get_clients().values():
            client.add_notification("MyoWarp", text, auto_close_seconds=NOTICE_SECONDS, color=color)


class Controls(Wishes, abc.ABC):
    """The state of the page of a session.

    Attributes:
        choices: What can be chosen.
        session: What runs.
        factor: Simulated time over the time that it takes.
        back: How many seconds before the last moment the shown one is; 0 is the last.
    """

    def __init__(self, server: viser.ViserServer, session: Session, choices: Choices) -> None:
        """Play."""
        super().__init__(server)
        self.choices, self.session = choices, session
        self.factor, self.back = 0.0, 0.0

    @property
    def beside(self) -> bool:
        """Whether a twin is shown."""
        return self.session.beside

    @abc.abstractmethod
    def open(self, task: str, policy: str) -> None:
        """Show another task.

        Raises:
            ValueError: It cannot be built; the one before goes on.
        """

    def play(self) -> None:
        """Go on from the last moment."""
        self.playing, self.back = True, 0.0

    def look_back(self, seconds: float) -> None:
        """Pause, and show what was seen some seconds before the last moment; 0 is that moment."""
        self.playing, self.back = False, seconds

    def reset(self) -> None:
        """Begin new episodes; a session that no reset heals is opened anew, as its patient was at first."""
        self.back = 0.0
        try:
            self.session.restart()
        except ValueError as error:
            self.complain(f"{error}; the task is opened anew, without changes to the patient")
            self.open(self.session.title, self.session.policy)

    @abc.abstractmethod
    def show_twin(self, beside: bool) -> None:
        """Show or hide the twin, from the state that the shown world is in."""
