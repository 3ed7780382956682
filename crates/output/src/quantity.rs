//! Formats numbers for readers: four digits with a prefix of the unit, in lines of at most 80 columns.

/// Columns of a line.
const WIDTH: usize = 80;

/// Prefixes from 10⁻⁹ to 10⁹, a thousand apart.
const PREFIXES: [&str; 7] = ["n", "µ", "m", "", "k", "M", "G"];

/// A value with its unit: `12 mm` for 0.012 m. Beyond the prefixes in powers of ten; a mass is given in grams.
pub fn quantity(value: f64, unit: &str) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value} {unit}");
    }
    // The value rounded to four digits, so that 0.99999 is 1, not 1000 m.
    let rounded: f64 = format!("{value:.3e}").parse().unwrap_or(value);
    let thousands = (rounded.abs().log10() / 3.0 + 1e-12).floor() as i32;
    let Some(prefix) = usize::try_from(thousands + 3)
        .ok()
        .and_then(|at| PREFIXES.get(at))
    else {
        return format!("{value:.3e} {unit}");
    };
    let scaled = rounded / 10f64.powi(3 * thousands);
    format!("{} {prefix}{unit}", digits(scaled))
}

/// A mass in kg with the unit that suits it.
pub fn mass(kilograms: f64) -> String {
    if kilograms.abs() >= 1e3 {
        return format!("{} kg", digits(kilograms));
    }
    quantity(1e3 * kilograms, "g")
}

/// About four digits, without trailing zeros.
pub fn digits(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e6).contains(&value.abs()) {
        return format!("{value:.2e}");
    }
    let before = value.abs().max(1e-3).log10().floor() as i32;
    let after = usize::try_from(3 - before).unwrap_or(0);
    let text = format!("{value:.after$}");
    if !text.contains('.') {
        return text;
    }
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

/// A line that begins with a word in a column of its own, broken between words.
pub fn entry(word: &str, text: &str) -> String {
    const INDENT: usize = 12;
    let mut out = format!("  {word:<width$}", width = INDENT - 2);
    let mut column = INDENT;
    for (at, part) in text.split(' ').enumerate() {
        let length = part.chars().count();
        if at > 0 && column + 1 + length > WIDTH {
            out.push('\n');
            out.push_str(&" ".repeat(INDENT));
            column = INDENT;
        } else if at > 0 {
            out.push(' ');
            column += 1;
        }
        out.push_str(part);
        column += length;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Prefixes change at a thousand, also where rounding carries over; masses are never 0.0000 kg.
    #[test]
    fn quantities_have_prefixes() {
        for (value, unit, text) in [
            (0.012, "m", "12 mm"),
            (0.99999, "m", "1 m"),
            (1234.5, "N", "1.234 kN"),
            (6.9e4, "Pa", "69 kPa"),
            (1e-10, "N", "1.000e-10 N"),
            (0.0, "N", "0 N"),
            (-0.5, "N", "-500 mN"),
            (2e11, "Pa", "200 GPa"),
        ] {
            assert_eq!(quantity(value, unit), text);
        }
        for (kilograms, text) in [
            (1.85e-3, "1.85 g"),
            (7.85e-7, "785 µg"),
            (7.854, "7.854 kg"),
            (12e3, "12000 kg"),
        ] {
            assert_eq!(mass(kilograms), text);
        }
        assert_eq!(digits(0.303), "0.303");
        assert_eq!(digits(1e-5), "1.00e-5");
    }

    /// No line is longer than 80 columns, and no word is lost.
    #[test]
    fn entries_are_broken_between_words() {
        let text = "several words of some length ".repeat(8);
        let lines = entry("word", text.trim());
        assert!(lines.lines().all(|line| line.chars().count() <= 80));
        let words = |text: &str| {
            text.split_whitespace()
                .map(String::from)
                .collect::<Vec<_>>()
        };
        assert_eq!(words(&lines), words(&format!("word {text}")));
    }
}
