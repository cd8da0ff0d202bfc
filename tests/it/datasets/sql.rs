//! Questions in SQL to a service with the real query engine: what the tables hold, live trials, formats,
//! groups, refusals. Without the engine the tests report that they were skipped, or fail with
//! `PALPATE_REQUIRE_TOOLS=1`.

use std::time::Duration;

use futures::future::{select, select_all};
use jiff::Timestamp;
use palpate::dataset::format::Format;
use palpate::ids::TrialKey;
use palpate::journal::Journal;
use palpate::program::Program;
use palpate::query::{QUERIES, QUERY};
use palpate::store::RunKind;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use tokio::time::timeout;

use super::filled::{self, Filled};
use crate::support::left_out;

/// A filled service, if there is an engine.
async fn lab(name: &str) -> Option<Filled> {
    if !matches!(QUERY.find(), Program::Ready(_)) {
        return left_out("no query engine: cargo build --manifest-path query/Cargo.toml");
    }
    Some(Filled::open(&format!("sql-{name}")).await)
}

async fn ask(lab: &Filled, sql: &str) -> Value {
    let answer = lab.posted("/api/v1/query", json!({ "sql": sql }), 200).await;
    answer["rows"].clone()
}

async fn number(lab: &Filled, sql: &str) -> Value {
    ask(lab, sql).await[0]["n"].clone()
}

#[tokio::test]
async fn what_is_stored_is_read_by_sql() {
    let Some(lab) = lab("read").await else { return };
    the_tables_hold_what_is_stored(&lab).await;
    an_answer_comes_in_every_row_format_and_by_the_address(&lab).await;
    groups_and_orders_follow_from_the_parameters_of_filters(&lab).await;
    a_refusal_names_what_is_wrong(&lab).await;
    lab.close().await;
}

async fn the_tables_hold_what_is_stored(lab: &Filled) {
    let counts = [
        ("trials", json!(342)),
        ("runs", json!(2)),
        ("twins", json!(327)),
        ("voltages", json!(342 * 784)),
        ("frames", json!(342)),
        ("references", json!(0)),
        // Depths 3 to 10 of 30 configurations have two contacts, the weights two to four.
        ("contacts", json!(30 * 8 * 2 + 4 * (2 + 3 + 4))),
    ];
    for (table, count) in counts {
        let found = number(lab, &format!("SELECT count(*) AS n FROM {table}")).await;
        assert_eq!(found, count, "{table}");
    }
    let events = lab.items("/api/v1/events?follow=false&limit=1000").await.len();
    assert_eq!(number(lab, "SELECT count(*) AS n FROM events").await, events);
    // The columns of the API, value by value.
    let names =
        "trial_id, scan_id, label, depth_mm, tips, contact_count, max_force_n, fvu, measured_at";
    let sql =
        format!("SELECT {names} FROM trials WHERE trial_id IN (5, 20, 335) ORDER BY trial_id");
    let columns = names.replace(' ', "");
    let path = format!("/api/v1/trials?trial_id__in=5,20,335&format=ndjson&columns={columns}");
    let lines = lab.answer(&path).await.text().await.unwrap();
    let rows: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(ask(lab, &sql).await, json!(rows));
    // Frames, measured and simulated, and the FVU by Eq. 2 from the long table.
    let frame = &ask(lab, "SELECT * FROM frames WHERE trial_id = 20").await[0];
    let trial = lab.get("/api/v1/trials/20").await;
    for column in ["voltages_v", "sim_voltages_v"] {
        // Of some numbers two shortest texts are the same f32.
        let volts = |row: &Value| -> Vec<f32> {
            let values = row[column].as_array().unwrap().iter().filter_map(Value::as_f64);
            values.map(|v| v as f32).collect()
        };
        assert_eq!(volts(frame), volts(&trial), "{column}");
        assert_eq!(volts(frame).len(), 784);
    }
    let sql = "SELECT injection, pair, voltage_v AS v FROM voltages WHERE trial_id = 20 AND position = 29";
    let long = json!({ "injection": 1, "pair": 1, "v": frame["voltages_v"][29] });
    assert_eq!(ask(lab, sql).await[0], long);
}

