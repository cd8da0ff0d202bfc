//! An evaluation as a job: gathers rows, reads them by a method, scores the answers.
//! Uses: `evaluate`, `infer`, `learn::examples`, `dataset`. Never: HTTP, a number without its rows.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use nets::quantity::Quantity;
use serde_json::Value;
use sim_core::stats::{quantile, sorted};

use super::error::JobError;
use super::gathered::{Gathered, first_frames};
use super::{Jobs, Watch};
use crate::clock::Clock;
use crate::dataset::background::background;
use crate::dataset::build::data_file;
use crate::dataset::force_map::ForceMap;
use crate::evaluate::held_out::{Made, is_held_out};
use crate::evaluate::perfect::perfect;
use crate::evaluate::quantities::QuantityScores;
use crate::evaluate::request::{
    EvaluationReport, EvaluationRequest, Example, FramesRead, OffsetsRead, Scored,
};
use crate::evaluate::score::Scores;
use crate::evaluate::touch::{Metric, Touch};
use crate::evaluate::voltages::VoltageScores;
use crate::ids::{CalibrationId, DatasetId, TrialId};
use crate::infer::answer::FoundContact;
use crate::infer::error::InferError;
use crate::infer::maps::ForceMaps;
use crate::infer::methods::fast::PointPipeline;
use crate::infer::methods::{Frames, Models, ReadyMethod};
use crate::infer::registry::Model;
use crate::infer::slot::Slot;
use crate::infer::untouched::UntouchedSkins;
use crate::learn::error::LearnError;
use crate::learn::examples::{MEASURED, SIMULATED};
use crate::learn::targets::Targets;
use crate::learn::task::Reads;
use crate::simulate::compare::difference;
use crate::store::{Contact, DatasetRow, TaskRow};

/// Number of frames that a Transfer-Net reads at a time.
const TRANSFERRED_AT_ONCE: usize = 8;

/// Reader of the frames.
enum Reader {
    /// A Transfer-Net, or none: the frames themselves.
    Voltages(Option<Arc<Model>>),
    /// A net that answers a quantity.
    Quantity(Arc<Model>, Quantity),
    /// A method from a frame to contacts.
    Contacts(Box<dyn ReadyMethod>),
}

impl Reader {
    /// The method, if contacts are read.
    fn method(&self) -> Option<&dyn ReadyMethod> {
        match self {
            Self::Voltages(_) | Self::Quantity(..) => None,
            Self::Contacts(method) => Some(method.as_ref()),
        }
    }

    /// Nets that are used.
    fn nets(&self) -> Vec<&Model> {
        match self {
            Self::Voltages(transfer) => transfer.iter().map(Arc::as_ref).collect(),
            Self::Quantity(net, _) => vec![net],
            Self::Contacts(method) => method.nets(),
        }
    }

