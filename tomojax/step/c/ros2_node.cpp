// A ROS 2 node: slots of a rig at a UDP port in, contacts out, by the step's library alone.
//
// In a package with ament_cmake, beside this folder's files:
//
//     find_package(rclcpp REQUIRED)
//     find_package(geometry_msgs REQUIRED)
//     add_subdirectory(step)  # this folder
//     add_executable(tomojax_node step/ros2_node.cpp)
//     ament_target_dependencies(tomojax_node rclcpp geometry_msgs)
//     target_link_libraries(tomojax_node tomojax_step)
//
//     ros2 run PACKAGE tomojax_node --ros-args -p tables:=step.tables -p host:=192.168.1.5
//
// It publishes `contacts` (geometry_msgs/PoseArray): a pose for each contact in the frame
// `sheet`, x and y in m. PROTOCOL.md describes the rig's messages.
#include <arpa/inet.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "geometry_msgs/msg/pose_array.hpp"
#include "rclcpp/rclcpp.hpp"
#include "tomojax_step.hpp"

namespace {

constexpr std::uint8_t SLOT = 0x01, DESCRIPTION = 0x02, START = 0x10, GROUNDS = 0x12;
constexpr std::size_t HEAD = 16, SIZE = HEAD + 2 * TOMOJAX_ELECTRODES + 4;

std::uint32_t crc(const std::uint8_t *bytes, std::size_t count)
{
    std::uint32_t value = 0xffffffffu;
    while (count-- > 0) {
        value ^= *bytes++;
        for (int bit = 0; bit < 8; bit++) value = value >> 1 ^ (value & 1 ? 0xedb88320u : 0);
    }
    return ~value;
}

template <class T> T get(const std::uint8_t *from)
{
    T value;  // the protocol is little-endian, as are ROS 2's machines
    std::memcpy(&value, from, sizeof value);
    return value;
}

// A rig's line: a socket that is connected to its port.
class Line {
public:
    Line(const std::string &host, int port)
    {
        sockaddr_in rig{};
        rig.sin_family = AF_INET;
        rig.sin_port = htons(std::uint16_t(port));
        const timeval patience{0, 250000};
        if (inet_pton(AF_INET, host.c_str(), &rig.sin_addr) != 1 ||
            connect(socket_, reinterpret_cast<sockaddr *>(&rig), sizeof rig) != 0)
            throw std::runtime_error(host + ": no such address");
        setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    }
    ~Line() { close(socket_); }
    Line(const Line &) = delete;
    Line &operator=(const Line &) = delete;

    void send(std::vector<std::uint8_t> message)
    {
        const std::uint32_t seal = crc(message.data(), message.size());
        for (int k = 0; k < 4; k++) message.push_back(std::uint8_t(seal >> 8 * k));
        ::send(socket_, message.data(), message.size(), 0);
    }
    // The next sound message; empty after a quarter of a second without one.
    std::vector<std::uint8_t> receive()
    {
        std::vector<std::uint8_t> message(SIZE + 64);
        const ssize_t size = recv(socket_, message.data(), message.size(), 0);
        message.resize(size > 0 ? std::size_t(size) : 0);
        const bool sound = message.size() > 4 &&
            get<std::uint32_t>(&message[message.size() - 4]) ==
                crc(message.data(), message.size() - 4);
        return sound ? message : std::vector<std::uint8_t>();
    }

private:
    int socket_ = socket(AF_INET, SOCK_DGRAM, 0);
};

class Contacts : public rclcpp::Node {
public:
    Contacts()
        : Node("tomojax"), tables_(declare_parameter<std::string>("tables", "step.tables")),
          step_(tables_), line_(declare_parameter<std::string>("host", "127.0.0.1"),
                                int(declare_parameter<int>("port", 5005))),
          out_(create_publisher<geometry_msgs::msg::PoseArray>(
              "contacts", rclcpp::SensorDataQoS()))
    {
    }

    void run()
    {
        line_.send({START, 1, 0, 0});
        while (rclcpp::ok()) {
            const auto message = line_.receive();
            if (message.empty())
                line_.send({START, 1, 0, 0});
            else if (message[0] == DESCRIPTION && message.size() == 40)
                describe(message.data());
            else if (message[0] == SLOT && message.size() == SIZE && scale_ != 0)
                slot(message.data());
        }
    }

private:
    void describe(const std::uint8_t *told)
    {
        if (get<std::uint16_t>(told + 2) != TOMOJAX_ELECTRODES)
            throw std::runtime_error("the rig has another number of electrodes");
        next_ = get<std::uint32_t>(told + 8);
        scale_ = get<double>(told + 20);
        offset_ = get<double>(told + 28);
    }

    void slot(const std::uint8_t *told)
    {
        const std::uint32_t lost = get<std::uint32_t>(told + 4) - next_;
        if (lost > 0x7fffffffu) return;  // it came late, or twice
        next_ += lost + 1;
        tomojax::Volts volts;
        for (int k = 0; k < TOMOJAX_ELECTRODES; k++)
            volts[k] = tomojax_real(scale_ * get<std::int16_t>(told + HEAD + 2 * k) + offset_);
        const tomojax_output &found = step_(volts, told[1], std::int32_t(lost));
        line_.send({GROUNDS, 1, 0, 0, std::uint8_t(found.next_condition)});
        geometry_msgs::msg::PoseArray poses;
        poses.header.stamp = now();
        poses.header.frame_id = "sheet";
        for (int k = 0; k < found.count; k++) {
            poses.poses.emplace_back();
            poses.poses.back().position.x = double(found.xy[k][0]);
            poses.poses.back().position.y = double(found.xy[k][1]);
            poses.poses.back().orientation.w = 1;
        }
        out_->publish(poses);
    }

    tomojax::Tables tables_;
    tomojax::Step step_;
    Line line_;
    std::shared_ptr<rclcpp::Publisher<geometry_msgs::msg::PoseArray>> out_;
    std::uint32_t next_ = 0;
    double scale_ = 0, offset_ = 0;
};

}  // namespace

int main(int count, char **arguments)
{
    rclcpp::init(count, arguments);
    try {
        Contacts().run();
    } catch (const std::exception &error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 2;
    }
    return rclcpp::shutdown() ? 0 : 1;
}
