//! Contacts of a connected rig's frames, live, while what serves is changed under them.

use std::time::Duration;

use futures::StreamExt;
use serde_json::{Value, json};
use tokio::sync::oneshot;
use tokio::time::sleep;
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;

use super::bench::{COMPUTES, Lab, SENSOR, http, is_refused, rig_args};

/// As fast as the wall: the readout sends thirty frames a second.
const SPEED: f64 = 1.0;
/// How long answers are followed after the last change.
const FOLLOWED: Duration = Duration::from_secs(1);
/// Most frames from one answer to the next, half a second of them: the machine may have other work.
const STEP_MAX: u64 = 15;
const CHANNELS: usize = 784;
const INFER: &str = "/api/v1/infer";
const SERVING: &str = "/api/v1/serving";
const ROLL_BACK: &str = "/api/v1/serving/roll-back";

/// Asks for a net as small as it can be: how good it is is no matter here. Returns the job's id.
async fn queue(lab: &Lab, name: &str, seed: u64) -> String {
    let recipe = format!(
        "name = '{name}'\nrows = 640\n[training]\nseed = {seed}\nepochs = 1\nbatch = 64\n\
         [training.net]\nkind = 'point-net'\nhidden = 1\nwidth = 64\n\
         [training.noise]\nwhite_v = 1.2e-3\n"
    );
    let job = lab.posted("/api/v1/trainings", json!({ "recipe": recipe })).await;
    job["id"].as_str().unwrap().to_owned()
}

/// Waits for a training's end; returns the model's id.
async fn trained(lab: &Lab, job: &str) -> String {
    let over = |job: &Value| !matches!(job["state"].as_str(), Some("waiting" | "running"));
    let job = lab.eventually("a training's end", &format!("/api/v1/jobs/{job}"), over).await;
    assert_eq!(job["state"], "done", "{job:#}");
    job["result"]["model"].as_str().unwrap().to_owned()
}

/// Trains a net as small as it can be, with the name `small`, and does not promote it.
pub async fn small_net(lab: &Lab) {
    let job = queue(lab, "small", 1).await;
    trained(lab, &job).await;
}

/// What `fast` answers live, while something else is done.
async fn followed(lab: &Lab, meanwhile: impl Future<Output = ()>) -> Vec<Value> {
    let url = lab.service.url().replacen("http", "ws", 1);
    let (mut socket, _) = connect_async(format!("{url}/api/v1/live?method=fast")).await.unwrap();
    let (following, ended) = oneshot::channel::<()>();
    let answering = async {
        let mut answers = Vec::<Value>::new();
        tokio::pin!(ended);
        loop {
            let message = tokio::select! {
                message = socket.next() => message.expect("the service continues").unwrap(),
                _ = &mut ended => return answers,
            };
            if let Message::Text(text) = message {
                answers.push(serde_json::from_str(&text).unwrap());
            }
        }
    };
    let changing = async {
        meanwhile.await;
        sleep(FOLLOWED).await;
        drop(following);
    };
    tokio::join!(answering, changing).0
}

/// Each is an answer of `fast`, to a later frame than the one before, and not to a much later one.
fn answered_in_order(answers: &[Value]) {
    for answer in answers {
        assert!(answer["error"].is_null(), "{answer:#}");
        assert_eq!(answer["method"], "fast", "{answer:#}");
        assert!(answer["outside"].is_null(), "an untouched skin was trained on: {answer:#}");
    }
    let sequences: Vec<u64> = answers.iter().map(|a| a["sequence"].as_u64().unwrap()).collect();
    for pair in sequences.windows(2) {
        assert!(pair[0] < pair[1] && pair[1] - pair[0] <= STEP_MAX, "{pair:?} of {sequences:?}");
    }
}

/// A request for the answer to a frame of `channels` zeros, except for the first voltage.
fn infer_request(channels: usize, first_v: Value) -> Value {
    let mut frame = vec![json!(0.0); channels];
    frame[0] = first_v;
    json!({ "method": "fast", "frames": [frame] })
}

