//! Scores the answers of nets and methods to gathered rows: voltages, a quantity, or contacts.
//! Uses: `gathered`, `evaluate`, `infer`. Never: the store, files, a number without its rows.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use nets::quantity::Quantity;
use serde_json::Value;
use sim_core::stats::{quantile, sorted};

use super::Watch;
use super::error::JobResult;
use super::gathered::Gathered;
use super::readings::frames::FrameInput;
use crate::clock::Clock;
use crate::dataset::force_map::ForceMap;
use crate::dataset::force_map::peaks::THRESHOLD_N;
use crate::dataset::origin;
use crate::evaluate::anova::Moments;
use crate::evaluate::distances::Distances;
use crate::evaluate::perfect::perfect;
use crate::evaluate::quantities::QuantityScores;
use crate::evaluate::reliability::{JudgedAnswer, Reliability};
use crate::evaluate::request::{EvaluationReport, EvaluationRequest, Example};
use crate::evaluate::score::Scores;
use crate::evaluate::touch::{Metric, Touch, TouchError};
use crate::evaluate::voltages::VoltageScores;
use crate::ids::DatasetId;
use crate::infer::answer::{FoundContact, Reading};
use crate::infer::error::{InferError, InferResult};
use crate::infer::maps::ForceMaps;
use crate::infer::methods::ReadyMethod;
use crate::infer::registry::Model;
use crate::infer::untouched::UntouchedSkins;
use crate::learn::error::LearnError;
use crate::learn::targets::Targets;
use crate::learn::task::{MEASURED, Reads, SIMULATED};
use crate::simulate::compare::Compared;
use crate::store::{Contact, Label};

/// Number of frames that a Transfer-Net reads at a time.
const TRANSFERRED_AT_ONCE: usize = 8;

pub(super) enum Reader {
    /// A Transfer-Net, or none: the frames themselves.
    Voltages(Option<Arc<Model>>),
    /// A net that answers a quantity.
    Quantity(Arc<Model>, Quantity),
    /// A method from a frame to contacts.
    Contacts(Box<dyn ReadyMethod>),
}

impl Reader {
    /// The method, if contacts are read.
    pub(super) fn method(&self) -> Option<&dyn ReadyMethod> {
        match self {
            Self::Voltages(_) | Self::Quantity(..) => None,
            Self::Contacts(method) => Some(method.as_ref()),
        }
    }

    pub(super) fn nets(&self) -> Vec<&Model> {
        match self {
            Self::Voltages(transfer) => transfer.iter().map(Arc::as_ref).collect(),
            Self::Quantity(net, _) => vec![net],
            Self::Contacts(method) => method.nets(),
        }
    }

    /// Columns of frames that are needed.
    pub(super) fn columns(&self) -> &'static [&'static str] {
        match self {
            Self::Voltages(_) => &[MEASURED, SIMULATED],
            Self::Quantity(..) => &[MEASURED],
            Self::Contacts(method) => match method.reads() {
                Reads::Simulated => &[SIMULATED],
                Reads::Measured => &[MEASURED],
            },
        }
    }
}

pub(super) struct Scoring {
    pub(super) request: EvaluationRequest,
    pub(super) dataset: DatasetId,
    /// Its lineage, as JSON.
    pub(super) lineage: Value,
    /// Whether none of the rows can have been used to train a net.
    pub(super) held_out: bool,
    pub(super) gathered: Gathered,
    pub(super) raw: Option<Vec<Vec<f32>>>,
    pub(super) untouched: UntouchedSkins,
    pub(super) reader: Reader,
    /// Whether measured frames are read.
    pub(super) measured: bool,
    /// Name and channels of the rig's sensor, which is that of the exact model.
    pub(super) rig_sensor: (String, usize),
    pub(super) watch: Arc<Watch>,
    pub(super) clock: Clock,
}

impl Scoring {
    /// Scores the answers to all rows; `None` if it was stopped.
    ///
    /// # Errors
    /// `JobError` if the models are for another sensor, a row cannot be read, or a model cannot answer.
    pub(super) fn run(self) -> JobResult<Option<EvaluationReport>> {
        self.check_sensor()?;
        let mut report = self.blank();
        self.watch.phase("scoring", self.gathered.rows.len() as u64);
        let done = match &self.reader {
            Reader::Voltages(transfer) => self.voltages(transfer.as_deref(), &mut report)?,
            Reader::Quantity(net, quantity) => self.quantity(net, *quantity, &mut report)?,
            Reader::Contacts(method) => self.contacts(method.as_ref(), &mut report)?,
        };
        Ok(done.then_some(report))
    }

