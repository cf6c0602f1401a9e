"""A headless Chromium, driven by the DevTools protocol; software draws, so that a frame may take seconds."""

import base64
import json
import re
import shutil
import subprocess
import tempfile
import time
import urllib.request

from websockets.sync.client import connect

NAME = next(filter(shutil.which, ("chromium", "chromium-browser", "google-chrome")), None)
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars", "--mute-audio"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run"),
    *("--remote-debugging-port=0", "--disable-background-networking"),
)
PATIENCE = 180.0  # s


class Chromium:
    """A page."""

    def __init__(self, size=(1000, 640), scale=1.0):
        """Open an empty page of a size [px]; a scale below 1 draws fewer dots for each px, and faster."""
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        own = (f"--window-size={size[0]},{size[1]}", f"--user-data-dir={self._folder.name}")
        own += (f"--force-device-scale-factor={scale}",)
        self._process = subprocess.Popen([NAME, *FLAGS, *own], stderr=subprocess.PIPE, text=True)
        port = next(m[1] for line in self._process.stderr if (m := re.search(r"ws://[^:]+:(\d+)/", line)))
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=PATIENCE) as answer:
            page = next(target for target in json.load(answer) if target["type"] == "page")
        self._socket = connect(page["webSocketDebuggerUrl"], max_size=None)
        self._count = 0
        width, height = size  # the page's: the window has a bar above it
        page = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **page)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def call(self, method, **parameters):
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE))
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return answer["result"]

    def before_opening(self, script):
        """Have a script run in the page before its own."""
        self.call("Page.enable")
        self.call("Page.addScriptToEvaluateOnNewDocument", source=script)

    def open(self, url):
        self.call("Page.navigate", url=url)

    def run(self, script):
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def screenshot(self):
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def text(self):
        return self.run("document.body ? document.body.innerText : ''")

    def wait_for(self, text):
        until = time.monotonic() + PATIENCE
        while text not in self.text():
            assert time.monotonic() < until, f"{text!r} did not come; the page says {self.text()[:500]!r}"
            time.sleep(0.2)

    def has(self, label):
        """Whether there is a button that has this text."""
        texts = self.run("[...document.querySelectorAll('button')].map(e => e.innerText.trim())")
        return label in texts

    def press(self, label):
        """Click the button or tab that has this text."""
        self.click("button, [role=tab]", f"e.innerText.trim() === {json.dumps(label)}")

    def click(self, kind, which="true"):
        """Click the first element of a kind of which a condition is true, where it is seen and at rest."""
        found = f"[...document.querySelectorAll('{kind}')].filter(e => e.offsetParent && {which})[0]"
        middle = "(b => [b.x + b.width / 2, b.y + b.height / 2])(e.getBoundingClientRect())"
        hit = f"(e => {{e.scrollIntoView({{block: 'nearest'}}); const [x, y] = {middle};"
        hit += f" return [x, y, e.contains(document.elementFromPoint(x, y))]}})({found})"
        until, before, place = time.monotonic() + PATIENCE, None, self.run(hit)
        while place != before or not place[2]:
            assert time.monotonic() < until, f"{kind} with {which} is covered or moves: {place}"
            # A notice stays as long as the mouse is on it.
            self.call("Input.dispatchMouseEvent", type="mouseMoved", x=1, y=1)
            time.sleep(0.05)
            before, place = place, self.run(hit)
        for event in ("mousePressed", "mouseReleased"):
            self.call(
                "Input.dispatchMouseEvent", type=event, x=place[0], y=place[1], button="left", clickCount=1
            )

    def close(self):
        self._socket.close()
        self._process.terminate()
        self._process.wait(PATIENCE)
        self._folder.cleanup()
