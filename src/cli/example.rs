//! `softarm example [NAME]`: lists the built-in scenes, or prints one.

use super::console::Console;
use super::{Global, Outcome, exit};
use crate::scene::{Scene, builtin};

pub(super) fn run(name: Option<&str>, global: &Global, console: &Console) -> Outcome {
    match name {
        None if console.json() => {
            console.summary(&serde_json::json!({
                "schema_version": crate::output::summary::SCHEMA_VERSION,
                "command": "example",
                "scenes": builtin::names().collect::<Vec<_>>(),
            }));
        }
        None => {
            for name in builtin::names() {
                let first = builtin::text(name)
                    .and_then(|text| text.lines().next())
                    .unwrap_or_default();
                console.print(&format!("{name:16} {}", first.trim_start_matches("# ")));
            }
        }
        Some(name) => match builtin::text(name) {
            Some(text) if console.json() => console.summary(&serde_json::json!({
                "schema_version": crate::output::summary::SCHEMA_VERSION,
                "command": "example",
                "name": name,
                "scene": text,
            })),
            Some(text) => console.print(text.trim_end()),
            None => {
                // The loader knows the names and suggests the nearest one; a file of that name is not a built-in scene.
                let (_, source) = Scene::load(name, &global.set)?;
                return Err(source
                    .error_at(
                        "",
                        format!("`{name}` is a file, not a built-in scene"),
                        Some(format!("built-in scenes: {}", names())),
                    )
                    .into());
            }
        },
    }
    Ok(exit::DONE)
}

fn names() -> String {
    builtin::names().collect::<Vec<_>>().join(", ")
}
