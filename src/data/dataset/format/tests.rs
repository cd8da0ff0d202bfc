//! Every format read back by another reader than its writer's, and refusals.
//! Uses: `dataset::format`, arrow, parquet, csv, zip. Never: files.

use std::collections::HashMap;
use std::io::{Cursor, Read};
use std::sync::Arc;

use arrow_array::builder::{Float32Builder, ListBuilder, StringBuilder};
use arrow_array::types::Float32Type;
use arrow_array::{
    ArrayRef, BooleanArray, FixedSizeListArray, Float32Array, Float64Array, Int64Array, ListArray,
    RecordBatch, StringArray, StructArray, TimestampMillisecondArray, UInt8Array, UInt16Array,
    UInt32Array, UInt64Array,
};
use arrow_buffer::{NullBuffer, OffsetBuffer};
use arrow_ipc::reader::{FileReader, StreamReader};
use arrow_schema::{DataType, Field, Fields, Schema, SchemaRef};
use bytes::Bytes;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::basic::Encoding;
use proptest::prelude::*;
use serde_json::{Value, json};

use super::{
    Batches, Format, FormatError, Rows, RowsError, Stream, rows_per_batch, rows_within, write,
};

/// Batches in memory, and the number of rows that they claim to be.
struct Table {
    batches: Vec<RecordBatch>,
    count: u64,
}

impl Table {
    fn new(batches: Vec<RecordBatch>) -> Self {
        let count = batches.iter().map(|batch| batch.num_rows() as u64).sum();
        Self { batches, count }
    }
}

impl Rows for Table {
    fn schema(&self) -> SchemaRef {
        self.batches[0].schema()
    }

    fn count(&self) -> u64 {
        self.count
    }

    fn batches(&self, columns: Option<&[usize]>) -> Result<Batches<'_>, RowsError> {
        let columns = columns.map(<[usize]>::to_vec);
        Ok(Box::new(self.batches.iter().map(move |batch| match &columns {
            Some(columns) => batch.project(columns).map_err(RowsError::new),
            None => Ok(batch.clone()),
        })))
    }
}

fn bytes_of(format: Format, rows: &dyn Rows) -> Vec<u8> {
    let mut out = Vec::new();
    let mut told = Vec::new();
    write(format, rows, &mut out, &mut |done| told.push(done)).unwrap();
    assert!(told.is_sorted(), "{told:?}");
    assert_eq!(told.last(), Some(&rows.count()));
    out
}

/// Contacts of five trials: two, none, not known, one without a place, one.
fn contacts() -> ListArray {
    let fields = Fields::from(vec![
        Field::new("x_mm", DataType::Float64, true),
        Field::new("y_mm", DataType::Float64, true),
        Field::new("force_n", DataType::Float32, true),
        Field::new("diameter_mm", DataType::Float32, true),
    ]);
    let columns: Vec<ArrayRef> = vec![
        Arc::new(Float64Array::from(vec![Some(0.1), Some(270.0), None, Some(500.25)])),
        Arc::new(Float64Array::from(vec![Some(0.2), Some(280.0), None, Some(-1e-9)])),
        Arc::new(Float32Array::from(vec![Some(0.1), None, Some(7.0), Some(60.0)])),
        Arc::new(Float32Array::from(vec![20.0; 4])),
    ];
    let items = StructArray::new(fields.clone(), columns, None);
    let item = Arc::new(Field::new("element", DataType::Struct(fields), true));
    let known = NullBuffer::from(vec![true, true, false, true, true]);
    ListArray::new(item, OffsetBuffer::from_lengths([2, 0, 0, 1, 1]), Arc::new(items), Some(known))
}

fn flags() -> ListArray {
    let item = Field::new("element", DataType::Utf8, true);
    let mut flags = ListBuilder::new(StringBuilder::new()).with_field(item);
    flags.append_value([Some("saturated"), Some("a \"quoted\", flag")]);
    flags.append_value([None::<&str>; 0]);
    flags.append_null();
    flags.append_value([Some("µ")]);
    flags.append_value([None::<&str>; 0]);
    flags.finish()
}

/// Five frames of `length` numbers: the second has a gap, the third is missing.
fn frames(length: i32) -> FixedSizeListArray {
    let frame = |row: i32| {
        let gap = |i| row == 1 && i == 1;
        let value = |i| (!gap(i)).then_some((row * 10 + i) as f32 * 0.1);
        (row != 2).then(|| (0..length).map(value).collect::<Vec<_>>())
    };
    let lists = (0..5).map(frame);
    FixedSizeListArray::from_iter_primitive::<Float32Type, _, _>(lists, length)
}

