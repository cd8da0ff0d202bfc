//! Fills the status from the readings of the bench and the contents of the store.
//! Uses: `campaign::{run::control, bench::stage, shown::status}`, `rig`. Never: motion, decisions.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;

use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::stage::Stage;
use crate::campaign::run::control::Control;
use crate::campaign::run::eta::Pace;
use crate::campaign::run::job::Job;
use crate::campaign::shown::frames::FrameFeed;
use crate::campaign::shown::status::{
    Attended, Phase, RigStatus, RunStatus, Status, StreamStatus, WireStatus,
};
use crate::journal::Progress;
use crate::rig::link::{Line, LineCounts};
use crate::rig::setup::RigSetup;
use crate::rig::traits::{Frame, SkinReader};
use crate::schedule::plan::Kind;
use crate::state::StoredState;

/// Shortest time between two turns of the live views, wall: less than one frame period of a rig at
/// speed 1.
const FRAME_REST: Duration = Duration::from_millis(10);

/// Status before any wire is open.
pub fn closed(config: &RigSetup) -> Status {
    Status {
        rig: RigStatus {
            name: config.name().into(),
            label: config.label(),
            has_stage: config.bench().is_some(),
            state: RigState::Disconnected,
            motion: None,
            trip: None,
            tripped_at: None,
            clock_rate: config.clock_rate(),
            pose: None,
            not_clear: None,
            forces_n: Vec::new(),
            force_limit_n: config.bench().map(|bench| bench.limits.force_n),
            tips: None,
            live_cells: None,
            surface: None,
            stream: StreamStatus::default(),
            wires: Vec::new(),
            estop_acknowledged_ms: None,
            estop_stops: Vec::new(),
            safe_end: None,
            stopping: None,
        },
        run: None,
        version: 0,
        attended: Attended::default(),
    }
}

/// Status of a run that has just been armed.
pub fn started(job: &Job) -> RunStatus {
    RunStatus {
        uid: job.run,
        scan_id: job.scan_id,
        experiment: job.plan.experiment.clone(),
        is_manual: job.plan.kind == Kind::RealRandom,
        state: StoredState::Idle,
        requested_state: None,
        paused_why: None,
        waits_since: None,
        waiting_for: None,
        wanted: None,
        phase: Phase::Next,
        current_step: None,
        trial: None,
        trials_planned: job.plan.trials(),
        trials_stored: 0,
        trials_skipped: 0,
        retries: 0,
        eta: None,
        needed_bytes: job.plan.trials() * job.bytes_per_trial,
    }
}

/// Publishes the counts of trials and the remaining time.
pub fn progress(control: &Control, job: &Job, progress: &Progress, pace: &Pace) {
    let depths = job.plan.depths_mm.len().max(1) as u32;
    let stored = progress.stored.len() as u64;
    let skipped: u64 = progress
        .skipped
        .iter()
        .map(|c| {
            let kept = progress.stored.iter().filter(|k| k.configuration == *c).count() as u64;
            u64::from(depths).saturating_sub(kept)
        })
        .sum();
    let left = job.plan.trials().saturating_sub(stored + skipped);
    let eta = pace.eta(left, depths);
    control.show_run(|run| {
        run.trials_stored = stored;
        run.trials_skipped = skipped;
        run.retries = run.retries.max(progress.retries);
        run.eta = Some(eta);
        run.needed_bytes = left * job.bytes_per_trial;
    });
}

/// Publishes the stops of a latched e-stop, and the readings of the bench, between runs. Until each axis has
/// acknowledged, nothing is read: the stop of a silent one is sent again and again, and delays each reply.
pub async fn bench(control: &Control, stage: &Stage) {
    if let Some(press) = control.estop.pressed() {
        let acknowledged_ms = press.acknowledged_ms();
        control.show(|status| {
            let rig = &mut status.rig;
            rig.estop_acknowledged_ms = acknowledged_ms;
            rig.estop_stops = press.stops();
            if acknowledged_ms.is_none() {
                (rig.pose, rig.not_clear, rig.live_cells) = (None, None, None);
                rig.forces_n.clear();
            }
        });
        if acknowledged_ms.is_none() {
            return;
        }
    }
    let (pose, z) = stage.pose_and_z().await.ok().unzip();
    let not_clear = z.and_then(|z| stage.not_clear(&z));
    let reading = stage.bench.cells.read().await.ok();
    if let Some(reading) = &reading {
        stage.publish(reading, pose.map(|pose| pose.z_mm));
    }
    let live = reading.map(|reading| stage.live_forces_n(&reading.volts));
    control.show(|status| {
        let rig = &mut status.rig;
        (rig.pose, rig.not_clear) = (pose, not_clear);
        rig.live_cells = live.map(|forces| forces.iter().flatten().count() as u8);
        rig.forces_n = live.map_or_else(Vec::new, Vec::from);
    });
}

/// Publishes the counters of the wires, without a request to any device.
pub fn counters(control: &Control, skin: &dyn SkinReader, lines: &BTreeMap<String, Arc<Line>>) {
    let latest = skin.latest();
    let counters = skin.counters();
    let wires = lines.iter().map(|(name, line)| wire(name, line.counts())).collect();
    control.show(|status| {
        status.rig.stream = StreamStatus {
            frames: counters.frames,
            missed: counters.missed,
            garbled: counters.garbled,
            reconnects: counters.reconnects,
            age_ms: latest.map(|f| f.received.elapsed().as_millis() as u64),
        };
        status.rig.wires = wires;
    });
}

fn wire(name: &str, counts: LineCounts) -> WireStatus {
    WireStatus {
        name: name.into(),
        requests: counts.answered,
        retries: counts.retries,
        timeouts: counts.timeouts,
        garbled: counts.garbled,
        reconnects: counts.reconnects,
        last_round_trip_us: counts.last_round_trip_us,
    }
}

/// Forwards each new frame to the live views immediately; those of a fast rig, and those that a busy machine received
/// together, in one turn.
pub async fn forward_frames(mut stream: broadcast::Receiver<Arc<Frame>>, views: FrameFeed) {
    loop {
        let mut together = match stream.recv().await {
            Ok(frame) => vec![frame],
            Err(RecvError::Lagged(_)) => Vec::new(),
            Err(RecvError::Closed) => return,
        };
        while let Ok(frame) = stream.try_recv() {
            together.push(frame);
        }
        views.publish(together);
        tokio::time::sleep(FRAME_REST).await;
    }
}
