//! Exports: progress, pieces, restarts, and files that match their tags.

use jiff::Timestamp;
use palpate::digest::sha256_hex;
use reqwest::StatusCode;
use reqwest::header::{ETAG, IF_MATCH, IF_NONE_MATCH, IF_RANGE, RANGE};
use serde_json::{Value, json};

use super::filled::Filled;
use crate::support::with_extension;

fn path_of(export: &Value) -> String {
    format!("/api/v1/exports/{}", export["id"].as_str().unwrap())
}

async fn exported(lab: &Filled, request: Value) -> (Value, Vec<u8>) {
    let asked = lab.posted("/api/v1/exports", request, 202).await;
    let row = lab.over(asked["id"].as_str().unwrap()).await;
    assert_eq!(row["state"], "done", "{row}");
    let before = Timestamp::now();
    let file = lab.answer(row["url"].as_str().unwrap()).await.bytes().await.unwrap().to_vec();
    assert_eq!(row["sha256"], sha256_hex(&file).as_str());
    assert_eq!(row["bytes"], file.len());
    assert!(lab.used_at(&path_of(&row)).await >= before);
    (row, file)
}

#[tokio::test]
async fn files_come_in_pieces_that_belong_together() {
    let lab = Filled::open("pieces").await;
    let (row, whole) = exported(&lab, json!({ "dataset": "real", "format": "npz" })).await;
    let url = lab.url("/api/v1/data/real.npz");
    let before = Timestamp::now();
    let part = lab.http.get(&url).header(RANGE, "bytes=100-299").send().await.unwrap();
    // A download at the address of the dataset uses the same file.
    assert!(lab.used_at(&path_of(&row)).await >= before);
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

/// The parts of a `multipart/byteranges` body, as (Content-Range, bytes).
fn parts(body: &[u8], boundary: &str) -> Vec<(String, Vec<u8>)> {
    let cut = |bytes: &[u8], at: &str| {
        let n = bytes.windows(at.len()).position(|window| window == at.as_bytes()).unwrap();
        (bytes[..n].to_vec(), bytes[n + at.len()..].to_vec())
    };
    let between = format!("\r\n--{boundary}");
    let mut rest = cut(body, &between).1;
    let mut parts = Vec::new();
    while rest != b"--\r\n" {
        let (head, more) = cut(&rest, "\r\n\r\n");
        let head = String::from_utf8(head).unwrap();

        let range = head.lines().find_map(|line| line.strip_prefix("content-range: ")).unwrap();
        let (bytes, more) = cut(&more, &between);
        parts.push((range.to_owned(), bytes));
        rest = more;
    }
    parts
}

#[tokio::test]
async fn several_ranges_are_parts_of_one_response() {
    let lab = Filled::open("ranges").await;
    let (_, whole) = exported(&lab, json!({ "dataset": "real", "format": "npz" })).await;
    let (url, size) = (lab.url("/api/v1/data/real.npz"), whole.len());
    let ask = |range: String| lab.http.get(&url).header(RANGE, range).send();
    let last = size - 100_000;
    let several = ask(format!("bytes=20-29,{last}-,10-12, 0-9")).await.unwrap();
    assert_eq!(several.status(), StatusCode::PARTIAL_CONTENT);
    let kind = several.headers()["content-type"].to_str().unwrap().to_owned();
    let boundary = kind.strip_prefix("multipart/byteranges; boundary=").unwrap();
    let length = several.content_length().unwrap();
    let body = several.bytes().await.unwrap();
    assert_eq!(length, body.len() as u64);
    let expected = [0..13, 20..30, last..size].map(|part| {
        let shown = format!("bytes {}-{}/{size}", part.start, part.end - 1);
        (shown, whole[part].to_vec())
    });
    assert!(parts(&body, boundary) == expected, "the parts differ");
    // Adjacent ranges are one part; what is no range is ignored.
    let merged = ask("bytes=0-9,10-19".into()).await.unwrap();
    assert_eq!(merged.headers()["content-range"], format!("bytes 0-19/{size}").as_str());
    assert_eq!(merged.bytes().await.unwrap(), &whole[..20]);
    let many = (0..17).map(|n| format!("{0}-{0}", 2 * n)).collect::<Vec<_>>().join(",");
    for ignored in ["bytes=abc", "bytes=5-1", "rows=0-9", &format!("bytes={many}")] {
        let answer = ask(ignored.into()).await.unwrap();
        assert_eq!(answer.status(), StatusCode::OK, "{ignored}");
        assert_eq!(answer.content_length(), Some(size as u64));
        assert!(answer.bytes().await.unwrap() == whole, "{ignored}");
    }
    let beyond = ask(format!("bytes={size}-,{size}-{size}")).await.unwrap();
    assert_eq!(beyond.status(), StatusCode::RANGE_NOT_SATISFIABLE);
    assert_eq!(beyond.headers()["content-range"], format!("bytes */{size}").as_str());
    assert_eq!(beyond.headers()["content-type"], "application/problem+json");
    // HEAD is answered like GET, without ranges and without the body.
    let head = lab.http.head(&url).header(RANGE, "bytes=0-9").send().await.unwrap();
    assert_eq!(head.status(), StatusCode::OK);
    assert_eq!(head.headers()["content-length"], size.to_string().as_str());
    assert!(head.bytes().await.unwrap().is_empty());
    // Who wants another file gets none.
    let tag = format!("\"{}\"", sha256_hex(&whole));
    for (tags, status) in [(format!("\"x\", {tag}"), 200), ("*".into(), 200), ("\"x\"".into(), 412)]
    {
        let answer = lab.http.get(&url).header(IF_MATCH, &tags).send().await.unwrap();
        assert_eq!(answer.status(), status, "{tags}");
    }
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
    assert_eq!(lab.refused(&format!("{}/file", path_of(&first))).await.0, 410);
    let (same, _) = exported(&lab, request).await;
    assert_eq!((&same["sha256"], &same["dataset"]), (&first["sha256"], &first["dataset"]));
    let left = std::fs::read_dir(lab.data.join("exports")).unwrap();
    let mut left = left.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned());
    assert_eq!(left.find(|name| name.starts_with("_partial")), None);
    lab.close().await;
}

#[tokio::test]
async fn a_truncated_sha256_of_an_export_is_not_used() {
    let lab = Filled::open("truncated").await;
    let request = json!({ "dataset": "real", "format": "csv" });
    exported(&lab, request.clone()).await;
    let digest = with_extension(&lab.data.join("exports"), "sha256").remove(0);
    // As a power failure could leave it before the file was synced.
    let whole = std::fs::read_to_string(&digest).unwrap();
    std::fs::write(&digest, &whole[..20]).unwrap();
    exported(&lab, request).await;
    assert_eq!(std::fs::read_to_string(&digest).unwrap(), whole);
    lab.close().await;
}

#[tokio::test]
async fn requests_that_cannot_be_met_are_refused_or_fail_with_their_reason() {
    let lab = Filled::open("exports-refused").await;
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
    assert_eq!(lab.refused(&format!("{}/file", path_of(&late))).await.0, 409);
    assert_eq!(lab.refused("/api/v1/exports/ex-none").await.0, 404);
    lab.close().await;
}
