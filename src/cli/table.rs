//! A table as text: a line of heads, columns as wide as their longest cell, and a sentence instead of an
//! empty table.
//! Uses: `output`. Never: HTTP, a number that is not in a cell.

use std::fmt;

use serde_json::Value;

use super::output::{columns, grouped, terminal_width, wrapped};

/// Gap between two columns.
const GAP: &str = "  ";
/// Narrowest last column that is still cut to the width of the terminal, characters.
const LAST_COLUMN_MIN: usize = 12;
/// Narrowest last column in which a text that must be whole continues below itself, characters.
const WHOLE_TEXT_MIN: usize = 20;
/// Indentation of such a text on the lines below its row, if the row leaves it less.
const BELOW_ROW: usize = 4;

/// Side to which a column is aligned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Align {
    /// Left-aligned, for texts.
    Left,
    /// Right-aligned, for numbers.
    Right,
}

/// A table for people.
#[derive(Debug, Clone)]
pub struct Table {
    /// Name and side of each column; the unit belongs to the name.
    heads: Vec<(String, Align)>,
    rows: Vec<Vec<String>>,
    empty: &'static str,
    width: Option<usize>,
    is_whole: bool,
}

impl Table {
    /// A table without rows. `heads`: the names of the columns with `|` in between; a column of numbers has `>` after its
    /// name. `empty` is shown as long as the table has no row.
    pub fn new(heads: &str, empty: &'static str) -> Self {
        let column = |head: &str| match head.trim().strip_suffix('>') {
            Some(name) => (name.to_owned(), Align::Right),
            None => (head.trim().to_owned(), Align::Left),
        };
        Self::of_columns(heads.split('|').map(column).collect(), empty)
    }

    /// As [`Table::new`], for names that may contain any character.
    pub fn of_columns(heads: Vec<(String, Align)>, empty: &'static str) -> Self {
        Self { heads, rows: Vec::new(), empty, width: terminal_width(), is_whole: false }
    }

    /// A table whose last column is never cut, such as one of reasons: where it has no room, its text is below the row.
    pub fn whole(self) -> Self {
        Self { is_whole: true, ..self }
    }

    /// As on a terminal of this width.
    #[cfg(test)]
    pub fn at_width(self, width: usize) -> Self {
        Self { width: Some(width), ..self }
    }

    /// Adds a row: one cell for each head.
    pub fn push(&mut self, cells: impl IntoIterator<Item = String>) {
        let mut cells: Vec<String> = cells.into_iter().map(|cell| one_line(&cell)).collect();
        cells.resize(self.heads.len(), String::new());
        self.rows.push(cells);
    }

    fn widths(&self) -> Vec<usize> {
        let of_column = |(column, (head, _)): (usize, &(String, Align))| {
            let cells = self.rows.iter().map(|row| columns(&row[column]));
            cells.chain([columns(head)]).max().unwrap_or(0)
        };
        self.heads.iter().enumerate().map(of_column).collect()
    }

    fn line<'a>(&self, cells: impl Iterator<Item = &'a str>, widths: &[usize]) -> String {
        let (mut line, mut last) = (String::new(), 0);
        for ((cell, width), (_, align)) in cells.zip(widths).zip(&self.heads) {
            if !line.is_empty() {
                line += GAP;
            }
            last = line.len();
            let padding = " ".repeat(width.saturating_sub(columns(cell)));
            match align {
                Align::Left => line.extend([cell, &padding]),
                Align::Right => line.extend([&*padding, cell]),
            }
        }
        let line = line.trim_end();
        match self.width.filter(|width| columns(line) > *width) {
            Some(width) => self.fitted(line, last.min(line.len()), width),
            None => line.to_owned(),
        }
    }

    /// A line that is longer than a terminal is wide: a text in the last column continues below itself, if it begins in
    /// the left half; otherwise the line is cut, unless the table is `whole`. `last`: where that column begins, bytes.
    fn fitted(&self, line: &str, last: usize, width: usize) -> String {
        let (before, text) = line.split_at(last);
        let column = columns(before);
        let is_text = self.heads.last().is_some_and(|(_, align)| *align == Align::Left);
        let has_room = self.is_whole && column + WHOLE_TEXT_MIN <= width;
        if is_text && (column <= width / 2 || has_room) {
            return format!("{before}{}", indented(text, column, width - column));
        }
        if is_text && self.is_whole && !text.is_empty() {
            let text = indented(text, BELOW_ROW, width.saturating_sub(BELOW_ROW));
            return format!("{}\n{:BELOW_ROW$}{text}", before.trim_end(), "");
        }
        cut(line, width)
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.rows.is_empty() {
            return f.write_str(self.empty);
        }
        let widths = self.widths();
        f.write_str(&self.line(self.heads.iter().map(|(head, _)| head.as_str()), &widths))?;
        for row in &self.rows {
            write!(f, "\n{}", self.line(row.iter().map(String::as_str), &widths))?;
        }
        Ok(())
    }
}

