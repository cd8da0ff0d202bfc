//! Bounds of the HTTP interface, from which `docs/limits.md` is generated. The queues of runs, exports
//! and jobs have theirs where they are.
//! Uses: `store` (the largest page). Never: a decision.

use std::time::Duration;

/// Largest number of ordinary connections. A page holds about six, a script one; the rest is for
/// streams.
pub const CONNECTIONS: usize = 512;
/// Number of further connections, while all ordinary ones are busy, for the e-stop and /health
/// only.
pub const RESERVED: usize = 32;
/// Longest time for the head of a request, from the start of the connection or from its first byte.
pub const HEAD_WITHIN: Duration = Duration::from_secs(5);
/// Least time that an idle connection is kept for its first or next request before it is closed in
/// favour of another connection.
pub const YOUNG: Duration = Duration::from_millis(20);
/// Longest time from the end of a response to the next request.
pub const IDLE_WITHIN: Duration = Duration::from_secs(60);
/// Longest time without a byte of a request's body.
pub const BODY_STALL: Duration = Duration::from_secs(10);
/// Longest time without a byte of a response that the client takes.
pub const SEND_STALL: Duration = Duration::from_secs(30);
/// Longest time for a whole body of up to `BODY_MAX_BYTES`.
pub const BODY_WITHIN: Duration = Duration::from_secs(60);
/// Longest time for a larger body.
pub const UPLOAD_WITHIN: Duration = Duration::from_secs(6 * 3600);
/// Requests in progress of one key, or of all clients without a key; streams count.
pub const CALLER_REQUESTS: usize = 128;
/// Preflights and tours of submissions in progress.
pub const PREFLIGHTS: usize = 2;
/// Longest wait for the turn of a preflight, a simulation or an inference.
pub const TURN_WAIT: Duration = Duration::from_secs(10);
/// Simulations in progress; further ones wait.
pub const SIMULATIONS: usize = 2;
/// Contacts of one simulation.
pub const SIMULATED_CONTACTS: usize = 6;
/// Frames of one inference.
pub const FRAMES_MAX: usize = 2_000;
/// Frames of one inference by `exact`: a fit takes about 0.1 s.
pub const EXACT_MAX: usize = 300;
/// Frames of one inference with maps: a map has 25,600 numbers.
pub const MAPS_MAX: usize = 100;
/// Inferences by nets in progress; further ones wait.
pub const NET_REQUESTS: usize = 4;
/// Inferences by `exact` in progress; further ones wait.
pub const FIT_REQUESTS: usize = 2;
/// Result of a query as JSON, bytes.
pub const QUERY_JSON_MAX_BYTES: usize = 64 << 20;
/// Clients of the live frames, recordings included.
pub const FRAME_CLIENTS: usize = 64;
/// Frames of a recording: five minutes of 30 per second.
pub const RECORDED_FRAMES: usize = 9000;
/// Clients of the live status.
pub const STATUS_CLIENTS: usize = 64;
/// Time for which the stored part of the live status is not read again.
pub const STORED_PART_KEPT: Duration = Duration::from_secs(1);
/// Minutes of samples of the load cells that are kept.
pub const SAMPLES_MINUTES: u32 = 30;
/// Samples of the load cells of one response.
pub const SAMPLES_MAX: usize = 3000;
/// Clients of the live contacts.
pub const LIVE_CLIENTS: usize = 8;
/// Tours that are kept in memory.
pub const TOURS_MAX: usize = 8;
/// Time for which a tour is kept in memory.
pub const TOUR_KEPT: Duration = Duration::from_secs(24 * 3600);
/// Queued runs whose disk space and duration are kept in memory.
pub const ROOM_MAX: usize = 256;
/// Runs whose progress, and histories that are kept in memory.
pub const KEPT_RUNS: usize = 8;
/// Time for which the stored part of a progress is not read again.
pub const PROGRESS_KEPT: Duration = Duration::from_secs(2);
/// Time for which a history is not read again.
pub const HISTORY_KEPT: Duration = Duration::from_secs(5);
/// Time for which the wear, and the stored frame of the untouched skin, are not read again.
pub const WEAR_KEPT: Duration = Duration::from_secs(60);
/// Time for which the state of workers and their queue is kept in memory.
pub const WORKERS_KEPT: Duration = Duration::from_secs(5);
/// Largest message of a WebSocket from a client, bytes.
pub const MESSAGE_MAX_BYTES: usize = 4096;
/// Tickets of one key for WebSockets that wait to be used.
pub const TICKETS: usize = 32;
/// Longest path with query of a request, bytes. hyper's own bound is 65534.
pub const URI_MAX_BYTES: usize = 32 << 10;
/// Largest sum of the headers of a request, bytes. hyper's own bound, of the whole head, is 417792.
pub const HEADERS_MAX_BYTES: usize = 32 << 10;
/// Most header fields of a request.
pub const FIELDS_MAX: usize = 100;
/// Most header fields that hyper reads, so that a request with more than `FIELDS_MAX` can still be
/// answered with a problem body, and a stop is a stop.
pub const HYPER_FIELDS: usize = 256;
/// Parts of a file in one response; more ranges are ignored.
pub const RANGES_MAX: usize = 16;
/// Validity of a ticket.
pub const TICKET: Duration = Duration::from_secs(30);
/// Delay of the response to a request with a wrong key.
pub const WRONG_KEY_DELAY: Duration = Duration::from_millis(250);
/// Responses that are delayed at once; further ones are not, so that they keep no connection busy.
pub const DELAYED: usize = 32;
/// Largest body of an action or a simulation, bytes.
pub const ACTION_BODY_MAX_BYTES: usize = 64 << 10;
/// Largest body of a submission, a recipe, a definition or a calibration, bytes.
pub const BODY_MAX_BYTES: usize = 2 << 20;
/// Largest body with frames, bytes.
pub const FRAMES_MAX_BYTES: usize = 64 << 20;
/// Largest form with a model, bytes.
pub const MODEL_MAX_BYTES: usize = 256 << 20;
/// Largest import, bytes.
pub const IMPORT_MAX_BYTES: usize = 16 << 30;
/// Largest text part of a form, bytes.
pub const PART_MAX_BYTES: usize = 1 << 20;
/// Longest name of a person, a lock's holder or a model, characters; in the log of actions longer
/// ones are cut.
pub const WHO_MAX_CHARS: usize = 100;
/// Longest reason or note, characters; in the log of actions longer ones are cut.
pub const WHY_MAX_CHARS: usize = 500;
/// Longest message of a refusal in the log of actions, characters; longer ones are cut.
pub const DETAIL_MAX_CHARS: usize = 2000;
/// Entries of the log of actions that wait for a failing store.
pub const LOGGED_LATER_MAX: usize = 1000;
/// Entries of a page of a list by default; lists of trials and of rows have their own.
pub const LIST_PAGE: u32 = 100;
/// Entries of a page of a list.
pub const LIST_MAX: u32 = 1000;
/// Largest age of the status that a request states with `Status-At`.
pub const STATUS_AGE_MAX: Duration = Duration::from_secs(10);
/// Characters of an `Idempotency-Key`.
pub const ONCE_KEY_MAX_CHARS: usize = 128;
/// Requests with an `Idempotency-Key` of one caller that are kept. Not for a time: the wall clock may jump.
pub const ONCE_MAX: u32 = 10_000;
/// Largest response that is kept, bytes.
pub const ONCE_RESPONSE_MAX_BYTES: usize = 1 << 20;
/// Parameters of a selection of rows.
pub const CONDITIONS_MAX: usize = 100;
/// Values of all conditions of a selection, also those of `COLUMN__in`.
pub const VALUES_MAX: usize = 1000;
/// Longest part of an invalid parameter or statement that its refusal repeats, characters.
pub const REPEATED_CHARS: usize = 200;
/// Numbers in the frames and maps of one page, as rows x numbers per row.
pub const PAGE_NUMBERS_MAX: u64 = 20_000_000;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::import::extent::IMPORTED_TRIALS_MAX;
    use crate::dataset::space::KEPT_FREE_BYTES;
    use crate::query::{MEMORY_MAX_BYTES, QUERIES, ROWS_MAX, TAKEN_WITHIN, TIME_MAX};
    use crate::query_lines::SQL_MAX_BYTES;
    use crate::schedule::experiment::NAME_MAX_CHARS;
    use crate::simulate::contacts::FORCE_MAX_N;
    use crate::store::MAX_PAGE;

    const HEAD_BEYOND: &str = "431, except of the e-stop; beyond 417792 bytes or 256 fields, of every request, without a body";

    /// A line of the page: what is bounded, its bound, and what happens beyond it.
    type Bound = (&'static str, String, &'static str);

    fn seconds(time: Duration) -> String {
        match time.as_millis() {
            ms if ms < 1000 => format!("{ms} ms"),
            ms if ms < 600_000 => format!("{} s", ms / 1000),
            ms => format!("{} h", ms / 3_600_000),
        }
    }

    fn bytes(n: usize) -> String {
        match n {
            n if n >= 1 << 30 => format!("{} GiB", n >> 30),
            n if n >= 1 << 20 => format!("{} MiB", n >> 20),
            n => format!("{} KiB", n >> 10),
        }
    }

    #[rustfmt::skip]
    fn table() -> Vec<Bound> {
        let n = |n: usize| n.to_string();
        vec![
            ("connections", n(CONNECTIONS), "the connection that was idle for longest is closed; if all are busy or new: 503, except for the e-stop and /health"),
            ("further connections for the e-stop and /health", n(RESERVED), "as above"),
            ("head of a request, from its first byte", seconds(HEAD_WITHIN), "the connection is closed"),
            ("connection between two requests", seconds(IDLE_WITHIN), "the connection is closed"),
            ("body: time without a byte", seconds(BODY_STALL), "408, the connection is closed"),
            ("body: whole, uploads excluded", seconds(BODY_WITHIN), "408, the connection is closed"),
            ("body: whole, of an upload", seconds(UPLOAD_WITHIN), "408, the connection is closed"),
            ("response: time in which the client takes no byte", seconds(SEND_STALL), "the connection is closed"),
            ("requests in progress of one key, or of all clients without a key; streams count", n(CALLER_REQUESTS), "429 with Retry-After"),
            ("preflights in progress", n(PREFLIGHTS), "the request waits, then 503"),
            ("simulations in progress", n(SIMULATIONS), "the request waits, then 503"),
            ("contacts of a simulation", n(SIMULATED_CONTACTS), "422"),
            ("force of a contact of a simulation", format!("{FORCE_MAX_N} N"), "422"),
            ("wait for the turn of a preflight, a simulation or an inference", seconds(TURN_WAIT), "503"),
            ("queries in progress", format!("{QUERIES}; while a run is driven 1, with one thread"), "the request waits, then 503 with Retry-After"),
            ("statement of a query", bytes(SQL_MAX_BYTES), "400"),
            ("time of a query, without sending its rows", seconds(TIME_MAX), "400"),
            ("time in which the client takes the rows of a query", seconds(TAKEN_WITHIN), "the query ends, the connection is closed before the last row"),
            ("memory of the engine of a query", bytes(MEMORY_MAX_BYTES as usize), "400"),
            ("rows of a query", ROWS_MAX.to_string(), "400"),
            ("result of a query as JSON", bytes(QUERY_JSON_MAX_BYTES), "400"),
            ("inferences by nets in progress", n(NET_REQUESTS), "the request waits, then 503"),
            ("inferences by `exact` in progress", n(FIT_REQUESTS), "the request waits, then 503"),
            ("frames of an inference", n(FRAMES_MAX), "422"),
            ("frames of an inference by `exact`", n(EXACT_MAX), "422"),
            ("frames of an inference with maps", n(MAPS_MAX), "422"),
            ("clients of live frames, recordings included", n(FRAME_CLIENTS), "503"),
            ("frames of a recording", n(RECORDED_FRAMES), "400"),
            ("clients of the live status", n(STATUS_CLIENTS), "503"),
            ("samples of the load cells in one response", n(SAMPLES_MAX), "extremes are kept"),
            ("time for which samples of the load cells are kept", format!("{SAMPLES_MINUTES} min"), "older ones are forgotten"),
            ("clients of live contacts", n(LIVE_CLIENTS), "503"),
            ("message of a WebSocket client", bytes(MESSAGE_MAX_BYTES), "the socket is closed"),
            ("unused tickets of one key, or of all clients without a key, for WebSockets", n(TICKETS), "429"),
            ("validity of a ticket, one use", seconds(TICKET), "401"),
            ("delay of the response to a wrong key", seconds(WRONG_KEY_DELAY), "never of the e-stop"),
            ("responses delayed at once", n(DELAYED), "further ones are not delayed"),
            ("path and query of a request", bytes(URI_MAX_BYTES), "414; beyond 65534 bytes without a body"),
            ("headers of a request", bytes(HEADERS_MAX_BYTES), HEAD_BEYOND),
            ("header fields of a request", n(FIELDS_MAX), HEAD_BEYOND),
            ("parts of a file that `Range` selects, after merging", n(RANGES_MAX), "200 with the whole file"),
            ("body of an action or a simulation", bytes(ACTION_BODY_MAX_BYTES), "413"),
            ("body of a submission, recipe, definition, calibration, and of any other request", bytes(BODY_MAX_BYTES), "413"),
            ("body with frames", bytes(FRAMES_MAX_BYTES), "413"),
            ("form with a model", bytes(MODEL_MAX_BYTES), "413"),
            ("import", bytes(IMPORT_MAX_BYTES), "413"),
            ("trials of an import", IMPORTED_TRIALS_MAX.to_string(), "400"),
            ("free space that imports, datasets, exports and questions in SQL leave to runs: at least", bytes(KEPT_FREE_BYTES as usize), "507; exports: the task fails"),
            ("text part of a form", bytes(PART_MAX_BYTES), "413"),
            ("name of a person, holder, key or model", format!("{WHO_MAX_CHARS} characters"), "422; in the log of actions: cut"),
            ("name of an experiment", format!("{NAME_MAX_CHARS} characters"), "422"),
            ("note of the lock, reason of an action", format!("{WHY_MAX_CHARS} characters"), "422; in the log of actions: cut"),
            ("message of a refusal in the log of actions", format!("{DETAIL_MAX_CHARS} characters"), "cut"),
            ("entries of a page of a list, by default 100", LIST_MAX.to_string(), "400"),
            ("rows of a page of trials or of a dataset, by default 100; groups of an answer", MAX_PAGE.to_string(), "400"),
            ("age of the status that a request states with `Status-At`", seconds(STATUS_AGE_MAX), "409, except to pause, stop or abort a run"),
            ("`Idempotency-Key`", format!("{ONCE_KEY_MAX_CHARS} characters"), "400"),
            ("kept requests with an `Idempotency-Key` of one key, or of all clients without a key", ONCE_MAX.to_string(), "the oldest one is removed: its repetition is a new request"),
            ("response to a request with an `Idempotency-Key`", bytes(ONCE_RESPONSE_MAX_BYTES), "not kept: a repetition gets 409"),
            ("parameters of a selection of rows", n(CONDITIONS_MAX), "400"),
            ("values of all conditions of a selection of rows", n(VALUES_MAX), "400"),
            ("numbers in the frames and maps of a page", PAGE_NUMBERS_MAX.to_string(), "400"),
        ]
    }

    /// The committed page equals the table; `UPDATE=1` writes it.
    #[test]
    fn the_page_of_limits_is_what_the_code_says() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/limits.md");
        let line = |(of, most, beyond): Bound| format!("| {of} | {most} | {beyond} |\n");
        let lines = table().into_iter().map(line);
        let page = format!(
            "# Limits of the API\n\nGenerated from `src/service/api/limits.rs`. A refusal is a problem \
             body that names the limit.\n\n| of | at most | beyond |\n|---|---|---|\n{}",
            lines.collect::<String>()
        );
        if std::env::var_os("UPDATE").is_some() {
            std::fs::write(path, &page).unwrap();
        }
        let committed = std::fs::read_to_string(path).unwrap_or_default();
        assert!(committed == page, "docs/limits.md is old: UPDATE=1 cargo test page_of_limits");
    }
}
