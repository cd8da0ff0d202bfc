//! A CSV file of trials: its header states which cells are voltages, contacts and other columns.
//! Uses: csv, `batch`, `line_limit`, `file_kind`. Never: more than a page of rows in memory.
//!
//! The separator is the one of comma, semicolon and tab that is most frequent in the header. Rows count from
//! 0, without the header, as in a Parquet file.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{DataType, Field, Schema};
use csv::{ByteRecord, ReaderBuilder};

use super::batch;
use super::line_limit::{Allowance, LINE_MAX_BYTES, LineLimit};
use crate::dataset::error::{DatasetError, DatasetResult};
use crate::dataset::import::columns::{FRAMES_V, Scalar, scalar};
use crate::dataset::import::extent::Extent;
use crate::dataset::import::{BATCH_TRIALS, whole};
use crate::dataset::schema::VOLTAGES_V;
use crate::file_kind::FileKind;
use crate::plain::counted;
use crate::problem::Problem;
use crate::simulate::schema::{CONTACTS, SIM_VOLTAGES_V};
use crate::store::{Contact, IMPORTED_CONTACTS_MAX};
use crate::syntax::PROBLEMS_MAX;

/// Largest TOML file that is recognised in place of a table, bytes.
const TOML_MAX_BYTES: u64 = 1 << 20;
/// Separators of cells.
const SEPARATORS: [u8; 3] = *b",;\t";
/// Columns of frames, and how the names of their cells begin.
const FRAMES: [(&str, &str); 2] = [(VOLTAGES_V, "v"), (SIM_VOLTAGES_V, "sim_voltages_v_")];
/// Fields of a contact: the stem of the name and its unit.
const CONTACT_STEMS: [(&str, &str); 4] =
    [("x", "_mm"), ("y", "_mm"), ("force", "_n"), ("diameter", "_mm")];

/// A CSV file whose header has been read and whose rows have been counted.
#[derive(Debug)]
pub struct Csv {
    path: PathBuf,
    file: String,
    separator: u8,
    layout: Layout,
    rows: u64,
    /// Number of contacts, at most.
    contacts: u64,
}

/// The cells of a row by their meaning.
#[derive(Debug, Default)]
struct Layout {
    /// Cells of the frames, by channel; empty if the file has none.
    frames: [Vec<usize>; 2],
    /// Cells of the fields of each contact.
    contacts: Vec<[Option<usize>; 4]>,
    /// Cell of contacts as JSON.
    json: Option<usize>,
    scalars: Vec<(&'static str, Scalar, usize)>,
    left_out: Vec<String>,
}

/// Meaning of a column.
enum Meaning {
    /// A channel of frame 0 (measured) or 1 (simulated).
    Channel(usize, usize),
    /// A field of a contact; number 0 if the name has none.
    Contact(usize, usize),
    Json,
    Scalar(&'static str, Scalar),
    Other,
}

/// A number without sign.
fn digits(text: &str) -> Option<usize> {
    text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok())?
}

fn meaning(name: &str) -> Meaning {
    let item = |column: &str| {
        let rest = name.strip_prefix(column)?;
        let inside = |rest: &str| rest.strip_prefix('[')?.strip_suffix(']').and_then(digits);
        rest.strip_prefix('_').and_then(digits).or_else(|| inside(rest))
    };
    if let Some(channel) = name.strip_prefix('v').and_then(digits).or_else(|| item(VOLTAGES_V)) {
        return Meaning::Channel(0, channel);
    }
    if let Some(channel) = item(SIM_VOLTAGES_V) {
        return Meaning::Channel(1, channel);
    }
    for (field, (stem, unit)) in CONTACT_STEMS.into_iter().enumerate() {
        let number = name.strip_prefix(stem).and_then(|rest| rest.strip_suffix(unit));
        match number {
            Some("") => return Meaning::Contact(0, field),
            Some(number) => match digits(number) {
                Some(number) if number > 0 => return Meaning::Contact(number, field),
                _ => {}
            },
            None => {}
        }
    }
    if name == CONTACTS {
        return Meaning::Json;
    }
    match scalar(name) {
        Some((known, scalar)) => Meaning::Scalar(known, scalar),
        None => Meaning::Other,
    }
}

/// Whether a column is one of raw frames, such as `frames_v_0_12`; `frames_valid` is another one.
fn is_of_frames(name: &str) -> bool {
    name.strip_prefix(FRAMES_V).is_some_and(|rest| !rest.contains(char::is_alphabetic))
}

impl Layout {
    /// Reads a header. `file` is the name of the file in messages.
    ///
    /// # Errors
    /// A problem for each column that occurs twice, channel that is absent, and mixture of forms.
    fn of(file: &str, header: &ByteRecord) -> Result<Self, Vec<Problem>> {
        let mut layout = Self::default();
        let mut problems = Vec::new();
        let mut channels = [BTreeMap::new(), BTreeMap::new()];
        let mut contacts: BTreeMap<usize, [Option<usize>; 4]> = BTreeMap::new();
        let mut scalars: BTreeMap<&str, (Scalar, usize)> = BTreeMap::new();
        let names = || header.iter().map(|name| String::from_utf8_lossy(name).trim().to_owned());
        if let Some(name) = names().find(|name| is_of_frames(name)) {
            let limit = "must be in a Parquet, NPZ or MAT file: a cell holds no frames";
            problems.push(Problem::new(file, &name, "a column", limit));
        }
        for (at, name) in names().enumerate() {
            let twice = match meaning(&name) {
                Meaning::Channel(frame, channel) => channels[frame].insert(channel, at).is_some(),
                Meaning::Contact(number, field) => {
                    contacts.entry(number).or_default()[field].replace(at).is_some()
                }
                Meaning::Json => layout.json.replace(at).is_some(),
                Meaning::Scalar(name, scalar) => scalars.insert(name, (scalar, at)).is_some(),
                Meaning::Other => {
                    layout.left_out.extend((!name.is_empty()).then(|| name.clone()));
                    false
                }
            };
            if twice {
                problems.push(Problem::new(file, &name, "twice", "must be one column"));
            }
        }
        for (frame, channels) in channels.into_iter().enumerate() {
            let absent = (0..channels.len()).find(|channel| !channels.contains_key(channel));
            if let (Some(channel), Some((last, _))) = (absent, channels.last_key_value()) {
                let key = format!("{}{channel}", FRAMES[frame].1);
                let limit =
                    format!("must be present: channels count from 0, and the last is {last}");
                problems.push(Problem::new(file, &key, "absent", limit));
            }
            layout.frames[frame] = channels.into_values().collect();
        }
        let forms =
            [contacts.contains_key(&0), contacts.keys().any(|n| *n > 0), layout.json.is_some()];
        if forms.into_iter().filter(|form| *form).count() > 1 {
            let limit = "must have one form: x_mm, y_mm, force_n of one contact; x1_mm, y1_mm, force1_n, \
                         x2_mm, .. of several; or a column contacts";
            problems.push(Problem::new(file, CONTACTS, "several forms", limit));
        }
        layout.contacts = contacts.into_values().collect();
        layout.scalars =
            scalars.into_iter().map(|(name, (scalar, at))| (name, scalar, at)).collect();
        if problems.is_empty() { Ok(layout) } else { Err(problems) }
    }

