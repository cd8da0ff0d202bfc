//! Groups of rows and their aggregates, by the conditions of filters, as a statement of the engine:
//! `group_by=contact_count`, `bin=depth_mm:0.5`, `agg=count,mean(fvu)`; of voltages `group_by=pair`, `agg=fvu`.
//! PURE. Uses: `store`'s columns and conditions. Never: a text of a request inside a statement, except
//! quoted.

use crate::dataset::sort::Sort;
use crate::store::table::{self, Column, Kind};
use crate::store::{Condition, TrialQuery};

/// Largest number of bins, aggregates and columns of groups together.
const PARTS_MAX: usize = 32;
/// Places of a voltage in its frame: columns of the engine's table of voltages.
const FRAME_PLACES: [&str; 3] = ["injection", "pair", "position"];
/// Variance of the measured voltages that the simulated ones leave unexplained, as a fraction (paper, Eq. 2).
const FVU_OF_VOLTAGES: &str = "AVG(POWER(CAST(voltage_v AS DOUBLE) - sim_voltage_v, 2)) / \
                   (AVG(POWER(CAST(voltage_v AS DOUBLE), 2)) - POWER(AVG(CAST(voltage_v AS DOUBLE)), 2))";

/// Aggregates of a column: name, whether the column must hold numbers, and expression; in double precision,
/// whatever the column has.
const FUNCTIONS: [(&str, bool, &str); 7] = [
    ("count", false, "COUNT(COLUMN)"),
    ("mean", true, "AVG(CAST(COLUMN AS DOUBLE))"),
    ("min", false, "MIN(COLUMN)"),
    ("max", false, "MAX(COLUMN)"),
    ("sum", true, "SUM(CAST(COLUMN AS DOUBLE))"),
    ("median", true, "MEDIAN(COLUMN)"),
    ("std", true, "STDDEV(CAST(COLUMN AS DOUBLE))"),
];

/// What a column of the result is made from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Source {
    /// A column of rows.
    Rows,
    /// Voltages, or their places in the frames.
    Voltages,
    /// Either of them: their number.
    Any,
}

/// A column of the result: what a group has in common, or an aggregate.
#[derive(Debug, Clone, PartialEq)]
struct Part {
    name: String,
    /// Its expression.
    sql: String,
    source: Source,
}

/// Groups, their aggregates, and their order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Grouping {
    keys: Vec<Part>,
    aggregates: Vec<Part>,
    sort: Vec<Sort>,
}

impl Grouping {
    /// Whether a parameter of a query string belongs to groups.
    pub fn has(key: &str) -> bool {
        matches!(key, "group_by" | "bin" | "agg")
    }

    /// Applies a parameter: `group_by`, `bin`, `agg` or `sort`; `false` for other keys.
    ///
    /// # Errors
    /// A message that names the invalid part and the choices.
    pub fn apply(&mut self, key: &str, value: &str) -> Result<bool, String> {
        let parts = value.split(',').map(str::trim).filter(|part| !part.is_empty());
        for part in parts {
            // A refusal repeats the whole value.
            let named =
                |limit: String| if part == value { limit } else { format!("{part}: {limit}") };
            match key {
                "group_by" => self.keys.push(group(part).map_err(named)?),
                "bin" => self.keys.push(bin(part).map_err(named)?),
                "agg" => self.aggregates.push(aggregate(part).map_err(named)?),
                "sort" => self.sort.push(Sort::parse(part)),
                _ => return Ok(false),
            }
        }
        if self.keys.len() + self.aggregates.len() > PARTS_MAX {
            return Err(format!("must be at most {PARTS_MAX} columns, bins and aggregates"));
        }
        Ok(matches!(key, "group_by" | "bin" | "agg" | "sort"))
    }

