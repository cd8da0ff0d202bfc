//! Trials measured elsewhere, from a file to datasets.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use arrow_array::{ArrayRef, Float32Array, Int64Array, ListArray, RecordBatch, StructArray};
use arrow_array::{FixedSizeListArray, Float64Array};
use arrow_buffer::{NullBuffer, OffsetBuffer};
use arrow_schema::{DataType, Field, Fields};
use parquet::arrow::ArrowWriter;
use reqwest::multipart::{Form, Part};
use serde_json::{Value, json};

use palpate::dataset::build::Progress;
use palpate::dataset::error::{DatasetError, Product};
use palpate::dataset::import::coordinates::Coordinates;
use palpate::dataset::import::{Import, import as import_file};
use palpate::dataset::space::KEPT_FREE_BYTES;
use palpate::store::{Label, TrialQuery};

use super::filled::{Filled, store};
use crate::support::{Folder, answered, is_refused};

pub const PAD: &str = "name = \"pad\"\nchannels = 4\nwidth_mm = 100\nheight_mm = 80\n";

pub fn frames(channels: i32, values: Vec<Option<f32>>) -> ArrayRef {
    let item = Arc::new(Field::new("item", DataType::Float32, true));
    let values = Arc::new(Float32Array::from(values));
    Arc::new(FixedSizeListArray::try_new(item, channels, values, None).unwrap())
}

/// Contacts (x, y, force) of three trials: one complete, one without force, none at all.
fn contacts(x_mm: f64) -> ArrayRef {
    let contacts = [(x_mm, 20.0, Some(2.5)), (30.0, 40.0, None)];
    lists(&contacts, [1, 1, 0])
}

/// x and y in mm, and the force in N where it is known.
pub type Touch = (f64, f64, Option<f64>);

/// Contacts of trials, `lengths` of them in each.
pub fn lists(contacts: &[Touch], lengths: impl IntoIterator<Item = usize>) -> ArrayRef {
    let field = |name, kind| Field::new(name, kind, true);
    let fields = Fields::from(vec![
        field("x_mm", DataType::Float64),
        field("y_mm", DataType::Float64),
        field("force_n", DataType::Float64),
    ]);
    let column = |of: fn(&Touch) -> Option<f64>| -> ArrayRef {
        Arc::new(contacts.iter().map(of).collect::<Float64Array>())
    };
    let columns = vec![column(|c| Some(c.0)), column(|c| Some(c.1)), column(|c| c.2)];
    let values = StructArray::try_new(fields.clone(), columns, None).unwrap();
    let item = Arc::new(Field::new("item", DataType::Struct(fields), true));
    let ends = OffsetBuffer::from_lengths(lengths);
    Arc::new(ListArray::try_new(item, ends, Arc::new(values), None).unwrap())
}

pub fn parquet(columns: Vec<(&str, ArrayRef)>) -> Vec<u8> {
    let batch = RecordBatch::try_from_iter(columns).unwrap();
    let mut writer = ArrowWriter::try_new(Vec::new(), batch.schema(), None).unwrap();
    writer.write(&batch).unwrap();
    writer.into_inner().unwrap()
}

/// Hands a file in: the status and the body.
pub async fn import(lab: &Filled, file: Vec<u8>, sensor: &str) -> (u16, Value) {
    let form = Form::new()
        .part("file", Part::bytes(file).file_name("pad.parquet"))
        .part("sensor", Part::text(sensor.to_owned()).file_name("pad.toml"))
        .text("name", "pad-study")
        .text("label", "measured");
    answered(lab.http.post(lab.url("/api/v1/imports")).multipart(form)).await
}

fn good() -> Vec<(&'static str, ArrayRef)> {
    let volts: Vec<Option<f32>> =
        (0..12).map(|n| if n == 5 { None } else { Some(n as f32 / 8.0) }).collect();
    vec![
        ("voltages_v", frames(4, volts)),
        ("contacts", contacts(12.5)),
        ("weather", Arc::new(Int64Array::from(vec![1, 2, 3]))),
    ]
}

