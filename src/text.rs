//! Words from outside in messages for people. Names of files and of nodes may hold anything, so that what is printed of
//! them can neither begin a line of its own nor give orders to a terminal.

use std::borrow::Cow;
use std::path::Path;

/// A name as it may stand within a line: quoted and with control characters escaped where it has any.
pub fn plain(text: &str) -> Cow<'_, str> {
    if text.chars().any(char::is_control) { format!("{text:?}").into() } else { text.into() }
}

/// A path as it may stand within a line.
pub fn shown(path: &Path) -> String {
    plain(&path.to_string_lossy()).into_owned()
}

/// The same of words that may be of any length: what is too long is cut.
pub fn cut(text: &str) -> Cow<'_, str> {
    const LONGEST: usize = 300;
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{:?}…", &text[..end]).into(),
        None => plain(text),
    }
}

/// A text of several lines: its lines stay, every other control character is escaped.
pub fn lines(text: &str) -> Cow<'_, str> {
    let is_harmless = |c: char| !c.is_control() || c == '\n' || c == '\t';
    if text.chars().all(is_harmless) {
        return text.into();
    }
    let mut clean = String::with_capacity(text.len());
    for c in text.replace("\r\n", "\n").chars() {
        if is_harmless(c) { clean.push(c) } else { clean.extend(c.escape_default()) }
    }
    clean.into()
}

/// A message of possibly several lines below which others stand: every line but the first is indented.
pub fn indented(text: &str) -> String {
    lines(text).replace('\n', "\n    ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_stays_within_its_line_and_orders_nothing() {
        assert_eq!(plain("a wall\\ö.glb"), "a wall\\ö.glb");
        assert_eq!(plain("a\n\u{1b}[2Jb"), "\"a\\n\\u{1b}[2Jb\"");
        assert_eq!(shown(Path::new("x\ty/\u{9b}")), "\"x\\ty/\\u{9b}\"");
        assert_eq!(cut(&"ö".repeat(100_000)).chars().count(), 303);
    }

    #[test]
    fn lines_stay_lines() {
        assert_eq!(lines("a\n\tb"), "a\n\tb");
        assert_eq!(lines("a\r\n\u{1b}[2Jb\rc"), "a\n\\u{1b}[2Jb\\rc");
        assert_eq!(indented("a\nerror: b"), "a\n    error: b");
    }
}
