"""The ROS 2 sink against a stub of the calls of rclpy and the messages that it uses."""

import json
import math
import subprocess
import sys
import types
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest

import tomojax as tx
from tomojax.hardware import SlotRing
from tomojax.hardware.sinks import check, check_all, follow, Force, parse
from tomojax.hardware.sinks.run import open_sink
from tomojax.recordings import attributes, Rig

NOW = 1.7e9  # s, of ROS's clock at the rig's zero
missing = pytest.mark.skipif(find_spec("rclpy") is not None, reason="ROS 2 is here")


def message(name: str, *fields: str, **made):
    """A class with slots, as ROS's messages have: another field is an AttributeError."""

    def init(self, **given):
        for field in fields:
            setattr(self, field, made[field]() if field in made else None)
        for field, value in given.items():
            setattr(self, field, value)

    return type(name, (), {"__slots__": fields, "__init__": init})


class Node:
    """A node that keeps what is published, and whose clock is 1 ms behind each row."""

    def __init__(self):
        self.sent, self.topics, self.times = {}, {}, iter(range(10**6))
        self.gone = False

    def create_publisher(self, kind, topic, qos):
        def publish(told):
            assert type(told) is kind
            self.sent[topic].append(told)

        self.sent[topic], self.topics[topic] = [], (kind.__name__, qos)
        return SimpleNamespace(publish=publish)

    def get_clock(self):
        nanoseconds = int((NOW + 1e-4 * 60 + 1e-3) * 1e9)
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=nanoseconds))

    def destroy_node(self):
        self.gone = True


@pytest.fixture
def node(monkeypatch):
    made, calls = Node(), []
    point, stamp = message("Point", "x", "y", "z"), message("Time", "sec", "nanosec")
    header = message("Header", "stamp", "frame_id", stamp=stamp)
    quaternion = message("Quaternion", "x", "y", "z", "w")
    pose = message(
        "Pose", "position", "orientation", position=point, orientation=quaternion
    )
    layout = message("Layout", "dim", "data_offset", dim=list)
    modules = {
        "rclpy": {
            "init": lambda args, signal_handler_options: calls.append("init"),
            "create_node": lambda name: made,
            "try_shutdown": lambda: calls.append("shutdown"),
        },
        "rclpy.qos": {"qos_profile_sensor_data": "sensor"},
        "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO=0)},
        "geometry_msgs": {},
        "geometry_msgs.msg": {
            "Pose": pose,
            "PoseArray": message("PoseArray", "header", "poses", header=header, poses=list),
        },
        "std_msgs": {},
        "std_msgs.msg": {
            "Float64MultiArray": message(
                "Float64MultiArray", "layout", "data", layout=layout
            ),
            "MultiArrayDimension": message(
                "MultiArrayDimension", "label", "size", "stride"
            ),
            "String": message("String", "data"),
        },
    }
    for name, held in modules.items():
        module = types.ModuleType(name)
        module.__dict__.update(held)
        monkeypatch.setitem(sys.modules, name, module)
    yield made
    assert calls == ["init", "shutdown"] and made.gone


def test_contacts_values_and_events_are_published(node) -> None:
    ring = SlotRing.create(16, 2)
    told = attributes(Rig.of(tx.Sensor.grid(4, 4, divisions=(16, 16))), 1e-4, 0.0)
    try:
        for k in range(60):
            count = 2 if 20 <= k < 40 else 1
            said = {"latency": 1e-5, "next": 0, "flags": 0, "count": count}
            said["xy"] = np.array([[0.03, 0.05], [0.06, 0.02]], np.float32)
            said["conductance"] = np.array([2e-4, 1e-4], np.float32)
            got = SimpleNamespace(number=k, lost=0, time=1e-4 * k, ground=0)
            ring.put(got, np.zeros(16, np.int16), said)  # type: ignore
        ring.head["done"][...] = 1
        where = parse("ros2:/skin/contacts")
        force = Force((0.02, 1.0), 1e-4)
        counted = follow(ring, open_sink(where, ring), told, where.rate, force)
    finally:
        ring.remove()
    assert counted == (60, 0, 0)
    assert node.topics == {
        "/skin/contacts": ("PoseArray", "sensor"),
        "/skin/contacts/values": ("Float64MultiArray", "sensor"),
        "/skin/contacts/events": ("String", 10),
    }
    poses, values, events = node.sent.values()
    assert [len(one.poses) for one in poses] == [1] * 20 + [2] * 20 + [1] * 20
    assert poses[30].header.frame_id == "sheet"
    second = poses[30].poses[1]
    assert second.position.x == pytest.approx(0.06) and second.orientation.w == 1
    stamps = [one.header.stamp.sec + one.header.stamp.nanosec * 1e-9 for one in poses]
    # The last row came soonest: its stamp is now, and no stamp lies in the future.
    assert stamps[-1] == pytest.approx(NOW + 7e-3, abs=1e-5)
    rows, columns = values[30].layout.dim
    assert columns.label == "stamp,number,x,y,conductance,force"
    assert (rows.size, rows.stride, columns.size) == (2, 12, 6)
    table = np.reshape(values[30].data, (2, 6))
    np.testing.assert_allclose(
        table[:, 1:5], [[1, 0.03, 0.05, 2e-4], [2, 0.06, 0.02, 1e-4]]
    )
    assert table[0, 5] == pytest.approx(0.01) and not math.isnan(table[1, 5])
    assert table[0, 0] == pytest.approx(stamps[30], abs=1e-6)
    kinds = [(one["event"], one["contact"]) for one in (json.loads(e.data) for e in events)]
    ends = [("lift_off", 2), ("lift_off", 1)]
    assert kinds == [("touch_down", 1), ("touch_down", 2), *ends]
    assert json.loads(events[0].data)["stamp_s"] == pytest.approx(NOW, abs=0.1)


@pytest.mark.parametrize("name", ["ros2:", "ros2:1a", "ros2:a b", "ros2:a//b", "ros2:a/"])
def test_topics_are_checked(name) -> None:
    with pytest.raises(ValueError, match="a topic of letters"):
        check(name)


def test_one_topic_has_one_sink(monkeypatch) -> None:
    monkeypatch.setattr("tomojax.hardware.sinks._where.find_spec", lambda name: name)
    with pytest.raises(ValueError, match="has already"):
        check_all(["ros2:a", "ros2:a?rate=5"])


@missing
def test_missing_rclpy_is_one_line() -> None:
    with pytest.raises(ValueError, match="rclpy is not installed; it comes with ROS 2"):
        check_all(["ros2:contacts"])
    words = ["live", "virtual", "--view", "none", "--send", "ros2:contacts"]
    code = "from tomojax.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, *words], capture_output=True, text=True
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert "not from PyPI" in done.stderr
