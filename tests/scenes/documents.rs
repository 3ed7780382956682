//! What the documents name exists, and what they show is read: paths, keys of a scene, worked scenes, criteria of the certificate.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use nalgebra::Vector3;
use softarm::mechanics::Material;
use softarm::scene::Scene;
use softarm::task::{Arm, Discretization, Task};

/// Most lines of the two documents that a newcomer reads first.
const LONGEST: [(&str, usize); 3] = [
    ("README.md", 200),
    ("ARCHITECTURE.md", 300),
    ("CHANGELOG.md", 40),
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(name: &str) -> String {
    fs::read_to_string(root().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// The documents of the top level, of `docs` and of its folders with pages, relative to the root.
fn documents() -> Vec<String> {
    let mut names: Vec<String> = [
        "README.md",
        "ARCHITECTURE.md",
        "CONTRIBUTING.md",
        "CHANGELOG.md",
    ]
    .map(String::from)
    .into();
    for folder in ["docs", "docs/tutorials", "docs/gallery", "docs/joss"] {
        for path in files(folder, "md") {
            let name = path.file_name().unwrap().to_str().unwrap();
            names.push(format!("{folder}/{name}"));
        }
    }
    names.sort();
    names
}

/// Text without its fenced blocks, and these blocks with their language.
fn split(text: &str) -> (String, Vec<(String, String)>) {
    let (mut prose, mut blocks) = (String::new(), Vec::new());
    let mut open: Option<(String, String)> = None;
    for line in text.lines() {
        match (&mut open, line.strip_prefix("```")) {
            (None, Some(language)) => open = Some((language.to_string(), String::new())),
            (Some(_), Some(_)) => blocks.extend(open.take()),
            (Some((_, block)), None) => *block += &format!("{line}\n"),
            (None, None) => prose += &format!("{line}\n"),
        }
    }
    assert!(open.is_none(), "a fenced block is not closed");
    (prose, blocks)
}

/// Targets of links, `[text](target)`.
fn links(prose: &str) -> Vec<&str> {
    prose
        .split("](")
        .skip(1)
        .filter_map(|rest| rest.split_once(')'))
        .map(|(target, _)| target)
        .collect()
}

/// Words between backticks.
fn code(prose: &str) -> Vec<&str> {
    prose.split('`').skip(1).step_by(2).collect()
}

/// The identifier of a heading in a link: lower case, words joined by hyphens, no punctuation.
fn anchor(heading: &str) -> String {
    let kept = heading
        .trim_start_matches('#')
        .trim()
        .chars()
        .filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    kept.collect::<String>().to_lowercase().replace(' ', "-")
}

/// Every link that is not to another site leads to a file, and to a heading in it where it names one.
#[test]
fn links_lead_somewhere() {
    for document in documents() {
        let folder = root().join(&document).parent().unwrap().to_path_buf();
        let (prose, _) = split(&read(&document));
        for link in links(&prose) {
            if link.contains("://") {
                continue;
            }
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let path = if file.is_empty() {
                root().join(&document)
            } else {
                folder.join(file)
            };
            assert!(path.exists(), "{document}: {link} leads nowhere");
            if !heading.is_empty() {
                let text = fs::read_to_string(&path).unwrap();
                let found = text
                    .lines()
                    .filter(|line| line.starts_with('#'))
                    .any(|line| anchor(line) == heading);
                assert!(found, "{document}: {link} has no such heading");
            }
        }
    }
}

/// Where a path in a document may begin: at the root, in `src`, or with the name of a package in `crates`, whose `src` is left out.
fn places(word: &str) -> [PathBuf; 3] {
    let (package, rest) = word.split_once('/').unwrap_or((word, ""));
    let in_package = root().join("crates").join(package).join("src").join(rest);
    [root().join(word), root().join("src").join(word), in_package]
}

/// Every path to a source file, and every folder of the repository, that a document names between backticks exists.
/// A name without a package is looked for everywhere in `src` and `crates`.
#[test]
fn paths_exist() {
    let mut sources = Vec::new();
    collect(&root().join("src"), &mut sources);
    collect(&root().join("crates"), &mut sources);
    let folders = [
        "src/",
        "crates/",
        "tests/",
        "examples/",
        "benches/",
        "docs/",
    ];
    for document in documents() {
        let (prose, _) = split(&read(&document));
        for word in code(&prose) {
            let is_plain = word
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || "._-/".contains(c));
            let is_source = word.ends_with(".rs");
            let is_folder = word.ends_with('/') && word.len() > 1;
            let is_inside = folders.iter().any(|folder| word.starts_with(folder));
            if !is_plain || !(is_source || is_folder || is_inside) {
                continue;
            }
            let exists = places(word).iter().any(|path| path.exists())
                || !is_inside && sources.iter().any(|path| path.ends_with(word));
            assert!(exists, "{document}: `{word}` does not exist");
        }
    }
}

/// Every source file under some folders of the repository, as text.
fn sources(folders: &[&str]) -> String {
    fn read_all(folder: &Path, text: &mut String) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                read_all(&path, text);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                *text += &fs::read_to_string(&path).unwrap();
            }
        }
    }
    let mut text = String::new();
    for folder in folders {
        read_all(&root().join(folder), &mut text);
    }
    text
}

