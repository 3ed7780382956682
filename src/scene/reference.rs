//! The reference of the scene file in Markdown: every table and every key of the JSON Schema, in its order and its words.

use serde_json::Value;

/// Longest line of prose, in characters.
const WIDTH: usize = 120;

const PREFACE: [&str; 3] = [
    "`softarm schema --markdown` prints this page from the JSON Schema, which `softarm schema` prints for editors. \
     [solves.md](solves.md) and [loops.md](loops.md) introduce the sections one after the other, and \
     [theory.md](theory.md#objective-and-limits) has the formulas of costs and limits.",
    "A scene is a TOML file. All quantities are in SI units, and the name of a key ends in its unit. Vectors are `[x, y, z]` in \
     the spatial frame unless the text says otherwise; quaternions are scalar first. `[section]` is a table, and `[[section]]` \
     a list of tables, which may stand any number of times. A key is *required* if a scene is refused without it. A section \
     that is absent is a feature that the scene does not have: it is neither modelled nor computed. An unknown key is an error.",
    "`--set KEY=VALUE` overrides a key by its dotted path with any verb, for example `--set rod.elements=40` or \
     `--set 'control.hold=\"cubic\"'`. The `scene.toml` in a result directory has every default and every chosen value \
     written out.",
];

/// Units by the end of a key, longer ends first.
const UNITS: [(&str, &str); 33] = [
    ("_kg_m2_s", "kg m²/s"),
    ("_kg_m_s", "kg m/s"),
    ("rotary_kg_m", "kg m"),
    ("_n_m_per_m", "N m/m"),
    ("_n_per_m", "N/m"),
    ("_n_m_s", "N m/s"),
    ("_n_m2", "N m²"),
    ("_kg_m2", "kg m²"),
    ("_kg_m3", "kg/m³"),
    ("_kg_m", "kg/m"),
    ("_rad_s", "rad/s"),
    ("_t_m_s", "T/m/s"),
    ("_m_s2", "m/s²"),
    ("_a_m2", "A m²"),
    ("_pa_s", "Pa/s"),
    ("_m3", "m³"),
    ("_m2", "m²"),
    ("_t_m", "T/m"),
    ("_t_s", "T/s"),
    ("_1_m", "1/m"),
    ("_1_n", "1/N"),
    ("_1_s", "1/s"),
    ("_n_m", "N m"),
    ("_n_s", "N/s"),
    ("_m_s", "m/s"),
    ("_rad", "rad"),
    ("_kg", "kg"),
    ("_hz", "Hz"),
    ("_pa", "Pa"),
    ("_m", "m"),
    ("_n", "N"),
    ("_s", "s"),
    ("_t", "T"),
];

/// Returns the reference of a scene file with this JSON Schema.
pub(super) fn page(schema: &Value) -> String {
    let definitions = &schema["$defs"];
    let mut page = Page {
        text: "# Reference of the scene file\n".into(),
        definitions,
        sections: Vec::new(),
        choices: Vec::new(),
    };
    for paragraph in PREFACE {
        page.paragraph(paragraph);
    }
    for (key, at_key) in schema["properties"].as_object().into_iter().flatten() {
        page.section(Entry::of(key, at_key, definitions));
    }
    page.text
}

struct Page<'a> {
    text: String,
    definitions: &'a Value,
    /// Every table that has its section: the name of its definition, and its heading.
    sections: Vec<(&'a str, String)>,
    /// Names of the definitions whose words are already explained.
    choices: Vec<&'a str>,
}

/// A key with the schema of its value.
struct Entry<'a> {
    /// Dotted path from the top of the scene.
    path: String,
    /// Description and default, which stand at the key.
    at_key: &'a Value,
    /// The value, or the item of a list, behind its definition.
    value: &'a Value,
    /// Name of that definition; empty if there is none.
    definition: &'a str,
    is_list: bool,
}

impl<'a> Entry<'a> {
    fn of(path: &str, at_key: &'a Value, definitions: &'a Value) -> Self {
        let (value, definition) = behind(at_key, definitions);
        let (item, of_item) = behind(&value["items"], definitions);
        let is_list = item["properties"].is_object();
        let (value, definition) = if is_list {
            (item, of_item)
        } else {
            (value, definition)
        };
        Self {
            path: path.into(),
            at_key,
            value,
            definition,
            is_list,
        }
    }

    fn is_table(&self) -> bool {
        self.value["properties"].is_object()
    }

    /// The name of a table as TOML writes it.
    fn heading(&self) -> String {
        match self.is_list {
            true => format!("[[{}]]", self.path),
            false => format!("[{}]", self.path),
        }
    }
}

