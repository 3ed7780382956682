//! Programs in C and C++ against the header and the library: a loop, and what goes wrong.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Returns the folder of the library that the tests were built with: their own.
fn built() -> PathBuf {
    let own = std::env::current_exe().expect("a test has a path");
    own.parent().expect("a folder").to_path_buf()
}

/// Compiles a program, and runs it with arguments; `None` on a machine without the compiler. That of C is there where Rust has its linker.
fn run(compiler: &str, source: &Path, args: &[&str]) -> Option<Output> {
    let folder = tempfile::tempdir().expect("a folder");
    let program = folder.path().join("program");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let made = Command::new(compiler)
        .args(["-Wall", "-Wextra", "-Werror", "-pedantic", "-O1"])
        .arg(source)
        .arg(format!("-I{}", root.join("include").display()))
        .arg(format!("-L{}", built().display()))
        .arg(format!("-Wl,-rpath,{}", built().display()))
        .args(["-lsoftarm_c", "-lm", "-lpthread", "-o"])
        .arg(&program)
        .output();
    let made = match made {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            eprintln!("skipped: no {compiler}");
            return None;
        }
        made => made.expect("a compiler runs"),
    };
    let words = String::from_utf8_lossy(&made.stderr);
    assert!(made.status.success(), "{compiler}: {words}");
    let ran = Command::new(&program).args(args).output();
    Some(ran.expect("the program runs"))
}

fn example() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/loop.c")
}

/// The loop of the example keeps the tip on its circle as well as the loop of the verb does, whose plant is the same arm, and says of a scene without
/// a loop what it lacks.
#[test]
fn the_example_closes_a_loop() {
    let Some(out) = run("cc", &example(), &["mpc-track-circle", "4.0"]) else {
        return;
    };
    let words = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(
        out.status.success(),
        "{words}{}",
        String::from_utf8_lossy(&out.stderr)
    );
    assert!(
        words.contains(" 0 fall-backs; controls: tip force x = "),
        "{words}"
    );
    let error = words
        .split("root mean square: ")
        .nth(1)
        .and_then(|own| own.split(' ').next())
        .and_then(|own| own.parse::<f64>().ok());
    assert!(error.is_some_and(|error| error < 1e-3), "{words}");

    let Some(out) = run("cc", &example(), &["reach"]) else {
        return;
    };
    let words = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(
        !out.status.success() && words.contains("new: code -1") && words.contains("mpc"),
        "{words}"
    );
}

/// Compiles a program in C++, which prints that all is as it should be, or the line where it is not.
fn passes(program: &str) {
    let folder = tempfile::tempdir().expect("a folder");
    let source = folder.path().join("program.cpp");
    std::fs::write(&source, program).expect("a file");
    let Some(out) = run("c++", &source, &[]) else {
        return;
    };
    let words = String::from_utf8_lossy(&out.stdout).into_owned();
    let errors = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{words}{errors}");
    let last = words.lines().last();
    assert_eq!(last, Some("all is as it should be"), "{words}");
}

/// Tendons: names, whole efforts, refused measurements, faults of the call, and a thread that asks for what acts while the loop works.
#[test]
fn calls_that_are_wrong_are_codes_and_texts() {
    passes(WRONG);
}

/// The messages of the node of ROS 2, with types that have the fields of its own: poses there and back, a path, a command, and what diagnostics say;
/// a loop closes through them.
#[test]
fn messages_of_ros_2_carry_a_loop() {
    let header = example().with_file_name("ros2").join("conversion.hpp");
    passes(&format!("#include \"{}\"\n{MESSAGES}", header.display()));
}

const MESSAGES: &str = r#"
#include <cstdio>
#include <cstring>
#include <limits>

struct Point { double x = 0, y = 0, z = 0; };
struct Quaternion { double x = 0, y = 0, z = 0, w = 1; };
struct Pose { Point position; Quaternion orientation; };
struct PoseArray { std::vector<Pose> poses; };
struct Stamp { int sec = 0; unsigned nanosec = 0; };
struct Header { Stamp stamp; };
struct PoseStamped { Header header; Pose pose; };
struct Path { std::vector<PoseStamped> poses; };
struct JointState { std::vector<std::string> name; std::vector<double> effort; };
struct Status { unsigned char level = 9; std::string name, message; };

// A locale whose numbers have a decimal comma.
struct Comma : std::numpunct<char> {
    char do_decimal_point() const override { return ','; }
};

