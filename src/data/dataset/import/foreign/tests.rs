//! Files of each format, written here byte by byte, read as trials; and refusals.
//! Uses: `import::source`, `import::rows`, zip. Never: a file outside the folder of a test.

use std::io::{Cursor, Write};

use tempfile::NamedTempFile;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::csv::Csv;
use crate::dataset::error::{DatasetError, DatasetResult};
use crate::dataset::import::coordinates::Coordinates;
use crate::dataset::import::rows::{Reader, columns};
use crate::dataset::import::sensor::ImportedSensor;
use crate::dataset::import::source::Source;
use crate::store::{Contact, ImportedTrial};
use crate::syntax::PROBLEMS_MAX;

const PAD: &str = "name = \"pad\"\nchannels = 3\nwidth_mm = 100\nheight_mm = 80\n";

/// Trials and ignored columns of a file, by the steps of an import.
fn read(name: &str, bytes: &[u8]) -> DatasetResult<(Vec<ImportedTrial>, Vec<String>)> {
    let file = NamedTempFile::new().unwrap();
    std::fs::write(&file, bytes).unwrap();
    let sensor = ImportedSensor::from_toml("pad.toml", PAD).unwrap();
    let source = Source::open(file.path(), name)?;
    let mut reader = Reader::new(name, &sensor, Coordinates::default());
    reader.check(source.schema()).map_err(DatasetError::Problems)?;
    source.extent().needed(name, &sensor).map_err(DatasetError::Problems)?;
    let (_, left_out) = columns(source.schema());
    let mut trials = Vec::new();
    let rows = source.extent().rows();
    for batch in source.batches()? {
        trials.extend(reader.read(&batch?).map_err(DatasetError::Problems)?);
    }
    assert_eq!(trials.len() as u64, rows, "the file states its rows");
    Ok((trials, left_out))
}

/// A file that must be refused with these words.
fn is_refused(name: &str, bytes: &[u8], words: &str) {
    let found = read(name, bytes).map(|(trials, _)| trials.len()).unwrap_err().to_string();
    assert!(found.contains(words), "{words}: {found}");
}

fn touch(x_mm: f64, y_mm: f64, force_n: Option<f64>) -> Contact {
    Contact { x_mm: Some(x_mm), y_mm: Some(y_mm), force_n, diameter_mm: None }
}

// ---------------------------------------------------------------- CSV

#[test]
fn a_table_of_one_contact_is_read_by_the_names_of_its_columns() {
    let text = "v0,v1,frames_valid,v2,x_mm,y_mm,force_n,configuration,started_at,flags\r\n\
                0.5,-1e-3,all,NaN,12.5,20,2.5,7,2026-11-20T18:00:00Z,unsettled still_cell\r\n\
                1,,none,3,,,,8,,\r\n";
    let (trials, left_out) = read("one.csv", text.as_bytes()).unwrap();
    assert_eq!(left_out, ["frames_valid"]);
    assert_eq!(trials[0].voltages_v[..2], [0.5, -1e-3]);
    assert!(trials[0].voltages_v[2].is_nan() && trials[1].voltages_v[1].is_nan());
    assert_eq!(trials[0].contacts, [touch(12.5, 20.0, Some(2.5))]);
    assert!(trials[1].contacts.is_empty() && trials[1].started_at.is_none());
    assert_eq!((trials[0].configuration, trials[1].configuration), (7, 8));
    assert_eq!(trials[0].started_at.unwrap().to_string(), "2026-11-20T18:00:00Z");
    let flags: Vec<&str> = trials[0].flags.iter().map(|flag| flag.as_str()).collect();
    assert_eq!(flags, ["unsettled", "still_cell"]);
}

#[test]
fn several_contacts_other_names_and_other_separators_are_read_too() {
    let text = "voltages_v[0];voltages_v[1];voltages_v[2];x1_mm;y1_mm;force1_n;x2_mm;y2_mm\n\
                1;2;3;10;20;1.5;30;40\n4;5;6;;;;50;60\n";
    let (trials, _) = read("two.csv", text.as_bytes()).unwrap();
    assert_eq!(trials[0].contacts, [touch(10.0, 20.0, Some(1.5)), touch(30.0, 40.0, None)]);
    assert_eq!(trials[1].contacts, [touch(50.0, 60.0, None)]);
    // As Palpate exports it.
    let text = "voltages_v_0,voltages_v_1,voltages_v_2,contacts\n\
                1,2,3,\"[{\"\"x_mm\"\":10.0,\"\"y_mm\"\":20.0,\"\"force_n\"\":1.5}]\"\n4,5,6,[]\n";
    let (trials, _) = read("own.csv", text.as_bytes()).unwrap();
    assert_eq!(trials[0].contacts, [touch(10.0, 20.0, Some(1.5))]);
    assert!(trials[1].contacts.is_empty());
}

