//! The same work with results in a bucket of an S3 service: moto, a server for tests, from the packages of
//! PALPATE_PYTHON. moto checks neither signatures nor policies.

use std::net::TcpListener;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::json;

use crate::bench::{Bench, text, until};
use crate::server::run;

const SOON: Duration = Duration::from_secs(60);
const SECRET_KEY: &str = "store-hush-3";

/// A running S3 service; killed when dropped.
struct Service {
    process: Child,
    port: u16,
}

impl Drop for Service {
    fn drop(&mut self) {
        drop(self.process.kill());
        drop(self.process.wait());
    }
}

fn service() -> Option<Service> {
    let python = std::env::var("PALPATE_PYTHON").unwrap_or_else(|_| "python3".into());
    let has_moto = Command::new(&python).args(["-c", "import moto.server"]).output();
    if !has_moto.is_ok_and(|output| output.status.success()) {
        assert!(
            std::env::var_os("PALPATE_REQUIRE_TOOLS").is_none(),
            "{python}: no moto[s3], flask and flask-cors"
        );
        eprintln!("SKIPPED: {python} has no moto[s3], flask and flask-cors");
        return None;
    }
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let start = "import sys, moto.server; moto.server.main(sys.argv[1:])";
    let mut command = Command::new(python);
    command.args(["-c", start, "-H", "127.0.0.1", "-p", &port.to_string()]);
    let process = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let service = Service { process, port };
    until("the service answers", SOON, || {
        std::net::TcpStream::connect(("127.0.0.1", port)).is_ok()
    });
    run(Command::new("curl").args(["-sf", "-X", "PUT", &format!("http://127.0.0.1:{port}/lab")]));
    Some(service)
}

#[test]
fn results_in_a_bucket_equal_those_of_one_process() {
    let Some(service) = service() else { return };
    let Some(bench) = Bench::start() else { return };
    let made = bench.order(6, json!({ "seed": 3, "fails": [4] }));
    let at = |arguments: &[&str]| {
        let mut command = bench.command(arguments);
        command.env("PALPATE_STORE", "s3://lab/some/prefix");
        command.env("AWS_ENDPOINT", format!("http://127.0.0.1:{}", service.port));
        command.env("AWS_ACCESS_KEY_ID", "id").env("AWS_SECRET_ACCESS_KEY", SECRET_KEY);
        command
    };
    let ok = |arguments: &[&str]| text(&run(&mut at(arguments)).stdout);
    assert!(ok(&["submit", made.path(), "--attempts", "1"]).contains("6 submitted"));
    let worked = at(&["work", "--until-idle"]).env("PALPATE_LOG", "trace").output().unwrap();
    assert!(worked.status.success());
    let log = text(&worked.stderr);
    assert!(log.contains("made=5 existed=0 failed=1") && !log.contains(SECRET_KEY), "{log}");
    let status: serde_json::Value =
        serde_json::from_str(&ok(&["status", made.path(), "--json"])).unwrap();
    let order = &status["orders"][0];
    assert_eq!((&order["done"], &order["failed"]), (&json!(5), &json!(1)));
    assert!(order["errors"][0]["error"].as_str().unwrap().contains("index 4 fails"), "{order}");
    let fetched = bench.folder.path().join("fetched");
    assert!(ok(&["fetch", &made.order.id[..8], fetched.to_str().unwrap()]).contains("5 of 6"));
    let results = made.results(&fetched.join("results"));
    assert!(results[4].is_none());
    assert!(results == made.undisturbed());
    assert!(
        ok(&["submit", made.path()]).contains("1 submitted (1 had failed), 0 in the queue, 5 done")
    );
    // A service on another machine must be encrypted, by whichever name its client takes it.
    for name in ["AWS_ENDPOINT", "AWS_ENDPOINT_URL_S3"] {
        let mut status = at(&["status"]);
        status.env("AWS_ALLOW_HTTP", "true").env(name, "http://store.lab:9000");
        let refused = status.output().unwrap();
        let error = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{error}");
        let is_named = error.contains(&format!("{name}: must be https"));
        assert!(is_named && !error.contains(SECRET_KEY), "{error}");
    }
}
