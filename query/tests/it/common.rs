//! Files of trials as the service writes them, and the service's side of the talk.
//! Uses: polars, `words::query_lines`. Never: code of the engine.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use palpate_words::query_lines::{Answer, Form, LINES_VERSION, Order, Table};
use polars::prelude::*;

/// The built program.
pub const PROGRAM: &str = env!("CARGO_BIN_EXE_palpate-query");
/// Largest number of rows, as in the service.
pub const ROWS_MAX: u64 = 1_000_000;
/// Largest memory, as in the service.
pub const MEMORY_MAX_BYTES: u64 = 2 << 30;

/// A number from 0 to 1 that depends on `n` alone, evenly distributed.
pub fn noise(n: u64) -> f64 {
    let mut z = n.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (z ^ (z >> 31)) as f64 / u64::MAX as f64
}

/// Trials from `first` on.
#[derive(Debug, Clone)]
pub struct Trials {
    /// First trial id.
    pub first: u64,
    /// Number of trials.
    pub count: u64,
    /// Voltages of each frame; none without frames.
    pub channels: usize,
    /// Every trial whose id is a multiple of it lacks a twin.
    pub without_twin: u64,
}

impl Trials {
    /// The measured voltage of a trial at a position.
    pub fn voltage(trial: u64, position: usize) -> f32 {
        (noise(trial * 10_000 + position as u64) * 2.0) as f32
    }

    /// The simulated voltage of a trial at a position.
    pub fn simulated(trial: u64, position: usize) -> f32 {
        Self::voltage(trial, position) * 0.9 + 0.05
    }

    fn ids(&self) -> std::ops::Range<u64> {
        self.first..self.first + self.count
    }

    fn has_twin(&self, trial: u64) -> bool {
        !trial.is_multiple_of(self.without_twin)
    }

    fn frames(&self, name: &str, of: impl Fn(u64) -> Option<Vec<f32>>) -> PolarsResult<Column> {
        let mut values = Vec::with_capacity(self.count as usize);
        for trial in self.ids() {
            values.push(of(trial).map(|frame| Series::new("".into(), frame)));
        }
        let lists = ListChunked::from_iter(values).with_name(name.into()).into_series();
        Ok(lists.cast(&DataType::Array(Box::new(DataType::Float32), self.channels))?.into())
    }

    /// All trials, as the service writes them to Parquet.
    pub fn rows(&self) -> DataFrame {
        self.try_rows().expect("rows of trials")
    }

    fn try_rows(&self) -> PolarsResult<DataFrame> {
        let tips = |id: u64| (id % 4) as u32;
        let of = |salt: u64, id: u64| noise(id.wrapping_mul(31).wrapping_add(salt));
        let twin = |id: u64, value: f64| self.has_twin(id).then_some(value);
        let ids = self.ids();
        macro_rules! column {
            ($name:literal, $of:expr) => {
                Column::new($name.into(), ids.clone().map($of).collect::<Vec<_>>())
            };
        }
        let zone = TimeZone::opt_try_new(Some("UTC"))?;
        let mut columns = vec![
            column!("trial_id", |id| id as i64),
            column!("scan_id", |id| (id / 10_000) as i64 + 1),
            column!("label", |id| format!("run-{}", id / 10_000 + 1)),
            column!("tips", tips).cast(&DataType::UInt8)?,
            column!("contact_count", tips).cast(&DataType::UInt8)?,
            column!("max_force_n", |id| (of(1, id) * 20.0) as f32),
            column!("sim_model", |id| self.has_twin(id).then_some("fem-1")),
            column!("rmse_v", |id| twin(id, of(2, id) * 0.1)),
            column!("fvu", |id| twin(id, of(3, id))),
            column!("measured_at", |id| 1_800_000_000_000 + id as i64 * 1500)
                .cast(&DataType::Datetime(TimeUnit::Milliseconds, zone))?,
        ];
        if self.channels > 0 {
            columns.push(self.contacts()?);
            columns.push(self.frames("voltages_v", |id| {
                Some((0..self.channels).map(|p| Self::voltage(id, p)).collect())
            })?);
            columns.push(self.frames("sim_voltages_v", |id| {
                let frame = || (0..self.channels).map(|p| Self::simulated(id, p)).collect();
                self.has_twin(id).then(frame)
            })?);
        }
        DataFrame::new(self.count as usize, columns)
    }

