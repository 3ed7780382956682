//! Programs in C and C++ against the header and the library: a loop, and what goes wrong.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Returns the folder of the library that the tests were built with: their own.
fn built() -> PathBuf {
    let own = std::env::current_exe().expect("a test has a path");
    own.parent().expect("a folder").to_path_buf()
}

/// Compiles a program, and runs it with arguments.
fn run(compiler: &str, source: &Path, args: &[&str]) -> Output {
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
        .output()
        .expect("a compiler of C is there, as the linker of Rust");
    let words = String::from_utf8_lossy(&made.stderr);
    assert!(made.status.success(), "{compiler}: {words}");
    Command::new(&program)
        .args(args)
        .output()
        .expect("the program runs")
}

fn example() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/loop.c")
}

/// The loop of the example keeps the tip on its circle as well as the loop of the verb does, whose plant is the same arm, and says of a scene without
/// a loop what it lacks.
#[test]
fn the_example_closes_a_loop() {
    let out = run("cc", &example(), &["mpc-track-circle", "4.0"]);
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

    let out = run("cc", &example(), &["reach"]);
    let words = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(
        !out.status.success() && words.contains("new: code -1") && words.contains("mpc"),
        "{words}"
    );
}

/// Tendons: names, whole efforts, refused measurements, faults of the call, and a thread that asks for what acts while the loop works.
#[test]
fn calls_that_are_wrong_are_codes_and_texts() {
    let folder = tempfile::tempdir().expect("a folder");
    let source = folder.path().join("wrong.cpp");
    std::fs::write(&source, WRONG).expect("a file");
    let out = run("c++", &source, &[]);
    let words = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(
        out.status.success(),
        "{words}{}",
        String::from_utf8_lossy(&out.stderr)
    );
    assert_eq!(
        words.lines().last(),
        Some("all is as it should be"),
        "{words}"
    );
}

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
