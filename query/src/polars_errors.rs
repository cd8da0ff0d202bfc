//! Errors of polars, each as a short sentence about the statement.
//! PURE. Uses: `words::near`, the errors of polars. Never: a plan, a syntax tree or a type of Rust.

use palpate_words::near::did_you_mean;
use polars::error::PolarsError;

/// Longest sentence, characters.
const CHARS_MAX: usize = 300;
/// Longest list of names in a sentence, characters.
const NAMES_MAX: usize = 150;
/// Types that CAST takes.
const TYPES: &str = "DOUBLE, REAL, INT, BIGINT, VARCHAR, BOOLEAN, DATE, TIME and TIMESTAMP";

/// Functions that polars knows, in addition to those in its own list.
const MORE_FUNCTIONS: [&str; 9] = [
    "array_agg",
    "datetime",
    "div",
    "normalize",
    "split_part",
    "string_agg",
    "string_to_array",
    "time",
    "trunc",
];

/// What to write in place of functions of other programs.
const INSTEAD: [(&str, &str); 18] = [
    ("bin", "floor(x / 2) * 2"),
    ("current_date", "a time such as '2027-01-15T08:00:00'"),
    ("current_timestamp", "a time such as '2027-01-15T08:00:00'"),
    ("date_trunc", "CAST(measured_at AS DATE), or strftime(measured_at, '%Y-%m-%d %H:00')"),
    ("datediff", "the difference of two times"),
    ("len", "length for texts, array_length for lists"),
    ("mean", "avg"),
    ("now", "a time such as '2027-01-15T08:00:00'"),
    ("percentile", "quantile_cont(x, 0.9)"),
    ("percentile_cont", "quantile_cont(x, 0.9)"),
    ("percentile_disc", "quantile_disc(x, 0.9)"),
    ("quantile", "quantile_cont(x, 0.9)"),
    ("std", "stddev"),
    ("stddev_pop", "stddev"),
    ("stdev_pop", "stddev"),
    ("to_char", "strftime(measured_at, '%Y-%m-%d %H:%M')"),
    ("var_pop", "variance"),
    ("width_bucket", "floor(x / 2) * 2"),
];

/// Columns that a person searches in another table, and the tables that have them.
const ELSEWHERE: [(&str, &str); 9] = [
    ("diameter_mm", "contacts"),
    ("force_n", "contacts"),
    ("pair", "voltages"),
    ("sim_voltage_v", "voltages"),
    ("sim_voltages_v", "frames"),
    ("voltage_v", "voltages"),
    ("voltages_v", "frames"),
    ("x_mm", "contacts"),
    ("y_mm", "contacts"),
];

/// Returns the sentence for an error of polars.
///
/// `tables`: names and columns of the tables that the statement reads; `typed`: the statement.
pub fn of_error(
    error: &PolarsError,
    tables: &[(String, Vec<String>)],
    typed: &str,
    memory_max_bytes: u64,
) -> String {
    let root = root(error);
    let text = root.to_string();
    if is_of_memory(&text) {
        return memory(memory_max_bytes);
    }
    let sentence = match root {
        PolarsError::ColumnNotFound(text) | PolarsError::SchemaFieldNotFound(text) => {
            column(text, tables, typed)
        }
        PolarsError::StructFieldNotFound(name) => format!("no field {name} in this column"),
        PolarsError::IO { .. } => {
            format!("a file of a table cannot be read: {}", first_line(&text))
        }
        _ => known(&text, tables).unwrap_or_else(|| plain(&text)),
    };
    short(&format!("sql: {sentence}"))
}

/// Returns the sentence for a panic of polars.
pub fn of_panic(said: &str, memory_max_bytes: u64) -> String {
    if is_of_memory(said) {
        return memory(memory_max_bytes);
    }
    // For a person who runs the program.
    eprintln!("palpate-query: {said}");
    "sql: this statement is beyond the query engine: write it in another way".into()
}

fn memory(memory_max_bytes: u64) -> String {
    // As the service reports it if an allocation has ended this process.
    let mib = memory_max_bytes >> 20;
    format!("sql: needs more than {mib} MiB of memory: select fewer rows or columns")
}