/// A cell for a value that may be absent: `-`.
pub fn or_dash(value: Option<impl fmt::Display>) -> String {
    value.map_or_else(|| "-".into(), |value| value.to_string())
}

/// A cell for a count of an answer: `-` if it is absent.
pub fn count_or_dash(count: &Value) -> String {
    or_dash(count.as_u64().map(grouped))
}

/// Wraps a text; its further lines are indented.
fn indented(text: &str, indent: usize, width: usize) -> String {
    wrapped(text, width).replace('\n', &format!("\n{:indent$}", ""))
}

fn one_line(cell: &str) -> String {
    if cell.contains(['\n', '\r', '\t']) {
        return cell.split_whitespace().collect::<Vec<_>>().join(" ");
    }
    cell.to_owned()
}

/// Cuts a line to the width of a terminal, unless that is too narrow for anything.
fn cut(line: &str, width: usize) -> String {
    if width < LAST_COLUMN_MIN {
        return line.to_owned();
    }
    let mut used = 0;
    let beyond = line.char_indices().find(|(_, c)| {
        used += columns(c.encode_utf8(&mut [0; 4]));
        used >= width
    });
    let kept = &line[..beyond.map_or(line.len(), |(at, _)| at)];
    format!("{}…", kept.trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(width: Option<usize>) -> Table {
        Table { width, ..Table::new("run> | name | label", "there are no runs") }
    }

    #[test]
    fn columns_are_as_wide_as_their_longest_cell_and_lines_end_without_blanks() {
        let mut table = table(None);
        assert_eq!(table.to_string(), "there are no runs");
        table.push(["1".into(), "quickstart".into(), String::new()]);
        table.push(["1234".into(), "a\nb".into(), "virtual".into()]);
        let lines = ["run   name        label", "   1  quickstart", "1234  a b         virtual"];
        assert_eq!(table.to_string().lines().collect::<Vec<_>>()[1..], lines[1..]);
        assert_eq!(table.to_string().lines().next(), Some(" run  name        label"));
    }

    #[test]
    fn a_count_that_is_absent_is_not_zero() {
        let of = |count: Value| count_or_dash(&count);
        assert_eq!([of(33_000.into()), of(0.into()), of(Value::Null)], ["33,000", "0", "-"]);
    }

    #[test]
    fn a_line_is_cut_to_the_terminal_only() {
        let mut narrow = table(Some(16));
        narrow.push(["1".into(), "quickstart".into(), "virtual".into()]);
        assert_eq!(narrow.to_string().lines().last(), Some("  1  quickstart…"));
        narrow.width = None;
        assert_eq!(narrow.to_string().lines().last(), Some("  1  quickstart  virtual"));
    }

    #[test]
    fn a_wide_character_has_two_columns() {
        let mut named = table(None);
        named.push(["1".into(), "触覚".into(), "virtual".into()]);
        named.push(["2".into(), "skin".into(), "virtual".into()]);
        let lines = ["run  name  label", "  1  触覚  virtual", "  2  skin  virtual"];
        assert_eq!(named.to_string().lines().collect::<Vec<_>>(), lines);
        named.width = Some(12);
        assert_eq!(named.to_string().lines().nth(1), Some("  1  触覚…"));
        named.width = Some(14);
        assert_eq!(named.to_string().lines().nth(1), Some("  1  触覚  vi…"));
    }

    #[test]
    fn a_text_that_must_be_whole_continues_in_its_column_or_below_its_row() {
        let actions = |width| {
            let mut table = Table::new("action | who | why", "").whole().at_width(width);
            table.push(["pause".into(), "ada".into(), "the lamp of the lab was replaced".into()]);
            table.push(["stop".into(), "operator of bench 2".into(), String::new()]);
            table.to_string()
        };
        let head = "action  who                  why";
        let column = "pause   ada                  the lamp of the lab\n                             was replaced";
        let below = "pause   ada\n    the lamp of the lab was\n    replaced";
        let last = "stop    operator of bench 2";
        assert_eq!(actions(49), [head, column, last].join("\n"));
        assert_eq!(actions(32), [head, below, last].join("\n"));
    }

    #[test]
    fn a_text_in_the_last_column_continues_below_itself() {
        let events = |width| {
            let mut table = Table { width, ..Table::new("time | event", "") };
            table.push(["09:15".into(), "run paused by a person".into()]);
            table.to_string()
        };
        let wrapped = "time   event\n09:15  run paused by a\n       person";
        assert_eq!(events(Some(24)), wrapped);
        assert_eq!(events(Some(12)), "time   event\n09:15  run…", "the right half");
        assert_eq!(events(None), "time   event\n09:15  run paused by a person");
    }
}
