//! `softarm schema`: prints the JSON Schema of the scene file, or the reference that is made of it.

use super::console::Console;
use super::{Outcome, exit};
use crate::scene::Scene;

pub(super) fn run(as_markdown: bool, console: &Console) -> Outcome {
    if as_markdown {
        console.print(Scene::reference().trim_end());
    } else {
        let schema = Scene::schema();
        console.print(&serde_json::to_string_pretty(&schema).unwrap_or_default());
    }
    Ok(exit::DONE)
}
