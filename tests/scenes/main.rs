//! Scenes as a user writes them: keys, errors, choices that are left open, and what the documents say of them.

#[cfg(feature = "cli")]
#[path = "../tool/mod.rs"]
mod tool;

mod accuracy;
mod documents;
mod errors_name_keys;
mod first_arms;
mod fuzz;
mod robots;
mod rows;
mod scene_errors;
mod scene_keys;
mod scene_paths;
mod typed_in;
