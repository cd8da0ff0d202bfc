//! Heads of requests. Each response states the id of its request, whatever answers it: a handler, a refusal,
//! the fallback, or the e-stop, which no middleware may delay. Long heads are refused, except of the e-stop.

use reqwest::Method;

use crate::datasets::filled::{Filled, folder};

fn is_uuid(text: &str) -> bool {
    let groups: Vec<&str> = text.split('-').collect();
    let hexadecimal = groups.iter().all(|group| group.bytes().all(|b| b.is_ascii_hexdigit()));
    hexadecimal && groups.iter().map(|group| group.len()).eq([8, 4, 4, 4, 12])
}

#[tokio::test]
async fn every_response_states_the_id_of_its_request() {
    let lab = Filled::serve(folder("request-ids")).await;
    for (method, path, status) in [
        (Method::GET, "/api/v1/status", 200),
        (Method::GET, "/api/v1/runs/7", 404),
        (Method::GET, "/api/v1/runs/none", 404),
        (Method::GET, "/no-such-page", 404),
        (Method::POST, "/health/live", 405),
        (Method::POST, "/api/v1/estop", 200),
        (Method::POST, "/estop", 200),
    ] {
        let ask = |id: Option<&str>| {
            let request = lab.http.request(method.clone(), lab.url(path));
            id.into_iter().fold(request, |request, id| request.header("x-request-id", id)).send()
        };
        let made = ask(None).await.unwrap();
        assert_eq!(made.status(), status, "{method} {path}");
        let id = made.headers()["x-request-id"].to_str().unwrap();
        assert!(is_uuid(id), "{method} {path}: {id}");
        let kept = ask(Some("my-night-7")).await.unwrap();
        assert_eq!(kept.headers()["x-request-id"], "my-night-7", "{method} {path}");
        let replaced = ask(Some(&"x".repeat(65))).await.unwrap();
        assert!(is_uuid(replaced.headers()["x-request-id"].to_str().unwrap()), "{method} {path}");
    }
    lab.close().await;
}

#[tokio::test]
async fn a_long_head_is_refused_with_its_bound_and_stops_all_the_same() {
    let lab = Filled::serve(folder("long-heads")).await;
    let long_path = format!("/api/v1/status?{}", "x".repeat(33 << 10));
    let (many, long) = (150, "y".repeat(40 << 10));
    for (method, path, fields, value, status, words) in [
        (Method::GET, long_path.as_str(), 1, "y", 414, "at most 32768 bytes"),
        (Method::GET, "/api/v1/status", many, "y", 431, "at most 100 fields"),
        (Method::GET, "/no-such-page", 1, long.as_str(), 431, "at most 32768 bytes"),
        (Method::POST, "/api/v1/estop", many, "y", 200, "latched"),
        (Method::POST, "/api/v1/estop", 1, long.as_str(), 200, "latched"),
    ] {
        let request = lab.http.request(method, lab.url(path));
        let names = (0..fields).map(|n| format!("x-{n}"));
        let request = names.fold(request, |request, name| request.header(name, value));
        let answer = request.send().await.unwrap();
        assert_eq!(answer.status(), status, "{words}");
        let kind = answer.headers()["content-type"].to_str().unwrap().to_owned();
        assert_eq!(kind == "application/problem+json", status != 200, "{kind}");
        let text = answer.text().await.unwrap();
        assert!(text.contains(words), "{text}");
    }
    lab.close().await;
}
