//! Models of a service: trained on its datasets, scored, promoted, asked; refused where they do not
//! fit. The nets are as small as they can be: how good they are is no matter here.

use std::time::Duration;

use jiff::Timestamp;
use serde_json::{Value, json};

use super::filled::Filled;
use super::imports::{PAD, frames, import, lists, parquet};
use crate::support::{SENSOR, answered, is_refused};

/// Longest wait for a job.
const LIMIT: Duration = Duration::from_secs(120);

pub fn transfer_net(name: &str, epochs: u32) -> String {
    format!(
        "name = \"{name}\"\ndataset = \"r2s-transfer\"\n[training]\nseed = 1\nepochs = {epochs}\n\
         batch = 32\n[training.net]\nkind = \"transfer-net\"\nform = \"residual\"\nhidden = 1\n\
         width = 8\n"
    )
}

const RECON_NET: &str = "name = \"maps\"\ndataset = \"real\"\nmap = \"20x60\"\n[training]\nseed = 1\n\
    epochs = 1\nbatch = 32\n[training.net]\nkind = \"end-to-end\"\nside = 32\nchannels = [4, 2]\n\
    input = \"unit\"\n";

fn path_of(job: &Value) -> String {
    format!("/api/v1/jobs/{}", job["id"].as_str().unwrap())
}

impl Filled {
    async fn job(&self, job: &Value) -> Value {
        let is_over = |row: &Value| row["state"] != "waiting" && row["state"] != "running";
        self.until(&path_of(job), LIMIT, is_over).await
    }

    /// The result of the job that a POST requests.
    async fn result(&self, path: &str, request: Value) -> Value {
        let job = self.posted(path, request, 202).await;
        let done = self.job(&job).await;
        assert_eq!(done["state"], "done", "{done}");
        done["result"].clone()
    }

    /// A POST requests a job that fails with these words.
    async fn fails(&self, path: &str, request: Value, words: &str) {
        let job = self.posted(path, request, 202).await;
        let failed = self.job(&job).await;
        assert_eq!(failed["state"], "failed", "{failed}");
        assert!(failed["error"].as_str().unwrap().contains(words), "{words}: {failed}");
    }

    /// The id of the model that a recipe produces.
    async fn trained(&self, recipe: &str) -> String {
        let result = self.result("/api/v1/trainings", json!({ "recipe": recipe })).await;
        result["model"].as_str().unwrap().to_owned()
    }

    async fn scored(&self, request: Value) -> Value {
        self.result("/api/v1/evaluations", request).await
    }

    /// Asks for the answers to frames as bytes.
    async fn infers(&self, query: &str, bytes: Vec<u8>) -> (u16, Value) {
        let request = self.http.post(self.url(&format!("/api/v1/infer?{query}")));
        answered(request.header("content-type", "application/octet-stream").body(bytes)).await
    }

    async fn a_frame(&self) -> Value {
        self.make("real").await;
        let page = self.get("/api/v1/datasets/real/rows?columns=voltages_v&limit=1").await;
        page["items"][0]["voltages_v"].clone()
    }
}

