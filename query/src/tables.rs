//! How the rows of a table follow from those of its files.
//! Uses: polars. Never: a file that was not named, a column's name that depends on a file.

use palpate_words::query_lines::{Form, Table};
use polars::prelude::{
    DataType, ExplodeOptions, Expr, LazyFrame, NULL, PlRefPath, PolarsResult, ScanArgsParquet,
    Schema, UnionArgs, by_name, col, concat_lf_diagonal, int_ranges, lit, when,
};

/// Columns of a row that name its trial.
const TRIAL: [&str; 2] = ["trial_id", "scan_id"];
const MEASURED: &str = "voltages_v";
const SIMULATED: &str = "sim_voltages_v";

/// Returns the rows of a table, unread.
///
/// # Errors
/// `PolarsError` if a file cannot be read, or two files have columns of different types.
pub fn rows(table: &Table) -> PolarsResult<LazyFrame> {
    let rows = of_files(table)?;
    Ok(match table.form {
        Form::Rows => rows,
        Form::Trials => rows.drop(by_name([MEASURED, SIMULATED], false, false)),
        Form::Contacts => {
            let contacts = rows.select(columns(&[TRIAL[0], TRIAL[1], "contacts"]));
            let one = by_name(["contacts"], true, false);
            contacts.explode(one.clone(), NONE_IF_EMPTY).unnest(one, None)
        }
        Form::Frames => rows.select(columns(&[TRIAL[0], TRIAL[1], MEASURED, SIMULATED])),
        Form::Twins => {
            let names = [TRIAL[0], TRIAL[1], "sim_model", "rmse_v", "fvu", SIMULATED];
            rows.filter(col("sim_model").is_not_null()).select(columns(&names))
        }
        Form::Voltages => voltages(rows),
    })
}

/// An empty or absent list becomes no row.
const NONE_IF_EMPTY: ExplodeOptions = ExplodeOptions { empty_as_null: false, keep_nulls: false };

fn columns(names: &[&str]) -> Vec<Expr> {
    names.iter().map(|&name| col(name)).collect()
}

/// A row for each voltage, with its position in the frame, and the number of its injection and of its
/// pair of electrodes if the frame has as many injections as pairs.
fn voltages(rows: LazyFrame) -> LazyFrame {
    let length = || col(MEASURED).list().len();
    let side = || length().cast(DataType::Float64).sqrt().cast(DataType::UInt32);
    let square = when((side() * side()).eq(length())).then(side()).otherwise(lit(NULL));
    // A frame without a twin has as many nulls as voltages.
    let nulls = col(MEASURED) * lit(NULL).cast(DataType::Float32);
    let simulated = when(col(SIMULATED).is_null()).then(nulls).otherwise(col(SIMULATED));
    let frames = rows.select([
        col(TRIAL[0]),
        col(TRIAL[1]),
        square.alias("side"),
        int_ranges(lit(0), length(), lit(1), DataType::UInt32).alias("position"),
        col(MEASURED).alias("voltage_v"),
        simulated.alias("sim_voltage_v"),
    ]);
    let lists = by_name(["position", "voltage_v", "sim_voltage_v"], true, false);
    frames.explode(lists, NONE_IF_EMPTY).select([
        col(TRIAL[0]),
        col(TRIAL[1]),
        col("position"),
        col("position").floor_div(col("side")).alias("injection"),
        (col("position") % col("side")).alias("pair"),
        col("voltage_v"),
        col("sim_voltage_v"),
    ])
}

/// The rows of all files. Frames of a fixed length become lists, so that skins of different numbers of
/// channels fit into one table.
fn of_files(table: &Table) -> PolarsResult<LazyFrame> {
    let mut alike: Vec<(Schema, Vec<PlRefPath>)> = Vec::new();
    for file in &table.files {
        let path = PlRefPath::try_from_path(file)?;
        let schema = scan(vec![path.clone()])?.collect_schema()?.as_ref().clone();
        match alike.iter_mut().find(|(known, _)| *known == schema) {
            Some((_, files)) => files.push(path),
            None => alike.push((schema, vec![path])),
        }
    }
    let groups = alike.into_iter().map(|(schema, files)| {
        let lists = schema.iter().filter_map(|(name, kind)| match kind {
            DataType::Array(item, _) => Some(col(name.clone()).cast(DataType::List(item.clone()))),
            // All times are UTC; without a zone they compare with the texts of a statement.
            DataType::Datetime(unit, Some(_)) => {
                Some(col(name.clone()).cast(DataType::Datetime(*unit, None)))
            }
            _ => None,
        });
        Ok(scan(files)?.with_columns(lists.collect::<Vec<_>>()))
    });
    let groups = groups.collect::<PolarsResult<Vec<_>>>()?;
    match groups.as_slice() {
        [one] => Ok(one.clone()),
        several => {
            concat_lf_diagonal(several, UnionArgs { to_supertypes: true, ..UnionArgs::default() })
        }
    }
}

fn scan(files: Vec<PlRefPath>) -> PolarsResult<LazyFrame> {
    let options = ScanArgsParquet { glob: false, ..ScanArgsParquet::default() };
    LazyFrame::scan_parquet_files(files.into_iter().collect(), options)
}
