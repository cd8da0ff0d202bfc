//! Trainings as processes: killed ones fail by their signal and resume when requested again, as those do that Ctrl-C
//! stopped, and none outlives its service.

use std::process::{Command, Stdio};
use std::time::Duration;

use rustix::process::Signal;
use serde_json::{Value, json};

use super::filled::{Filled, fill, folder, rig};
use super::models::transfer_net;
use crate::support::{PALPATE, Process, command, eventually, http, served, signal};

/// Longest wait for anything; the trainer may have to be built first.
const LIMIT: Duration = Duration::from_secs(120);
/// Longest time from the end of a service to that of its trainer, which ends after one batch.
const ORPHAN_MAX: Duration = Duration::from_secs(10);

/// What a service has for `palpate-worker` alone.
const SECRETS: [&str; 3] = ["PALPATE_QUEUE", "PALPATE_STORE_FILE", "AWS_SECRET_ACCESS_KEY"];

/// The process that trains for a job, by its arguments.
fn trainer(job: &str) -> Option<i32> {
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let mut ids = processes.filter_map(|p| p.file_name().to_str()?.parse().ok());
    ids.find(|id: &i32| {
        let line = std::fs::read(format!("/proc/{id}/cmdline")).unwrap_or_default();
        let line = String::from_utf8_lossy(&line).into_owned();
        line.contains("palpate-trainer\0") && line.contains(job)
    })
}

fn environment(process: i32) -> String {
    let variables = std::fs::read(format!("/proc/{process}/environ")).unwrap();
    String::from_utf8_lossy(&variables).into_owned()
}

fn kill(process: i32) {
    let status = Command::new("kill").args(["-9", &process.to_string()]).status().unwrap();
    assert!(status.success());
}

/// Nice value of a process: field 19 of its status.
fn nice(process: i32) -> i32 {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap();
    let after_name = stat.rsplit(')').next().unwrap();
    after_name.split_whitespace().nth(16).unwrap().parse().unwrap()
}

impl Filled {
    async fn asked(&self, recipe: &str) -> String {
        let job = self.posted("/api/v1/trainings", json!({ "recipe": recipe }), 202).await;
        job["id"].as_str().unwrap().to_owned()
    }

    /// Waits for a training after this one; returns its id.
    async fn newer(&self, than: &str) -> String {
        let look = async || {
            // The newest is the first.
            let jobs = self.get("/api/v1/jobs").await;
            let id = jobs["items"][0]["id"].as_str().filter(|&id| id != than);
            id.map(str::to_owned)
        };
        eventually("a newer training", LIMIT, look).await
    }

    /// The first line of a training's losses.
    async fn first_loss(&self, id: &str) -> Value {
        let answer = self.answer(&format!("/api/v1/jobs/{id}/losses")).await;
        let text = answer.text().await.unwrap();
        serde_json::from_str(text.lines().next().unwrap()).unwrap()
    }

    /// Waits until a job learns in an epoch from `epoch` on; returns the epoch.
    async fn learns(&self, id: &str, epoch: u64) -> u64 {
        let path = format!("/api/v1/jobs/{id}");
        let look = async || {
            let job = self.get(&path).await;
            assert!(["waiting", "running"].contains(&job["state"].as_str().unwrap()), "{job}");
            job["progress"]["epoch"].as_u64().filter(|&now| now >= epoch)
        };
        eventually("the job learns", LIMIT, look).await
    }
}

