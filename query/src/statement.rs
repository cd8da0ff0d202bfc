//! Which statements are evaluated: one SELECT over named tables, in the form that polars takes.
//! PURE. Uses: sqlparser, with the dialect of polars. Never: a table's rows.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use palpate_words::query_lines::SQL_MAX_BYTES;
use sqlparser::ast::{
    Expr, GroupByExpr, Query, Select, SetExpr, Statement as Ast, TableFactor, Visit, VisitMut,
    Visitor,
};
use sqlparser::dialect::GenericDialect;
use sqlparser::parser::{Parser, ParserError, ParserOptions};

use crate::aggregates::{Parts, parts};
use crate::error::{DEPTH_MAX, StatementError};
use crate::rewrite;

/// A statement that may be evaluated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Statement {
    /// The tables that it reads, except those that its WITH clauses define.
    pub tables: BTreeSet<String>,
    /// Whether it sorts its rows and returns all of them.
    pub sorts_all: bool,
    /// The statement for polars.
    pub sql: String,
    /// The statement as a person has typed it.
    pub typed: String,
}

/// Reads a statement.
///
/// # Errors
/// `StatementError` if it is not one SELECT statement over tables.
pub fn read(sql: &str) -> Result<Statement, StatementError> {
    if sql.len() > SQL_MAX_BYTES {
        return Err(StatementError::Long(sql.len()));
    }
    let mut statement = parse(sql)?;
    let mut reads = Reads::default();
    if let ControlFlow::Break(error) = statement.visit(&mut reads) {
        return Err(error);
    }
    let tables = reads.tables.difference(&reads.defined).cloned().collect();
    if let Some(name) = reads.confused(&tables) {
        return Err(StatementError::Names(name));
    }
    let mut rewrite = rewrite::Rewrite::default();
    if let ControlFlow::Break(error) = VisitMut::visit(&mut statement, &mut rewrite) {
        return Err(error);
    }
    rewrite::name_columns(&mut statement);
    let sorts_all = matches!(&statement, Ast::Query(query)
        if query.order_by.is_some() && query.limit_clause.is_none() && query.fetch.is_none());
    Ok(Statement { tables, sorts_all, sql: statement.to_string(), typed: sql.to_owned() })
}

fn parse(sql: &str) -> Result<Ast, StatementError> {
    let options = ParserOptions { trailing_commas: true, ..ParserOptions::default() };
    let statements = Parser::new(&GenericDialect)
        .with_options(options)
        .try_with_sql(sql)
        .and_then(|mut parser| parser.parse_statements())
        .map_err(syntax)?;
    let count = statements.len();
    let Ok([statement]) = <[Ast; 1]>::try_from(statements) else {
        return Err(StatementError::Count(count));
    };
    if !matches!(statement, Ast::Query(_)) {
        let words = statement.to_string();
        let verb = words.split_whitespace().next().unwrap_or_default().to_owned();
        return Err(StatementError::Kind(verb));
    }
    Ok(statement)
}

/// `expected x, found y (line 1, column 5)`.
fn syntax(error: ParserError) -> StatementError {
    let words = match error {
        ParserError::RecursionLimitExceeded => return StatementError::Deep,
        ParserError::TokenizerError(words) | ParserError::ParserError(words) => words,
    };
    let (words, place) = match words.rsplit_once(" at Line: ") {
        Some((words, place)) => {
            (words, format!(" (line {})", place.replace(", Column: ", ", column ")))
        }
        None => (words.as_str(), String::new()),
    };
    let words = words.trim_end_matches('.').replacen("Expected: ", "expected ", 1);
    let words = words.replacen("found: ", "found ", 1).replace("found EOF", "found the end");
    let words = match words.strip_prefix("Expected close delimiter") {
        Some(rest) => format!("expected the closing{}", rest.replace(" before EOF", "")),
        None => words.replace("Unterminated string literal", "expected the closing \' of a text"),
    };
    let words: String = words.chars().take(WORDS_MAX).collect();
    let hint = match words.ends_with("found -") {
        true => "; a name with a - has double quotes: \"run-3\"",
        false => "",
    };
    StatementError::Syntax(format!("{words}{place}{hint}"))
}