    /// Columns of frames that are needed.
    fn columns(&self) -> &'static [&'static str] {
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

/// Runs an evaluation; `None` if it was stopped.
pub(super) async fn run(
    jobs: &Jobs,
    job: &TaskRow,
    watch: &Arc<Watch>,
) -> Result<Option<Value>, JobError> {
    let request: EvaluationRequest =
        serde_json::from_value(job.request.clone()).map_err(JobError::Json)?;
    request.check()?;
    watch.phase("preparing the method", 0);
    let reader = reader(jobs, &request).await?;
    watch.phase("making the dataset", 0);
    let name = job.dataset.as_ref().map_or(request.dataset.as_str(), DatasetId::as_str);
    let dataset = jobs.inner.datasets.resolve(name).await?;
    jobs.inner.store.begin_task(job.id, Some(&dataset.id)).await?;
    let file = data_file(&jobs.inner.datasets.datasets(), &dataset.id);
    watch.phase("gathering frames", dataset.rows);
    let scratch = jobs.inner.data.join("cache");
    let columns = reader.columns();
    let measured = columns.contains(&MEASURED);
    if request.frames == FramesRead::First && !measured {
        let limit = "no measured frames are read: use mean, or name a Transfer-Net";
        return Err(LearnError::value("evaluation", "frames", "first", limit).into());
    }
    let requested = request.clone();
    let at = file.clone();
    let gathered = background(move || Gathered::new(&at, &requested, columns, &scratch)).await??;
    let raw = match request.frames {
        FramesRead::Mean => None,
        FramesRead::First => Some(first_frames(&jobs.inner.store, &gathered).await?),
    };
    let takes = reader.method().is_some_and(|method| method.takes_untouched());
    let untouched = match (request.offsets, takes) {
        (OffsetsRead::Untouched, true) => {
            UntouchedSkins::before(&jobs.inner.store, &gathered.trials()).await?
        }
        _ => UntouchedSkins::default(),
    };
    let held_out = held_out(jobs, &reader, &dataset, request.part.as_deref()).await?;
    let (watch, clock) = (watch.clone(), jobs.inner.clock.clone());
    let sensor = jobs.inner.serving.sensor();
    let rig_sensor = (sensor.file.name.clone(), sensor.channels());
    let scoring = Scoring {
        request,
        dataset,
        held_out,
        gathered,
        raw,
        untouched,
        reader,
        measured,
        rig_sensor,
        watch,
        clock,
    };
    let report = background(move || scoring.run()).await??;
    report.map(|report| serde_json::to_value(report).map_err(JobError::Json)).transpose()
}

async fn reader(jobs: &Jobs, request: &EvaluationRequest) -> Result<Reader, JobError> {
    let models = &jobs.inner.models;
    let load = async |name: &Option<String>| match name {
        Some(name) => models.load(name).await.map(Some),
        None => Ok(None),
    };
    let mut ready = Models {
        transfer: load(&request.transfer).await?,
        map: load(&request.map).await?,
        points: load(&request.points).await?.map(PointPipeline::new).transpose()?,
        threshold_n: request.threshold_n,
        ..Models::default()
    };
    let method = match request.scored {
        Scored::Voltages => return Ok(Reader::Voltages(ready.transfer)),
        Scored::Quantity => {
            let net = models.load(request.net.as_deref().unwrap_or_default()).await?;
            let quantity = net.quantity()?;
            return Ok(Reader::Quantity(net, quantity));
        }
        Scored::Method(method) => method,
    };
    if method.slots().contains(&Slot::Skin) {
        let (serving, calibration) = (&jobs.inner.serving, skin(jobs, request).await?);
        if method.is_fit() {
            // The preparation of a skin takes most of a minute: it is reused.
            serving.once_restored(None).await;
            ready.skin = Some(serving.skin(calibration.as_ref()).await?);
        } else {
            ready.forward = Some(Arc::new(serving.model(calibration.as_ref()).await?));
        }
    }
    Ok(Reader::Contacts(background(move || method.ready(&ready)).await??))
}

/// Whether none of the scored rows can have been used to train a net of the reader.
async fn held_out(
    jobs: &Jobs,
    reader: &Reader,
    dataset: &DatasetRow,
    part: Option<&str>,
) -> Result<bool, JobError> {
    let scored = Made { definition: &dataset.definition, lineage: &dataset.lineage };
    for id in reader.nets().iter().flat_map(|net| &net.manifest.model.datasets) {
        // The lineage of an unknown dataset is unknown.
        let Some(row) = jobs.inner.store.dataset(id).await? else { continue };
        let learned = Made { definition: &row.definition, lineage: &row.lineage };
        if !is_held_out(part, &scored, &learned) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Id of the calibration of the exact model: the named one, or else the serving one.
async fn skin(jobs: &Jobs, request: &EvaluationRequest) -> Result<Option<CalibrationId>, JobError> {
    match &request.skin {
        Some(skin) => Ok(Some(skin.clone())),
        None => Ok(jobs.inner.serving.promoted_skin().await?),
    }
}

/// Inputs of the scoring.
struct Scoring {
    request: EvaluationRequest,
    dataset: DatasetRow,
    /// Whether none of the rows can have been used to train a net.
    held_out: bool,
    gathered: Gathered,
    raw: Option<Vec<Vec<f32>>>,
    /// The untouched skin before the rows.
    untouched: UntouchedSkins,
    reader: Reader,
    /// Whether measured frames are read.
    measured: bool,
    /// Name and channels of the rig's sensor, which is that of the exact model.
    rig_sensor: (String, usize),
    watch: Arc<Watch>,
    clock: Clock,
}

impl Scoring {
    fn run(self) -> Result<Option<EvaluationReport>, JobError> {
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
    fn check_sensor(&self) -> Result<(), InferError> {
        let here = &self.gathered.sensor;
        let nets = self.reader.nets().into_iter().map(|net| {
            let facts = &net.manifest.model;
            (net.manifest.id.to_string(), facts.sensor.clone(), facts.channels)
        });
        let skin = self.reader.method().and_then(|method| method.skin());
        let of_rig =
            skin.map(|skin| (skin.id.to_owned(), self.rig_sensor.0.clone(), self.rig_sensor.1));
        let same = |(_, sensor, channels): &(String, String, usize)| {
            *sensor == here.name && *channels == here.channels
        };
        match nets.chain(of_rig).find(|model| !same(model)) {
            None => Ok(()),
            Some((id, sensor, channels)) => Err(InferError::OtherSensor {
                id,
                sensor,
                channels,
                here: format!("{} with {}", here.name, here.channels),
            }),
        }
    }

    /// Restrictions on the validity of the scores.
    fn notes(&self) -> Vec<String> {
        let run = self.reader.method().and_then(|method| method.skin()?.run);
        let runs = self.dataset.lineage["runs"].as_array().into_iter().flatten();
        let seen = run.filter(|run| runs.into_iter().any(|r| r["uid"].as_str() == Some(run)));
        let seen = seen.map(|run| {
            format!("the skin was calibrated to trials of run {run}, which are in the dataset")
        });
        let learned = (!self.held_out)
            .then(|| "the rows may include rows that the nets were trained on".to_owned());
        seen.into_iter().chain(learned).collect()
    }

    fn blank(&self) -> EvaluationReport {
        let models = self.reader.nets().iter().map(|net| net.manifest.id.clone()).collect();
        let skin = self.reader.method().and_then(|method| method.skin());
        let calibration = skin.and_then(|skin| skin.calibration.cloned());
        let label = self.dataset.lineage["runs"][0]["label"].as_str();
        EvaluationReport {
            scored: self.request.scored,
            dataset: self.dataset.id.clone(),
            part: self.request.part.clone(),
            held_out: self.held_out,
            conditions: self.request.conditions.clone(),
            frames: self.request.frames,
            label: label.filter(|_| self.measured).unwrap_or("simulated").into(),
            models,
            calibration,
            rows: self.gathered.rows.len() as u64,
            threshold_n: self.request.threshold_n,
            place_sd_mm: self.request.place_sd_mm,
            contacts: None,
            perfect: None,
            map: None,
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
    fn voltages(
        &self,
        transfer: Option<&Model>,
        report: &mut EvaluationReport,
    ) -> Result<bool, JobError> {
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
                let fit = difference(&target, answer);
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
    ) -> Result<bool, JobError> {
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
            return Err(LearnError::value("evaluation", "dataset", &self.dataset.id, &limit).into());
        }
        Ok(true)
    }

    /// Scores contacts; returns `false` if it was stopped.
    fn contacts(
        &self,
        method: &dyn ReadyMethod,
        report: &mut EvaluationReport,
    ) -> Result<bool, JobError> {
        let began_s = self.clock.process_s();
        let (mut touches, mut latencies) = (Vec::new(), Vec::new());
        let mut calibrated = 0;
        // One frame at a time, as on a rig: the latency is measured.
        for (at, rows) in self.gathered.rows.chunks(1).enumerate() {
            let voltages_v = self.frames(at, rows)?;
            let trial = self.gathered.examples.trial_id(rows[0]);
            let untouched = trial.and_then(|trial| self.untouched.of(TrialId(trial)));
            calibrated += u64::from(untouched.is_none());
            let (averaged, untouched) = (self.averaged(rows[0]), untouched.as_ref());
            let frames = Frames { voltages_v: &voltages_v, averaged, untouched };
            let before_s = self.clock.process_s();
            let shown = (self.request.examples as usize).saturating_sub(report.examples.len());
            let readings = method.read(&frames, ForceMaps::if_wanted(shown > 0))?;
            latencies.push(1e3 * (self.clock.process_s() - before_s));
            for (&row, reading) in rows.iter().zip(&readings) {
                let sure = reading.contacts.iter().filter(|found| self.is_sure(found));
                let found: Vec<Contact> = sure.map(Contact::from).collect();
                let touch = Touch::of(&self.truths(row), &found);
                touches
                    .push(touch.map_err(|e| {
                        LearnError::value("evaluation", "row", row, &e.to_string())
                    })?);
            }
            let examples = rows.iter().zip(readings).take(shown);
            report.examples.extend(
                examples.map(|(&row, reading)| Example { truth: self.truths(row), reading }),
            );
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
        report.contacts = Some(Scores::of(&touches, self.request.seed));
        report.cells = Some(cells(&touches));
        let spec = method.map();
        let skin = &self.gathered.skin;
        let draws = ForceMap::new(spec, [skin.width_mm, skin.height_mm]);
        let draws = draws.map_err(InferError::from)?;
        let truths: Vec<Vec<Contact>> =
            self.gathered.rows.iter().map(|&row| self.truths(row)).collect();
        let truths = truths.iter().map(Vec::as_slice);
        let perfect = perfect(&draws, truths, self.request.threshold_n).map_err(|error| {
            LearnError::value("evaluation", "dataset", &self.dataset.id, &error.to_string())
        })?;
        if !perfect.is_empty() {
            report.perfect = Some(Scores::of(&perfect, self.request.seed));
            report.map = Some(spec.to_string());
        }
        Ok(true)
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

    /// Frames of rows, V, one after the other.
    fn frames(&self, first: usize, rows: &[u32]) -> Result<Vec<f32>, JobError> {
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
fn cells(touches: &[Touch]) -> BTreeMap<String, crate::evaluate::anova::Moments> {
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
