//! A virtual rig, a virtual operator and a service, in one process, each on its own sockets; and the shares of the
//! machine that tests take.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use palpate::api::{ServeOptions, Service};
use palpate::conductor::AutoResume;
use serde_json::{Value, json};
use sim_core::sensor::Sensor;
use tokio::sync::{Semaphore, SemaphorePermit};
use virtual_rig::run::{RigArgs, RigOptions, VirtualRig};
use virtual_rig::{OperatorArgs, operator_main};

use crate::common::serve_options;
pub use crate::common::{
    Process, SENSOR, answered, database, execute, http, is_refused, left_out, signal, skin_cache,
    until, with_extension, with_responses,
};

/// Longest wait for anything that a test waits for.
pub const LIMIT: Duration = Duration::from_secs(240);

/// An experiment of 66 trials with one tip, named `one-tip`.
pub const ONE_TIP: &str = "name = \"one-tip\"\nseed = 1\nsensor = \"sensors/ert-28.toml\"\n\
    [real_hex]\ntips = [1]\nconfigurations = 6\nblock = 6\nreference_every = 6\n";

/// A file of `experiments/`.
pub fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("experiments").join(name)
}

/// Arguments of a virtual rig that is this much faster than the wall.
pub fn rig_args(rig: &str, speed: f64) -> RigArgs {
    let options = RigOptions {
        seed: 3,
        speed: Some(speed),
        age_days: 0.0,
        ephemeral: true,
        out_rig: None,
        fault: None,
        control: "127.0.0.1:0".into(),
        cache: Some(skin_cache()),
        ready_file: None,
        with_parent: false,
    };
    let rig = file(&format!("rigs/{rig}.toml"));
    let (gap, sensor) = (file("gaps/gap-a.toml"), file("sensors/ert-28.toml"));
    RigArgs { rig, gap, sensor, options }
}

/// Shares of the machine: an accelerated rig that is late by a wall millisecond is late by tens of process
/// milliseconds, so that few rigs run at the same time. Measured on two cores, a rig at up to twenty times the wall
/// and its service need an eighth to a third of a core.
static MACHINE: Semaphore = Semaphore::const_new(WHOLE as usize);
/// Share of a test that waits for a rig most of the time.
pub const WAITS: u32 = 1;
/// Share of a test that computes meanwhile, as a browser does, or that moves axes at full speed.
pub const COMPUTES: u32 = 2;
/// Share of a test that measures how soon something happens, or whose wires are serial: their gaps are milliseconds.
/// Until it begins, the others end.
pub const WHOLE: u32 = 4;

/// Held shares of the machine, given back when it is dropped.
pub type Turn = SemaphorePermit<'static>;

/// Waits for shares of the machine, in the order of the requests.
pub async fn turn(shares: u32) -> Turn {
    MACHINE.acquire_many(shares).await.unwrap()
}

/// Sends a line to the control socket of a rig, as a hand would; what it answers.
pub async fn tell(rig: &VirtualRig, command: Value) -> Value {
    tell_at(&rig.ready.control, command).await
}

/// As [`tell`], for the address of the socket.
pub async fn tell_at(control: &str, command: Value) -> Value {
    use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
    let wire = tokio::net::TcpStream::connect(control).await.unwrap();
    let mut wire = BufReader::new(wire);
    wire.get_mut().write_all(format!("{command}\n").as_bytes()).await.unwrap();
    let mut reply = String::new();
    wire.read_line(&mut reply).await.unwrap();
    assert!(reply.contains("\"ok\":true"), "{command}: {reply}");
    serde_json::from_str(&reply).unwrap()
}

/// A line for the control socket: a fault that begins at once, with what else it states.
pub fn fault(kind: &str, device: &str, more: Value) -> Value {
    let mut fault = json!({ "cmd": "fault", "kind": kind, "device": device });
    fault.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    fault
}

/// Everything of one test; its folder goes with it.
pub struct Lab {
    /// Switched on.
    pub rig: VirtualRig,
    /// Answers.
    pub service: Service,
    pub data: PathBuf,
    http: reqwest::Client,
    turn: Turn,
}

impl Lab {
    /// Switches everything on, with a share of the machine.
    pub async fn open(name: &str, args: RigArgs, share: u32) -> Self {
        let speed = args.options.speed.unwrap();
        let lab = Self::open_alone(name, args, share).await;
        lab.call_operator(speed);
        lab
    }

