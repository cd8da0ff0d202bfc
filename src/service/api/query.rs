//! Parses query strings to selections of rows: `column__gt=..`, `columns`, `sort`, `limit`.
//! PURE. Uses: `store`'s table of columns and its conditions. Never: SQL, a name of a column.

use super::audit::cut;
use super::limits::{CONDITIONS_MAX, REPEATED_CHARS, VALUES_MAX};
use super::params::page_formats;
use crate::dataset::format::Format;
use crate::dataset::select::Wanted;
use crate::dataset::sort::Sort;
use crate::ids::RunUid;
use crate::problem::Problem;
use crate::query::groups::Grouping;
use crate::record::Flag;
use crate::store::table::{self, Column, Kind, RUN_COLUMNS, TABLE};
use crate::store::{Condition, MAX_PAGE, Order, TrialQuery};

/// Default number of rows per page.
const PAGE_ROWS: u32 = 100;

/// Selection of stored trials by a query string.
#[derive(Debug, Default)]
pub struct TrialsRequest {
    /// Run, conditions, order and page.
    pub query: TrialQuery,
    /// Order by another column than the id.
    pub sort: Option<Sort>,
    /// Columns and slice of the frames.
    pub wanted: Wanted,
    /// Format; `None` for JSON, or if the header `Accept` decides.
    pub format: Option<Format>,
}

/// Selection of a dataset's rows by a query string.
#[derive(Debug)]
pub struct RowsRequest {
    /// Conditions, columns, slice and force map.
    pub wanted: Wanted,
    /// Format; `None` for JSON, or if the header `Accept` decides.
    pub format: Option<Format>,
    /// Order; `None` for the order of the file.
    pub sort: Option<Sort>,
    /// Largest number of rows in the page.
    pub limit: u32,
}

/// Parses a query string for stored trials.
///
/// # Errors
/// All unknown names and invalid values.
pub fn trial_query(
    run: Option<RunUid>,
    pairs: &[(String, String)],
) -> Result<TrialsRequest, Vec<Problem>> {
    let query = TrialQuery { run, limit: PAGE_ROWS, ..TrialQuery::default() };
    let mut wanted = TrialsRequest { query, ..TrialsRequest::default() };
    each(pairs, |key, value| {
        no_groups(key, "/api/v1/trials/groups")?;
        if key == "sort" {
            match value {
                "trial_id" => wanted.query.order = Order::OldestFirst,
                "-trial_id" => wanted.query.order = Order::NewestFirst,
                other => wanted.sort = Some(of_trials(Sort::parse(other))?),
            }
            return Ok(true);
        }
        let of_datasets =
            |name: &str| Column::find(name.trim()).is_some_and(|column| !column.is_of_stored());
        if key == "columns" && value.split(',').any(of_datasets) {
            let names = table::names(Column::is_of_stored);
            return Err(format!("must name columns of stored trials: {names}"));
        }
        Ok(common(&mut wanted.wanted, &mut wanted.format, &mut wanted.query.limit, key, value)?
            || apply(&mut wanted.query, key, value)?)
    })?;
    Ok(wanted)
}

/// Parses a query string for the rows of a dataset. Conditions apply to the labelled rows.
///
/// # Errors
/// All unknown names and invalid values.
pub fn rows_query(pairs: &[(String, String)]) -> Result<RowsRequest, Vec<Problem>> {
    let wanted = Wanted::default();
    let mut request = RowsRequest { wanted, format: None, sort: None, limit: PAGE_ROWS };
    each(pairs, |key, value| {
        no_groups(key, "/api/v1/datasets/NAME/groups")?;
        if common(&mut request.wanted, &mut request.format, &mut request.limit, key, value)? {
            return Ok(true);
        }
        match key {
            "sort" => request.sort = Some(Sort::parse(value)),
            "map" => request.wanted.map = Some(value.into()),
            _ => {
                let text = condition(&TABLE, key, value)?.1;
                request.wanted.conditions.push(text);
            }
        }
        Ok(true)
    })?;
    Ok(request)
}

/// Parses a query string for a dataset as a file. It has no pages, and its name determines the
/// format.
///
/// # Errors
/// A parameter of pages, or all unknown names and invalid values.
pub fn file_query(pairs: &[(String, String)]) -> Result<Wanted, Vec<Problem>> {
    const PAGES: [&str; 4] = ["limit", "cursor", "format", "sort"];
    let of_pages = |key: &str| PAGES.contains(&key) || Grouping::has(key);
    if let Some((key, value)) = pairs.iter().find(|(key, _)| of_pages(key)) {
        let limit = "must be absent for a file, whose name determines the format; for pages use \
                     /api/v1/datasets/NAME/rows";
        return Err(vec![Problem::new("query", key, value, limit)]);
    }
    rows_query(pairs).map(|request| request.wanted)
}

