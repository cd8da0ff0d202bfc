//! `palpate events`: what happened, as a list or as it happens.
//! Uses: `client`, `view`, `stream`. Never: a change, an event that was not stored.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use futures::StreamExt;
use jiff::Timestamp;
use serde_json::json;

use super::answers::numbers_of;
use super::stream::Collect;
use super::{EventsArgs, check_names};
use crate::api::Page;
use crate::cli::client::Client;
use crate::cli::embed;
use crate::cli::error::{CliError, CliResult};
use crate::cli::find::find_run;
use crate::cli::output::{note, say, say_json};
use crate::cli::table::{Table, or_dash};
use crate::cli::times::{Since, second};
use crate::cli::view::EventView;
use crate::event::{Importance, KINDS};

/// Events without `--limit` and `--since`.
const EVENTS_SHOWN: usize = 50;
/// Events per request.
const EVENTS_PER_REQUEST: u32 = 1000;
/// Time until a broken stream is opened again.
const REOPEN_PAUSE: Duration = Duration::from_secs(1);
/// Longest wait for the number of an event's run.
const NUMBER_WAIT: Duration = Duration::from_secs(2);
/// Width of the kinds of a stream, characters.
const KIND_WIDTH: usize = 14;
/// Width of its runs, characters.
const RUN_WIDTH: usize = 8;

/// Runs `palpate events`.
///
/// # Errors
/// `CliError` if the service cannot be reached, or refuses; to follow, it must be running.
pub async fn events(args: EventsArgs) -> CliResult<()> {
    if args.follow {
        let client = embed::server(&args.at).await?;
        return follow(&client, &args).await;
    }
    embed::command(&args.at, embed::Purpose::Reads, &args, list).await
}

impl EventsArgs {
    /// Whether an event is shown, of those that the service selects.
    fn selects(&self, event: &EventView) -> bool {
        // A request to place weights matters while the run waits for it, and would hide all others afterwards.
        let is_past = !self.follow && event.is_placement();
        !self.important || event.importance() >= Importance::Notable && !is_past
    }
}

/// Parameters that select run and kinds, each with `&` in front.
async fn selection(client: &Client, args: &EventsArgs) -> CliResult<String> {
    let mut query = String::new();
    if let Some(run) = &args.run {
        query += &format!("&run={}", find_run(client, run).await?.uid);
    }
    if !args.kind.is_empty() {
        check_names("--kind", &args.kind, KINDS.iter().map(|kind| kind.name))?;
        query += &format!("&kind={}", args.kind.join(","));
    }
    Ok(query)
}

/// The newest events that fit, and the number of the last one; all of them if `limit` is `None`.
async fn newest(
    client: &Client,
    args: &EventsArgs,
    selection: &str,
    limit: Option<usize>,
) -> CliResult<VecDeque<EventView>> {
    let (mut since, from) = match args.since {
        Some(Since::Event(number)) => (number, None),
        Some(Since::Time(at)) => (0, Some(at)),
        // Which ones are important is decided here.
        None if args.important => (0, None),
        // A negative number counts from the end.
        None => (limit.map_or(0, |limit| -i64::try_from(limit).unwrap_or(i64::MAX)), None),
    };
    let mut kept = VecDeque::new();
    loop {
        let path = format!("/api/v1/events?since={since}&limit={EVENTS_PER_REQUEST}{selection}");
        let page: Page<EventView> = client.get(&path).await?;
        for event in page.items {
            since = event.seq;
            let is_late = |from| event.at.parse::<Timestamp>().is_ok_and(|at| at >= from);
            if from.is_none_or(is_late) && args.selects(&event) {
                kept.push_back(event);
            }
            if limit.is_some_and(|limit| kept.len() > limit) {
                kept.pop_front();
            }
        }
        if page.next.is_none() {
            return Ok(kept);
        }
    }
}

async fn list(client: &Client, args: &EventsArgs) -> CliResult<()> {
    let selection = selection(client, args).await?;
    let limit = args.limit.or(args.since.is_none().then_some(EVENTS_SHOWN));
    let kept = newest(client, args, &selection, limit).await?;
    let filtered = !args.kind.is_empty() || args.since.is_some() || args.important;
    let empty = if filtered { "no event fits" } else { "there are no events" };
    let mut words = match args.run.is_some() || args.at.json {
        true => table(&kept, None, empty),
        false => {
            let numbers = numbers_of(client, kept.iter().filter_map(|event| event.run)).await?;
            table(&kept, Some(&numbers), empty)
        }
    }
    .to_string();
    if Some(kept.len()) == limit && args.limit.is_none() {
        words += &format!("\nthe newest {}; --limit N or --since 8h shows more", kept.len());
    }
    args.at.output().say(&json!({ "items": kept }), words);
    Ok(())
}

