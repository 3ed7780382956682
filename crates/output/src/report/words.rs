//! The words of a page, made by templates: sentences, facts, tables, and the columns that its charts draw.
//!
//! A template is Jinja (`minijinja`). It renders to lines, of which blank ones count for nothing. `[part]` or `[part a | b]` begins a part,
//! with cells in its head; every other line is a row, `name: cell | cell`. The lines of a sentence are its clauses, which are joined by
//! spaces but for those that begin with a comma, a semicolon or a full stop. Values are text, whatever signs they hold: a backslash
//! stands before those that would mean something in a line.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use minijinja::{AutoEscape, Environment, Error, ErrorKind, UndefinedBehavior, Value};
use serde::Serialize;

use crate::quantity::{digits, quantity};

use super::{
    ReportAttempt, ReportBars, ReportChart, ReportCheck, ReportCurve, ReportTable, ReportVerdict,
    figure,
};

/// Numbers that charts draw, by the names by which templates call them.
pub type Columns = BTreeMap<String, Vec<f64>>;
/// Pairs of label and value.
pub type Facts = Vec<(String, String)>;

/// The words of a page.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Words {
    /// The outcome, beside the title.
    pub verdict: ReportVerdict,
    /// One sentence: the motion, its forces, and its outcome.
    pub lead: String,
    /// Why that can be trusted, or why not: one sentence.
    pub trust: String,
    /// The arm.
    pub arm_facts: Facts,
    /// Facts about the loads and controls.
    pub acting: Facts,
    /// The run.
    pub facts: Facts,
    /// Curves over time or over something else.
    pub charts: Vec<ReportChart>,
    /// Sizes beside each other.
    pub bars: Vec<ReportBars>,
    /// Tables.
    pub tables: Vec<ReportTable>,
    /// Advice, in sentences.
    pub advice: Vec<String>,
    /// The solves that the iterations belong to.
    pub attempts: Vec<ReportAttempt>,
    /// Checks that were made afterwards, with their verdicts.
    pub checks: Vec<ReportCheck>,
}

impl Words {
    /// The words of the template `name`, one of `templates`, which may import each other, from `context`.
    ///
    /// Beside the fields of `context` a template knows `columns`: of each by its name the least and the largest number, `low` and `high`,
    /// and whether it has one that is finite, `known`.
    ///
    /// # Errors
    /// A template that asks for what there is not: a sum of texts, a column that was not gathered, a part that no page has.
    pub fn of(
        templates: &[(&'static str, &'static str)],
        name: &str,
        context: &serde_json::Value,
        columns: &Columns,
    ) -> Result<Self, Error> {
        let extents: BTreeMap<&str, Value> = (columns.iter())
            .map(|(name, values)| (name.as_str(), extent(values)))
            .collect();
        let context =
            minijinja::context! { columns => extents, ..minijinja::value::Serde(context) };
        let environment = environment(templates)?;
        let text = environment.get_template(name)?.render(context)?;
        let mut words = Self::default();
        for part in parts(&text) {
            words.take(&part, columns)?;
        }
        Ok(words)
    }