    fn contacts(&self) -> PolarsResult<Column> {
        let mut lists = Vec::new();
        for id in self.ids() {
            let n: Vec<u64> = (0..id % 4).collect();
            let of = |salt: u64| n.iter().map(|k| noise(id * 7 + k + salt)).collect::<Vec<f64>>();
            let force: Vec<f32> = of(3).iter().map(|value| (value * 20.0) as f32).collect();
            let fields = [
                Series::new("x_mm".into(), of(1)),
                Series::new("y_mm".into(), of(2)),
                Series::new("force_n".into(), force),
                Series::new("diameter_mm".into(), vec![12f32; n.len()]),
            ];
            let list = StructChunked::from_series("".into(), n.len(), fields.iter())?;
            lists.push(list.into_series());
        }
        let kind = lists[0].dtype().clone();
        let mut all = polars::chunked_array::builder::get_list_builder(
            &kind,
            lists.len() * 2,
            lists.len(),
            "contacts".into(),
        );
        for list in &lists {
            all.append_series(list)?;
        }
        Ok(all.finish().into_series().into())
    }

    /// Writes the rows to a file.
    pub fn write(&self, path: &Path) {
        write(&mut self.rows(), path);
    }
}

/// Writes rows to a Parquet file.
pub fn write(rows: &mut DataFrame, path: &Path) {
    let file = File::create(path).expect("a file");
    ParquetWriter::new(file).finish(rows).expect("a Parquet file");
}

/// A folder that is removed when it is dropped.
pub struct Folder(PathBuf);