/// A request that cannot be met is refused with its fault, and what serves does not change.
async fn what_cannot_be_changes_nothing(lab: &Lab) {
    let before = lab.get(SERVING).await;
    for (path, body, status, words) in [
        (INFER, infer_request(CHANNELS - 1, json!(0.0)), 422, "frames[0] = 783"),
        (INFER, infer_request(CHANNELS, Value::Null), 422, "null"),
        (SERVING, json!({ "what": "nobody" }), 404, "nobody"),
        (ROLL_BACK, json!({ "slot": "nowhere" }), 422, "nowhere"),
    ] {
        is_refused(lab.post(path, body).await, status, words);
    }
    // JSON has no NaN; bytes have.
    let bytes: Vec<u8> = [f32::NAN; CHANNELS].iter().flat_map(|v| v.to_le_bytes()).collect();
    let raw = http()
        .post(format!("{}{INFER}?method=fast", lab.service.url()))
        .header("content-type", "application/octet-stream")
        .body(bytes);
    let problem: Value = raw.send().await.unwrap().json().await.unwrap();
    assert_eq!(problem["status"], 422, "{problem}");
    assert_eq!(problem["errors"][0]["key"], "frames[0][0]", "{problem}");
    assert_eq!(lab.get(SERVING).await, before);
}

/// Imports a few frames of the rig's sensor, and makes a dataset `few` of them.
async fn few_trials(lab: &Lab) {
    let voltages: Vec<String> = (0..CHANNELS).map(|channel| format!("v{channel}")).collect();
    let mut table = format!("{},x_mm,y_mm,force_n\n", voltages.join(","));
    for trial in 0..20 {
        let force_n = 5.0 + trial as f64;
        let volts = |channel: usize| 1e-3 * force_n * (0.1 * (channel * trial) as f64).cos();
        let volts: Vec<String> = (0..CHANNELS).map(|c| format!("{:.6}", volts(c))).collect();
        table += &format!("{},{},250,{force_n}\n", volts.join(","), 100 + 10 * trial);
    }
    let part = |text: &str, name: &'static str| {
        reqwest::multipart::Part::text(text.to_owned()).file_name(name)
    };
    let form = reqwest::multipart::Form::new()
        .part("file", part(&table, "few.csv"))
        .part("sensor", part(SENSOR, "ert-28.toml"))
        .text("name", "few-trials")
        .text("label", "virtual");
    let url = format!("{}/api/v1/imports", lab.service.url());
    let made = http().post(url).multipart(form).send().await.unwrap();
    assert_eq!(made.status(), 201, "{}", made.text().await.unwrap());
    let definition = json!({ "name": "few", "task": "real", "runs": ["few-trials"],
        "split": { "by": "trial" } });
    lab.posted("/api/v1/datasets", json!({ "definition": definition })).await;
}

/// Trains and promotes a net of the force and one of the position; returns their ids.
pub async fn quantity_nets(lab: &Lab) -> Vec<String> {
    few_trials(lab).await;
    let mut ids = Vec::new();
    for quantity in ["force", "position"] {
        let recipe = format!(
            "name = 'few-{quantity}'\ndataset = 'few'\n[training]\nseed = 1\n[training.net]\n\
             kind = 'ridge'\nanswers = '{quantity}'\n"
        );
        let job = lab.posted("/api/v1/trainings", json!({ "recipe": recipe })).await;
        ids.push(trained(lab, job["id"].as_str().unwrap()).await);
        let promoted = lab.posted(SERVING, json!({ "what": ids.last() })).await;
        assert_eq!(promoted["slot"], quantity, "{promoted}");
    }
    ids
}

