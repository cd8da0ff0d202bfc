//! SQL that polars does not accept, rewritten as SQL that it accepts.
//! PURE. Uses: sqlparser, `aggregates`. Never: another meaning.
//!
//! ```text
//! WHERE fvu > (SELECT avg(fvu) ..)   FROM .. CROSS JOIN (SELECT avg(fvu) AS value_1 ..) AS value_1
//!                                    WHERE fvu > value_1
//! SELECT avg(fvu), max(fvu)          SELECT avg(fvu) AS "avg(fvu)", max(fvu) AS "max(fvu)"
//! .. ORDER BY avg(fvu)               .. ORDER BY "avg(fvu)"
//! TIMESTAMP '2027-01-15 08:00:00'    '2027-01-15 08:00:00'
//! ```

use std::ops::ControlFlow;

use sqlparser::ast::{
    DataType, ExcludeSelectItem, Expr, GroupByExpr, Ident, Join, JoinConstraint, JoinOperator,
    ObjectName, OrderBy, OrderByKind, Query, Select, SelectItem, SetExpr, Statement, TableAlias,
    TableFactor, VisitMut, VisitorMut,
};

use crate::aggregates::parts;
use crate::error::StatementError;

/// Longest name that a column of the result gets from its expression, characters.
const COLUMN_NAME_MAX: usize = 64;

/// Rewrites every SELECT of a statement.
#[derive(Default)]
pub struct Rewrite {
    values: usize,
}

impl VisitorMut for Rewrite {
    type Break = StatementError;

    fn pre_visit_select(&mut self, select: &mut Select) -> ControlFlow<StatementError> {
        let Some(condition) = select.selection.as_mut() else { return ControlFlow::Continue(()) };
        let mut values = Values { first: self.values, found: Vec::new(), queries: 0 };
        VisitMut::visit(condition, &mut values)?;
        self.values += values.found.len();
        let names: Vec<_> = values.found.iter().map(|(name, _)| name.clone()).collect();
        let Some(from) = select.from.last_mut() else { return ControlFlow::Continue(()) };
        from.joins.extend(values.found.into_iter().map(|(name, query)| cross_join(name, query)));
        for item in &mut select.projection {
            if let SelectItem::Wildcard(options) = item
                && !names.is_empty()
            {
                let mut excluded = match options.opt_exclude.take() {
                    Some(ExcludeSelectItem::Single(name)) => vec![name],
                    Some(ExcludeSelectItem::Multiple(names)) => names,
                    None => Vec::new(),
                };
                excluded.extend(names.iter().cloned().map(|name| ObjectName::from(vec![name])));
                options.opt_exclude = Some(ExcludeSelectItem::Multiple(excluded));
            }
        }
        ControlFlow::Continue(())
    }

    fn pre_visit_expr(&mut self, expr: &mut Expr) -> ControlFlow<StatementError> {
        if let Expr::TypedString(typed) = expr
            && matches!(typed.data_type, DataType::Timestamp(..) | DataType::Datetime(_))
        {
            *expr = Expr::Value(typed.value.clone());
        }
        ControlFlow::Continue(())
    }
}

/// The subqueries of a condition that are values.
struct Values {
    first: usize,
    found: Vec<(Ident, Box<Query>)>,
    queries: usize,
}

impl VisitorMut for Values {
    type Break = StatementError;

    fn pre_visit_query(&mut self, _: &mut Query) -> ControlFlow<StatementError> {
        self.queries += 1;
        ControlFlow::Continue(())
    }

    fn post_visit_query(&mut self, _: &mut Query) -> ControlFlow<StatementError> {
        self.queries -= 1;
        ControlFlow::Continue(())
    }

    fn pre_visit_expr(&mut self, expr: &mut Expr) -> ControlFlow<StatementError> {
        let Expr::Subquery(query) = expr else { return ControlFlow::Continue(()) };
        // A subquery of a subquery belongs to that one.
        if self.queries > 0 {
            return ControlFlow::Continue(());
        }
        let name = Ident::new(format!("value_{}", self.first + self.found.len() + 1));
        if !name_value(query, &name) {
            return ControlFlow::Break(StatementError::Subquery);
        }
        let Expr::Subquery(query) = std::mem::replace(expr, Expr::Identifier(name.clone())) else {
            return ControlFlow::Continue(());
        };
        self.found.push((name, query));
        ControlFlow::Continue(())
    }
}

/// Names the value of a query that always has exactly one; false if it may have more or none.
fn name_value(query: &mut Query, name: &Ident) -> bool {
    let Query { with: None, limit_clause: None, fetch: None, body, .. } = query else {
        return false;
    };
    let SetExpr::Select(select) = body.as_mut() else { return false };
    let grouped = !matches!(&select.group_by, GroupByExpr::Expressions(of, _) if of.is_empty());
    let plain = !grouped && select.having.is_none() && select.qualify.is_none();
    let [item] = select.projection.as_mut_slice() else { return false };
    let of = parts(item);
    if !plain || of.aggregate.is_none() || of.column.is_some() {
        return false;
    }
    let (SelectItem::UnnamedExpr(expr) | SelectItem::ExprWithAlias { expr, .. }) = item else {
        return false;
    };
    *item = SelectItem::ExprWithAlias { expr: expr.clone(), alias: name.clone() };
    true
}

fn cross_join(name: Ident, subquery: Box<Query>) -> Join {
    let alias = TableAlias { explicit: true, name, columns: Vec::new(), at: None };
    let relation =
        TableFactor::Derived { lateral: false, subquery, alias: Some(alias), sample: None };
    let join_operator = JoinOperator::CrossJoin(JoinConstraint::None);
    Join { relation, global: false, join_operator }
}

/// Names each column of the result that has no name as it was typed: polars would name it as the first
/// column in it, and refuse two of one name.
pub fn name_columns(statement: &mut Statement) {
    let Statement::Query(query) = statement else { return };
    let SetExpr::Select(select) = query.body.as_mut() else { return };
    for item in &mut select.projection {
        let SelectItem::UnnamedExpr(expr) = item else { continue };
        let is_column = matches!(expr, Expr::Identifier(_) | Expr::CompoundIdentifier(_));
        // These may stand for several columns.
        let is_several = matches!(&*expr, Expr::Function(function)
            if function.name.to_string().eq_ignore_ascii_case("columns"));
        let name = expr.to_string();
        if !is_column && !is_several && name.chars().count() <= COLUMN_NAME_MAX {
            let alias = Ident::with_quote('"', name);
            *item = SelectItem::ExprWithAlias { expr: expr.clone(), alias };
        }
    }
    // Polars sorts the result, which has these columns only.
    let Some(OrderBy { kind: OrderByKind::Expressions(sorted), .. }) = &mut query.order_by else {
        return;
    };
    for by in sorted {
        let same = select.projection.iter().find_map(|item| match item {
            SelectItem::ExprWithAlias { expr, alias } if *expr == by.expr => Some(alias),
            _ => None,
        });
        if let Some(alias) = same {
            by.expr = Expr::Identifier(Ident::with_quote('"', &alias.value));
        }
    }
}