/// Five rows with every type of column, in batches of three and two.
fn sample() -> Table {
    let ints = vec![Some(-9_007_199_254_740_993), None, Some(0), Some(1), Some(i64::MAX)];
    let times = vec![Some(1_795_000_000_123), None, Some(0), Some(-1), Some(1_795_000_000_000)];
    let floats =
        vec![Some(0.1), None, Some(f32::NAN), Some(f32::INFINITY), Some(f32::MIN_POSITIVE)];
    let texts = vec![Some("real, \"hex\""), None, Some(""), Some("line\r\nbreak"), Some("größe")];
    let truths = vec![Some(true), None, Some(false), Some(true), Some(true)];
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("index", Arc::new(Int64Array::from(ints))),
        ("seed", Arc::new(UInt64Array::from(vec![u64::MAX, 1, 2, 3, 4]))),
        (
            "configuration",
            Arc::new(UInt32Array::from(vec![Some(u32::MAX), None, None, None, None])),
        ),
        ("tips", Arc::new(UInt16Array::from(vec![1, 2, 3, 4, 65535]))),
        ("contact_count", Arc::new(UInt8Array::from(vec![2, 0, 0, 1, 1]))),
        ("max_force_n", Arc::new(Float32Array::from(floats))),
        (
            "rmse_v",
            Arc::new(Float64Array::from(vec![Some(0.1), None, Some(1e300), Some(3.0), None])),
        ),
        ("run", Arc::new(StringArray::from(texts))),
        ("saturated", Arc::new(BooleanArray::from(truths))),
        ("started_at", Arc::new(TimestampMillisecondArray::from(times).with_timezone("UTC"))),
        ("flags", Arc::new(flags())),
        ("contacts", Arc::new(contacts())),
        ("voltages_v", Arc::new(frames(3))),
    ];
    let field = |(name, values): &(&str, ArrayRef)| {
        Field::new(*name, values.data_type().clone(), true)
            .with_metadata(HashMap::from([("unit".to_owned(), "x".to_owned())]))
    };
    let metadata = ["palpate.dataset", "b", "a", "citation"].map(|key| (key.into(), "{}".into()));
    let fields: Vec<Field> = columns.iter().map(field).collect();
    let schema = Schema::new(fields).with_metadata(HashMap::from(metadata));
    let values = columns.into_iter().map(|(_, values)| values).collect();
    let all = RecordBatch::try_new(Arc::new(schema), values).unwrap();
    Table::new(vec![all.slice(0, 3), all.slice(3, 2)])
}

#[test]
fn parquet_reads_back_with_its_row_groups_and_footer() {
    let rows = sample();
    let file = bytes_of(Format::Parquet, &rows);
    let reader = ParquetRecordBatchReaderBuilder::try_new(Bytes::from(file)).unwrap();
    assert_eq!(reader.schema().as_ref(), rows.schema().as_ref());
    let metadata = reader.metadata().clone();
    let keys: Vec<_> = metadata.file_metadata().key_value_metadata().unwrap().iter().collect();
    let keys: Vec<_> = keys.iter().map(|pair| pair.key.as_str()).collect();
    assert_eq!(keys, ["a", "b", "citation", "palpate.dataset", "ARROW:schema"]);
    assert_eq!(metadata.num_row_groups(), 2);
    for column in metadata.row_group(0).columns() {
        let path = column.column_path().string();
        let is_list = path.contains(".list.");
        assert_eq!(column.statistics().is_none(), is_list, "statistics of {path}");
        if path.starts_with("voltages_v") || path == "max_force_n" || path.ends_with("x_mm") {
            let split = column.encodings().any(|e| e == Encoding::BYTE_STREAM_SPLIT);
            assert!(split, "encoding of {path}");
        }
    }
    let read: Vec<_> = reader.with_batch_size(3).build().unwrap().map(Result::unwrap).collect();
    assert_eq!(read.len(), rows.batches.len());
    for (read, written) in read.iter().zip(&rows.batches) {
        assert_eq!(read.columns(), written.columns());
    }
}

#[test]
fn arrow_reads_back() {
    let rows = sample();
    let reader = StreamReader::try_new(Cursor::new(bytes_of(Format::Arrow, &rows)), None).unwrap();
    assert_eq!(reader.schema(), rows.schema());
    assert_eq!(reader.map(Result::unwrap).collect::<Vec<_>>(), rows.batches);
}

