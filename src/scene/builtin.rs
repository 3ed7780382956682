//! The built-in scenes.

/// Name and text of every built-in scene, the one to start with first.
const SCENES: [(&str, &str); 37] = [
    ("reach", include_str!("../../examples/scenes/reach.toml")),
    (
        "reach-tapered",
        include_str!("../../examples/scenes/reach-tapered.toml"),
    ),
    (
        "reach-3d",
        include_str!("../../examples/scenes/reach-3d.toml"),
    ),
    (
        "reach-obstacle",
        include_str!("../../examples/scenes/reach-obstacle.toml"),
    ),
    (
        "reach-table",
        include_str!("../../examples/scenes/reach-table.toml"),
    ),
    (
        "reach-tendons",
        include_str!("../../examples/scenes/reach-tendons.toml"),
    ),
    (
        "till-tendons",
        include_str!("../../examples/scenes/till-tendons.toml"),
    ),
    (
        "till-winch",
        include_str!("../../examples/scenes/till-winch.toml"),
    ),
    (
        "knode-tendons",
        include_str!("../../examples/scenes/knode-tendons.toml"),
    ),
    (
        "soromox-tendons",
        include_str!("../../examples/scenes/soromox-tendons.toml"),
    ),
    (
        "stiff-flop",
        include_str!("../../examples/scenes/stiff-flop.toml"),
    ),
    (
        "elastica-muscles",
        include_str!("../../examples/scenes/elastica-muscles.toml"),
    ),
    (
        "reach-guidewire",
        include_str!("../../examples/scenes/reach-guidewire.toml"),
    ),
    (
        "paper-arm",
        include_str!("../../examples/scenes/paper-arm.toml"),
    ),
    ("swing", include_str!("../../examples/scenes/swing.toml")),
    (
        "shaken-base",
        include_str!("../../examples/scenes/shaken-base.toml"),
    ),
    ("wire", include_str!("../../examples/scenes/wire.toml")),
    (
        "wire-reach",
        include_str!("../../examples/scenes/wire-reach.toml"),
    ),
    (
        "paper-flying-beam",
        include_str!("../../examples/scenes/paper-flying-beam.toml"),
    ),
    (
        "paper-stretching",
        include_str!("../../examples/scenes/paper-stretching.toml"),
    ),
    (
        "paper-bending-stretching",
        include_str!("../../examples/scenes/paper-bending-stretching.toml"),
    ),
    (
        "paper-convergence",
        include_str!("../../examples/scenes/paper-convergence.toml"),
    ),
    (
        "mpc-track-circle",
        include_str!("../../examples/scenes/mpc-track-circle.toml"),
    ),
    (
        "mpc-tendons",
        include_str!("../../examples/scenes/mpc-tendons.toml"),
    ),
    (
        "mpc-guidewire",
        include_str!("../../examples/scenes/mpc-guidewire.toml"),
    ),
    (
        "mpc-stiff-flop",
        include_str!("../../examples/scenes/mpc-stiff-flop.toml"),
    ),
    (
        "mpc-knode",
        include_str!("../../examples/scenes/mpc-knode.toml"),
    ),
    (
        "mpc-reach",
        include_str!("../../examples/scenes/mpc-reach.toml"),
    ),
    (
        "mpc-push",
        include_str!("../../examples/scenes/mpc-push.toml"),
    ),
    (
        "mpc-payload",
        include_str!("../../examples/scenes/mpc-payload.toml"),
    ),
    (
        "mpc-delay",
        include_str!("../../examples/scenes/mpc-delay.toml"),
    ),
    (
        "mpc-catch",
        include_str!("../../examples/scenes/mpc-catch.toml"),
    ),
    (
        "mpc-obstacle",
        include_str!("../../examples/scenes/mpc-obstacle.toml"),
    ),
    (
        "mpc-elastica-case1",
        include_str!("../../examples/scenes/mpc-elastica-case1.toml"),
    ),
    (
        "mpc-elastica-case2",
        include_str!("../../examples/scenes/mpc-elastica-case2.toml"),
    ),
    (
        "mpc-elastica-case3",
        include_str!("../../examples/scenes/mpc-elastica-case3.toml"),
    ),
    (
        "mpc-elastica-case4",
        include_str!("../../examples/scenes/mpc-elastica-case4.toml"),
    ),
];

/// The names of the built-in scenes, the one to start with first.
pub fn names() -> impl Iterator<Item = &'static str> {
    SCENES.iter().map(|(name, _)| *name)
}

/// The commented text of a built-in scene.
pub fn text(name: &str) -> Option<&'static str> {
    SCENES
        .iter()
        .find(|(known, _)| *known == name)
        .map(|(_, text)| *text)
}