#[tokio::test]
async fn trials_of_a_run_that_goes_on_are_there_and_datasets_are_tables() {
    let Some(lab) = lab("live").await else { return };
    let before = number(&lab, "SELECT max(trial_id) AS n FROM trials").await;
    let store = filled::store(&lab.data).await;
    let run = store.create_run(filled::new_run(RunKind::RealRandom, "live")).await.unwrap().uid;
    let mut chance = ChaCha8Rng::seed_from_u64(9);
    for configuration in 0..3 {
        let key = TrialKey { configuration, depth_index: 0 };
        store.trial(run, &filled::placed(key, &[[100.0, 200.0]], &mut chance)).await.unwrap();
        let sql = "SELECT count(*) AS n FROM trials WHERE experiment = 'live'";
        assert_eq!(number(&lab, sql).await, json!(configuration + 1));
    }
    // Twins arrive later.
    let sql = "SELECT count(fvu) AS n FROM trials WHERE experiment = 'live'";
    assert_eq!(number(&lab, sql).await, json!(0));
    filled::twins(&store, run, "sim-0000000000000002", &mut chance).await;
    assert_eq!(number(&lab, sql).await, json!(0), "the last three have none");
    // A discarded trial is gone, and its attempt is no trial.
    let key = TrialKey { configuration: 2, depth_index: 0 };
    store.discard(run, key, "slipped").await.unwrap();
    let sql = "SELECT count(*) AS n FROM trials WHERE experiment = 'live'";
    assert_eq!(number(&lab, sql).await, json!(2));
    // While a run is driven, no file of columns is written.
    store.interrupt_open_runs(None).await.unwrap();
    store.close().await;
    assert!(before.is_i64());

    let unmade = json!({ "sql": "SELECT count(*) AS n FROM \"real\"" });
    lab.refuses("/api/v1/query", unmade, 400, "dataset make real").await;
    let made = lab.make("real").await;
    for name in ["real", made["id"].as_str().unwrap()] {
        let sql = format!("SELECT count(*) AS n FROM \"{name}\"");
        let before = Timestamp::now();
        assert_eq!(number(&lab, &sql).await, made["rows"]);
        // A statement uses the dataset.
        assert!(lab.used_at("/api/v1/datasets/real").await >= before);
    }
    // The dataset of a run is read without its frames, from a file with the same rows.
    let file = format!("{}.parquet", lab.make("run-1").await["id"].as_str().unwrap());
    let sums =
        "sum(max_force_n + depth_mm + trial_id) AS s, count(fvu) AS n, max(measured_at) AS t";
    let by_columns = ask(&lab, &format!("SELECT {sums} FROM trials WHERE scan_id = 1")).await;
    let by_dataset = ask(&lab, &format!("SELECT {sums} FROM \"run-1\"")).await;
    let sum = |rows: &Value| rows[0]["s"].as_f64().unwrap();
    // It depends on the order of the rows by rounding.
    assert!((sum(&by_columns) / sum(&by_dataset) - 1.0).abs() < 1e-9, "{by_columns} {by_dataset}");
    let rest = |rows: &Value| ["n", "t"].map(|key| rows[0][key].clone());
    assert_eq!(rest(&by_columns), rest(&by_dataset));
    let contacts = "SELECT count(*) AS n FROM contacts WHERE scan_id = 1";
    assert_eq!(number(&lab, contacts).await, json!(30 * 8 * 2));
    let bytes = |folder: &str| std::fs::metadata(lab.data.join(folder).join(&file)).unwrap().len();
    assert!(bytes("columns") * 5 < bytes("datasets"));
    let frames = "SELECT count(*) AS n FROM trials t JOIN frames f USING (trial_id)";
    assert_eq!(number(&lab, frames).await, number(&lab, "SELECT count(*) AS n FROM trials").await);
    let joined =
        "SELECT count(*) AS n FROM real r JOIN trials t USING (trial_id) WHERE t.fvu = 0.5";
    assert_eq!(number(&lab, joined).await, json!(232));
    let tables = lab.get("/api/v1/query/tables").await;
    let names: Vec<&str> =
        tables.as_array().unwrap().iter().filter_map(|table| table["name"].as_str()).collect();
    assert!(names.contains(&"trials") && names.contains(&"real"), "{names:?}");
    lab.close().await;
}

