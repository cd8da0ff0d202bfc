//! Exports: progress, pieces, restarts, and files that are what their tags say.

use palpate::digest::sha256_hex;
use reqwest::StatusCode;
use reqwest::header::{ETAG, IF_NONE_MATCH, IF_RANGE, RANGE};
use serde_json::{Value, json};

use super::filled::Filled;

async fn exported(lab: &Filled, request: Value) -> (Value, Vec<u8>) {
    let (status, asked) = lab.post("/api/v1/exports", request).await;
    assert_eq!(status, 202, "{asked}");
    let row = lab.over(asked["id"].as_str().unwrap()).await;
    assert_eq!(row["state"], "done", "{row}");
    let file = lab.answer(row["url"].as_str().unwrap()).await.bytes().await.unwrap().to_vec();
    assert_eq!(row["sha256"], sha256_hex(&file).as_str());
    assert_eq!(row["bytes"], file.len());
    (row, file)
}

#[tokio::test]
async fn files_come_in_pieces_that_belong_together() {
    let lab = Filled::open("pieces").await;
    let (_, whole) = exported(&lab, json!({ "dataset": "real", "format": "npz" })).await;
    let url = lab.url("/api/v1/data/real.npz");
    let part = lab.http.get(&url).header(RANGE, "bytes=100-299").send().await.unwrap();
    assert_eq!(part.status(), StatusCode::PARTIAL_CONTENT);
    let tag = part.headers()[ETAG].clone();
    assert_eq!(tag, format!("\"{}\"", sha256_hex(&whole)).as_str());
    assert_eq!(part.bytes().await.unwrap(), &whole[100..300]);
    let same = lab.http.get(&url).header(RANGE, "bytes=300-").header(IF_RANGE, tag.clone());
    assert_eq!(same.send().await.unwrap().bytes().await.unwrap(), &whole[300..]);
    let other = lab.http.get(&url).header(RANGE, "bytes=300-").header(IF_RANGE, "\"other\"");
    let other = other.send().await.unwrap();
    assert_eq!(other.status(), StatusCode::OK);
    assert_eq!(other.bytes().await.unwrap(), &whole[..]);
    let known = lab.http.get(&url).header(IF_NONE_MATCH, tag).send().await.unwrap();
    assert_eq!(known.status(), StatusCode::NOT_MODIFIED);
    let head = lab.http.head(&url).send().await.unwrap();
    assert_eq!(head.headers()["content-length"], whole.len().to_string().as_str());
    assert_eq!(head.headers()["accept-ranges"], "bytes");
    assert!(head.headers().contains_key("repr-digest"));
    let beyond = lab.http.get(&url).header(RANGE, "bytes=999999999-").send().await.unwrap();
    assert_eq!(beyond.status(), StatusCode::RANGE_NOT_SATISFIABLE);
    lab.close().await;
}

#[tokio::test]
async fn an_export_outlives_the_service_and_gives_the_same_bytes() {
    let lab = Filled::open("restart").await;
    let request = json!({ "dataset": "real", "format": "csv", "map": "20x60",
        "where": ["split=train"] });
    let (first, _) = exported(&lab, request.clone()).await;
    // Asked for, not waited for, and the service ends.
    let another = json!({ "dataset": first["dataset"], "format": "ndjson" });
    let (_, open) = lab.post("/api/v1/exports", another.clone()).await;
    let data = lab.end().await;
    for name in ["exports", "datasets"] {
        let folder = data.join(name);
        std::fs::write(folder.join("_partial-of-a-killed-process"), "half").unwrap();
    }
    let removed = data.join("exports");
    for entry in std::fs::read_dir(&removed).unwrap() {
        let path = entry.unwrap().path();
        if !path.file_name().unwrap().to_string_lossy().starts_with('_') {
            std::fs::remove_file(path).unwrap();
        }
    }
    let lab = Filled::serve(data).await;
    let over = lab.over(open["id"].as_str().unwrap()).await;
    assert_eq!(over["state"], "done", "{over}");
    let (again, _) = exported(&lab, another).await;
    assert_eq!(over["sha256"], again["sha256"]);
    assert_eq!(
        lab.refused(&format!("/api/v1/exports/{}/file", first["id"].as_str().unwrap())).await.0,
        410
    );
    let (same, _) = exported(&lab, request).await;
    assert_eq!((&same["sha256"], &same["dataset"]), (&first["sha256"], &first["dataset"]));
    let left: Vec<_> = std::fs::read_dir(lab.data.join("exports"))
        .unwrap()
        .filter(|e| e.as_ref().unwrap().file_name().to_string_lossy().starts_with("_partial"))
        .collect();
    assert!(left.is_empty(), "{left:?}");
    lab.close().await;
}

#[tokio::test]
async fn a_truncated_sha256_of_an_export_is_not_used() {
    let lab = Filled::open("truncated").await;
    let request = json!({ "dataset": "real", "format": "csv" });
    exported(&lab, request.clone()).await;
    let entries = std::fs::read_dir(lab.data.join("exports")).unwrap();
    let mut digests = entries.map(|entry| entry.unwrap().path());
    let digest = digests.find(|path| path.extension().is_some_and(|e| e == "sha256")).unwrap();
    // As a power failure could leave it before the file was synced.
    let whole = std::fs::read_to_string(&digest).unwrap();
    std::fs::write(&digest, &whole[..20]).unwrap();
    exported(&lab, request).await;
    assert_eq!(std::fs::read_to_string(&digest).unwrap(), whole);
    lab.close().await;
}

#[tokio::test]
async fn wishes_that_cannot_be_met_are_refused_or_fail_with_their_reason() {
    let lab = Filled::open("wishes").await;
    let ask = async |request: Value| lab.post("/api/v1/exports", request).await;
    assert_eq!(ask(json!({ "dataset": "reel", "format": "csv" })).await.0, 404);
    assert_eq!(ask(json!({ "dataset": "real", "format": "xlsx" })).await.0, 422);
    let id = lab.make("real").await["id"].clone();
    let (status, body) = ask(json!({ "dataset": id, "format": "csv", "map": "7x20" })).await;
    assert_eq!(status, 400, "{body}");
    let (_, late) =
        ask(json!({ "dataset": "real-unseen", "format": "csv", "slice": "0:9999" })).await;
    let late = lab.over(late["id"].as_str().unwrap()).await;
    assert_eq!(late["state"], "failed");
    assert!(late["error"].as_str().unwrap().contains("0:784"), "{late}");
    let file = format!("/api/v1/exports/{}/file", late["id"].as_str().unwrap());
    assert_eq!(lab.refused(&file).await.0, 409);
    assert_eq!(lab.refused("/api/v1/exports/ex-none").await.0, 404);
    lab.close().await;
}