    fn take(&mut self, part: &Part, columns: &Columns) -> Result<(), Error> {
        let rows = || part.lines.iter().map(|line| Row::of(line));
        let facts = || rows().map(|row| (row.name, row.cells.join(" | ")));
        let head = |i: usize| part.head.get(i).cloned().unwrap_or_default();
        match part.kind {
            "verdict" => {
                for row in rows() {
                    self.verdict = ReportVerdict {
                        ok: row.is(0),
                        checked: row.is(1),
                        text: row.name,
                    };
                }
            }
            "lead" => self.lead = sentence(&part.lines),
            "trust" => self.trust = sentence(&part.lines),
            "arm" => self.arm_facts.extend(facts()),
            "acting" => self.acting.extend(facts()),
            "facts" => self.facts.extend(facts()),
            "advice" => self
                .advice
                .extend(part.lines.iter().map(|line| plain(line))),
            "chart" => self.charts.push(ReportChart {
                section: head(0),
                title: head(1),
                unit: head(2),
                x_name: part.head.get(3).map_or("time".into(), String::clone),
                x_unit: part.head.get(4).map_or("s".into(), String::clone),
                series: (rows().map(|row| curve(row, columns))).collect::<Result<_, _>>()?,
            }),
            "bars" => self.bars.push(ReportBars {
                section: head(0),
                title: head(1),
                note: head(2),
                bars: (rows())
                    .map(|row| (row.name.clone(), row.number(0), row.cell(1)))
                    .collect(),
            }),
            "table" => self.tables.push(ReportTable {
                title: head(0),
                heads: part.head.iter().skip(1).cloned().collect(),
                rows: (rows())
                    .map(|row| [vec![row.name], row.cells].concat())
                    .collect(),
            }),
            "attempts" => self.attempts.extend(rows().map(|row| ReportAttempt {
                iterations: row.number(0) as usize,
                ended: row.cell(1),
                is_result: row.is(2),
                from: row.name,
            })),
            "checks" => self.checks.extend(rows().map(|row| ReportCheck {
                value: row.cell(0),
                limit: row.cell(1),
                ok: row.is(2),
                meaning: row.cell(3),
                name: row.name,
            })),
            other => return Err(fault(format!("no page has a part `{other}`"))),
        }
        Ok(())
    }
}

/// The document that the template `name` makes of `context`.
///
/// # Errors
/// As [`Words::of`].
pub fn fill(
    templates: &[(&'static str, &'static str)],
    name: &str,
    context: &serde_json::Value,
) -> Result<String, Error> {
    environment(templates)?
        .get_template(name)?
        .render(minijinja::value::Serde(context))
}

/// The rows of the template `name`, each a name and a text, whatever part they stand in.
///
/// # Errors
/// As [`Words::of`].
pub fn entries(
    templates: &[(&'static str, &'static str)],
    name: &str,
    context: &serde_json::Value,
) -> Result<Facts, Error> {
    let text = fill(templates, name, context)?;
    let lines = text.lines().map(str::trim);
    Ok((lines.filter(|line| !line.is_empty()))
        .map(Row::of)
        .map(|row| (row.name, row.cells.join(" | ")))
        .collect())
}

fn fault(what: String) -> Error {
    Error::new(ErrorKind::InvalidOperation, what)
}

/// The least and the largest number of a column, and whether one is finite.
fn extent(values: &[f64]) -> Value {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let known = values.iter().any(|value| value.is_finite());
    minijinja::context! { low, high, known }
}

/// Lines under a head.
struct Part<'a> {
    kind: &'a str,
    head: Vec<String>,
    lines: Vec<&'a str>,
}

fn parts(text: &str) -> Vec<Part<'_>> {
    let mut parts: Vec<Part> = Vec::new();
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        let head = line.strip_prefix('[').and_then(|l| l.strip_suffix(']'));
        match (head, parts.last_mut()) {
            (Some(head), _) => {
                let (kind, head) = head.split_once(' ').unwrap_or((head, ""));
                let cells = if head.is_empty() {
                    Vec::new()
                } else {
                    cells(head)
                };
                parts.push(Part {
                    kind,
                    head: cells,
                    lines: Vec::new(),
                });
            }
            (None, Some(part)) => part.lines.push(line),
            (None, None) => {}
        }
    }
    parts
}

/// A name and what stands behind it.
struct Row {
    name: String,
    cells: Vec<String>,
}

impl Row {
    fn of(line: &str) -> Self {
        let (name, rest) = match places(line, ':').next() {
            Some(at) => (&line[..at], &line[at + 1..]),
            None => (line, ""),
        };
        Self {
            name: plain(name),
            cells: cells(rest),
        }
    }

    fn cell(&self, i: usize) -> String {
        self.cells.get(i).cloned().unwrap_or_default()
    }

    fn is(&self, i: usize) -> bool {
        self.cell(i) == "True"
    }

    /// A number; NaN for what is none.
    fn number(&self, i: usize) -> f64 {
        self.cell(i).parse().unwrap_or(f64::NAN)
    }
}

/// The signs that would mean something in a line, with the letter that stands for them behind a backslash.
const SIGNS: [(char, char); 6] = [
    ('\\', '\\'),
    (':', ':'),
    ('|', '|'),
    ('[', '['),
    ('\n', 'n'),
    ('\r', 'r'),
];