    /// Checks that the models are for the sensor of the rows.
    fn check_sensor(&self) -> InferResult<()> {
        let here = &self.gathered.skin;
        for net in self.reader.nets() {
            net.is_for(&here.name, here.channels)?;
        }
        let (sensor, channels) = &self.rig_sensor;
        match self.reader.method().and_then(|method| method.skin()) {
            Some(skin) if *sensor != here.name || *channels != here.channels => {
                Err(InferError::OtherSensor {
                    id: skin.id.to_owned(),
                    sensor: sensor.clone(),
                    channels: *channels,
                    here: format!("{} with {}", here.name, here.channels),
                })
            }
            _ => Ok(()),
        }
    }

    /// Restrictions on the validity of the scores.
    fn notes(&self) -> Vec<String> {
        let skin = self.reader.method().and_then(|method| method.skin());
        let (run, limited) = skin.map_or((None, None), |skin| (skin.run, skin.limitation));
        let runs = self.lineage["runs"].as_array().into_iter().flatten();
        let seen = run.filter(|run| runs.into_iter().any(|r| r["uid"].as_str() == Some(run)));
        let seen = seen.map(|run| {
            format!("the skin was calibrated to trials of run {run}, which are in the dataset")
        });
        let learned = (!self.held_out)
            .then(|| "the rows may include rows that the nets were trained on".to_owned());
        seen.into_iter().chain(limited).chain(learned).collect()
    }

    /// Distances by which contacts are judged on the skin of the rows.
    fn distances(&self) -> Distances {
        let skin = &self.gathered.skin;
        Distances::on_skin([skin.width_mm, skin.height_mm])
    }

    fn blank(&self) -> EvaluationReport {
        let models = self.reader.nets().iter().map(|net| net.manifest.id.clone()).collect();
        let skin = self.reader.method().and_then(|method| method.skin());
        let calibration = skin.and_then(|skin| skin.calibration.cloned());
        let label = origin::label(&self.lineage);
        EvaluationReport {
            scored: self.request.scored,
            dataset: self.dataset.clone(),
            part: self.request.part.clone(),
            held_out: self.held_out,
            conditions: self.request.conditions.clone(),
            frames: self.request.frames,
            label: label.filter(|_| self.measured).unwrap_or(Label::Simulated),
            models,
            calibration,
            rows: self.gathered.rows.len() as u64,
            threshold_n: self.request.threshold_n.unwrap_or(THRESHOLD_N),
            distances: self.distances(),
            place_sd_mm: self.request.place_sd_mm,
            contacts: None,
            perfect: None,
            map: None,
            reliability: None,
            voltages: None,
            quantity: None,
            cells: None,
            latency_ms: None,
            notes: self.notes(),
            examples: Vec::new(),
        }
    }

    /// Reports progress; returns `false` if the job must end.
    fn goes_on(&self, done: usize, began_s: f64) -> bool {
        let elapsed = Duration::from_secs_f64((self.clock.process_s() - began_s).max(1e-3));
        self.watch.done(done as u64, done as u64, elapsed);
        !self.watch.is_stopped()
    }

    /// Scores voltages; returns `false` if it was stopped.
    fn voltages(&self, transfer: Option<&Model>, report: &mut EvaluationReport) -> JobResult<bool> {
        let examples = &self.gathered.examples;
        let channels = examples.channels;
        let began_s = self.clock.process_s();
        let (mut fits, mut target) = (Vec::new(), vec![0.0; channels]);
        for (at, rows) in self.gathered.rows.chunks(TRANSFERRED_AT_ONCE).enumerate() {
            let frames = self.frames(at * TRANSFERRED_AT_ONCE, rows)?;
            let mut answers = Vec::new();
            match transfer {
                Some(model) => {
                    model.plan.answer(&frames, &mut answers).map_err(InferError::from)?
                }
                None => answers = frames,
            }
            for (&row, answer) in rows.iter().zip(answers.chunks_exact(channels)) {
                examples.frame(row, 1, &mut target)?;
                let pair = Compared { measured_v: &target, simulated_v: answer };
                let fit = pair.difference();
                fits.push((examples.contacts(row).len() as u32, fit.rmse_v, fit.fvu));
            }
            if !self.goes_on(fits.len(), began_s) {
                return Ok(false);
            }
        }
        report.voltages = VoltageScores::of(&fits);
        Ok(true)
    }