#[tokio::test]
async fn another_skins_trials_are_a_run_like_any_other() {
    let lab = Filled::open("import").await;
    let (status, made) = import(&lab, parquet(good()), PAD).await;
    assert_eq!(status, 201, "{made}");
    assert_eq!((&made["trials"], &made["columns_left_out"][0]), (&3.into(), &"weather".into()));
    let run = &made["run"];
    assert_eq!((&run["kind"], &run["label"]), (&"imported".into(), &"measured".into()));
    let run = run["scan_id"].as_i64().unwrap();
    // The same upload again, after a lost answer, doubles nothing.
    let again = import(&lab, parquet(good()), PAD).await;
    is_refused(again, 409, &format!("imported as run {run}"));
    let trials = lab.items(&format!("/api/v1/runs/{run}/trials?voltages=true")).await;
    assert_eq!(trials.len(), 3);
    assert_eq!(trials[0]["contacts"][0]["force_n"], 2.5);
    assert!(trials[1]["contacts"][0].get("force_n").is_none());
    assert_eq!(trials[1]["missing_channels"], 1);
    assert_eq!(trials[2]["contact_count"], 0);
    let imported = trials[0]["trial_id"].as_i64().unwrap();
    lab.refuses_get(&format!("/api/v1/trials/{imported}/frames"), 404, "no raw frames").await;
    // Without a force there is no map, not a map of zeros.
    let path = format!("/api/v1/datasets/run-{run}/rows?map=10x10&columns=trial_id,voltages_v");
    lab.make(&format!("run-{run}")).await;
    let rows = lab.get(&path).await["items"].clone();
    assert_eq!(rows[0]["voltages_v"].as_array().unwrap().len(), 4);
    assert!(rows[0]["force_map_n"].is_array() && rows[1].get("force_map_n").is_none());
    // A map of the extent of the pad has 40 x 40 pixels.
    let path = format!("/api/v1/datasets/run-{run}/rows?map=2.5x10x100&columns=trial_id&limit=1");
    let rows = lab.get(&path).await["items"].clone();
    let map: Vec<f64> = serde_json::from_value(rows[0]["force_map_n"].clone()).unwrap();
    assert!(map.len() == 1600 && (map.iter().sum::<f64>() - 2.5).abs() < 1e-4, "{rows}");
    // It joins datasets only when it is named, and never those of another label unasked.
    assert_eq!(lab.make("real").await["report"]["channels"], 784);
    let both = json!({ "definition": { "name": "both", "task": "real",
        "runs": ["1", run.to_string()] } });
    lab.refuses("/api/v1/datasets", both, 409, "run 1 is virtual").await;
    let own = json!({ "name": "pad", "task": "real", "runs": ["pad-study"] });
    assert_eq!(lab.defined(own).await["rows"], 2);
    // A deadband removes the contact of 2.5 N, and keeps the one whose force is not known.
    let heavy = json!({ "name": "pad-heavy", "task": "real", "runs": ["pad-study"],
        "deadband_n": 3.0, "untouched": "keep" });
    assert_eq!(lab.defined(heavy).await["rows"], 3);
    let path = "/api/v1/datasets/pad-heavy/rows?columns=contact_count,contacts,max_force_n";
    let rows = lab.get(path).await["items"].clone();
    let found = |row: usize| (rows[row]["contact_count"].clone(), rows[row]["contacts"].clone());
    assert_eq!(found(0), (0.into(), json!([])), "{rows}");
    assert_eq!((&found(1).0, &rows[0]["max_force_n"]), (&1.into(), &2.5.into()), "{rows}");
    lab.close().await;
}

/// Raw frames of three trials: two, one, and none, whose mean is stated.
fn raw_frames() -> ArrayRef {
    let volts = [0.25, 0.5, -0.25, 0.0, 0.75, 0.5, -0.75, 0.5, 1.0, 1.0, 1.0, 1.0].map(Some);
    let each = frames(4, volts.to_vec());
    let item = Arc::new(Field::new("item", each.data_type().clone(), true));
    let ends = OffsetBuffer::from_lengths([2, 1, 0]);
    let there = NullBuffer::from(vec![true, true, false]);
    Arc::new(ListArray::try_new(item, ends, each, Some(there)).unwrap())
}