/// The words of a text: runs of letters, digits and underscores.
fn words(text: &str) -> BTreeSet<&str> {
    text.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_'))
        .collect()
}

/// An item that a table names after a source file stands in that file.
#[test]
fn items_are_where_they_are_said_to_be() {
    let mut n_items = 0;
    for document in documents() {
        let (prose, _) = split(&read(&document));
        for row in prose.lines().filter(|line| line.starts_with('|')) {
            let mut file: Option<(&str, String)> = None;
            for word in code(row) {
                if word.ends_with(".rs") {
                    let path = places(word).into_iter().find(|path| path.exists());
                    file = path.map(|path| (word, fs::read_to_string(path).unwrap()));
                    continue;
                }
                let is_item = word
                    .chars()
                    .all(|c| c.is_ascii_alphanumeric() || "_:".contains(c));
                let Some((name, text)) = file.as_ref().filter(|_| is_item) else {
                    continue;
                };
                n_items += 1;
                let found = words(text);
                for part in word.split("::").filter(|part| !part.is_empty()) {
                    assert!(found.contains(part), "{document}: {name} has no `{word}`");
                }
            }
        }
    }
    assert!(n_items > 50, "only {n_items} items were found");
}

/// A long name in lower case, such as that of a test, stands somewhere in the code.
#[test]
fn long_names_exist() {
    let text = sources(&["src", "crates", "tests", "benches", "examples"]);
    let known = words(&text);
    for document in documents() {
        let (prose, _) = split(&read(&document));
        for word in code(&prose) {
            let is_name = word.matches('_').count() >= 2
                && (word.chars()).all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
            assert!(!is_name || known.contains(word), "{document}: no `{word}`");
        }
    }
}

/// All files and folders under `folder`.
fn collect(folder: &Path, paths: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(&path, paths);
        }
        paths.push(path);
    }
}

/// The examples that `.ci/run` runs name no crate but softarm and the standard library, so that a copy of one compiles in a program that
/// depends on softarm alone: vectors and matrices are those of `softarm::nalgebra` and `softarm::faer`.
#[test]
fn examples_need_this_library_alone() {
    let steps = read(".ci/run");
    let list = steps
        .split_once("for example in ")
        .and_then(|(_, rest)| rest.split_once("; do"));
    let names: Vec<&str> = list.expect("a list of examples").0.split(' ').collect();
    assert!(names.len() >= 8, "{names:?}");
    let mut with_vectors = 0;
    for name in names {
        let text = read(&format!("examples/{name}.rs"));
        with_vectors += usize::from(text.contains("use softarm::nalgebra::"));
        for line in text.lines().filter(|line| line.starts_with("use ")) {
            let root = line[4..].split([':', ';']).next().unwrap();
            assert!(["std", "softarm"].contains(&root), "{name}: {line}");
        }
    }
    assert!(with_vectors >= 6, "{with_vectors}");
}