#[tokio::test]
async fn nets_are_trained_scored_promoted_and_asked() {
    let lab = Filled::open("models").await;
    let transfer = lab.trained(&transfer_net("small-transfer", 2)).await;
    // A training uses its dataset, which has been read before: only the first read is noted by the file system.
    let frame = lab.a_frame().await;
    let before = Timestamp::now();
    let maps = lab.trained(RECON_NET).await;
    assert!(lab.used_at("/api/v1/datasets/real").await >= before);
    let model = lab.get("/api/v1/models/small-transfer").await;
    assert_eq!((&model["id"], &model["task"]), (&json!(transfer), &json!("transfer")));
    let manifest = &model["manifest"];
    assert_eq!(manifest["label"], "virtual");
    assert_eq!(manifest["calibration"], "cal-1");
    assert_eq!(manifest["simulation"], "sim-0000000000000001");
    assert!(manifest["datasets"][0].as_str().unwrap().starts_with("ds-"));
    assert!(manifest["trained_on"]["max_force_n"].as_f64().unwrap() > 5.0);
    let dataset = manifest["datasets"][0].as_str().unwrap();
    let lineage = lab.get(&format!("/api/v1/datasets/{dataset}/lineage")).await;
    let net = json!({ "id": transfer, "name": "small-transfer", "task": "transfer" });
    assert_eq!(lineage["trained"], json!([net]));
    let losses =
        lab.answer(&format!("/api/v1/models/{transfer}/losses")).await.text().await.unwrap();
    assert_eq!(losses.lines().count(), 2, "{losses}");
    let left = lab.get(&format!("/api/v1/models/{transfer}/residuals")).await;
    assert_eq!(left["sd_v"].as_array().unwrap().len(), 784);

    let voltages = json!({ "scored": "voltages", "dataset": "r2s-transfer", "part": "test",
        "transfer": transfer });
    let report = lab.scored(voltages).await;
    assert_eq!(report["voltages"]["all"]["trials"], report["rows"]);
    let contacts = json!({ "scored": "paper", "dataset": "real", "part": "test", "map": maps });
    let before = Timestamp::now();
    let report = lab.scored(contacts).await;
    assert!(lab.used_at("/api/v1/datasets/real").await >= before);
    assert_eq!(report["contacts"]["all"]["trials"], report["rows"]);
    // The true contacts of this run lie far apart: a perfect map finds nearly all of them.
    assert!(report["perfect"]["all"]["exact_rate"]["mean"].as_f64().unwrap() > 0.8, "{report:#}");
    // An end-to-end net reads the measured frames: a Transfer-Net before it has no use.
    let both = json!({ "scored": "paper", "dataset": "real", "transfer": transfer, "map": maps });
    let words = format!("transfer = {transfer}: must be absent");
    lab.fails("/api/v1/evaluations", both, &words).await;
    let shown = json!({ "scored": "paper", "dataset": "real", "map": maps, "limit": 2,
        "examples": 2 });
    let shown = lab.scored(shown).await;
    let examples = shown["examples"].as_array().unwrap();
    assert_eq!(examples.len(), 2);
    assert_eq!(examples[1]["reading"]["force_map_n"].as_array().unwrap().len(), 32 * 32);
    assert!(examples[1]["truth"][0]["force_n"].as_f64().unwrap() > 0.0, "{}", examples[1]["truth"]);
    // Neither a few that are shown nor rows that were learned from show how good a model is.
    let learned = json!({ "scored": "paper", "dataset": "real", "part": "train", "map": maps });
    lab.scored(learned).await;
    assert_eq!(lab.get("/api/v1/models/maps").await["scores"], json!([report]));

    let request = json!({ "method": "paper", "frames": [frame, frame], "map": true });
    lab.posted("/api/v1/infer", request.clone(), 409).await;
    lab.posted("/api/v1/serving", json!({ "what": "maps" }), 200).await;
    let mut both = request.clone();
    both["transfer"] = json!(transfer);
    let (status, refused) = lab.post("/api/v1/infer", both).await;
    assert_eq!((status, &refused["errors"][0]["key"]), (422, &json!("transfer")), "{refused}");
    let answers = lab.posted("/api/v1/infer", request, 200).await;
    assert_eq!(answers.as_array().unwrap().len(), 2);
    assert_eq!((&answers[0]["model"], &answers[0]["method"]), (&json!(maps), &json!("paper")));
    assert_eq!(answers[0]["force_map_n"].as_array().unwrap().len(), 32 * 32);
    assert_eq!(answers[0]["force_map_n"], answers[1]["force_map_n"]);

    let bytes: Vec<u8> = frame
        .as_array()
        .unwrap()
        .iter()
        .flat_map(|v| (v.as_f64().unwrap() as f32).to_le_bytes())
        .collect();
    let (_, raw) = lab.infers("method=paper&map=true", bytes).await;
    assert_eq!(raw[0]["force_map_n"], answers[0]["force_map_n"]);

    let lab = Filled::serve(lab.end().await).await;
    let serving = lab.get("/api/v1/serving").await;
    assert_eq!(serving["serves"][1], json!({ "slot": "map", "what": maps }));
    let (status, back) = lab.post("/api/v1/serving/roll-back", json!({ "slot": "map" })).await;
    assert_eq!((status, &back["what"]), (200, &Value::Null));
    lab.posted("/api/v1/serving/roll-back", json!({ "slot": "points" }), 409).await;
    lab.close().await;
}

