//! Writes a scene into the text that another one came from, and keeps its comments, blank lines and order.

use toml::{Table, Value};
use toml_edit::{ArrayOfTables, DocumentMut, InlineTable, Item, TableLike};

use super::{Scene, SceneSource};

/// Number of rounds of change and reading: a first one for the scene, one for keys of the text that an override had put out of force, and
/// one that finds no difference.
const ROUNDS: usize = 3;

/// Placeholder for the value of an entry that is to be removed, so that the comments around its line can still be found.
const GONE: &str = "softarm: this entry goes";

impl SceneSource {
    /// Returns the text of this source, changed only in the entries that differ between `scene` and the source with its overrides.
    ///
    /// The text reads back as `scene`; `None` if no such text is found.
    pub(crate) fn text_with(&self, scene: &Scene) -> Option<String> {
        let written: Table = toml::from_str(&self.text).ok()?;
        let overridden = self.entries()?;
        let wanted = entries(scene)?;
        let (mut found, _) = Scene::from_toml(&self.name, &self.text, &self.overrides).ok()?;
        let mut document: DocumentMut = self.text.parse().ok()?;
        change(document.as_table_mut(), &written, &overridden, false);
        for _ in 0..ROUNDS {
            let before = entries(&found)?;
            change(document.as_table_mut(), &before, &wanted, false);
            settle_grid(&mut document, scene);
            let text = without_gone(&document.to_string());
            (found, _) = Scene::from_toml(&self.name, &text, &[]).ok()?;
            document = text.parse().ok()?;
            if found == *scene {
                self.prune(&mut document, &written, scene);
                let text = document.to_string();
                return Some(match self.text.contains("\r\n") {
                    true => text.replace("\r\n", "\n").replace('\n', "\r\n"),
                    false => text,
                });
            }
        }
        None
    }

    /// Removes the keys of new sections that have their default values anyway.
    fn prune(&self, document: &mut DocumentMut, written: &Table, scene: &Scene) {
        let added = |document: &DocumentMut| -> Vec<(String, String)> {
            let sections = (document.iter()).filter(|(name, _)| !written.contains_key(*name));
            (sections.filter_map(|(name, item)| Some((name, item.as_table_like()?))))
                .flat_map(|(name, section)| {
                    (section.iter()).map(move |(key, _)| (name.to_string(), key.to_string()))
                })
                .collect()
        };
        for (section, key) in added(document) {
            let mut shorter = document.clone();
            if let Some(table) = shorter.get_mut(&section).and_then(Item::as_table_like_mut) {
                table.remove(&key);
            }
            let read = Scene::from_toml(&self.name, &shorter.to_string(), &[]);
            if read.is_ok_and(|(read, _)| read == *scene) {
                *document = shorter;
            }
        }
    }
}

/// Returns the entries of a scene, with every default.
fn entries(scene: &Scene) -> Option<Table> {
    let erased: &dyn erased_serde::Serialize = scene;
    Table::try_from(erased).ok()
}

/// Replaces an accuracy by elements, unless the scene asks for an accuracy: the two exclude each other, and a scene without elements asks
/// for an accuracy.
fn settle_grid(document: &mut DocumentMut, scene: &Scene) {
    let Some(item) = document.get_mut("rod") else {
        return;
    };
    let inline = item.is_inline_table();
    let Some(rod) = item.as_table_like_mut() else {
        return;
    };
    if scene.rod.accuracy.is_some() {
        return;
    }
    if !rod.contains_key("elements") {
        let elements = toml_edit::value(scene.rod.elements as i64);
        rod.insert("elements", elements);
    }
    remove(rod, "accuracy", inline);
}

/// Makes the changes in a section of a text that lead from one table to another.
fn change(section: &mut dyn TableLike, before: &Table, after: &Table, inline: bool) {
    for key in before.keys().filter(|key| !after.contains_key(*key)) {
        remove(section, key, inline);
    }
    for (key, value) in after {
        let earlier = before.get(key);
        if earlier == Some(value) {
            continue;
        }
        match section.get_mut(key) {
            Some(item) => change_item(item, earlier, value),
            None => {
                // What the text leaves open it may leave open still.
                let new = match (earlier, value) {
                    (Some(Value::Table(earlier)), Value::Table(table)) => {
                        let mut new = table.clone();
                        new.retain(|key, value| earlier.get(key) != Some(value));
                        item(&Value::Table(new), inline)
                    }
                    _ => item(value, inline),
                };
                section.insert(key, new);
            }
        }
    }
}

