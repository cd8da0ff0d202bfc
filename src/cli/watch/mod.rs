//! `palpate status --watch`: the night on the whole terminal, and the keys that a person needs.
//! Uses: `read` (what is asked), `night` (what is known), `draw` (its picture), `estop`, the
//! terminal. Never: a service in this process, a wait of the keys for an answer of the service.

use std::io::{self, IsTerminal};
use std::time::Duration;

use jiff::Timestamp;
use jiff::tz::TimeZone;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use serde_json::json;
use tokio::sync::mpsc::{self, Sender};
use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval};

pub(super) mod answers;
mod draw;
mod facts;
pub(super) mod night;
mod read;
pub(super) mod skin;
#[cfg(test)]
mod tests;
pub(super) mod theme;

use facts::Now;
use night::{News, Night};
use theme::Theme;

use super::client::Client;
use super::error::{CliError, CliResult};
use super::log::{self, Held};
use super::output::is_coloured;
use super::signals::Signals;
use super::{At, ask, embed, estop};

/// Interval at which the screen is drawn without news, for ages.
const REDRAW: Duration = Duration::from_millis(250);
/// Interval at which the thread that reads keys checks whether the screen is still there.
const KEYS_POLL: Duration = Duration::from_millis(100);
/// Number of news, and of keys, that may wait.
const WAITING: usize = 64;

/// The terminal with the screen on it; it is left as it was.
struct Screen {
    terminal: DefaultTerminal,
    // Dropped after the terminal is restored.
    _log: Option<Held>,
}

impl Screen {
    fn open() -> CliResult<Self> {
        let held = log::hold();
        let terminal =
            ratatui::try_init().map_err(CliError::system("opening the screen on the terminal"))?;
        Ok(Self { terminal, _log: held })
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        ratatui::restore();
    }
}

/// What a key asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Asked {
    Quit,
    Pause,
    Resume,
    Estop,
    Nothing,
}

impl Asked {
    fn of(key: KeyEvent) -> Self {
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        match key.code {
            _ if key.kind == KeyEventKind::Release => Self::Nothing,
            KeyCode::Char('c' | 'd') if control => Self::Quit,
            _ if control || key.modifiers.contains(KeyModifiers::ALT) => Self::Nothing,
            KeyCode::Char('q') => Self::Quit,
            KeyCode::Char('p') => Self::Pause,
            KeyCode::Char('r') => Self::Resume,
            KeyCode::Char('E') => Self::Estop,
            _ => Self::Nothing,
        }
    }
}

/// Runs `palpate status --watch`.
///
/// # Errors
/// `CliError::Problems` without a terminal, or with `--json`; other variants if the service cannot be
/// reached, or the terminal fails.
pub async fn watch(at: &At) -> CliResult<()> {
    let unsuited = |limit| CliError::argument("--watch", "given", limit);
    if at.json {
        return Err(unsuited("must not be combined with --json"));
    }
    if !io::stdout().is_terminal() || !io::stdin().is_terminal() {
        return Err(unsuited("needs a terminal: without one use `palpate status`"));
    }
    let mut signals = Signals::catch()?;
    let client = embed::server(at).await?;
    let (send, mut news) = mpsc::channel(WAITING);
    let (runs, of_runs) = watch::channel(None);
    tokio::spawn(read::follow_status(client.clone(), runs, send.clone()));
    tokio::spawn(read::follow_rest(client.clone(), of_runs, send.clone()));
    let mut night = Night::new(client.url());
    let theme = Theme { colour: is_coloured() };
    let zone = TimeZone::system();
    let mut screen = Screen::open()?;
    let mut keys = keys()?;
    let mut tick = interval(REDRAW);
    tick.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        let now = Now { at: Timestamp::now(), zone: zone.clone() };
        let drawn = screen.terminal.draw(|frame| draw::draw(frame, &night, &now, theme));
        drawn.map_err(CliError::system("drawing on the terminal"))?;
        tokio::select! {
            _ = tick.tick() => {}
            Some(read) = news.recv() => {
                night.take(read, Timestamp::now());
                // One drawing for all that has arrived.
                while let Ok(read) = news.try_recv() {
                    night.take(read, Timestamp::now());
                }
            }
            key = keys.recv() => match key.map_or(Asked::Quit, Asked::of) {
                Asked::Quit => return Ok(()),
                Asked::Nothing => night.outcome = None,
                asked => answer(asked, &mut night, &client, at, &send),
            },
            _ = signals.next() => return Ok(()),
        }
    }
}

/// Reads keys on a thread, until the receiver is dropped. A resize is a key that asks for nothing.
fn keys() -> CliResult<mpsc::Receiver<KeyEvent>> {
    let (send, keys) = mpsc::channel(WAITING);
    let reading = move || {
        while !send.is_closed() {
            let read = match event::poll(KEYS_POLL) {
                Ok(true) => event::read(),
                Ok(false) => continue,
                Err(error) => Err(error),
            };
            match read {
                Ok(Event::Key(key)) if send.blocking_send(key).is_err() => return,
                Ok(_) => {}
                // The terminal is gone: the closed channel ends the screen.
                Err(_) => return,
            }
        }
    };
    let thread = std::thread::Builder::new().name("keys".into()).spawn(reading);
    thread.map_err(CliError::system("reading keys"))?;
    Ok(keys)
}

/// Sends the request of a key, without waiting; its outcome becomes news.
fn answer(asked: Asked, night: &mut Night, client: &Client, at: &At, news: &Sender<News>) {
    let news = news.clone();
    if asked == Asked::Estop {
        night.outcome = Some("emergency stop requested".into());
        let at = at.clone();
        tokio::spawn(async move {
            let why = Some("E at status --watch");
            let told = news.clone();
            let tell = move |words: &str| drop(told.try_send(News::Outcome(words.into())));
            let words = match estop::press_estop(&at, why, tell).await {
                Ok(stopped) => stopped.words(),
                Err(error) => format!("THE STOP WAS NOT ACCEPTED: {error}"),
            };
            let _ = news.send(News::Outcome(words)).await;
        });
        return;
    }
    let Some(run) = night.active() else {
        night.outcome = Some("no run is active".into());
        return;
    };
    let of = ask::ActedRun::from(run);
    // The status that the person sees.
    let shown_at = night.status.as_ref().and_then(|status| status.at);
    let (client, action, mut more) = match asked {
        Asked::Pause => (client.clone(), "pause", json!({ "when": "checkpoint" })),
        Asked::Resume => (client.acting_on(shown_at), "resume", json!({})),
        Asked::Quit | Asked::Estop | Asked::Nothing => return,
    };
    more["why"] = "key at status --watch".into();
    night.outcome = Some(format!("{action} requested"));
    tokio::spawn(async move {
        let words = match client.act(of.uid, action, more).await {
            Ok(()) => of.accepted(action),
            Err(error) => error.to_string(),
        };
        let _ = news.send(News::Outcome(words)).await;
    });
}
