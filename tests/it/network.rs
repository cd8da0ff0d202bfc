//! Between the service and its clients: TLS, keys that are required, and a proxy as the manual sets it up.
//! Without nginx the test of the proxy reports that it was skipped; with `PALPATE_REQUIRE_TOOLS=1` it fails.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::StreamExt;
use palpate::api::Tls;
use palpate::cli::trust::{self, Certificates};
use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair};
use reqwest::{Client, StatusCode};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::{Connector, connect_async_tls_with_config};

use super::datasets::filled::{Filled, folder, rig};
use super::support::{self, Folder, PALPATE, Process, http, served};

const LIMIT: Duration = Duration::from_secs(20);
const MANUAL: &str = include_str!("../../docs/how-to/network.md");

// ---------------------------------------------------------------- certificates and clients

/// A self-signed certificate with its key, in two files.
fn self_signed(folder: &Path) -> Tls {
    let made = rcgen::generate_simple_self_signed(["rig.example.org".to_owned()]).unwrap();
    written(folder, &made.cert.pem(), &made.signing_key)
}

fn written(folder: &Path, certificate: &str, key: &KeyPair) -> Tls {
    std::fs::create_dir_all(folder).unwrap();
    let files = Tls { certificate: folder.join("cert.pem"), key: folder.join("key.pem") };
    std::fs::write(&files.certificate, certificate).unwrap();
    std::fs::write(&files.key, key.serialize_pem()).unwrap();
    files
}

async fn serve(name: &str, tls: impl FnOnce(&Path) -> Tls) -> (Filled, PathBuf) {
    let data = folder(name);
    let tls = tls(&data);
    let file = tls.certificate.clone();
    (Filled::serve_as(data, |options| options.tls = Some(tls)).await, file)
}

/// A client that trusts the certificates in a file only.
fn trusting(file: &Path) -> Client {
    trust::http(trust::tls("https:", Some(&certificates(file))).unwrap()).unwrap()
}

fn certificates(file: &Path) -> Certificates {
    Certificates::read(file).unwrap()
}

/// Why a GET has no answer: the certificate.
async fn untrusted(client: &Client, url: &str) -> String {
    let error = client.get(url).send().await.unwrap_err();
    trust::refused(&error).unwrap_or_else(|| panic!("{error:?}"))
}