impl Folder {
    /// Creates an empty folder.
    pub fn new(name: &str) -> Self {
        let path =
            std::env::temp_dir().join(format!("palpate-query-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }

    /// Path of a file in it.
    pub fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A table that a statement can name, over files of one form.
pub fn table(name: &str, form: Form, files: &[PathBuf]) -> Table {
    Table { name: name.into(), form, files: files.to_vec() }
}

/// The tables over files of trials, and one more with the rows of the first, as a dataset.
pub fn tables(files: &[PathBuf], dataset: &str) -> Vec<Table> {
    vec![
        table("trials", Form::Trials, files),
        table("contacts", Form::Contacts, files),
        table("frames", Form::Frames, files),
        table("twins", Form::Twins, files),
        table("voltages", Form::Voltages, files),
        table(dataset, Form::Rows, &files[..1]),
    ]
}

/// What the program did.
#[derive(Debug)]
pub enum Outcome {
    /// It sent rows.
    Rows(DataFrame),
    /// It refused the statement, with these words.
    Refused(String),
    /// It ended without an answer.
    Ended(ExitStatus, String),
    /// It took too long, and was killed.
    Killed,
}

impl Outcome {
    /// The rows that it sent; panics on any other outcome.
    pub fn rows(self) -> DataFrame {
        match self {
            Self::Rows(rows) => rows,
            other => panic!("{other:?}"),
        }
    }

    /// The words with which it refused; panics on any other outcome.
    pub fn refused(self) -> String {
        match self {
            Self::Refused(words) => words,
            other => panic!("{other:?}"),
        }
    }
}

/// How a statement is evaluated.
#[derive(Debug, Clone, Copy)]
pub struct Bounds {
    /// Largest number of rows.
    pub rows_max: u64,
    /// Largest memory, bytes.
    pub memory_max_bytes: u64,
    /// Longest time.
    pub time_max: Duration,
    /// Threads of polars.
    pub threads: usize,
}

/// Bounds of the service.
pub const BOUNDS: Bounds = Bounds {
    rows_max: ROWS_MAX,
    memory_max_bytes: MEMORY_MAX_BYTES,
    time_max: Duration::from_secs(60),
    threads: 2,
};

/// A started program.
pub struct Engine {
    /// The process.
    pub child: Child,
    output: BufReader<std::process::ChildStdout>,
}

impl Engine {
    /// Starts the program as the service does, and sends an order.
    pub fn start(sql: &str, bounds: Bounds) -> Self {
        let mut child = Command::new(PROGRAM)
            .env("POLARS_MAX_THREADS", bounds.threads.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let output = BufReader::new(child.stdout.take().expect("an output"));
        let mut engine = Self { child, output };
        engine.say(&Order {
            version: LINES_VERSION,
            sql: sql.into(),
            rows_max: bounds.rows_max,
            memory_max_bytes: bounds.memory_max_bytes,
        });
        engine
    }

    /// Sends a line.
    pub fn say<T: serde::Serialize>(&mut self, line: &T) {
        let line = serde_json::to_string(line).expect("JSON") + "\n";
        // A program that has ended is found by `hear`.
        let _ = self.child.stdin.as_mut().expect("an input").write_all(line.as_bytes());
    }

    /// Reads an answer; `None` if the program has ended.
    pub fn hear(&mut self) -> Option<Answer> {
        let mut line = String::new();
        self.output.read_line(&mut line).expect("a line");
        (!line.is_empty()).then(|| serde_json::from_str(&line).expect("an answer"))
    }

    /// How it ended, and what it printed on standard error.
    pub fn end(mut self) -> (ExitStatus, String) {
        let mut said = String::new();
        let mut errors = self.child.stderr.take().expect("standard error");
        errors.read_to_string(&mut said).expect("text");
        (self.child.wait().expect("a status"), said)
    }
}

/// Evaluates a statement over those of `known` that it reads.
pub fn ask(sql: &str, known: &[Table], bounds: Bounds) -> Outcome {
    let mut engine = Engine::start(sql, bounds);
    let killer = Killer::of(engine.child.id(), bounds.time_max);
    let answer = talk(&mut engine, known);
    let (status, said) = engine.end();
    if killer.has_killed() {
        return Outcome::Killed;
    }
    match answer {
        Some(answer) => {
            // For an unknown table the service ends the program.
            let left = !status.success() && matches!(answer, Outcome::Refused(_));
            assert!(status.success() || left, "{sql}: {status} {said}");
            if !said.is_empty() {
                println!("{}: {said}", sql.chars().take(150).collect::<String>());
            }
            answer
        }
        None => Outcome::Ended(status, said),
    }
}

fn talk(engine: &mut Engine, known: &[Table]) -> Option<Outcome> {
    let names = match engine.hear()? {
        Answer::Tables(names) => names,
        Answer::Refused(words) => return Some(Outcome::Refused(words)),
        Answer::Rows(_) => panic!("rows before tables"),
    };
    let mut tables = Vec::new();
    for name in &names {
        match known.iter().find(|table| table.name == *name) {
            Some(table) => tables.push(table.clone()),
            // As the service does.
            None => {
                drop(engine.child.stdin.take());
                return Some(Outcome::Refused(format!("sql: no table {name}")));
            }
        }
    }
    engine.say(&tables);
    match engine.hear()? {
        Answer::Rows(count) => {
            let mut bytes = Vec::new();
            engine.output.read_to_end(&mut bytes).expect("rows");
            let rows = IpcStreamReader::new(Cursor::new(bytes)).finish().expect("an Arrow stream");
            assert_eq!(rows.height() as u64, count);
            Some(Outcome::Rows(rows))
        }
        Answer::Refused(words) => Some(Outcome::Refused(words)),
        Answer::Tables(_) => panic!("tables twice"),
    }
}

/// Kills a process after a time.
struct Killer {
    stop: std::sync::mpsc::Sender<()>,
    thread: std::thread::JoinHandle<bool>,
}

impl Killer {
    fn of(process: u32, time_max: Duration) -> Self {
        let (stop, stopped) = std::sync::mpsc::channel();
        let thread = std::thread::spawn(move || {
            let late = stopped
                .recv_timeout(time_max)
                .is_err_and(|error| error == std::sync::mpsc::RecvTimeoutError::Timeout);
            if late && let Some(pid) = rustix::process::Pid::from_raw(process as i32) {
                let _ = rustix::process::kill_process(pid, rustix::process::Signal::KILL);
            }
            late
        });
        Self { stop, thread }
    }

    fn has_killed(self) -> bool {
        let _ = self.stop.send(());
        self.thread.join().expect("a thread")
    }
}

/// Rows as text: a line for each, values separated by ` | `.
pub fn text(rows: &DataFrame) -> String {
    let line = |row: usize| {
        let values = rows.columns().iter().map(|column| {
            let value = column.get(row).expect("a value");
            match value {
                AnyValue::String(text) => text.to_owned(),
                AnyValue::StringOwned(text) => text.to_string(),
                other => other.to_string(),
            }
        });
        values.collect::<Vec<_>>().join(" | ")
    };
    (0..rows.height()).map(line).collect::<Vec<_>>().join("\n")
}