#[tokio::test]
async fn raw_frames_are_stored_and_served_as_those_of_a_rig() {
    let lab = Filled::open("import-raw").await;
    let mut mean = vec![Some(0.0); 12];
    let item = Arc::new(Field::new("item", DataType::Float32, true));
    mean[11] = Some(0.125);
    let means = Arc::new(Float32Array::from(mean)) as ArrayRef;
    let there = NullBuffer::from(vec![false, false, true]);
    let means = Arc::new(FixedSizeListArray::try_new(item, 4, means, Some(there)).unwrap());
    let columns = || vec![("frames_v", raw_frames()), ("contacts", contacts(12.5))];
    let all = [columns(), vec![("voltages_v", means as ArrayRef)]].concat();
    let (status, made) = import(&lab, parquet(all), PAD).await;
    assert_eq!(status, 201, "{made}");
    let run = made["run"]["scan_id"].as_i64().unwrap();
    let trials = lab.items(&format!("/api/v1/runs/{run}/trials?voltages=true")).await;
    let stated = |n: usize| (&trials[n]["frame_count"], &trials[n]["voltages_v"]);
    assert_eq!(stated(0), (&2.into(), &json!([0.5, 0.5, -0.5, 0.25])));
    assert_eq!(stated(1), (&1.into(), &json!([1.0, 1.0, 1.0, 1.0])));
    assert_eq!(stated(2), (&0.into(), &json!([0.0, 0.0, 0.0, 0.125])));
    let path = |n: usize| format!("/api/v1/trials/{}/frames", trials[n]["trial_id"]);
    let served = lab.items(&path(0)).await;
    assert_eq!(served.len(), 2);
    let volts: Vec<f64> = serde_json::from_value(served[1]["voltages_v"].clone()).unwrap();
    for (volt, wanted) in volts.iter().zip([0.75, 0.5, -0.75, 0.5]) {
        assert!((volt - wanted).abs() <= 0.75 / 65_534.0 * 1.01, "{volts:?}");
    }
    // A device measured them that is not known here.
    assert!(served[0].get("sequence").is_none() && served[0].get("device_time_us").is_none());
    assert_eq!(served[1]["counts"][0], 32_767);
    lab.refuses_get(&path(2), 404, "no raw frames").await;
    // Without the mean the third trial has no frame.
    is_refused(import(&lab, parquet(columns()), PAD).await, 400, "row 2, voltages_v = null");
    lab.close().await;
}

#[tokio::test]
async fn what_cannot_be_used_is_named_and_nothing_is_stored() {
    let lab = Filled::open("import-bad").await;
    let before = lab.get("/api/v1/runs").await["items"].as_array().unwrap().len();
    let wrong_length =
        parquet(vec![("voltages_v", frames(3, vec![Some(1.0); 9])), ("contacts", contacts(12.5))]);
    let outside = parquet(vec![good().remove(0), ("contacts", contacts(120.0))]);
    let infinite = parquet(vec![
        ("voltages_v", frames(4, vec![Some(f32::INFINITY); 12])),
        ("contacts", contacts(12.5)),
    ]);
    let numbers = Arc::new(Int64Array::from(vec![1, 2, 3])) as ArrayRef;
    let words = parquet(vec![("voltages_v", numbers), ("contacts", contacts(12.5))]);
    let flat = "channels = 4\nname = \"p\"\nwidth_mm = 0\nheight_mm = 1\n";
    let with = |configurations: ArrayRef| {
        parquet([good(), vec![("configuration", configurations)]].concat())
    };
    let half = with(Arc::new(Float64Array::from(vec![0.0, 0.5, 1.0])));
    let twice = with(Arc::new(Int64Array::from(vec![0, 0, 0])));
    for (file, sensor, wanted) in [
        (wrong_length, PAD, "row 0, voltages_v = 3 values: must have the 4 values of sensor pad"),
        (outside, PAD, "row 0, contacts[0].x_mm = 120: must be from 0 to 100"),
        (infinite, PAD, "row 0, voltages_v = infinite"),
        (words, PAD, "must be a column of lists of numbers"),
        (half, PAD, "configuration = 0.5: must be a column of whole numbers"),
        (parquet(vec![good().remove(0)]), PAD, "contacts = absent"),
        (twice, PAD, "must occur once"),
        (parquet(vec![("weather", frames(4, vec![Some(1.0); 4]))]), PAD, "voltages_v = absent"),
        (b"PAR2 or so".to_vec(), PAD, "must be a Parquet file"),
        (parquet(good()), "name = \"pad\"\n", "channels"),
        (parquet(good()), flat, "width_mm = 0"),
    ] {
        is_refused(import(&lab, file, sensor).await, 400, wanted);
    }
    assert_eq!(lab.get("/api/v1/runs").await["items"].as_array().unwrap().len(), before);
    let uploads = std::fs::read_dir(lab.data.join("uploads")).unwrap().count();
    assert_eq!(uploads, 0, "uploads are removed");
    lab.close().await;
}

