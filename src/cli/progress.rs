//! A progress bar for counted work, and log lines without a terminal.
//! Uses: indicatif. Never: standard output.

use std::fmt;
use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use parking_lot::Mutex;

use super::output::{duration, grouped, note};

/// Interval of progress lines without a terminal.
pub const PROGRESS_LINES: Duration = Duration::from_secs(10);

/// A bar on standard error, in units of this name; hidden if that is not a terminal.
pub fn progress_bar(unit: &str) -> ProgressBar {
    bar(&format!("{{bar:30}} {{human_pos}} / {{human_len}} {unit}, {{rate}}{{left}} {{msg}}"))
}

/// Progress of counted work: a bar on a terminal, elsewhere lines. It ends when it is dropped.
pub struct Counted {
    /// Hidden without a terminal.
    pub bar: ProgressBar,
    lines: LogLines,
    unit: &'static str,
}

impl Counted {
    /// None of `total` units is done.
    pub fn of(unit: &'static str, total: u64) -> Self {
        let bar = progress_bar(unit);
        bar.set_length(total);
        Self { lines: LogLines::instead_of(&bar), bar, unit }
    }

    /// Shows that `done` of `total` units are done.
    pub fn show(&mut self, done: u64, total: u64) {
        self.bar.set_length(total);
        self.bar.set_position(done);
        let unit = self.unit;
        self.lines.say(|| format!("{} of {} {unit}", grouped(done), grouped(total)));
    }

    /// Shows that further units are done.
    pub fn add(&mut self, units: u64) {
        self.show(self.bar.position() + units, self.bar.length().unwrap_or_default());
    }

    /// Waits for `work` on the next units, and shows meanwhile how many are done.
    pub async fn during<T>(&mut self, work: impl Future<Output = T>) -> T {
        let mut work = std::pin::pin!(work);
        loop {
            tokio::select! {
                done = &mut work => return done,
                () = tokio::time::sleep(COUNT_POLL) => self.add(0),
            }
        }
    }
}

