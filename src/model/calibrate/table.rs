//! A table of numbers: CSV with a header, `#` comments, and every invalid cell reported.
//! PURE. Uses: the csv crate, `problem`, `record`. Never: the meaning of the numbers.

use crate::problem::Problem;
use crate::record::Label;

/// Number of problems after which reading ends: a file in another format has one in every row.
const MOST_PROBLEMS: usize = 20;

/// A column that a table may have.
#[derive(Debug, Clone, Copy)]
pub struct Column {
    /// Name in the header.
    pub name: &'static str,
    /// Smallest and largest number allowed.
    pub within: [f64; 2],
    /// The limit as text, for messages.
    pub limit: &'static str,
    /// Whether a cell may be empty.
    pub may_be_empty: bool,
}

impl Column {
    /// Defines a column with a number in every row.
    pub const fn number(name: &'static str, within: [f64; 2], limit: &'static str) -> Self {
        Self { name, within, limit, may_be_empty: false }
    }

    /// Returns the column with empty cells allowed.
    pub const fn or_empty(self) -> Self {
        Self { may_be_empty: true, ..self }
    }
}

/// A row of numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Line in the file, from 1.
    pub line: u64,
    /// One number per requested column; `None` if the cell is empty or the file lacks the column.
    pub values: Vec<Option<f64>>,
}

impl Row {
    /// Problem of one cell of this row.
    pub fn problem(&self, file: &str, column: &str, value: impl ToString, limit: &str) -> Problem {
        cell_problem(file, self.line, column, &value.to_string(), limit)
    }
}

fn cell_problem(file: &str, line: u64, column: &str, value: &str, limit: &str) -> Problem {
    Problem::new(file, &format!("line {line}, {column}"), value, limit)
}

/// Reads a table. Columns may be in any order and some may be missing (the caller decides which);
/// an unknown column is a problem, since it is probably misspelt.
///
/// # Errors
/// Problems of the header, or up to about 20 problems of the cells.
pub fn read(file: &str, text: &str, columns: &[Column]) -> Result<Vec<Row>, Vec<Problem>> {
    // Spreadsheets begin their files with a byte order mark.
    let text = text.trim_start_matches('\u{feff}');
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .flexible(true)
        .from_reader(text.as_bytes());
    let whole = |error: csv::Error| vec![Problem::whole(file, error.to_string())];
    let header = reader.headers().map_err(whole)?.clone();
    let places = places(file, &header, columns).map_err(|problem| vec![problem])?;
    let (mut rows, mut problems) = (Vec::new(), Vec::new());
    let mut lines = Lines { text, byte: 0, line: 1 };
    for record in reader.records() {
        let record = record.map_err(whole)?;
        let line = lines.of(record.position().map_or(0, csv::Position::byte) as usize);
        match row(file, line, &record, header.len(), &places) {
            Ok(row) => rows.push(row),
            Err(found) => problems.extend(found),
        }
        if problems.len() >= MOST_PROBLEMS {
            break;
        }
    }
    if problems.is_empty() { Ok(rows) } else { Err(problems) }
}

/// Origin of a table: virtual if a comment above its header begins with `SYNTHETIC`, otherwise measured.
pub fn label(text: &str) -> Label {
    let above = text.trim_start_matches('\u{feff}').lines().map(str::trim);
    let mut above = above.take_while(|line| line.is_empty() || line.starts_with('#'));
    let is_synthetic = |line: &str| line.trim_start_matches(['#', ' ']).starts_with("SYNTHETIC");
    if above.any(is_synthetic) { Label::Virtual } else { Label::Measured }
}

/// Lines of records. The csv crate returns the position from which it searched for a record: blank
/// lines and comments may precede the record.
struct Lines<'a> {
    text: &'a str,
    byte: usize,
    line: u64,
}

impl Lines<'_> {
    /// The line of the record that was searched from a byte on; bytes must not decrease.
    fn of(&mut self, from: usize) -> u64 {
        for piece in self.text[self.byte..].split_inclusive('\n') {
            let content = piece.trim();
            let is_record = !content.is_empty() && !content.starts_with('#');
            if is_record && self.byte + piece.trim_end().len() > from {
                break;
            }
            self.byte += piece.len();
            self.line += 1;
        }
        self.line
    }
}

/// Index of each requested column in a record.
fn places<'a>(
    file: &str,
    header: &csv::StringRecord,
    columns: &'a [Column],
) -> Result<Vec<(&'a Column, Option<usize>)>, Problem> {
    let known = columns.iter().map(|c| c.name).collect::<Vec<_>>().join(", ");
    let limit = format!("the header may name {known}, separated by commas");
    if header.is_empty() {
        return Err(Problem::whole(file, format!("no header: {limit}")));
    }
    for (n, name) in header.iter().enumerate() {
        let twice = header.iter().take(n).any(|earlier| earlier == name);
        if twice || !columns.iter().any(|c| c.name == name) {
            let limit = if twice { "a column may occur only once" } else { &limit };
            return Err(Problem::new(file, &format!("header, column {}", n + 1), name, limit));
        }
    }
    let place = |c: &Column| header.iter().position(|name| name == c.name);
    Ok(columns.iter().map(|c| (c, place(c))).collect())
}

