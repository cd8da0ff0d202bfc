//! Times as a person enters them, of the past and of the future, and as the clock on the wall shows them.
//! Uses: jiff. Never: a local time of another zone than the system's.

use std::str::FromStr;

use jiff::civil::{DateTime, Time};
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp, Unit, Zoned};

/// Reads an earliest start.
///
/// # Errors
/// The limit, if the text is no time.
pub fn start_time(text: &str) -> Result<Timestamp, String> {
    start(text, &Zoned::now())
}

/// Where a list of events begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Since {
    /// After the event with this number.
    Event(i64),
    /// At this time.
    Time(Timestamp),
}

impl FromStr for Since {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        since(text, &Zoned::now())
    }
}

/// Returns date and time to the minute, local.
pub fn local(at: Timestamp) -> String {
    at.to_zoned(TimeZone::system()).strftime("%Y-%m-%d %H:%M").to_string()
}

/// Returns date and time to the second, local.
pub fn second(at: Timestamp) -> String {
    at.to_zoned(TimeZone::system()).strftime("%Y-%m-%d %H:%M:%S").to_string()
}

/// Returns date and time to the second, local, with the offset of the zone, for a text that leaves the machine.
pub fn zoned(at: Timestamp) -> String {
    at.to_zoned(TimeZone::system()).strftime("%Y-%m-%d %H:%M:%S (UTC%:z)").to_string()
}

fn start(text: &str, now: &Zoned) -> Result<Timestamp, String> {
    let at = clock(text, now, Day::Next).and_then(|at| at.round(Unit::Millisecond).ok());
    at.ok_or_else(|| "must be like 22:00, 2026-11-24T22:00 or 2026-11-24T22:00:00+01:00".into())
}

fn since(text: &str, now: &Zoned) -> Result<Since, String> {
    let ago = || now.timestamp().checked_sub(text.parse::<SignedDuration>().ok()?.abs()).ok();
    let found = match text.parse::<i64>() {
        Ok(number) => (number >= 0).then_some(Since::Event(number)),
        // A time of day first: with seconds it would be read as a duration, too.
        Err(_) => clock(text, now, Day::Last).or_else(ago).map(Since::Time),
    };
    found.ok_or_else(|| {
        "must be like 8h, 90min, 22:00, 2026-11-24T22:00, or the number of an event".into()
    })
}

/// Which occurrence of a time of day is meant.
#[derive(Debug, Clone, Copy)]
enum Day {
    Last,
    Next,
}

/// Reads a time with an offset, a local date and time, or a local time of day; `None` if it is none of these.
fn clock(text: &str, now: &Zoned, day: Day) -> Option<Timestamp> {
    if let Ok(at) = text.parse::<Timestamp>() {
        return Some(at);
    }
    let local = |at: DateTime| Some(at.to_zoned(now.time_zone().clone()).ok()?.timestamp());
    let is_of_day = text.contains(':') && !text.contains('-');
    let Some(time) = text.parse::<Time>().ok().filter(|_| is_of_day) else {
        return local(text.parse().ok()?);
    };
    let today = local(now.date().to_datetime(time))?;
    let other = match (day, today <= now.timestamp()) {
        (Day::Last, true) | (Day::Next, false) => return Some(today),
        (Day::Last, false) => now.date().yesterday(),
        (Day::Next, true) => now.date().tomorrow(),
    };
    local(other.ok()?.to_datetime(time))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn zoned(at: &str) -> Zoned {
        let zone = TimeZone::posix("CET-1CEST,M3.5.0,M10.5.0/3").unwrap();
        at.parse::<Timestamp>().unwrap().to_zoned(zone)
    }

    /// The start of a run. It is 22:30.
    fn from(text: &str) -> Result<String, String> {
        start(text, &zoned("2026-11-23T21:30:00Z")).map(|at| at.to_string())
    }

    #[test]
    fn a_time_of_day_is_the_next_one_of_a_start() {
        assert_eq!(from("23:00").unwrap(), "2026-11-23T22:00:00Z");
        assert_eq!(from("22:30").unwrap(), "2026-11-24T21:30:00Z");
        assert_eq!(from("06:15:30").unwrap(), "2026-11-24T05:15:30Z");
    }

    #[test]
    fn a_date_is_local_unless_it_has_an_offset() {
        assert_eq!(from("2026-11-24T22:00").unwrap(), "2026-11-24T21:00:00Z");
        assert_eq!(from("2026-11-24 22:00").unwrap(), "2026-11-24T21:00:00Z");
        assert_eq!(from("2027-07-01T22:00").unwrap(), "2027-07-01T20:00:00Z");
        assert_eq!(from("2026-11-24T22:00Z").unwrap(), "2026-11-24T22:00:00Z");
        assert_eq!(from("2026-11-24T22:00:00+05:30").unwrap(), "2026-11-24T16:30:00Z");
        for wrong in ["", "tonight", "25:00", "2026-13-01T00:00", "22", "-1:00"] {
            assert!(from(wrong).unwrap_err().starts_with("must be like 22:00"), "{wrong}");
        }
    }

    #[test]
    fn a_time_of_day_is_the_last_one_of_a_list() {
        // It is 08:30.
        let from = |text: &str| since(text, &zoned("2026-11-23T07:30:00Z"));
        let at = |text: &str| Ok(Since::Time(text.parse().unwrap()));
        assert_eq!(from("08:00"), at("2026-11-23T07:00:00Z"));
        assert_eq!(from("22:00"), at("2026-11-22T21:00:00Z"));
        assert_eq!(from("22:00:30"), at("2026-11-22T21:00:30Z"));
        assert_eq!(from("8h"), at("2026-11-22T23:30:00Z"));
        assert_eq!(from("90min"), at("2026-11-23T06:00:00Z"));
        assert_eq!(from("2026-11-22T22:00"), at("2026-11-22T21:00:00Z"));
        assert_eq!(from("2026-11-22T22:00Z"), at("2026-11-22T22:00:00Z"));
        assert_eq!(from("812"), Ok(Since::Event(812)));
        for wrong in ["", "yesterday", "-3", "25:00"] {
            assert!(from(wrong).unwrap_err().starts_with("must be like 8h"), "{wrong}");
        }
    }
}