async fn an_answer_comes_in_every_row_format_and_by_the_address(lab: &Filled) {
    let sql = "SELECT trial_id, label, fvu, measured_at, flags FROM trials ORDER BY trial_id";
    for format in Format::ALL {
        let body = json!({ "sql": sql, "format": format.name() });
        let sent = lab.http.post(lab.url("/api/v1/query")).json(&body).send().await.unwrap();
        assert_eq!(sent.status().is_success(), format.streams(), "{format}");
        if !format.streams() {
            continue;
        }
        assert_eq!(sent.headers()["content-type"], format.media_type());
        let bytes = sent.bytes().await.unwrap();
        let rows = match format {
            Format::Csv | Format::Ndjson => {
                let text = String::from_utf8(bytes.to_vec()).unwrap();
                text.lines().count() - usize::from(format == Format::Csv)
            }
            Format::Parquet => {
                use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
                let reader = ParquetRecordBatchReaderBuilder::try_new(bytes).unwrap();
                reader.metadata().file_metadata().num_rows() as usize
            }
            _ => 342,
        };
        assert_eq!(rows, 342, "{format}");
    }
    let get =
        lab.answer("/api/v1/query?sql=SELECT%20max(tips)%20AS%20n%20FROM%20trials&format=csv");
    assert_eq!(get.await.text().await.unwrap(), "n\r\n4\r\n");
}

async fn groups_and_orders_follow_from_the_parameters_of_filters(lab: &Filled) {
    let by_count = "/api/v1/trials/groups?group_by=contact_count&agg=count,max(max_force_n)";
    let by_count = lab.items(by_count).await;
    let counts: Vec<&Value> = by_count.iter().map(|row| &row["count"]).collect();
    assert_eq!(counts, [90, 244, 4, 4], "{by_count:?}");
    let bins = lab.get("/api/v1/trials/groups?scan_id=1&bin=depth_mm:2&sort=-from_depth_mm").await;
    assert_eq!(
        bins["items"],
        json!([
            { "from_depth_mm": 4.0, "count": 90 },
            { "from_depth_mm": 2.0, "count": 120 },
            { "from_depth_mm": 0.0, "count": 120 },
        ])
    );
    // A depth on the border of a range is in it: 3.5 / 0.14 is below 25 in double precision.
    let border = lab.get("/api/v1/trials/groups?scan_id=1&depth_mm=3.5&bin=depth_mm:0.14").await;
    assert_eq!(border["items"], json!([{ "from_depth_mm": 3.5, "count": 30 }]));
    // FVU by pair of electrodes, against the table of voltages.
    let pairs = lab.items("/api/v1/trials/groups?scan_id=1&group_by=pair&agg=fvu,count").await;
    assert_eq!(pairs.len(), 28);
    let of = "FROM voltages WHERE scan_id = 1 AND pair = 3 AND sim_voltage_v IS NOT NULL";
    assert_eq!(pairs[3]["pair"], 3);
    assert_eq!(pairs[3]["count"], number(lab, &format!("SELECT count(*) AS n {of}")).await);
    let squares = "sum((voltage_v - sim_voltage_v) * (voltage_v - sim_voltage_v))";
    let fvu = format!("SELECT {squares} / (variance(voltage_v) * (count(*) - 1)) AS n {of}");
    let [found, wanted] = [&pairs[3]["fvu"], &number(lab, &fvu).await].map(|n| n.as_f64().unwrap());
    assert!((found / wanted - 1.0).abs() < 1e-3, "{found} {wanted}");
    // Of the trials that meet conditions, against the voltages of these trials by their ids; the last has no twin.
    let deep = "SELECT trial_id FROM trials WHERE scan_id = 1 AND depth_mm > 4.9";
    let deep = ask(lab, deep).await;
    let ids: Vec<String> =
        deep.as_array().unwrap().iter().map(|row| row["trial_id"].to_string()).collect();
    let of = format!(
        "FROM voltages WHERE trial_id IN ({}) AND pair = 3 AND sim_voltage_v IS NOT NULL",
        ids.join(", ")
    );
    let fvu = format!("SELECT {squares} / (variance(voltage_v) * (count(*) - 1)) AS n {of}");
    let wanted = number(lab, &fvu).await.as_f64().unwrap();
    let run = lab.get("/api/v1/runs/1").await;
    for run in ["scan_id=1".to_owned(), format!("run={}", run["uid"].as_str().unwrap())] {
        let path = format!("{run}&depth_mm__gt=4.9&group_by=pair&agg=fvu,count");
        let pairs = lab.items(&format!("/api/v1/trials/groups?{path}")).await;
        assert_eq!(pairs.len(), 28, "{path}");
        assert_eq!(pairs[3]["count"], json!(29 * 28), "{path}");
        let found = pairs[3]["fvu"].as_f64().unwrap();
        assert!((found / wanted - 1.0).abs() < 1e-3, "{path}: {found} {wanted}");
    }
    // One of several conditions.
    let either = "/api/v1/trials/groups?agg=count&contact_count=3|depth_mm__gt=4.9";
    assert_eq!(lab.get(either).await["items"], json!([{ "count": 34 }]));
    let listed = lab.get("/api/v1/trials?contact_count=3|depth_mm__gt=4.9&limit=1000").await;
    assert_eq!(listed["items"].as_array().unwrap().len(), 34);
    lab.make("real").await;
    let real = "/api/v1/datasets/real/groups?group_by=split&agg=count,mean(max_force_n)&contact_count=2|tips=9";
    let parts = lab.items(real).await;
    let total: u64 = parts.iter().filter_map(|row| row["count"].as_u64()).sum();
    assert_eq!(total, 235, "{parts:?}");
    // Any order, page by page, equals sorting all.
    let path =
        "/api/v1/trials?sort=-max_force_n&columns=trial_id,max_force_n&format=ndjson&limit=100";
    let (mut next, mut forces) = (path.to_owned(), Vec::new());
    loop {
        let page = lab.answer(&next).await;
        let link = page.headers().get("link").map(|link| link.to_str().unwrap().to_owned());
        let text = page.text().await.unwrap();
        let rows = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        forces.extend(rows.map(|row| row["max_force_n"].as_f64().unwrap_or(-1.0)));
        match link {
            Some(link) => next = link[1..link.find('>').unwrap()].to_owned(),
            None => break,
        }
    }
    assert_eq!(forces.len(), 342);
    assert!(forces.windows(2).all(|pair| pair[0] >= pair[1]));
}

