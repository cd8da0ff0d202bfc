//! Where a key of a TOML text is, and which key is at a place.
//! PURE. Uses: the parser's spans, `problem`. Never: files (the text is passed in), drawing.

use std::ops::Range;

use toml::de::{DeTable, DeValue};

use crate::problem::Place;

/// Longest value that is repeated in a message, characters.
const SHOWN_CHARS: usize = 60;

/// A key that was found in a text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Located {
    /// Place of its value, or of its name if the value is a table.
    pub place: Place,
    /// Place of its name; of an entry of a list that of the entry.
    pub name: Place,
    /// Whether it is the key itself; otherwise the closest table that contains it.
    pub is_exact: bool,
}

/// Finds a dotted key, such as `axes.x.travel_mm` or `contacts[1].x_mm`, or the closest table around it.
/// Returns nothing if the text is not TOML, or has not even the first part of the key.
pub fn locate(text: &str, key: &str) -> Option<Located> {
    let parsed = DeTable::parse(text).ok()?;
    let (mut value, mut found) = (None, None);
    let mut table = Some(parsed.get_ref());
    let parts: Vec<&str> = key.split(['.', '[']).map(|part| part.trim_end_matches(']')).collect();
    for (n, part) in parts.iter().enumerate() {
        let is_last = n + 1 == parts.len();
        if let Some((name, inner)) = table.and_then(|table| table.get_key_value(*part)) {
            let of_value = inner.span();
            let span = match inner.get_ref() {
                DeValue::Table(_) => name.span(),
                _ => of_value,
            };
            found = Some((span, name.span(), is_last));
            (table, value) = (inner.get_ref().as_table(), Some(inner.get_ref()));
            continue;
        }
        let list = value.and_then(DeValue::as_array);
        let entry = part.parse().ok().and_then(|index: usize| list?.get(index));
        let Some(entry) = entry else { break };
        found = Some((entry.span(), entry.span(), is_last));
        (table, value) = (entry.get_ref().as_table(), Some(entry.get_ref()));
    }
    let (span, name, is_exact) = found?;
    Some(Located { place: place(text, &span), name: place(text, &name), is_exact })
}

/// Returns the dotted key at a place of the text, with its value as written.
pub fn key_at(text: &str, span: &Range<usize>) -> Option<(String, String)> {
    let parsed = DeTable::parse(text).ok()?;
    in_table(text, parsed.get_ref(), span, "")
}

fn in_table(
    text: &str,
    table: &DeTable<'_>,
    span: &Range<usize>,
    path: &str,
) -> Option<(String, String)> {
    for (name, value) in table {
        let key = match path {
            "" => name.get_ref().to_string(),
            path => format!("{path}.{}", name.get_ref()),
        };
        let inner = match value.get_ref() {
            DeValue::Table(inner) => in_table(text, inner, span, &key),
            DeValue::Array(list) => list.iter().enumerate().find_map(|(n, entry)| {
                in_table(text, entry.get_ref().as_table()?, span, &format!("{key}[{n}]"))
            }),
            _ => None,
        };
        let is_here = |of: Range<usize>| of.start <= span.start && span.start < of.end;
        if inner.is_some() {
            return inner;
        }
        if is_here(name.span()) || is_here(value.span()) {
            let shown = match value.get_ref() {
                DeValue::Table(_) => "a table".into(),
                _ => shown(text.get(value.span()).unwrap_or_default()),
            };
            return Some((key, shown));
        }
    }
    None
}

/// A value as written, in one line, shortened.
fn shown(value: &str) -> String {
    let line = value.split_whitespace().collect::<Vec<_>>().join(" ");
    match line.char_indices().nth(SHOWN_CHARS) {
        Some((end, _)) => format!("{}..", &line[..end]),
        None => line,
    }
}

/// Place of a span of bytes: it ends with its first line, and has at least one character.
pub fn place(text: &str, span: &Range<usize>) -> Place {
    let start = text.floor_char_boundary(span.start);
    let before = &text[..start];
    let line_start = before.rfind('\n').map_or(0, |at| at + 1);
    let rest = text[start..].lines().next().unwrap_or_default();
    let end = rest.floor_char_boundary(span.end.saturating_sub(start));
    let number = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    Place {
        line: number(before.matches('\n').count() + 1),
        column: number(text[line_start..start].chars().count() + 1),
        length: number(rest[..end].chars().count().max(1)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "name = \"é\" # a name\n[axes.x]\nunit = 3\ntravel_mm = [\n  0.0,\n  9.5,\n]\n\
                        [[points]]\nat = { x_mm = 1 }\n";

    fn found(key: &str) -> Option<(u32, u32, u32, bool)> {
        let Located { place, is_exact, .. } = locate(TEXT, key)?;
        Some((place.line, place.column, place.length, is_exact))
    }

    #[test]
    fn a_key_is_found_or_else_the_table_around_it() {
        assert_eq!(found("name"), Some((1, 8, 3, true)));
        assert_eq!(found("axes.x.unit"), Some((3, 8, 1, true)));
        assert_eq!(found("axes.x.travel_mm[1]"), Some((6, 3, 3, true)));
        assert_eq!(found("axes.x.speed"), Some((2, 7, 1, false)));
        assert_eq!(found("points[0].at.x_mm"), Some((9, 15, 1, true)));
        assert_eq!(found("points[4].at"), found("points").map(|(l, c, n, _)| (l, c, n, false)));
        assert_eq!(locate(TEXT, "axes.x.unit").unwrap().name.length, 4);
        assert_eq!(found("seed"), None);
        assert_eq!(locate("[", "seed"), None);
    }

    #[test]
    fn the_key_at_a_place_is_named_with_its_value() {
        let key = |of: &str| {
            let start = TEXT.find(of).unwrap();
            key_at(TEXT, &(start..start + 1))
        };
        let named = |key: &str, value: &str| Some((key.to_owned(), value.to_owned()));
        assert_eq!(key("unit"), named("axes.x.unit", "3"));
        assert_eq!(key("9.5"), named("axes.x.travel_mm", "[ 0.0, 9.5, ]"));
        assert_eq!(key("x_mm"), named("points[0].at.x_mm", "1"));
        assert_eq!(key("# a"), None);
    }
}
