//! Which parts of an expression are one value for many rows.
//! PURE. Uses: sqlparser. Never: a subquery inside of the expression.

use std::ops::ControlFlow;

use sqlparser::ast::{Expr, Query, SelectItem, SelectItemQualifiedWildcardKind, Visit, Visitor};

/// Functions that make one value of many rows.
const AGGREGATES: [&str; 26] = [
    "array_agg",
    "avg",
    "corr",
    "count",
    "covar",
    "covar_pop",
    "covar_samp",
    "first",
    "group_concat",
    "last",
    "listagg",
    "max",
    "median",
    "min",
    "quantile_cont",
    "quantile_disc",
    "stddev",
    "stddev_samp",
    "stdev",
    "stdev_samp",
    "string_agg",
    "sum",
    "total",
    "var",
    "var_samp",
    "variance",
];

/// What an expression consists of.
#[derive(Debug, Default)]
pub struct Parts {
    /// Its first column, as typed, that is not in an aggregate.
    pub column: Option<String>,
    /// Its first aggregate, as typed.
    pub aggregate: Option<String>,
    aggregates: usize,
    queries: usize,
}

impl Parts {
    /// The parts of two expressions.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            column: self.column.or(other.column),
            aggregate: self.aggregate.or(other.aggregate),
            ..Self::default()
        }
    }
}

/// Returns the parts of an expression, or of an item of SELECT.
pub fn parts<T: Visit + Whole>(of: &T) -> Parts {
    let mut parts = Parts { column: of.rows(), ..Parts::default() };
    let _ = of.visit(&mut parts);
    parts
}

/// What has columns without naming them.
pub trait Whole {
    /// The wildcard, if it is one.
    fn rows(&self) -> Option<String>;
}

impl Whole for Expr {
    fn rows(&self) -> Option<String> {
        None
    }
}

impl Whole for SelectItem {
    fn rows(&self) -> Option<String> {
        match self {
            Self::Wildcard(_) => Some("*".into()),
            Self::QualifiedWildcard(SelectItemQualifiedWildcardKind::ObjectName(name), _) => {
                Some(format!("{name}.*"))
            }
            _ => None,
        }
    }
}

/// True for an aggregate over rows, not over a window.
fn is_aggregate(expr: &Expr) -> bool {
    let Expr::Function(function) = expr else { return false };
    let name = function.name.to_string().to_lowercase();
    function.over.is_none() && AGGREGATES.contains(&name.as_str())
}

impl Visitor for Parts {
    type Break = ();

    fn pre_visit_query(&mut self, _: &Query) -> ControlFlow<()> {
        self.queries += 1;
        ControlFlow::Continue(())
    }

    fn post_visit_query(&mut self, _: &Query) -> ControlFlow<()> {
        self.queries -= 1;
        ControlFlow::Continue(())
    }

    fn pre_visit_expr(&mut self, expr: &Expr) -> ControlFlow<()> {
        if self.queries > 0 {
            return ControlFlow::Continue(());
        }
        if is_aggregate(expr) {
            self.aggregates += 1;
            self.aggregate.get_or_insert_with(|| expr.to_string());
        }
        if self.aggregates == 0 && matches!(expr, Expr::Identifier(_) | Expr::CompoundIdentifier(_))
        {
            self.column.get_or_insert_with(|| expr.to_string());
        }
        ControlFlow::Continue(())
    }

    fn post_visit_expr(&mut self, expr: &Expr) -> ControlFlow<()> {
        if self.queries == 0 && is_aggregate(expr) {
            self.aggregates -= 1;
        }
        ControlFlow::Continue(())
    }
}
