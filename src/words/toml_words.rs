//! Messages of the TOML parser in plain words: no names of types, with what was probably meant.
//! PURE. Uses: `near`. Never: the text of a file except the value in question.

use crate::near::{did_you_mean, nearest};

/// Endings of keys that state a unit.
const UNITS: [&str; 29] = [
    "nm", "um", "mm", "cm", "m", "us", "ms", "s", "min", "h", "hz", "khz", "n", "mn", "kn", "v",
    "mv", "a", "ma", "ohm", "kohm", "deg", "rad", "mpa", "kpa", "pa", "g", "kg", "bytes",
];
/// Most keys that are listed for an unknown one that resembles none.
const LISTED: usize = 16;

/// What an error of the parser means.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Meaning {
    /// A required key is missing.
    Missing(String),
    /// The value, or the text at the place, must be another one.
    Limit(String),
}

/// Explains a message of the parser; `value` is the value as written, empty if there is none.
pub fn meaning(message: &str, value: &str) -> Meaning {
    let message = message.lines().next().unwrap_or_default();
    if let Some(key) = message.strip_prefix("missing field ") {
        return Meaning::Missing(key.trim_matches('`').into());
    }
    let named = quoted(message);
    let (found, known) = named.split_first().map_or(("", &[][..]), |(f, known)| (*f, known));
    if message.starts_with("unknown field") {
        return Meaning::Limit(unknown_key(found, known));
    }
    if message.starts_with("unknown ") && message.contains("expected") {
        let meant = did_you_mean(found, known.iter().copied());
        return Meaning::Limit(format!("must be one of {}{meant}", known.join(", ")));
    }
    let typed = ["invalid type: ", "invalid value: ", "invalid length "];
    let wrong = typed.iter().find_map(|start| message.strip_prefix(start));
    if let Some((found, expected)) = wrong.and_then(|rest| rest.rsplit_once(", expected ")) {
        let hint = hint(found, expected, value);
        return Meaning::Limit(format!("must be {}{hint}", noun(expected)));
    }
    Meaning::Limit(syntax(message, value))
}

/// The words of a message in back quotes.
fn quoted(message: &str) -> Vec<&str> {
    message.split('`').skip(1).step_by(2).collect()
}

fn unknown_key(key: &str, known: &[&str]) -> String {
    let split = |key: &str| {
        let (stem, unit) = key.rsplit_once('_')?;
        UNITS.contains(&unit).then(|| (stem.to_owned(), unit.to_owned()))
    };
    let typed = key.to_lowercase();
    let other_unit = |known: &&&str| match (split(&typed), split(known)) {
        (Some((a, one)), Some((b, other))) => a == b && one != other,
        _ => false,
    };
    let no_unit = |known: &&&str| split(known).is_some_and(|(stem, _)| stem == typed);
    if let Some(same) = known.iter().find(other_unit) {
        return format!("unknown key; units are fixed: {same}");
    }
    if let Some(same) = known.iter().find(no_unit) {
        return format!("unknown key; the unit is part of the name: {same}");
    }
    match nearest(key, known.iter().copied()) {
        Some(name) => format!("unknown key; did you mean `{name}`?"),
        None if known.is_empty() || known.len() > LISTED => "unknown key".into(),
        None => format!("unknown key; the keys here are {}", known.join(", ")),
    }
}

/// What a value must be, for a type of the parser.
fn noun(expected: &str) -> String {
    match expected {
        "u8" => "a whole number from 0 to 255".into(),
        "u16" => "a whole number from 0 to 65535".into(),
        "u32" | "u64" | "u128" | "usize" => "a whole number, 0 or more".into(),
        "i8" | "i16" | "i32" | "i64" | "i128" | "isize" => "a whole number".into(),
        "f32" | "f64" => "a number".into(),
        "a boolean" | "bool" => "true or false".into(),
        "a string" | "str" | "a borrowed string" | "string or table" | "a character" => {
            "text in quotes".into()
        }
        "a sequence" => "a list, in [ ]".into(),
        "a map" => "a table".into(),
        other if other.starts_with("struct ") || other.starts_with("internally tagged ") => {
            "a table".into()
        }
        other if other.starts_with("enum ") || other.starts_with("variant ") => {
            "text in quotes".into()
        }
        other => {
            let length = ["an array of length ", "a tuple of size "];
            match length.iter().find_map(|start| other.strip_prefix(start)) {
                Some(length) => format!("a list of {length} entries"),
                None => other.into(),
            }
        }
    }
}