/// Longest part of a statement that a message shows, characters.
const WORDS_MAX: usize = 150;

/// The start of a part of a statement, for a message.
fn shown(part: &impl ToString) -> String {
    let text = part.to_string();
    if text.chars().count() <= WORDS_MAX {
        return text;
    }
    text.chars().take(WORDS_MAX - 2).chain("..".chars()).collect()
}

/// Names found in a statement.
#[derive(Default)]
struct Reads {
    /// Tables that FROM names.
    tables: BTreeSet<String>,
    /// Names that WITH defines.
    defined: BTreeSet<String>,
    /// Names that are defined twice by WITH.
    twice: Option<String>,
    /// Aliases of subqueries.
    subqueries: BTreeSet<String>,
    /// Aliases of tables, and the tables.
    aliases: BTreeSet<(String, String)>,
    depth: usize,
}

impl Reads {
    /// A name by which polars would find another table than the one that SQL means.
    fn confused(&self, tables: &BTreeSet<String>) -> Option<String> {
        let known = |name: &&String| tables.contains(*name) || self.defined.contains(*name);
        let alias = self.aliases.iter().filter(|(alias, table)| alias != table);
        let alias = alias.map(|(alias, _)| alias).find(known);
        let subquery = self.subqueries.iter().find(known);
        self.twice.as_ref().or(subquery).or(alias).cloned()
    }

    fn deeper(&mut self) -> ControlFlow<StatementError> {
        self.depth += 1;
        if self.depth > DEPTH_MAX {
            return ControlFlow::Break(StatementError::Deep);
        }
        ControlFlow::Continue(())
    }
}

impl Visitor for Reads {
    type Break = StatementError;

    fn pre_visit_query(&mut self, query: &Query) -> ControlFlow<StatementError> {
        for cte in query.with.iter().flat_map(|with| &with.cte_tables) {
            let name = &cte.alias.name.value;
            if !self.defined.insert(name.clone()) {
                self.twice = Some(name.clone());
            }
        }
        let recursive = query.with.as_ref().is_some_and(|with| with.recursive);
        let other = match query.body.as_ref() {
            _ if recursive => Some("WITH RECURSIVE"),
            _ if !query.locks.is_empty() => Some("FOR UPDATE"),
            SetExpr::Insert(_) => Some("INSERT"),
            SetExpr::Update(_) => Some("UPDATE"),
            SetExpr::Delete(_) => Some("DELETE"),
            SetExpr::Merge(_) => Some("MERGE"),
            _ => None,
        };
        match other {
            Some(kind) => ControlFlow::Break(StatementError::Kind(kind.into())),
            None => self.deeper(),
        }
    }

    fn post_visit_query(&mut self, _: &Query) -> ControlFlow<StatementError> {
        self.depth -= 1;
        ControlFlow::Continue(())
    }

    fn pre_visit_select(&mut self, select: &Select) -> ControlFlow<StatementError> {
        match select_error(select) {
            Some(error) => ControlFlow::Break(error),
            None => ControlFlow::Continue(()),
        }
    }

    fn pre_visit_expr(&mut self, _: &Expr) -> ControlFlow<StatementError> {
        self.deeper()
    }

    fn post_visit_expr(&mut self, _: &Expr) -> ControlFlow<StatementError> {
        self.depth -= 1;
        ControlFlow::Continue(())
    }

    fn pre_visit_table_factor(&mut self, factor: &TableFactor) -> ControlFlow<StatementError> {
        let (name, alias) = match factor {
            TableFactor::Table { name, args: None, alias, .. } => (name, alias),
            TableFactor::Derived { alias, .. } => {
                self.subqueries.extend(alias.iter().map(|alias| alias.name.value.clone()));
                return ControlFlow::Continue(());
            }
            TableFactor::NestedJoin { .. } | TableFactor::UNNEST { .. } => {
                return ControlFlow::Continue(());
            }
            other => return ControlFlow::Break(StatementError::Source(shown(other))),
        };
        let parts: Vec<_> = name.0.iter().filter_map(|part| part.as_ident()).collect();
        let [table] = parts.as_slice() else {
            return ControlFlow::Break(StatementError::Source(shown(name)));
        };
        if name.0.len() != 1 {
            return ControlFlow::Break(StatementError::Source(shown(name)));
        }
        self.tables.insert(table.value.clone());
        if let Some(alias) = alias {
            self.aliases.insert((alias.name.value.clone(), table.value.clone()));
        }
        ControlFlow::Continue(())
    }
}