/// The events as a table, with the `numbers` of their runs if they may be of several ones.
fn table(
    events: &VecDeque<EventView>,
    numbers: Option<&BTreeMap<String, i64>>,
    empty: &'static str,
) -> Table {
    let run = if numbers.is_some() { "run> | " } else { "" };
    let mut table = Table::new(&format!("time | kind | {run}event"), empty);
    for event in events {
        let mut cells = vec![time(event), event.kind.clone()];
        if let Some(numbers) = numbers {
            cells.push(or_dash(event.run.and_then(|run| numbers.get(&run.to_string()))));
        }
        cells.push(event.sentence());
        table.push(cells);
    }
    table
}

async fn follow(client: &Client, args: &EventsArgs) -> CliResult<()> {
    let selection = selection(client, args).await?;
    // With --since or --limit the earlier events come first.
    let earlier = args.limit.unwrap_or(if args.since.is_some() { usize::MAX } else { 0 });
    let mut last: Option<String> = None;
    let mut printer = Printer { client, args, numbers: BTreeMap::new() };
    if earlier > 0 {
        for event in newest(client, args, &selection, Some(earlier)).await? {
            printer.print(&event).await;
            last = Some(event.seq.to_string());
        }
    }
    loop {
        if let Err(error) = listen(&mut printer, &selection, &mut last).await {
            let is_lost = matches!(
                error,
                CliError::NoServer { .. }
                    | CliError::Http(_)
                    | CliError::Refused { status: 503, .. }
            );
            if !is_lost {
                return Err(error);
            }
            note(format_args!("{error}; trying again"));
        }
        tokio::time::sleep(REOPEN_PAUSE).await;
    }
}

/// Prints events until the connection ends.
async fn listen(
    printer: &mut Printer<'_>,
    selection: &str,
    last: &mut Option<String>,
) -> CliResult<()> {
    let path = format!("/api/v1/events?{}", selection.trim_start_matches('&'));
    let answer = printer.client.stream(&path, last.as_deref()).await?;
    let mut pieces = answer.bytes_stream();
    let mut collect = Collect::default();
    while let Some(piece) = pieces.next().await {
        for sent in collect.take(&piece?) {
            if let Ok(event) = serde_json::from_str::<EventView>(&sent.data)
                && printer.args.selects(&event)
            {
                printer.print(&event).await;
            }
            *last = Some(sent.id);
        }
    }
    Ok(())
}

/// Prints the events of a stream.
struct Printer<'a> {
    client: &'a Client,
    args: &'a EventsArgs,
    /// Numbers of the runs whose events were printed, by their uids as text.
    numbers: BTreeMap<String, i64>,
}

impl Printer<'_> {
    /// Prints an event, with the number of its run if the stream may have events of several ones.
    async fn print(&mut self, event: &EventView) {
        if self.args.at.json {
            say_json(event);
            return;
        }
        let words = event.sentence().replace('\n', " ");
        let run = match self.args.run {
            Some(_) => String::new(),
            None => format!("  {:<RUN_WIDTH$}", or_dash(self.run(event).await)),
        };
        say(format_args!("{}  {:<KIND_WIDTH$}{run}  {words}", time(event), event.kind));
    }

    /// The run of an event by its number, `run 3`; by the start of its id if the service does not tell the number: an event
    /// that has arrived is shown in any case.
    async fn run(&mut self, event: &EventView) -> Option<String> {
        let uid = event.run?.to_string();
        if !self.numbers.contains_key(&uid) {
            let client = self.client.patient(NUMBER_WAIT);
            let found = numbers_of(&client, event.run.into_iter()).await;
            self.numbers.extend(found.unwrap_or_default());
        }
        let number = self.numbers.get(&uid).map(|number| format!("run {number}"));
        Some(number.unwrap_or_else(|| uid.chars().take(RUN_WIDTH).collect()))
    }
}

fn time(event: &EventView) -> String {
    event.at.parse().map_or_else(|_| event.at.clone(), second)
}