#[test]
fn feather_reads_back() {
    let rows = sample();
    let file = Cursor::new(bytes_of(Format::Feather, &rows));
    let reader = FileReader::try_new(file, None).unwrap();
    assert_eq!(reader.schema(), rows.schema());
    assert_eq!(reader.map(Result::unwrap).collect::<Vec<_>>(), rows.batches);
}

#[test]
fn a_text_like_a_formula_is_a_text_in_csv_and_unchanged_elsewhere() {
    let formulas = ["=HYPERLINK(\"http://evil\")", "+1", "@SUM", "-2+3", "\tx", "\rx", "a=b", ""];
    let numbers = (0..8).map(|n| -1.5 - f64::from(n));
    let batch = RecordBatch::try_from_iter([
        ("who", Arc::new(StringArray::from(formulas.to_vec())) as ArrayRef),
        ("depth_mm", Arc::new(numbers.collect::<Float64Array>())),
    ]);
    let table = Table::new(vec![batch.unwrap()]);
    let file = bytes_of(Format::Csv, &table);
    let lines: Vec<csv::StringRecord> =
        csv::Reader::from_reader(file.as_slice()).records().map(Result::unwrap).collect();
    for ((line, formula), n) in lines.iter().zip(formulas).zip(0..) {
        let shown = if n < 6 { format!("'{formula}") } else { formula.into() };
        assert_eq!(line[0], shown);
        assert_eq!(line[1], (-1.5 - f64::from(n)).to_string());
    }
    let json = String::from_utf8(bytes_of(Format::Ndjson, &table)).unwrap();
    let rows = json.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    assert!(rows.zip(formulas).all(|(row, formula)| row["who"] == formula));
}

#[test]
fn csv_reads_back_cell_by_cell() {
    let file = bytes_of(Format::Csv, &sample());
    let mut reader = csv::Reader::from_reader(file.as_slice());
    let header = reader.headers().unwrap().clone();
    let voltages: Vec<&str> = header.iter().skip(12).collect();
    assert_eq!(voltages, ["voltages_v_0", "voltages_v_1", "voltages_v_2"]);
    let lines: Vec<_> = reader.records().map(Result::unwrap).collect();
    let column = |name: &str| {
        let at = header.iter().position(|n| n == name).unwrap();
        lines.iter().map(|line| line[at].to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(column("index"), ["-9007199254740993", "", "0", "1", "9223372036854775807"]);
    assert_eq!(column("seed")[0], "18446744073709551615");
    assert_eq!(column("max_force_n"), ["0.1", "", "NaN", "inf", "1.1754944e-38"]);
    assert_eq!(column("rmse_v"), ["0.1", "", "1e300", "3.0", ""]);
    assert_eq!(column("run"), ["real, \"hex\"", "", "", "line\r\nbreak", "größe"]);
    assert_eq!(column("saturated"), ["true", "", "false", "true", "true"]);
    let times =
        ["2026-11-18T11:06:40.123Z", "", "1970-01-01T00:00:00Z", "1969-12-31T23:59:59.999Z"];
    assert_eq!(column("started_at")[..4], times);
    let flags = [r#"["saturated","a \"quoted\", flag"]"#, "[]", "", "[\"µ\"]", "[]"];
    assert_eq!(column("flags"), flags);
    let first: Value = serde_json::from_str(&column("contacts")[0]).unwrap();
    assert_eq!(first[0], json!({"x_mm": 0.1, "y_mm": 0.2, "force_n": 0.1, "diameter_mm": 20.0}));
    assert_eq!(first[1], json!({"x_mm": 270.0, "y_mm": 280.0, "diameter_mm": 20.0}));
    assert_eq!(column("contacts")[1..3], ["[]", ""]);
    assert_eq!(column("voltages_v_1"), ["0.1", "", "", "3.1000001", "4.1"]);
    assert_eq!(column("voltages_v_2")[1], "1.2");
}

#[test]
fn ndjson_reads_back_without_what_is_missing() {
    let file = String::from_utf8(bytes_of(Format::Ndjson, &sample())).unwrap();
    let lines: Vec<Value> = file.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 5);
    let missing = ["seed", "tips", "contact_count", "flags", "contacts", "voltages_v"];
    let keys: Vec<_> = lines[1].as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(keys.len(), missing.len());
    assert!(missing.iter().all(|key| keys.contains(key)), "{keys:?}");
    assert_eq!(lines[0]["index"], json!(-9_007_199_254_740_993_i64));
    assert_eq!(lines[0]["seed"], json!(u64::MAX));
    assert_eq!(lines[0]["started_at"], "2026-11-18T11:06:40.123Z");
    assert_eq!(lines[0]["voltages_v"], json!([0.0, 0.1, 0.2]));
    assert_eq!(lines[0]["flags"][1], "a \"quoted\", flag");
    assert_eq!(lines[1]["contacts"], json!([]));
    assert_eq!(lines[1]["voltages_v"], json!([1.0, null, 1.2]));
    assert_eq!(lines[2]["max_force_n"], Value::Null);
    assert_eq!(lines[3]["contacts"], json!([{"force_n": 7.0, "diameter_mm": 20.0}]));
}

/// An array of an NPZ: its description, and its bytes.
fn array(npz: &[u8], name: &str) -> (String, Vec<u8>) {
    let mut archive = zip::ZipArchive::new(Cursor::new(npz)).unwrap();
    let mut entry = archive.by_name(&format!("{name}.npy")).unwrap();
    assert_eq!(entry.compressed_size(), entry.size());
    assert_eq!(entry.data_start().unwrap() % 64, 0, "alignment of {name}");
    let mut bytes = Vec::new();
    entry.read_to_end(&mut bytes).unwrap();
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
    assert_eq!(bytes[127], b'\n');
    let header = String::from_utf8(bytes[10..127].to_vec()).unwrap();
    (header.trim_end().to_owned(), bytes.split_off(128))
}

fn f64s(bytes: &[u8]) -> Vec<Option<f64>> {
    let each = bytes.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap()));
    each.map(|value| (!value.is_nan()).then_some(value)).collect()
}