#[test]
fn an_invalid_table_is_refused_by_row_and_column() {
    let head = "v0,v1,v2,x_mm,y_mm\n";
    let many = format!("{head}1,2,\"3{}", "x,\n".repeat(7 << 20));
    for (text, wanted) in [
        (
            format!("{head}1,2,3,4,5\n1,2,3;0,4,5\n"),
            "row 1, v2 = 3;0: must be a number with a point",
        ),
        (format!("{head}1,2,3,4,900\n"), "row 0, contacts[0].y_mm = 900: must be from 0 to 80"),
        (
            format!("{head}1,2,3,4,5\n1,2,-1500,4,5\n"),
            "row 1, voltages_v[2] = -1500: must be from -1000 to 1000 V",
        ),
        (
            format!("{head}1,2,3,4,5\n1,2,3\n"),
            "each line with as many cells as the first: row 1 has 3 cells, the first line 5",
        ),
        (
            "# One tip, then four, and more.\nname = \"e\"\n[real_hex]\ntips = [1, 4]\n".into(),
            "this is an experiment, not a table of trials; an experiment is given with palpate run",
        ),
        ("v0,v2,x_mm,y_mm\n1,2,3,4\n".into(), "v1 = absent: must be present"),
        ("v0,v0,x_mm,y_mm\n1,2,3,4\n".into(), "v0 = twice"),
        ("v0,frames_v,x_mm,y_mm\n1,2,3,4\n".into(), "frames_v = a column: must be in a Parquet"),
        (
            "v0,frames_v_0_0,x_mm,y_mm\n1,2,3,4\n".into(),
            "frames_v_0_0 = a column: must be in a Parquet",
        ),
        ("v0,x_mm,y_mm,x1_mm\n1,2,3,4\n".into(), "contacts = several forms"),
        ("v0,v1,x_mm,y_mm\n1,2,3,4\n".into(), "voltages_v = 2 values: must have the 3 values"),
        ("a,b\n1,2\n".into(), "voltages_v = absent"),
        ("v0,v1,v2\n1,2,3\n".into(), "contacts = absent"),
        (
            format!("{},started_at\n1,2,3,4,5,noon\n", head.trim()),
            "started_at = noon: must be a time",
        ),
        (many, "a line is longer than"),
    ] {
        is_refused("bad.csv", text.as_bytes(), wanted);
    }
}

#[test]
fn a_row_of_many_contacts_is_refused_before_it_is_parsed() {
    let text = format!("v0,v1,v2,contacts\n1,2,3,\"{}\"\n4,5,6,[]\n", "{".repeat(65));
    for words in ["row 0, contacts = {{{", "must have at most 64 contacts"] {
        is_refused("many.csv", text.as_bytes(), words);
    }
}

#[test]
fn a_row_with_many_words_that_are_no_flags_has_few_problems() {
    let text = format!("v0,v1,v2,x_mm,y_mm,flags\n1,2,3,4,5,{}\n", "wrong ".repeat(100));
    match read("flags.csv", text.as_bytes()) {
        Err(DatasetError::Problems(problems)) => assert_eq!(problems.len(), PROBLEMS_MAX),
        other => panic!("{other:?}"),
    }
}

#[test]
fn pages_of_long_lines_have_few_rows() {
    let note = "n".repeat(9 << 20);
    let text = format!("v0,v1,v2,x_mm,y_mm,note\n1,2,3,4,5,{note}\n1,2,3,4,5,{note}\n1,2,3,4,5,\n");
    let file = NamedTempFile::new().unwrap();
    std::fs::write(&file, text).unwrap();
    let pages = Csv::open(file.path(), "long.csv").unwrap().batches().unwrap();
    let rows: Vec<usize> = pages.map(|page| page.unwrap().num_rows()).collect();
    assert_eq!(rows, [2, 1]);
}

// ---------------------------------------------------------------- NPZ

/// A `.npy` file: header and bytes.
fn npy(kind: &str, by_columns: bool, shape: &str, bytes: &[u8]) -> Vec<u8> {
    let order = if by_columns { "True" } else { "False" };
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': {order}, 'shape': {shape}, }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((header.len() as u16).to_le_bytes());
    [out, header.into_bytes(), bytes.to_vec()].concat()
}