#[tokio::test]
async fn a_training_goes_on_after_a_restart_and_stops_when_it_is_told() {
    let lab = Filled::open("training-restart").await;
    let undisturbed = lab.trained(&transfer_net("same", 300)).await;
    let whole = lab.answer(&format!("/api/v1/models/{undisturbed}/losses")).await.text().await;
    let epochs = |text: &str| -> Vec<u64> {
        let lines = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        lines.map(|line| line["epoch"].as_u64().unwrap()).collect()
    };
    assert_eq!(epochs(&whole.unwrap()), (1..=300).collect::<Vec<_>>());
    // The same recipe again, the service ended in the middle.
    let recipe = json!({ "recipe": transfer_net("same", 300) });
    let (_, job) = lab.post("/api/v1/trainings", recipe).await;
    lab.until(&path_of(&job), LIMIT, |job| job["progress"]["epoch"].as_u64() >= Some(20)).await;
    let lab = Filled::serve(lab.end().await).await;
    let done = lab.job(&job).await;
    assert_eq!(done["result"]["model"], json!(undisturbed), "{done}");

    let (_, endless) = lab
        .post("/api/v1/trainings", json!({ "recipe": transfer_net("endless", 1_000_000) }))
        .await;
    let path = path_of(&endless);
    lab.until(&path, LIMIT, |job| job["state"] == "running").await;
    lab.post(&format!("{path}/stop"), Value::Null).await;
    assert_eq!(lab.job(&endless).await["state"], "stopped");
    assert_eq!(lab.get("/api/v1/models").await["items"].as_array().unwrap().len(), 1);
    lab.close().await;
}