#[tokio::test]
async fn a_query_ends_when_its_client_leaves() {
    let Some(lab) = lab("leaving").await else { return };
    // 342 trials to the power of 6: years, in little memory, since polars holds the left side of each product.
    let product = (0..5).fold("SELECT fvu AS f0 FROM trials".to_owned(), |inner, n| {
        format!("SELECT fvu * f{n} AS f{} FROM trials CROSS JOIN ({inner}) AS q{n}", n + 1)
    });
    let long = json!({ "sql": format!("SELECT sum(f5) AS n FROM ({product}) AS q") });
    let short = json!({ "sql": "SELECT count(*) AS n FROM runs" });
    let some_time = Duration::from_secs(2);
    // As many as may be in progress. None is answered or refused.
    let mut asked =
        select_all((0..QUERIES).map(|_| Box::pin(lab.post("/api/v1/query", long.clone()))));
    if let Ok((answer, ..)) = timeout(some_time, &mut asked).await {
        panic!("{answer:?}");
    }
    // So a further one waits for its turn.
    let further = Box::pin(lab.post("/api/v1/query", short));
    let waits = timeout(some_time, select(&mut asked, further)).await.is_err();
    assert!(waits, "answered while all turns are taken");
    // All clients leave. If a query continued, the next one would be refused after 10 s.
    drop(asked);
    assert_eq!(number(&lab, "SELECT count(*) AS n FROM runs").await, json!(2));
    lab.close().await;
}

async fn a_refusal_names_what_is_wrong(lab: &Filled) {
    for (sql, word) in [
        ("DROP TABLE trials", "DROP"),
        ("SELECT 1; SELECT 2", "2 statements"),
        ("SELECT fuv FROM trials", "fuv"),
        ("SELECT * FROM trails", "did you mean `trials`"),
        ("SELECT * FROM read_parquet('/etc/passwd')", "cannot be read"),
        ("SELECT CAST(9223372036854775807 AS TIMESTAMP) AS t FROM runs", "is no time"),
        ("SELECT a.trial_id FROM voltages a CROSS JOIN voltages b", "rows"),
    ] {
        let answer = lab.posted("/api/v1/query", json!({ "sql": sql }), 400).await;
        let key = if word == "is no time" { "" } else { "sql" };
        assert_eq!(answer["errors"][0]["key"], key, "{sql}");
        assert!(answer["detail"].as_str().unwrap().contains(word), "{sql}: {answer}");
    }
    for (query, word) in [
        ("group_by=colour", "contact_count"),
        ("bin=depth_mm", "COLUMN:WIDTH"),
        ("agg=mode(fvu)", "q90"),
        ("group_by=tips&sort=fvu", "tips, count"),
        ("group_by=pair&agg=mean(fvu)", "with count"),
        ("columns=fvu", "must be absent"),
    ] {
        lab.refuses_get(&format!("/api/v1/trials/groups?{query}"), 400, word).await;
    }
    lab.refuses_get("/api/v1/trials?group_by=tips", 400, "/api/v1/trials/groups").await;
    lab.refuses_get("/api/v1/trials?sort=contacts", 400, "max_force_n").await;
    // The service is steady.
    assert_eq!(number(lab, "SELECT count(*) AS n FROM trials").await, json!(342));
}
