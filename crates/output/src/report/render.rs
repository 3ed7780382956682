//! The page as text: the template with its data, and numbers in words of a few digits.

use serde::Serialize;

use super::ComparisonData;
use super::ReportData;

/// The document, with places for title, data and the script that draws them.
const TEMPLATE: &str = concat!(
    include_str!("head.html"),
    include_str!("style.css"),
    include_str!("body.html"),
    include_str!("base.js"),
    include_str!("stage.js"),
    include_str!("bodies.js"),
    include_str!("arm.js"),
    include_str!("view.js"),
    include_str!("charts.js"),
    include_str!("image.js"),
    include_str!("sections.js"),
    include_str!("main.js"),
    include_str!("foot.html"),
);

/// The style sheet of all pages.
pub const PAGE_STYLE: &str = include_str!("style.css");
/// The words by which a page of softarm is told from other files.
pub const PAGE_MARK: &str = "<meta name=\"generator\" content=\"softarm\">";

/// The page: one HTML document that loads nothing else and works from a file.
///
/// The same data give the same text. Non-finite numbers become gaps in the charts.
pub fn render_report(data: &ReportData) -> String {
    render(data, &data.title)
}

/// The page of several results, made as that of one.
pub fn render_comparison(data: &ComparisonData) -> String {
    render(data, &data.title)
}

fn render(data: &impl Serialize, title: &str) -> String {
    let json = serde_json::to_string(data).expect("structs, vectors and JSON values serialize");
    // The data first: a title that spells a placeholder is then only text.
    TEMPLATE
        .replacen("{{data}}", &escape_json(&json), 1)
        .replacen("{{title}}", &escape_html(title), 1)
}

/// JSON that means the same and cannot end or open anything in a `<script>` element.
fn escape_json(json: &str) -> String {
    json.replace('<', "\\u003c")
        .replace('>', "\\u003e")
        .replace('&', "\\u0026")
        .replace('\u{2028}', "\\u2028")
        .replace('\u{2029}', "\\u2029")
}

