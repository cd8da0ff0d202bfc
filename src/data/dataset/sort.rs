//! The order of rows by a scalar column.
//! PURE. Uses: arrow. Never: frames, files.

use arrow_array::{ArrayRef, UInt64Array};
use arrow_ord::sort::{SortColumn, SortOptions, lexsort_to_indices};
use arrow_schema::{ArrowError, Schema};

use super::schema::comparable;

/// Sort key: a column and a direction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sort {
    /// Name of the column.
    pub column: String,
    /// True: largest value first. Absent values are last in both directions.
    pub descending: bool,
}

impl Sort {
    /// Parses `COLUMN` (ascending) or `-COLUMN` (descending).
    pub fn parse(text: &str) -> Self {
        let descending = text.starts_with('-');
        Self { column: text.trim_start_matches('-').into(), descending }
    }

    /// Returns the index of the column in a table.
    ///
    /// # Errors
    /// The limit as text if the table has no such column, or if it holds lists.
    pub fn find(&self, table: &Schema) -> Result<usize, String> {
        let names = comparable(table);
        if names.contains(&self.column.as_str()) {
            return table.index_of(&self.column).map_err(|error| error.to_string());
        }
        Err(format!("must be COLUMN or -COLUMN, with a column of {}", names.join(", ")))
    }

    /// Returns up to `limit` of `rows` in the order of `keys`, from position `from` of that order.
    /// Equal keys are sorted by row.
    ///
    /// # Errors
    /// `ArrowError` if the type of `keys` cannot be sorted.
    pub fn order(
        &self,
        keys: ArrayRef,
        rows: &UInt64Array,
        from: usize,
        limit: usize,
    ) -> Result<Vec<u64>, ArrowError> {
        let options = SortOptions { descending: self.descending, nulls_first: false };
        let by_row = SortColumn { values: std::sync::Arc::new(rows.clone()), options: None };
        let columns = [SortColumn { values: keys, options: Some(options) }, by_row];
        let end = from.saturating_add(limit).min(rows.len());
        let order = lexsort_to_indices(&columns, Some(end))?;
        let page = order.values().get(from..end).unwrap_or_default();
        Ok(page.iter().map(|&at| rows.value(at as usize)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use arrow_array::Float32Array;
    use std::sync::Arc;

    #[test]
    fn equal_rows_stay_in_order_and_absent_ones_come_last() {
        let keys: ArrayRef =
            Arc::new(Float32Array::from(vec![Some(2.0), None, Some(9.0), Some(2.0)]));
        let rows = UInt64Array::from(vec![4, 5, 6, 7]);
        let order = |text: &str, from, limit| {
            Sort::parse(text).order(keys.clone(), &rows, from, limit).unwrap()
        };
        assert_eq!(order("max_force_n", 0, 10), [4, 7, 6, 5]);
        assert_eq!(order("-max_force_n", 0, 10), [6, 4, 7, 5]);
        assert_eq!(order("-max_force_n", 1, 2), [4, 7]);
        assert_eq!(order("max_force_n", 4, 2), Vec::<u64>::new());
    }
}
