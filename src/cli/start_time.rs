//! The start time of a queued run, as a person enters and reads it: local time.
//! Uses: jiff. Never: a time of another kind.

use std::str::FromStr;

use jiff::civil::{DateTime, Time};
use jiff::tz::TimeZone;
use jiff::{Timestamp, Unit, Zoned};

/// An earliest start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StartTime(pub Timestamp);

impl FromStr for StartTime {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        read(text, &Zoned::now()).map(Self)
    }
}

/// Returns a time as the clock on the wall shows it.
pub fn local(at: Timestamp) -> String {
    at.to_zoned(TimeZone::system()).strftime("%Y-%m-%d %H:%M").to_string()
}

/// Reads a time with an offset, a local date and time, or a local time: its next occurrence.
fn read(text: &str, now: &Zoned) -> Result<Timestamp, String> {
    let wrong = || "must be like 22:00, 2026-11-24T22:00 or 2026-11-24T22:00:00+01:00".to_owned();
    if let Ok(at) = text.parse::<Timestamp>() {
        return Ok(at);
    }
    let zone = now.time_zone();
    if text.contains(':') && !text.contains('-') {
        let time: Time = text.parse().map_err(|_| wrong())?;
        let today = now.date().to_datetime(time).to_zoned(zone.clone()).map_err(|_| wrong())?;
        let next = if today <= *now {
            let tomorrow = now.date().tomorrow().map_err(|_| wrong())?;
            tomorrow.to_datetime(time).to_zoned(zone.clone()).map_err(|_| wrong())?
        } else {
            today
        };
        return Ok(next.timestamp());
    }
    let at: DateTime = text.parse().map_err(|_| wrong())?;
    let at = at.to_zoned(zone.clone()).map_err(|_| wrong())?;
    at.timestamp().round(Unit::Millisecond).map_err(|_| wrong())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn from(text: &str) -> Result<String, String> {
        let zone = TimeZone::posix("CET-1CEST,M3.5.0,M10.5.0/3").unwrap();
        let now = "2026-11-23T21:30:00Z".parse::<Timestamp>().unwrap().to_zoned(zone);
        read(text, &now).map(|at| at.to_string())
    }

    #[test]
    fn a_time_of_day_is_its_next_occurrence() {
        // Here it is 22:30.
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
}