fn doubles(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// An array of numbers: its name, and its file.
fn numbers<'a>(name: &'a str, shape: &str, values: &[f64]) -> (&'a str, Vec<u8>) {
    (name, npy("<f8", false, shape, &doubles(values)))
}

fn npz(arrays: &[(&str, Vec<u8>)], method: CompressionMethod) -> Vec<u8> {
    let mut file = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in arrays {
        let options = SimpleFileOptions::default().compression_method(method);
        file.start_file(format!("{name}.npy"), options).unwrap();
        file.write_all(bytes).unwrap();
    }
    file.finish().unwrap().into_inner()
}

#[test]
fn arrays_of_either_order_and_compression_are_read() {
    let unknown = f64::NAN;
    let rows = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    let columns = [1.0, 4.0, 2.0, 5.0, 3.0, 6.0];
    let xy = [10.0, 20.0, 30.0, 40.0, 50.0, 60.0, unknown, unknown];
    let force = [1.5, unknown, 2.5, unknown];
    for (method, by_columns) in
        [(CompressionMethod::Stored, false), (CompressionMethod::Deflated, true)]
    {
        let volts = doubles(if by_columns { &columns } else { &rows });
        let depth: Vec<u8> = [3_i32, 4].iter().flat_map(|n| n.to_le_bytes()).collect();
        let times: Vec<u8> = [1_000_i64, i64::MIN].iter().flat_map(|n| n.to_le_bytes()).collect();
        let bytes = npz(
            &[
                ("voltages_v", npy("<f8", by_columns, "(2, 3)", &volts)),
                numbers("contacts_xy_mm", "(2, 2, 2)", &xy),
                numbers("force_n", "(2, 2)", &force),
                ("depth_index", npy("<i4", false, "(2,)", &depth)),
                ("started_at", npy("<M8[us]", false, "(2,)", &times)),
                ("notes", npy("|O", false, "(2,)", b"pickled")),
            ],
            method,
        );
        let (trials, left_out) = read("pad.npz", &bytes).unwrap();
        assert_eq!(left_out, ["notes"]);
        assert_eq!(trials[0].voltages_v, [1.0, 2.0, 3.0]);
        assert_eq!(trials[1].voltages_v, [4.0, 5.0, 6.0]);
        assert_eq!(trials[0].contacts, [touch(10.0, 20.0, Some(1.5)), touch(30.0, 40.0, None)]);
        assert_eq!(trials[1].contacts, [touch(50.0, 60.0, Some(2.5))]);
        assert_eq!((trials[0].depth_index, trials[1].depth_index), (3, 4));
        assert_eq!(trials[0].started_at.map(|at| at.as_millisecond()), Some(1));
        assert_eq!(trials[1].started_at, None);
    }
}

/// Three trials of a pad of 3 channels, each of up to two raw frames.
const RAW: [[f64; 6]; 3] = [
    [1.0, 2.0, 3.0, 3.0, 4.0, 5.0],
    [0.5, 0.5, 0.5, f64::NAN, f64::NAN, f64::NAN],
    [-1.0, 0.0, 1.0, -1.0, 2.0, 1.0],
];

/// Mean frame, raw frames and their number of each trial of [`RAW`].
fn is_raw(trials: &[ImportedTrial]) {
    let means: Vec<&[f32]> = trials.iter().map(|trial| &trial.voltages_v[..]).collect();
    assert_eq!(means, [[2.0, 3.0, 4.0], [0.5, 0.5, 0.5], [-1.0, 1.0, 1.0]]);
    let counts: Vec<u32> = trials.iter().map(|trial| trial.frame_count).collect();
    assert_eq!(counts, [2, 1, 2]);
    assert_eq!(trials[0].frames_v, [[1.0, 2.0, 3.0], [3.0, 4.0, 5.0]]);
    assert_eq!(trials[1].frames_v, [[0.5, 0.5, 0.5]]);
}