fn texts(bytes: &[u8], chars: usize) -> Vec<String> {
    let letter = |b: &[u8]| char::from_u32(u32::from_le_bytes(b.try_into().unwrap())).unwrap();
    let text = |b: &[u8]| b.chunks_exact(4).map(letter).filter(|&c| c != '\0').collect();
    bytes.chunks_exact(4 * chars).map(text).collect()
}

#[test]
fn npz_holds_an_array_for_each_column() {
    let file = bytes_of(Format::Npz, &sample());
    let described = |kind: &str, shape: &str| {
        format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}")
    };
    for (name, kind, shape) in [
        ("index", "<f8", "(5,)"),
        ("seed", "<u8", "(5,)"),
        ("configuration", "<f8", "(5,)"),
        ("tips", "<u2", "(5,)"),
        ("contact_count", "|u1", "(5,)"),
        ("max_force_n", "<f4", "(5,)"),
        ("rmse_v", "<f8", "(5,)"),
        ("run", "<U11", "(5,)"),
        ("saturated", "<f8", "(5,)"),
        ("started_at", "<M8[ms]", "(5,)"),
        ("flags", "<U34", "(5,)"),
        ("contacts", "<f8", "(5, 2, 4)"),
        ("voltages_v", "<f4", "(5, 3)"),
    ] {
        assert_eq!(array(&file, name).0, described(kind, shape), "{name}");
    }
    assert_eq!(array(&file, "contact_count").1, [2, 0, 0, 1, 1]);
    let saturated = [Some(1.0), None, Some(0.0), Some(1.0), Some(1.0)];
    assert_eq!(f64s(&array(&file, "saturated").1), saturated);
    assert_eq!(texts(&array(&file, "run").1, 11)[3..], ["line\r\nbreak", "größe"]);
    assert_eq!(texts(&array(&file, "flags").1, 34)[1..4], ["[]", "", "[\"µ\"]"]);
    let times: Vec<_> = array(&file, "started_at").1;
    assert_eq!(times[8..16], i64::MIN.to_le_bytes());
    assert_eq!(times[..8], 1_795_000_000_123_i64.to_le_bytes());
    let contacts = f64s(&array(&file, "contacts").1);
    let force = f64::from(0.1_f32);
    assert_eq!(contacts[..4], [Some(0.1), Some(0.2), Some(force), Some(20.0)]);
    assert_eq!(contacts[4..8], [Some(270.0), Some(280.0), None, Some(20.0)]);
    assert!(contacts[8..24].iter().all(Option::is_none));
    assert_eq!(contacts[24..28], [None, None, Some(7.0), Some(20.0)]);
    let frames = array(&file, "voltages_v").1;
    let volts: Vec<_> =
        frames.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!(volts[..3], [0.0, 0.1, 0.2]);
    assert!(volts[4].is_nan() && volts[6..9].iter().all(|v| v.is_nan()));
    assert_eq!(volts[9..12], [30.0_f32 * 0.1, 31.0 * 0.1, 32.0 * 0.1]);
}

#[test]
fn the_same_rows_give_the_same_bytes() {
    for format in Format::ALL {
        // A map of metadata has another order in each instance.
        assert_eq!(bytes_of(format, &sample()), bytes_of(format, &sample()), "{format}");
    }
}

