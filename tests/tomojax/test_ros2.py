"""The node for ROS 2, compiled against the few calls of rclcpp that it makes."""

import shutil
import subprocess
import sys

import numpy as np
import pytest

import tomojax as tx
from tomojax.hardware.sources.virtual_rig import VirtualRig, write_scene

# This stands for ROS 2. Parameters come from the command line. Messages go to standard
# output. After 200 messages it is no longer "ok".
RCLCPP = """
#pragma once
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
namespace rclcpp {
inline int count = 0;
inline char **words = nullptr;
inline int published = 0;
inline void init(int n, char **arguments) { count = n; words = arguments; }
inline bool ok() { return published < 200; }
inline bool shutdown() { return true; }
struct SensorDataQoS {};
template <class M> struct Publisher {
    void publish(const M &message)
    {
        published++;
        for (const auto &pose : message.poses)
            std::printf("%s %f %f\\n", message.header.frame_id.c_str(), pose.position.x,
                        pose.position.y);
    }
};
inline std::string word(const std::string &name)
{
    for (int k = 1; k + 1 < count; k += 2)
        if (words[k] == name) return words[k + 1];
    return "";
}
class Node {
public:
    explicit Node(const std::string &) {}
    template <class T> T declare_parameter(const std::string &name, const T &otherwise)
    {
        const std::string told = word(name);
        if (told.empty()) return otherwise;
        if constexpr (std::is_same_v<T, std::string>) return told;
        else return std::atoi(told.c_str());
    }
    template <class M>
    std::shared_ptr<Publisher<M>> create_publisher(const std::string &, SensorDataQoS)
    {
        return std::make_shared<Publisher<M>>();
    }
    int now() { return 0; }
};
}
"""
POSES = """
#pragma once
#include <string>
#include <vector>
namespace geometry_msgs::msg {
struct Pose {
    struct { double x, y, z; } position;
    struct { double x, y, z, w; } orientation;
};
struct PoseArray {
    struct { int stamp; std::string frame_id; } header;
    std::vector<Pose> poses;
};
}
"""


@pytest.mark.skipif(
    shutil.which("g++") is None or not sys.platform.startswith("linux"),
    reason="no C++ compiler for Linux is there",
)
def test_a_rig_at_a_udp_port_is_published(tmp_path):
    sensor = tx.Sensor.grid(4, 4, dtype=np.float32, divisions=(16, 16))
    step = tx.make_step(sensor, "source", "around_contacts", contacts=1, grid=8)
    folder = tmp_path / "step"
    tx.step.compile(step, folder)
    for name, text in (
        ("rclcpp/rclcpp.hpp", RCLCPP),
        ("geometry_msgs/msg/pose_array.hpp", POSES),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    node = tmp_path / "node"
    command = ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", folder / "ros2_node.cpp"]
    command += [f"-I{tmp_path}", f"-I{folder}", f"-L{folder}", "-l:libtomojax_step.a"]
    subprocess.run([*command, "-lm", "-o", node], check=True)
    place = [0.03, 0.02]
    volts = np.asarray(tx.voltages(sensor, tx.Disc(place, 0.005, 0.5)))
    write_scene(tmp_path / "scene.npz", volts[None], 1.0)
    with VirtualRig(tmp_path / "scene.npz", rate=500, link="udp", loss=0.02) as rig:
        port = rig.where.rsplit(":", 1)[1]
        words = "tables", folder / "step.tables", "port", port
        done = subprocess.run(
            [node, *words], capture_output=True, text=True, check=True, timeout=20
        )
    rows = [line.split() for line in done.stdout.splitlines()]
    assert len(rows) > 150 and {row[0] for row in rows} == {"sheet"}
    away = np.linalg.norm(np.array([row[1:] for row in rows], float) - place, axis=1)
    assert np.median(away) < 0.01  # half the distance of electrodes
    wrong = subprocess.run(
        [node, "tables", node], capture_output=True, text=True, check=False, timeout=20
    )
    assert wrong.returncode == 2 and "another kind of file" in wrong.stderr