    /// Scores a quantity; returns `false` if it was stopped.
    fn quantity(
        &self,
        net: &Model,
        quantity: Quantity,
        report: &mut EvaluationReport,
    ) -> JobResult<bool> {
        let began_s = self.clock.process_s();
        let mut answers = Vec::new();
        for (at, rows) in self.gathered.rows.chunks(TRANSFERRED_AT_ONCE).enumerate() {
            let frames = self.frames(at * TRANSFERRED_AT_ONCE, rows)?;
            net.plan.answer(&frames, &mut answers).map_err(InferError::from)?;
            if !self.goes_on(at * TRANSFERRED_AT_ONCE + rows.len(), began_s) {
                return Ok(false);
            }
        }
        let targets = Targets { quantity, places_mm: net.manifest.model.places_mm.clone() };
        let contacts = self.gathered.rows.iter().map(|&row| self.gathered.examples.contacts(row));
        let rows: Vec<_> = contacts.zip(answers.chunks_exact(targets.len())).collect();
        report.quantity = QuantityScores::of(&targets, &rows, self.request.seed);
        if report.quantity.is_none() {
            let limit = format!("must have rows with a {}", quantity.name());
            return Err(LearnError::value("evaluation", "dataset", &self.dataset, &limit).into());
        }
        Ok(true)
    }

    /// Scores contacts; returns `false` if it was stopped.
    fn contacts(&self, method: &dyn ReadyMethod, report: &mut EvaluationReport) -> JobResult<bool> {
        let began_s = self.clock.process_s();
        let (mut touches, mut judged, mut latencies) = (Vec::new(), Vec::new(), Vec::new());
        let mut calibrated = 0;
        // One frame at a time, as on a rig: the latency is measured.
        for (at, &row) in self.gathered.rows.iter().enumerate() {
            let input = self.input(at, row)?;
            calibrated += u64::from(input.untouched.is_none());
            let shown = report.examples.len() < self.request.examples as usize;
            let before_s = self.clock.process_s();
            let readings = method.read(&input.frames(), ForceMaps::if_wanted(shown))?;
            latencies.push(1e3 * (self.clock.process_s() - before_s));
            for reading in readings {
                let sure = reading.contacts.iter().filter(|found| self.is_sure(found));
                touches.push(self.touch(row, &sure.copied().collect::<Vec<_>>())?);
                judged.extend(self.judged(row, &reading)?);
                if shown {
                    report.examples.push(Example { truth: self.truths(row), reading });
                }
            }
            if !self.goes_on(touches.len(), began_s) {
                return Ok(false);
            }
        }
        if calibrated > 0 && method.takes_untouched() {
            report.notes.push(format!(
                "{calibrated} of {} rows were read with the offsets of the calibration, which drift",
                touches.len()
            ));
        }
        let latencies = sorted(latencies);
        report.latency_ms =
            quantile(&latencies, 0.5).zip(quantile(&latencies, 0.99)).map(Into::into);
        report.contacts = Some(Scores::of(&touches, &report.distances, self.request.seed));
        report.reliability = Reliability::of(&judged, self.request.seed);
        report.cells = Some(cells(&touches));
        let spec = method.map();
        let skin = &self.gathered.skin;
        let draws = ForceMap::new(spec, [skin.width_mm, skin.height_mm]);
        let draws = draws.map_err(InferError::from)?;
        let truths: Vec<Vec<Contact>> =
            self.gathered.rows.iter().map(|&row| self.truths(row)).collect();
        let truths = truths.iter().map(Vec::as_slice);
        report.threshold_n = self.request.threshold_n.unwrap_or_else(|| method.threshold_n());
        let ghost_mm = report.distances.ghost_mm;
        let perfect = perfect(&draws, truths, report.threshold_n, ghost_mm).map_err(|error| {
            LearnError::value("evaluation", "dataset", &self.dataset, &error.to_string())
        })?;
        if !perfect.is_empty() {
            let scores = Scores::of(&perfect, &report.distances, self.request.seed);
            report.perfect = Some(scores);
            report.map = Some(spec.to_string());
        }
        Ok(true)
    }

