//! The log of a process: its level, its format, and a writer for which nothing waits.
//! Uses: tracing-subscriber, tracing-appender, `journal`, standard error. Never: a wait of the thread that logs, also if
//! standard error is a pipe that nothing reads: the campaign logs, too.

use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

use clap::Args;
use parking_lot::Mutex;
use tracing::{Dispatch, Metadata};
use tracing_appender::rolling::{RollingFileAppender, Rotation};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::layer::SubscriberExt;

use super::journal::{is_behind_stderr, priority};
use super::output::no_color;
use crate::plain::escaped;

/// Options of the log.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Log")]
pub struct LogArgs {
    /// Level: off, error, warn, info, debug or trace, also of parts: info,palpate_bench=debug
    /// [env: PALPATE_LOG] [default: warn].
    #[arg(long, value_name = "LEVEL", global = true, hide_short_help = true)]
    pub log: Option<String>,
    /// Format: text, or json with one object per line [env: PALPATE_LOG_FORMAT] [default: text].
    #[arg(long, value_name = "FORMAT", global = true, hide_short_help = true)]
    pub log_format: Option<String>,
    /// File of the log, a new one each day with the date in its name, of which 14 are kept
    /// [env: PALPATE_LOG_FILE] [default: standard error].
    #[arg(long, value_name = "FILE", global = true, hide_short_help = true)]
    pub log_file: Option<PathBuf>,
}

/// Days whose log files are kept.
const DAYS_KEPT: usize = 14;

/// Level without `PALPATE_LOG`.
const LEVEL: LevelFilter = LevelFilter::WARN;
/// Lines that may wait for standard error; further ones are counted and lost.
const WAITING_LINES: usize = 8192;
/// Longest wait for standard error at the end of the process.
const FLUSH_WAIT: Duration = Duration::from_secs(1);

/// Lines that wait for the end of a screen on the terminal; `None` while there is no screen.
static BEHIND_SCREEN: Mutex<Option<Vec<String>>> = Mutex::new(None);

/// Holds the log back while a screen occupies the terminal; its lines are written when it is dropped.
#[derive(Debug)]
pub struct Held(());

/// Holds the log back if standard error is a terminal, on which its lines would destroy a screen.
pub fn hold() -> Option<Held> {
    if !io::stderr().is_terminal() {
        return None;
    }
    *BEHIND_SCREEN.lock() = Some(Vec::new());
    Some(Held(()))
}

impl Drop for Held {
    fn drop(&mut self) {
        for line in BEHIND_SCREEN.lock().take().unwrap_or_default() {
            let _ = io::stderr().write_all(line.as_bytes());
        }
    }
}

/// Format of the lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Text,
    Json,
}

/// The log of this process. Its lines are written when it is dropped, if standard error takes them.
#[derive(Debug)]
pub struct Log {
    lines: SyncSender<Item>,
    written: Receiver<()>,
}

#[derive(Debug)]
enum Item {
    Line(Vec<u8>),
    End,
}

/// Starts the log as the options or the environment ask for it. Returns nothing if its thread cannot be
/// started: the process then has no log.
pub fn start(args: &LogArgs) -> Option<Log> {
    let from_env = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let wanted = args.log.clone().or_else(|| from_env("PALPATE_LOG"));
    let default = || Targets::new().with_default(LEVEL);
    let filter = wanted.as_deref().map_or_else(|| Ok(default()), levels);
    let named = args.log_format.clone().or_else(|| from_env("PALPATE_LOG_FORMAT"));
    let named = named.unwrap_or_default();
    let path = args.log_file.clone().or_else(|| from_env("PALPATE_LOG_FILE").map(PathBuf::from));
    let (file, unopened) = match path.as_deref().map(daily).transpose() {
        Ok(file) => (file, None),
        Err(error) => (None, Some(error)),
    };
    let colours = file.is_none() && io::stderr().is_terminal() && !no_color();
    let is_journal = file.is_none() && is_behind_stderr();
    let format = match named.as_str() {
        "json" => Format::Json,
        _ => Format::Text,
    };
    let (lines, inbox) = sync_channel(WAITING_LINES);
    let (done, written) = sync_channel(1);
    let lost = Arc::<AtomicU64>::default();
    let queue = Queue { lines: lines.clone(), lost: lost.clone(), priority: "" };
    let writing = move || {
        write_all(&inbox, &lost, file);
        let _ = done.send(());
    };
    std::thread::Builder::new().name("log".into()).spawn(writing).ok()?;
    let invalid_level = filter.as_ref().err().cloned();
    let filter = filter.unwrap_or_else(|_| default());
    let log = dispatch(format, filter, colours, Queues { queue, is_journal });
    // A log that was set before stays.
    let _ = tracing::dispatcher::set_global_default(log);
    // The default hook writes to standard error itself, before the safe end: a full pipe would stop it.
    std::panic::set_hook(Box::new(|panic| tracing::error!(%panic, "a thread panicked")));
    if let Some(error) = invalid_level {
        tracing::warn!(error, "--log or PALPATE_LOG is invalid: the level is {LEVEL}");
    }
    if let Some(error) = unopened {
        tracing::warn!(%error, ?path, "the log goes to standard error: its file cannot be opened");
    }
    if !matches!(named.as_str(), "" | "text" | "json") {
        tracing::warn!(
            named,
            "--log-format or PALPATE_LOG_FORMAT must be text or json: it is text"
        );
    }
    Some(Log { lines, written })
}

