"""Writes MCAP with ROS 2's messages, without ROS: for rosbag2, Foxglove and learners."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._whole import whole
from tomojax.events import EventFinder
from tomojax.exports._messages import definition
from tomojax.exports._source import plain, Progress, Source

_FRAME = "tomojax_sheet"

# Of a contact in a cloud; and ROS's numbers of the types.
_POINT = np.dtype(
    [
        (name, "<u4" if name == "number" else "<f4")
        for name in ("x", "y", "z", "number", "conductance", "force")
    ]
)
_TYPES = {"u": 6, "f": 7}
_NUMBERS = ("radius", "angle", "current", "conductance", "force")

TOPICS = {
    "state": "tomojax_msgs/msg/State",
    "contacts": "sensor_msgs/msg/PointCloud2",
    "wrench": "geometry_msgs/msg/WrenchStamped",
    "image": "sensor_msgs/msg/Image",
    "events": "tomojax_msgs/msg/Event",
}


def write(source: Source, out: Path, progress: Progress) -> None:
    """Writes one file; see MESSAGES.md."""
    from mcap_ros2.writer import Writer

    with whole(out) as part, part.open("wb") as file:
        writer = Writer(file)
        texts = {name: str(value) for name, value in plain(source.attributes).items()}
        writer.add_metadata("tomojax", texts)
        schemas = {
            topic: writer.register_msgdef(kind, definition(kind))
            for topic, kind in TOPICS.items()
            if (topic != "image" or "image" in source.names)
            and (topic != "wrench" or "contact_force" in source.names)
        }

        def put(topic: str, t: float, message: dict[str, Any]) -> None:
            stamp = round(t * 1e9)  # ns
            seconds, rest = divmod(stamp, 10**9)
            head = {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": _FRAME}
            told = {"header": head, **message}
            name = f"/tomojax/{topic}"
            writer.write_message(name, schemas[topic], told, max(0, stamp))

        for t, row in _rows(source, progress):
            put("state", t, {"device_time": t, **row["state"]})
            put("contacts", t, _cloud(row["state"]["contacts"]))
            if "wrench" in schemas:
                put("wrench", t, _wrench(row["state"]["contacts"]))
            if "image" in schemas:
                put("image", t, _image(row["image"]))
        for event in source.events():
            x, y = event.xy
            told = {"device_time": event.t, "event": event.kind, "x": x, "y": y}
            put("events", event.t, event._asdict() | told)
        writer.finish()


def _rows(source: Source, progress: Progress) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yields each row's time, and its state and image."""
    finder = None
    for block in source.blocks(source.names, progress):
        t = block["t"].tolist()
        if finder is None and "contact_track" not in block:
            interval = (t[-1] - t[0]) / max(1, len(t) - 1)
            finder = EventFinder.of_rows(source.pitch, interval)
        shape = block["contact_xy"].shape[:2]
        each = {n: _listed(block, f"contact_{n}", shape) for n in _NUMBERS}
        each["covariance"] = _listed(block, "contact_covariance", (*shape, 3))
        xy = block["contact_xy"]
        each |= {"x": xy[..., 0].tolist(), "y": xy[..., 1].tolist()}
        flags, count = block["flags"].tolist(), block["contact_count"].tolist()
        residual = _listed(block, "residual", shape[:1])
        for k in range(len(t)):
            n = count[k]
            if finder is None:
                numbers = block["contact_track"][k, :n].tolist()
            else:
                g = each["conductance"][k][:n]
                numbers = finder.row(t[k], xy[k, :n].tolist(), g, flags[k])[0]
            contacts = [
                {"number": number, **{name: each[name][k][c] for name in each}}
                for c, number in enumerate(numbers)
            ]
            state = {"flags": flags[k], "residual": residual[k], "contacts": contacts}
            image = block["image"][k] if "image" in block else None
            yield t[k], {"state": state, "image": image}


def _listed(block: dict[str, np.ndarray], name: str, shape: tuple[int, ...]) -> list:
    """Returns a field as lists, NaN where results have no such field."""
    values = block[name] if name in block else np.full(shape, np.nan)
    return values.tolist()


def _cloud(contacts: list[dict]) -> dict[str, Any]:
    points = np.zeros(len(contacts), _POINT)  # z is 0
    for name in ("x", "y", "number", "conductance", "force"):
        points[name] = [one[name] for one in contacts]
    return {
        "height": 1,
        "width": len(contacts),
        "fields": [
            {"name": name, "offset": at, "datatype": _TYPES[kind.kind], "count": 1}
            for name, (kind, at, *_) in (_POINT.fields or {}).items()
        ],
        "is_bigendian": False,
        "point_step": _POINT.itemsize,
        "row_step": points.nbytes,
        "data": points.tobytes(),
        "is_dense": True,
    }


def _wrench(contacts: list[dict]) -> dict[str, Any]:
    """Sums the wrench of contacts that press along −z: r × F has x and y alone."""
    known = [c for c in contacts if c["force"] == c["force"]]
    torque = {
        "x": -sum(c["y"] * c["force"] for c in known),
        "y": sum(c["x"] * c["force"] for c in known),
        "z": 0.0,
    }
    force = {"x": 0.0, "y": 0.0, "z": -sum(c["force"] for c in known)}
    return {"wrench": {"force": force, "torque": torque}}


def _image(image: np.ndarray) -> dict[str, Any]:
    shown = np.ascontiguousarray(image.T[::-1], "<f4")
    return {
        "height": shown.shape[0],
        "width": shown.shape[1],
        "encoding": "32FC1",
        "is_bigendian": 0,
        "step": shown.strides[0],
        "data": shown.tobytes(),
    }
