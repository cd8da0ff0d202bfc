//! A time in the past as a person enters it, and times as the clock on the wall shows them.
//! Uses: jiff. Never: a time in the future.

use std::str::FromStr;

use jiff::civil::{DateTime, Time};
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp, Zoned};

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
        read(text, &Zoned::now())
    }
}

fn read(text: &str, now: &Zoned) -> Result<Since, String> {
    let wrong = || "must be like 8h, 90min, 22:00, 2026-11-24T22:00, or the number of an event";
    if let Ok(number) = text.parse::<i64>() {
        return if number >= 0 { Ok(Since::Event(number)) } else { Err(wrong().into()) };
    }
    if let Ok(at) = text.parse::<Timestamp>() {
        return Ok(Since::Time(at));
    }
    let zone = now.time_zone();
    if let Ok(ago) = text.parse::<SignedDuration>() {
        let at = now.timestamp().checked_sub(ago.abs()).map_err(|_| wrong())?;
        return Ok(Since::Time(at));
    }
    if let Some(time) = text.parse::<Time>().ok().filter(|_| !text.contains('-')) {
        let today = now.date().to_datetime(time).to_zoned(zone.clone()).map_err(|_| wrong())?;
        if today <= *now {
            return Ok(Since::Time(today.timestamp()));
        }
        let yesterday = now.date().yesterday().map_err(|_| wrong())?.to_datetime(time);
        return Ok(Since::Time(yesterday.to_zoned(zone.clone()).map_err(|_| wrong())?.timestamp()));
    }
    let at: DateTime = text.parse().map_err(|_| wrong())?;
    Ok(Since::Time(at.to_zoned(zone.clone()).map_err(|_| wrong())?.timestamp()))
}

/// Date and time to the second, local.
pub fn second(at: Timestamp) -> String {
    at.to_zoned(TimeZone::system()).strftime("%Y-%m-%d %H:%M:%S").to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn from(text: &str) -> Result<Since, String> {
        let zone = TimeZone::posix("CET-1CEST,M3.5.0,M10.5.0/3").unwrap();
        read(text, &"2026-11-23T07:30:00Z".parse::<Timestamp>().unwrap().to_zoned(zone))
    }

    #[test]
    fn a_time_of_day_is_its_last_occurrence() {
        // Here it is 08:30.
        let at = |text: &str| Ok(Since::Time(text.parse().unwrap()));
        assert_eq!(from("08:00"), at("2026-11-23T07:00:00Z"));
        assert_eq!(from("22:00"), at("2026-11-22T21:00:00Z"));
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