impl Drop for Log {
    fn drop(&mut self) {
        let deadline = Instant::now() + FLUSH_WAIT;
        while let Err(TrySendError::Full(_)) = self.lines.try_send(Item::End) {
            if Instant::now() > deadline {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        let _ = self.written.recv_timeout(FLUSH_WAIT);
    }
}

/// Reads the level of all and those of parts. A word without a level would be a part, and silence all others; so would
/// the level of a part alone.
fn levels(wanted: &str) -> Result<Targets, String> {
    let is_level = |word: &str| word.parse::<LevelFilter>().is_ok();
    if let Some(word) = wanted.split(',').find(|word| !word.contains('=') && !is_level(word)) {
        return Err(format!(
            "{word}: must be off, error, warn, info, debug or trace, or PART=LEVEL"
        ));
    }
    let levels = wanted.parse::<Targets>().map_err(|error| error.to_string())?;
    Ok(match levels.default_level() {
        Some(_) => levels,
        None => levels.with_default(LEVEL),
    })
}

/// A file for each day.
fn daily(path: &Path) -> io::Result<RollingFileAppender> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    // The library looks for old files first, and prints an error if there is no folder.
    std::fs::create_dir_all(folder)?;
    RollingFileAppender::builder()
        .rotation(Rotation::DAILY)
        .filename_prefix(name)
        .max_log_files(DAYS_KEPT)
        .build(folder)
        .map_err(io::Error::other)
}

/// Writes lines until the end, to the file or else to standard error; reports lost ones.
fn write_all(inbox: &Receiver<Item>, lost: &AtomicU64, mut file: Option<RollingFileAppender>) {
    while let Ok(Item::Line(line)) = inbox.recv() {
        let line = safe(&line);
        if let Some(kept) = BEHIND_SCREEN.lock().as_mut().filter(|_| file.is_none()) {
            if kept.len() < WAITING_LINES {
                kept.push(line);
            } else {
                lost.fetch_add(1, Ordering::Relaxed);
            }
            continue;
        }
        // A log that cannot be written, on a full disk, must not end the process.
        let _ = match &mut file {
            Some(file) => file.write_all(line.as_bytes()),
            None => io::stderr().write_all(line.as_bytes()),
        };
        let missing = lost.swap(0, Ordering::Relaxed);
        if missing > 0 {
            tracing::warn!(lines = missing, "lines of the log were lost: its reader is too slow");
        }
    }
}

/// Start of the codes with which the subscriber sets colours.
const COLOUR: &str = "\u{1b}[";

/// Escapes the control characters of a line, except codes of colours: the subscriber escapes those of texts
/// and messages, not those of fields with `%`.
fn safe(line: &[u8]) -> String {
    let line = String::from_utf8_lossy(line);
    let (line, end) = line.strip_suffix('\n').map_or((&*line, ""), |line| (line, "\n"));
    let mut pieces = line.split(COLOUR);
    let mut safe = escaped(pieces.next().unwrap_or_default()).into_owned();
    for piece in pieces {
        let code = piece.trim_start_matches(|c: char| c.is_ascii_digit() || c == ';');
        let start = if code.starts_with('m') { COLOUR } else { "\\u{1b}[" };
        safe.push_str(start);
        safe.push_str(&escaped(piece));
    }
    safe.push_str(end);
    safe
}

/// Puts lines into the queue of the writing thread.
#[derive(Debug, Clone)]
struct Queue {
    lines: SyncSender<Item>,
    lost: Arc<AtomicU64>,
    /// What the lines begin with.
    priority: &'static str,
}

impl Write for Queue {
    /// Takes a whole line, as the subscriber writes it.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        let whole = [self.priority.as_bytes(), line].concat();
        if self.lines.try_send(Item::Line(whole)).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Makes the writer of each line, which in the journal begins with the priority of its level.
#[derive(Debug)]
struct Queues {
    queue: Queue,
    is_journal: bool,
}

impl<'w> MakeWriter<'w> for Queues {
    type Writer = Queue;