fn change_item(place: &mut Item, before: Option<&Value>, after: &Value) {
    let inline = place.is_value();
    match (before, after) {
        (Some(Value::Table(before)), Value::Table(after)) => {
            if let Some(section) = place.as_table_like_mut() {
                return change(section, before, after, inline);
            }
        }
        (Some(Value::Array(before)), Value::Array(after)) if before.len() == after.len() => {
            let pairs = before.iter().zip(after).enumerate();
            match place {
                Item::ArrayOfTables(tables) if tables.len() == after.len() => {
                    for (index, pair) in pairs {
                        if let (Some(table), (Value::Table(before), Value::Table(after))) =
                            (tables.get_mut(index), pair)
                        {
                            change(table, before, after, false);
                        }
                    }
                    return;
                }
                Item::Value(toml_edit::Value::Array(items)) if items.len() == after.len() => {
                    for (index, (before, after)) in pairs {
                        if let Some(item) = items.get_mut(index).filter(|_| before != after) {
                            change_value(item, Some(before), after);
                        }
                    }
                    return;
                }
                _ => {}
            }
        }
        _ => {}
    }
    match place {
        Item::Value(place) => change_value(place, None, after),
        place => *place = item(after, false),
    }
}

/// Changes a value whose comment, if there is one on its line, stays.
fn change_value(place: &mut toml_edit::Value, before: Option<&Value>, after: &Value) {
    if let (toml_edit::Value::InlineTable(table), Some(Value::Table(before)), Value::Table(after)) =
        (&mut *place, before, after)
    {
        return change(table, before, after, true);
    }
    let decor = place.decor().clone();
    *place = inline_value(after);
    *place.decor_mut() = decor;
}

/// Removes an entry, or marks it if comments may stand around its line.
fn remove(section: &mut dyn TableLike, key: &str, inline: bool) {
    match section.get_mut(key) {
        Some(Item::Value(value)) if !inline => {
            let decor = value.decor().clone();
            *value = GONE.into();
            *value.decor_mut() = decor;
        }
        Some(_) => drop(section.remove(key)),
        None => {}
    }
}

/// Returns the text without the lines of removed entries; a comment on such a line becomes a line of its own.
fn without_gone(text: &str) -> String {
    let mark = format!("\"{GONE}\"");
    let mut out = String::with_capacity(text.len());
    for line in text.split_inclusive('\n') {
        match line.split_once(&mark) {
            None => out.push_str(line),
            Some((_, rest)) if rest.trim().is_empty() => {}
            Some((_, rest)) => out.push_str(rest.trim_start()),
        }
    }
    out
}

/// A new entry: a section, sections that repeat, or a value.
fn item(value: &Value, inline: bool) -> Item {
    match value {
        Value::Table(table) if !inline => Item::Table(section(table)),
        Value::Array(items)
            if !inline && !items.is_empty() && items.iter().all(Value::is_table) =>
        {
            let mut tables = ArrayOfTables::new();
            for table in items.iter().filter_map(Value::as_table) {
                tables.push(section(table));
            }
            Item::ArrayOfTables(tables)
        }
        _ => Item::Value(inline_value(value)),
    }
}

fn section(table: &Table) -> toml_edit::Table {
    let mut new = toml_edit::Table::new();
    for (key, value) in table {
        new.insert(key, item(value, false));
    }
    new
}