/// Two nets of quantities answer the stream together; without them it is refused.
async fn quantities_are_followed(lab: &Lab) {
    let ids = quantity_nets(lab).await;
    let url = lab.service.url().replacen("http", "ws", 1) + "/api/v1/live/quantities";
    let (mut socket, _) = connect_async(&url).await.unwrap();
    let mut answers = Vec::<Value>::new();
    while answers.len() < 3 {
        if let Message::Text(text) = socket.next().await.expect("the service continues").unwrap() {
            answers.push(serde_json::from_str(&text).unwrap());
        }
    }
    for answer in &answers {
        assert!(answer["force_n"].is_number(), "{answer}");
        assert_eq!(answer["position_mm"].as_array().map(Vec::len), Some(2), "{answer}");
        assert_eq!(answer["model"], ids.join("+"), "{answer}");
        assert!(answer.get("contacts").is_none() && answer.get("count").is_none(), "{answer}");
    }
    for slot in ["force", "position"] {
        let back = lab.posted(ROLL_BACK, json!({ "slot": slot })).await;
        assert!(back["what"].is_null(), "{back}");
    }
    assert!(connect_async(&url).await.is_err(), "no net of a quantity serves");
}

/// Frames are recorded from the request on, with their label, in the formats of rows.
async fn frames_are_recorded(lab: &Lab) {
    let record = async |frames: usize, format: &str| {
        let query = format!("frames={frames}&format={format}");
        let url = format!("{}/api/v1/frames/recording?{query}", lab.service.url());
        http().get(url).send().await.unwrap()
    };
    let answer = record(40, "csv").await;
    assert_eq!(answer.status(), 200);
    let name = answer.headers()["content-disposition"].to_str().unwrap().to_owned();
    assert!(name.contains("frames-virtual-") && name.ends_with(".csv\""), "{name}");
    let text = answer.text().await.unwrap();
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 41);
    assert_eq!(rows[0][..4], ["at", "label", "sequence", "device_time_us"]);
    assert!(rows.iter().all(|row| row.len() == 4 + CHANNELS));
    assert!(rows[1..].iter().all(|row| row[1] == "virtual"));
    let sequences: Vec<u64> = rows[1..].iter().map(|row| row[2].parse().unwrap()).collect();
    assert!(sequences.windows(2).all(|pair| pair[0] < pair[1]), "{sequences:?}");
    let parquet = record(5, "parquet").await.bytes().await.unwrap();
    assert!(parquet.starts_with(b"PAR1") && parquet.ends_with(b"PAR1"), "{} bytes", parquet.len());
    for (frames, format) in [(0, "csv"), (9001, "csv"), (5, "npz"), (5, "xlsx")] {
        assert_eq!(record(frames, format).await.status(), 400, "{frames} {format}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn models_change_between_two_live_frames_and_what_is_refused_changes_none() {
    let lab = Lab::open("live", rig_args("virtual", SPEED), COMPUTES).await;
    let url = format!("{}/api/v1/frames/recording?frames=5", lab.service.url());
    assert_eq!(http().get(url).send().await.unwrap().status(), 409, "no frames come");
    lab.operate(json!({ "action": "connect", "who": "test" })).await;
    let jobs = [queue(&lab, "one", 1).await, queue(&lab, "two", 2).await];
    let (one, two) = (trained(&lab, &jobs[0]).await, trained(&lab, &jobs[1]).await);
    assert_ne!(one, two);
    lab.posted(SERVING, json!({ "what": "one" })).await;
    let changes = async {
        sleep(Duration::from_secs(1)).await;
        let second = lab.posted(SERVING, json!({ "what": "two" })).await;
        assert_eq!(second["restores"], one, "{second}");
        sleep(Duration::from_millis(1500)).await;
        let back = lab.posted(ROLL_BACK, json!({ "slot": "points" })).await;
        assert_eq!(back["what"], one);
    };
    let answers = followed(&lab, changes).await;
    answered_in_order(&answers);
    let mut models: Vec<&str> = answers.iter().map(|a| a["model"].as_str().unwrap()).collect();
    models.dedup();
    assert_eq!(models, [&one, &two, &one]);

    what_cannot_be_changes_nothing(&lab).await;
    let serving = lab.get(SERVING).await;
    assert_eq!(serving["serves"][2], json!({ "slot": "points", "what": one }));
    let answers = lab.posted(INFER, infer_request(CHANNELS, json!(0.0))).await;
    assert_eq!(answers.as_array().unwrap().len(), 1, "{answers}");
    assert_eq!(answers[0]["model"], one, "{answers}");
    quantities_are_followed(&lab).await;
    frames_are_recorded(&lab).await;
    lab.close().await;
}
