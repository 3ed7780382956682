//! `softarm report DIR...`: writes the page of a result again from its files, or one page that compares several results.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::console::Console;
use super::error::CliError;
use super::{Global, Outcome, exit};
use crate::output::replace::{Own, Writer};
use crate::output::summary::{SCHEMA_VERSION, TOOL};
use crate::output::{
    Compared, ComparisonTable, ResultKind, compare, render_comparison, render_report,
};
use crate::solve::{SavedPage, saved_page};
use crate::tradeoff::page::{SavedTradeoff, tradeoff_comparison, tradeoff_tables};

/// Arguments of `report`.
#[derive(Debug, Args)]
pub(super) struct ReportArguments {
    /// Result directories of one verb: for one, its report.html is written again; several are compared on one page
    #[arg(value_name = "DIR", required = true)]
    directories: Vec<PathBuf>,
    /// File of the page [default: DIR/report.html; comparison.html for several]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Allow this file to be replaced although it is not a page of softarm
    #[arg(long, value_name = "FILE", num_args = 1)]
    force: Vec<PathBuf>,
}

/// Output of `--json`.
#[derive(Serialize)]
struct Summary {
    schema_version: u32,
    tool: &'static str,
    command: &'static str,
    /// The directories, in their order.
    directories: Vec<String>,
    /// Path of the page.
    report: String,
    /// Differences between several results.
    differences: Vec<ComparisonTable>,
}

pub(super) fn run(arguments: &ReportArguments, global: &Global, console: &Console) -> Outcome {
    console.catch_interrupts();
    if let Some(key) = global.set.first() {
        return Err(CliError::Directory(format!(
            "--set {key}: a report shows a result as it is; solve or simulate with --set, and report on that"
        )));
    }
    let stop = console.stop_signal(None);
    let directories = &arguments.directories;
    let mut results = Vec::new();
    for directory in directories {
        results.push(ResultKind::read(directory)?);
    }
    of_one_verb(directories, &results)?;
    let own = match &directories[..] {
        [directory] => directory.join("report.html"),
        _ => "comparison.html".into(),
    };
    let path = arguments.out.clone().unwrap_or(own);
    let writer = Writer::forcing(&arguments.force);
    writer.permit(&path, Own::Page)?;
    let (page, differences) = if results[0].0 == ResultKind::Tradeoff {
        of_tradeoffs(directories, results)?
    } else {
        let pages = (directories.iter())
            .map(|directory| saved_page(directory, &stop))
            .collect::<Result<Vec<_>, _>>()?;
        if let [page] = &pages[..] {
            (render_report(&page.data), Vec::new())
        } else {
            let data = comparison(directories, pages);
            (render_comparison(&data), data.tables)
        }
    };
    writer.write(&path, Own::Page, &page)?;
    for table in &differences {
        let n = table.rows.len();
        console.say(&format!("{}: {n} differ", table.title.to_lowercase()));
    }
    console.say(&format!("report: {}", path.display()));
    console.summary(&Summary {
        schema_version: SCHEMA_VERSION,
        tool: TOOL,
        command: "report",
        directories: (directories.iter())
            .map(|directory| directory.display().to_string())
            .collect(),
        report: path.display().to_string(),
        differences,
    });
    Ok(exit::DONE)
}

/// Refuses results of several verbs.
fn of_one_verb(
    directories: &[PathBuf],
    results: &[(ResultKind, serde_json::Value)],
) -> Result<(), CliError> {
    let first = results[0].0;
    match results.iter().position(|(kind, _)| *kind != first) {
        None => Ok(()),
        Some(other) => Err(CliError::Directory(format!(
            "{} holds a {}, and {} a {}: only results of one verb can be compared",
            directories[0].display(),
            first.command(),
            directories[other].display(),
            results[other].0.command()
        ))),
    }
}

/// Returns the page of a trade-off, or of several whose errors have the same meaning.
fn of_tradeoffs(
    directories: &[PathBuf],
    results: Vec<(ResultKind, serde_json::Value)>,
) -> Result<(String, Vec<ComparisonTable>), CliError> {
    let mut saved = Vec::new();
    for (directory, (_, summary)) in directories.iter().zip(results) {
        saved.push(SavedTradeoff::read(directory, summary)?);
    }
    if let [only] = &saved[..] {
        return Ok((only.page()?, Vec::new()));
    }
    let subject = saved[0].found.subject;
    if let Some(other) = saved.iter().position(|s| s.found.subject != subject) {
        return Err(CliError::Directory(format!(
            "{} holds a tradeoff of {}, and {} one of {}: their times and errors mean different things",
            directories[0].display(),
            subject.words(),
            directories[other].display(),
            saved[other].found.subject.words()
        )));
    }
    let page = tradeoff_comparison(&names(directories), &saved)?;
    Ok((page, tradeoff_tables(&saved)))
}

/// Returns the comparison of several results.
fn comparison(directories: &[PathBuf], pages: Vec<SavedPage>) -> crate::output::ComparisonData {
    let command = pages[0].data.command;
    let results = (names(directories).into_iter().zip(pages))
        .map(|(name, page)| Compared {
            name,
            summary: page.summary,
            scene: page.scene,
            data: page.data,
        })
        .collect();
    compare(command, results)
}

/// Returns the last part of every path, or the whole path if two end alike; a directory that is named twice gets a number.
fn names(directories: &[PathBuf]) -> Vec<String> {
    let last = |path: &Path| {
        let name = path.file_name().unwrap_or(path.as_os_str());
        name.to_string_lossy().into_owned()
    };
    let short: Vec<String> = directories.iter().map(|path| last(path)).collect();
    let alike = |names: &[String], i: usize| names.iter().filter(|n| **n == names[i]).count() > 1;
    let full: Vec<String> = (directories.iter().enumerate())
        .map(|(i, path)| match alike(&short, i) {
            true => path.display().to_string(),
            false => short[i].clone(),
        })
        .collect();
    (0..full.len())
        .map(|i| match alike(&full, i) {
            true => format!("{} ({})", full[i], i + 1),
            false => full[i].clone(),
        })
        .collect()
}
