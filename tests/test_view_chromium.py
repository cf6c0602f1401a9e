"""The page of `myowarp view` in a real browser: `make test-view`."""

import re
import subprocess
import sys
import time

import imageio_ffmpeg
import numpy as np
import pytest
from chromium import NAME, Chromium

pytestmark = [pytest.mark.view, pytest.mark.skipif(NAME is None, reason="needs chromium")]
SIZE = (1000, 640)
MINUTES = 1.0


def address_of(process):
    for line in process.stderr:
        if found := re.search(r"Open (http://\S+)", line):
            return found[1]
    raise AssertionError("the command ended")


@pytest.fixture(scope="module")
def served():
    command = [sys.executable, "-m", "myowarp", "view", "myoElbowPose1D6MRandom-v0", "--port", "0"]
    process = subprocess.Popen([*command, "--device", "cpu"], stderr=subprocess.PIPE, text=True)
    yield process, address_of(process)
    process.send_signal(2)
    assert process.wait(30) == 0
    assert "Traceback" not in process.stderr.read()


@pytest.fixture(scope="module")
def window(served):
    with Chromium(SIZE) as found:
        found.open(served[1])
        found.wait_for("real time")
        yield found


def step_of(window):
    return int(re.search(r"step (\d+)", window.text())[1])


def pixels(window, path):
    path.write_bytes(window.screenshot())
    reader = imageio_ffmpeg.read_frames(str(path), pix_fmt="rgb24")
    width, height = next(reader)["size"]
    return np.frombuffer(next(reader), np.uint8).reshape(height, width, 3).astype(int)[:, : width // 2]


def test_pause_stops_the_counter_and_the_picture(window, tmp_path):
    first = step_of(window)
    time.sleep(2.0)
    assert step_of(window) > first
    window.press("Play / Pause")
    window.wait_for("paused")
    halted = step_of(window)
    before = pixels(window, tmp_path / "a.png")
    red, green, blue = np.moveaxis(before, -1, 0)
    assert (before.std(axis=-1) < 40).mean() > 0.5
    assert ((green > red + 25) & (green > blue + 15)).sum() > 50, "no ghost or target"
    assert (np.abs(red - blue) + np.abs(red - green) > 25).sum() > 300, "no muscles"
    assert ((before.min(axis=-1) > 90) & (before.max(axis=-1) < 225)).sum() > 3000, "no bones"
    time.sleep(1.0)
    assert step_of(window) == halted
    np.testing.assert_array_equal(pixels(window, tmp_path / "b.png"), before)
    window.press("Step")
    window.wait_for(f"step {halted + 1}")


def test_the_patient_is_at_hand(window):
    window.press("Patient")
    window.wait_for("sarcopenia")
    window.wait_for("exoskeleton")
    window.click("input[type=checkbox]")
    window.press("Run")
    window.wait_for("before the change")


def test_a_page_that_leaves_costs_nothing(served, window):
    """And memory does not grow while pages are open."""
    other = Chromium((400, 300))
    other.open(served[1])
    other.wait_for("real time")
    other.close()
    window.press("Play / Pause")

    def memory():
        with open(f"/proc/{served[0].pid}/status") as file:  # noqa: PTH123
            return int(re.search(r"VmRSS:\s+(\d+)", file.read())[1]) / 1024

    time.sleep(15.0)
    first, halted = memory(), step_of(window)
    time.sleep(60.0 * MINUTES)
    assert memory() - first < 20.0
    assert step_of(window) > halted + 10