/// Two contacts at each of 20 places and at two depths; at the first one of them is below the deadband.
#[tokio::test]
async fn depths_of_a_configuration_stay_together_under_a_deadband() {
    let lab = Filled::open("import-depths").await;
    let touches: Vec<Touch> = (0..40u32)
        .flat_map(|trial| {
            let (x_mm, light_n) = (2.0 * f64::from(trial / 2), [2.0, 6.0][trial as usize % 2]);
            [(x_mm, 20.0, Some(light_n)), (x_mm, 60.0, Some(9.0))]
        })
        .collect();
    let volts = (0..160).map(|n| Some(n as f32 / 200.0)).collect();
    let columns = vec![("voltages_v", frames(4, volts)), ("contacts", lists(&touches, [2; 40]))];
    let (status, made) = import(&lab, parquet(columns), PAD).await;
    assert_eq!(status, 201, "{made}");
    let heavy =
        json!({ "name": "heavy", "task": "real", "runs": ["pad-study"], "deadband_n": 3.0 });
    assert_eq!(lab.defined(heavy).await["rows"], 40);
    let path = "/api/v1/datasets/heavy/rows?columns=trial_id,split,contact_count&limit=100";
    let rows = lab.items(path).await;
    for depths in rows.chunks(2) {
        assert_eq!([0, 1].map(|at| depths[at]["contact_count"].as_u64()), [Some(1), Some(2)]);
        assert_eq!(depths[0]["split"], depths[1]["split"], "{depths:?}");
    }
    let parts = |part: &str| rows.iter().filter(|row| row["split"] == part).count();
    assert_eq!(["train", "validation", "test"].map(parts), [24, 8, 8]);
    lab.close().await;
}

/// A request for an import of [`good`].
fn request() -> Import {
    Import {
        name: "pad-study".into(),
        label: Label::Measured,
        file: "pad.parquet".into(),
        sensor_file: "pad.toml".into(),
        sensor: PAD.into(),
        coordinates: Coordinates::default(),
        submitted_by: "local".into(),
    }
}

#[tokio::test]
async fn a_file_that_is_imported_twice_at_once_is_one_run() {
    let data = Folder::new("import-twice");
    let store = store(&data).await;
    let path = data.join("pad.parquet");
    std::fs::write(&path, parquet(good())).unwrap();
    let progress = Progress::default();
    let import = || import_file(&store, &path, request(), u64::MAX, &progress);
    let (one, two) = tokio::join!(import(), import());
    let (stored, refused) = if one.is_ok() { (one, two) } else { (two, one) };
    let run = stored.unwrap().run;
    assert!(matches!(refused, Err(DatasetError::Imported(known)) if known == run.scan_id));
    let query = TrialQuery { limit: 100, ..TrialQuery::default() };
    let trials = store.trials(&query).await.unwrap();
    assert_eq!(trials.iter().map(|trial| trial.run).collect::<Vec<_>>(), [run.uid; 3]);
    // Under another file name it is the same file.
    let renamed = Import { file: "copy.parquet".into(), ..request() };
    let refused = import_file(&store, &path, renamed, u64::MAX, &progress).await;
    assert!(matches!(refused, Err(DatasetError::Imported(known)) if known == run.scan_id));
    store.close().await;
}

#[tokio::test]
async fn an_import_that_the_disk_cannot_hold_stores_nothing() {
    let data = Folder::new("import-disk");
    let store = store(&data).await;
    let path = data.join("pad.parquet");
    std::fs::write(&path, parquet(good())).unwrap();
    // Three trials without their numbers take 2400 bytes.
    let progress = Progress::default();
    let free = KEPT_FREE_BYTES + 2400;
    let refused = import_file(&store, &path, request(), free, &progress).await;
    assert!(matches!(refused, Err(DatasetError::DiskFull { product: Product::Import, .. })));
    assert!(store.runs(&[], 10, None).await.unwrap().runs.is_empty());
    let free = KEPT_FREE_BYTES + 4000;
    let stored = import_file(&store, &path, request(), free, &progress).await.unwrap();
    assert_eq!(stored.trials, 3);
    // What a client shows while it waits.
    assert_eq!([&progress.done, &progress.total].map(|n| n.load(Relaxed)), [3, 3]);
    store.close().await;
}