    /// Switches everything on, with a virtual rig of this speed, and homes.
    pub async fn homed(name: &str, speed: f64, share: u32) -> Self {
        let lab = Self::open(name, rig_args("virtual", speed), share).await;
        lab.home().await;
        lab
    }

    /// Switches everything on; no operator mounts tips or places weights.
    pub async fn open_alone(name: &str, args: RigArgs, share: u32) -> Self {
        let turn = turn(share).await;
        let rig = VirtualRig::switch_on(&args).await.unwrap();
        let data = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("system-{name}"));
        std::fs::remove_dir_all(&data).ok();
        with_responses(&data);
        let service = Service::start(options(&rig, &data)).await.unwrap();
        Self { rig, service, data, http: http(), turn }
    }

    fn call_operator(&self, speed: f64) {
        self.call_operator_who_errs(speed, 0.0);
    }

    /// Starts an operator who puts a weight on a wrong point at first, with this probability.
    pub fn call_operator_who_errs(&self, speed: f64, mistakes: f64) {
        let args = OperatorArgs {
            url: self.service.url(),
            control: self.rig.ready.control.clone(),
            speed,
            who: "virtual operator".into(),
            mistakes,
            seed: 1,
            with_parent: false,
        };
        let text = std::fs::read_to_string(file("sensors/ert-28.toml")).unwrap();
        let sensor = Sensor::from_toml(&text).unwrap();
        // It ends with an error once the service has ended.
        std::thread::spawn(move || operator_main(args, Some(&sensor)));
    }

    /// A GET that must succeed.
    pub async fn get(&self, path: &str) -> Value {
        let url = format!("{}{path}", self.service.url());
        let answer = self.http.get(url).send().await.unwrap();
        assert!(answer.status().is_success(), "{path}: {}", answer.text().await.unwrap());
        answer.json().await.unwrap()
    }

    /// The items of a page.
    pub async fn items(&self, path: &str) -> Vec<Value> {
        self.get(path).await["items"].as_array().unwrap().clone()
    }

    /// A POST: its status and its body.
    pub async fn post(&self, path: &str, body: Value) -> (u16, Value) {
        let url = format!("{}{path}", self.service.url());
        answered(self.http.post(url).json(&body)).await
    }

    /// A POST that must succeed.
    pub async fn posted(&self, path: &str, body: Value) -> Value {
        let (status, answer) = self.post(path, body).await;
        assert!(status < 300, "{path}: {status} {answer}");
        answer
    }

    /// Waits for a safe end, which must leave no trip.
    pub async fn ends_safely(&self) {
        let status = self.until("a safe end", |s| !s["rig"]["safe_end"].is_null()).await;
        let rig = &status["rig"];
        assert_eq!((&rig["state"], &rig["trip"]), (&json!("disarmed"), &Value::Null));
    }

    /// Waits for the status to satisfy this.
    pub async fn until(&self, what: &str, done: impl Fn(&Value) -> bool) -> Value {
        self.eventually(what, "/api/v1/status", done).await
    }

    /// Waits for what stands at a path to satisfy this.
    pub async fn eventually(&self, what: &str, path: &str, done: impl Fn(&Value) -> bool) -> Value {
        until(what, LIMIT, async || self.get(path).await, done).await
    }

    /// An action on the rig that must be accepted.
    pub async fn operate(&self, action: Value) {
        self.posted("/api/v1/rig/actions", action).await;
    }

    pub async fn home(&self) {
        self.operate(json!({ "action": "connect", "who": "test" })).await;
        self.operate(json!({ "action": "home", "who": "test" })).await;
        self.until("homed", |s| s["rig"]["state"] == "homed").await;
    }

    /// Queues an experiment; returns the run's uid.
    pub async fn queue(&self, definition: &str) -> String {
        let sensor = std::fs::read_to_string(file("sensors/ert-28.toml")).unwrap();
        let body = json!({ "file": "test.toml", "definition": definition, "sensor": sensor,
            "who": "test" });
        let row = self.posted("/api/v1/queue", body).await;
        row["uid"].as_str().unwrap().to_owned()
    }

    /// Arms and starts.
    pub async fn start(&self, run: &str) {
        let armed = self.posted(&format!("/api/v1/runs/{run}/arm"), json!({ "who": "test" })).await;
        let body = json!({ "action": "start", "code": armed["code"], "who": "test" });
        self.posted(&format!("/api/v1/runs/{run}/actions"), body).await;
    }

    /// Queues an experiment, arms it and starts it; returns the run's uid.
    pub async fn begin(&self, definition: &str) -> String {
        let run = self.queue(definition).await;
        self.start(&run).await;
        run
    }

    /// An action on a run that must be accepted.
    pub async fn accepts(&self, run: &str, action: Value) {
        let (status, answer) = self.act(run, action).await;
        assert_eq!(status, 202, "{answer:#}");
    }

    /// No run is active, and the rig is in this state.
    pub async fn rests(&self, rig: &str) {
        let status = self.get("/api/v1/status").await;
        assert_eq!((&status["run"], &status["rig"]["state"]), (&Value::Null, &json!(rig)));
    }

    /// Waits until a run is interrupted; returns its row.
    pub async fn interrupted(&self, run: &str) -> Value {
        let is_left = |row: &Value| row["state"] == "interrupted";
        self.eventually("the run is left alone", &format!("/api/v1/runs/{run}"), is_left).await
    }

    /// Waits until an event of this kind states this reason.
    pub async fn told(&self, kind: &str, words: &str) {
        let is_told = |page: &Value| {
            let mut events = page["items"].as_array().unwrap().iter();
            events.any(|event| event["data"]["why"].as_str().is_some_and(|why| why.contains(words)))
        };
        self.eventually("the event", &format!("/api/v1/events?kind={kind}"), is_told).await;
    }

    pub async fn act(&self, run: &str, action: Value) -> (u16, Value) {
        self.post(&format!("/api/v1/runs/{run}/actions"), action).await
    }

    /// Waits for a run's end; returns its summary.
    pub async fn ended(&self, run: &str) -> Value {
        let start = Instant::now();
        loop {
            let row = self.get(&format!("/api/v1/runs/{run}")).await;
            if row["state"] == "ended" {
                return self.get(&format!("/api/v1/runs/{run}/summary")).await;
            }
            if start.elapsed() > LIMIT {
                let status = self.get("/api/v1/status").await;
                panic!("the run does not end: {status:#}\n{:#}", self.events().await);
            }
            // An end stays: asking more often takes from the machine what rigs need.
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    /// Every event so far.
    pub async fn events(&self) -> Value {
        self.get("/api/v1/events?since=0&limit=1000").await["items"].clone()
    }

    /// Keys of a run's trials, in the order of storage.
    pub async fn keys(&self, run: &str) -> Vec<(u64, u64)> {
        let trials = self.items(&format!("/api/v1/runs/{run}/trials?limit=10000")).await;
        let number = |trial: &Value, key: &str| trial[key].as_u64().unwrap();
        trials.iter().map(|t| (number(t, "configuration"), number(t, "depth_index"))).collect()
    }

    /// Sends a line to the control socket, as a hand would.
    pub async fn tell_rig(&self, command: Value) {
        tell(&self.rig, command).await;
    }

    /// A fault of the rig that begins at once.
    pub async fn fault(&self, kind: &str, device: &str, more: Value) {
        self.tell_rig(fault(kind, device, more)).await;
    }

    /// Sticks x: the next homing lasts until its limit of twelve seconds.
    pub async fn stick_x(&self) {
        self.fault("stuck_axis", "x", json!({ "for_s": 6000.0 })).await;
    }

    /// Waits until a run has stored `n` trials.
    pub async fn stored(&self, n: u64) {
        let enough = |s: &Value| s["run"]["trials_stored"].as_u64().is_some_and(|t| t >= n);
        self.until("progress", enough).await;
    }

    /// The service ends and another starts on the same database, as after a reboot.
    pub async fn restart(self) -> Self {
        let lab = self.restart_alone().await;
        lab.call_operator(40.0);
        lab
    }

    /// As [`Self::restart`], without an operator.
    pub async fn restart_alone(self) -> Self {
        let Self { rig, service, data, http, turn } = self;
        service.shutdown().await;
        let service = Service::start(options(&rig, &data)).await.unwrap();
        Self { rig, service, data, http, turn }
    }

    /// Switches everything off.
    pub async fn close(self) {
        self.service.shutdown().await;
        std::fs::remove_dir_all(&self.data).ok();
    }
}

/// A service on a rig that is switched on.
pub fn options(rig: &VirtualRig, data: &Path) -> ServeOptions {
    let base = serve_options(data, rig.rig_text.clone());
    ServeOptions { resume: AutoResume::Allowed, twin_workers: 1, ..base }
}