    fn has_contacts(&self) -> bool {
        !self.contacts.is_empty() || self.json.is_some()
    }
}

impl Csv {
    /// Reads the header and counts the rows.
    ///
    /// # Errors
    /// `DatasetError::File` if the file cannot be read, `Problems` if its header is invalid, a line is too
    /// long, or a line has another number of cells than the header.
    pub fn open(path: &Path, file: &str) -> DatasetResult<Self> {
        let mut first = Vec::new();
        let opened = File::open(path).map_err(DatasetError::file("opening", path))?;
        let mut start = opened.take(LINE_MAX_BYTES);
        io::BufRead::read_until(&mut io::BufReader::new(&mut start), b'\n', &mut first)
            .map_err(DatasetError::file("reading", path))?;
        let count = |separator: &u8| first.iter().filter(|byte| *byte == separator).count();
        // Of equal numbers the last counts: a comma.
        let separator = SEPARATORS.into_iter().rev().max_by_key(count).unwrap_or(b',');
        let mut csv = Self {
            path: path.into(),
            file: file.into(),
            separator,
            layout: Layout::default(),
            rows: 0,
            contacts: 0,
        };
        let (mut reader, allowance) = csv.reader()?;
        let header = reader.byte_headers().map_err(|error| csv.broken(&error))?.clone();
        csv.layout = Layout::of(file, &header).map_err(DatasetError::Problems)?;
        let mut record = ByteRecord::new();
        loop {
            allowance.renew();
            if !reader.read_byte_record(&mut record).map_err(|error| csv.broken(&error))? {
                break;
            }
            csv.rows += 1;
            csv.contacts += match csv.layout.json.and_then(|at| record.get(at)) {
                Some(json) => json.iter().filter(|byte| **byte == b'{').count() as u64,
                None => csv.layout.contacts.len() as u64,
            };
        }
        Ok(csv)
    }

    fn reader(&self) -> DatasetResult<(csv::Reader<LineLimit<File>>, Allowance)> {
        let opened = File::open(&self.path).map_err(DatasetError::file("opening", &self.path))?;
        let (limited, allowance) = LineLimit::new(opened);
        let reader = ReaderBuilder::new().delimiter(self.separator).from_reader(limited);
        Ok((reader, allowance))
    }

