//! Pages, columns, slices and maps; and what a query gets wrong.

use palpate::dataset::format::Format;
use serde_json::Value;

use super::filled::Filled;

#[tokio::test]
async fn what_is_stored_is_read_by_queries() {
    let lab = Filled::open("queries").await;
    lab.make("real").await;
    lab.make("run-1").await;
    pages_cover_a_dataset_once_also_filtered(&lab).await;
    rows_come_in_the_order_of_a_column(&lab).await;
    frames_are_cut_and_maps_sum_to_the_forces(&lab).await;
    stored_trials_come_in_every_format(&lab).await;
    the_header_accept_selects_a_format(&lab).await;
    bad_queries_are_400_with_the_column_and_the_choices(&lab).await;
    lab.close().await;
}

async fn pages_cover_a_dataset_once_also_filtered(lab: &Filled) {
    for filter in ["", "&configuration__gte=7&max_force_n__lt=12.5&split=train"] {
        let mut seen = Vec::new();
        let mut path = format!("/api/v1/datasets/run-1/rows?limit=17&columns=trial_id{filter}");
        if !filter.is_empty() {
            path = path.replace("run-1", "real");
        }
        let first = path.clone();
        loop {
            let page = lab.get(&path).await;
            let rows = page["items"].as_array().unwrap();
            assert!(rows.len() <= 17);
            seen.extend(rows.iter().map(|row| row["trial_id"].as_i64().unwrap()));
            let Some(next) = page["next"].as_str() else { break };
            path = format!("{first}&cursor={next}");
        }
        let all = lab.items(&first.replace("limit=17", "limit=10000")).await;
        let all: Vec<i64> = all.iter().map(|r| r["trial_id"].as_i64().unwrap()).collect();
        assert_eq!(seen, all);
        assert!(!all.is_empty() && all.windows(2).all(|pair| pair[0] < pair[1]));
    }
}

async fn rows_come_in_the_order_of_a_column(lab: &Filled) {
    let path = "/api/v1/datasets/run-1/rows?columns=trial_id,max_force_n,voltages_v&tips=2";
    let all = lab.items(&format!("{path}&limit=10000")).await;
    let mut wanted = all.clone();
    let force = |row: &Value| row["max_force_n"].as_f64().unwrap();
    wanted.sort_by(|a, b| force(b).total_cmp(&force(a)));
    let (mut found, mut cursor) = (Vec::new(), String::new());
    loop {
        let page = lab.get(&format!("{path}&sort=-max_force_n&limit=37{cursor}")).await;
        found.extend(page["items"].as_array().unwrap().clone());
        let Some(next) = page["next"].as_str() else { break };
        cursor = format!("&cursor={next}");
    }
    assert_eq!(found.len(), all.len());
    assert!(found == wanted, "frames belong to their rows");
    lab.refuses_get(&format!("{path}&sort=voltages_v"), 400, "max_force_n").await;
}

async fn frames_are_cut_and_maps_sum_to_the_forces(lab: &Filled) {
    let whole = lab.get("/api/v1/datasets/real/rows?limit=3&columns=voltages_v").await;
    let cut = lab.get("/api/v1/datasets/real/rows?limit=3&columns=voltages_v&slice=28:56").await;
    let maps = lab.get("/api/v1/datasets/real/rows?limit=3&columns=contacts&map=10x10").await;
    for row in 0..3 {
        let whole = whole["items"][row]["voltages_v"].as_array().unwrap();
        assert_eq!(whole.len(), 784);
        assert_eq!(cut["items"][row]["voltages_v"].as_array().unwrap(), &whole[28..56]);
        let map = maps["items"][row]["force_map_n"].as_array().unwrap();
        assert_eq!(map.len(), 64 * 64);
        let sum = |values: &[Value]| values.iter().map(|v| v.as_f64().unwrap()).sum::<f64>();
        let contacts = maps["items"][row]["contacts"].as_array().unwrap();
        let forces: Vec<Value> = contacts.iter().map(|c| c["force_n"].clone()).collect();
        assert!((sum(map) / sum(&forces) - 1.0).abs() < 1e-6, "{} {}", sum(map), sum(&forces));
    }
}

async fn the_header_accept_selects_a_format(lab: &Filled) {
    let csv = Format::Csv.media_type();
    for (accept, parameter, status, kind) in [
        ("*/*", "", 200, "application/json"),
        ("application/vnd.apache.parquet;q=0.1, text/csv", "", 200, csv),
        ("text/csv;q=0.5, application/json;q=0.9", "", 200, "application/json"),
        ("image/png", "", 406, "application/problem+json"),
        ("image/png", "&format=json", 200, "application/json"),
    ] {
        for list in ["trials", "datasets/real/rows"] {
            let path = format!("/api/v1/{list}?limit=2{parameter}");
            let answer = lab.http.get(lab.url(&path)).header("accept", accept).send().await;
            let answer = answer.unwrap();
            assert_eq!(answer.status(), status, "{path} {accept}");
            assert_eq!(answer.headers()["content-type"], kind, "{path} {accept}");
        }
    }
}