    /// Compares contacts of an answer with those of its row.
    fn touch(&self, row: u32, found: &[FoundContact]) -> JobResult<Touch> {
        let touch = Touch::of_found(&self.truths(row), found, self.distances().ghost_mm);
        let wrong = |e: TouchError| LearnError::value("evaluation", "row", row, &e.to_string());
        Ok(touch.map_err(wrong)?)
    }

    /// Whether an answer, or one of its alternatives, is right; `None` if it states no probability, or a
    /// position is unknown.
    fn judged(&self, row: u32, reading: &Reading) -> JobResult<Option<JudgedAnswer>> {
        let Some(probability) = reading.probability else { return Ok(None) };
        let Some(right) = self.touch(row, &reading.contacts)?.is_right() else { return Ok(None) };
        let mut any_right = right;
        for other in &reading.alternatives {
            any_right |= self.touch(row, &other.contacts)?.is_right() == Some(true);
        }
        Ok(Some(JudgedAnswer { probability, right, any_right }))
    }

    /// Whether the standard deviation of a contact's position is within the requested limit.
    fn is_sure(&self, found: &FoundContact) -> bool {
        let sds = found.x_sd_mm.zip(found.y_sd_mm);
        let wanted = self.request.place_sd_mm.zip(sds);
        wanted.is_none_or(|(limit_mm, (x, y))| x.hypot(y) <= limit_mm * f64::sqrt(2.0))
    }

    /// True contacts of a row; their diameter is the tip's if none is stated.
    fn truths(&self, row: u32) -> Vec<Contact> {
        let tip_mm = self.gathered.skin.tip_diameter_mm;
        let known = |c: &Contact| Contact { diameter_mm: c.diameter_mm.or(tip_mm), ..*c };
        self.gathered.examples.contacts(row).iter().map(known).collect()
    }

    /// The frames of all rows, with what is known of them.
    ///
    /// # Errors
    /// `JobError::Learn` if a row cannot be read.
    pub(super) fn inputs(&self) -> JobResult<Vec<FrameInput>> {
        let rows = self.gathered.rows.iter().enumerate();
        rows.map(|(at, &row)| self.input(at, row)).collect()
    }

    /// The frame of the row at a place, with what is known of it.
    fn input(&self, at: usize, row: u32) -> JobResult<FrameInput> {
        let trial = self.gathered.examples.trial_id(row);
        Ok(FrameInput {
            voltages_v: self.frames(at, &[row])?,
            averaged: self.averaged(row),
            untouched: trial.and_then(|trial| self.untouched.of(trial)),
        })
    }

    /// Frames of rows, V, one after the other.
    fn frames(&self, first: usize, rows: &[u32]) -> JobResult<Vec<f32>> {
        if let Some(raw) = &self.raw {
            return Ok(raw[first..first + rows.len()].concat());
        }
        let channels = self.gathered.examples.channels;
        let mut frames = vec![0.0; channels * rows.len()];
        for (&row, frame) in rows.iter().zip(frames.chunks_exact_mut(channels)) {
            self.gathered.examples.frame(row, 0, frame)?;
        }
        Ok(frames)
    }

    /// Number of frames of which the frame of a row is the mean.
    fn averaged(&self, row: u32) -> f64 {
        let count = self.gathered.examples.frame_count(row);
        let single = self.raw.is_some() || count == 0;
        if single { 1.0 } else { f64::from(count) }
    }
}

/// Moments of the paper's four criteria, each contact a sample (V-C2).
fn cells(touches: &[Touch]) -> BTreeMap<String, Moments> {
    [
        ("number_percent", Metric::Number),
        ("location_mm", Metric::Location),
        ("force_percent", Metric::Force),
        ("diameter_percent", Metric::Diameter),
    ]
    .into_iter()
    .map(|(name, metric)| {
        let values = touches.iter().flat_map(|touch| touch.values_by_contact(metric));
        (name.to_owned(), values.collect())
    })
    .collect()
}
