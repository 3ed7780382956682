//! Numbers as texts of a page.

/// A number as text: with `digits` significant digits, zeros at the end left out, and a power of ten where it is very small or large.
pub fn figure(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    if value == 0.0 {
        return "0".into();
    }
    let digits = digits.max(1);
    let scientific = format!("{value:.*e}", digits - 1);
    let (mantissa, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let trimmed = |text: &str| {
        let text = match text.contains('.') {
            true => text.trim_end_matches('0').trim_end_matches('.'),
            false => text,
        };
        text.replace('-', "\u{2212}")
    };
    if (-3..6).contains(&exponent) {
        let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
        // Rounded first: before the point there may be more places than digits.
        let rounded: f64 = scientific.parse().unwrap_or(value);
        return trimmed(&format!("{rounded:.decimals$}"));
    }
    let plain = exponent.to_string();
    let superscript = plain.chars().map(|c| match c {
        '-' => '\u{207b}',
        '1' => '\u{b9}',
        '2' => '\u{b2}',
        '3' => '\u{b3}',
        digit => char::from_u32(0x2070 + digit.to_digit(10).unwrap_or(0)).unwrap_or(digit),
    });
    let power: String = superscript.collect();
    format!("{}\u{b7}10{power}", trimmed(mantissa))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three digits, no zeros at the end, powers of ten outside of what reads well.
    #[test]
    fn figures_have_the_digits_that_were_asked_for() {
        for (value, text) in [
            (0.0, "0"),
            (0.5, "0.5"),
            (2.4361, "2.44"),
            (-12.0, "\u{2212}12"),
            (333_333.3, "333000"),
            (1234567.0, "1.23\u{b7}10\u{2076}"),
            (0.001, "0.001"),
            (3.284e-11, "3.28\u{b7}10\u{207b}\u{b9}\u{b9}"),
            (1e-20, "1\u{b7}10\u{207b}\u{b2}\u{2070}"),
            (f64::NAN, "–"),
        ] {
            assert_eq!(figure(value, 3), text);
        }
    }
}
