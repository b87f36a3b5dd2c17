"""A page without a browser: speaks viser's protocol, sees widgets, presses buttons, drags the ball at the hand."""

from __future__ import annotations

import threading
import time

import msgspec
import viser
import zstandard
from viser import _messages
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect


class PageClient:
    """One open page, kept up to date by a thread of its own."""

    def __init__(self, address):
        self.widgets, self.notes, self.moves = {}, [], 0
        self._socket = connect(address.replace("http", "ws"), proxy=None, max_size=None, compression=None,
                               subprotocols=[f"viser-v{viser.__version__}"])
        self._send(_messages.ViewerCameraMessage(
            wxyz=(1.0, 0.0, 0.0, 0.0), position=(1.0, 1.0, 1.0), fov=0.8, near=0.01, far=100.0, image_height=800,
            image_width=880, look_at=(0.0, 0.0, 0.0), up_direction=(0.0, 0.0, 1.0)))
        threading.Thread(target=self._listen, daemon=True).start()

    def close(self):
        self._socket.close()

    def text(self):
        """All HTML that is on the page."""
        return "\n".join(w["content"] for w in list(self.widgets.values()) if "content" in w)

    def can_press(self, words):
        return any(words in w.get("label", "") and not w.get("disabled") for w in list(self.widgets.values()))

    def press(self, words):
        name = next(n for n, w in list(self.widgets.items()) if words in (w.get("label") or ""))
        self._send(_messages.GuiUpdateMessage(uuid=name, updates={"value": True}))

    def drag(self, phase, place, grabbed):
        self._send(_messages.SceneNodeDragMessage(
            phase=phase, name="/grip", instance_index=None, start_position=tuple(map(float, grabbed)),
            start_screen_pos=(0.5, 0.5), end_position=tuple(map(float, place)), end_screen_pos=(0.5, 0.5),
            button="left", modifier=None))

    def pull(self, places, period=0.05):
        """Drag the ball from the first place through the others, shape (N, 3) [m]."""
        for k, place in enumerate(places):
            self.drag("start" if k == 0 else "update", place, places[0])
            time.sleep(period)
        self.drag("end", places[-1], places[0])

    def _send(self, message):
        self._socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def _listen(self):
        unpack = zstandard.ZstdDecompressor()
        try:
            for data in self._socket:
                length = int.from_bytes(data[8:16], "little")
                for message in msgspec.msgpack.decode(unpack.decompress(data[16:16 + length]))["messages"]:
                    self._take(message)
        except ConnectionClosed:
            pass

    def _take(self, message):
        kind = message["type"]
        if "container_uuid" in message and "props" in message:
            self.widgets[message["uuid"]] = dict(message["props"])
        elif kind == "GuiUpdateMessage":
            self.widgets.setdefault(message["uuid"], {}).update(message["updates"])
        elif kind == "NotificationShowMessage":
            self.notes.append(message["props"]["body"])
        elif kind in ("SetPositionMessage", "SceneNodeUpdateMessage") and message["name"] == "/grip":
            self.moves += 1

