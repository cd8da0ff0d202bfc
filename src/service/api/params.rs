//! Query parameters of rows for the API description, generated from the table of columns.
//! PURE. Uses: `store::table`, `dataset::format`, utoipa. Never: a value of a request.

use utoipa::IntoParams;
use utoipa::openapi::path::{Parameter, ParameterBuilder, ParameterIn};
use utoipa::openapi::schema::{ArrayBuilder, ObjectBuilder, Schema, SchemaType, Type};

use crate::dataset::format::Format;
use crate::store::table::{self, Column, Kind, RUN_COLUMNS, TABLE};

/// Types that stand for parameters in the description of an operation, each with its parameters.
macro_rules! described {
    ($($(#[$about:meta])* $name:ident: $parameters:expr;)*) => {$(
        $(#[$about])*
        pub struct $name;

        impl IntoParams for $name {
            fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
                $parameters
            }
        }
    )*};
}

described! {
    /// Conditions on runs.
    RunParams: vec![conditions(&table::names_of(&RUN_COLUMNS, |_| true))];
    /// Parameters of pages of stored trials.
    TrialParams: {
        let order = "`trial_id` (default: oldest first), `-trial_id`, or another `COLUMN` or `-COLUMN`, for \
                     which the query engine finds the trials; absent values come last";
        let mut all = selected(Column::is_of_stored).to_vec();
        all.extend(page("id of the last trial of the page before: its `next`"));
        all.push(parameter("sort", order, text()));
        all.extend(flags());
        all.push(parameter("voltages", "include measured and simulated frames", boolean()));
        all
    };
    /// Parameters of pages of a dataset's rows.
    RowsParams: {
        let mut all = selected(|_| true).to_vec();
        all.extend(page("row where the page starts: the `next` of the page before"));
        all.push(parameter("sort", "`COLUMN` or `-COLUMN`; absent values come last", text()));
        all.push(map());
        all
    };
    /// Parameters of a dataset as a file.
    FileParams: [&selected(|_| true)[..], &[map()]].concat();
    /// Parameters of groups of stored trials.
    TrialGroupParams: [&groups(Column::is_of_stored)[..], &flags()].concat();
    /// Parameters of groups of a dataset's rows.
    RowGroupParams: groups(|_| true);
}

/// Conditions on the flags of trials.
fn flags() -> [Parameter; 2] {
    [
        parameter("flag", "only trials with this flag; may be repeated", text()),
        parameter("flagged", "only trials with, or only without, any flag", boolean()),
    ]
}

/// Names of the formats of a page: JSON, and the row formats.
pub fn page_formats() -> Vec<&'static str> {
    let formats = Format::ALL.into_iter().filter(|format| format.streams()).map(Format::name);
    ["json"].into_iter().chain(formats).collect()
}

/// Parameters of every selection of rows: conditions, columns and slice.
fn selected(has: fn(&Column) -> bool) -> [Parameter; 3] {
    let comparable = table::names(|column| has(column) && column.kind() != Kind::List);
    let names: Vec<&str> = TABLE.iter().filter(|c| has(c)).map(|c| c.name).collect();
    let name = ObjectBuilder::new().schema_type(Type::String).enum_values(Some(names));
    let columns = ArrayBuilder::new().items(name).build();
    let columns = ParameterBuilder::from(parameter("columns", &meanings(has), columns.into()));
    [
        conditions(&comparable),
        columns.explode(Some(false)).build(),
        parameter("slice", "only these values of each frame: `0:28`, the end excluded", text()),
    ]
}

/// The parameter `where`; `comparable`: the columns, separated by commas.
fn conditions(comparable: &str) -> Parameter {
    let pattern = format!("^({})(__(eq|gt|gte|lt|lte|in))?=.+$", comparable.replace(", ", "|"));
    let condition = ObjectBuilder::new().schema_type(Type::String).pattern(Some(pattern));
    let about = format!(
        "Condition `COLUMN__gt=VALUE` with eq, gt, gte, lt, lte, or in with values separated by commas; \
         repeated conditions must all hold, of those separated by `|` one, and an absent value meets none. \
         A condition may also be a separate parameter, `COLUMN__gt=VALUE`. Columns: {comparable}."
    );
    let conditions = ArrayBuilder::new().items(condition).build();
    parameter("where", &about, conditions.into())
}

/// Description of `columns`, with the meaning of each column.
fn meanings(has: fn(&Column) -> bool) -> String {
    let line = |c: &Column| match c.unit {
        "" => format!("- `{}`: {}", c.name, c.about),
        unit => format!("- `{}` ({unit}): {}", c.name, c.about),
    };
    let lines: Vec<String> = TABLE.iter().filter(|c| has(c)).map(line).collect();
    format!("Only these columns, in this order, separated by commas:\n\n{}", lines.join("\n"))
}

fn page(cursor: &str) -> [Parameter; 3] {
    let format = ObjectBuilder::new().schema_type(Type::String).enum_values(Some(page_formats()));
    let limit = ObjectBuilder::new()
        .schema_type(Type::Integer)
        .minimum(Some(1))
        .maximum(Some(crate::store::MAX_PAGE));
    [
        parameter("limit", "number of rows per page, default 100", limit.into()),
        parameter("cursor", cursor, text()),
        parameter(
            "format",
            "format of the response; else that of `Accept`, else json",
            format.into(),
        ),
    ]
}

/// Parameters of groups: conditions, keys, aggregates, order.
fn groups(has: fn(&Column) -> bool) -> Vec<Parameter> {
    let [condition, ..] = selected(has);
    let [limit, _, format] = page("");
    let with = |name, about| parameter(name, about, text());
    vec![
        condition,
        with(
            "group_by",
            "one group for equal values of these columns, separated by commas; of the voltages of stored trials \
             that have a twin: injection, pair, position in the frame",
        ),
        with(
            "bin",
            "one group for each range of a column, `COLUMN:WIDTH`, such as `depth_mm:0.5`; \
             `from_COLUMN` is the lower end of a range",
        ),
        with(
            "agg",
            "values of each group, separated by commas: `count` (default), or count, mean, min, max, \
             sum, median, std, or a quantile (q05, q90) of a column, as in `mean(fvu)`, which becomes \
             `mean_fvu`; of voltages `count` and `fvu`, the fraction of their variance that the simulated ones \
             leave unexplained",
        ),
        with("sort", "columns of the result, separated by commas, `-` before one for descending"),
        limit,
        format,
    ]
}

fn map() -> Parameter {
    let about = "adds a force map per row: pixel and map diameter in mm, as in `4x20`";
    parameter("map", about, text())
}

fn parameter(name: &str, about: &str, schema: Schema) -> Parameter {
    ParameterBuilder::new()
        .name(name)
        .parameter_in(ParameterIn::Query)
        .description(Some(about))
        .schema(Some(schema))
        .build()
}

fn text() -> Schema {
    ObjectBuilder::new().schema_type(SchemaType::Type(Type::String)).into()
}

fn boolean() -> Schema {
    ObjectBuilder::new().schema_type(SchemaType::Type(Type::Boolean)).into()
}