/// Where a sign stands in a line without a backslash before it.
fn places(line: &str, sign: char) -> impl Iterator<Item = usize> {
    let mut is_text = false;
    line.char_indices().filter_map(move |(at, other)| {
        let means = !is_text && other == sign;
        is_text = !is_text && other == '\\';
        means.then_some(at)
    })
}

/// Texts between bars.
fn cells(text: &str) -> Vec<String> {
    let mut from = 0;
    let mut out = Vec::new();
    for at in places(text, '|').chain([text.len()]) {
        out.push(plain(text[from..at].trim()));
        from = at + 1;
    }
    out
}

/// A text without the backslashes of [`SIGNS`].
fn plain(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut signs = text.chars();
    while let Some(sign) = signs.next() {
        if sign == '\\' {
            let letter = signs.next();
            out.extend(SIGNS.iter().find(|(_, l)| letter == Some(*l)).map(|s| s.0));
        } else {
            out.push(sign);
        }
    }
    out
}

fn sentence(clauses: &[&str]) -> String {
    let mut out = String::new();
    for clause in clauses {
        if !out.is_empty() && !clause.starts_with([',', ';', '.']) {
            out.push(' ');
        }
        out.push_str(clause);
    }
    plain(&out)
}

/// A curve: `name: color | column of x | column of y`, and behind these `hold`, `dashed`, `dots`, and `band` with a column.
fn curve(row: Row, columns: &Columns) -> Result<ReportCurve, Error> {
    let column = |name: &str| {
        (columns.get(name).cloned()).ok_or_else(|| fault(format!("no column `{name}` to draw")))
    };
    let mut curve = ReportCurve {
        color: row.cell(0),
        x: column(&row.cell(1))?,
        y: column(&row.cell(2))?,
        hold: false,
        band: Vec::new(),
        dashed: false,
        dots: false,
        name: row.name,
    };
    for option in row.cells.iter().skip(3) {
        match option.split_once(' ') {
            Some(("band", name)) => curve.band = column(name)?,
            _ if option == "hold" => curve.hold = true,
            _ if option == "dashed" => curve.dashed = true,
            _ if option == "dots" => curve.dots = true,
            _ => return Err(fault(format!("no curve is `{option}`"))),
        }
    }
    Ok(curve)
}

/// The rows in which two lists of facts differ: name, value in the first, value in the second.
fn differing(a: &str, b: &str) -> Vec<[String; 3]> {
    let [a, b] = [a, b].map(|text| -> Vec<Row> {
        let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
        lines.map(Row::of).collect()
    });
    let mut names: Vec<&str> = Vec::new();
    for row in a.iter().chain(&b) {
        if !names.contains(&row.name.as_str()) {
            names.push(&row.name);
        }
    }
    let value = |rows: &[Row], name: &str| {
        let found: Vec<String> = (rows.iter().filter(|row| row.name == name))
            .map(|row| row.cells.join(" | "))
            .collect();
        if found.is_empty() {
            "–".into()
        } else {
            found.join("; ")
        }
    };
    (names.into_iter())
        .map(|name| [name.to_string(), value(&a, name), value(&b, name)])
        .filter(|[_, a, b]| a != b)
        .collect()
}

/// A number; NaN for what is none.
fn number(value: &Value) -> f64 {
    f64::try_from(value.clone()).unwrap_or(f64::NAN)
}

/// Three numbers.
fn vector(value: &Value) -> [f64; 3] {
    [0, 1, 2].map(|i| number(&value.get_item_by_index(i).unwrap_or_default()))
}

/// Fraction of the largest of some numbers below which another one is its rounding.
const ROUNDING: f64 = 1e-9;

fn significant(value: Value) -> Vec<f64> {
    let v = vector(&value);
    let largest = v.iter().fold(0.0, |most: f64, part| most.max(part.abs()));
    (v.into_iter())
        .map(|part| {
            if part.abs() < ROUNDING * largest {
                0.0
            } else {
                part
            }
        })
        .collect()
}

/// A number of `digits` digits with its unit.
fn measure(value: f64, unit: &str, digits: usize) -> String {
    format!("{} {unit}", figure(value, digits))
        .trim_end()
        .into()
}