fn is_of_memory(text: &str) -> bool {
    let marks =
        ["OOM", "os error 12", "os error 11", "memory alloc", "allocate memory", "spawn thread"];
    marks.iter().any(|mark| text.contains(mark)) || text.contains("capacity overflow")
}

fn root(error: &PolarsError) -> &PolarsError {
    match error {
        PolarsError::Context { error, .. } | PolarsError::ExprContext { error, .. } => root(error),
        other => other,
    }
}

/// The text between the first pair of `mark`.
fn quoted(text: &str, mark: char) -> Option<&str> {
    text.split(mark).nth(1)
}

/// The texts between all pairs of `mark`.
fn all_quoted(text: &str, mark: char) -> Vec<&str> {
    text.split(mark).skip(1).step_by(2).collect()
}

fn first_line(text: &str) -> &str {
    text.lines().next().unwrap_or_default()
}

/// Names, as many as fit, separated by commas.
fn list<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    let mut text = String::new();
    for name in names {
        if text.len() + name.len() > NAMES_MAX {
            return text + ", ..";
        }
        if !text.is_empty() {
            text += ", ";
        }
        text += name;
    }
    text
}

/// The sentence for a column that does not exist where it is used.
fn column(text: &str, tables: &[(String, Vec<String>)], typed: &str) -> String {
    let name = quoted(text, '"').or_else(|| quoted(text, '\'')).unwrap_or(first_line(text));
    if name.len() < typed.len() && typed.contains(&format!("\"{name}\"")) && !is_plain(name) {
        return format!("no column {name}; a text is written with single quotes: '{name}'");
    }
    if typed.contains(&format!("= {name}")) && meant(name, tables).is_empty() {
        return format!("no column {name}; a text is written with single quotes: 'run-3'");
    }
    let here = text.split_once("valid columns: [").and_then(|(_, here)| here.split_once(']'));
    let here = here.map_or(vec![], |(here, _)| all_quoted(here, '"'));
    if tables.is_empty() {
        return format!("no column {name}: the statement has no FROM");
    }
    if tables.iter().any(|(_, columns)| columns.iter().any(|known| known == name)) {
        return format!(
            "no column {name} at this place of the statement; there are {}",
            list(here)
        );
    }
    no_column(name, None, tables, &here)
}

fn no_column(
    name: &str,
    within: Option<&str>,
    tables: &[(String, Vec<String>)],
    here: &[&str],
) -> String {
    let all = || tables.iter().flat_map(|(_, columns)| columns).map(String::as_str);
    if let Some((_, table)) = ELSEWHERE.iter().find(|(column, _)| *column == name)
        && !tables.iter().any(|(known, _)| known == table)
    {
        return format!("no column {name} here: it is in the table {table}");
    }
    let of_table = |table: &str| tables.iter().find(|(known, _)| known == table);
    let within = match within {
        Some(table) => table.to_owned(),
        None => list(tables.iter().map(|(table, _)| table.as_str())),
    };
    let meant = meant(name, tables);
    let there = match of_table(&within) {
        Some((_, columns)) => list(columns.iter().map(String::as_str)),
        None if !here.is_empty() => list(here.iter().copied()),
        None => list(all()),
    };
    format!("no column {name} in {within}{meant}; there are {there}")
}

/// `; did you mean ..?` for a column of the tables.
fn meant(name: &str, tables: &[(String, Vec<String>)]) -> String {
    let all = || tables.iter().flat_map(|(_, columns)| columns).map(String::as_str);
    let letters = |name: &str| {
        let mut letters: Vec<char> = name.to_lowercase().chars().collect();
        letters.sort_unstable();
        letters
    };
    // In a short name two exchanged letters are much.
    match all().find(|known| letters(known) == letters(name)) {
        Some(known) => format!("; did you mean `{known}`?"),
        None => did_you_mean(name, all()),
    }
}

