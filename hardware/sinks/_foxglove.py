"""Foxglove's websocket, on this machine alone: sends contacts, the image and the state."""

import json
import math
from typing import Any

import numpy as np

from tomojax.events import Event
from tomojax.hardware.loop import SlotRing
from tomojax.hardware.sinks._jsonl import event_as_json, row_as_json
from tomojax.hardware.sinks._rows import LiveRow
from tomojax.hardware.sinks._where import Where

_FRAME = "tomojax_sheet"

_RADIUS = 0.004  # m, of a contact's disc: the step tells no radius
_HIGH = 0.001  # m, of the disc
_IMAGES = 10.0  # a second


class FoxgloveSink:
    """Topics of Foxglove; a slow client loses the oldest messages.

    /tomojax/contacts is a SceneUpdate, /tomojax/image a RawImage (32FC1, y upwards).
    /tomojax/state and /tomojax/events are JSON, with the keys of JSON lines.
    """

    def __init__(self, where: Where, ring: SlotRing):
        import foxglove
        from foxglove import channels

        self._ring, self._image_due = ring, -math.inf
        self._context = foxglove.Context()
        self._server = foxglove.start_server(
            name="tomojax",
            host="127.0.0.1",
            port=where.address[1],
            context=self._context,
        )
        own = self._context
        self._scene = channels.SceneUpdateChannel("/tomojax/contacts", context=own)
        self._image = channels.RawImageChannel("/tomojax/image", context=own)
        self._state, self._events = (
            foxglove.Channel(f"/tomojax/{name}", message_encoding="json", context=own)
            for name in ("state", "events")
        )

    def put(self, row: LiveRow) -> None:
        stamp = round(row.t * 1e9)
        self._state.log(json.dumps(row_as_json(row)).encode(), log_time=stamp)
        self._scene.log(_scene(row), log_time=stamp)
        if row.t >= self._image_due:
            self._image_due = row.t + 1 / _IMAGES
            self._image.log(_image(self._ring.head["image"], row.t), log_time=stamp)

    def event(self, event: Event, row: LiveRow | None) -> None:
        told = json.dumps(event_as_json(event)).encode()
        self._events.log(told, log_time=round(event.t * 1e9))

    def close(self) -> None:
        self._server.stop()


def _time(t: float) -> Any:
    from foxglove.messages import Timestamp

    return Timestamp(*divmod(round(max(t, 0.0) * 1e9), 10**9))


def _scene(row: LiveRow) -> Any:
    """Returns an entity with a disc for each contact; the next row's entity replaces it."""
    from foxglove import messages

    discs = [
        messages.CylinderPrimitive(
            pose=messages.Pose(
                position=messages.Vector3(x=one.x, y=one.y, z=0.0),
                orientation=messages.Quaternion(x=0, y=0, z=0, w=1),
            ),
            size=messages.Vector3(x=2 * _RADIUS, y=2 * _RADIUS, z=_HIGH),
            bottom_scale=1.0,
            top_scale=1.0,
            color=messages.Color(r=0.0, g=0.7, b=0.9, a=0.9),
        )
        for one in row.contacts
    ]
    entity = messages.SceneEntity(
        timestamp=_time(row.t), frame_id=_FRAME, id="contacts", cylinders=discs
    )
    return messages.SceneUpdate(entities=[entity])


def _image(image: np.ndarray, t: float) -> Any:
    from foxglove.messages import RawImage

    shown = np.ascontiguousarray(np.asarray(image, "<f4").T[::-1])
    return RawImage(
        timestamp=_time(t),
        frame_id=_FRAME,
        width=shown.shape[1],
        height=shown.shape[0],
        encoding="32FC1",
        step=shown.strides[0],
        data=shown.tobytes(),
    )
