//! The refusals of likely mistakes, whole.
//! Uses: `common`. Never: a part of a refusal.

use crate::common::{BOUNDS, Bounds, Folder, Trials, ask, tables};

const TRIALS: &str = "there are trial_id, scan_id, label, tips, contact_count, max_force_n, sim_model, \
                      rmse_v, fvu, measured_at, contacts";

/// Statements and their refusals; `{trials}` is [`TRIALS`].
#[rustfmt::skip]
const MISTAKES: &[(&str, &str)] = &[
    // Names.
    ("SELECT fuv FROM trials", "no column fuv in trials; did you mean `fvu`?; {trials}"),
    ("SELECT t.fuv FROM trials t", "no column fuv in t; did you mean `fvu`?; {trials}"),
    ("SELECT FVU FROM trials", "no column FVU in trials; did you mean `fvu`?; {trials}"),
    ("SELECT colour FROM trials", "no column colour in trials; {trials}"),
    ("SELECT trial_id FROM trials ORDER BY max_force", "no column max_force in trials; did you mean `max_force_n`?; {trials}"),
    ("SELECT c.x FROM contacts c", "no column x in c; there are trial_id, scan_id, x_mm, y_mm, force_n, diameter_mm"),
    ("SELECT voltages_v FROM trials", "no column voltages_v here: it is in the table frames"),
    ("SELECT fvu FROM (SELECT tips FROM trials) AS few", "no column fvu at this place of the statement; there are tips"),
    ("SELECT x.fvu FROM trials t", "no table x in this FROM"),
    ("SELECT trial_id FROM trials t JOIN contacts c ON t.trial_id = c.trial_id", "trial_id is a column of several tables: write one of c.trial_id, t.trial_id"),
    ("SELECT tips, tips FROM trials", "the result has two columns tips: name one of them with AS"),
    ("WITH trials AS (SELECT * FROM trials WHERE tips = 1) SELECT * FROM trials", "no table trials at this place of the statement; a WITH clause needs another name than the table that it reads"),
    ("SELECT t.fvu FROM trials t JOIN contacts trials USING (trial_id)", "trials names two tables here: choose another name for the one that the statement defines"),
    // Quotes.
    ("SELECT count(*) FROM trials WHERE label = \"run-3\"", "no column run-3; a text is written with single quotes: 'run-3'"),
    ("SELECT count(*) FROM trials WHERE label = run-3", "no column run; a text is written with single quotes: 'run-3'"),
    ("SELECT count(*) FROM trials WHERE label = 'run-3", "expected the closing ' of a text (line 1, column 43)"),
    ("SELECT * FROM run-3", "expected end of statement, found - (line 1, column 18); a name with a - has double quotes: \"run-3\""),
    // Kinds of values.
    ("SELECT count(*) FROM trials WHERE tips = '3'", "a text cannot be compared with a number: a number has no quotes, a text has single quotes"),
    ("SELECT count(*) FROM trials WHERE label = 3", "a text cannot be compared with a number: a number has no quotes, a text has single quotes"),
    ("SELECT count(*) FROM trials WHERE measured_at > 'yesterday'", "a time is compared with a text such as '2027-01-15T08:00:10' or '2027-01-15', UTC"),
    ("SELECT count(*) FROM trials WHERE tips IN (1, 'a')", "a list of values needs values of one kind"),
    ("SELECT * FROM trials WHERE label", "WHERE needs a condition, not a text"),
    ("SELECT sum(label) FROM trials", "sum of a text is not possible"),
    ("SELECT avg(measured_at || 'a') FROM trials", "avg of a text is not possible"),
    ("SELECT fvu + label FROM trials", "arithmetic with a number and a text is not possible"),
    ("SELECT fvu / label FROM trials", "arithmetic with a text is not possible"),
    ("SELECT upper(tips) FROM trials", "tips is a number; a text is needed here"),
    ("SELECT CAST(label AS INT) FROM trials", "label has values that are not a number, such as 'run-1': TRY_CAST makes them null"),
    ("SELECT CAST(fvu AS DECIMAL(10, 3)) FROM trials", "CAST knows DOUBLE, REAL, INT, BIGINT, VARCHAR, BOOLEAN, DATE, TIME and TIMESTAMP"),
    ("SELECT * FROM trials WHERE label ~ '('", "the regular expression is invalid: unclosed group"),
    ("SELECT * FROM trials WHERE label LIKE 3", "LIKE needs a text with single quotes, such as 'run-%'"),
    // Groups.
    ("SELECT tips, avg(fvu) FROM trials", "tips is next to avg(fvu), which is one value: add GROUP BY, with each column"),
    ("SELECT *, count(*) FROM trials", "* is next to count(*), which is one value: add GROUP BY, with each column"),
    ("SELECT tips, label, count(*) FROM trials GROUP BY tips", "label is neither in GROUP BY nor in an aggregate such as avg(label)"),
    ("SELECT tips FROM trials WHERE max(fvu) > 0.5", "max(fvu) in WHERE: a condition on an aggregate follows GROUP BY, in HAVING"),
    ("SELECT tips, count(*) AS n FROM trials WHERE n > 3 GROUP BY tips", "no column n in trials; {trials}"),
    ("SELECT tips FROM trials HAVING tips > 1", "HAVING needs GROUP BY"),
    ("SELECT rank() FROM trials", "rank needs OVER (ORDER BY ..)"),
    // Functions.
    ("SELECT mean(fvu) FROM trials", "no function mean: write avg"),
    ("SELECT medain(fvu) FROM trials", "no function medain; did you mean `median`?"),
    ("SELECT frobnicate(fvu) FROM trials", "no function frobnicate"),
    ("SELECT date_trunc('day', measured_at) FROM trials", "no function date_trunc: write CAST(measured_at AS DATE), or strftime(measured_at, '%Y-%m-%d %H:00')"),
    ("SELECT percentile_cont(0.5) WITHIN GROUP (ORDER BY fvu) FROM trials", "no function percentile_cont: write quantile_cont(x, 0.9)"),
    ("SELECT quantile_cont(fvu, 90) FROM trials", "a quantile is between 0 and 1, such as 0.9"),
    ("SELECT round(fvu, 2, 3) FROM trials", "round takes 1-2 arguments, not 3"),
    ("SELECT voltages_v[1:3] FROM frames", "a part of a list is not possible: use the table voltages, WHERE position < 28"),
    ("SELECT contacts[1].force_n FROM trials", "only one step into a column is possible, such as voltages_v[1]: take the next in an outer SELECT"),
    ("SELECT label SIMILAR TO 'run%' AS s FROM trials", "SIMILAR TO is not possible here"),
    ("SELECT avg(fvu) OVER (ORDER BY trial_id ROWS BETWEEN 2 PRECEDING AND CURRENT ROW) AS a FROM trials", "a window has no frame but ROWS BETWEEN UNBOUNDED PRECEDING AND CURRENT ROW"),
    // Form.
    ("SELEC trial_id FROM trials", "expected an SQL statement, found SELEC (line 1, column 1)"),
    ("SELECT trial_id FORM trials", "expected end of statement, found trials (line 1, column 22)"),
    ("SELECT trial_id FROM trials WHERE", "expected an expression, found the end"),
    ("SELECT sum(fvu FROM trials", "expected ), found FROM (line 1, column 16)"),
    ("SELECT * FROM trials WHERE tips = 1 && fvu > 0.5", "&& is not possible: write AND"),
    ("SELECT * FROM trials JOIN contacts", "JOIN needs ON or USING; CROSS JOIN combines every row with every row"),
    ("SELECT trial_id FROM trials LIMIT ten", "LIMIT and OFFSET take a number that is not negative"),
    ("SELECT tips FROM trials UNION SELECT tips, fvu FROM trials", "both sides of UNION need the same number of columns"),
    ("SELECT trial_id FROM trials WHERE fvu > (SELECT fvu FROM trials)", "a comparison takes a subquery of one aggregate, such as (SELECT max(fvu) FROM trials); for several rows use IN, or JOIN"),
    ("SELECT (SELECT max(fvu) FROM trials) AS m FROM trials", "a subquery may be in FROM, after IN or EXISTS, and in a comparison of WHERE"),
    ("SELECT trial_id FROM trials; DROP TABLE trials", "has 2 statements; must be one SELECT statement"),
    ("UPDATE trials SET label = 'good'", "UPDATE is not possible; must be one SELECT statement (nothing can be written)"),
    ("SELECT * FROM read_csv('trials.csv')", "read_csv('trials.csv') cannot be read; FROM takes tables, subqueries and UNNEST"),
    ("SELECT a.trial_id FROM trials a, trials b, trials c, trials d", "the result has more than 1000000 rows: add LIMIT, or aggregate"),
];

