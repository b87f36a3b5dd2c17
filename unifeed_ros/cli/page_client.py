"""A page without a browser: speaks viser's protocol, sees widgets, presses buttons, drags the ball at the hand."""

from __future__ import annotations

import threading
import time
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from viser import _messages
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from unifeed_ros.core.types import Array

BALL = "/grip"
"""Name of the ball at the hand in the page's scene; it is where the tool is drawn."""


class PageClient:
    """One open page, kept up to date by a thread of its own.

    Args:
        address: Address of the page.
    """

    def __init__(self, address: str) -> None:
        self.widgets: dict[str, dict[str, Any]] = {}
        """Properties of every widget by its identifier."""
        self.notes: list[str] = []
        """Notes that were shown."""
        self.places: list[tuple[float, Array]] = []
        """Where the tool was drawn, shape (3,) [m], with the steady time at which it came [s]."""
        self._socket = connect(address.replace("http", "ws"), proxy=None, max_size=None, compression=None,
                               subprotocols=[f"viser-v{viser.__version__}"])
        self._send(_messages.ViewerCameraMessage(
            wxyz=(1.0, 0.0, 0.0, 0.0), position=(1.0, 1.0, 1.0), fov=0.8, near=0.01, far=100.0, image_height=800,
            image_width=880, look_at=(0.0, 0.0, 0.0), up_direction=(0.0, 0.0, 1.0)))
        threading.Thread(target=self._listen, daemon=True).start()

    def close(self) -> None:
        """Close the page."""
        self._socket.close()

    def text(self) -> str:
        """Give all HTML that is on the page."""
        return "\n".join(w["content"] for w in list(self.widgets.values()) if "content" in w)

    def can_press(self, words: str) -> bool:
        """Say whether a button with these words can be pressed."""
        return any(words in w.get("label", "") and not w.get("disabled") for w in list(self.widgets.values()))

    def press(self, words: str) -> None:
        """Press the button with these words, also one that cannot be pressed."""
        name = next(n for n, w in list(self.widgets.items()) if words in (w.get("label") or ""))
        self._send(_messages.GuiUpdateMessage(uuid=name, updates={"value": True}))

    def drag(self, phase: str, place: Array, grabbed: Array) -> None:
        """Drag the ball: phase "start", "update" or "end", the place and where it was grabbed, shape (3,) each [m]."""
        self._send(_messages.SceneNodeDragMessage(
            phase=phase, name=BALL, instance_index=None, start_position=tuple(map(float, grabbed)),
            start_screen_pos=(0.5, 0.5), end_position=tuple(map(float, place)), end_screen_pos=(0.5, 0.5),
            button="left", modifier=None))

    def pull(self, places: Array, period: float = 0.05) -> None:
        """Drag the ball from the first place through the others, shape (N, 3) [m], one a period [s]."""
        for k, place in enumerate(places):
            self.drag("start" if k == 0 else "update", place, places[0])
            time.sleep(period)
        self.drag("end", places[-1], places[0])

    def _send(self, message: Any) -> None:
        self._socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def _listen(self) -> None:
        unpack = zstandard.ZstdDecompressor()
        try:
            for data in self._socket:
                length = int.from_bytes(data[8:16], "little")
                for message in msgspec.msgpack.decode(unpack.decompress(data[16:16 + length]))["messages"]:
                    self._take(message, time.monotonic())
        except ConnectionClosed:
            pass

    def _take(self, message: dict[str, Any], now: float) -> None:
        kind = message["type"]
        if "container_uuid" in message and "props" in message:
            self.widgets[message["uuid"]] = dict(message["props"])
        elif kind == "GuiUpdateMessage":
            self.widgets.setdefault(message["uuid"], {}).update(message["updates"])
        elif kind == "NotificationShowMessage":
            self.notes.append(message["props"]["body"])
        elif message.get("name") == BALL and (place := _position(message)) is not None:
            self.places.append((now, np.asarray(place, dtype=float)))


def _position(message: dict[str, Any]) -> Any:
    if message["type"] == "SetPositionMessage":
        return message["position"]
    return message.get("updates", {}).get("position") if message["type"] == "SceneNodeUpdateMessage" else None
