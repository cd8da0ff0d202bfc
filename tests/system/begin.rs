//! `palpate run` that is left as it begins: what it has requested to start is taken back, and its homing ends, as that
//! of `palpate rig home` does. It states the status that it has read (`Status-At`) with a start, and none with a stop.
//! A homing that another person aborts ends the command.
//! Uses: the program, at a wire that can keep the answer to a start. Never: a mock of the service.

use std::io::Read;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use parking_lot::Mutex;
use rustix::process::Signal;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

use super::bench::{Lab, ONE_TIP, Process, WAITS, rig_args, signal};
use super::campaign::SPEED;

/// A wire to a service: what was requested on it, and its URL. A connection on which a start is requested gets no answer
/// from then on.
async fn wire(service: &str) -> (String, Arc<Mutex<String>>) {
    let door = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", door.local_addr().unwrap());
    let service = service.strip_prefix("http://").unwrap().to_owned();
    let requested = Arc::new(Mutex::new(String::new()));
    let heard = requested.clone();
    tokio::spawn(async move {
        while let Ok((client, _)) = door.accept().await {
            let service = TcpStream::connect(&service).await.unwrap();
            tokio::spawn(carry(client, service, heard.clone()));
        }
    });
    (url, requested)
}

async fn carry(client: TcpStream, service: TcpStream, requested: Arc<Mutex<String>>) {
    let (mut from_client, mut to_client) = client.into_split();
    let (mut from_service, mut to_service) = service.into_split();
    let is_kept = AtomicBool::new(false);
    let requests = async {
        let mut piece = vec![0; 1 << 16];
        while let Ok(n @ 1..) = from_client.read(&mut piece).await {
            let words = String::from_utf8_lossy(&piece[..n]).into_owned();
            if words.contains(r#""action":"start""#) {
                is_kept.store(true, Ordering::SeqCst);
            }
            requested.lock().push_str(&words);
            if to_service.write_all(&piece[..n]).await.is_err() {
                break;
            }
        }
        // The client is gone: so is its connection.
        let _ = to_service.shutdown().await;
    };
    let answers = async {
        let mut piece = vec![0; 1 << 16];
        while let Ok(n @ 1..) = from_service.read(&mut piece).await {
            let kept = is_kept.load(Ordering::SeqCst);
            if !kept && to_client.write_all(&piece[..n]).await.is_err() {
                break;
            }
        }
    };
    tokio::join!(requests, answers);
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_as_a_stopped_run_resumes_stops_it_again() {
    let lab = Lab::homed("left-as-it-began", 20.0, WAITS).await;
    let run = lab.begin(ONE_TIP).await;
    lab.stored(1).await;
    lab.accepts(&run, json!({ "action": "stop" })).await;
    lab.ended(&run).await;
    let is_free = |s: &Value| s["run"].is_null() && s["rig"]["state"] == "homed";
    lab.until("the end of the run", is_free).await;

    std::fs::write(lab.data.join("e.toml"), ONE_TIP).unwrap();
    let (url, requested) = wire(&lab.service.url()).await;
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    command.args(["run", "e.toml", "--json", "--url", &url]).current_dir(&lab.data);
    command.env("PALPATE_LOG", "warn").stdin(Stdio::null()).stdout(Stdio::null());
    let mut resumes = Process(command.spawn().unwrap());
    let row = format!("/api/v1/runs/{run}");
    lab.eventually("the run again", &row, |row| row["state"] == "running").await;
    signal(&resumes.0, Signal::INT);
    let ended = tokio::task::block_in_place(|| resumes.0.wait()).unwrap();
    assert_eq!(ended.code(), Some(1));
    lab.eventually("its end", &row, |row| row["state"] == "ended").await;
    assert_eq!(lab.get(&row).await["exit_status"], "stopped");

    let requested = requested.lock().to_lowercase();
    let states = |action: &str| {
        let of = |request: &&str| request.contains(&format!(r#""action":"{action}""#));
        let request = requested.split("post /api/").find(of).expect(action);
        request.contains("status-at: ")
    };
    assert!(states("start") && !states("stop"), "{requested}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_as_the_rig_homes_ends_the_homing() {
    let lab = Lab::open("left-as-it-homed", rig_args("virtual", SPEED), WAITS).await;
    left_as_it_homes(&lab, &["run", "e.toml"]).await;
    assert_eq!(lab.get("/api/v1/queue").await["items"], json!([]), "nothing is queued for it");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_at_a_manual_homing_ends_it() {
    let lab = Lab::open("left-manual-homing", rig_args("virtual", SPEED), WAITS).await;
    lab.operate(json!({ "action": "connect", "who": "test" })).await;
    left_as_it_homes(&lab, &["rig", "home"]).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_homing_that_another_person_aborts_is_over_for_its_command_which_names_them() {
    let lab = Lab::open("aborted-homing", rig_args("virtual", SPEED), WAITS).await;
    lab.operate(json!({ "action": "connect", "who": "test" })).await;
    let mut homes = homes(&lab, &["rig", "home"]).await;
    let abort = json!({ "who": "Ada", "why": "a cable is caught" });
    lab.posted("/api/v1/rig/abort", abort).await;
    let (mut stderr, mut words) = (homes.0.stderr.take().unwrap(), String::new());
    tokio::task::block_in_place(|| stderr.read_to_string(&mut words)).unwrap();
    assert_eq!(homes.0.wait().unwrap().code(), Some(1), "{words}");
    for part in ["homing: the motion was ended early", "Ada", "aborted it (a cable is caught)"] {
        assert!(words.contains(part), "{part}: {words}");
    }
    lab.close().await;
}

/// A command for which the rig homes is left meanwhile: the homing ends.
async fn left_as_it_homes(lab: &Lab, command_args: &[&str]) {
    let mut homes = homes(lab, command_args).await;
    signal(&homes.0, Signal::INT);
    let ended = tokio::task::block_in_place(|| homes.0.wait()).unwrap();
    assert_eq!(ended.code(), Some(1));
    lab.ends_safely().await;
}

/// Starts a command for which the rig homes, until its request is accepted.
async fn homes(lab: &Lab, command_args: &[&str]) -> Process {
    lab.stick_x().await;
    std::fs::write(lab.data.join("e.toml"), ONE_TIP).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    command.args(command_args).args(["--json", "--url", &lab.service.url()]);
    command.current_dir(&lab.data);
    command.env("PALPATE_LOG", "warn").stdin(Stdio::null()).stdout(Stdio::null());
    let homes = Process(command.stderr(Stdio::piped()).spawn().unwrap());
    // The request to home is logged once it is accepted.
    let is_accepted = |page: &Value| {
        let actions = page["items"].as_array().unwrap();
        actions.iter().any(|act| act["action"] == "home" && act["accepted"] == true)
    };
    lab.eventually("a homing", "/api/v1/actions", is_accepted).await;
    homes
}
