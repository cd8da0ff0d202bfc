//! Named arrays of a file as trials: which are read, of which shapes, and their rows as batches.
//! Uses: `array`, `batch`, the readers `npz` and `mat`. Never: an allocation before its size is known and allowed.
//!
//! Rows are along the first dimension. The arrays that are read are held in memory, because MATLAB and some
//! NumPy files store them column by column.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{DataType, Field, Schema};

use super::array::{Kind, Shape, Values, is_frame};
use super::{batch, mat, npz};
use crate::dataset::error::{DatasetError, DatasetResult};
use crate::dataset::import::columns::{CONTACT_FIELDS, FRAMES_V, SCALARS, Scalar, scalar};
use crate::dataset::import::extent::Extent;
use crate::dataset::import::whole;
use crate::dataset::schema::VOLTAGES_V;
use crate::problem::Problem;
use crate::simulate::schema::{CONTACTS, SIM_VOLTAGES_V};

/// Largest size in memory of the arrays that are read, bytes.
pub const HELD_MAX_BYTES: u64 = 1 << 30;

/// Array of the positions of contacts, (n, k, 2), mm.
const CONTACTS_XY_MM: &str = "contacts_xy_mm";

/// Container of the arrays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Container {
    /// A zip file of `.npy` files, as `numpy.savez` writes it.
    Npz,
    /// A MAT file of version 5 to 7.
    Mat,
}

/// Where the values of a field of a contact are: at `trial * per_trial + contact * step + first`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Place {
    array: &'static str,
    per_trial: usize,
    step: usize,
    first: usize,
}

/// The arrays that are read.
#[derive(Debug, Default)]
struct Layout {
    rows: usize,
    read: BTreeMap<String, Shape>,
    /// Largest number of contacts of a trial, and the places of their fields.
    contacts: Option<(usize, [Option<Place>; 4])>,
    left_out: Vec<String>,
}

impl Layout {
    /// Chooses the arrays that are read. `file` is the name of the file in messages.
    ///
    /// # Errors
    /// A problem for each array of another shape or type than it must have, and one if they need more memory
    /// than is allowed.
    fn of(file: &str, arrays: BTreeMap<String, Shape>) -> Result<Self, Vec<Problem>> {
        let mut layout = Self::default();
        let mut problems = Vec::new();
        let mut wrong = |name: &str, value: &str, limit: String| {
            problems.push(Problem::new(file, name, value, limit));
        };
        let frames = arrays.get(VOLTAGES_V).or_else(|| arrays.get(FRAMES_V));
        let rows = frames.and_then(|shape| shape.dims.first()).copied();
        layout.rows = rows.unwrap_or_default();
        let rows = layout.rows;
        let is_list = |shape: &Shape| {
            let dims = &shape.dims;
            matches!(dims.as_slice(), [n] | [n, 1] | [1, n] if *n == rows)
        };
        for (name, inner) in
            [(VOLTAGES_V, "channels"), (SIM_VOLTAGES_V, "channels"), (FRAMES_V, "frames, channels")]
        {
            let Some(shape) = arrays.get(name) else { continue };
            let is_long = shape.dims.len() == 1 + inner.split(' ').count();
            let fits = is_long && shape.dims[0] == rows && !shape.dims[1..].contains(&0);
            if !fits || shape.kind != Kind::Numbers {
                let limit = format!("must be numbers of the shape ({rows}, {inner}), V");
                wrong(name, &shape.shown(), limit);
            }
        }
        for (name, scalar) in SCALARS {
            let Some(shape) = arrays.get(name) else { continue };
            let (fits, words) = match (scalar, shape.kind) {
                (Scalar::Number, kind) => (kind == Kind::Numbers, "numbers"),
                (Scalar::Time, kind) => (matches!(kind, Kind::Times | Kind::Texts(_)), "times"),
                (Scalar::Text | Scalar::Words, kind) => (matches!(kind, Kind::Texts(_)), "texts"),
            };
            if !fits || !is_list(shape) {
                wrong(name, &shape.shown(), format!("must be {words} of the shape ({rows})"));
            }
        }
        let has = |name: &str| arrays.contains_key(name);
        let places = has(CONTACT_FIELDS[0]) || has(CONTACT_FIELDS[1]);
        let forms = [has(CONTACTS), has(CONTACTS_XY_MM), places];
        if forms.into_iter().filter(|form| *form).count() > 1 {
            let limit =
                format!("must have one form: {CONTACTS}, or {CONTACTS_XY_MM}, or x_mm and y_mm");
            wrong(CONTACTS, "several forms", limit);
            return Err(problems);
        }
        let mut fields = [None; 4];
        let mut most = None;
        let mut lengths = |name: &'static str, inner: usize| -> Option<(usize, usize)> {
            let shape = arrays.get(name)?;
            let found = match (shape.dims.as_slice(), inner) {
                ([n], 1) if *n == rows => Some(1),
                ([n, k], 1) if *n == rows => Some(*k),
                ([1, n], 1) if *n == rows => Some(1),
                ([n, last], _) if *n == rows && *last == inner => Some(1),
                ([n, k, last], _) if *n == rows && *last == inner => Some(*k),
                _ => None,
            };
            let found =
                found.filter(|k| shape.kind == Kind::Numbers && most.is_none_or(|m| m == *k));
            if found.is_none() {
                let k = most.map_or("k".to_owned(), |k: usize| k.to_string());
                let words = match inner {
                    1 => format!("must be numbers of the shape ({rows}) or ({rows}, {k})"),
                    _ => format!("must be numbers of the shape ({rows}, {k}, {inner})"),
                };
                wrong(name, &shape.shown(), words);
            }
            most = most.or(found);
            found.map(|k| (k * inner, inner))
        };
        if let Some((per_trial, step)) = lengths(CONTACTS, CONTACT_FIELDS.len()) {
            fields =
                [0, 1, 2, 3].map(|first| Some(Place { array: CONTACTS, per_trial, step, first }));
        } else {
            if let Some((per_trial, step)) = lengths(CONTACTS_XY_MM, 2) {
                for (first, field) in fields.iter_mut().take(2).enumerate() {
                    *field = Some(Place { array: CONTACTS_XY_MM, per_trial, step, first });
                }
            }
            for (name, field) in CONTACT_FIELDS.into_iter().zip(&mut fields) {
                if let Some((per_trial, step)) = lengths(name, 1) {
                    *field = Some(Place { array: name, per_trial, step, first: 0 });
                }
            }
        }
        layout.contacts = most.map(|most| (most, fields));
        for (name, shape) in arrays {
            let of_contacts = fields.iter().flatten().any(|place| place.array == name);
            if is_frame(&name) || of_contacts || scalar(&name).is_some() {
                layout.read.insert(name, shape);
            } else {
                layout.left_out.push(name);
            }
        }
        let held = layout.read.iter().map(|(name, shape)| match shape.kind {
            Kind::Numbers if is_frame(name) => shape.values().saturating_mul(4),
            Kind::Texts(bytes) => shape.values().saturating_mul(bytes.saturating_add(24)),
            _ => shape.values().saturating_mul(16),
        });
        let held = held.fold(0, u64::saturating_add);
        if held > HELD_MAX_BYTES && problems.is_empty() {
            let limit = format!(
                "must be at most {HELD_MAX_BYTES} in memory: split the file, or save it as Parquet"
            );
            problems.push(Problem::new(file, "bytes", held, limit));
        }
        if problems.is_empty() { Ok(layout) } else { Err(problems) }
    }
}

