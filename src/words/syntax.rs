//! Parses a TOML text; errors of the parser become problems with file, key, value, limit and place.
//! PURE. Uses: `problem`, `locate`, `toml_words`. Never: files (the text is passed in).

use std::ops::Range;

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue, Deserializer};

use crate::locate::{key_at, place};
use crate::problem::Problem;
use crate::toml_words::{Meaning, meaning};

/// Most problems of one text or file that are reported at once.
pub const PROBLEMS_MAX: usize = 20;
/// Value of the problem of a key that must be given.
const ABSENT: &str = "absent";

/// Parses a text.
///
/// # Errors
/// Every key that is unknown or has a value of a wrong type, in the order of the text. If there is none: the
/// first key that is absent, or the first error of the syntax.
pub fn parse_toml<T: DeserializeOwned>(file: &str, text: &str) -> Result<T, Vec<Problem>> {
    toml::from_str(text).map_err(|first| problems::<T>(file, text, &first))
}

/// The parser stops at its first error. The following ones are found by parsing again without the key of the
/// last one. A key that is absent then is not reported, because it may be the one that was removed or misspelled:
/// parsing continues without its table.
fn problems<T: DeserializeOwned>(file: &str, text: &str, first: &toml::de::Error) -> Vec<Problem> {
    let mut found = vec![syntax_problem(file, text, first)];
    let Ok(mut parsed) = DeTable::parse(text) else { return found };
    let mut span = first.span();
    while found.len() < PROBLEMS_MAX
        && span.is_some_and(|span| without_key_at(parsed.get_mut(), &span))
    {
        let Err(error) = T::deserialize(Deserializer::from(parsed.clone())) else { break };
        let problem = syntax_problem(file, text, &error);
        span = error.span();
        match (problem.value == ABSENT, problem.at) {
            (false, _) => found.push(problem),
            (true, Some(_)) => {} // the table goes
            (true, None) => break,
        }
    }
    found.sort_by_key(|problem| problem.at.map(|at| (at.line, at.column)));
    found
}

/// Removes the innermost key whose name or value is at a place; returns whether there was one.
fn without_key_at(table: &mut DeTable<'_>, span: &Range<usize>) -> bool {
    let inner_is_removed = table.iter_mut().any(|(_, value)| match value.get_mut() {
        DeValue::Table(inner) => without_key_at(inner, span),
        DeValue::Array(list) => list.iter_mut().any(|entry| match entry.get_mut() {
            DeValue::Table(inner) => without_key_at(inner, span),
            _ => false,
        }),
        _ => false,
    });
    if inner_is_removed {
        return true;
    }
    let is_here = |of: Range<usize>| of.contains(&span.start);
    let here = table.iter().find(|(name, value)| is_here(name.span()) || is_here(value.span()));
    let name = here.map(|(name, _)| name.get_ref().to_string());
    name.is_some_and(|name| table.remove(name.as_str()).is_some())
}

/// Problem for an error of the parser: key (with its table) and value at the place that the error
/// refers to. Without such a key, the problem concerns the file as a whole.
fn syntax_problem(file: &str, text: &str, error: &toml::de::Error) -> Problem {
    let span = error.span();
    let (key, value) = span.as_ref().map_or_else(Default::default, |span| {
        let is_twice = error.message().starts_with("duplicate key");
        key_at(text, span).unwrap_or_else(|| key_of_line(text, span, is_twice))
    });
    let at = span.as_ref().map(|span| place(text, span));
    if span.as_ref().is_some_and(|span| text[span.start..].starts_with("[["))
        && error.message().contains("invalid type: map")
    {
        let limit = format!("must be one table: [{key}], not [[{key}]]");
        return Problem::new(file, &key, "a list of tables", limit).at(at);
    }
    match meaning(error.message(), &value) {
        Meaning::Missing(missing) => {
            // The place of a table is its heading, or its braces; that of the file is the whole text.
            let in_table = span.and_then(|span| text.get(span)).is_some_and(|shown| {
                shown.starts_with('{') || (shown.starts_with('[') && !shown.contains('\n'))
            });
            let (key, at) = match key.is_empty() || !in_table {
                true => (missing, None),
                false => (format!("{key}.{missing}"), at),
            };
            Problem::new(file, &key, ABSENT, "must be given").at(at)
        }
        Meaning::Limit(limit) if key.is_empty() => Problem::whole(file, limit).at(at),
        Meaning::Limit(limit) => Problem::new(file, &key, value, limit).at(at),
    }
}

/// Key and value of the line of a place, in a text that is not TOML; empty without a key, and unless the
/// place is in the value or `is_key` states that it is the key.
fn key_of_line(text: &str, span: &Range<usize>, is_key: bool) -> (String, String) {
    let before = text.get(..span.start).unwrap_or(text);
    let start = before.rfind('\n').map_or(0, |at| at + 1);
    let line = text[start..].lines().next().unwrap_or_default();
    let Some((key, value)) = line.split_once('=') else { return Default::default() };
    if !is_key && span.start <= start + key.len() {
        return Default::default();
    }
    let value = value.split(" #").next().unwrap_or_default().trim();
    let table = text[..start].lines().rev().find_map(table_name);
    let key = table.map_or_else(|| key.trim().into(), |table| format!("{table}.{}", key.trim()));
    (key, value.into())
}

fn table_name(line: &str) -> Option<&str> {
    let name = line.trim().strip_prefix('[')?;
    name.trim_start_matches('[').split_once(']').map(|(name, _)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only parsed, to be refused")]
    struct File {
        table: Table,
    }

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only parsed, to be refused")]
    struct Table {
        count: u32,
    }

    fn all_problems(text: &str) -> Vec<String> {
        let problems = parse_toml::<File>("f.toml", text).unwrap_err();
        problems.iter().map(Problem::to_string).collect()
    }

    #[test]
    fn all_keys_that_are_wrong_are_reported_at_once() {
        let text = "tabel = 3\n[table]\ncuont = 3\nb.c = { d = 4 }\n[[lists]]\ne = 5\n[[lists]]\n";
        assert_eq!(
            all_problems(text),
            [
                "f.toml: tabel = 3: unknown key; did you mean `table`? (line 1)",
                "f.toml: table.cuont = 3: unknown key; did you mean `count`? (line 3)",
                "f.toml: table.b = a table: unknown key; the keys here are count (line 4)",
                "f.toml: lists = [[lists]]: unknown key; the keys here are table (line 5)",
            ]
        );
        let text = "[table]\ncount = 'three'\ncuont = 3\n";
        assert_eq!(all_problems(text).len(), 2);
        let many: String = (0..50).map(|n| format!("key{n} = 1\n")).collect();
        assert_eq!(all_problems(&many).len(), PROBLEMS_MAX);
    }
}
