//! Each response of a service states the id of its request, whatever answers it: a handler, a refusal, the
//! fallback, or the e-stop, which no middleware may delay.

use reqwest::Method;

use crate::datasets::filled::{Filled, folder};

/// Whether a text has the form of a uuid.
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