#[test]
fn a_likely_mistake_is_refused_by_a_sentence_about_the_statement() {
    let folder = Folder::new("mistakes");
    let path = folder.file("a.parquet");
    Trials { first: 0, count: 40, channels: 16, without_twin: 10 }.write(&path);
    let known = tables(&[path], "run-3");
    let mut failures = Vec::new();
    for (sql, refusal) in MISTAKES {
        let found = ask(sql, &known, BOUNDS).refused();
        if found != format!("sql: {}", refusal.replace("{trials}", TRIALS)) {
            failures.push(format!("{sql}\n    {found}"));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    let few = Bounds { rows_max: 39, ..BOUNDS };
    for sql in ["SELECT trial_id FROM trials ORDER BY fvu", "SELECT trial_id FROM trials"] {
        let found = ask(sql, &known, few).refused();
        assert!(found.starts_with("sql: the result has more than 39 rows"), "{sql}: {found}");
    }
}

#[test]
fn a_statement_that_polars_would_answer_in_another_way_is_answered_as_in_sql() {
    let folder = Folder::new("meaning");
    let path = folder.file("a.parquet");
    let trials = Trials { first: 0, count: 40, channels: 16, without_twin: 10 };
    trials.write(&path);
    let known = tables(&[path], "run-3");
    let text = |sql: &str| crate::common::text(&ask(sql, &known, BOUNDS).rows());
    // Two columns of polars' name `fvu`.
    let both = ask("SELECT min(fvu), max(fvu) FROM trials", &known, BOUNDS).rows();
    assert_eq!(both.get_column_names(), ["min(fvu)", "max(fvu)"]);
    // Counts of unions.
    assert_eq!(text("SELECT count(*) FROM voltages"), "640");
    assert_eq!(
        text(
            "SELECT count(*) FROM (SELECT tips FROM trials UNION ALL SELECT tips FROM trials) AS a"
        ),
        "80"
    );
    // A value among conditions.
    let top = "SELECT trial_id FROM trials WHERE fvu = (SELECT max(fvu) FROM trials)";
    assert_eq!(text(top), text("SELECT trial_id FROM trials ORDER BY fvu DESC NULLS LAST LIMIT 1"));
    let all = ask("SELECT * FROM trials WHERE fvu < (SELECT avg(fvu) FROM trials)", &known, BOUNDS)
        .rows();
    assert_eq!(all.width(), trials.rows().width() - 2, "no column more than the table's");
    let with = "SELECT trial_id FROM trials WHERE tips = 1 AND trial_id > (SELECT avg(trial_id) FROM trials \
                WHERE fvu < (SELECT max(fvu) FROM trials)) ORDER BY trial_id LIMIT 2";
    assert_eq!(text(with), "21\n25");
    // The order of an aggregate.
    let named = "SELECT tips, avg(fvu) AS m FROM trials GROUP BY tips ORDER BY m DESC";
    let typed = "SELECT tips, avg(fvu) FROM trials GROUP BY tips ORDER BY avg(fvu) DESC";
    assert_eq!(text(named), text(typed));
    let many = "SELECT tips, avg(fvu) AS m FROM trials GROUP BY tips ORDER BY avg(fvu) DESC";
    assert_eq!(text(named), text(many));
}
