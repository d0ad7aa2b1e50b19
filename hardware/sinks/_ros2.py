"""ROS 2: publishes contacts, their values and events as messages that every ROS 2 has."""

import json
import math

from tomojax.events import Event
from tomojax.hardware.loop import SlotRing
from tomojax.hardware.sinks._jsonl import event_as_json
from tomojax.hardware.sinks._rows import LiveRow
from tomojax.hardware.sinks._where import Where

_FRAME = "sheet"  # as of the node in C++
_VALUES = "stamp,number,x,y,conductance,force"
_DRIFT = 1e-4  # s a second: two cheap quartzes part by no more


class Ros2Sink:
    """Topics of ROS 2, with the QoS of sensors; events are sent reliably.

    TOPIC is a PoseArray in the frame `sheet`, x and y in m. TOPIC/values is a
    Float64MultiArray with a row for each contact: stamp (s), number, x, y (m), conductance
    (S), force (N). TOPIC/events is a String of JSON with the keys of JSON lines. Stamps
    are the rows' times on ROS's clock, and `t_s` is the rig's.
    """

    def __init__(self, where: Where, ring: SlotRing):
        import rclpy  # pyright: ignore[reportMissingImports]
        from geometry_msgs.msg import PoseArray  # pyright: ignore[reportMissingImports]
        from rclpy.qos import (  # pyright: ignore[reportMissingImports]
            qos_profile_sensor_data,
        )
        from rclpy.signals import (  # pyright: ignore[reportMissingImports]
            SignalHandlerOptions,
        )
        from std_msgs.msg import (  # pyright: ignore[reportMissingImports]
            Float64MultiArray,
            String,
        )

        # Ctrl-C ends the loop, and the loop's end ends the sink.
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("tomojax")
        make, topic = self._node.create_publisher, where.path
        self._poses = make(PoseArray, topic, qos_profile_sensor_data)
        self._values = make(Float64MultiArray, f"{topic}/values", qos_profile_sensor_data)
        self._events = make(String, f"{topic}/events", 10)
        self._t, self._away = 0.0, math.inf

    def put(self, row: LiveRow) -> None:
        from geometry_msgs.msg import (  # pyright: ignore[reportMissingImports]
            Pose,
            PoseArray,
        )
        from std_msgs.msg import (  # pyright: ignore[reportMissingImports]
            Float64MultiArray,
            MultiArrayDimension,
        )

        stamp, poses, values = self._stamp(row.t), PoseArray(), Float64MultiArray()
        header = poses.header
        header.stamp.sec, header.stamp.nanosec = divmod(round(stamp * 1e9), 10**9)
        header.frame_id = _FRAME
        for one in row.contacts:
            pose = Pose()
            pose.position.x, pose.position.y = one.x, one.y
            pose.orientation.w = 1.0
            poses.poses.append(pose)
        columns, count = 1 + _VALUES.count(","), len(row.contacts)
        values.layout.dim = [
            MultiArrayDimension(label="contact", size=count, stride=columns * count),
            MultiArrayDimension(label=_VALUES, size=columns, stride=columns),
        ]
        values.data = [float(v) for one in row.contacts for v in (stamp, *one)]
        self._poses.publish(poses)
        self._values.publish(values)

    def event(self, event: Event, row: LiveRow | None) -> None:
        from std_msgs.msg import String  # pyright: ignore[reportMissingImports]

        stamp = {"stamp_s": self._stamp(event.t)}
        self._events.publish(String(data=json.dumps(stamp | event_as_json(event))))

    def close(self) -> None:
        import rclpy  # pyright: ignore[reportMissingImports]

        self._node.destroy_node()
        rclpy.try_shutdown()

    def _stamp(self, t: float) -> float:
        """Returns a rig's time on ROS's clock, by the rows that came soonest."""
        away = self._node.get_clock().now().nanoseconds / 1e9 - t
        later = self._away + _DRIFT * max(t - self._t, 0.0)
        self._t, self._away = max(t, self._t), min(away, later)
        return t + self._away
