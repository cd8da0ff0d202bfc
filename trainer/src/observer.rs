//! Follows a training: reports progress, stores checkpoints and losses in the job's folder.
//! Uses: `talk`, `new_file`, the clock. Never: a checkpoint that is not whole.

use std::path::Path;
use std::time::{Duration, Instant};

use nets::progress::{Flow, Observer, Progress};
use serde_json::{Value, json};

use crate::learn::order::{CHECKPOINT, Event, LOSSES};
use crate::new_file;
use crate::talk::Talk;

/// Interval between two checkpoints.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(30);
/// Shortest interval between two reports.
const REPORT_EVERY: Duration = Duration::from_millis(50);

/// Follows a training.
pub struct JobObserver<'a> {
    folder: &'a Path,
    talk: &'a Talk,
    began: Instant,
    /// Number of samples that were learned before this start.
    first: Option<u64>,
    kept: Instant,
    reported: Option<Instant>,
    validation_loss: Option<f64>,
}

impl<'a> JobObserver<'a> {
    /// Begins a phase in which a net learns.
    pub fn begin(folder: &'a Path, talk: &'a Talk, phase: &str) -> Self {
        talk.say(&Event::Phase { phase: phase.into(), total: 0 });
        let began = Instant::now();
        let (first, reported, validation_loss) = (None, None, None);
        Self { folder, talk, began, first, kept: began, reported, validation_loss }
    }

    fn report(&mut self, progress: &Progress) {
        let [done, total] = progress.samples;
        let first = *self.first.get_or_insert(done);
        self.validation_loss = progress.validation_loss.or(self.validation_loss);
        let is_last = done == total && progress.validation_loss.is_some();
        if !is_last && self.reported.is_some_and(|at| at.elapsed() < REPORT_EVERY) {
            return;
        }
        self.reported = Some(Instant::now());
        self.talk.say(&Event::Learned {
            done,
            total,
            new: done - first,
            elapsed_s: self.began.elapsed().as_secs_f64(),
            epoch: u64::from(progress.epoch) + 1,
            train_loss: Some(progress.train_loss),
            validation_loss: self.validation_loss,
        });
    }

    fn write_loss(&self, progress: &Progress, validation: f64) {
        let line = json!({
            "epoch": progress.epoch + 1, "samples": progress.samples[0],
            "train_loss": progress.train_loss, "validation_loss": validation,
            "elapsed_s": self.began.elapsed().as_secs_f64(),
        });
        let known = std::fs::read_to_string(self.folder.join(LOSSES)).unwrap_or_default();
        // After a restart, epochs since the last checkpoint are repeated: the later line is valid.
        let before = |line: &&str| {
            let known: Option<Value> = serde_json::from_str(line).ok();
            known.is_some_and(|k| k["epoch"].as_u64() < Some(u64::from(progress.epoch) + 1))
        };
        let mut text: String = known.lines().filter(before).map(|l| format!("{l}\n")).collect();
        text += &format!("{line}\n");
        if let Err(error) = new_file::write(self.folder, LOSSES, text) {
            self.warn(format!("losses were not stored: {error}"));
        }
    }

    fn warn(&self, message: String) {
        self.talk.say(&Event::Warning { message });
    }
}

impl Observer for JobObserver<'_> {
    fn see(&mut self, progress: &Progress) -> Flow {
        let goes_on = self.talk.learns_on();
        self.report(progress);
        if let Some(validation) = progress.validation_loss {
            self.write_loss(progress, validation);
        }
        if !goes_on {
            Flow::Stop
        } else if self.kept.elapsed() >= CHECKPOINT_EVERY {
            self.kept = Instant::now();
            Flow::Checkpoint
        } else {
            Flow::Continue
        }
    }

    fn keep(&mut self, checkpoint: Vec<u8>) {
        match new_file::write(self.folder, CHECKPOINT, checkpoint) {
            Ok(_) => self.talk.say(&Event::Checkpoint),
            // The training continues; a restart resumes from an older checkpoint.
            Err(error) => self
                .warn(format!("{}: a checkpoint was not stored: {error}", self.folder.display())),
        }
    }
}