/// What is read first stays short.
#[test]
fn documents_are_short() {
    for (name, most) in LONGEST {
        let lines = read(name).lines().count();
        assert!(lines <= most, "{name}: {lines} lines, at most {most}");
    }
}

/// Lines of prose can be read beside code: at most 120 characters, but for tables, code, displayed formulas, and what cannot be broken.
#[test]
fn lines_of_documents_are_short() {
    for document in documents() {
        let text = read(&document);
        let (mut in_code, mut in_formula) = (false, false);
        for (i, line) in text.lines().enumerate() {
            in_code ^= line.trim_start().starts_with("```");
            in_formula ^= line.matches("$$").count() == 1;
            let is_free = in_code || in_formula || line.starts_with('|') || line.contains("](");
            let length = line.chars().count();
            assert!(
                is_free || length <= 120,
                "{document}, line {}: {length} characters",
                i + 1
            );
        }
    }
}

/// Documents with scenes for a newcomer to copy.
const WITH_SCENES: [&str; 3] = ["README.md", "docs/solves.md", "docs/loops.md"];

/// The scenes that a document shows.
fn scenes(document: &str) -> Vec<String> {
    let (_, blocks) = split(&read(document));
    let blocks = blocks.into_iter();
    (blocks.filter(|(language, _)| language == "toml"))
        .map(|(_, scene)| scene)
        .collect()
}

/// Every scene of the README and of the tutorials is valid.
#[test]
fn worked_scenes_are_valid() {
    let mut number = 0;
    for document in WITH_SCENES {
        for scene in scenes(document) {
            number += 1;
            if let Err(error) = Scene::from_toml("scene", &scene, &[]) {
                panic!("{document}, scene {number}: {error}");
            }
        }
    }
    assert!(number >= 6, "only {number} scenes were found");
}

/// The scenes of the README and of the tutorial on solves do what the page says: solves are certified, and a scene without controls is
/// simulated. The scene of the tutorial on loops has a test of its own, `the_worked_scene_holds_its_target`.
#[cfg(feature = "cli")]
#[test]
fn worked_scenes_run() {
    let folder = tempfile::tempdir().unwrap();
    for (number, scene) in WITH_SCENES[..2]
        .iter()
        .flat_map(|name| scenes(name))
        .enumerate()
    {
        let path = folder.path().join(format!("scene-{number}.toml"));
        fs::write(&path, &scene).unwrap();
        let is_solve = scene.contains("[task]");
        let verb = if is_solve { "solve" } else { "simulate" };
        let (code, printed) = softarm(&[verb, path.to_str().unwrap(), "--quiet"]);
        assert_eq!(code, Some(0), "{verb} scene {number}: {printed}");
    }
}

/// The reference of the scene file is what the program prints.
#[cfg(feature = "cli")]
#[test]
fn reference_is_printed() {
    let (code, printed) = softarm(&["schema", "--markdown"]);
    assert_eq!(code, Some(0));
    assert!(
        read("docs/scene-reference.md") == printed,
        "print it anew: cargo run --release -- schema --markdown > docs/scene-reference.md"
    );
}

/// Every dotted key that the README or a tutorial names is one of the schema.
#[test]
fn dotted_keys_exist() {
    let schema = serde_json::to_value(Scene::schema()).unwrap();
    let behind = |value: &serde_json::Value| {
        let reference = [value, &value["anyOf"][0], &value["items"]]
            .into_iter()
            .find_map(|value| value["$ref"].as_str());
        let name = reference.and_then(|path| path.rsplit('/').next());
        name.map_or_else(|| value.clone(), |name| schema["$defs"][name].clone())
    };
    let mut n_keys = 0;
    for document in WITH_SCENES {
        let (prose, _) = split(&read(document));
        for word in code(&prose) {
            let key = word.split(' ').next().unwrap_or_default();
            let parts: Vec<&str> = key.split('.').collect();
            let is_key = parts.len() > 1
                && (key.chars())
                    .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || "._".contains(c))
                && schema["properties"].get(parts[0]).is_some();
            if !is_key {
                continue;
            }
            n_keys += 1;
            let mut at = schema.clone();
            for part in parts {
                at = behind(&at["properties"][part]);
                assert!(!at.is_null(), "{document}: no key `{key}`");
            }
        }
    }
    assert!(n_keys > 20, "only {n_keys} keys were found");
}