    fn broken(&self, error: &csv::Error) -> DatasetError {
        if let Some(kind) = self.toml() {
            let (is, given) = (kind.name(), kind.given());
            let limit = format!("this is {is}, not a table of trials; {is} is given with {given}");
            return whole(&self.file, limit);
        }
        let why = match error.kind() {
            csv::ErrorKind::UnequalLengths { pos: Some(at), expected_len, len } => {
                // The header is record 0. Its line is not stated: it is wrong after a line that ends with CR LF.
                let (row, cells) = (at.record().saturating_sub(1), counted(*len, "cell", "cells"));
                format!("row {row} has {cells}, the first line {expected_len}")
            }
            _ => error.to_string(),
        };
        whole(&self.file, format!("must be CSV, each line with as many cells as the first: {why}"))
    }

    /// Kind of the file if it is no table, but one of the TOML files of this program.
    fn toml(&self) -> Option<FileKind> {
        let mut text = String::new();
        File::open(&self.path).ok()?.take(TOML_MAX_BYTES).read_to_string(&mut text).ok()?;
        FileKind::of(&text)
    }

    /// Names of the columns that are read, and of those that are ignored.
    pub fn schema(&self) -> Schema {
        let mut names: Vec<&str> = Vec::new();
        for ((name, _), cells) in FRAMES.into_iter().zip(&self.layout.frames) {
            names.extend((!cells.is_empty()).then_some(name));
        }
        names.extend(self.layout.has_contacts().then_some(CONTACTS));
        names.extend(self.layout.scalars.iter().map(|(name, ..)| *name));
        names.extend(self.layout.left_out.iter().map(String::as_str));
        let field = |name: &str| Field::new(name, DataType::Null, true);
        Schema::new(names.into_iter().map(field).collect::<Vec<_>>())
    }

    /// Numbers of rows and values.
    pub fn extent(&self) -> Extent {
        let mut values = BTreeMap::new();
        for ((name, _), cells) in FRAMES.into_iter().zip(&self.layout.frames) {
            if !cells.is_empty() {
                values.insert(name.to_owned(), self.rows.saturating_mul(cells.len() as u64));
            }
        }
        values.insert(CONTACTS.to_owned(), self.contacts);
        Extent::new(self.rows, values)
    }

    /// Reads the rows, page by page.
    ///
    /// # Errors
    /// As [`Self::open`]; a page is an error if a cell is not of the type of its column.
    pub fn batches(self) -> DatasetResult<Batches> {
        let (reader, allowance) = self.reader()?;
        Ok(Batches { csv: self, reader, allowance, row: 0, ended: false })
    }
}

/// Pages of rows.
pub struct Batches {
    csv: Csv,
    reader: csv::Reader<LineLimit<File>>,
    allowance: Allowance,
    row: u64,
    ended: bool,
}

impl Iterator for Batches {
    type Item = DatasetResult<RecordBatch>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let page = self.page().transpose();
        self.ended = !matches!(page, Some(Ok(_)));
        page
    }
}

impl Batches {
    fn page(&mut self) -> DatasetResult<Option<RecordBatch>> {
        let mut page = Page::default();
        let mut record = ByteRecord::new();
        let (mut rows, mut bytes) = (0, 0);
        // Of long lines a page has fewer.
        while rows < BATCH_TRIALS && bytes < LINE_MAX_BYTES && page.problems.len() < PROBLEMS_MAX {
            self.allowance.renew();
            let read = self.reader.read_byte_record(&mut record);
            if !read.map_err(|error| self.csv.broken(&error))? {
                break;
            }
            page.push(&self.csv.file, &self.csv.layout, self.row, &record);
            rows += 1;
            bytes += record.as_slice().len() as u64;
            self.row += 1;
        }
        if !page.problems.is_empty() {
            return Err(DatasetError::Problems(page.problems));
        }
        if rows == 0 { Ok(None) } else { page.finish(&self.csv.layout).map(Some) }
    }
}

/// Values of a page, column by column.
#[derive(Default)]
struct Page {
    frames: [Vec<f32>; 2],
    contacts: Vec<Vec<Contact>>,
    numbers: BTreeMap<&'static str, Vec<Option<f64>>>,
    times: BTreeMap<&'static str, Vec<Option<i64>>>,
    words: BTreeMap<&'static str, Vec<Vec<String>>>,
    texts: BTreeMap<&'static str, Vec<String>>,
    problems: Vec<Problem>,
}

