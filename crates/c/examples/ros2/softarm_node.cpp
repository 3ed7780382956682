// A node of ROS 2 that closes the loop of a scene. README.md beside it says how it is built.
//
//   topic         type                               direction
//   poses         geometry_msgs/PoseArray            in: of all nodes of the model, from base to tip
//   path          nav_msgs/Path                      in: where the tip is to go, in the place of the scene's path
//   command       sensor_msgs/JointState             out: efforts that act, `actuators_hz` times a second
//   estimate      geometry_msgs/PoseArray            out: of all nodes, once a sample
//   diagnostics   diagnostic_msgs/DiagnosticArray    out: once a sample
//
// Parameters: `scene`, a file or the name of a built-in scene; `overrides`, a list of KEY=VALUE; `actuators_hz`.
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <geometry_msgs/msg/pose_array.hpp>
#include <nav_msgs/msg/path.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/joint_state.hpp>

#include "conversion.hpp"

class SoftarmNode : public rclcpp::Node {
public:
    SoftarmNode() : Node("softarm") {
        const auto scene = declare_parameter<std::string>("scene", "mpc-tendons");
        const auto overrides = declare_parameter<std::vector<std::string>>("overrides", std::vector<std::string>{});
        const double rate = declare_parameter<double>("actuators_hz", 500.0);
        std::vector<const char *> setters;
        for (const auto &own : overrides) setters.push_back(own.c_str());
        softarm_controller *made = nullptr;
        if (softarm_new(scene.c_str(), setters.data(), setters.size(), &made) != SOFTARM_OK) {
            throw std::runtime_error(softarm_text());
        }
        controller_.reset(made);
        softarm_describe(made, &description_);
        arm_ = std::make_unique<softarm_ros::Arm>(description_.n_nodes);
        estimate_ = std::make_unique<softarm_ros::Arm>(description_.n_nodes);
        values_.resize(description_.n_controls);

        command_ = create_publisher<sensor_msgs::msg::JointState>("command", 1);
        poses_ = create_publisher<geometry_msgs::msg::PoseArray>("estimate", 1);
        diagnostics_ = create_publisher<diagnostic_msgs::msg::DiagnosticArray>("diagnostics", 1);
        using std::placeholders::_1;
        samples_ = create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
        actuators_ = create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
        rclcpp::SubscriptionOptions in;
        in.callback_group = samples_;
        measured_ = create_subscription<geometry_msgs::msg::PoseArray>("poses", 1, std::bind(&SoftarmNode::measured, this, _1), in);
        path_ = create_subscription<nav_msgs::msg::Path>("path", 1, std::bind(&SoftarmNode::follow, this, _1), in);
        start_ = now().seconds();
        timer_ = create_wall_timer(std::chrono::duration<double>(description_.period_s), std::bind(&SoftarmNode::sample, this), samples_);
        // Asks for what acts while a sample is computed: softarm_acting() allows that.
        outlet_ = create_wall_timer(std::chrono::duration<double>(1.0 / rate), std::bind(&SoftarmNode::act, this), actuators_);
    }

private:
    void measured(const geometry_msgs::msg::PoseArray &message) {
        is_new_ = softarm_ros::take_poses(message, *arm_);
        if (!is_new_) RCLCPP_WARN(get_logger(), "%zu poses; the model has %zu nodes", message.poses.size(), description_.n_nodes);
    }

    void follow(const nav_msgs::msg::Path &message) { more_ = softarm_ros::reference_of(message, start_); }

    void sample() {
        softarm_measurement measurement{};
        measurement.time_s = now().seconds() - start_;
        if (is_new_) {
            measurement.positions = arm_->x.data();
            measurement.rotations = arm_->r.data();
        }
        measurement.more = more_.empty() ? nullptr : more_.c_str();
        const int code = softarm_step(controller_.get(), &measurement, nullptr);
        diagnostic_msgs::msg::DiagnosticArray said;
        said.header.stamp = now();
        said.status.resize(1);
        softarm_ros::put_diagnostics(code, said.status[0]);
        is_new_ = false;
        more_.clear();
        double time = 0.0;
        softarm_state(controller_.get(), &time, estimate_->x.data(), estimate_->r.data(), nullptr, nullptr);
        geometry_msgs::msg::PoseArray poses;
        poses.header.stamp = rclcpp::Time(static_cast<int64_t>(1e9 * (start_ + time)));
        softarm_ros::put_poses(*estimate_, poses);
        poses_->publish(poses);
        diagnostics_->publish(said);
    }

    void act() {
        if (softarm_acting(controller_.get(), now().seconds() - start_, values_.data()) != SOFTARM_OK) return;
        sensor_msgs::msg::JointState message;
        message.header.stamp = now();
        softarm_ros::put_command(description_, values_, message);
        command_->publish(message);
    }

    struct Free {
        void operator()(softarm_controller *own) const { softarm_free(own); }
    };
    std::unique_ptr<softarm_controller, Free> controller_;
    softarm_description description_{};
    std::unique_ptr<softarm_ros::Arm> arm_, estimate_;
    std::vector<double> values_;
    std::string more_;
    bool is_new_ = false;
    double start_ = 0.0;
    rclcpp::CallbackGroup::SharedPtr samples_, actuators_;
    rclcpp::Publisher<sensor_msgs::msg::JointState>::SharedPtr command_;
    rclcpp::Publisher<geometry_msgs::msg::PoseArray>::SharedPtr poses_;
    rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticArray>::SharedPtr diagnostics_;
    rclcpp::Subscription<geometry_msgs::msg::PoseArray>::SharedPtr measured_;
    rclcpp::Subscription<nav_msgs::msg::Path>::SharedPtr path_;
    rclcpp::TimerBase::SharedPtr timer_, outlet_;
};

int main(int argc, char **argv) {
    rclcpp::init(argc, argv);
    rclcpp::executors::MultiThreadedExecutor executor(rclcpp::ExecutorOptions(), 2);
    auto node = std::make_shared<SoftarmNode>();
    executor.add_node(node);
    executor.spin();
    rclcpp::shutdown();
    return 0;
}
