//! A query string as filters over trials: `column__gt=..`, `sort`, `limit`, `cursor`.
//! PURE. Uses: `store`'s closed lists of columns and comparisons. Never: SQL.

use crate::campaign::record::Flag;
use crate::ids::{RunUid, TrialId};
use crate::problem::Problem;
use crate::store::{Comparison, Filter, FilterValue, MAX_PAGE, Order, TrialColumn, TrialQuery};

/// Rows of a page, unless asked otherwise.
const PAGE: u32 = 100;

/// Reads the pairs of a query string; an unknown name is a problem, not ignored.
pub fn trial_query(
    run: Option<RunUid>,
    pairs: &[(String, String)],
) -> Result<TrialQuery, Vec<Problem>> {
    let mut query = TrialQuery { run, limit: PAGE, ..TrialQuery::default() };
    let mut problems = Vec::new();
    for (key, value) in pairs {
        if let Err(limit) = apply(&mut query, key, value) {
            problems.push(Problem::new("query", key, value, limit));
        }
    }
    if problems.is_empty() { Ok(query) } else { Err(problems) }
}

fn apply(query: &mut TrialQuery, key: &str, value: &str) -> Result<(), String> {
    match key {
        "key" => {}
        "limit" => match value.parse() {
            Ok(n @ 1..=MAX_PAGE) => query.limit = n,
            _ => return Err(format!("must be from 1 to {MAX_PAGE}")),
        },
        "cursor" => query.after = Some(TrialId(number(value)?)),
        "voltages" => query.with_voltages = number(value)?,
        "flagged" => query.flagged = Some(number(value)?),
        "flag" => query.flags.push(flag(value)?),
        "sort" => {
            query.order = match value {
                "trial_id" => Order::OldestFirst,
                "-trial_id" => Order::NewestFirst,
                _ => return Err("must be trial_id or -trial_id".into()),
            }
        }
        _ => query.filters.push(filter(key, value)?),
    }
    Ok(())
}

fn number<T: std::str::FromStr>(value: &str) -> Result<T, String> {
    value.parse().map_err(|_| format!("must be a {}", std::any::type_name::<T>()))
}

fn flag(value: &str) -> Result<Flag, String> {
    serde_json::from_value(value.into()).map_err(|e| e.to_string())
}

fn filter(key: &str, value: &str) -> Result<Filter, String> {
    let (name, suffix) = key.rsplit_once("__").unwrap_or((key, "eq"));
    let column = TrialColumn::from_name(name).ok_or_else(|| {
        let names: Vec<&str> = TrialColumn::ALL.iter().map(|c| c.name()).collect();
        format!("unknown; filters are COLUMN__eq|gt|gte|lt|lte|in on {}", names.join(", "))
    })?;
    let typed = |text: &str| -> Result<FilterValue, String> {
        if column.is_time() {
            let time = text.parse().map_err(|_| "must be an RFC 3339 time".to_owned())?;
            Ok(FilterValue::Time(time))
        } else {
            Ok(FilterValue::Number(number(text)?))
        }
    };
    if suffix == "in" {
        return Ok(Filter::OneOf(column, value.split(',').map(typed).collect::<Result<_, _>>()?));
    }
    let comparison = Comparison::from_suffix(suffix)
        .ok_or_else(|| format!("{suffix}: must be eq, gt, gte, lt, lte or in"))?;
    Ok(Filter::Compare(column, comparison, typed(value)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(pairs: &[(&str, &str)]) -> Result<TrialQuery, Vec<Problem>> {
        let pairs: Vec<_> = pairs.iter().map(|&(k, v)| (k.into(), v.into())).collect();
        trial_query(None, &pairs)
    }

    #[test]
    fn filters_are_read_from_their_suffixes() {
        let query = read(&[
            ("contact_count__gte", "3"),
            ("tips__in", "4,6"),
            ("sort", "-trial_id"),
            ("limit", "7"),
        ])
        .unwrap();
        let three = FilterValue::Number(3.0);
        let four_or_six = vec![FilterValue::Number(4.0), FilterValue::Number(6.0)];
        assert_eq!(
            query.filters,
            [
                Filter::Compare(TrialColumn::ContactCount, Comparison::GreaterOrEqual, three),
                Filter::OneOf(TrialColumn::Tips, four_or_six),
            ]
        );
        assert_eq!((query.limit, query.order), (7, Order::NewestFirst));
    }

    #[test]
    fn every_wrong_name_or_value_is_named() {
        let wrong =
            [("colour", "red"), ("limit", "0"), ("tips__near", "3"), ("started_at__gt", "5")];
        let problems = read(&wrong).unwrap_err();
        let keys: Vec<&str> = problems.iter().map(|p| p.key.as_str()).collect();
        assert_eq!(keys, ["colour", "limit", "tips__near", "started_at__gt"]);
    }
}