#[tokio::test]
async fn what_cannot_be_is_named_and_changes_nothing() {
    let lab = Filled::open("models-refused").await;
    let net = transfer_net("a", 1);
    for (recipe, words) in [
        (net.replace("epochs = 1", "epochs = 0"), "epochs"),
        (net.replace("batch", "bacth"), "bacth"),
        (net.replace("name = \"a\"", "name = \"a b\""), "name = a b"),
        (net.replace("[training]", "map = \"4x20\"\n[training]"), "map = 4x20"),
        ("nonsense".into(), "recipe"),
    ] {
        lab.refuses("/api/v1/trainings", json!({ "recipe": recipe }), 422, words).await;
    }
    for (recipe, words) in [
        (net.replace("r2s-transfer", "none-such"), "no dataset none-such"),
        (net.replace("r2s-transfer", "real-unseen"), "sim_voltages_v"),
        (net.replace("dataset", "where = [\"tips__gt=9\"]\ndataset"), "no rows in part train"),
    ] {
        lab.fails("/api/v1/trainings", json!({ "recipe": recipe }), words).await;
    }
    let unknown = json!({ "scored": "paper", "dataset": "real", "part": "some" });
    lab.refuses("/api/v1/evaluations", unknown, 422, "part = some").await;
    let unused = json!({ "scored": "tikhonov", "dataset": "real", "points": "any" });
    lab.refuses("/api/v1/evaluations", unused, 422, "points = named").await;

    let frame = vec![0.0; 784];
    for (frames, words) in [
        (json!([vec![0.0; 783]]), "frames[0] = 783"),
        (json!([]), "frames = 0"),
        (json!([frame, vec![1e39; 784]]), "frames"),
    ] {
        let request = json!({ "method": "fast", "frames": frames });
        lab.refuses("/api/v1/infer", request, 422, words).await;
    }
    let nan: Vec<u8> = [f32::NAN; 784].iter().flat_map(|v| v.to_le_bytes()).collect();
    for (bytes, words) in [(nan.clone(), "frames[0][0] = NaN"), (nan[..13].to_vec(), "body = 13")] {
        is_refused(lab.infers("method=fast", bytes).await, 422, words);
    }

    let id = lab.trained(&net).await;
    let onnx = lab.answer(&format!("/api/v1/models/{id}/onnx")).await.bytes().await.unwrap();
    let facts = "task = \"transfer\"\nlabel = \"virtual\"\nsensor = \"ert-28\"\nchannels = 784\n\
        output_shape = [784]\ncode = \"mine\"\n";
    let add = async |file: Vec<u8>, facts: String, sensor: String| {
        let form = reqwest::multipart::Form::new()
            .part("file", reqwest::multipart::Part::bytes(file))
            .text("sensor", sensor)
            .text("facts", facts)
            .text("name", "mine");
        answered(lab.http.post(lab.url("/api/v1/models")).multipart(form)).await
    };
    for (file, facts, words) in [
        (onnx[..onnx.len() / 2].to_vec(), facts.to_owned(), "ONNX"),
        (onnx.to_vec(), facts.replace("784", "783"), "channels"),
        (onnx.to_vec(), facts.replace("ert-28", "other"), "sensor = other"),
        (onnx.to_vec(), facts.replace("code", "cdoe"), "cdoe"),
    ] {
        is_refused(add(file, facts, SENSOR.to_owned()).await, 422, words);
    }
    // What is wrong with the form itself is refused as in other forms.
    let form = reqwest::multipart::Form::new;
    let no_text = reqwest::multipart::Part::bytes(vec![0xff_u8]);
    for (form, words) in [
        (form().text("colour", "red"), "colour = ..: unknown part"),
        (form().text("sensor", SENSOR), "name = absent"),
        (form().text("name", "a\nb"), "no control characters"),
        (form().part("facts", no_text), "facts = bytes: must be text"),
    ] {
        let request = lab.http.post(lab.url("/api/v1/models")).multipart(form);
        is_refused(answered(request).await, 400, words);
    }
    assert_eq!(lab.get("/api/v1/models").await["items"].as_array().unwrap().len(), 1);

    let request = json!({ "method": "fast", "model": id, "frames": [frame] });
    lab.refuses("/api/v1/infer", request, 409, "has no use for it").await;
    let request = json!({ "method": "fast", "model": "cal-0", "frames": [frame] });
    lab.refuses("/api/v1/infer", request, 422, "model = cal-0: must be a net").await;
    let request = json!({ "method": "exact", "model": "cal-0", "frames": [frame] });
    lab.posted("/api/v1/infer", request, 404).await;
    let file = parquet(vec![
        ("voltages_v", frames(4, vec![Some(0.1); 4])),
        ("contacts", lists(&[(10.0, 20.0, Some(3.0))], [1])),
    ]);
    let (_, made) = import(&lab, file, PAD).await;
    let pad = format!("run-{}", made["run"]["scan_id"]);
    for request in [
        json!({ "scored": "tikhonov", "dataset": pad }),
        json!({ "scored": "exact", "dataset": pad }),
    ] {
        let words = "is for sensor ert-28 with 784 channels, this is pad with 4";
        lab.fails("/api/v1/evaluations", request, words).await;
    }
    let (status, added) = add(onnx.to_vec(), facts.to_owned(), SENSOR.to_owned()).await;
    assert_eq!(status, 201, "{added}");
    lab.posted("/api/v1/serving", json!({ "what": "mine" }), 200).await;
    // The id does not cover the sensor file.
    let other = format!("# of another lab\n{SENSOR}");
    let (status, again) = add(onnx.to_vec(), facts.to_owned(), other).await;
    assert_eq!((status, &again["id"]), (201, &added["id"]), "{again}");
    let folder = lab.data.join("models").join(added["id"].as_str().unwrap());
    assert_eq!(std::fs::read_to_string(folder.join("sensor.toml")).unwrap(), SENSOR);
    lab.close().await;
}

