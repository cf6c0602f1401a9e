"""A client on the socket of a page, and what waits for what it is told."""

import threading
import time
from collections import Counter

import msgspec
import viser
import zstandard
from websockets.sync.client import connect

CAMERA = {
    "type": "ViewerCameraMessage",
    **{"wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1.0, 0.0, 0.0], "look_at": [0.0, 0.0, 0.0]},
    **{"fov": 1.0, "near": 0.01, "far": 100.0, "image_height": 100, "image_width": 100},
    "up_direction": [0.0, 0.0, 1.0],
}

MISSTATED = (
    *({"image_height": 0}, {"image_width": 0}, {"image_height": 0, "image_width": 0}, {"image_height": -1}),
    *({"image_height": "x"}, {"image_height": None}, {"image_height": 2**40, "image_width": 0}),
    *({"position": [float("nan")] * 3}, {"position": "x"}, {"look_at": [1.0, 0.0, 0.0]}, {"fov": "x"}),
    *({"position": [1e308] * 3}, {"look_at": []}, {"up_direction": [0.0] * 3}, {"wxyz": None}),
)
"""What a client may say of its camera, in place of what `CAMERA` has."""
LIGHTS = {"AmbientLightMessage": 1, "DirectionalLightMessage": 2}
"""How many messages of each type light a page."""


class Client:
    """A browser without a screen: counts bytes, messages by type, and pictures of the body's muscles."""

    def __init__(self, address, **camera):
        """Open a page; what is given is said of its camera in place of what `CAMERA` has."""
        # A browser acknowledges pings, and reads on while nobody looks.
        self._socket = connect(
            address, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, compression=None
        )
        self.parts, self.bytes, self.types, self.done = {}, 0, Counter(), False
        self.frames = 0
        self.send(CAMERA | camera)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        # Until then controls have the values that they were made with, not those that they have now.
        until(lambda: self.types["ReplayDoneMessage"] or self.done)

    def send(self, message):
        self._socket.send(msgspec.msgpack.encode(message))

    def _read(self):
        try:
            for packet in self._socket:
                self.bytes += len(packet)
                size = int.from_bytes(packet[8:16], "little")
                text = zstandard.ZstdDecompressor().decompress(packet[16 : 16 + size])
                for message in msgspec.msgpack.decode(text)["messages"]:
                    self._take(message)
        except Exception as error:  # noqa: BLE001 (shown by whoever waits)
            self.error = error
        self.done = True

    def _take(self, message):
        self.types[message["type"]] += 1
        if message.get("name") == "/world/body/tubes":
            self.frames += "batched_positions" in message.get("updates", ())
        if "props" in message and "uuid" in message:
            self.parts[message["uuid"]] = dict(message["props"], value=message.get("value"))
        elif message["type"] == "GuiUpdateMessage":
            self.parts.setdefault(message["uuid"], {}).update(message["updates"])
        elif message["type"] == "GuiRemoveMessage":
            self.parts.pop(message["uuid"], None)

    def uuid(self, label):
        return until(
            lambda: next((u for u, part in list(self.parts.items()) if part.get("label") == label), None)
        )

    def set(self, label, value):
        self.send({"type": "GuiUpdateMessage", "uuid": self.uuid(label), "updates": {"value": value}})

    def press(self, button):
        self.send({"type": "GuiUpdateMessage", "uuid": self.uuid(""), "updates": {"value": button}})

    def push(self, label):
        self.send({"type": "GuiUpdateMessage", "uuid": self.uuid(label), "updates": {"value": True}})

    def status(self):
        return next(
            (p["content"] for p in list(self.parts.values()) if "real time" in p.get("content", "")), ""
        )

    def lights(self):
        """How many lights of each kind there are."""
        return {
            kind: self.types[kind] for kind in self.types if "Light" in kind and kind != "EnableLightsMessage"
        }

    def vanish(self):
        """Break the connection without a word."""
        self._socket.close_socket()

    def leave(self):
        self._socket.close()
        self._reader.join(10)


def until(condition, seconds=240.0):
    """Wait for a condition, and return what it returns."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.02)
    return found