/// A file of arrays whose headers have been read.
#[derive(Debug)]
pub struct Arrays {
    container: Container,
    path: PathBuf,
    file: String,
    layout: Layout,
}

impl Arrays {
    /// Reads the headers of the arrays.
    ///
    /// # Errors
    /// `DatasetError::File` if the file cannot be opened; `Problems` if it cannot be read, or an array has
    /// another shape or type than it must have.
    pub fn open(container: Container, path: &Path, file: &str) -> DatasetResult<Self> {
        let opened = std::fs::File::open(path).map_err(DatasetError::file("opening", path))?;
        let shapes = match container {
            Container::Npz => npz::shapes(opened),
            Container::Mat => mat::shapes(opened),
        };
        let shapes = shapes.map_err(|error| unreadable(file, container, &error))?;
        let layout = Layout::of(file, shapes).map_err(DatasetError::Problems)?;
        Ok(Self { container, path: path.into(), file: file.into(), layout })
    }

    /// Names of the columns that are read, and of the arrays that are ignored.
    pub fn schema(&self) -> Schema {
        let layout = &self.layout;
        let is_column = |name: &&str| is_frame(name) || scalar(name).is_some();
        let mut names: Vec<&str> =
            layout.read.keys().map(String::as_str).filter(is_column).collect();
        names.extend(layout.contacts.is_some().then_some(CONTACTS));
        names.extend(layout.left_out.iter().map(String::as_str));
        let field = |name: &str| Field::new(name, DataType::Null, true);
        Schema::new(names.into_iter().map(field).collect::<Vec<_>>())
    }

    /// Numbers of rows and values.
    pub fn extent(&self) -> Extent {
        let rows = self.layout.rows as u64;
        let mut values: BTreeMap<String, u64> = self
            .layout
            .read
            .iter()
            .filter(|(name, _)| is_frame(name))
            .map(|(name, shape)| (name.clone(), shape.values()))
            .collect();
        let most = self.layout.contacts.map_or(0, |(most, _)| most as u64);
        values.insert(CONTACTS.into(), rows.saturating_mul(most));
        Extent::new(rows, values)
    }