#[test]
fn no_rows_are_still_a_file() {
    let empty = Table::new(vec![sample().batches[0].slice(0, 0)]);
    for format in Format::ALL {
        let file = bytes_of(format, &empty);
        assert_eq!(file.is_empty(), format == Format::Ndjson, "{format}");
    }
    let file = bytes_of(Format::Npz, &empty);
    assert!(array(&file, "contacts").0.contains("(0, 0, 4)"));
    assert!(array(&file, "run").0.contains("<U1"));
}

proptest! {
    #[test]
    fn text_keeps_every_f32(bits in prop::collection::vec(any::<u32>(), 1..50)) {
        let numbers: Vec<f32> = bits.into_iter().map(f32::from_bits).collect();
        let mut values = Float32Builder::new();
        values.append_slice(&numbers);
        let batch = RecordBatch::try_from_iter([("v", Arc::new(values.finish()) as ArrayRef)]);
        let rows = Table::new(vec![batch.unwrap()]);
        let finite = |v: &f32| v.is_finite();
        let ndjson = String::from_utf8(bytes_of(Format::Ndjson, &rows)).unwrap();
        for (line, number) in ndjson.lines().zip(&numbers) {
            let text = line.trim_start_matches("{\"v\":").trim_end_matches('}');
            let same = text.parse::<f32>().is_ok_and(|read| read.to_bits() == number.to_bits());
            prop_assert!(if finite(number) { same } else { text == "null" }, "{line} for {number}");
        }
        let csv = String::from_utf8(bytes_of(Format::Csv, &rows)).unwrap();
        for (line, number) in csv.lines().skip(1).zip(&numbers) {
            let read: f32 = line.parse().unwrap();
            let same = read.to_bits() == number.to_bits() || read.is_nan() && number.is_nan();
            prop_assert!(same, "{line} for {number}");
        }
    }
}

#[test]
fn refusals_name_what_is_wrong() {
    let mut out = Vec::new();
    let lost = Table { count: 6, ..sample() };
    for format in Format::ALL {
        let refused = write(format, &lost, &mut out, &mut |_| {});
        assert!(matches!(refused, Err(FormatError::Count { expected: 6, found: 5 })), "{format}");
    }
    let numbers: ArrayRef = Arc::new(arrow_array::Int32Array::from(vec![1]));
    let rows = Table::new(vec![RecordBatch::try_from_iter([("odd", numbers)]).unwrap()]);
    let refused = write(Format::Npz, &rows, &mut out, &mut |_| {}).unwrap_err().to_string();
    assert_eq!(refused, "column odd of type Int32 cannot be written as npz");
    let refused = Stream::new(Format::Npz, &sample().schema(), &mut out).err().unwrap();
    assert!(matches!(refused, FormatError::NotAStream));
    let refused = "xls".parse::<Format>().unwrap_err().to_string();
    let names = Format::ALL.map(Format::name).join(", ");
    assert_eq!(refused, format!("format `xls`: choose from {names}"));
    for format in Format::ALL {
        assert_eq!(format.name().parse(), Ok(format));
        assert_eq!(serde_json::to_value(format).unwrap(), format.name());
    }
}

#[test]
fn the_ending_of_a_file_is_an_extension_before_it_is_a_name() {
    for format in Format::ALL {
        let file = format!("real.v2.{}", format.extension());
        assert_eq!(Format::of_file(&file), Some(("real.v2", format)));
    }
    assert_eq!(Format::of_file("real.feather"), Some(("real", Format::Feather)));
    assert_eq!(Format::of_file(".csv"), Some(("", Format::Csv)));
    for other in ["real", "real.", "csv", "realcsv", "real.csv.xls", "real.CSV"] {
        assert_eq!(Format::of_file(other), None, "{other}");
    }
}

#[test]
fn batches_of_wide_rows_are_shorter() {
    let frame = |items| {
        let item = Arc::new(Field::new("element", DataType::Float32, true));
        Schema::new(vec![Field::new("force_map_n", DataType::FixedSizeList(item, items), true)])
    };
    assert_eq!(rows_per_batch(&frame(784)), 1000);
    assert_eq!(rows_per_batch(&frame(160 * 160)), 163);
    assert_eq!(rows_per_batch(&frame(100_000_000)), 1);
    assert_eq!(rows_per_batch(&Schema::empty()), 1000);
    assert_eq!(rows_within(&frame(784), 256 << 10), 83);
    assert_eq!(rows_within(&frame(784), 1), 1);
}