    /// Returns the statement for the groups of the rows of `table` that meet all conditions.
    ///
    /// # Errors
    /// A message with the columns of the result if `sort` names another one, or if places of voltages are
    /// mixed with columns of rows.
    pub fn sql(&self, table: &str, conditions: &[String], limit: u32) -> Result<String, String> {
        let counted = [Part::count()];
        let aggregates = if self.aggregates.is_empty() { &counted[..] } else { &self.aggregates };
        let all = || self.keys.iter().chain(aggregates);
        let mut order = Vec::new();
        for Sort { column: name, descending } in &self.sort {
            if !all().any(|part| part.name == *name) {
                let names: Vec<&str> = all().map(|part| part.name.as_str()).collect();
                return Err(format!("sort = {name}: must be of {}", names.join(", ")));
            }
            let direction = if *descending { " DESC" } else { "" };
            order.push(format!("{name}{direction} NULLS LAST"));
        }
        // Polars refuses a key that is repeated.
        let keys: Vec<&str> = self.keys.iter().map(|key| key.name.as_str()).collect();
        let more = keys.iter().filter(|key| !self.sort.iter().any(|sort| sort.column == **key));
        order.extend(more.map(|key| format!("{key} NULLS LAST")));
        let values: Vec<String> =
            all().map(|Part { name, sql, .. }| format!("{sql} AS {name}")).collect();
        let mut sql = format!("SELECT {} FROM ", values.join(", "));
        let has = |source: Source| all().any(|part| part.source == source);
        if has(Source::Voltages) {
            if table != "trials" || has(Source::Rows) {
                return Err(format!(
                    "{} and fvu are of the voltages of stored trials: must be with count and each other only",
                    FRAME_PLACES.join(", ")
                ));
            }
            // The engine applies a condition on a column of `voltages` before a frame becomes rows. For other
            // conditions it joins the rows as they come; IN with a subquery would hold all rows: of 10,000 frames
            // they do not fit into its memory.
            let (of_voltages, of_trials): (Vec<String>, Vec<String>) =
                conditions.iter().cloned().partition(|condition| is_of_voltages(condition));
            sql += "voltages";
            if !of_trials.is_empty() {
                let trials = filter(&of_trials);
                sql += &format!(
                    " SEMI JOIN (SELECT trial_id FROM trials{trials}) AS selected USING (trial_id)"
                );
            }
            sql += " WHERE sim_voltage_v IS NOT NULL";
            for condition in of_voltages {
                sql += &format!(" AND {condition}");
            }
        } else {
            sql += &(quoted(table) + &filter(conditions));
        }
        if !keys.is_empty() {
            sql += &format!(" GROUP BY {}", keys.join(", "));
        }
        if !order.is_empty() {
            sql += &format!(" ORDER BY {}", order.join(", "));
        }
        Ok(format!("{sql} LIMIT {limit}"))
    }
}

/// Whether a condition is on a column that the table of voltages has, too.
fn is_of_voltages(condition: &str) -> bool {
    ["scan_id ", "trial_id "].iter().any(|column| condition.starts_with(column))
}

/// Returns the conditions of a selection of trials as SQL of the engine.
pub fn conditions(query: &TrialQuery) -> Vec<String> {
    let run = query.run.iter().map(|run| format!("run = '{run}'"));
    let filters = query.filters.iter().map(Condition::to_sql);
    let flagged = query
        .flagged
        .iter()
        .map(|flagged| format!("ARRAY_LENGTH(flags) {} 0", if *flagged { ">" } else { "=" }));
    let flags =
        query.flags.iter().map(|flag| format!("ARRAY_CONTAINS(flags, '{}')", flag.as_str()));
    run.chain(filters).chain(flagged).chain(flags).collect()
}

/// The conditions as ` WHERE ..`, or nothing.
pub fn filter(conditions: &[String]) -> String {
    match conditions {
        [] => String::new(),
        all => format!(" WHERE {}", all.join(" AND ")),
    }
}

/// Returns the statement for the ids of a page of trials in the order of a column.
///
/// # Errors
/// A message with the columns of scalars if there is no such column.
pub fn sorted_ids(query: &TrialQuery, sort: &Sort, from: u64) -> Result<String, String> {
    let column = comparable(&sort.column)?;
    let filter = filter(&conditions(query));
    let direction = if sort.descending { " DESC" } else { "" };
    Ok(format!(
        "SELECT trial_id FROM trials{filter} ORDER BY {column}{direction} NULLS LAST, trial_id \
         LIMIT {} OFFSET {from}",
        query.limit
    ))
}

fn comparable(name: &str) -> Result<&'static str, String> {
    let is_comparable = |column: &Column| column.kind() != Kind::List;
    match Column::find(name).filter(|column| is_comparable(column)) {
        Some(column) => Ok(column.name),
        None => Err(format!("must be a column: {}", table::names(is_comparable))),
    }
}

fn number(name: &str) -> Result<&'static str, String> {
    let is_number = |column: &Column| column.kind() == Kind::Number;
    match Column::find(name).filter(|column| is_number(column)) {
        Some(column) => Ok(column.name),
        None => Err(format!("must be a column of numbers: {}", table::names(is_number))),
    }
}