/// Each place of a pad has a separate channel.
#[tokio::test]
async fn touches_without_forces_are_learned_and_scored_and_no_force_is_made_up() {
    let lab = Filled::open("models-patterns").await;
    let (trials, channels) = (120, 16);
    let place = |trial: usize| trial % channels;
    let volts = (0..trials).flat_map(|trial| {
        (0..channels).map(move |channel| Some(if channel == place(trial) { 0.2 } else { 0.0 }))
    });
    let touches = (0..trials)
        .map(place)
        .map(|place| (40.0 + 80.0 * (place % 4) as f64, 40.0 + 80.0 * (place / 4) as f64, None));
    let ones: arrow_array::ArrayRef =
        std::sync::Arc::new(arrow_array::Int64Array::from(vec![1; trials]));
    let file = parquet(vec![
        ("voltages_v", frames(channels as i32, volts.collect())),
        ("contacts", lists(&touches.collect::<Vec<_>>(), vec![1; trials])),
        ("frame_count", ones),
    ]);
    let sensor = "name = \"mat\"\nchannels = 16\nwidth_mm = 320\nheight_mm = 320\n";
    let (status, made) = import(&lab, file, sensor).await;
    assert_eq!(status, 201, "{made}");
    let own = json!({ "name": "mat", "task": "real", "runs": ["pad-study"],
        "split": { "ratio": [3, 1, 1], "seed": 1, "by": "trial" } });
    assert_eq!(lab.defined(own).await["rows"], trials);

    let recipe = RECON_NET
        .replace("\"real\"", "\"mat\"")
        .replace("epochs = 1", "epochs = 60")
        .replace("batch = 32", "batch = 8")
        .replace("[4, 2]", "[16, 8]");
    let net = lab.trained(&recipe).await;
    let model = lab.get(&format!("/api/v1/models/{net}")).await;
    assert_eq!(model["manifest"]["trained_on"]["forces_unknown"], true);
    // The map of a carried recipe follows the size of the skin.
    let carried = RECON_NET.replace("\"real\"", "\"mat\"").replace("\"maps\"", "\"scaled\"");
    let request = json!({ "recipe": carried, "scale_map": true });
    let scaled = lab.result("/api/v1/trainings", request).await["model"].clone();
    let scaled = lab.get(&format!("/api/v1/models/{}", scaled.as_str().unwrap())).await;
    let recipe = scaled["manifest"]["recipe"].as_str().unwrap();
    assert!(recipe.contains("map = \"11.6x34.8x371.2\""), "{recipe}");
    let report = lab
        .scored(json!({ "scored": "paper", "dataset": "mat", "part": "test", "map": net }))
        .await;
    let all = &report["contacts"]["all"];
    assert!(all["exact_rate"]["mean"].as_f64().unwrap() > 0.5, "{all:#}");
    assert!(all["closest_mm"]["mean"].as_f64().unwrap() < 40.0, "{all:#}");
    assert!(all.get("force_percent").is_none_or(Value::is_null), "{all:#}");
    // The mean of one frame is that frame: no raw frames are needed.
    let first = json!({ "scored": "paper", "dataset": "mat", "part": "test", "map": net,
        "frames": "first" });
    let first = lab.scored(first).await;
    assert_eq!(first["contacts"]["all"]["exact_rate"]["mean"], all["exact_rate"]["mean"]);

    // It answers frames of its sensor by its id.
    let ask = async |length: usize| {
        let frames = json!([vec![0.01; length]]);
        lab.post("/api/v1/infer", json!({ "method": "paper", "model": net, "frames": frames }))
            .await
    };
    let (status, answers) = ask(channels).await;
    assert_eq!((status, &answers[0]["model"]), (200, &json!(net)), "{answers}");
    assert!(answers[0]["contacts"].is_array(), "{answers}");
    is_refused(ask(784).await, 422, "frames[0] = 784: must have 16 voltages");

    // Promoted, it answers by slot and sensor, also after a restart, next to what serves on the rig.
    let of_mat = json!({ "slot": "map", "sensor": "mat", "what": net });
    assert_eq!(lab.posted("/api/v1/serving", json!({ "what": net }), 200).await, of_mat);
    let lab = Filled::serve(lab.end().await).await;
    let serving = lab.get("/api/v1/serving").await;
    assert_eq!((&serving["sensor"], &serving["elsewhere"]), (&json!("ert-28"), &json!([of_mat])));
    let of_rig = serving["serves"].as_array().unwrap();
    assert!(of_rig.iter().all(|serves| serves["what"].is_null()), "{serving}");
    assert_eq!(lab.get("/api/v1/models/map@mat").await["serves"], true);
    let frames = json!([vec![0.01; channels]]);
    let request = json!({ "method": "paper", "model": "map@mat", "frames": frames });
    let answers = lab.posted("/api/v1/infer", request.clone(), 200).await;
    assert_eq!(answers[0]["model"], json!(net));
    lab.posted("/api/v1/serving/roll-back", json!({ "slot": "map" }), 409).await;
    let back = json!({ "slot": "map", "sensor": "mat" });
    let emptied = lab.posted("/api/v1/serving/roll-back", back, 200).await;
    assert!(emptied["what"].is_null(), "{emptied}");
    lab.posted("/api/v1/infer", request, 404).await;
    lab.close().await;
}