/// Every key of the schema stands on its page, and every key in a table of that page is one of the schema.
#[test]
fn keys_are_those_of_the_page() {
    fn keys(value: &serde_json::Value, found: &mut BTreeSet<String>) {
        match value {
            serde_json::Value::Object(object) => {
                if let Some(serde_json::Value::Object(properties)) = object.get("properties") {
                    found.extend(properties.keys().cloned());
                }
                object.values().for_each(|value| keys(value, found));
            }
            serde_json::Value::Array(values) => values.iter().for_each(|value| keys(value, found)),
            _ => (),
        }
    }
    let schema = serde_json::to_value(Scene::schema()).unwrap();
    let mut found = BTreeSet::new();
    keys(&schema, &mut found);
    assert!(found.len() > 100, "the schema has {} keys", found.len());
    let page = read("docs/scene-reference.md");
    let words = words(&page);
    for key in &found {
        assert!(
            words.contains(key.as_str()),
            "docs/scene-reference.md: no {key}"
        );
    }
    let (prose, _) = split(&page);
    let mut in_keys = false;
    for line in prose.lines() {
        if !line.starts_with('|') {
            in_keys = false;
        } else if line.starts_with("| key |") {
            in_keys = true;
        } else if in_keys {
            let first = line.split('|').nth(1).unwrap_or_default();
            for word in code(first) {
                let part = word.rsplit('.').next().unwrap_or_default();
                let is_key = part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
                assert!(
                    !is_key || found.contains(part),
                    "docs/scene-reference.md: {word} is no key"
                );
            }
        }
    }
}

/// Every criterion of the certificate of a reach has its row on the page on accuracy.
#[test]
fn every_criterion_is_explained() -> Result<(), Box<dyn std::error::Error>> {
    let arm = Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05);
    let task = Task::reach(Vector3::new(0.4, 0.0, 0.85), 1.0, 20.0);
    let solution = softarm::solve(&arm, &task, &Discretization::with_elements(4))?;
    let page = read("docs/accuracy.md");
    for item in solution.certify()?.items {
        let name = item.name;
        assert!(
            page.contains(&format!("`{name}`")),
            "docs/accuracy.md: no {name}"
        );
    }
    Ok(())
}

/// Runs the program in a folder of its own; what it prints.
fn softarm(arguments: &[&str]) -> (Option<i32>, String) {
    let folder = tempfile::tempdir().unwrap();
    let run = Command::new(env!("CARGO_BIN_EXE_softarm"))
        .args(arguments)
        .current_dir(folder.path())
        .output()
        .unwrap();
    let printed =
        [run.stdout, run.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    (run.status.code(), printed.concat())
}

fn files(folder: &str, ending: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(root().join(folder)).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|own| own == ending));
    paths.sort();
    paths
}

/// The summary that a command prints.
#[cfg(feature = "cli")]
fn summary(arguments: &[&str], folder: &Path) -> serde_json::Value {
    let run = Command::new(env!("CARGO_BIN_EXE_softarm"))
        .args(arguments)
        .args(["--json", "--quiet"])
        .current_dir(folder)
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&run.stderr);
    serde_json::from_slice(&run.stdout)
        .unwrap_or_else(|error| panic!("{arguments:?}: {error}\n{errors}"))
}

