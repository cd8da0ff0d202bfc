//! A service that systemd starts: it is ready once it answers.

use std::os::unix::net::UnixDatagram;
use std::time::Duration;

use crate::support::{Folder, answered, command, http, served};

/// Longest wait for the message.
const LIMIT: Duration = Duration::from_secs(60);

#[tokio::test(flavor = "multi_thread")]
async fn systemd_is_told_that_a_service_is_ready_once_it_answers() {
    let folder = Folder::new("notify");
    let socket = folder.join("socket");
    let told = UnixDatagram::bind(&socket).unwrap();
    told.set_read_timeout(Some(LIMIT)).unwrap();
    let data = folder.path("data");
    let mut serve = command(&["serve", "--desk", "--twin-workers", "0", "--bind", "127.0.0.1:0"]);
    serve.args(["--data", &data]).env("NOTIFY_SOCKET", &socket);
    let (_service, url) = served(&mut serve);
    let mut message = [0; 64];
    let length = told.recv(&mut message).unwrap();
    assert_eq!(message[..length].trim_ascii(), b"READY=1");
    let (status, _) = answered(http().get(format!("{url}/api/v1/status"))).await;
    assert_eq!(status, 200);
}