/// Returns a schema without the choice of `null` and without the reference to its definition, and the name of the latter.
fn behind<'a>(schema: &'a Value, definitions: &'a Value) -> (&'a Value, &'a str) {
    let choices = schema["anyOf"].as_array();
    let is_optional =
        choices.is_some_and(|choices| choices.iter().any(|one| one["type"] == "null"));
    let schema = match choices {
        Some(choices) if is_optional => &choices[0],
        _ => schema,
    };
    let name = schema["$ref"]
        .as_str()
        .and_then(|path| path.rsplit('/').next());
    name.map_or((schema, ""), |name| (&definitions[name], name))
}

impl<'a> Page<'a> {
    /// Prints the section of a table, then those of the tables in it that have none yet.
    fn section(&mut self, table: Entry<'a>) {
        let heading = table.heading();
        self.text += &format!("\n## `{heading}`\n");
        let (meaning, default) = meaning_and_default(table.at_key);
        if let Some(first) = self.heading_of(table.definition) {
            let words = format!("{meaning} Its keys are those of {}.", link(first));
            return self.paragraph(&words);
        }
        for part in description(table.value).split("\n\n") {
            self.paragraph(part);
        }
        if default != "none" {
            self.paragraph(&format!("Default: {default}."));
        }
        self.sections.push((table.definition, heading));
        self.keys(&table);
    }

    /// Prints the keys of a table, then the words that a key may have, then the sections of the tables in it.
    fn keys(&mut self, table: &Entry<'a>) {
        let required = table.value["required"].as_array();
        let keys = table.value["properties"].as_object().into_iter().flatten();
        let entries: Vec<Entry> = keys
            .map(|(key, at_key)| {
                Entry::of(&format!("{}.{key}", table.path), at_key, self.definitions)
            })
            .collect();
        self.text += "\n| key | type | unit | default | meaning |\n|---|---|---|---|---|\n";
        for entry in &entries {
            let key = entry.path.rsplit('.').next().unwrap_or_default();
            let (meaning, default) = meaning_and_default(entry.at_key);
            let is_required = required.is_some_and(|keys| keys.iter().any(|one| one == key));
            let default = if is_required {
                "*required*".into()
            } else {
                default
            };
            let kind = match self.heading_of(entry.definition) {
                _ if !entry.is_table() => {
                    kind(behind(entry.at_key, self.definitions).0, self.definitions)
                }
                Some(heading) => link(heading),
                // Of several keys of this table with the same keys, the first has the section.
                None => {
                    let mut alike = entries.iter();
                    let first = alike.find(|other| other.definition == entry.definition);
                    link(&first.unwrap_or(entry).heading())
                }
            };
            let cells = [
                format!("`{key}`"),
                kind.clone(),
                unit(key, &kind, &meaning),
                default,
                meaning,
            ];
            let cells = cells.map(|cell| cell.replace('\n', " ").replace('|', "\\|"));
            self.text += &format!("| {} |\n", cells.join(" | "));
        }
        for entry in &entries {
            self.words(entry);
        }
        for entry in entries.into_iter().filter(Entry::is_table) {
            if self.heading_of(entry.definition).is_none() {
                self.section(entry);
            }
        }
    }

    /// Prints the words that a key may have with their meaning, the first time that a key has them.
    fn words(&mut self, entry: &Entry<'a>) {
        let (item, of_item) = behind(&entry.value["items"], self.definitions);
        let (choice, name) = match item["oneOf"].is_array() {
            true => (item, of_item),
            false => (entry.value, entry.definition),
        };
        let Some(words) = choice["oneOf"].as_array() else {
            return;
        };
        if self.choices.contains(&name) {
            return;
        }
        self.choices.push(name);
        self.paragraph(&format!("`{}`: {}", entry.path, description(choice)));
        self.text += "\n";
        for word in words {
            let word = format!("{}: {}", typed(word), description(word));
            self.text += &wrapped(&word, "* ", "  ");
        }
    }

    /// Returns the heading of the section of a table; `None` if it has none yet.
    fn heading_of(&self, definition: &str) -> Option<&str> {
        let section = self.sections.iter().find(|(name, _)| *name == definition);
        section.map(|(_, heading)| heading.as_str())
    }

    fn paragraph(&mut self, text: &str) {
        self.text += &format!("\n{}", wrapped(text, "", ""));
    }
}

/// Returns the description of a schema, or nothing.
fn description(schema: &Value) -> String {
    schema["description"].as_str().unwrap_or_default().into()
}

