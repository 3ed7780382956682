//! The words of the command line as those of Python: `--out` is the argument `out`.

/// Options that no function of the package has; what a sentence says of them is about the command line.
const OF_THE_COMMAND_LINE: [&str; 3] = ["help", "resume", "skip-existing"];
/// Beginnings of the sentences that a command line ends with: its usage, and where its help is.
const ENDS: [&str; 2] = ["\n\nUsage:", "\n\nFor more information"];

/// Returns a message with the options of the command line named as arguments, and without its usage. Whole command lines, which stand in
/// quotes of code and begin with the program, stay.
pub(super) fn in_python(message: &str) -> String {
    let end = ENDS
        .iter()
        .filter_map(|words| message.find(words))
        .min()
        .unwrap_or(message.len());
    let parts: Vec<String> = (message[..end].split('`').enumerate())
        .map(
            |(i, part)| match i % 2 == 1 && part.starts_with("softarm ") {
                true => part.to_string(),
                false => with_arguments(part),
            },
        )
        .collect();
    parts.join("`")
}

/// Returns text with `--name` as `name`.
fn with_arguments(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find("--") {
        let (before, after) = (&rest[..at], &rest[at + 2..]);
        let length = after
            .find(|c: char| !(c.is_ascii_lowercase() || c == '-'))
            .unwrap_or(after.len());
        let name = &after[..length];
        let follows_a_word = before.ends_with(|c: char| c.is_alphanumeric() || c == '-');
        out.push_str(before);
        if follows_a_word || name.is_empty() || OF_THE_COMMAND_LINE.contains(&name) {
            out.push_str("--");
            out.push_str(name);
        } else {
            out.push_str(&name.replace('-', "_"));
        }
        rest = &after[length..];
    }
    out + rest
}
