//! The page of columns in the manual equals the table.

use crate::table::{Column, Of, TABLE};

/// Type of a column in Parquet and Arrow.
fn type_name(of: &Of) -> &'static str {
    match of {
        Of::Id(_) => "int64",
        Of::Count(_) => "uint32",
        Of::Few(_) => "uint8",
        Of::Number(_) => "float64",
        Of::Single(_) => "float32",
        Of::Text(_) | Of::Part => "string",
        Of::Time(_) => "timestamp[ms, UTC]",
        Of::Drawn => "uint64",
        Of::Contacts => "list of struct",
        Of::Forces => "float32[6]",
        Of::Flags => "list of string",
        Of::Measured(_) | Of::Simulated(_) => "float32[784]",
    }
}

/// The committed page equals the table; `UPDATE=1` writes it.
#[test]
fn the_page_of_columns_is_what_the_code_says() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/columns.md");
    let line = |column: &Column| {
        let Column { name, unit, of, about, .. } = column;
        format!("| `{name}` | {} | {unit} | {about} |\n", type_name(of))
    };
    let lines: String = TABLE.iter().map(line).collect();
    let page = format!(
        "# Columns of trials and datasets\n\nGenerated from `src/store/table/column.rs`. A value that is \
         unknown is null, never zero; quality numbers are also null for trials\nthat were stored before these \
         numbers were recorded. With a force map ([how](how-to/datasets.md)) a table also has\n\
         `force_map_n`, float32[pixels], N, row by row, row 0 at y = -40 mm.\n\n\
         | column | type | unit | |\n|---|---|---|---|\n{lines}"
    );
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(path, &page).unwrap();
    }
    let committed = std::fs::read_to_string(path).unwrap_or_default();
    assert!(committed == page, "docs/columns.md is old: UPDATE=1 cargo test page_of_columns");
}