    fn make_writer(&'w self) -> Queue {
        self.queue.clone()
    }

    fn make_writer_for(&'w self, line: &Metadata<'_>) -> Queue {
        let priority = if self.is_journal { priority(*line.level()) } else { "" };
        Queue { priority, ..self.queue.clone() }
    }
}

/// A log with a writer. Text: one line per event, with the fields of its spans at its end. JSON: one
/// object per line, with its spans in `spans`, the outermost first.
fn dispatch<W>(format: Format, filter: Targets, colours: bool, writer: W) -> Dispatch
where
    W: for<'w> MakeWriter<'w> + Send + Sync + 'static,
{
    let lines = tracing_subscriber::fmt::layer().with_writer(writer).log_internal_errors(false);
    let log = tracing_subscriber::registry();
    match format {
        Format::Text => Dispatch::new(log.with(lines.compact().with_ansi(colours)).with(filter)),
        Format::Json => {
            let lines = lines.json().flatten_event(true).with_current_span(false);
            Dispatch::new(log.with(lines).with(filter))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::spans::{configuration_span, run_span, trial_span};
    use crate::dataset::background::background;
    use crate::ids::TrialKey;
    use serde_json::{Value, json};
    use tracing::Instrument;

    #[derive(Debug, Clone, Default)]
    struct Kept(Arc<Mutex<Vec<u8>>>);

    impl Write for Kept {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    const RUN: &str = "01890a5d-ac96-774b-bcce-b302099a8057";

    fn span_of_run() -> tracing::Span {
        run_span(RUN.parse().unwrap(), 12)
    }

    /// What is logged at a level by a piece of work in the spans of a run and a trial.
    fn logged(format: Format, level: LevelFilter) -> String {
        let kept = Kept::default();
        let (writer, filter) = (kept.clone(), Targets::new().with_default(level));
        let log = dispatch(format, filter, false, move || writer.clone());
        let key = TrialKey { configuration: 4, depth_index: 2 };
        let work = async {
            tracing::debug!("the tips press");
            tokio::task::yield_now().await;
            tracing::warn!(force_n = 2.5, "too much force");
        };
        let of_run = async {
            tracing::info!("before the trial");
            let of_configuration = async { work.instrument(trial_span(key)).await };
            of_configuration.instrument(configuration_span(4, 3)).await;
            tracing::error!("after the trial");
        };
        tracing::dispatcher::with_default(&log, || {
            let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
            runtime.block_on(of_run.instrument(span_of_run()));
        });
        String::from_utf8(kept.0.lock().clone()).unwrap()
    }

    fn lines(text: &str) -> Vec<Value> {
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    #[test]
    fn a_line_of_json_names_the_run_and_the_trial_in_which_it_was_logged() {
        let logged = lines(&logged(Format::Json, LevelFilter::DEBUG));
        assert_eq!(logged.len(), 4);
        let run = json!({ "name": "run", "run": RUN, "scan_id": 12 });
        let configuration = json!({ "name": "configuration", "index": 4, "tips": 3 });
        let trial = json!({ "name": "trial", "configuration": 4, "depth_index": 2 });
        assert_eq!(logged[0]["spans"], json!([run]));
        assert_eq!(logged[1]["spans"], json!([run, configuration, trial]));
        assert_eq!(logged[2]["spans"], logged[1]["spans"]);
        assert_eq!(logged[3]["spans"], logged[0]["spans"]);
        assert_eq!(logged[2]["message"], "too much force");
        assert_eq!(logged[2]["level"], "WARN");
        assert_eq!(logged[2]["force_n"], 2.5);
        assert!(logged.iter().all(|line| line["timestamp"].is_string()));
    }

    #[test]
    fn a_warning_names_its_run_at_the_default_level() {
        let logged = lines(&logged(Format::Json, LEVEL));
        assert_eq!(logged.len(), 2);
        for line in &logged {
            assert_eq!(line["spans"][0]["run"], RUN);
        }
    }

    #[test]
    fn a_level_that_is_none_or_of_a_part_silences_no_other_part() {
        let of = |wanted: &str, part: &str, level: tracing::Level| {
            levels(wanted).unwrap().would_enable(part, &level)
        };
        assert!(of("palpate_bench=debug", "palpate_store", tracing::Level::WARN));
        assert!(of("palpate_bench=debug", "palpate_bench", tracing::Level::DEBUG));
        assert!(!of("palpate_bench=debug", "palpate_store", tracing::Level::DEBUG));
        assert!(of("info,palpate_bench=debug", "palpate_store", tracing::Level::INFO));
        assert!(!of("off", "palpate_store", tracing::Level::ERROR));
        for wanted in ["verbose", "info,palpate_bench", "palpate_bench=loud", "info debug"] {
            assert!(levels(wanted).is_err(), "{wanted}");
        }
    }

    #[test]
    fn a_line_of_text_has_the_fields_of_its_spans() {
        let text = logged(Format::Text, LEVEL);
        let line = text.lines().find(|line| line.contains("too much force")).unwrap();
        for field in [&*format!("run={RUN}"), "scan_id=12", "configuration=4", "depth_index=2"] {
            assert!(line.contains(field), "{line}");
        }
    }

    #[test]
    fn a_line_in_the_journal_begins_with_the_priority_of_its_level() {
        let priorities = |is_journal| {
            let (lines, written) = sync_channel(8);
            let queue = Queue { lines, lost: Arc::default(), priority: "" };
            let filter = Targets::new().with_default(LevelFilter::TRACE);
            let log = dispatch(Format::Text, filter, false, Queues { queue, is_journal });
            tracing::dispatcher::with_default(&log, || {
                tracing::error!("3");
                tracing::warn!("4");
                tracing::info!("6");
                tracing::debug!("7");
                tracing::trace!("7");
            });
            let lines = written.try_iter().map(|item| match item {
                Item::Line(line) => String::from_utf8_lossy(&line[..3]).into_owned(),
                Item::End => String::new(),
            });
            lines.collect::<Vec<_>>()
        };
        assert_eq!(priorities(true), ["<3>", "<4>", "<6>", "<7>", "<7>"]);
        let without = priorities(false);
        assert!(without.len() == 5 && without.iter().all(|line| !line.starts_with('<')));
    }

    /// The log of a test belongs to its thread: another thread is asked for its span only.
    #[test]
    fn a_thread_for_long_work_continues_the_span_in_which_it_was_started() {
        let log = dispatch(Format::Json, Targets::new().with_default(LEVEL), false, io::sink);
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let inside = tracing::dispatcher::with_default(&log, || {
            let span = span_of_run();
            let there = log.clone();
            let ask =
                move || tracing::dispatcher::with_default(&there, tracing::Span::current).id();
            let asked = background(ask).instrument(span.clone());
            (runtime.block_on(asked).unwrap(), span.id())
        });
        assert!(inside.0.is_some());
        assert_eq!(inside.0, inside.1);
    }

    #[test]
    fn a_line_sets_colours_and_nothing_else_of_the_terminal() {
        let line = "\u{1b}[2mINFO\u{1b}[0m who=\u{1b}]0;title\u{7} \u{1b}[2J \u{9b}2J\nX\n";
        let shown =
            "\u{1b}[2mINFO\u{1b}[0m who=\\u{1b}]0;title\\u{7} \\u{1b}[2J \\u{9b}2J\\u{a}X\n";
        assert_eq!(safe(line.as_bytes()), shown);
    }

    #[test]
    fn a_file_of_the_log_has_the_date_in_its_name() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = temporary.path().join("logs");
        let file = daily(&folder.join("palpate.log")).unwrap();
        let (lines, inbox) = sync_channel(2);
        lines.send(Item::Line(b"a line\n".to_vec())).unwrap();
        lines.send(Item::End).unwrap();
        write_all(&inbox, &AtomicU64::new(0), Some(file));
        let entry = std::fs::read_dir(&folder).unwrap().next().unwrap().unwrap();
        assert!(entry.file_name().to_string_lossy().starts_with("palpate.log.2"));
        assert_eq!(std::fs::read_to_string(entry.path()).unwrap(), "a line\n");
    }

    #[test]
    fn a_log_in_a_folder_that_cannot_be_made_is_refused_before_it_starts() {
        let temporary = tempfile::tempdir().unwrap();
        let file = temporary.path().join("file");
        std::fs::write(&file, "").unwrap();
        let refused = daily(&file.join("logs").join("palpate.log")).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::NotADirectory);
    }

    #[test]
    fn lines_for_which_nothing_reads_are_counted_and_do_not_wait() {
        let (lines, inbox) = sync_channel(2);
        let mut queue = Queue { lines, lost: Arc::default(), priority: "" };
        for _ in 0..5 {
            queue.write_all(b"line\n").unwrap();
        }
        assert_eq!(queue.lost.load(Ordering::Relaxed), 3);
        assert_eq!(inbox.try_iter().count(), 2);
    }
}