fn group(text: &str) -> Result<Part, String> {
    let (name, source) = match FRAME_PLACES.into_iter().find(|place| *place == text) {
        Some(place) => (place, Source::Voltages),
        None => (comparable(text)?, Source::Rows),
    };
    Ok(Part { name: name.to_owned(), sql: name.to_owned(), source })
}

/// A range of values of a column, of a width in the unit of the column.
fn bin(text: &str) -> Result<Part, String> {
    let form = || "must be COLUMN:WIDTH, such as depth_mm:0.5".to_owned();
    let (column, width) = text.split_once(':').ok_or_else(form)?;
    let width = width.parse::<f64>().ok().filter(|width| width.is_finite() && *width > 0.0);
    let width = width.ok_or("must have a width that is a number above 0")?;
    let column = number(column)?;
    Ok(Part {
        name: format!("from_{column}"),
        // Rounded: in double precision 0.3 / 0.1 is below 3, and 3 x 0.1 above 0.3.
        sql: format!("ROUND(FLOOR(ROUND(CAST({column} AS DOUBLE) / {width}, 6)) * {width}, 9)"),
        source: Source::Rows,
    })
}

fn aggregate(text: &str) -> Result<Part, String> {
    const CHOICES: &str = "must be count, fvu of voltages, or count, mean, min, max, sum, median, std, or a \
                           quantile (q05, q90) of a column: mean(fvu)";
    match text {
        "count" => return Ok(Part::count()),
        "fvu" => {
            let (name, sql) = (text.to_owned(), FVU_OF_VOLTAGES.to_owned());
            return Ok(Part { name, sql, source: Source::Voltages });
        }
        _ => {}
    }
    let unknown = || CHOICES.to_owned();
    let (function, column) =
        text.strip_suffix(')').and_then(|text| text.split_once('(')).ok_or_else(unknown)?;
    let (name, sql) = match FUNCTIONS.iter().find(|(name, ..)| *name == function) {
        Some((name, of_numbers, sql)) => {
            let column = if *of_numbers { number(column)? } else { comparable(column)? };
            (format!("{name}_{column}"), sql.replace("COLUMN", column))
        }
        None => {
            let digits = function.strip_prefix('q').filter(|digits| digits.len() == 2);
            let percent: u8 = digits.and_then(|digits| digits.parse().ok()).ok_or_else(unknown)?;
            let (column, share) = (number(column)?, f64::from(percent) / 100.0);
            (format!("q{percent:02}_{column}"), format!("QUANTILE_CONT({column}, {share})"))
        }
    };
    Ok(Part { name, sql, source: Source::Rows })
}

/// A name of a table in a statement.
fn quoted(table: &str) -> String {
    format!("\"{}\"", table.replace('"', "\"\""))
}