/// Every key of a summary, and every key of the objects in it and of those in its lists, stands between backticks in the sections of
/// `docs/files.md` on the summary and on `verify`. Keys of `fallbacks` are causes, which another table names.
#[cfg(feature = "cli")]
#[test]
fn summaries_are_described() {
    use serde_json::Value;
    let text = read("docs/files.md");
    let section = |heading: &str| {
        let (_, rest) = text.split_once(&format!("\n## {heading}\n")).unwrap();
        rest.split("\n## ").next().unwrap().to_string()
    };
    let about = section("summary.json") + &section("The scope of `verify`");
    let words: BTreeSet<String> = (code(&about).iter())
        .flat_map(|span| span.split(|c: char| !c.is_alphanumeric() && c != '_'))
        .map(String::from)
        .collect();
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("reach.toml"), crate::tool::SCENE).unwrap();
    let short = "time.end_s=0.05";
    for arguments in [
        &["check", "reach.toml"][..],
        &["check", "mpc-push"],
        &["solve", "reach.toml", "--out", "solved", "--starts", "2"],
        &["verify", "solved"],
        &["solve", "reach-obstacle", "--set", "rod.elements=4"],
        &["simulate", "swing", "--set", short],
        &["mpc", "mpc-push", "--set", short],
        &["equilibrium", "mpc-push", "--points", "3"],
        &["tradeoff", "swing", "--set", short, "--budget", "2s"],
    ] {
        let summary = summary(arguments, folder.path());
        let mut missing = BTreeSet::new();
        for (key, value) in summary.as_object().unwrap() {
            if !words.contains(key) {
                missing.insert(key.clone());
            }
            let items = match value {
                Value::Array(items) => &items[..],
                _ => std::slice::from_ref(value),
            };
            let inner = items
                .iter()
                .filter_map(Value::as_object)
                .flat_map(|item| item.keys());
            for inner in inner.filter(|inner| key != "fallbacks" && !words.contains(*inner)) {
                missing.insert(format!("{key}.{inner}"));
            }
        }
        assert!(
            missing.is_empty(),
            "{arguments:?}: docs/files.md does not name {missing:?}"
        );
    }
}

/// The iterations by which times of solves are predicted are those of the tables of random reaches: of each kind the largest median and the
/// largest 95 % of both tables.
#[test]
fn predicted_iterations_are_those_that_were_measured() {
    use softarm::task::prediction::{ITERATIONS, ITERATIONS_PAST_OBSTACLES};
    let text = read("benches/reach_suite.md");
    let largest = |kinds: &[&str]| {
        let mut most = [0, 0];
        for line in text.lines().filter(|line| line.starts_with("| ")) {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            if kinds.contains(&cells[1]) {
                let counts: Vec<usize> = (cells[6].split(", "))
                    .map(|count| count.parse().unwrap())
                    .collect();
                most = [0, 1].map(|i| most[i].max(counts[i]));
            }
        }
        most
    };
    assert_eq!(largest(&["free", "bounds"]), ITERATIONS);
    assert_eq!(largest(&["obstacle"]), ITERATIONS_PAST_OBSTACLES);
}

/// The problems of the comparison with peers are solved as their table says: to the same objective, in about as many iterations. Rounding
/// differs from one processor to another, and with it the path of a solve: half as many more are within it, twice as many are not.
#[cfg(feature = "cli")]
#[test]
fn problems_of_peers_are_solved_as_their_table_says() {
    let page = read("benches/peers/README.md");
    let mut solved = 0;
    for line in page.lines() {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        if cells.len() < 10 || cells[1].is_empty() || cells[2] != "softarm" {
            continue;
        }
        let scene = root().join(format!("benches/peers/scenes/{}.toml", cells[1]));
        let arguments = ["solve", scene.to_str().unwrap(), "--json", "--quiet"];
        let (_, printed) = softarm(&arguments);
        let end = printed.rfind('}').unwrap_or_else(|| panic!("{printed}")) + 1;
        let summary: serde_json::Value = serde_json::from_str(&printed[..end]).unwrap();
        assert_eq!(summary["status"], "converged", "{}", cells[1]);
        let [iterations, objective] =
            ["iterations", "objective"].map(|key| summary[key].as_f64().unwrap());
        let [expected, same] = [3, 8].map(|at| cells[at].parse::<f64>().unwrap());
        let within = 1.5 * expected;
        assert!(
            iterations <= within,
            "{}: {iterations}, not {expected}",
            cells[1]
        );
        let apart = (objective / same - 1.0).abs();
        assert!(apart < 1e-5, "{}: {objective}, not {same}", cells[1]);
        solved += 1;
    }
    let scenes = files("benches/peers/scenes", "toml");
    let problems = (scenes.iter()).filter(|path| path.file_stem().unwrap() != "forward");
    assert_eq!(solved, problems.count());
}