#define EXPECT(truth) \
    do { if (!(truth)) { std::printf("line %d: %s; %s\n", __LINE__, #truth, softarm_text()); return 1; } } while (0)

int main() {
    using namespace softarm_ros;
    std::locale::global(std::locale(std::locale::classic(), new Comma));
    // Turns about all kinds of axes, by any angle, of quaternions of any length, there and back.
    for (int i = 0; i < 2000; i++) {
        Quaternion q;
        q.w = std::sin(1.0 + 3.1 * i);
        q.x = std::sin(2.0 + 1.7 * i);
        q.y = std::cos(0.3 * i) * (i % 7 != 0);
        q.z = std::sin(0.9 * i * i) * (i % 5 != 0);
        double rows[9], again[9];
        rotation_of(q, rows);
        for (int a = 0; a < 3; a++) {
            for (int b = 0; b < 3; b++) {
                double dot = 0;
                for (int c = 0; c < 3; c++) dot += rows[3 * a + c] * rows[3 * b + c];
                EXPECT(std::fabs(dot - (a == b)) < 1e-12);
            }
        }
        const Quaternion back = quaternion_of<Quaternion>(rows);
        const double size = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
        EXPECT(back.w >= 0 && std::fabs(std::fabs(back.w * q.w + back.x * q.x + back.y * q.y + back.z * q.z) / size - 1) < 1e-12);
        rotation_of(back, again);
        for (int a = 0; a < 9; a++) EXPECT(std::fabs(rows[a] - again[a]) < 1e-12);
    }
    // A quarter turn about z takes x to y.
    Quaternion quarter;
    quarter.z = quarter.w = std::sqrt(0.5);
    double rows[9];
    rotation_of(quarter, rows);
    EXPECT(std::fabs(rows[3] - 1) < 1e-12 && std::fabs(rows[1] + 1) < 1e-12);

    softarm_controller *controller = nullptr;
    softarm_plant *plant = nullptr;
    EXPECT(softarm_new("mpc-track-circle", nullptr, 0, &controller) == SOFTARM_OK);
    EXPECT(softarm_plant_new(controller, &plant) == SOFTARM_OK);
    softarm_description own;
    EXPECT(softarm_describe(controller, &own) == SOFTARM_OK);
    Arm arm(own.n_nodes), measured(own.n_nodes), known(own.n_nodes);
    PoseArray message;
    EXPECT(!take_poses(message, measured));
    JointState command;
    Status status;
    std::vector<double> values(own.n_controls);
    // Where the tip is to stay, in the place of the circle.
    Path path;
    path.poses.resize(2);
    path.poses[0].header.stamp.sec = 100;
    path.poses[1].header.stamp = {101, 500000000};
    for (auto &point : path.poses) point.pose.position = {0.1, 0.05, 0.98};
    std::string more = reference_of(path, 100.0);
    EXPECT(more.find("[1.5, 0.1") != std::string::npos);
    Path broken = path;
    broken.poses[0].pose.position.y = std::numeric_limits<double>::quiet_NaN();
    EXPECT(reference_of(broken, 100.0).find("[0, 0.10000000000000001, null, ") != std::string::npos);
    for (int k = 0; k < 300; k++) {
        softarm_measurement in{};
        EXPECT(softarm_plant_state(plant, &in.time_s, arm.x.data(), arm.r.data(), nullptr, nullptr) == SOFTARM_OK);
        put_poses(arm, message);
        EXPECT(take_poses(message, measured));
        in.positions = measured.x.data();
        in.rotations = measured.r.data();
        in.more = k == 0 ? more.c_str() : nullptr;
        put_diagnostics(softarm_step(controller, &in, nullptr), status);
        EXPECT(status.level == 0 && status.message.empty() && status.name == "softarm");
        EXPECT(softarm_acting(controller, in.time_s, values.data()) == SOFTARM_OK);
        EXPECT(softarm_plant_step(plant, controller, own.period_s) == SOFTARM_OK);
    }
    put_command(own, values, command);
    EXPECT(command.name.size() == own.n_controls && command.effort == values && command.name[0] == "tip force x");
    EXPECT(softarm_state(controller, nullptr, known.x.data(), known.r.data(), nullptr, nullptr) == SOFTARM_OK);
    const double *tip = &known.x[3 * (own.n_nodes - 1)];
    const double off = std::hypot(std::hypot(tip[0] - 0.1, tip[1] - 0.05), tip[2] - 0.98);
    if (!(off < 5e-3)) std::printf("%g\n", off);
    EXPECT(off < 5e-3);
    put_diagnostics(SOFTARM_FALLBACK, status);
    EXPECT(status.level == 2);
    softarm_plant_free(plant);
    softarm_free(controller);
    std::puts("all is as it should be");
    return 0;
}
"#;

const WRONG: &str = r#"
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <thread>
#include <vector>

#include "softarm.h"

#define EXPECT(truth) \
    do { if (!(truth)) { std::printf("line %d: %s; %s\n", __LINE__, #truth, softarm_text()); return 1; } } while (0)

int main() {
    softarm_controller *controller = nullptr;
    EXPECT(softarm_new(nullptr, nullptr, 0, &controller) == SOFTARM_ARGUMENT && std::strstr(softarm_text(), "scene is NULL"));
    EXPECT(softarm_new("mpc-tendons", nullptr, 0, nullptr) == SOFTARM_ARGUMENT);
    EXPECT(softarm_new("no-such-scene", nullptr, 0, &controller) == SOFTARM_SCENE && controller == nullptr);
    const char *wrong[] = {"rod.elements=-3"};
    EXPECT(softarm_new("mpc-tendons", wrong, 1, &controller) == SOFTARM_SCENE && std::strstr(softarm_text(), "rod.elements"));
    const char *overrides[] = {"rod.elements=6", "tendon.0.pretension_n=0.2"};
    EXPECT(softarm_new("mpc-tendons", overrides, 2, &controller) == SOFTARM_OK);
    softarm_description own;
    EXPECT(softarm_describe(controller, &own) == SOFTARM_OK);
    EXPECT(own.n_nodes == 7 && own.places[6] == 1.0 && own.n_controls >= 3);
    EXPECT(std::strcmp(own.units[0], "N") == 0 && std::strlen(own.names[0]) > 0 && own.hello[0] == '{');
    std::vector<double> values(own.n_controls), x(3 * 7), r(9 * 7), v(3 * 7), w(3 * 7);
    EXPECT(softarm_acting(controller, 0.0, values.data()) == SOFTARM_OK && std::fabs(values[0] - 0.2) < 1e-12);
    EXPECT(softarm_acting(controller, NAN, values.data()) == SOFTARM_ARGUMENT);
    EXPECT(softarm_acting(nullptr, 0.0, values.data()) == SOFTARM_ARGUMENT);

    softarm_plant *plant = nullptr;
    EXPECT(softarm_plant_new(controller, &plant) == SOFTARM_OK);
    EXPECT(softarm_plant_step(plant, controller, -1.0) == SOFTARM_ARGUMENT);
    std::atomic<bool> ends{false};
    std::atomic<long> asked{0};
    std::thread actuators([&] {
        std::vector<double> now(own.n_controls);
        while (!ends) {
            double time = 0.0;
            softarm_acting(controller, time, now.data());
            asked += now[0] >= 0.0;
        }
    });
    softarm_measurement measured = {};
    const char *answer = nullptr;
    for (int k = 0; k < 20; k++) {
        EXPECT(softarm_plant_state(plant, &measured.time_s, x.data(), r.data(), v.data(), w.data()) == SOFTARM_OK);
        measured.positions = x.data();
        measured.rotations = r.data();
        measured.velocities = v.data();
        measured.angular_velocities = w.data();
        EXPECT(softarm_step(controller, &measured, &answer) >= 0 && std::strstr(answer, "\"efforts\""));
        EXPECT(softarm_plant_step(plant, controller, own.period_s) == SOFTARM_OK);
    }
    ends = true;
    actuators.join();
    EXPECT(asked > 0);
    double time = 0.0;
    std::vector<double> known(3 * 7);
    EXPECT(softarm_state(controller, &time, known.data(), nullptr, nullptr, nullptr) == SOFTARM_OK);
    EXPECT(time <= 19 * own.period_s + 1e-9 && time > 15 * own.period_s && std::fabs(known[20] - x[20]) < 1e-2);

    // A measurement that cannot be costs its sample, and a call that is wrong none.
    x[3] = NAN;
    measured.time_s = NAN;
    EXPECT(softarm_step(controller, &measured, nullptr) > 0 && std::strlen(softarm_text()) > 0);
    measured.more = "not JSON";
    EXPECT(softarm_step(controller, &measured, nullptr) == SOFTARM_ARGUMENT && std::strstr(softarm_text(), "JSON"));
    measured.more = "{\"no_such_field\": 1}";
    EXPECT(softarm_step(controller, &measured, nullptr) == SOFTARM_ARGUMENT && std::strstr(softarm_text(), "no_such_field"));
    EXPECT(softarm_step(controller, nullptr, nullptr) == SOFTARM_ARGUMENT);
    softarm_plant_free(plant);
    softarm_free(controller);
    softarm_free(nullptr);
    std::puts("all is as it should be");
    return 0;
}
"#;
