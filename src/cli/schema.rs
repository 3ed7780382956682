//! `softarm schema`: prints the JSON Schema of the scene file.

use super::console::Console;
use super::{Outcome, exit};
use crate::scene::Scene;

pub(super) fn run(console: &Console) -> Outcome {
    let schema = Scene::schema();
    console.print(&serde_json::to_string_pretty(&schema).unwrap_or_default());
    Ok(exit::DONE)
}