/// Parses the conditions of a query string for runs.
///
/// # Errors
/// All unknown names and invalid values.
pub fn run_conditions(pairs: &[(String, String)]) -> Result<Vec<Condition>, Vec<Problem>> {
    let mut conditions = Vec::new();
    each(pairs, |key, value| {
        if !matches!(key, "limit" | "cursor") {
            conditions.push(condition(&RUN_COLUMNS, key, value)?.0);
        }
        Ok(true)
    })?;
    Ok(conditions)
}

/// Groups of rows by a query string.
#[derive(Debug)]
pub struct GroupsRequest {
    /// Conditions and number of groups; of the rows of a dataset only `filters` and `limit`.
    pub query: TrialQuery,
    /// Groups, aggregates, order.
    pub groups: Grouping,
    /// Format; `None` for JSON, or if the header `Accept` decides.
    pub format: Option<Format>,
}

/// What the rows of groups are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GroupsOf {
    /// Stored trials, with their parameters.
    StoredTrials,
    /// Rows of a dataset, with conditions on its columns.
    Dataset,
}

/// Parses a query string for groups.
///
/// # Errors
/// All unknown names and invalid values.
pub fn groups_query(
    pairs: &[(String, String)],
    of: GroupsOf,
) -> Result<GroupsRequest, Vec<Problem>> {
    // One more than are answered: without a limit all groups are.
    let query = TrialQuery { limit: MAX_PAGE + 1, ..TrialQuery::default() };
    let mut request = GroupsRequest { query, groups: Grouping::default(), format: None };
    let mut page = Wanted::default();
    each(pairs, |key, value| {
        if matches!(key, "columns" | "slice" | "cursor" | "voltages") {
            return Err("must be absent: groups have the columns of group_by, bin and agg".into());
        }
        if request.groups.apply(key, value)?
            || common(&mut page, &mut request.format, &mut request.query.limit, key, value)?
        {
            return Ok(true);
        }
        match of {
            GroupsOf::StoredTrials => apply(&mut request.query, key, value),
            GroupsOf::Dataset => {
                request.query.filters.push(condition(&TABLE, key, value)?.0);
                Ok(true)
            }
        }
    })?;
    Ok(request)
}

/// Refuses a parameter of groups where they are not.
fn no_groups(key: &str, there: &str) -> Result<(), String> {
    if Grouping::has(key) { Err(format!("must be absent: groups are at {there}")) } else { Ok(()) }
}

/// Checks that trials can be sorted by a column.
fn of_trials(sort: Sort) -> Result<Sort, String> {
    let comparable = |column: &Column| column.is_of_stored() && column.kind() != Kind::List;
    match Column::find(&sort.column) {
        Some(column) if comparable(column) => Ok(sort),
        _ => {
            let names = table::names(comparable);
            Err(format!("must be COLUMN or -COLUMN, with a column of {names}"))
        }
    }
}

/// Checks that a page can be written in a format, row by row.
///
/// # Errors
/// A problem that lists the formats of pages.
pub fn for_pages(format: Format) -> Result<(), Vec<Problem>> {
    if format.streams() {
        return Ok(());
    }
    let limit = format!(
        "must be one of {} for pages; a dataset as {format} is at /api/v1/data/NAME.{}",
        page_formats().join(", "),
        format.extension()
    );
    Err(vec![Problem::new("query", "format", format.name(), limit)])
}

/// Applies `apply` to each pair and collects the problems.
fn each(
    pairs: &[(String, String)],
    mut apply: impl FnMut(&str, &str) -> Result<bool, String>,
) -> Result<(), Vec<Problem>> {
    if pairs.len() > CONDITIONS_MAX {
        let limit = format!("must be at most {CONDITIONS_MAX} parameters");
        return Err(vec![Problem::new("query", "parameters", pairs.len(), limit)]);
    }
    let values: usize = pairs.iter().map(|(_, value)| value.split(',').count()).sum();
    if values > VALUES_MAX {
        let limit = format!("must have at most {VALUES_MAX} values in all");
        return Err(vec![Problem::new("query", "values", values, limit)]);
    }
    let mut problems = Vec::new();
    for (key, value) in pairs {
        if let Err(limit) = apply(key, value) {
            let (key, value) = (cut(key, REPEATED_CHARS), cut(value, REPEATED_CHARS));
            problems.push(Problem::new("query", &key, value, limit));
        }
    }
    if problems.is_empty() { Ok(()) } else { Err(problems) }
}

