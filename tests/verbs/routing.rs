//! Lines of tendons in rows of offsets.

#![cfg(feature = "cli")]

use crate::desk::Desk;
use crate::tool::USAGE;

const ARM: &str = "\
[rod]
length_m = 0.2
elements = 10
[rod.material]
youngs_modulus_pa = 5e5
poisson_ratio = 0.4
density_kg_m3 = 1070.0
[rod.section]
radius_m = 0.013
[gravity]
acceleration_m_s2 = [0.0, 9.81, 0.0]
[time]
end_s = 0.5
";

/// Returns where the tip rests under tendons of 3 N.
fn tip(tendons: &str) -> Vec<f64> {
    let text = format!("{ARM}{}", tendons.replace("{T}", "pretension_n = 3.0"));
    let found = Desk::holding(&text).done("equilibrium arm.toml");
    (found["tip"]["position_m"].as_array().unwrap().iter())
        .map(|x| x.as_f64().unwrap())
        .collect()
}

fn apart(a: &[f64], b: &[f64]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

/// A line that jumps is that of two tendons with the same tension, one to the place and one from it on; rows of one place are that place, rows
/// at the ends a line that converges, and rows of a helix approach the helix.
#[test]
fn rows_are_the_lines_that_they_say() {
    let jump = tip(
        "[[tendon]]\n{T}\noffset_m = [[0.0, 0.012, 0.0], [0.57, 0.012, 0.0], [0.57, 0.006, 0.002], [1.0, 0.006, 0.002]]\n",
    );
    let two = tip(
        "[[tendon]]\n{T}\noffset_m = [0.012, 0.0]\nto = 0.57\n[[tendon]]\n{T}\noffset_m = [0.006, 0.002]\nfrom = 0.57\n",
    );
    assert!(apart(&jump, &two) < 1e-9, "{jump:?} {two:?}");

    let same = tip("[[tendon]]\n{T}\noffset_m = [[0.2, 0.01, 0.0], [0.6, 0.01, 0.0]]\n");
    assert!(apart(&same, &tip("[[tendon]]\n{T}\noffset_m = [0.01, 0.0]\n")) < 1e-9);

    let linear = tip("[[tendon]]\n{T}\noffset_m = [[0.0, 0.01, 0.0], [1.0, 0.004, 0.003]]\n");
    let to = tip("[[tendon]]\n{T}\noffset_m = [0.01, 0.0]\noffset_to_m = [0.004, 0.003]\n");
    assert!(apart(&linear, &to) < 1e-9);

    let helix = tip("[[tendon]]\n{T}\noffset_m = [0.01, 0.0]\nturns = 0.5\n");
    let off = |n: usize| {
        let rows: Vec<String> = (0..=n)
            .map(|i| {
                let part = i as f64 / n as f64;
                let (sin, cos) = (std::f64::consts::PI * part).sin_cos();
                format!("[{part}, {}, {}]", 0.01 * cos, 0.01 * sin)
            })
            .collect();
        apart(
            &tip(&format!(
                "[[tendon]]\n{{T}}\noffset_m = [{}]\n",
                rows.join(", ")
            )),
            &helix,
        )
    };
    let (coarse, fine) = (off(10), off(40));
    assert!(fine < 0.15 * coarse && fine < 2e-4, "{coarse:e} {fine:e}");
}

/// Rows that fall, a single row, and an offset at the end beside rows are refused where they stand.
#[test]
fn rows_that_are_no_line_are_refused() {
    for (tendon, word) in [
        (
            "offset_m = [[0.5, 0.01, 0.0], [0.2, 0.01, 0.0]]",
            "increasing",
        ),
        ("offset_m = [[0.5, 0.01, 0.0]]", "increasing"),
        (
            "offset_m = [[0.0, 0.01, 0.0], [1.0, 0.01, 0.0]]\noffset_to_m = [0.0, 0.0]",
            "offset_to_m",
        ),
        ("offset_m = [0.0, 0.01, 0.0, 1.0]", "rows"),
        (
            "offset_m = [[0.0, 0.01, 0.0], [150.0, 0.01, 0.0], [200.0, 0.005, 0.0]]",
            "150 is no fraction of the length",
        ),
        (
            "offset_m = [[-0.1, 0.01, 0.0], [1.0, 0.01, 0.0]]",
            "-0.1 is no fraction of the length",
        ),
    ] {
        let desk = Desk::holding(&format!("{ARM}[[tendon]]\n{tendon}\npretension_n = 1.0\n"));
        let (code, _, talk) = desk.run("check arm.toml");
        assert_eq!(code, USAGE, "{tendon}: {talk}");
        assert!(
            talk.contains(word) && talk.contains("tendon"),
            "{tendon}: {talk}"
        );
    }
}

/// Disks are at most as far from one another as the tendon is long in the arm, from where it begins to where it ends.
#[test]
fn disks_farther_apart_than_a_tendon_is_long_are_refused() {
    let check = |keys: &str| {
        let text = format!("{ARM}[[tendon]]\noffset_m = [0.01, 0.0]\npretension_n = 1.0\n{keys}\n");
        let (code, _, talk) = Desk::holding(&text).run("check arm.toml");
        (code == USAGE, talk)
    };
    for (keys, refused) in [
        ("disk_spacing_m = 0.4", true),
        ("disk_spacing_m = 0.2", false),
        ("disk_spacing_m = 0.15\nfrom = 0.4", true),
        ("disk_spacing_m = 0.12\nfrom = 0.4", false),
        ("disk_spacing_m = 0.11\nfrom = 0.2\nto = 0.7", true),
    ] {
        let (is_refused, talk) = check(keys);
        assert_eq!(is_refused, refused, "{keys}: {talk}");
        assert!(
            !refused || talk.contains("tendon.0.disk_spacing_m"),
            "{talk}"
        );
    }
}
