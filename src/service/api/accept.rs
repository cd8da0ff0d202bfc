//! The header `Accept` (RFC 9110, 12.5.1): which format of rows a client prefers.
//! Uses: `dataset::format`. Never: parameters of a media type, except its weight.

use std::iter::once;

use axum::http::{HeaderMap, StatusCode, header};

use super::problem::{ApiError, ApiResult};
use crate::dataset::format::Format;

/// Media type of pages, and of results without a format.
pub const PAGE_TYPE: &str = "application/json";

/// A range of media types, such as `text/csv`, `text/*` or `*/*`, with its weight.
struct MediaRange<'h> {
    kind: &'h str,
    subtype: &'h str,
    /// From 0 (refused) to 1.
    weight: f32,
}

impl<'h> MediaRange<'h> {
    /// Reads an element of the header; `None` if it is no range.
    fn read(text: &'h str) -> Option<Self> {
        let (name, parameters) = text.split_once(';').unwrap_or((text, ""));
        let (kind, subtype) = name.trim().split_once('/')?;
        let mut parameters = parameters.split(';').filter_map(|one| one.split_once('='));
        let weight = match parameters.find(|(key, _)| key.trim().eq_ignore_ascii_case("q")) {
            Some((_, value)) => {
                value.trim().parse::<f32>().ok().filter(|q| (0.0..=1.0).contains(q))?
            }
            None => 1.0,
        };
        Some(Self { kind, subtype, weight })
    }

    /// Number of parts of a media type that this range names; `None` if the type is not in it.
    fn precision(&self, media_type: &str) -> Option<usize> {
        let (kind, subtype) = media_type.split_once('/')?;
        match (self.kind, self.subtype) {
            ("*", "*") => Some(0),
            (of, "*") if of.eq_ignore_ascii_case(kind) => Some(1),
            (of, name) if of.eq_ignore_ascii_case(kind) && name.eq_ignore_ascii_case(subtype) => {
                Some(2)
            }
            _ => None,
        }
    }
}

/// Returns the format of rows that the header prefers; `None` for a response of the type `usual`. The largest weight
/// decides, among equal ones the type that is named, then `usual` before the formats in their order. Without the
/// header it is `usual`.
///
/// # Errors
/// 406 if the header permits neither `usual` nor a format of rows.
pub fn accepted(headers: &HeaderMap, usual: &'static str) -> ApiResult<Option<Format>> {
    let sent = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let ranges: Vec<MediaRange<'_>> =
        sent.flat_map(|value| value.split(',')).filter_map(MediaRange::read).collect();
    if ranges.is_empty() {
        return Ok(None);
    }
    let formats = Format::ALL.into_iter().filter(|format| format.streams());
    let formats = formats.map(|format| {
        let media_type = format.media_type();
        (media_type.split_once(';').map_or(media_type, |(name, _)| name), Some(format))
    });
    let offers: Vec<_> = once((usual, None)).chain(formats).collect();
    let mut best: Option<((f32, usize), Option<Format>)> = None;
    for &(name, format) in &offers {
        // The most precise range that holds the type states its weight.
        let holding = ranges.iter().filter_map(|one| Some((one.precision(name)?, one.weight)));
        let Some((precision, weight)) = holding.max_by_key(|&(precision, _)| precision) else {
            continue;
        };
        let rank = (weight, precision);
        if weight > 0.0 && best.is_none_or(|(most, _)| rank > most) {
            best = Some((rank, format));
        }
    }
    best.map(|(_, format)| format).ok_or_else(|| {
        let names: Vec<&str> = offers.iter().map(|(name, _)| *name).collect();
        let words = format!("Accept: must permit one of {}, or be absent", names.join(", "));
        ApiError::new(StatusCode::NOT_ACCEPTABLE, words)
    })
}

/// Returns the format of a list: `asked` if its parameter `format` is among `pairs`, else as [`accepted`] for pages.
///
/// # Errors
/// As [`accepted`].
pub fn of_list(
    asked: Option<Format>,
    pairs: &[(String, String)],
    headers: &HeaderMap,
) -> ApiResult<Option<Format>> {
    let is_asked = pairs.iter().any(|(key, _)| key == "format");
    if is_asked { Ok(asked) } else { accepted(headers, PAGE_TYPE) }
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    fn headers(values: &[&'static str]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for &value in values {
            headers.append(header::ACCEPT, HeaderValue::from_static(value));
        }
        headers
    }

    fn of(value: &'static str) -> Result<Option<Format>, StatusCode> {
        accepted(&headers(&[value]), PAGE_TYPE).map_err(|refused| refused.status())
    }

    #[test]
    fn the_largest_weight_decides() {
        assert_eq!(of("application/vnd.apache.parquet;q=0.1, text/csv"), Ok(Some(Format::Csv)));
        assert_eq!(of("text/csv;q=0.5, application/json;q=0.9"), Ok(None));
        assert_eq!(of("application/json;q=0, */*;q=0.1"), Ok(Some(Format::Parquet)));
        assert_eq!(of("TEXT/CSV; header=present; Q=0.7, */*; q=.2"), Ok(Some(Format::Csv)));
        let two = headers(&["text/csv;q=0.2", "application/x-ndjson;q=0.3"]);
        assert_eq!(accepted(&two, PAGE_TYPE).unwrap(), Some(Format::Ndjson));
    }

    #[test]
    fn among_equal_weights_a_named_type_precedes_and_then_the_usual_one() {
        assert_eq!(of("*/*, application/x-ndjson"), Ok(Some(Format::Ndjson)));
        assert_eq!(of("text/csv, application/json"), Ok(None));
        assert_eq!(of("text/csv, application/vnd.apache.parquet"), Ok(Some(Format::Parquet)));
        assert_eq!(of("text/*"), Ok(Some(Format::Csv)));
        assert_eq!(of("application/*"), Ok(None));
        assert_eq!(of("text/html, application/xhtml+xml, */*;q=0.8"), Ok(None));
    }

    #[test]
    fn what_fits_nothing_is_refused_and_what_states_nothing_gets_the_usual_type() {
        for none in ["image/png", "text/csv;q=0", "application/zip", "*/*;q=0"] {
            assert_eq!(of(none), Err(StatusCode::NOT_ACCEPTABLE), "{none}");
        }
        for nothing in ["", "csv", "text/csv;q=2", "text/csv;q=high"] {
            assert_eq!(of(nothing), Ok(None), "{nothing}");
        }
        assert_eq!(accepted(&HeaderMap::new(), PAGE_TYPE).unwrap(), None);
        let refused = accepted(&headers(&["image/png"]), PAGE_TYPE).unwrap_err();
        assert!(refused.detail().starts_with("Accept: must permit one of application/json, "));
    }

    #[test]
    fn the_parameter_precedes_the_header() {
        let (csv, image) = (headers(&["text/csv"]), headers(&["image/png"]));
        let json = [("format".to_owned(), "json".to_owned())];
        assert_eq!(of_list(None, &json, &csv).unwrap(), None);
        assert_eq!(of_list(None, &json, &image).unwrap(), None);
        assert_eq!(of_list(None, &[], &csv).unwrap(), Some(Format::Csv));
        assert!(of_list(None, &[], &image).is_err());
    }
}
