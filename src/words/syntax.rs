//! Converts the error of a TOML parser to a problem with file, key, value and limit in one line.
//! PURE. Uses: `problem`. Never: files (the text is passed in).

use crate::problem::Problem;

/// Problem for an error of the parser: key (with its table) and value of the line that the error
/// refers to. Without such a key, the problem concerns the file as a whole.
pub fn syntax_problem(file: &str, text: &str, error: &toml::de::Error) -> Problem {
    let message = error.message();
    let Some(span) = error.span().filter(|s| !s.is_empty()) else {
        return Problem::whole(file, message);
    };
    let before = &text[..span.start];
    let start = before.rfind('\n').map_or(0, |at| at + 1);
    let line = text[start..].lines().next().unwrap_or_default();
    let limit = format!("{message} (line {})", before.matches('\n').count() + 1);
    match line.split_once('=') {
        Some((key, value)) => {
            let value = value.split(" #").next().unwrap_or_default().trim();
            Problem::new(file, &in_table(&text[..start], key.trim()), value, limit)
        }
        None => match table_name(line) {
            Some(name) => Problem::new(file, name, "a table", limit),
            None => Problem::whole(file, limit),
        },
    }
}

/// Returns `key`, prefixed with the table that the preceding text ends in.
fn in_table(before: &str, key: &str) -> String {
    match before.lines().rev().find_map(table_name) {
        Some(table) => format!("{table}.{key}"),
        None => key.into(),
    }
}

fn table_name(line: &str) -> Option<&str> {
    line.trim().strip_prefix('[')?.split_once(']').map(|(name, _)| name)
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

    fn problem(text: &str) -> String {
        let error = toml::from_str::<File>(text).unwrap_err();
        syntax_problem("f.toml", text, &error).to_string()
    }

    #[test]
    fn an_unknown_key_is_named_with_its_table_value_and_the_keys_there_are() {
        assert_eq!(
            problem("# a file\n[table]\ncuont = 3 # three\n"),
            "f.toml: table.cuont = 3: unknown field `cuont`, expected `count` (line 3)"
        );
        assert_eq!(
            problem("[tabel]\n"),
            "f.toml: tabel = a table: unknown field `tabel`, expected `table` (line 1)"
        );
    }

    #[test]
    fn a_value_of_the_wrong_type_is_named_with_what_is_expected() {
        assert_eq!(
            problem("[table]\ncount = -3\n"),
            "f.toml: table.count = -3: invalid value: integer `-3`, expected u32 (line 2)"
        );
    }

    #[test]
    fn a_missing_table_is_named() {
        assert_eq!(problem(""), "f.toml: missing field `table`");
    }
}