fn escape_html(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::super::*;
    use super::*;
    use crate::motion::tests::record;

    fn data() -> ReportData {
        let motion = record(5, 3);
        let words = Words {
            lead: "The tip moves.".into(),
            facts: vec![("elements".into(), "2".into())],
            ..Words::default()
        };
        let arm = ReportArm {
            radius: vec![0.01; 3],
            base: Some([0.0; 3]),
            gravity: [0.0, 0.0, -9.81],
            length: 1.0,
            payload: 0.0,
        };
        let summary = serde_json::json!({"schema_version": 1, "scene": "reach"});
        let frames = ReportMotion::thinned(&motion, 240);
        ReportData {
            target: Some(ReportTarget {
                position: Some([0.3, 0.0, 0.1]),
                directions: None,
            }),
            energy: Some(ReportEnergy::thinned(&motion, 240)),
            ..ReportData::of(ReportCommand::Solve, &summary, words, arm, frames)
        }
    }

    fn embedded_json(page: &str) -> Value {
        let (_, rest) = page
            .split_once(r#"<script id="data" type="application/json">"#)
            .unwrap();
        let (json, _) = rest.split_once("</script>").unwrap();
        serde_json::from_str(json).unwrap()
    }

    /// Strings that end scripts, open comments or spell placeholders arrive as text, and open no element.
    #[test]
    fn hostile_strings_stay_text() {
        let hostile = "</script><script>alert(1)</script><!-- <img src=x onerror=alert(2)> \
                       & \u{2028} {{title}} {{data}} ]]> \" ' \\";
        let mut spoiled = data();
        spoiled.title = hostile.into();
        spoiled.words.verdict.text = hostile.into();
        spoiled.words.facts = vec![(hostile.into(), hostile.into())];
        spoiled.summary = serde_json::json!({ hostile: hostile });
        spoiled.obstacles = Some(ReportObstacles {
            t: vec![0.0],
            bodies: vec![ReportObstacle {
                name: hostile.into(),
                shape: ReportShape::HalfSpace {
                    point: [0.0; 3],
                    normal: [0.0, 0.0, 1.0],
                },
                velocity: [0.0; 3],
                margin: 0.0,
                clearance: vec![0.5],
                is_touched: false,
            }],
        });
        let page = render_report(&spoiled);
        let tags = |text: &str| text.matches('<').count();
        assert_eq!(tags(&page), tags(TEMPLATE));
        assert!(!page.contains("<!--"));
        let json = embedded_json(&page);
        assert_eq!(json["title"], hostile);
        assert_eq!(json["verdict"]["text"], hostile);
        assert_eq!(json["facts"][0][1], hostile);
        assert_eq!(json["summary"][hostile], hostile);
        let body = &json["obstacles"]["bodies"][0];
        assert_eq!(body["name"], hostile);
        assert_eq!(body["shape"]["kind"], "half_space");
    }

    /// Equal data give equal bytes.
    #[test]
    fn page_is_deterministic() {
        assert_eq!(render_report(&data()), render_report(&data()));
    }

    /// Nothing in the page names another resource, and its policy forbids loading one.
    #[test]
    fn page_is_self_contained() {
        let page = render_report(&data());
        for load in [
            "http://", "https://", "src=", "href=", "url(", "@import", "import(",
        ] {
            assert!(!page.contains(load), "{load}");
        }
        assert!(page.contains("default-src 'none'"));
    }

    /// Non-finite numbers become null, so that the page still parses.
    #[test]
    fn non_finite_numbers_become_null() {
        let mut spoiled = data();
        if let Some(energy) = &mut spoiled.energy {
            energy.kinetic[1] = f64::NAN;
            energy.elastic[1] = f64::INFINITY;
        }
        let json = embedded_json(&render_report(&spoiled));
        assert!(json["energy"]["kinetic"][1].is_null());
        assert!(json["energy"]["elastic"][1].is_null());
    }

    /// Frames take positions, the first column of the rotations, and the tip from the rows that are kept; the tip with all digits, the
    /// rest rounded.
    #[test]
    fn frames_are_rows_of_the_record() {
        let mut record = record(9, 3);
        for values in [&mut record.x, &mut record.rotation] {
            (0..values.len()).for_each(|i| values[i] = (i as f64).sin());
        }
        let motion = ReportMotion::thinned(&record, 3);
        assert_eq!(motion.t, [record.t[0], record.t[4], record.t[8]]);
        let (row, node) = (4, 1);
        let at = (row * 3 + node) * 9;
        for (axis, part) in [0, 3, 6].into_iter().enumerate() {
            let off = f64::from(motion.d1[1][node][axis]) - record.rotation[at + part];
            assert!(off.abs() < 0.6 * DIRECTOR_DIGIT);
        }
        let tip = (row * 3 + 2) * 3;
        assert_eq!(motion.tip[1], record.x[tip..tip + 3]);
        for (x, tip) in motion.x[1][2].into_iter().zip(motion.tip[1]) {
            assert!((f64::from(x) - tip).abs() < 0.6 * POSITION_DIGIT);
        }
        // What has no size to round by stays as it is.
        assert_eq!(rounded(3.0, f64::NAN), 3.0);
        assert_eq!(rounded(0.0, 0.0), 0.0);
    }

    /// A field takes its codes back to its values within half a step, and what is only noise is none.
    #[test]
    fn fields_are_coded_to_three_digits() {
        let values = vec![vec![0.0, 0.25], vec![-2.0, 1.5]];
        let field = ReportField::of("twist", "1/m", false, Some(0.0), 1e-9, &values).unwrap();
        assert_eq!([field.low, field.high], [-2.0, 2.0]);
        let step = (field.high - field.low) / f64::from(ReportField::CODES);
        for (codes, row) in field.codes.iter().zip(&values) {
            for (code, value) in codes.iter().zip(row) {
                let back = field.low + step * f64::from(*code);
                assert!((back - value).abs() <= 0.5 * step * (1.0 + 1e-12));
            }
        }
        let noise = vec![vec![1e-12, -1e-13]];
        assert!(ReportField::of("twist", "1/m", false, Some(0.0), 1e-9, &noise).is_none());
    }
}
