"""Holds the texts of the ROS 2 messages; MESSAGES.md has tomojax's own messages."""

import re
from functools import cache
from importlib.resources import files

# Of common_interfaces, without their constants and comments.
_STANDARD = {
    "sensor_msgs/msg/PointCloud2": """std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense""",
    "sensor_msgs/msg/PointField": """string name
uint32 offset
uint8 datatype
uint32 count""",
    "sensor_msgs/msg/Image": """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data""",
    "geometry_msgs/msg/WrenchStamped": """std_msgs/Header header
geometry_msgs/Wrench wrench""",
    "geometry_msgs/msg/Wrench": """geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque""",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
}


@cache
def _texts() -> dict[str, str]:
    page = files("tomojax.exports").joinpath("MESSAGES.md").read_text(encoding="utf-8")
    ours = re.findall(r"## `(tomojax_msgs/msg/\w+)`\n\n((?:    .*\n?)+)", page)
    return _STANDARD | {name: re.sub("(?m)^    ", "", text) for name, text in ours}


def definition(name: str) -> str:
    """Returns a message's text, followed by the texts of the messages inside."""
    texts = _texts()
    found, due = [texts[name]], [name]
    known = {name}
    while due:
        for one in re.findall(r"(?m)^(\w+/\w+)", texts[due.pop()]):
            long = one.replace("/", "/msg/")
            if long not in known:
                known.add(long)
                due.append(long)
                found.append(f"{'=' * 80}\nMSG: {one}\n{texts[long]}")
    return "\n".join(found) + "\n"