/// True for a name that needs no quotes.
fn is_plain(name: &str) -> bool {
    name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

fn no_function(name: &str) -> String {
    if let Some((_, instead)) = INSTEAD.iter().find(|(other, _)| *other == name) {
        return format!("no function {name}: write {instead}");
    }
    let all = polars::sql::keywords::all_functions();
    let all = all.into_iter().filter(|known| !known.starts_with("read_")).chain(MORE_FUNCTIONS);
    format!("no function {name}{}", did_you_mean(name, all))
}

/// A type of polars, for a person.
fn kind(name: &str) -> String {
    let base = name.trim_start_matches("dyn ").to_lowercase();
    let base = base.split(['[', '(']).next().unwrap_or_default();
    let words = match base {
        "str" | "string" => "a text",
        "bool" | "boolean" => "a condition",
        "datetime" | "date" | "time" => "a time",
        "duration" => "a duration",
        "list" | "array" => "a list",
        "struct" => "a record",
        "null" => "null",
        _ if base.starts_with(['i', 'u', 'f', 'd']) => "a number",
        _ => "another kind",
    };
    words.to_owned()
}

/// `SimilarTo` as `SIMILAR TO`.
fn spaced(name: &str) -> String {
    let mut words = String::new();
    for c in name.chars().take_while(char::is_ascii_alphanumeric) {
        if c.is_ascii_uppercase() && !words.is_empty() {
            words.push(' ');
        }
        words.push(c.to_ascii_uppercase());
    }
    words
}

/// The sentence for a text of polars that is known.
fn known(text: &str, tables: &[(String, Vec<String>)]) -> Option<String> {
    let line = first_line(text);
    let has = |part: &str| text.contains(part);
    let single = || quoted(line, '\'').unwrap_or_default();
    Some(if line.starts_with("unsupported function") {
        no_function(single())
    } else if line.starts_with("no column named") {
        let names = all_quoted(line, '\'');
        no_column(names.first()?, names.get(1).copied(), tables, &[])
    } else if line.starts_with("no table or struct column named") {
        format!("no table {} in this FROM", single())
    } else if line.starts_with("no table or alias named") || line.starts_with("relation '") {
        format!(
            "no table {} at this place of the statement; a WITH clause needs another name than the \
             table that it reads",
            single()
        )
    } else if line.starts_with("ambiguous reference") {
        let name = quoted(line, '"')?;
        let several = line.split_once("use one of: ")?.1.trim_end_matches(')');
        format!("{name} is a column of several tables: write one of {several}")
    } else if has("should participate in the GROUP BY") {
        format!("{0} is neither in GROUP BY nor in an aggregate such as avg({0})", single())
    } else if has("duplicate output name") || has("is duplicated in the SELECT") {
        format!("the result has two columns {}: name one of them with AS", single())
    } else if line.starts_with("cannot compare string with numeric") {
        "a text cannot be compared with a number: a number has no quotes, a text has single quotes"
            .into()
    } else if line.starts_with("cannot compare 'date/datetime/time'") {
        "a time is compared with a text such as '2027-01-15T08:00:10' or '2027-01-15', UTC".into()
    } else if has("operation not supported for dtype") {
        let names = all_quoted(line, '`');
        let verb = if names.first()? == &"mean" { "avg" } else { names.first()? };
        format!("{verb} of {} is not possible", kind(names.get(1)?))
    } else if line.starts_with("arithmetic on dtypes") || has("not allowed on") {
        let kinds = line.trim_start_matches("arithmetic on dtypes ");
        let (_, kinds) = kinds.split_once("not allowed on ").unwrap_or(("", kinds));
        let (one, other) = kinds.split_once(" and ")?;
        let other = other.split(" is not").next()?;
        format!("arithmetic with {} and {} is not possible", kind(one), kind(other))
    } else if line.starts_with("invalid series dtype") {
        let names = all_quoted(line, '`');
        let is_named = !names.get(2)?.starts_with('_');
        let what = if is_named { names.get(2)? } else { "an argument" };
        let needed = kind(names.first()?);
        format!("{what} is {}; {needed} is needed here", kind(names.get(1)?))
    } else if line.starts_with("filter predicate must be") {
        let found = all_quoted(line, '`');
        format!("WHERE needs a condition, not {}", kind(found.get(1)?))
    } else if line.starts_with("conversion from") {
        let kinds = all_quoted(line, '`');
        let value = line.split_once(": [").and_then(|(_, values)| quoted(values, '"'));
        let value = value.map_or(String::new(), |value| format!(", such as '{value}'"));
        let name = single();
        let to = kind(kinds.get(1)?);
        format!("{name} has values that are not {to}{value}: TRY_CAST makes them null")
    } else if has("regex parse error") {
        let cause = text.lines().last()?.trim_start_matches("error: ");
        format!("the regular expression is invalid: {cause}")
    } else if line.starts_with("regex error") {
        "the regular expression is too large".into()
    } else if line.starts_with("unsupported SQL join constraint") {
        "JOIN needs ON or USING; CROSS JOIN combines every row with every row".into()
    } else if line.starts_with("unexpected subquery") || line.starts_with("subquery comparisons") {
        "a subquery may be in FROM, after IN or EXISTS, and in a comparison of WHERE".into()
    } else if line.starts_with("only 'ROWS BETWEEN") {
        "a window has no frame but ROWS BETWEEN UNBOUNDED PRECEDING AND CURRENT ROW".into()
    } else if line.starts_with("division with 'String'") {
        "arithmetic with a text is not possible".into()
    } else if line.contains(" requires an OVER clause with") {
        format!("{} needs OVER (ORDER BY ..)", line.split_whitespace().next()?.to_lowercase())
    } else if line.starts_with("LIKE/ILIKE pattern") {
        "LIKE needs a text with single quotes, such as 'run-%'".into()
    } else if line.starts_with("QUANTILE") {
        "a quantile is between 0 and 1, such as 0.9".into()
    } else if line.starts_with("array slice syntax") {
        "a part of a list is not possible: use the table voltages, WHERE position < 28".into()
    } else if line.starts_with("Expected array expression") {
        "UNNEST of a column follows CROSS JOIN: CROSS JOIN UNNEST(voltages_v) AS v".into()
    } else if line.starts_with("non-numeric arguments for LIMIT") {
        "LIMIT and OFFSET take a number that is not negative".into()
    } else if line.starts_with("datatype") {
        format!("CAST knows {TYPES}")
    } else if line.starts_with("operator PGOverlap") {
        "&& is not possible: write AND".into()
    } else if line.starts_with("expression ") || line.starts_with("operator ") {
        let name = line.split_whitespace().nth(1)?;
        format!("{} is not possible here", spaced(name))
    } else if line.starts_with("complex field access") {
        "only one step into a column is possible, such as voltages_v[1]: take the next in an outer \
         SELECT"
            .into()
    } else if line.starts_with("UNION requires") || line.contains("requires equal number") {
        let verb = line.split_whitespace().next()?;
        format!("both sides of {verb} need the same number of columns")
    } else if line.starts_with("unexpected value while building") {
        "a list of values needs values of one kind".into()
    } else if line.starts_with("no function matches") {
        let call = quoted(line, '`')?;
        format!("{call}: wrong number or kind of arguments")
    } else if line.contains("expects") && line.contains("(found") {
        let (name, rest) = line.split_once(" expects ")?;
        format!(
            "{} takes {}",
            name.to_lowercase(),
            rest.replace(" (found", ", not").replace(')', "")
        )
    } else {
        return None;
    })
}

/// The first line of a text of polars, without what is meant for programmers.
fn plain(text: &str) -> String {
    let line = first_line(text);
    let debug = [
        "{",
        "Span(",
        "Ident(",
        "Identifier(",
        "Function(",
        "Value(",
        "Subscript(",
        "Dot(",
        "Some(",
    ];
    let end = debug.iter().filter_map(|mark| line.find(mark)).min().unwrap_or(line.len());
    let line = line[..end].trim_end().trim_end_matches("found").trim_end();
    let line = line.trim_end_matches([':', ',', ';', '.']).trim_end();
    let line = line.replace(" is not currently supported", " is not possible");
    let line = line.replace(" is not supported", " is not possible");
    if line.is_empty() { "this statement is not possible".into() } else { line }
}

fn short(text: &str) -> String {
    if text.chars().count() <= CHARS_MAX {
        return text.to_owned();
    }
    text.chars().take(CHARS_MAX - 2).chain("..".chars()).collect()
}