impl Part {
    /// The number of rows, or of voltages.
    fn count() -> Self {
        Self { name: "count".into(), sql: "COUNT(*)".into(), source: Source::Any }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Flag;

    fn grouping(pairs: &[(&str, &str)]) -> Result<Grouping, String> {
        let mut grouping = Grouping::default();
        for (key, value) in pairs {
            assert!(grouping.apply(key, value)?, "{key}");
        }
        Ok(grouping)
    }

    #[test]
    fn groups_are_one_statement_in_the_order_of_their_keys() {
        let pairs = [("group_by", "tips"), ("bin", "depth_mm:0.5"), ("agg", "count,q90(fvu)")];
        let conditions = ["fvu < 1".to_owned(), "tips = 4".to_owned()];
        assert_eq!(
            grouping(&pairs).unwrap().sql("ds-1", &conditions, 9).unwrap(),
            "SELECT tips AS tips, \
             ROUND(FLOOR(ROUND(CAST(depth_mm AS DOUBLE) / 0.5, 6)) * 0.5, 9) AS from_depth_mm, \
             COUNT(*) AS count, QUANTILE_CONT(fvu, 0.9) AS q90_fvu FROM \"ds-1\" \
             WHERE fvu < 1 AND tips = 4 GROUP BY tips, from_depth_mm \
             ORDER BY tips NULLS LAST, from_depth_mm NULLS LAST LIMIT 9"
        );
        let whole = grouping(&[("agg", "mean(fvu)")]).unwrap().sql("trials", &[], 1).unwrap();
        assert_eq!(whole, "SELECT AVG(CAST(fvu AS DOUBLE)) AS mean_fvu FROM \"trials\" LIMIT 1");
        let sorted = grouping(&[("group_by", "label"), ("sort", "-count")]).unwrap();
        let order = "GROUP BY label ORDER BY count DESC NULLS LAST, label NULLS LAST";
        assert!(sorted.sql("trials", &[], 1).unwrap().contains(order));
    }

    #[test]
    fn places_of_voltages_are_groups_of_the_voltages_of_the_selected_trials() {
        let by_pair = grouping(&[("group_by", "pair"), ("agg", "fvu,count")]).unwrap();
        let sql = by_pair.sql("trials", &["tips = 4".to_owned()], 9).unwrap();
        assert!(sql.starts_with("SELECT pair AS pair, AVG(POWER("), "{sql}");
        let of = "AS fvu, COUNT(*) AS count FROM voltages SEMI JOIN (SELECT trial_id FROM trials WHERE tips = 4) \
                  AS selected USING (trial_id) WHERE sim_voltage_v IS NOT NULL GROUP BY pair";
        assert!(sql.contains(of), "{sql}");
        let run = "scan_id = 2".to_owned();
        let sql = by_pair.sql("trials", std::slice::from_ref(&run), 9).unwrap();
        assert!(sql.contains("IS NOT NULL AND scan_id = 2 GROUP BY pair"), "{sql}");
        let sql = by_pair.sql("trials", &[run, "tips = 4".to_owned()], 9).unwrap();
        let of = "trials WHERE tips = 4) AS selected USING (trial_id) WHERE sim_voltage_v IS NOT NULL AND \
                  scan_id = 2 GROUP BY pair";
        assert!(sql.contains(of), "{sql}");
        let wrong = |pairs: &[(&str, &str)], table| grouping(pairs).unwrap().sql(table, &[], 9);
        for (pairs, table) in [
            (&[("group_by", "pair")][..], "ds-1"),
            (&[("group_by", "pair,tips")], "trials"),
            (&[("group_by", "tips"), ("agg", "fvu")], "trials"),
            (&[("group_by", "pair"), ("agg", "mean(fvu)")], "trials"),
        ] {
            assert!(wrong(pairs, table).unwrap_err().contains("with count"), "{pairs:?} {table}");
        }
    }

    #[test]
    fn what_is_wrong_names_the_choices() {
        let wrong = |key, value| grouping(&[(key, value)]).unwrap_err();
        assert!(wrong("group_by", "colour").starts_with("must be a column: trial_id"));
        assert!(wrong("group_by", "tips,colour").starts_with("colour: must be a column"));
        assert!(wrong("group_by", "voltages_v").contains("must be a column: trial_id"));
        assert!(wrong("bin", "label:2").contains("of numbers: trial_id"));
        assert!(wrong("bin", "depth_mm").contains("COLUMN:WIDTH"));
        assert!(wrong("bin", "depth_mm:0").contains("above 0"));
        assert!(wrong("agg", "mode(fvu)").contains("q05, q90"));
        assert!(wrong("agg", "mean(label)").contains("of numbers"));
        assert!(wrong("agg", "fvu); DROP TABLE trials").contains("must be count"));
        let sort = grouping(&[("group_by", "tips"), ("sort", "fvu")]).unwrap();
        assert_eq!(sort.sql("trials", &[], 1).unwrap_err(), "sort = fvu: must be of tips, count");
        let many = vec!["count"; PARTS_MAX + 1].join(",");
        assert!(wrong("agg", &many).contains("at most 32"));
    }

    #[test]
    fn a_selection_of_trials_is_a_list_of_conditions() {
        let query = TrialQuery {
            filters: vec![Condition::parse("tips=4|fvu__gt=1").unwrap()],
            flags: vec![Flag::Unsettled],
            flagged: Some(false),
            limit: 5,
            ..TrialQuery::default()
        };
        let all = "(tips = 4 OR fvu > 1) AND ARRAY_LENGTH(flags) = 0 AND \
                   ARRAY_CONTAINS(flags, 'unsettled')";
        assert_eq!(conditions(&query).join(" AND "), all);
        assert_eq!(
            sorted_ids(&query, &Sort::parse("-fvu"), 10).unwrap(),
            format!(
                "SELECT trial_id FROM trials WHERE {all} ORDER BY fvu DESC NULLS LAST, trial_id \
                 LIMIT 5 OFFSET 10"
            )
        );
        assert!(sorted_ids(&query, &Sort::parse("-contacts"), 0).is_err());
    }
}