async fn stored_trials_come_in_every_format(lab: &Filled) {
    let path = "/api/v1/trials?contact_count=2&max_force_n__gt=10&limit=40";
    let json = lab.get(path).await;
    let ids: Vec<i64> =
        json["items"].as_array().unwrap().iter().map(|t| t["trial_id"].as_i64().unwrap()).collect();
    assert_eq!(ids.len(), 40);
    let lines = lab.answer(&format!("{path}&format=ndjson&columns=trial_id,contacts")).await;
    let next = json["next"].as_str().unwrap();
    let link = lines.headers()["link"].to_str().unwrap();
    assert!(link.ends_with("; rel=\"next\""), "{link}");
    let second = link.strip_prefix('<').and_then(|link| link.split_once('>')).unwrap().0;
    assert!(second.contains("format=ndjson&columns=trial_id,contacts&cursor="), "{second}");
    let second = lab.answer(second).await.text().await.unwrap();
    let first = serde_json::from_str::<Value>(second.lines().next().unwrap()).unwrap();
    assert!(first["trial_id"].as_i64().unwrap() > ids[39]);
    lab.refuses_get(&format!("{path}&sort=-trial_id&cursor={next}"), 400, "of the same address")
        .await;
    lab.refuses_get(&format!("{path}&columns=trial_id"), 400, "format=ndjson").await;
    let text = lines.text().await.unwrap();
    let rows: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(rows.iter().map(|r| r["trial_id"].as_i64().unwrap()).collect::<Vec<_>>(), ids);
    assert_eq!(rows[0].as_object().unwrap().len(), 2);
    for format in Format::ALL {
        let answer = lab.answer(&format!("{path}&voltages=true&format={format}")).await;
        assert_eq!(answer.status().is_success(), format.streams(), "{format}");
        if !format.streams() {
            continue;
        }
        assert_eq!(answer.headers()["content-type"], format.media_type());
        let bytes = answer.bytes().await.unwrap();
        let starts = match format {
            Format::Parquet => &b"PAR1"[..],
            Format::Arrow => b"\xff\xff\xff\xff",
            Format::Feather => b"ARROW1",
            Format::Csv => b"trial_id,run,",
            _ => b"",
        };
        assert!(!bytes.is_empty() && bytes.starts_with(starts), "{format}");
    }
    let many = (0..998).map(|n| (n % 7).to_string()).collect::<Vec<_>>().join(",");
    let all = lab.get(&format!("/api/v1/trials?tips__in={many}&limit=2")).await;
    assert_eq!(all["items"].as_array().unwrap().len(), 2);
    let some = lab.get("/api/v1/trials?contact_count__in=2,9&limit=10000").await;
    let one = lab.get("/api/v1/trials?contact_count=2&limit=10000").await;
    assert_eq!(some["items"], one["items"]);
    let backwards = lab.get(&format!("{path}&sort=-trial_id")).await;
    let backwards = backwards["items"][0]["trial_id"].as_i64().unwrap();
    assert!(backwards > ids[0]);
}

async fn bad_queries_are_400_with_the_column_and_the_choices(lab: &Filled) {
    for path in [
        "/api/v1/trials",
        "/api/v1/runs/1/trials",
        "/api/v1/datasets/real/rows",
        "/api/v1/data/real.csv",
    ] {
        for (query, wanted) in [
            ("colour=red", &["colour", "contact_count"][..]),
            ("columns=trial_id,colour", &["colour", "voltages_v"]),
            ("tips__gt=many", &["tips__gt", "many"]),
            ("tips__near=3", &["gte"]),
            ("voltages_v__gt=1", &["voltages_v", "max_force_n"]),
            ("limit=1000000", &["limit", "10000", "export"]),
            ("format=xlsx", &["xlsx", "parquet"]),
        ] {
            if path.contains("/data/") && (query.contains("limit") || query.contains("format")) {
                // A file has no pages.
                assert_eq!(lab.refused(&format!("{path}?{query}")).await.0, 400);
                continue;
            }
            let (status, words) = lab.refused(&format!("{path}?{query}")).await;
            assert_eq!(status, 400, "{path}?{query}: {words}");
            for word in wanted {
                assert!(words.contains(word), "{path}?{query}: {words}");
            }
        }
    }
    for (query, word) in [
        ("map=3x20", "divide 640"),
        ("map=4x0", "diameter"),
        ("map=wide", "4x20"),
        ("slice=0:785&columns=voltages_v", "0:784"),
        ("slice=9:3&columns=voltages_v", "FIRST:END"),
        ("columns=sim_voltages_v", "must be a column"),
        ("format=npz", "npz"),
    ] {
        lab.refuses_get(&format!("/api/v1/datasets/real/rows?{query}"), 400, word).await;
    }
}