/// A bar of this template on standard error, cleared when it is dropped; hidden if that is not a terminal.
pub fn bar(template: &str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template(template)
        .map(|style| style.with_key("rate", rate).with_key("left", left));
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// `rate` of a template: units per second.
fn rate(state: &ProgressState, out: &mut dyn fmt::Write) {
    let _ = write!(out, "{}", rate_words(state.per_sec()));
}

/// `left` of a template: the time to go, after a comma.
fn left(state: &ProgressState, out: &mut dyn fmt::Write) {
    let _ = write!(out, "{}", left_words(state.pos(), state.len().unwrap_or(0), state.eta()));
}

/// The time to go, after a comma; empty while it is not known, which is a time of zero.
fn left_words(done: u64, total: u64, eta: Duration) -> String {
    match eta.as_secs_f64() {
        // No unit shows how long the end of the work takes, for example closing a file.
        _ if total > 0 && done >= total => ", finishing".into(),
        _ if eta.is_zero() => String::new(),
        eta_s => format!(", {}", to_go(eta_s)),
    }
}

/// The time to go of work that has not ended: never zero, which would remain while its end takes longer.
pub fn to_go(left_s: f64) -> String {
    match left_s {
        ..1.0 => "nearly done".into(),
        _ => format!("{} to go", duration(left_s)),
    }
}

/// Units per second with the digits that matter: decimals below 10 only.
fn rate_words(per_s: f64) -> String {
    match per_s < 10.0 {
        true => format!("{per_s:.1}/s"),
        false => format!("{}/s", grouped(per_s.round() as u64)),
    }
}

/// Interval of asking how much of counted work is done.
const COUNT_POLL: Duration = Duration::from_millis(250);
/// Time after which a wait is shown.
const UNSHOWN_WAIT: Duration = Duration::from_millis(1500);

/// Waits for `work`; what takes longer than a moment is named on standard error, on a terminal with the time
/// since it began, elsewhere again at intervals.
pub async fn shown_wait<T>(words: &str, work: impl Future<Output = T>) -> T {
    let mut work = std::pin::pin!(work);
    let begin = Instant::now();
    tokio::select! {
        done = &mut work => return done,
        () = tokio::time::sleep(UNSHOWN_WAIT) => {}
    }
    let shown = match std::io::stderr().is_terminal() {
        true => Working::at_terminal(words),
        false => {
            note(format_args!("{words} .."));
            Working::in_lines(words, begin, PROGRESS_LINES)
        }
    };
    let done = work.await;
    drop(shown);
    done
}

/// As [`shown_wait`]; once `count` returns how many of how many units are done, they are shown with the time to go.
pub async fn counted_wait<T, Count: Future<Output = Option<(u64, u64)>>>(
    words: &str,
    unit: &'static str,
    count: impl Fn() -> Count,
    work: impl Future<Output = T>,
) -> T {
    let mut work = std::pin::pin!(work);
    let counted = async {
        tokio::time::sleep(UNSHOWN_WAIT).await;
        loop {
            if let Some(found) = count().await {
                return found;
            }
            tokio::time::sleep(COUNT_POLL).await;
        }
    };
    let (mut done, mut total) = tokio::select! {
        ended = shown_wait(words, work.as_mut()) => return ended,
        found = counted => found,
    };
    let mut shown = Counted::of(unit, total);
    loop {
        shown.show(done, total);
        let next = async {
            tokio::time::sleep(COUNT_POLL).await;
            count().await
        };
        // After the last unit nothing may be counted: what was shown remains.
        tokio::select! {
            ended = work.as_mut() => return ended,
            found = next => {
                (done, total) = found.unwrap_or((done, total));
            }
        }
    }
}

/// A sign of life while something works; it ends when it is dropped.
pub struct Working {
    /// Hidden without a terminal.
    bar: ProgressBar,
    /// What is done now, for the lines.
    words: Arc<Mutex<String>>,
    /// Ends the thread that prints lines; absent on a terminal.
    _lines: Option<Sender<()>>,
}

impl Working {
    /// Names the work: on a terminal at once, with the time since it began; elsewhere by a line once it takes longer
    /// than a moment, and again at intervals.
    pub fn on(words: &str) -> Self {
        match std::io::stderr().is_terminal() {
            true => Self::at_terminal(words),
            false => Self::in_lines(words, Instant::now(), UNSHOWN_WAIT),
        }
    }

    /// A spinner with the time since it began.
    fn at_terminal(words: &str) -> Self {
        let style = ProgressStyle::with_template("{spinner} {msg}, {elapsed}");
        let style = style.unwrap_or_else(|_| ProgressStyle::default_spinner());
        let bar = ProgressBar::new_spinner().with_style(style).with_message(words.to_owned());
        bar.enable_steady_tick(Duration::from_millis(100));
        Self { bar, words: Arc::default(), _lines: None }
    }

    /// Prints a line with the time since `begin` after `wait`, and then at intervals.
    fn in_lines(words: &str, begin: Instant, mut wait: Duration) -> Self {
        let (lines, ended) = mpsc::channel::<()>();
        let words = Arc::new(Mutex::new(words.to_owned()));
        let shown = words.clone();
        let print = move || {
            while ended.recv_timeout(wait) == Err(RecvTimeoutError::Timeout) {
                let words = shown.lock().clone();
                note(format_args!("{words} .. {} s", begin.elapsed().as_secs()));
                wait = PROGRESS_LINES;
            }
        };
        // Without a thread the work is done all the same.
        drop(std::thread::Builder::new().name("progress".into()).spawn(print));
        Self { bar: ProgressBar::hidden(), words, _lines: Some(lines) }
    }

    /// Names what is done now: on a terminal at once, elsewhere in the next line.
    pub fn step(&self, words: &str) {
        self.bar.set_message(words.to_owned());
        *self.words.lock() = words.to_owned();
    }
}

impl Drop for Working {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Prints the progress of long work on standard error, if no bar is visible: once it takes longer than a moment,
/// then at intervals.
pub struct LogLines {
    /// Time of the next line; absent if a bar is visible.
    next: Option<Instant>,
}

impl LogLines {
    /// Log lines for the work of this bar.
    pub fn instead_of(bar: &ProgressBar) -> Self {
        Self { next: bar.is_hidden().then(|| Instant::now() + UNSHOWN_WAIT) }
    }

    /// Prints a line, if it is time for one.
    pub fn say(&mut self, words: impl FnOnce() -> String) {
        if let Some(next) = &mut self.next
            && Instant::now() >= *next
        {
            *next = Instant::now() + PROGRESS_LINES;
            note(words());
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::future::ready;

    use tokio::sync::Notify;

    use super::*;

    #[test]
    fn a_rate_has_the_digits_that_matter() {
        assert_eq!([0.0, 2.46, 35_930.37].map(rate_words), ["0.0/s", "2.5/s", "35,930/s"]);
    }

    #[test]
    fn a_bar_never_has_zero_seconds_to_go() {
        let shown = |done, eta_s| left_words(done, 264, Duration::from_secs_f64(eta_s));
        assert_eq!(shown(0, 0.0), "", "no rate is known yet");
        assert_eq!(shown(12, 725.0), ", 12 min 5 s to go");
        assert_eq!(shown(263, 0.2), ", nearly done");
        assert_eq!(shown(264, 0.0), ", finishing");
        assert_eq!(left_words(0, 0, Duration::ZERO), "", "nothing is counted yet");
    }

    #[tokio::test]
    async fn counted_work_is_asked_for_until_it_ends() {
        let (asked, done) = (Cell::new(0_u64), Notify::new());
        let count = || {
            let now = asked.get() + 1;
            asked.set(now);
            if now == 4 {
                done.notify_one();
            }
            // Not counted at first, and no longer at the end.
            ready((2..4).contains(&now).then_some((now, 9)))
        };
        let work = async {
            done.notified().await;
            "made"
        };
        assert_eq!(counted_wait("making", "rows", count, work).await, "made");
        assert_eq!(asked.get(), 4);
        let mut shown = Counted::of("frames", 9);
        shown.add(4);
        let part = async {
            tokio::time::sleep(2 * COUNT_POLL).await;
            "answered"
        };
        assert_eq!(shown.during(part).await, "answered");
        assert_eq!((shown.bar.position(), shown.bar.length()), (4, Some(9)));
        let at_once = async { "there" };
        assert_eq!(counted_wait("making", "rows", || ready(None), at_once).await, "there");
    }
}