#[test]
fn raw_frames_are_an_array_of_three_dimensions() {
    let place = || [numbers("x_mm", "(3,)", &[5.0; 3]), numbers("y_mm", "(3,)", &[6.0; 3])];
    let raw = |shape: &str| numbers("frames_v", shape, RAW.as_flattened());
    let of = |more: Vec<(&str, Vec<u8>)>| {
        let arrays: Vec<_> = more.into_iter().chain(place()).collect();
        npz(&arrays, CompressionMethod::Deflated)
    };
    let (trials, left_out) = read("raw.npz", &of(vec![raw("(3, 2, 3)")])).unwrap();
    assert!(left_out.is_empty(), "{left_out:?}");
    is_raw(&trials);
    let volts = |values: &[f64]| numbers("voltages_v", "(3, 3)", values);
    let large = numbers("frames_v", "(100000, 8, 784)", &[]);
    for (bytes, wanted) in [
        (
            of(vec![raw("(3, 6)")]),
            "frames_v = (3, 6) numbers: must be numbers of the shape (3, frames",
        ),
        (of(vec![raw("(3, 3, 2)")]), "row 0, frames_v[0] = 2 values: must have the 3 values"),
        (
            of(vec![raw("(3, 2, 3)"), volts(&[0.0; 9])]),
            "row 0, voltages_v = a frame: must be null where frames_v has frames",
        ),
        (
            of(vec![raw("(3, 2, 3)"), numbers("frame_count", "(3,)", &[2.0; 3])]),
            "row 1, frame_count = 2: must be the 1 frames of frames_v",
        ),
        (
            npz(&[large], CompressionMethod::Stored),
            "bytes = 2508800000: must be at most 1073741824",
        ),
    ] {
        is_refused("raw.npz", &bytes, wanted);
    }
    // Where a trial has no raw frames, it may have its mean.
    let mut some = RAW;
    some[..2].fill([f64::NAN; 6]);
    let means = [0.0, 0.0, 1.0, 0.0, 0.0, 2.0, f64::NAN, f64::NAN, f64::NAN];
    let some = numbers("frames_v", "(3, 2, 3)", some.as_flattened());
    let (trials, _) = read("some.npz", &of(vec![some, volts(&means)])).unwrap();
    let counts: Vec<u32> = trials.iter().map(|trial| trial.frame_count).collect();
    assert_eq!((counts, trials[1].voltages_v[2]), (vec![0, 0, 2], 2.0));
}

#[test]
fn arrays_of_other_shapes_or_sizes_are_refused_by_name() {
    let volts = || numbers("voltages_v", "(2, 3)", &[0.0; 6]);
    let of = |arrays: Vec<(&str, Vec<u8>)>| npz(&arrays, CompressionMethod::Stored);
    let x = |shape: &str, n: usize| numbers("x_mm", shape, &vec![1.0; n]);
    let y = |shape: &str, n: usize| numbers("y_mm", shape, &vec![1.0; n]);
    let large = || numbers("voltages_v", "(1000000, 784)", &[]);
    let nested = format!("({}", "(".repeat(2000));
    for (bytes, wanted) in [
        (
            of(vec![volts(), x("(3,)", 3), y("(2,)", 2)]),
            "x_mm = (3) numbers: must be numbers of the shape (2)",
        ),
        (
            of(vec![volts(), x("(2, 2)", 4), y("(2,)", 2)]),
            "y_mm = (2) numbers: must be numbers of the shape (2) or (2, 2)",
        ),
        (of(vec![large(), x("(1000000,)", 0)]), "bytes = 3152000000: must be at most 1073741824"),
        (of(vec![volts()]), "contacts = absent"),
        (
            of(vec![("voltages_v", npy("|O", false, "(2, 3)", b"pickled"))]),
            "voltages_v = (2, 3) values of another type",
        ),
        (of(vec![numbers("voltages_v", &nested, &[])]), "voltages_v = () values of another type"),
        (
            of(vec![
                ("voltages_v", npy("<f8", false, "(2, 3)", &[0; 40])),
                x("(2,)", 2),
                y("(2,)", 2),
            ]),
            "voltages_v",
        ),
        (npy("<f8", false, "(2, 3)", &[]), "must not be a single array"),
        (b"PK\x03\x04 and no more".to_vec(), "must be an NPZ file"),
    ] {
        is_refused("bad.npz", &bytes, wanted);
    }
}

// ---------------------------------------------------------------- MAT

/// Bytes of an element, padded.
fn element(kind: u32, data: &[u8]) -> Vec<u8> {
    let mut out = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
    out.extend_from_slice(data);
    out.resize(out.len().next_multiple_of(8), 0);
    out
}

fn matrix(name: &str, class: u32, dims: &[i32], data: Vec<u8>) -> Vec<u8> {
    let dims: Vec<u8> = dims.iter().flat_map(|n| n.to_le_bytes()).collect();
    let flags = [class.to_le_bytes(), [0; 4]].concat();
    let body = [element(6, &flags), element(5, &dims), element(1, name.as_bytes()), data].concat();
    element(14, &body)
}

