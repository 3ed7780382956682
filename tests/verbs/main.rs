//! The program: its verbs, their files, exit codes, and how they end.

#[cfg(feature = "cli")]
#[path = "../tool/mod.rs"]
mod tool;

mod causes;
mod cli;
mod contact;
mod continued;
#[cfg(feature = "cli")]
mod desk;
mod doubt;
mod export;
mod files;
mod fit;
mod fit_results;
mod fluid;
mod friction;
mod hardware;
mod learned;
mod mpc_verb;
mod nearest;
mod outcomes;
mod report_verb;
mod routing;
mod stopping;
mod talking;
mod tradeoff;