/// The templates, and what they may call.
///
/// Filters: `number` (NaN for what is none), `figure(digits)`, `m(unit)` (three digits and a unit), `percent`, `vector`, `significant`
/// (without rounding of other components), `size` (Euclidean norm), `exp`, `counted(noun)`, `words` (of a key or a number),
/// `fixed(decimals)`, `power(decimals)` (as in 1.5e-3); and for a terminal `digits` and `quantity(unit)`, as in
/// [`quantity`](crate::quantity).
/// The test `known` holds for finite numbers.
fn environment(templates: &[(&'static str, &'static str)]) -> Result<Environment<'static>, Error> {
    let mut out = Environment::new();
    out.set_undefined_behavior(UndefinedBehavior::Chainable);
    out.set_auto_escape_callback(|name| match name.ends_with(".html") {
        true => AutoEscape::Html,
        false => AutoEscape::Custom("lines".into()),
    });
    out.set_formatter(|out, state, value| {
        if value.is_undefined() || value.is_none() {
            return Ok(());
        }
        if value.is_safe() {
            return Ok(write!(out, "{value}")?);
        }
        let is_html = matches!(state.auto_escape(), AutoEscape::Html);
        for sign in value.to_string().chars() {
            let escape = match sign {
                _ if !is_html => {
                    if let Some((_, letter)) = SIGNS.iter().find(|(known, _)| *known == sign) {
                        write!(out, "\\{letter}")?;
                        continue;
                    }
                    None
                }
                '&' => Some("&amp;"),
                '<' => Some("&lt;"),
                '>' => Some("&gt;"),
                '"' => Some("&quot;"),
                _ => None,
            };
            match escape {
                Some(text) => out.write_str(text)?,
                None => out.write_char(sign)?,
            }
        }
        Ok(())
    });
    out.add_test("known", |v: Value| number(&v).is_finite());
    out.add_filter("number", |v: Value| number(&v));
    out.add_filter("figure", |v: Value, digits: Option<usize>| {
        figure(number(&v), digits.unwrap_or(3))
    });
    out.add_filter("m", |v: Value, unit: String, digits: Option<usize>| {
        measure(number(&v), &unit, digits.unwrap_or(3))
    });
    out.add_filter("digits", |v: Value| digits(number(&v)));
    out.add_filter("quantity", |v: Value, unit: String| {
        quantity(number(&v), &unit)
    });
    out.add_filter("exp", |v: Value| number(&v).exp());
    out.add_filter("percent", |v: Value| measure(100.0 * number(&v), "%", 3));
    out.add_filter("vector", |v: Value| {
        let [x, y, z] = vector(&v).map(|part| figure(part, 3));
        format!("({x}, {y}, {z})")
    });
    out.add_filter("significant", significant);
    out.add_filter("size", |v: Value| {
        nalgebra::Vector3::from(vector(&v)).norm()
    });
    out.add_filter("counted", |v: Value, noun: String| {
        let n = u64::try_from(v).unwrap_or(0);
        format!("{n} {noun}{}", if n == 1 { "" } else { "s" })
    });
    out.add_filter("words", |v: Value| match v.as_str() {
        Some(word) => word.replace('_', " "),
        None => figure(number(&v), 3),
    });
    out.add_filter("fixed", |v: Value, decimals: usize| {
        format!("{:.decimals$}", number(&v))
    });
    out.add_filter(
        "power",
        |v: Value, decimals: Option<usize>| match decimals {
            Some(decimals) => format!("{:.decimals$e}", number(&v)),
            None => format!("{:e}", number(&v)),
        },
    );
    out.add_function("differing", |a: String, b: String| differing(&a, &b));
    for (name, text) in templates {
        out.add_template(name, text)?;
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn words(template: &'static str, context: serde_json::Value) -> Result<Words, Error> {
        let columns = Columns::from([
            ("t".into(), vec![0.0, 1.0]),
            ("y".into(), vec![f64::NAN, 2.0]),
        ]);
        Words::of(
            &[("page.jinja", template)],
            "page.jinja",
            &context,
            &columns,
        )
    }

    /// Signs that mean something in a line or to the template stay text in labels, values, sentences and cells, also through a macro.
    #[test]
    fn values_stay_text() {
        let hostile = "[facts]\na: b | c \\: \\ {{ x }} \r\n; 1\\";
        let template = "{% macro same(x) %}{{ x }}{% endmacro %}
            [lead]\n{{ same(x) }}
            [facts]\n{{ x }}: {{ same(x) }}
            [table {{ x }} | {{ x }}]\n{{ x }}: {{ x }} | {{ [x, 1] | join(\", \") }}";
        let words = words(template, json!({ "x": hostile })).unwrap();
        assert_eq!(words.lead, hostile);
        assert_eq!(words.facts, [(hostile.into(), hostile.into())]);
        let table = &words.tables[0];
        assert_eq!([&table.title, &table.heads[0]], [hostile; 2]);
        assert_eq!(table.rows, [[hostile, hostile, &format!("{hostile}, 1")]]);
    }

    /// Clauses are joined by spaces, but for those that begin with a comma, a semicolon or a full stop; lines of a template without a text
    /// leave nothing.
    #[test]
    fn clauses_become_a_sentence() {
        let template =
            "[lead]\nThe tip\n{% if no %}stays{% else %}goes{% endif %}\n\n  , at rest\n; done\n.";
        let words = words(template, json!({})).unwrap();
        assert_eq!(words.lead, "The tip goes, at rest; done.");
    }

    /// A field that a summary lacks is a dash or nothing, and no error: other versions wrote fewer fields.
    #[test]
    fn missing_fields_are_nothing() {
        let template = "[facts]
            a: {{ summary.none.at.all | m(\"m\") }}
            b: {{ summary.v | vector }}
            c: {{ (1e3 * (summary.none | number)) | percent }}
            {% for x in summary.none %}{{ x }}: 1{% endfor %}
            {% for x in summary.null %}{{ x }}: 1{% endfor %}
            d: {{ summary.null }}{{ 1 | counted(\"point\") }}, {{ 2 | counted(\"point\") }}";
        let summary = json!({ "summary": { "v": [0.5, -1.0, 1e-4], "null": null } });
        let values: Vec<String> = (words(template, summary).unwrap().facts.into_iter())
            .map(|(_, value)| value)
            .collect();
        let vector = "(0.5, \u{2212}1, 1\u{b7}10\u{207b}\u{2074})";
        assert_eq!(values, ["– m", vector, "– %", "1 point, 2 points"]);
    }

    /// Curves draw columns by their names, and a template knows their extent; what there is not is an error.
    #[test]
    fn charts_draw_columns() {
        let template = "[chart S | T | m]
            {% if columns.y.known and columns.y.high == 2 %}f: x | t | y | hold | band t{% endif %}";
        let chart = words(template, json!({})).unwrap().charts.remove(0);
        assert_eq!(
            [&*chart.x_name, &*chart.x_unit, &*chart.unit],
            ["time", "s", "m"]
        );
        let curve = &chart.series[0];
        assert_eq!([&curve.x, &curve.band], [&[0.0, 1.0]; 2]);
        assert!(curve.hold && !curve.dashed && curve.y[1] == 2.0);
        for fault in [
            "[chart]\nf: x | t | z",
            "[chart]\nf: x | t | y | wavy",
            "[poem]",
        ] {
            assert!(words(fault, json!({})).is_err(), "{fault}");
        }
    }

    /// Facts that two lists share are left out, the others stand beside each other.
    #[test]
    fn differing_facts_stand_beside_each_other() {
        let rows = differing("a: 1\nb: 2\nb: 3\n", "\na: 1\n  c: 4\n");
        let rows: Vec<[&str; 3]> = rows
            .iter()
            .map(|row| row.each_ref().map(|s| &**s))
            .collect();
        assert_eq!(rows, [["b", "2; 3", "–"], ["c", "–", "4"]]);
    }

    /// In HTML, values open no element and end no attribute.
    #[test]
    fn documents_escape_values() {
        let page = fill(
            &[("page.html", "<p title=\"{{ x }}\">{{ x }}</p>")],
            "page.html",
            &json!({ "x": "<b> & \"" }),
        );
        let text = "&lt;b&gt; &amp; &quot;";
        assert_eq!(page.unwrap(), format!("<p title=\"{text}\">{text}</p>"));
    }
}