fn inline_value(value: &Value) -> toml_edit::Value {
    match value {
        Value::String(text) => text.as_str().into(),
        Value::Integer(number) => (*number).into(),
        Value::Float(number) => (*number).into(),
        Value::Boolean(truth) => (*truth).into(),
        Value::Datetime(date) => (*date).into(),
        Value::Array(items) => items.iter().map(inline_value).collect(),
        Value::Table(table) => {
            let mut new = InlineTable::new();
            for (key, value) in table {
                new.insert(key, inline_value(value));
            }
            toml_edit::Value::InlineTable(new)
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::control::Hold;
    use crate::scene::{Scene, builtin};
    use crate::sqp::HessianChoice;
    use crate::task::Discretization;

    /// Returns the comments, in their order, and the number of blank lines.
    fn kept(text: &str) -> (Vec<&str>, usize) {
        let comments = text
            .lines()
            .filter_map(|line| line.find('#').map(|at| &line[at..]));
        let blank = text.lines().filter(|line| line.trim().is_empty()).count();
        (comments.collect(), blank)
    }

    /// Returns the scene with twice the elements and this step, one more block, solver settings that it may not name, and a horizon.
    fn changed(scene: &Scene, step: Option<f64>) -> Scene {
        let own = scene.discretization();
        let mut out = scene.with_grid(&Discretization {
            elements: 2 * own.elements,
            step,
            hold: Hold::Cubic,
            blocks: own.blocks + 1,
            ..own
        });
        if scene.control.is_some() {
            out.set_solver(Some(3e-7), Some(HessianChoice::Exact));
        }
        out.set_loop([Some(0.7), Some(0.07)], Some(true), Some(2), None);
        out
    }

    #[track_caller]
    fn check(text: &str, overrides: &[&str], change: impl Fn(&Scene) -> Scene) -> String {
        let overrides: Vec<String> = overrides.iter().map(|o| o.to_string()).collect();
        let (scene, source) = Scene::from_toml("scene", text, &overrides).unwrap();
        let wanted = change(&scene);
        let edited = source.text_with(&wanted).expect(text);
        let (read, _) = Scene::from_toml("edited", &edited, &[]).unwrap();
        let (written, _) = Scene::from_toml("written", &wanted.to_toml(), &[]).unwrap();
        assert_eq!(read, written, "{edited}");
        let (before, after) = (kept(text), kept(&edited));
        assert_eq!(before.0, after.0, "{edited}");
        assert!(after.1 >= before.1, "{edited}");
        edited
    }

    /// Every built-in scene, changed as a recommendation changes it, keeps its comments, and reads as if every key were written out.
    #[test]
    fn built_in_scenes_keep_their_comments() {
        for name in builtin::names() {
            let text = builtin::text(name).unwrap();
            check(text, &[], |scene| changed(scene, Some(1.25e-4)));
            check(text, &["rod.elements=6"], |scene| changed(scene, None));
        }
    }

    /// A scene without differences gives the same text.
    #[test]
    fn nothing_changed_is_the_same_text() {
        for name in builtin::names() {
            let text = builtin::text(name).unwrap();
            let (scene, source) = Scene::from_toml(name, text, &[]).unwrap();
            if scene.accuracy().is_none() {
                assert_eq!(source.text_with(&scene).unwrap(), text);
            }
        }
    }

    const ARM: &str = "\
# An arm.
[rod] # the rod
length_m = 1.0 # one meter
# How many.
elements = 8 # as in the paper

section = { radius_m = 0.05 } # round
material.youngs_modulus_pa = 1e6
material.poisson_ratio = 0.5 # rubber
material.density_kg_m3 = 1000.0

# A push.
[[load]]
node = 4 # the middle
force_n = [ # along
  3.0, # x
  0.0, 0.0]

[time]
end_s = 0.3
step_s = 1e-3 # small
# The end.
";

    /// Keys of the command line are in the text, whether they are in force themselves or put others out of force.
    #[test]
    fn overrides_are_written() {
        let own = |scene: &Scene| scene.clone();
        let text = check(
            ARM,
            &[
                "time.end_s=0.2",
                "load.0.force_n=[1.0, 0.0, 2.0]",
                "gravity.acceleration_m_s2=[0, 0, -9.81]",
            ],
            own,
        );
        assert!(
            text.contains("end_s = 0.2\n") && text.contains("[gravity]"),
            "{text}"
        );
        assert!(text.contains("  1.0, # x\n"), "{text}");
        check(ARM, &["time.end_s=0.2"], |scene| changed(scene, None));
        let free = ARM.replace("node = 4", "node = \"tip\"");
        for chosen in [8, 12] {
            let text = check(&free, &["rod.accuracy=1e-2"], |scene| {
                let grid = Discretization {
                    elements: chosen,
                    step: None,
                    ..scene.discretization()
                };
                scene.with_grid(&grid)
            });
            assert!(
                text.contains(&format!("elements = {chosen} # as in the paper")),
                "{text}"
            );
            assert!(text.contains("step_s = \"auto\" # small"), "{text}");
        }
    }

    /// Elements replace an accuracy, whose comments stay; so do the elements with which the search began.
    #[test]
    fn an_accuracy_gives_way() {
        let text = ARM
            .replace("elements = 8", "accuracy = 1e-2")
            .replace("node = 4", "node = \"tip\"")
            .replace("step_s = 1e-3", "step_s = \"auto\"");
        for more in [0, 3] {
            let text = check(&text, &[], |scene| {
                let own = scene.discretization();
                scene.with_grid(&Discretization {
                    elements: own.elements + more,
                    ..own
                })
            });
            assert!(!text.contains("accuracy"), "{text}");
        }
        check(&text, &["rod.elements=8"], |scene| changed(scene, None));
    }

    /// Line ends are those of the text.
    #[test]
    fn line_ends_stay() {
        let text = check(&ARM.replace('\n', "\r\n"), &[], |scene| {
            changed(scene, Some(1e-4))
        });
        assert_eq!(text.matches('\n').count(), text.matches("\r\n").count());
    }
}