/// Returns what a key does, and what holds without it: the sentence of its description that says so, or else the default of its schema.
fn meaning_and_default(at_key: &Value) -> (String, String) {
    let text = description(at_key).replace('\n', " ");
    for word in ["Absent: ", "Default: "] {
        let Some((before, after)) = text.split_once(word) else {
            continue;
        };
        // A sentence ends where the next one begins with a capital letter.
        let end = after.match_indices(". ").map(|(at, _)| at).find(|at| {
            let next = after[at + 2..].chars().next();
            next.is_some_and(char::is_uppercase)
        });
        let (default, rest) = after.split_at(end.map_or(after.len(), |at| at + 1));
        let meaning = format!("{}{}", before.trim_end(), rest);
        let default = default.trim_end_matches('.');
        let is_value = default == "true"
            || default == "false"
            || default.starts_with(['"', '[']) && default.ends_with(['"', ']']);
        let default = if is_value {
            format!("`{default}`")
        } else {
            default.into()
        };
        return (meaning.trim().into(), default);
    }
    let default = match &at_key["default"] {
        Value::Null | Value::Object(_) => "none".into(),
        Value::Array(items) if items.is_empty() => "none".into(),
        Value::Number(number) => number.to_string().trim_end_matches(".0").into(),
        value => format!("`{value}`"),
    };
    (text, default)
}

/// Returns the type of a value in words, with its range.
fn kind(schema: &Value, definitions: &Value) -> String {
    let of = |schema: &Value| kind(behind(schema, definitions).0, definitions);
    if let Some(choices) = (schema["oneOf"].as_array()).or(schema["anyOf"].as_array()) {
        let choices = choices.iter().map(|one| match typed(one).as_str() {
            "" => of(one),
            word => word.into(),
        });
        return choices.collect::<Vec<String>>().join(", ");
    }
    if let Some(words) = schema["enum"].as_array() {
        let words = words.iter().map(|word| format!("`{word}`"));
        return words.collect::<Vec<String>>().join(", ");
    }
    let kind = (schema["type"].as_str()).or(schema["type"][0].as_str());
    match kind.unwrap_or_default() {
        "array" => {
            let item = behind(&schema["items"], definitions).0;
            match schema["maxItems"].as_u64() {
                Some(count) => format!("{count} × {}", of(item)),
                None if item["type"] == "array" && item["maxItems"].is_u64() => {
                    format!("rows of {}", of(item))
                }
                None if item["type"] == "array" => "rows of numbers".into(),
                None => format!("list of {}", of(item)),
            }
        }
        "boolean" => "`true`, `false`".into(),
        kind @ ("number" | "integer") => format!("{kind}{}", range(schema)),
        kind => kind.into(),
    }
}

/// Returns the range of a number, with a space before it.
fn range(schema: &Value) -> String {
    let bound = |keyword: &str| {
        let bound = schema[keyword].as_f64();
        bound.map(|bound| bound.to_string())
    };
    match (
        bound("minimum"),
        bound("exclusiveMinimum"),
        bound("maximum"),
    ) {
        (Some(least), _, Some(most)) => format!(" {least} to {most}"),
        (Some(least), _, None) => format!(" ≥ {least}"),
        (None, Some(above), Some(most)) => format!(" > {above}, ≤ {most}"),
        (None, Some(above), None) => format!(" > {above}"),
        (None, None, Some(most)) => format!(" ≤ {most}"),
        (None, None, None) => String::new(),
    }
}

/// Returns a choice as it is typed: a word in quotes, or a table with one key; nothing for a choice of another kind.
fn typed(choice: &Value) -> String {
    let key = choice["properties"]
        .as_object()
        .and_then(|keys| keys.keys().next());
    match (&choice["const"], key) {
        (Value::String(word), _) => format!("`\"{word}\"`"),
        (_, Some(key)) => format!("`{{ {key} = n }}`"),
        _ => String::new(),
    }
}

/// Returns the unit of a key by its end; rows over time begin with a time in seconds.
fn unit(key: &str, kind: &str, meaning: &str) -> String {
    let unit = UNITS
        .iter()
        .find(|(end, _)| key.ends_with(end))
        .map_or("", |(_, unit)| unit);
    let is_over_time = meaning.contains("[t in s") || meaning.contains("over time");
    match (unit, kind.starts_with("rows of") && is_over_time) {
        ("", true) => "s".into(),
        (unit, true) => format!("s, {unit}"),
        (unit, false) => unit.into(),
    }
}

/// Returns a link to the section with this heading.
fn link(heading: &str) -> String {
    let anchor = heading.replace(['[', ']', '.'], "");
    format!("[`{heading}`](#{anchor})")
}

/// Returns text on lines of at most [`WIDTH`] characters; a word between backticks is not broken.
fn wrapped(text: &str, first: &str, next: &str) -> String {
    let (mut lines, mut line) = (String::new(), first.to_string());
    let mut is_code = false;
    let mut word = String::new();
    for piece in text.split_whitespace() {
        word += piece;
        is_code ^= piece.matches('`').count() % 2 == 1;
        if is_code {
            word.push(' ');
            continue;
        }
        let is_first = line.len() == first.len() && lines.is_empty()
            || line.len() == next.len() && !lines.is_empty();
        if !is_first && line.chars().count() + 1 + word.chars().count() > WIDTH {
            lines += &format!("{line}\n");
            line = format!("{next}{word}");
        } else {
            if !is_first {
                line.push(' ');
            }
            line += &word;
        }
        word.clear();
    }
    lines + &line + "\n"
}