fn row(
    file: &str,
    line: u64,
    record: &csv::StringRecord,
    cells: usize,
    places: &[(&Column, Option<usize>)],
) -> Result<Row, Vec<Problem>> {
    if record.len() != cells {
        let limit = format!("must be {cells}, as in the header");
        return Err(vec![cell_problem(file, line, "cells", &record.len().to_string(), &limit)]);
    }
    let mut problems = Vec::new();
    let mut values = Vec::with_capacity(places.len());
    for &(column, place) in places {
        let Some(text) = place.and_then(|at| record.get(at)) else {
            values.push(None);
            continue;
        };
        let [low, high] = column.within;
        match text.parse::<f64>() {
            Ok(value) if (low..=high).contains(&value) => values.push(Some(value)),
            Err(_) if text.is_empty() && column.may_be_empty => values.push(None),
            _ => problems.push(cell_problem(file, line, column.name, text, column.limit)),
        }
    }
    if problems.is_empty() { Ok(Row { line, values }) } else { Err(problems) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: [Column; 2] = [
        Column::number("x_mm", [0.0, 10.0], "a number from 0 to 10"),
        Column::number("y", [-1.0, 1.0], "a number from -1 to 1"),
    ];

    fn problems(text: &str) -> Vec<String> {
        let found = read("t.csv", text, &COLUMNS).unwrap_err();
        found.iter().map(Problem::to_string).collect()
    }

    #[test]
    fn comments_blanks_order_and_a_byte_order_mark_do_not_matter() {
        let text = "\u{feff}# made by hand\n y , x_mm\n\n0.5, 2\r\n# half way\n -0.5,3e0\n";
        let rows = read("t.csv", text, &COLUMNS).unwrap();
        assert_eq!(rows.len(), 2);
        assert_eq!(rows[0].values, [Some(2.0), Some(0.5)]);
        assert_eq!(rows[1], Row { line: 6, values: vec![Some(3.0), Some(-0.5)] });
    }

    #[test]
    fn a_table_is_measured_unless_it_begins_with_the_comment_that_it_is_synthetic() {
        let of = |above: &str| label(&format!("{above}x_mm\n# SYNTHETIC row\n1\n"));
        assert_eq!(of("\u{feff}# bench 3\n\n#  SYNTHETIC, from Eq. 1\n"), Label::Virtual);
        assert_eq!([of(""), of("# bench 3\n")], [Label::Measured; 2]);
    }

    #[test]
    fn a_missing_column_is_left_to_whoever_asks() {
        assert_eq!(read("t.csv", "x_mm\n1\n", &COLUMNS).unwrap()[0].values, [Some(1.0), None]);
    }

    #[test]
    fn a_cell_may_be_empty_where_that_was_said() {
        let columns = [COLUMNS[0], COLUMNS[1].or_empty()];
        let rows = read("t.csv", "x_mm,y\n1,\n", &columns).unwrap();
        assert_eq!(rows[0].values, [Some(1.0), None]);
    }

    #[test]
    fn wrong_cells_are_named_with_line_column_and_limit() {
        let text = "# one\nx_mm,y\n11,0\n1,abc\n1\nNaN,\n1,0\n";
        assert_eq!(
            problems(text),
            [
                "t.csv: line 3, x_mm = 11: a number from 0 to 10",
                "t.csv: line 4, y = abc: a number from -1 to 1",
                "t.csv: line 5, cells = 1: must be 2, as in the header",
                "t.csv: line 6, x_mm = NaN: a number from 0 to 10",
                "t.csv: line 6, y = : a number from -1 to 1",
            ]
        );
    }

    #[test]
    fn a_wrong_header_is_named() {
        let limit = "the header may name x_mm, y, separated by commas";
        let wrong = format!("t.csv: header, column 1 = x_mm;y: {limit}");
        assert_eq!(problems("x_mm;y\n1;2\n"), [wrong]);
        let twice = "t.csv: header, column 2 = y: a column may occur only once";
        assert_eq!(problems("y,y\n"), [twice]);
        assert_eq!(problems("# nothing\n"), [format!("t.csv: no header: {limit}")]);
    }

    #[test]
    fn a_file_of_another_kind_does_not_flood_the_terminal() {
        let text = format!("x_mm,y\n{}", "a,b\n".repeat(1000));
        assert!(problems(&text).len() <= MOST_PROBLEMS + 1);
    }
}