/// What polars would accept but answer in its own way.
fn select_error(select: &Select) -> Option<StatementError> {
    if select.into.is_some() {
        return Some(StatementError::Kind("SELECT INTO".into()));
    }
    if let Some(aggregate) = select.selection.as_ref().and_then(|of| parts(of).aggregate) {
        return Some(StatementError::Where(shown(&aggregate)));
    }
    if !matches!(&select.group_by, GroupByExpr::Expressions(of, _) if of.is_empty()) {
        return None;
    }
    if select.having.is_some() {
        return Some(StatementError::Having);
    }
    let all = select.projection.iter().map(parts).fold(Parts::default(), Parts::and);
    let (column, aggregate) = (all.column?, all.aggregate?);
    Some(StatementError::Group { column: shown(&column), aggregate: shown(&aggregate) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(sql: &str) -> Vec<String> {
        super::read(sql).unwrap().tables.into_iter().collect()
    }

    #[test]
    fn the_tables_of_joins_subqueries_and_unions_are_found() {
        assert_eq!(names("SELECT tips, count(*) FROM trials GROUP BY tips"), ["trials"]);
        assert_eq!(
            names("SELECT * FROM trials t JOIN \"run-3\" r USING (trial_id)"),
            ["run-3", "trials"]
        );
        assert_eq!(
            names(
                "WITH few AS (SELECT * FROM contacts) SELECT * FROM few, runs WHERE scan_id IN \
                  (SELECT scan_id FROM events) UNION SELECT * FROM twins"
            ),
            ["contacts", "events", "runs", "twins"]
        );
    }

    #[test]
    fn everything_but_one_select_is_refused() {
        for sql in [
            "",
            ";",
            "SELECT 1; SELECT 2",
            "DROP TABLE trials",
            "DELETE FROM trials",
            "TRUNCATE TABLE trials",
            "UPDATE trials SET tips = 0",
            "INSERT INTO trials VALUES (1)",
            "CREATE TABLE a AS SELECT * FROM trials",
            "SELECT * INTO a FROM trials",
            "EXPLAIN SELECT * FROM trials",
            "SHOW TABLES",
            "PRAGMA table_info(trials)",
            "ATTACH DATABASE 'a' AS b",
            "COPY trials TO '/tmp/a'",
            "SET a = 1",
            "SELECT * FROM read_parquet('/etc/passwd')",
            "SELECT * FROM read_csv('http://a/b')",
            "SELECT * FROM trials, read_json('/etc/passwd')",
            "SELECT * FROM (SELECT * FROM read_ipc('/etc/passwd'))",
            "SELECT 1 WHERE 1 IN (SELECT a FROM read_csv('/etc/passwd'))",
            "WITH a AS (SELECT * FROM read_csv('/etc/passwd')) SELECT * FROM a",
            "SELECT * FROM main.trials",
            "SELECT * FROM trials FOR UPDATE",
            "WITH RECURSIVE a AS (SELECT 1 UNION ALL SELECT * FROM a) SELECT * FROM a",
        ] {
            assert!(super::read(sql).is_err(), "{sql}: {:?}", super::read(sql));
        }
        let words = super::read("DROP TABLE trials").unwrap_err().to_string();
        assert!(words.starts_with("sql: DROP is not possible; must be one SELECT"), "{words}");
        let words = super::read("SELECT * FROM read_csv('a')").unwrap_err().to_string();
        assert!(words.contains("read_csv('a') cannot be read"), "{words}");
        let words = super::read("SELEC 1").unwrap_err().to_string();
        assert!(words.contains("(line 1, column 1)"), "{words}");
        let deep = format!("SELECT {}1{}", "(".repeat(20_000), ")".repeat(20_000));
        assert!(super::read(&deep).unwrap_err().to_string().contains("nested more than"));
        assert_eq!(super::read(&" ".repeat(70_000)), Err(StatementError::Long(70_000)));
    }

    #[test]
    fn names_that_polars_would_confuse_are_refused() {
        for (sql, name) in [
            ("SELECT * FROM (SELECT 1 AS n) AS trials, trials AS t", "trials"),
            ("SELECT * FROM trials AS contacts, contacts", "contacts"),
            ("WITH a AS (SELECT 1) SELECT * FROM (SELECT 2) AS a, a AS b", "a"),
            ("WITH a AS (SELECT 1), a AS (SELECT 2) SELECT * FROM a", "a"),
        ] {
            assert_eq!(super::read(sql), Err(StatementError::Names(name.into())), "{sql}");
        }
        for sql in [
            "SELECT * FROM trials AS trials, contacts c",
            "SELECT * FROM (SELECT * FROM trials AS t) AS t",
            "SELECT * FROM (SELECT 1 AS n) AS a JOIN (SELECT 1 AS n) AS b USING (n)",
        ] {
            assert!(super::read(sql).is_ok(), "{sql}: {:?}", super::read(sql));
        }
    }

    #[test]
    fn aggregates_are_not_mixed_with_rows() {
        let refused = |sql: &str| super::read(sql).unwrap_err();
        assert!(matches!(
            refused("SELECT tips + max(fvu) FROM trials"),
            StatementError::Group { .. }
        ));
        assert!(matches!(refused("SELECT * FROM a WHERE b > avg(b)"), StatementError::Where(_)));
        for sql in [
            "SELECT max(fvu) - min(fvu), count(*), 1 FROM trials",
            "SELECT tips, max(fvu) OVER (PARTITION BY tips) AS m FROM trials",
            "SELECT tips, max(fvu) FROM trials GROUP BY ALL",
            "SELECT count(*) FILTER (WHERE tips = 1) FROM a WHERE b IN (SELECT max(b) FROM c)",
        ] {
            assert!(super::read(sql).is_ok(), "{sql}: {:?}", super::read(sql));
        }
    }

    fn rewritten(sql: &str) -> String {
        read(sql).unwrap().sql
    }

    #[test]
    fn a_plain_statement_stays_as_it_is() {
        for sql in [
            "SELECT tips, t.fvu, label AS l FROM trials AS t WHERE tips IN (SELECT tips FROM twins)",
            "SELECT tips, count(*) AS n FROM trials GROUP BY tips ORDER BY n",
            "SELECT columns('a') FROM trials",
        ] {
            assert_eq!(rewritten(sql), sql);
        }
    }

    #[test]
    fn columns_of_the_result_have_the_names_of_their_expressions() {
        assert_eq!(
            rewritten("SELECT tips, avg(fvu), 'a\"b' FROM trials GROUP BY tips ORDER BY avg(fvu)"),
            "SELECT tips, avg(fvu) AS \"avg(fvu)\", 'a\"b' AS \"'a\"\"b'\" FROM trials GROUP BY tips \
             ORDER BY \"avg(fvu)\""
        );
        let inner = "SELECT m FROM (SELECT avg(fvu) FROM trials) AS a (m)";
        assert_eq!(rewritten(inner), inner);
    }

    #[test]
    fn a_value_of_a_subquery_is_joined() {
        assert_eq!(
            rewritten(
                "SELECT * FROM a WHERE x > (SELECT max(x) FROM b WHERE y = (SELECT min(y) FROM c))"
            ),
            "SELECT * EXCLUDE (value_1) FROM a CROSS JOIN (SELECT max(x) AS value_1 FROM b CROSS JOIN \
             (SELECT min(y) AS value_2 FROM c) AS value_2 WHERE y = value_2) AS value_1 WHERE x > value_1"
        );
        for sql in [
            "SELECT * FROM a WHERE x > (SELECT x FROM b)",
            "SELECT * FROM a WHERE x > (SELECT max(x) FROM b GROUP BY y)",
            "SELECT * FROM a WHERE x > (SELECT max(x) FROM b LIMIT 0)",
            "SELECT * FROM a WHERE x > (SELECT max(x), min(x) FROM b)",
            "SELECT * FROM a WHERE x > (SELECT max(x) FROM b UNION SELECT 1)",
        ] {
            assert_eq!(read(sql), Err(StatementError::Subquery), "{sql}");
        }
    }
}
