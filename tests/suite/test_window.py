"""The window of `render_mode="human"` on an X server without a screen: Xvfb, whose picture is a file."""

import shutil
import subprocess
import sys

import numpy as np
import pytest
from socket_client import until

from myowarp.view.drawing.muscles import RELAXED_RGB, TENSED_RGB

XVFB = shutil.which("Xvfb")
pytestmark = pytest.mark.skipif(XVFB is None, reason="needs Xvfb (Debian: apt-get install xvfb)")
SIZE = (960, 720)
SHOWN = 300  # px that muscles take at least
HUE = 0.06  # light changes how bright a colour is, and its hue only a little
SCRIPT = """
import sys, time
import gymnasium as gym
import numpy as np
import myowarp

env = gym.make_vec("MyoWarp/myoElbowPose1D6MFixed-v0", num_envs=2, device="cpu", render_mode="human")
env.reset(seed=0)
for level in (-1.0, 1.0):
    for _ in range(40):
        env.step(np.full((2, 6), level, dtype=np.float32))
    print("shown", type(env.unwrapped.pictures.viewer).__name__, flush=True)
    sys.stdin.readline()
env.close()
env.close()
print("closed", flush=True)
"""


class Screen:
    """A server, and what is on it."""

    def __init__(self, folder, *options):
        size = f"{SIZE[0]}x{SIZE[1]}x24"
        command = [XVFB, "-displayfd", "1", "-screen", "0", size, "-nolisten", "tcp", "-fbdir", str(folder)]
        self._process = subprocess.Popen(
            [*command, *options], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        self.name = f":{int(self._process.stdout.readline())}"
        self._file = folder / "Xvfb_screen0"

    def picture(self):
        """Return what is on the screen, (height, width, 3); the file is an X window dump."""
        dump = self._file.read_bytes()
        header = np.frombuffer(dump[:100], ">u4")
        size, height, stride, colors = header[0], header[5], header[12], header[19]
        rows = np.frombuffer(dump, np.uint8, height * stride, size + 12 * colors).reshape(height, -1, 4)
        return rows[..., 2::-1].astype(float) / 255.0

    def close(self):
        self._process.terminate()
        self._process.wait(30)


@pytest.fixture
def screen(tmp_path):
    found = Screen(tmp_path)
    yield found
    found.close()


def colored(picture, rgb):
    """Return how many pixels have a colour, however bright the light on it is."""
    bright = picture.max(axis=-1, keepdims=True)
    share, wanted = picture / np.maximum(bright, 1e-6), np.asarray(rgb) / np.max(rgb)
    return int(((np.abs(share - wanted) < HUE).all(axis=-1) & (bright[..., 0] > 0.15)).sum())


def test_muscles_turn_red_in_the_window(screen, monkeypatch):
    """Muscles that rest have the one colour, muscles at full activation the other."""
    monkeypatch.setenv("DISPLAY", screen.name)
    command = [sys.executable, "-c", SCRIPT]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as shown:
        pictures = []
        for rgb in (RELAXED_RGB, TENSED_RGB):
            assert shown.stdout.readline() == "shown Window\n"
            until(lambda rgb=rgb: colored(screen.picture(), rgb) > SHOWN)  # the window draws when it can
            pictures.append(screen.picture())
            shown.stdin.write("go on\n")
            shown.stdin.flush()
        assert shown.stdout.readline() == "closed\n"
    assert shown.returncode == 0
    rest, tensed = pictures
    assert colored(rest, RELAXED_RGB) > SHOWN
    assert colored(rest, TENSED_RGB) == 0
    assert colored(tensed, TENSED_RGB) > SHOWN


def test_a_display_without_opengl_has_no_window(tmp_path, monkeypatch):
    """MuJoCo's viewer would fail in a thread of its own, and keep its caller waiting."""
    screen = Screen(tmp_path, "-extension", "GLX")
    monkeypatch.setenv("DISPLAY", screen.name)
    script = "from myowarp.view.window import check_window; check_window()"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    screen.close()
    assert (
        f"NoGraphicsError: a window needs a display with OpenGL, got none at '{screen.name}' (" in done.stderr
    )