/// Applies a parameter that all lists of rows have; `false` for other keys.
fn common(
    wanted: &mut Wanted,
    format: &mut Option<Format>,
    page: &mut u32,
    key: &str,
    value: &str,
) -> Result<bool, String> {
    match key {
        // `pages` reads it.
        "cursor" => {}
        "limit" => match value.parse() {
            Ok(n @ 1..=MAX_PAGE) => *page = n,
            _ => return Err(format!("must be from 1 to {MAX_PAGE}; for more request an export")),
        },
        "columns" => {
            for name in value.split(',').map(str::trim) {
                if Column::find(name).is_none() {
                    let names = table::names(|_| true);
                    return Err(format!("column {name} is unknown; must be of {names}"));
                }
                wanted.columns.push(name.into());
            }
        }
        "slice" => wanted.slice = Some(value.into()),
        "format" if value == "json" => *format = None,
        "format" => *format = Some(value.parse().map_err(|e| format!("{e}, or json"))?),
        _ => return Ok(false),
    }
    Ok(true)
}

fn apply(query: &mut TrialQuery, key: &str, value: &str) -> Result<bool, String> {
    match key {
        "voltages" => query.with_voltages = yes_or_no(value)?,
        "flagged" => query.flagged = Some(yes_or_no(value)?),
        "flag" => query.flags.push(flag(value)?),
        _ => query.filters.push(condition(&TABLE, key, value)?.0.of_stored()?),
    }
    Ok(true)
}

/// A condition on columns of a table, as `where=COLUMN__gt=VALUE` or as `COLUMN__gt=VALUE`, and its text.
fn condition(
    table: &'static [Column],
    key: &str,
    value: &str,
) -> Result<(Condition, String), String> {
    let text = if key == "where" { value.to_owned() } else { format!("{key}={value}") };
    Ok((Condition::parse_of(table, &text)?, text))
}

fn yes_or_no(value: &str) -> Result<bool, String> {
    value.parse().map_err(|_| "must be true or false".into())
}

fn flag(value: &str) -> Result<Flag, String> {
    serde_json::from_value(value.into()).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(pairs: &[(&str, &str)]) -> Result<TrialQuery, Vec<Problem>> {
        let pairs: Vec<_> = pairs.iter().map(|&(k, v)| (k.into(), v.into())).collect();
        trial_query(None, &pairs).map(|wanted| wanted.query)
    }

    #[test]
    fn filters_are_read_from_their_suffixes() {
        let query = read(&[
            ("contact_count__gte", "3"),
            ("tips__in", "4,6"),
            ("where", "label=virtual"),
            ("sort", "-trial_id"),
            ("limit", "7"),
        ])
        .unwrap();
        let columns: Vec<&str> =
            query.filters.iter().flat_map(Condition::columns).map(|c| c.name).collect();
        assert_eq!(columns, ["contact_count", "tips", "label"]);
        assert_eq!((query.limit, query.order), (7, Order::NewestFirst));
    }

    #[test]
    fn runs_are_selected_in_the_same_language() {
        let conditions = |pairs: &[(&str, &str)]| {
            let pairs: Vec<_> = pairs.iter().map(|&(k, v)| (k.into(), v.into())).collect();
            run_conditions(&pairs)
        };
        let found = conditions(&[
            ("where", "state=interrupted|exit_status__in=abort,fail"),
            ("started_at__gte", "2026-11-24T22:00:00Z"),
            ("limit", "7"),
        ]);
        assert_eq!(found.unwrap().len(), 2);
        let wrong = conditions(&[("tips", "4"), ("state__gt", "idle")]).unwrap_err();
        assert!(wrong[0].limit.contains("there is no column tips; there are scan_id, experiment"));
        assert!(wrong[1].limit.contains("state holds words: use eq or in"), "{wrong:?}");
    }

    #[test]
    fn more_conditions_or_values_than_a_statement_may_have_are_refused() {
        let limit = |pairs: &[(&str, &str)]| read(pairs).unwrap_err()[0].limit.clone();
        let many = vec![("tips", "3"); CONDITIONS_MAX + 1];
        assert_eq!(limit(&many), "must be at most 100 parameters");
        assert!(read(&many[1..]).is_ok());
        let values = vec!["3"; VALUES_MAX + 1].join(",");
        assert_eq!(limit(&[("tips__in", &values)]), "must have at most 1000 values in all");
        let half = &values[..values.len() / 2];
        assert!(read(&[("tips__in", half), ("tips__in", half), ("limit", "3")]).is_err());
        assert!(read(&[("tips__in", &values[2..])]).is_ok());
    }

    #[test]
    fn without_a_limit_one_more_than_the_most_groups_is_read() {
        let limit = |pairs: &[(String, String)]| {
            groups_query(pairs, GroupsOf::StoredTrials).map(|asked| asked.query.limit)
        };
        assert_eq!(limit(&[]), Ok(MAX_PAGE + 1));
        assert_eq!(limit(&[("limit".into(), "7".into())]), Ok(7));
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