/// What may have been meant by a value of another type.
fn hint(found: &str, expected: &str, value: &str) -> String {
    let is_number = noun(expected).contains("number");
    let Some(inner) = value.strip_prefix(['"', '\'']).map(|v| v.trim_end_matches(['"', '\'']))
    else {
        return match found.starts_with("integer") && value.len() > 9 && is_number {
            true => "; this one is too large".into(),
            false => String::new(),
        };
    };
    if !found.starts_with("string") {
        return String::new();
    }
    let is_boolean = matches!(expected, "a boolean" | "bool");
    if (is_number && inner.parse::<f64>().is_ok()) || (is_boolean && inner.parse::<bool>().is_ok())
    {
        return ", without quotes".into();
    }
    match is_number && inner.starts_with(|c: char| c.is_ascii_digit()) {
        true => " without quotes and unit: the unit is fixed".into(),
        false => String::new(),
    }
}

/// An error of the syntax.
fn syntax(message: &str, value: &str) -> String {
    let known = match message.split(", expected").next().unwrap_or_default() {
        "duplicate key" => "is stated twice",
        "invalid basic string" | "invalid literal string" => {
            "text ends with a quotation mark on the line where it starts"
        }
        "missing comma between array elements" | "unclosed array" => {
            "the entries of a list are separated by commas, and it ends with ]"
        }
        "unclosed table" => "the name of a table ends with ]",
        "unclosed inline table" | "missing comma between key-value pairs" => {
            "the entries of { } are separated by commas, and it ends with }"
        }
        "key with no value" => "a key is followed by = and its value",
        "extra `=`" => "a key has one =",
        "unexpected leading zero" => "a number has no leading zero",
        "invalid boolean" => "true and false are written in small letters",
        "unexpected key or value" if value.contains(',') && !value.contains(['[', '{']) => {
            "a decimal number has a point, not a comma"
        }
        "unexpected key or value" => "a line ends after its value",
        "string values must be quoted" if value.is_empty() => "the value is missing",
        "string values must be quoted" if value.starts_with(['“', '”', '‘', '’', '„']) => {
            "quotes must be straight: \""
        }
        "string values must be quoted" if lacks_comma(value) => "a comma is missing between values",
        "string values must be quoted" if value.starts_with(|c: char| c.is_ascii_digit()) => {
            "a number has no unit: the unit is in the name of its key"
        }
        "string values must be quoted" => "text must be in quotes",
        _ => return message.into(),
    };
    known.into()
}

/// Whether a list has numbers with only a space between them.
fn lacks_comma(value: &str) -> bool {
    let numbers = |entry: &str| {
        let words = entry.split_whitespace().map(|word| word.trim_matches(['[', ']']));
        let are_numbers: Vec<bool> = words.map(|word| word.parse::<f64>().is_ok()).collect();
        are_numbers.len() > 1 && are_numbers.iter().all(|is_number| *is_number)
    };
    value.starts_with('[') && value.split(',').any(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limit(message: &str, value: &str) -> String {
        match meaning(message, value) {
            Meaning::Limit(limit) => limit,
            Meaning::Missing(key) => panic!("{key} is missing"),
        }
    }

    #[test]
    fn an_unknown_variant_has_a_proposal() {
        assert_eq!(limit("unknown field `x`, there are no fields", ""), "unknown key");
        let variant = "unknown variant `ia`, expected one of `iai`, `oriental-az`";
        assert_eq!(limit(variant, ""), "must be one of iai, oriental-az; did you mean `iai`?");
    }

    #[test]
    fn a_type_is_stated_without_its_name() {
        let of = |expected: &str| limit(&format!("invalid type: map, expected {expected}"), "");
        assert_eq!(of("struct RealHex"), "must be a table");
        assert_eq!(of("an array of length 2"), "must be a list of 2 entries");
        assert_eq!(limit("the map must be 4x20", "\"4\""), "the map must be 4x20");
    }

    #[test]
    fn an_error_of_the_syntax_states_the_rule() {
        let quoted = "string values must be quoted, expected literal string";
        for list in ["[1, 2 4]", "[[1.5, 2] , [3 4]]"] {
            assert_eq!(limit(quoted, list), "a comma is missing between values", "{list}");
        }
        assert_eq!(limit(quoted, "[one, 4]"), "text must be in quotes");
        let more = "unexpected key or value, expected newline, `#`";
        assert_eq!(limit(more, "1 2"), "a line ends after its value");
    }
}