/// What the Python files give the program is accepted: scenes of their own, and built-in ones with the keys that they set.
#[cfg(feature = "cli")]
#[test]
fn scenes_of_python_files_are_valid() {
    let forward = root().join("benches/peers/scenes/forward.toml");
    let arguments = [
        "simulate",
        forward.to_str().unwrap(),
        "--json",
        "--quiet",
        "--set",
        "rod.elements=4",
    ];
    let (code, printed) = softarm(&arguments);
    assert_eq!(code, Some(0), "{printed}");
    for key in ["steps", "step_s", "node_steps_per_s"] {
        assert!(
            printed.contains(&format!("\"{key}\"")),
            "forward.py reads {key}"
        );
    }
    let mut commands = 0;
    for path in ["benches", "benches/peers", "examples"]
        .iter()
        .flat_map(|folder| files(folder, "py"))
    {
        let text = fs::read_to_string(&path).unwrap();
        for line in text.lines().filter(|line| line.contains("\"mpc\", ")) {
            let words: Vec<&str> = line.split('"').skip(1).step_by(2).collect();
            let mut arguments = vec!["check", words[1], "--quiet"];
            for pair in words.windows(2).filter(|pair| pair[0] == "--set") {
                arguments.extend(pair);
            }
            let (code, printed) = softarm(&arguments);
            assert_eq!(code, Some(0), "{}: {printed}", path.display());
            commands += 1;
        }
    }
    assert!(commands >= 2, "only {commands} commands were found");
}

/// Python files compile, where there is a Python.
#[test]
fn python_files_compile() {
    const COMPILE: &str =
        "import sys\nfor f in sys.argv[1:]: compile(open(f, encoding='utf-8').read(), f, 'exec')";
    let folders = ["benches", "benches/peers", "examples"];
    let scripts: Vec<PathBuf> = folders
        .iter()
        .flat_map(|folder| files(folder, "py"))
        .collect();
    assert!(scripts.len() > 10);
    match Command::new("python3")
        .arg("-c")
        .arg(COMPILE)
        .args(scripts)
        .output()
    {
        Ok(run) => {
            let errors = String::from_utf8_lossy(&run.stderr);
            assert!(run.status.success(), "{errors}");
        }
        Err(_) => println!("skipped: no python3"),
    }
}

/// The packages of `Cargo.lock`, by name and version: those of others, which come from a registry.
fn packages_of_others() -> BTreeSet<(String, String)> {
    let text = read("Cargo.lock");
    let blocks = text.split("[[package]]").skip(1);
    let value = |block: &str, key: &str| {
        let lines = block.lines();
        let found = lines.filter_map(|line| line.strip_prefix(key)?.strip_prefix(" = "));
        found
            .map(|value| value.trim_matches('"').to_string())
            .next()
    };
    blocks
        .filter(|block| value(block, "source").is_some())
        .map(|block| {
            (
                value(block, "name").unwrap(),
                value(block, "version").unwrap(),
            )
        })
        .collect()
}

/// Names of the packages on which a manifest says that code depends which is no test.
fn dependencies(manifest: &str) -> Vec<String> {
    let mut section = "";
    let mut names = Vec::new();
    for line in manifest.lines() {
        if line.starts_with('[') {
            section = line.trim_matches(['[', ']']);
        } else if section == "dependencies" || section.ends_with("'.dependencies") {
            let name = line.split(['.', ' ', '=']).next().unwrap();
            if !name.is_empty() && !name.starts_with('#') {
                names.push(name.to_string());
            }
        }
    }
    names
}

/// Licenses under which a program may be passed on in any form.
const PERMISSIVE: [&str; 10] = [
    "MIT",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
    "0BSD",
];

