// Messages of ROS 2 to and from the numbers of softarm.h. The types of messages are parameters, so that this file is tested without ROS.
#pragma once

#include <cmath>
#include <locale>
#include <sstream>
#include <string>
#include <vector>

#include "softarm.h"

namespace softarm_ros {

// Poses and velocities of the nodes of an arm, from base to tip.
struct Arm {
    explicit Arm(std::size_t n) : x(3 * n), r(9 * n), v(3 * n), w(3 * n) {}
    std::vector<double> x, r, v, w;
};

// Writes the rotation of a quaternion row by row. A quaternion of another norm is a rotation all the same; one of no length is none, NAN, which the
// controller refuses.
template <class Quaternion>
void rotation_of(const Quaternion &q, double *rows) {
    const double norm = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    const double w = q.w / norm, x = q.x / norm, y = q.y / norm, z = q.z / norm;
    const double all[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z),
                           2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
    for (int i = 0; i < 9; i++) rows[i] = all[i];
}

// Returns the quaternion of a rotation, with w not negative.
template <class Quaternion>
Quaternion quaternion_of(const double *rows) {
    const double m[4] = {rows[0] + rows[4] + rows[8], rows[0] - rows[4] - rows[8], rows[4] - rows[0] - rows[8], rows[8] - rows[0] - rows[4]};
    int largest = 0;
    for (int i = 1; i < 4; i++) {
        if (m[i] > m[largest]) largest = i;
    }
    // w, x, y, z times four times the largest of them.
    const double sums[4][4] = {{1 + m[0], rows[7] - rows[5], rows[2] - rows[6], rows[3] - rows[1]},
                               {rows[7] - rows[5], 1 + m[1], rows[1] + rows[3], rows[2] + rows[6]},
                               {rows[2] - rows[6], rows[1] + rows[3], 1 + m[2], rows[5] + rows[7]},
                               {rows[3] - rows[1], rows[2] + rows[6], rows[5] + rows[7], 1 + m[3]}};
    const double *own = sums[largest];
    const double size = std::sqrt(own[0] * own[0] + own[1] * own[1] + own[2] * own[2] + own[3] * own[3]);
    const double sign = own[0] < 0 ? -1 / size : 1 / size;
    Quaternion q;
    q.w = sign * own[0];
    q.x = sign * own[1];
    q.y = sign * own[2];
    q.z = sign * own[3];
    return q;
}

// Takes the poses of all nodes from a geometry_msgs/PoseArray. Returns whether there are as many as the arm has nodes.
template <class PoseArray>
bool take_poses(const PoseArray &message, Arm &arm) {
    const std::size_t n = arm.x.size() / 3;
    if (message.poses.size() != n) return false;
    for (std::size_t q = 0; q < n; q++) {
        const auto &pose = message.poses[q];
        arm.x[3 * q] = pose.position.x;
        arm.x[3 * q + 1] = pose.position.y;
        arm.x[3 * q + 2] = pose.position.z;
        rotation_of(pose.orientation, &arm.r[9 * q]);
    }
    return true;
}

// Writes the poses of all nodes to a geometry_msgs/PoseArray.
template <class PoseArray>
void put_poses(const Arm &arm, PoseArray &message) {
    message.poses.resize(arm.x.size() / 3);
    for (std::size_t q = 0; q < message.poses.size(); q++) {
        auto &pose = message.poses[q];
        pose.position.x = arm.x[3 * q];
        pose.position.y = arm.x[3 * q + 1];
        pose.position.z = arm.x[3 * q + 2];
        pose.orientation = quaternion_of<decltype(pose.orientation)>(&arm.r[9 * q]);
    }
}

// Returns the field `reference_m` of a measurement for the points of a nav_msgs/Path, whose stamps count from the start of the loop at `start_s`. A
// number that is not finite becomes null, which the loop refuses; a decimal comma of the locale has no place in JSON.
template <class Path>
std::string reference_of(const Path &path, double start_s) {
    std::ostringstream out;
    out.imbue(std::locale::classic());
    out.precision(17);
    out << "{\"reference_m\": [";
    const char *comma = "";
    for (const auto &own : path.poses) {
        const double time = own.header.stamp.sec + 1e-9 * own.header.stamp.nanosec - start_s;
        const char *open = "[";
        out << comma;
        for (const double value : {time, double(own.pose.position.x), double(own.pose.position.y), double(own.pose.position.z)}) {
            out << open;
            if (std::isfinite(value)) out << value;
            else out << "null";
            open = ", ";
        }
        out << "]";
        comma = ", ";
    }
    out << "]}";
    return out.str();
}

// Writes the values of the controls to a sensor_msgs/JointState: names, and values as efforts, each in its unit.
template <class JointState>
void put_command(const softarm_description &description, const std::vector<double> &values, JointState &message) {
    message.name.assign(description.names, description.names + description.n_controls);
    message.effort = values;
}

// Writes what a step said to a diagnostic_msgs/DiagnosticStatus: OK (0), a warning (1) where the measurement was refused in part, an error (2) where
// the command is that of the fall-back or there is none.
template <class Status>
void put_diagnostics(int code, Status &status) {
    status.name = "softarm";
    status.level = code == SOFTARM_OK ? 0 : code == SOFTARM_REFUSED ? 1 : 2;
    status.message = code == SOFTARM_OK ? "" : softarm_text();
}

}  // namespace softarm_ros