/// Opens a WebSocket at a URL of HTTP; its status.
async fn socket(url: &str, file: Option<&Path>, headers: &[(&'static str, &str)]) -> u16 {
    let mut request = url.replacen("http", "ws", 1).into_client_request().unwrap();
    for (name, value) in headers {
        request.headers_mut().insert(*name, value.parse().unwrap());
    }
    let ca = file.map(certificates);
    let tls = Connector::Rustls(Arc::new(trust::tls(url, ca.as_ref()).unwrap()));
    let connecting = connect_async_tls_with_config(request, None, false, Some(tls));
    match timeout(LIMIT, connecting).await.unwrap() {
        Ok((_, answer)) => answer.status().as_u16(),
        Err(tokio_tungstenite::tungstenite::Error::Http(answer)) => answer.status().as_u16(),
        Err(other) => panic!("{other}"),
    }
}

// ---------------------------------------------------------------- TLS

#[tokio::test(flavor = "multi_thread")]
async fn a_service_with_tls_answers_those_who_trust_its_certificate() {
    let (lab, certificate) = serve("tls", self_signed).await;
    let client = trusting(&certificate);
    let status = lab.url("/api/v1/status");
    assert!(status.starts_with("https://127.0.0.1:"), "{status}");
    assert_eq!(client.get(&status).send().await.unwrap().status(), 200);
    // One that trusts no certificate, and one that trusts another certificate.
    let other = Folder::new("tls-other");
    let other = trusting(&self_signed(&other).certificate);
    for wrong in [&http(), &other] {
        let why = untrusted(wrong, &status).await;
        assert!(why.contains("certificate"), "{why}");
    }
    // A page of this service, and a page of another one on this machine.
    let own = lab.url("");
    for (origin, code) in [(own.as_str(), 200), ("https://127.0.0.1:1", 403)] {
        let answer = client.get(&status).header("origin", origin).send().await.unwrap();
        assert_eq!(answer.status(), code, "{origin}");
        let live = lab.url("/api/v1/frames/live");
        let opened = socket(&live, Some(&certificate), &[("origin", origin)]).await;
        assert_eq!(opened, if code == 200 { 101 } else { 403 }, "{origin}");
    }
    // HTTP without TLS has no answer, and the connection ends.
    let mut plain = TcpStream::connect(own.trim_start_matches("https://")).await.unwrap();
    plain.write_all(b"GET /health/live HTTP/1.1\r\nhost: localhost\r\n\r\n").await.unwrap();
    let mut answer = Vec::new();
    timeout(LIMIT, plain.read_to_end(&mut answer)).await.unwrap().unwrap();
    assert!(!answer.starts_with(b"HTTP"), "{}", String::from_utf8_lossy(&answer));
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_authority_vouches_for_the_names_of_its_certificates() {
    let mut params = CertificateParams::new(Vec::new()).unwrap();
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let authority_key = KeyPair::generate().unwrap();
    let authority = params.self_signed(&authority_key).unwrap();
    let files = Folder::new("tls-authority");
    std::fs::write(files.join("ca.pem"), authority.pem()).unwrap();
    let client = trusting(&files.join("ca.pem"));
    let issuer = Issuer::new(params, authority_key);
    for (name, is_trusted) in [("127.0.0.1", true), ("rig.example.org", false)] {
        let signed = |data: &Path| {
            let own = KeyPair::generate().unwrap();
            let params = CertificateParams::new([name.to_owned()]).unwrap();
            written(data, &params.signed_by(&own, &issuer).unwrap().pem(), &own)
        };
        let (lab, _) = serve(&format!("tls-{name}"), signed).await;
        let status = lab.url("/api/v1/status");
        if is_trusted {
            assert_eq!(client.get(&status).send().await.unwrap().status(), 200);
        } else {
            let why = untrusted(&client, &status).await;
            assert!(why.contains("not valid for name"), "{why}");
        }
        lab.close().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_never_completes_the_handshake_does_not_keep_a_stop_out() {
    let (lab, certificate) = serve("tls-stuck", self_signed).await;
    let address = lab.url("").trim_start_matches("https://").to_owned();
    let mut stuck = Vec::new();
    for _ in 0..600 {
        let mut line = TcpStream::connect(&address).await.unwrap();
        // The begin of a record; the door may have closed the connection already.
        let _ = line.write_all(&[0x16, 0x03, 0x01]).await;
        stuck.push(line);
    }
    let stop = trusting(&certificate).post(lab.url("/api/v1/estop")).send();
    let stopped: Value = timeout(LIMIT, stop).await.unwrap().unwrap().json().await.unwrap();
    assert_eq!(stopped["latched"], true);
    // They are closed like clients that never complete the head of a request.
    let end = async {
        for line in &mut stuck {
            while !matches!(line.read(&mut [0; 64]).await, Ok(0) | Err(_)) {}
        }
    };
    timeout(LIMIT, end).await.expect("each of them is closed");
    lab.close().await;
}

/// Runs a command with these variables and no other ones of Palpate.
fn command(arguments: &[&str], variables: &[(&str, &str)]) -> Output {
    support::command(arguments).envs(variables.iter().copied()).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn commands_on_the_same_machine_find_a_service_with_tls() {
    let files = Folder::new("tls-found");
    let Tls { certificate, key } = self_signed(&files);
    std::fs::write(files.join("rig.toml"), rig()).unwrap();
    let data = files.path("data");
    let mut serve = Command::new(PALPATE);
    serve.args(["serve", "--bind", "127.0.0.1:0", "--data", &data, "--rig"]);
    serve.arg(files.join("rig.toml"));
    serve.arg("--tls-cert").arg(&certificate).arg("--tls-key").arg(&key);
    let (_service, url) = served(&mut serve);
    assert!(url.starts_with("https://"), "{url}");
    let found = command(&["status", "--data", &data, "--json"], &[]);
    assert!(found.status.success(), "{}", text(&found.stderr));
    let stopped = command(&["estop", "--data", &data, "--json"], &[]);
    let stopped: Value = serde_json::from_slice(&stopped.stdout).unwrap();
    assert_eq!(stopped["latched"], true);
    // From another machine the certificate must be named.
    let refused =
        text(&command(&["status", "--url", &url, "--ca", &files.path("none")], &[]).stderr);
    assert!(refused.contains(&files.path("none")), "{refused}");
    let other = self_signed(&files.join("other")).certificate.display().to_string();
    let refused = text(&command(&["status", "--url", &url, "--ca", &other], &[]).stderr);
    assert!(refused.contains("is not trusted") && refused.contains("--ca"), "{refused}");
    let own = certificate.display().to_string();
    let variables = [("PALPATE_URL", url.as_str()), ("PALPATE_CA", own.as_str())];
    let named = command(&["status", "--json"], &variables);
    assert!(named.status.success(), "{}", text(&named.stderr));
    // A second service on its port, with the same certificate and without one.
    let (address, elsewhere) = (url.trim_start_matches("https://"), files.path("elsewhere"));
    let key = key.display().to_string();
    let taken = |more: &[&str]| {
        let serve = ["serve", "--desk", "--bind", address, "--data", &elsewhere];
        text(&command(&[&serve[..], more].concat(), &[]).stderr)
    };
    let named = taken(&["--tls-cert", &own, "--tls-key", &key]);
    let holder = format!("in use by the palpate service of {data}/palpate.db ({url})");
    assert!(named.contains(&holder), "{named}");
    let unknown = taken(&[]);
    assert!(unknown.contains("in use by a program"), "{unknown}");
}

// ---------------------------------------------------------------- keys on loopback

#[tokio::test(flavor = "multi_thread")]
async fn keys_may_be_required_on_loopback_but_never_for_a_stop() {
    let lab = Filled::serve(folder("require-key")).await;
    let (_, secret) = lab.key("ada", "operator").await;
    let lab = Filled::serve_keys(lab.end().await).await;
    lab.refuses_get("/api/v1/status", 401, "--require-key").await;
    let asked = lab.http.get(lab.url("/api/v1/status")).bearer_auth(&secret).send();
    assert_eq!(asked.await.unwrap().status(), 200);
    let (status, stopped) = lab.post("/api/v1/estop", Value::Null).await;
    assert_eq!((status, &stopped["latched"]), (200, &json!(true)), "{stopped}");
    // A command reads the key from a file, and warns if others can.
    let file = lab.data.join("key");
    std::fs::write(&file, format!("{secret}\n")).unwrap();
    let (file, url) = (file.display().to_string(), lab.url(""));
    let asked = tokio::task::spawn_blocking(move || {
        command(&["status", "--url", &url, "--json"], &[("PALPATE_KEY_FILE", &file)])
    });
    let asked = asked.await.unwrap();
    let warned = text(&asked.stderr);
    assert!(asked.status.success() && warned.contains("chmod 600"), "{warned}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_comes_through_a_proxy_is_nobody_on_this_machine() {
    let lab = Filled::serve(folder("forwarded")).await;
    let (_, secret) = lab.key("ada", "operator").await;
    let (status, live) = (lab.url("/api/v1/status"), lab.url("/api/v1/frames/live"));
    for header in ["x-forwarded-for", "forwarded"] {
        let asked = lab.http.get(&status).header(header, "for=10.0.0.7");
        support::is_refused(support::answered(asked).await, 401, "proxy");
        let with_key = lab.http.get(&status).header(header, "for=10.0.0.7").bearer_auth(&secret);
        let with_key = with_key.header("host", "rig.example.org");
        assert_eq!(with_key.send().await.unwrap().status(), 200);
        let opened = socket(&live, None, &[(header, "for=10.0.0.7")]).await;
        assert_eq!(opened, 401);
        let stop = || lab.http.post(lab.url("/api/v1/estop")).header(header, "for=10.0.0.7");
        assert_eq!(stop().send().await.unwrap().status(), 401);
        assert_eq!(stop().bearer_auth(&secret).send().await.unwrap().status(), 200);
    }
    // A name that an attacker's DNS points to this machine.
    let rebound = lab.http.get(&status).header("host", "rig.example.org").send().await.unwrap();
    assert_eq!(rebound.status(), 403);
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_on_this_machine_needs_no_key_wherever_the_service_listens() {
    let lab = Filled::serve(folder("everywhere")).await;
    lab.key("ada", "operator").await;
    let data = lab.end().await;
    let lab = Filled::serve_as(data, |options| options.bind = "0.0.0.0:0".parse().unwrap()).await;
    let port = lab.url("").rsplit(':').next().unwrap().to_owned();
    let here = format!("http://127.0.0.1:{port}");
    let status = lab.http.get(format!("{here}/api/v1/status")).send().await.unwrap();
    assert_eq!(status.status(), 401);
    let stop = |host: &'static str| {
        lab.http.post(format!("{here}/api/v1/estop")).header("host", host).send()
    };
    assert_eq!(stop("rig.example.org").await.unwrap().status(), 403, "a name of somebody else");
    let page =
        lab.http.post(format!("{here}/api/v1/estop")).header("origin", "http://evil.example");
    assert_eq!(page.send().await.unwrap().status(), 403, "a page of another site");
    assert_eq!(stop("localhost").await.unwrap().status(), 200);
    // The command needs neither a key nor one that is valid or can be read.
    for (variable, value) in
        [("PALPATE_KEY", "palpate_00"), ("PALPATE_KEY_FILE", "/nonexistent"), ("PALPATE_KEY", "")]
    {
        let here = here.clone();
        let stopped = tokio::task::spawn_blocking(move || {
            command(&["estop", "--url", &here, "--json"], &[(variable, value)])
        });
        let stopped = stopped.await.unwrap();
        assert!(stopped.status.success(), "{variable}={value}: {}", text(&stopped.stderr));
    }
    lab.close().await;
}

// ---------------------------------------------------------------- a proxy

/// The program `nginx`, or `None`, as for other tools.
fn nginx() -> Option<&'static str> {
    let names = ["nginx", "/usr/sbin/nginx"];
    let runs = |name: &&str| Command::new(name).arg("-v").stderr(Stdio::null()).status().is_ok();
    names.into_iter().find(runs).or_else(|| support::left_out("no nginx"))
}

/// The manual's block, at a free port, in front of a service.
fn behind(name: &str, files: &Folder, service: &str, tls: &Tls) -> (Process, String) {
    let block =
        MANUAL.split("```nginx\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mut block = block.to_owned();
    for (from, to) in [
        ("listen 443 ssl", format!("listen 127.0.0.1:{port} ssl")),
        ("listen [::]:443 ssl;", String::new()),
        ("/etc/ssl/rig.example.org.pem", tls.certificate.display().to_string()),
        ("/etc/ssl/private/rig.example.org.key", tls.key.display().to_string()),
        ("http://127.0.0.1:8080", service.to_owned()),
    ] {
        assert!(block.contains(from), "the page has no {from}");
        block = block.replace(from, &to);
    }
    let kinds = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"];
    let folders: String = kinds.map(|kind| format!("{kind}_temp_path {kind};\n")).concat();
    let whole = format!(
        "daemon off;\nmaster_process off;\npid pid;\nerror_log stderr;\nevents {{}}\nhttp {{\n\
         access_log off;\n{folders}{block}}}\n"
    );
    std::fs::write(files.join("nginx.conf"), whole).unwrap();
    let config = files.path("nginx.conf");
    let process = Command::new(name).args(["-p", &files.path(""), "-c", &config]).spawn().unwrap();
    (Process(process), format!("https://127.0.0.1:{port}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn the_manuals_nginx_passes_everything_on() {
    let Some(program) = nginx() else { return };
    let lab = Filled::open("proxied").await;
    let (_, admin) = lab.key("ada", "admin").await;
    let files = Folder::new("nginx");
    let tls = self_signed(&files);
    let (_process, url) = behind(program, &files, &lab.url(""), &tls);
    let client = trusting(&tls.certificate);
    let status = format!("{url}/api/v1/status");
    let start = Instant::now();
    let refused = loop {
        match client.get(&status).send().await {
            Ok(answer) => break answer,
            Err(error) => assert!(start.elapsed() < LIMIT, "nginx does not answer: {error:?}"),
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    assert_eq!(refused.status(), 401, "nobody is local behind a proxy");
    let words: Value = refused.json().await.unwrap();
    assert!(words["detail"].as_str().unwrap().contains("proxy"), "{words}");
    // As a page of the proxy's origin asks.
    let own = |request: reqwest::RequestBuilder| {
        request.bearer_auth(&admin).header("origin", &url).header("sec-fetch-site", "same-origin")
    };
    assert_eq!(own(client.get(&status)).send().await.unwrap().status(), 200);
    // A body; then a large one, and a long address.
    let made = client.post(format!("{url}/api/v1/keys"));
    let made = own(made).json(&json!({ "name": "eve", "role": "viewer" })).send().await.unwrap();
    assert_eq!(made.status(), 201);
    let large = own(client.post(format!("{url}/api/v1/infer"))).body(vec![b' '; 8 << 20]);
    let large = large.header("content-type", "application/json").send().await.unwrap();
    assert_eq!(large.status(), StatusCode::BAD_REQUEST, "{:?}", large.text().await);
    let long = format!("{status}?{}", "x".repeat(20 << 10));
    assert_eq!(own(client.get(&long)).send().await.unwrap().status(), 200);
    // An event arrives while its stream continues.
    let events = own(client.get(format!("{url}/api/v1/events?since=-3")));
    let events = events.header("accept", "text/event-stream").send().await.unwrap();
    let mut events = events.bytes_stream();
    let first = timeout(LIMIT, events.next()).await.expect("an event, at once").unwrap().unwrap();
    assert!(!first.is_empty());
    let bearer = format!("Bearer {admin}");
    let headers = [("authorization", bearer.as_str()), ("origin", url.as_str())];
    let opened =
        socket(&format!("{url}/api/v1/frames/live"), Some(&tls.certificate), &headers).await;
    assert_eq!(opened, 101);
    let stop = own(client.post(format!("{url}/api/v1/estop"))).send().await.unwrap();
    let stopped: Value = stop.json().await.unwrap();
    assert_eq!(stopped["latched"], true);
    drop(events);
    lab.close().await;
}