fn mat(elements: &[Vec<u8>]) -> Vec<u8> {
    let mut header = b"MATLAB 5.0 MAT-file, made by a test".to_vec();
    header.resize(124, b' ');
    header.extend([0, 1, b'I', b'M']);
    [header, elements.concat()].concat()
}

fn compressed(element: &[u8]) -> Vec<u8> {
    let mut deflated = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    deflated.write_all(element).unwrap();
    let data = deflated.finish().unwrap();
    [15_u32.to_le_bytes().to_vec(), (data.len() as u32).to_le_bytes().to_vec(), data].concat()
}

#[test]
fn matrices_are_read_by_columns_compressed_or_not() {
    let volts =
        matrix("voltages_v", 6, &[2, 3], element(9, &doubles(&[1.0, 4.0, 2.0, 5.0, 3.0, 6.0])));
    // MATLAB stores whole numbers in the narrowest type: here x is 10 and 50, y 20 and 60.
    let xy = matrix("contacts_xy_mm", 6, &[2, 1, 2], element(2, &[10, 50, 20, 60]));
    // A short element: the data are part of the tag.
    let depth = matrix("depth_index", 12, &[1, 2], vec![2, 0, 2, 0, 3, 4, 0, 0]);
    let text = matrix("comment", 4, &[1, 2], element(16, b"hi"));
    let tag = matrix("tag", 4, &[2, 2], element(16, b"acbd"));
    let file = mat(&[compressed(&volts), text, xy, compressed(&depth), tag]);
    let (trials, left_out) = read("pad.mat", &file).unwrap();
    assert_eq!(left_out, ["comment"]);
    assert_eq!(trials[0].voltages_v, [1.0, 2.0, 3.0]);
    assert_eq!(trials[1].voltages_v, [4.0, 5.0, 6.0]);
    assert_eq!(trials[0].contacts, [touch(10.0, 20.0, None)]);
    assert_eq!(trials[1].contacts, [touch(50.0, 60.0, None)]);
    assert_eq!((trials[0].depth_index, trials[1].depth_index), (3, 4));
    assert_eq!((trials[0].tag.as_deref(), trials[1].tag.as_deref()), (Some("ab"), Some("cd")));
}

#[test]
fn raw_frames_of_a_matrix_are_read_by_columns() {
    // MATLAB: the first dimension varies fastest.
    let by_columns: Vec<f64> = (0..18).map(|n| RAW[n % 3][n / 3 % 2 * 3 + n / 6]).collect();
    let raw = matrix("frames_v", 6, &[3, 2, 3], element(9, &doubles(&by_columns)));
    let xy = matrix("contacts_xy_mm", 6, &[3, 1, 2], element(2, &[10, 11, 12, 20, 21, 22]));
    let (trials, _) = read("raw.mat", &mat(&[compressed(&raw), xy])).unwrap();
    is_raw(&trials);
    assert_eq!(trials[2].contacts, [touch(12.0, 22.0, None)]);
}

#[test]
fn a_damaged_or_newer_matlab_file_is_refused() {
    let volts = matrix("voltages_v", 6, &[2, 3], element(9, &doubles(&[0.0; 6])));
    let xy = matrix("contacts_xy_mm", 6, &[2, 1, 2], element(2, &[1, 1, 1, 1]));
    let large = matrix("voltages_v", 6, &[2_000_000_000, 2_000_000_000], element(9, &[]));
    let few = matrix("voltages_v", 6, &[2, 3], element(9, &doubles(&[0.0; 5])));
    // 200 MB in the file, of which each character takes up to 8 bytes.
    let wide = [
        matrix("voltages_v", 6, &[4_000_000, 3], element(9, &[])),
        matrix("tag", 4, &[4_000_000, 50], element(16, &[])),
    ];
    let mut cut = mat(&[volts, xy.clone()]);
    cut.truncate(200);
    for (bytes, wanted) in [
        (b"MATLAB 7.3 MAT-file, Platform: GLNXA64".to_vec(), "save(FILE, .., '-v7')"),
        (b"\x89HDF\r\n\x1a\n".to_vec(), "must not be HDF5"),
        (mat(&[large]), "must be at most 1073741824 in memory"),
        (mat(&wide), "bytes = 1744000000: must be at most 1073741824 in memory"),
        (mat(&[few, xy]), "voltages_v: has 40 bytes instead of 48"),
        (cut, "must be a MAT file of version 5 to 7"),
        (b"MATLAB 5.0 MAT-file".to_vec(), "must be a MAT file of version 5 to 7"),
    ] {
        is_refused("bad.mat", &bytes, wanted);
    }
}