/// The tables of `docs/licenses.md` have the packages of others in `Cargo.lock`, each once, and no more. The first table has all on which the
/// program depends directly. Each package can be used under a permissive license.
#[test]
fn licenses_are_those_of_the_packages() {
    let page = read("docs/licenses.md");
    let mut rows = BTreeSet::new();
    let mut in_program = BTreeSet::new();
    let mut heading = "";
    for line in page.lines() {
        heading = line.strip_prefix("## ").unwrap_or(heading);
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        if !line.starts_with('|') || cells[0] == "package" || cells[0].starts_with("---") {
            continue;
        }
        let is_permissive = cells[2].split(" AND ").all(|part| {
            let mut choices = part.trim_matches(['(', ')']).split(" OR ");
            choices.any(|license| PERMISSIVE.contains(&license))
        });
        assert!(is_permissive, "{}: {}", cells[0], cells[2]);
        let package = (cells[0].to_string(), cells[1].to_string());
        if heading == "In the program" {
            in_program.insert(cells[0].to_string());
        }
        assert!(rows.insert(package), "{} {} twice", cells[0], cells[1]);
    }
    let locked = packages_of_others();
    let differ: Vec<_> = rows.symmetric_difference(&locked).collect();
    assert!(
        differ.is_empty() && rows.len() > 100,
        "{} packages; {differ:?} are in one of docs/licenses.md and Cargo.lock: python3 docs/site/licenses.py --write",
        rows.len()
    );

    let workspace = read("Cargo.toml");
    let members = workspace.split_once("default-members = [").unwrap().1;
    let members = members
        .split_once(']')
        .unwrap()
        .0
        .split('"')
        .skip(1)
        .step_by(2);
    let mut n_dependencies = 0;
    for member in members {
        let manifest = read(&format!("{member}/Cargo.toml"));
        for name in dependencies(&manifest) {
            let is_own = name == "softarm" || root().join("crates").join(&name).is_dir();
            n_dependencies += usize::from(!is_own);
            assert!(
                is_own || in_program.contains(&name),
                "{member} depends on {name}, which is not in the program's table of docs/licenses.md"
            );
        }
    }
    assert!(n_dependencies > 40, "{n_dependencies} dependencies");
}

/// Keys of the paper's citations, `[@key; @other]`, and of the entries of its bibliography are the same.
#[test]
fn citations_of_the_paper_are_in_its_bibliography() {
    let (paper, bibliography) = (read("docs/joss/paper.md"), read("docs/joss/paper.bib"));
    let key = |rest: &str| {
        let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || "_-:".contains(c)));
        rest[..end.unwrap_or(rest.len())].to_string()
    };
    let brackets = paper
        .split('[')
        .skip(1)
        .filter_map(|rest| rest.split_once(']'));
    let cited: BTreeSet<String> = brackets
        .flat_map(|(inside, _)| inside.split('@').skip(1))
        .map(key)
        .collect();
    let entries = bibliography.lines().filter(|line| line.starts_with('@'));
    let known: BTreeSet<String> = entries
        .filter_map(|line| line.split_once('{'))
        .map(|(_, rest)| key(rest))
        .collect();
    assert!(cited.len() > 5, "{cited:?}");
    assert_eq!(cited, known);
}

/// A figure of `docs/comparison.md` in backticks, in a row that ends with a link to a table of `benches`, is a cell of that table's file.
#[test]
fn figures_of_the_comparison_are_those_of_their_tables() {
    let page = read("docs/comparison.md");
    let mut n_figures = 0;
    for row in page.lines().filter(|line| line.starts_with('|')) {
        let Some(file) = links(row).last().and_then(|link| link.strip_prefix("../")) else {
            continue;
        };
        let table = read(file);
        let cells: BTreeSet<&str> = (table.lines().filter(|line| line.starts_with('|')))
            .flat_map(|line| line.split('|'))
            .map(str::trim)
            .collect();
        for figure in code(row) {
            n_figures += 1;
            assert!(cells.contains(figure), "{file} has no {figure}");
        }
    }
    assert!(n_figures > 10, "{n_figures} figures");
}
