"""ROS 2 topics, by rclpy, in messages that every ROS machine has."""

import json

from tomojax.events import Event
from tomojax.hardware.loop import SlotRing
from tomojax.hardware.sinks._jsonl import event_as_json
from tomojax.hardware.sinks._rows import LiveContact, LiveRow
from tomojax.hardware.sinks._where import Where

_FRAME = "sheet"  # as of the node in C++


class Ros2Sink:
    """Publishes each row's contacts on a topic, and values and events beside them.

    TOPIC is a `geometry_msgs/PoseArray` with x and y, m, in the frame `sheet`; its stamp is
    the rig's clock. TOPIC/values is a `std_msgs/Float64MultiArray` with a line for each
    contact: number, x, y (m), conductance (S), force (N, NaN where unknown). TOPIC/events
    is a `std_msgs/String` with JSON as of `jsonl`.
    """

    def __init__(self, where: Where, ring: SlotRing):
        import rclpy  # pyright: ignore[reportMissingImports]
        from geometry_msgs.msg import PoseArray  # pyright: ignore[reportMissingImports]
        from rclpy.qos import qos_profile_sensor_data  # pyright: ignore
        from std_msgs.msg import Float64MultiArray, String  # pyright: ignore

        rclpy.init()
        self._rclpy = rclpy
        self._node = node = rclpy.create_node("tomojax")
        topic, often = where.path, qos_profile_sensor_data
        self._poses = node.create_publisher(PoseArray, topic, often)
        self._values = node.create_publisher(Float64MultiArray, f"{topic}/values", often)
        self._events = node.create_publisher(String, f"{topic}/events", 10)

    def put(self, row: LiveRow) -> None:
        from geometry_msgs.msg import Pose, PoseArray  # pyright: ignore
        from std_msgs.msg import Float64MultiArray, MultiArrayDimension  # pyright: ignore

        poses = PoseArray()
        poses.header.frame_id = _FRAME
        stamp = round(row.t * 1e9)
        poses.header.stamp.sec, poses.header.stamp.nanosec = divmod(stamp, 10**9)
        for one in row.contacts:
            pose = Pose()
            pose.position.x, pose.position.y = float(one.x), float(one.y)
            pose.orientation.w = 1.0
            poses.poses.append(pose)
        values, width = Float64MultiArray(), len(LiveContact._fields)
        values.data = [float(value) for one in row.contacts for value in one]
        values.layout.dim = [
            MultiArrayDimension(
                label="contact", size=len(poses.poses), stride=len(values.data)
            ),
            MultiArrayDimension(
                label=",".join(LiveContact._fields), size=width, stride=width
            ),
        ]
        self._poses.publish(poses)
        self._values.publish(values)

    def event(self, event: Event, row: LiveRow | None) -> None:
        from std_msgs.msg import String  # pyright: ignore

        self._events.publish(String(data=json.dumps(event_as_json(event))))

    def close(self) -> None:
        self._node.destroy_node()
        self._rclpy.shutdown()