impl Page {
    fn push(&mut self, file: &str, layout: &Layout, row: u64, record: &ByteRecord) {
        let mut problems = Vec::new();
        let mut wrong = |column: &str, value: &str, limit: &str| {
            let shown: String = value.chars().take(40).collect();
            problems.push(Problem::new(file, &format!("row {row}, {column}"), shown, limit));
        };
        let text = |at: usize| String::from_utf8_lossy(record.get(at).unwrap_or_default());
        let mut number = |column: &dyn Fn() -> String, at: usize| {
            parse_number(&text(at)).unwrap_or_else(|limit| {
                wrong(&column(), text(at).trim(), limit);
                None
            })
        };
        for (frame, cells) in layout.frames.iter().enumerate() {
            let name = FRAMES[frame].1;
            for (channel, at) in cells.iter().enumerate() {
                let value = number(&|| format!("{name}{channel}"), *at);
                self.frames[frame].push(value.map_or(f32::NAN, |value| value as f32));
            }
        }
        let mut contacts = Vec::new();
        for (n, cells) in layout.contacts.iter().enumerate() {
            let mut values = [None; 4];
            for (field, at) in cells.iter().enumerate() {
                let column = || {
                    format!("contacts[{n}].{}{}", CONTACT_STEMS[field].0, CONTACT_STEMS[field].1)
                };
                values[field] = at.and_then(|at| number(&column, at));
            }
            contacts.extend(batch::contact(values));
        }
        for (name, scalar, at) in &layout.scalars {
            if *scalar == Scalar::Number {
                let value = number(&|| (*name).to_owned(), *at);
                self.numbers.entry(name).or_default().push(value);
            }
        }
        for (name, scalar, at) in &layout.scalars {
            let cell = text(*at);
            match scalar {
                Scalar::Number => {}
                Scalar::Text => self.texts.entry(name).or_default().push(cell.into_owned()),
                Scalar::Time => {
                    let time = batch::parse_time(&cell).unwrap_or_else(|limit| {
                        wrong(name, &cell, &limit);
                        None
                    });
                    self.times.entry(name).or_default().push(time);
                }
                Scalar::Words => {
                    let words = batch::parse_words(&cell).unwrap_or_else(|limit| {
                        wrong(name, &cell, &limit);
                        Vec::new()
                    });
                    self.words.entry(name).or_default().push(words);
                }
            }
        }
        if let Some(at) = layout.json {
            let cell = text(at);
            // A contact takes 20 times the memory of its text.
            if cell.bytes().filter(|byte| *byte == b'{').count() > IMPORTED_CONTACTS_MAX {
                let limit = format!("must have at most {IMPORTED_CONTACTS_MAX} contacts");
                wrong(CONTACTS, &cell, &limit);
            } else {
                contacts = serde_json::from_str(&cell).unwrap_or_else(|_| {
                    let limit =
                        "must be a list of {\"x_mm\": .., \"y_mm\": .., \"force_n\": ..} as JSON";
                    wrong(CONTACTS, &cell, limit);
                    Vec::new()
                });
            }
        }
        self.contacts.push(contacts);
        self.problems.append(&mut problems);
    }

    fn finish(mut self, layout: &Layout) -> DatasetResult<RecordBatch> {
        let mut columns: Vec<(&str, ArrayRef)> = Vec::new();
        let frames = self.frames.into_iter().zip(&layout.frames);
        for ((name, _), (values, cells)) in FRAMES.into_iter().zip(frames) {
            if !cells.is_empty() {
                let may_lack = name == SIM_VOLTAGES_V;
                columns.push((name, batch::frames(values, cells.len(), may_lack)?));
            }
        }
        if layout.has_contacts() {
            columns.push((CONTACTS, batch::contacts(&self.contacts)?));
        }
        for (name, scalar, _) in &layout.scalars {
            columns.push((
                name,
                match scalar {
                    Scalar::Number => {
                        batch::numbers(self.numbers.remove(name).unwrap_or_default().into_iter())
                    }
                    Scalar::Text => {
                        let texts = self.texts.remove(name).unwrap_or_default();
                        batch::texts(texts.iter().map(String::as_str))
                    }
                    Scalar::Time => batch::times(self.times.remove(name).unwrap_or_default()),
                    Scalar::Words => {
                        batch::words(self.words.remove(name).unwrap_or_default().into_iter())
                    }
                },
            ));
        }
        Ok(RecordBatch::try_from_iter_with_nullable(
            columns.into_iter().map(|(name, array)| (name, array, true)),
        )?)
    }
}

/// Parses a cell; `None` if it is empty, `NA`, `null` or NaN.
fn parse_number(text: &str) -> Result<Option<f64>, &'static str> {
    match text.trim() {
        "" | "NA" | "null" => Ok(None),
        text => match text.parse::<f64>() {
            Ok(number) => Ok(Some(number).filter(|number| !number.is_nan())),
            Err(_) => Err("must be a number with a point, an empty cell or NaN"),
        },
    }
}