#[tokio::test]
async fn the_same_request_resumes_from_the_checkpoint_of_a_killed_or_a_stopped_training() {
    let lab = Filled::open("training-killed").await;
    let recipe = transfer_net("endless", 1_000_000);
    let first = lab.asked(&recipe).await;
    lab.learns(&first, 30).await;
    // The end of the service makes the trainer write a checkpoint.
    let lab = Filled::serve(lab.end().await).await;
    let resumed = lab.learns(&first, 1).await;
    assert!(resumed >= 30, "{resumed}");
    let process = trainer(&first).unwrap();
    assert_eq!(nice(process), 10);
    kill(process);
    let over = async || {
        let job = lab.get(&format!("/api/v1/jobs/{first}")).await;
        (job["state"] != "running").then_some(job)
    };
    let job = eventually("the job ends", LIMIT, over).await;
    assert_eq!(job["state"], "failed", "{job}");
    let words = job["error"].as_str().unwrap();
    let killed = "the trainer was killed by signal 9, probably out of memory";
    assert!(words.starts_with(killed), "{words}");
    // Another request does not resume from a checkpoint that is not its own.
    let kept = lab.data.join("jobs").join(&first).join("checkpoint.bin");
    let other = lab.asked(&recipe.replace("seed = 1", "seed = 2")).await;
    lab.learns(&other, 2).await;
    assert!(kept.exists());
    let others = lab.first_loss(&other).await;
    lab.post(&format!("/api/v1/jobs/{other}/stop"), Value::Null).await;
    let second = lab.asked(&recipe).await;
    let again = lab.learns(&second, 1).await;
    assert!(again >= 30 && !kept.exists(), "{again} after {resumed}");
    let own = lab.first_loss(&second).await;
    assert_eq!([&own["epoch"], &others["epoch"]], [1, 1]);
    assert_ne!(own["train_loss"], others["train_loss"]);
    lab.post(&format!("/api/v1/jobs/{second}/stop"), Value::Null).await;
    // The trainer writes a checkpoint before it ends.
    let third = lab.asked(&recipe).await;
    let once_more = lab.learns(&third, 1).await;
    assert!(once_more >= 30, "{once_more} after {again}");
    lab.post(&format!("/api/v1/jobs/{third}/stop"), Value::Null).await;
    let gone = async || trainer(&third).is_none().then_some(());
    eventually("the trainer ends", LIMIT, gone).await;
    lab.close().await;
}

/// Presses Ctrl-C at a `palpate train` without a terminal; returns what it printed.
async fn interrupted(mut train: Process) -> String {
    signal(&train.0, Signal::INT);
    let printed = train.0.stderr.take().unwrap();
    let printed = tokio::task::spawn_blocking(move || std::io::read_to_string(printed));
    let words = printed.await.unwrap().unwrap();
    assert_eq!(train.0.wait().unwrap().code(), Some(1), "{words}");
    words
}

#[tokio::test]
async fn ctrl_c_at_train_stops_it_at_a_checkpoint_from_which_the_same_command_resumes() {
    let lab = Filled::open("training-left").await;
    let recipe = lab.data.join("endless.toml");
    std::fs::write(&recipe, transfer_net("endless", 1_000_000)).unwrap();
    let (recipe, url) = (recipe.display().to_string(), lab.url(""));
    let train = || {
        let mut train = command(&["train", &recipe, "--url", &url]);
        Process(train.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap())
    };
    let left = train();
    let first = lab.newer("").await;
    lab.learns(&first, 30).await;
    let words = interrupted(left).await;
    assert!(words.contains("stopping at a checkpoint"), "{words}");
    assert!(words.contains("the same command resumes it from its checkpoint"), "{words}");
    assert_eq!(lab.get(&format!("/api/v1/jobs/{first}")).await["state"], "stopped");

    let again = train();
    let second = lab.newer(&first).await;
    let resumed = lab.learns(&second, 1).await;
    assert!(resumed >= 30, "{resumed}");
    interrupted(again).await;
    lab.close().await;
}

#[tokio::test]
async fn a_killed_service_leaves_a_checkpoint_and_no_trainer() {
    let data = folder("training-orphan");
    fill(&data).await;
    let rig_file = data.join("rig.toml");
    std::fs::write(&rig_file, rig()).unwrap();
    let mut serve = Command::new(PALPATE);
    serve.args(["serve", "--bind", "127.0.0.1:0", "--data"]).arg(&data);
    serve.arg("--rig").arg(&rig_file);
    for name in SECRETS {
        serve.env(name, "hush");
    }
    let (mut service, url) = served(&mut serve);
    let recipe = transfer_net("orphan", 1_000_000);
    let asked = http().post(format!("{url}/api/v1/trainings")).json(&json!({ "recipe": recipe }));
    let job: Value = asked.send().await.unwrap().json().await.unwrap();
    let id = job["id"].as_str().unwrap().to_owned();
    let learns = async || {
        let answer = http().get(format!("{url}/api/v1/jobs/{id}")).send().await.unwrap();
        let job: Value = answer.json().await.unwrap();
        job["progress"]["epoch"].as_u64().filter(|&epoch| epoch >= 3)
    };
    eventually("the job learns", LIMIT, learns).await;
    let environment = environment(trainer(&id).unwrap());
    for name in SECRETS {
        assert!(!environment.contains(name), "{name}");
    }
    assert!(environment.contains("PATH="));
    let checkpoint = data.join("jobs").join(&id).join("checkpoint.bin");
    assert!(!checkpoint.exists());
    service.0.kill().unwrap();
    service.0.wait().unwrap();
    let gone = async || trainer(&id).is_none().then_some(());
    eventually("the trainer ends", ORPHAN_MAX, gone).await;
    assert!(checkpoint.exists());
    std::fs::remove_dir_all(data).ok();
}