    /// Reads the arrays; returns their rows, page by page.
    ///
    /// # Errors
    /// As [`Self::open`]; a page is an error if a text is not of the type of its column.
    pub fn batches(self) -> DatasetResult<Batches> {
        let path = &self.path;
        let opened = std::fs::File::open(path).map_err(DatasetError::file("opening", path))?;
        let wanted = &self.layout.read;
        let arrays = match self.container {
            Container::Npz => npz::read(opened, wanted),
            Container::Mat => mat::read(opened, wanted),
        };
        let arrays = arrays.map_err(|error| unreadable(&self.file, self.container, &error))?;
        let rows_at_once = self.extent().rows_at_once();
        Ok(Batches { file: self.file, layout: self.layout, arrays, rows_at_once, row: 0 })
    }
}

fn unreadable(file: &str, container: Container, error: &io::Error) -> DatasetError {
    let words = match container {
        Container::Npz => "must be an NPZ file of arrays without pickle, as numpy.savez writes it",
        Container::Mat => "must be a MAT file of version 5 to 7",
    };
    whole(file, format!("{words}: {error}"))
}

/// Pages of rows.
pub struct Batches {
    file: String,
    layout: Layout,
    arrays: BTreeMap<String, Values>,
    rows_at_once: usize,
    row: usize,
}

impl Iterator for Batches {
    type Item = DatasetResult<RecordBatch>;

    fn next(&mut self) -> Option<Self::Item> {
        let first = self.row;
        let end = self.layout.rows.min(first + self.rows_at_once);
        self.row = end;
        (first < end).then(|| self.page(first, end))
    }
}

impl Batches {
    fn page(&self, first: usize, end: usize) -> DatasetResult<RecordBatch> {
        let mut columns: Vec<(&str, ArrayRef)> = Vec::new();
        for (name, values) in &self.arrays {
            match values {
                Values::Singles(volts) if name == FRAMES_V => {
                    let each = volts.len() / self.layout.rows.max(1);
                    let frames = self.layout.read.get(name).map_or(1, |shape| shape.dims[1]);
                    let page = &volts[first * each..end * each];
                    columns.push((name, batch::raw_frames(page, frames, each / frames.max(1))?));
                }
                Values::Singles(volts) => {
                    let channels = volts.len() / self.layout.rows.max(1);
                    let page = volts[first * channels..end * channels].to_vec();
                    let has_raw = self.layout.read.contains_key(FRAMES_V);
                    let may_lack = has_raw || name == SIM_VOLTAGES_V;
                    columns.push((name, batch::frames(page, channels, may_lack)?));
                }
                _ => {
                    if let Some((_, scalar)) = scalar(name) {
                        columns.push((name, self.scalar(name, scalar, values, first, end)?));
                    }
                }
            }
        }
        if let Some((most, fields)) = &self.layout.contacts {
            let trials: Vec<Vec<_>> = (first..end)
                .map(|trial| {
                    let contact = |n| fields.map(|place| self.field(place?, trial, n));
                    (0..*most).filter_map(|n| batch::contact(contact(n))).collect()
                })
                .collect();
            columns.push((CONTACTS, batch::contacts(&trials)?));
        }
        Ok(RecordBatch::try_from_iter_with_nullable(
            columns.into_iter().map(|(name, array)| (name, array, true)),
        )?)
    }

    fn field(&self, place: Place, trial: usize, contact: usize) -> Option<f64> {
        let Some(Values::Numbers(values)) = self.arrays.get(place.array) else { return None };
        values.get(trial * place.per_trial + contact * place.step + place.first).copied()
    }

    fn scalar(
        &self,
        name: &str,
        scalar: Scalar,
        values: &Values,
        first: usize,
        end: usize,
    ) -> DatasetResult<ArrayRef> {
        let wrong = |row: usize, value: &str, limit: String| {
            let key = format!("row {row}, {name}");
            DatasetError::Problems(vec![Problem::new(&self.file, &key, value, limit)])
        };
        Ok(match (scalar, values) {
            (_, Values::Numbers(values)) => {
                batch::numbers(values[first..end].iter().copied().map(Some))
            }
            (_, Values::Times(values)) => batch::times(values[first..end].to_vec()),
            (Scalar::Time, Values::Texts(texts)) => {
                let times = texts[first..end].iter().enumerate().map(|(at, text)| {
                    batch::parse_time(text).map_err(|limit| wrong(first + at, text, limit))
                });
                batch::times(times.collect::<Result<_, _>>()?)
            }
            (Scalar::Text, Values::Texts(texts)) => {
                batch::texts(texts[first..end].iter().map(String::as_str))
            }
            (_, Values::Texts(texts)) => {
                let words = texts[first..end].iter().enumerate().map(|(at, text)| {
                    batch::parse_words(text).map_err(|limit| wrong(first + at, text, limit))
                });
                batch::words(words.collect::<Result<Vec<_>, _>>()?.into_iter())
            }
            (_, Values::Singles(values)) => {
                batch::numbers(values[first..end].iter().map(|v| Some(f64::from(*v))))
            }
        })
    }
}
