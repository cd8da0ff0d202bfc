//! A skin that is ready for fits: its offsets, its errors, and its readings.
//! Uses: `skin_errors`, `rehearsal`, `untouched`, `zero`, `calibrate::judgement`, sim-core's `inverse::contacts`.
//! Never: files, threads.

use sim_core::forward::ForwardModel;
use sim_core::inverse::contacts::{
    ContactFitter, Explanation, Fit, FitOptions, FittedContact, Observation,
};

use super::rehearsal::LEAST_REHEARSED;
use super::skin_errors::{LEAST_KNOWN, SkinErrors, Stretch, grown};
use super::untouched::{Drift, LEAST_UNTOUCHED};
use super::zero::Zero;
use crate::calibrate::judgement;
use crate::ids::CalibrationId;
use crate::infer::answer::{Alternative, FoundContact, Reading};
use crate::infer::error::InferResult;
use crate::infer::untouched_frame::{UntouchedBefore, share_of_day};

/// Drift in a day, in standard deviations of the noise of a pair, from which offsets must be measured again.
const DRIFT_MATTERS: f64 = 2.0;
/// A fit whose residual exceeds this multiple of the assumed noise does not explain the frame.
const MISFIT_EXPLAINED: f64 = 3.0;

/// A skin for fits of contacts. Its preparation takes most of a minute.
pub struct ExactSkin {
    /// Id of its calibration; `None` for the nominal skin.
    calibration: Option<CalibrationId>,
    /// The run that it was calibrated to, if any.
    run: Option<String>,
    /// How its fit is worse than the model before it, if it is.
    pub(super) worse: Option<String>,
    /// Hash of its model.
    simulation: String,
    /// Width and height, mm.
    size_mm: [f64; 2],
    /// Offsets of the untouched frame, V.
    pub(super) offset_v: Vec<f64>,
    pub(super) errors: SkinErrors,
    pub(super) fitter: ContactFitter,
}

impl std::fmt::Debug for ExactSkin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ExactSkin").field("simulation", &self.simulation).finish_non_exhaustive()
    }
}

impl ExactSkin {
    /// Prepares a model with errors that were estimated earlier.
    ///
    /// # Errors
    /// `InferError::Fitter` if the tables of the fit cannot be computed.
    pub fn with(model: &ForwardModel, errors: SkinErrors) -> InferResult<Self> {
        let evidence = model.sensor().skin().map(|skin| &skin.evidence);
        Ok(Self {
            calibration: model.sensor().calibration().map(CalibrationId::unchecked),
            run: evidence.map(|evidence| evidence.run.clone()),
            worse: evidence.and_then(judgement::limitation),
            simulation: model.model_hash().into(),
            size_mm: [model.sensor().file.width_mm, model.sensor().file.height_mm],
            offset_v: model.sensor().offsets_v(),
            fitter: ContactFitter::new(model, &errors.model, FitOptions::default())?,
            errors,
        })
    }

    /// Width and height, mm.
    pub fn size_mm(&self) -> [f64; 2] {
        self.size_mm
    }

    /// What limits the answers of this skin, if anything is known to.
    pub fn limitation(&self) -> Option<String> {
        match (&self.worse, self.unknown()) {
            (Some(worse), Some(unknown)) => Some(format!("{worse}; {unknown}")),
            (worse, unknown) => worse.clone().or(unknown),
        }
    }

    /// What is not known about the errors of this skin, if anything.
    fn unknown(&self) -> Option<String> {
        let of_run = || match &self.run {
            Some(run) => format!("the run {run}, to which it was calibrated,"),
            None => "a Real-Hex or imported run on this sensor".to_owned(),
        };
        match &self.errors {
            SkinErrors { learnt_from: 0, .. } => Some(format!(
                "the errors of the skin's model are unknown: the database has fewer than {LEAST_KNOWN} trials of \
                 {} of 1 to 3 contacts that it was not fitted to; every misfit counts as noise",
                of_run()
            )),
            SkinErrors { rehearsal: None, .. } => Some(format!(
                "95 % regions were not compared with known contacts: fewer than {LEAST_REHEARSED} \
                 trials of {} that it was not fitted to have forces of 5 N and more only, or all are of one \
                 configuration",
                of_run()
            )),
            SkinErrors { drift: Drift { day_sd_v: None, .. }, .. } => Some(format!(
                "the drift of the offsets is unknown: the database has fewer than {LEAST_UNTOUCHED} untouched trials \
                 of {}; standard deviations do not grow with the age of the untouched frame",
                of_run()
            )),
            _ => None,
        }
    }

    /// The estimated errors of the model.
    pub fn errors(&self) -> &SkinErrors {
        &self.errors
    }

    /// Id of the run that it was calibrated to, if any.
    pub fn run(&self) -> Option<&str> {
        self.run.as_deref()
    }

    /// Id of its calibration, if any.
    pub fn calibration(&self) -> Option<&CalibrationId> {
        self.calibration.as_ref()
    }

    /// Id of the model in answers: the calibration's, or else the hash of the model.
    pub fn id(&self) -> &str {
        self.calibration.as_ref().map_or(self.simulation.as_str(), CalibrationId::as_str)
    }

    /// Simulation id of its model.
    pub fn simulation(&self) -> &str {
        &self.simulation
    }

    /// Number of voltages in a frame.
    pub fn channels(&self) -> usize {
        self.offset_v.len()
    }

    /// The untouched skin, if its offsets are better than those of the calibration.
    pub(super) fn better<'a>(
        &self,
        untouched: Option<&'a UntouchedBefore>,
    ) -> Option<&'a UntouchedBefore> {
        let fits = |skin: &&UntouchedBefore| skin.voltages_v.len() == self.channels();
        let day_sd_v = self.errors.drift.day_sd_v;
        let is_better = |skin: &&UntouchedBefore| {
            day_sd_v.is_none_or(|day_sd_v| self.offset_sd_v(Some(skin)) < day_sd_v)
        };
        untouched.filter(fits).filter(is_better)
    }

    /// Standard deviation of the residual of an offset, V: at least the noise of the untouched frame.
    pub(super) fn offset_sd_v(&self, untouched: Option<&UntouchedBefore>) -> f64 {
        let pairs = self.channels().isqrt() as f64;
        let noise_v =
            |skin: &UntouchedBefore| self.errors.noise_sd_v / (pairs * skin.frames).sqrt();
        self.errors.drift.after_v(untouched).max(untouched.map_or(0.0, noise_v))
    }

    /// Warns of offsets that may have drifted by more than the noise of a mean of `frames` frames. `zero_hours`: process
    /// time since the untouched skin was measured, h, if it was.
    fn drifted(&self, zero_hours: Option<f64>, frames: f64) -> Option<String> {
        let drift = &self.errors.drift;
        let pairs = self.channels().isqrt() as f64;
        let limit_v = DRIFT_MATTERS * self.errors.noise_sd_v / (pairs * frames).sqrt();
        let of_day_v = drift.day_sd_v.unwrap_or(0.0);
        let Some(hours) = zero_hours else {
            return (of_day_v > limit_v).then(|| {
                let drift_mv = 1e3 * of_day_v;
                format!("offsets of the calibration, which drift by {drift_mv:.2} mV a day: tare the empty skin")
            });
        };
        let since_v = share_of_day(hours) * of_day_v;
        // A new zero would not be better by more than its scatter.
        (since_v > limit_v.max(drift.sd_v(Some(0.0)))).then(|| {
            let drift_mv = 1e3 * since_v;
            format!(
                "the untouched skin was measured {hours:.1} h before, since when offsets drift by \
                 {drift_mv:.2} mV: tare the empty skin"
            )
        })
    }

    /// Contacts of a fit, strongest first, with standard deviations that allow for the model's error and for what answers
    /// to known trials showed.
    fn found(&self, contacts: &[FittedContact]) -> Vec<FoundContact> {
        let Stretch { place, force } = self.errors.stretch;
        let rehearsal = self.errors.rehearsal.as_ref();
        let seen = rehearsal.map(|rehearsal| rehearsal.of_contacts(contacts));
        let (places, forces) = seen.map_or((1.0, 1.0), |seen| (seen.place, seen.force));
        let contact = |found: &FittedContact| FoundContact {
            x_mm: found.contact.x_mm,
            y_mm: found.contact.y_mm,
            force_n: Some(found.contact.force_n),
            x_sd_mm: Some(places * found.x_sd_mm * grown(found.by_model[0], place)),
            y_sd_mm: Some(places * found.y_sd_mm * grown(found.by_model[1], place)),
            force_sd_n: Some(forces * found.force_sd_n * grown(found.by_model[2], force)),
            ..FoundContact::default()
        };
        let mut contacts: Vec<FoundContact> = contacts.iter().map(contact).collect();
        contacts.sort_by(|a, b| b.force_n.unwrap_or(0.0).total_cmp(&a.force_n.unwrap_or(0.0)));
        contacts
    }

    /// Converts the fit of a mean of `frames` frames to a reading. `zero_hours`: process time since the untouched
    /// skin was measured, h, if it was.
    pub(super) fn reading(&self, fit: &Fit, zero_hours: Option<f64>, frames: f64) -> Reading {
        let alternative = |other: &Explanation| Alternative {
            probability: other.probability,
            contacts: self.found(&other.contacts),
        };
        let misfit = fit.chi2 / fit.degrees_of_freedom;
        let outside = (misfit > MISFIT_EXPLAINED).then(|| {
            format!("misfit = {misfit:.1}: limit {MISFIT_EXPLAINED} for contacts on this skin")
        });
        let outside = outside.into_iter().collect();
        let notes = self.drifted(zero_hours, frames).into_iter().collect();
        Reading {
            contacts: self.found(&fit.contacts),
            probability: fit.probability,
            alternatives: fit.alternatives.iter().map(alternative).collect(),
            misfit: Some(misfit),
            misfit_limit: Some(MISFIT_EXPLAINED),
            outside,
            notes,
            ..Reading::default()
        }
    }

    /// Subtracts the offsets of the untouched skin from a frame, V: those of the calibration, and their
    /// drift since, if the untouched skin was measured.
    pub(super) fn take_offsets(
        &self,
        frame: &[f32],
        untouched: Option<&UntouchedBefore>,
        frame_v: &mut Vec<f64>,
    ) {
        self.take_calibrated(frame, frame_v);
        if let Some(untouched) = untouched {
            let mut drifted_v = Vec::new();
            self.take_calibrated(&untouched.voltages_v, &mut drifted_v);
            Zero::of(&drifted_v).take_off(frame_v);
        }
    }

    pub(super) fn take_calibrated(&self, frame: &[f32], frame_v: &mut Vec<f64>) {
        frame_v.clear();
        let offsets = self.offset_v.iter();
        frame_v.extend(frame.iter().zip(offsets).map(|(v, offset)| f64::from(*v) - offset));
    }

    /// A mean of `frames` frames without offsets, V, as the fit reads it.
    pub(super) fn observation<'a>(
        &'a self,
        frame_v: &'a [f64],
        frames: f64,
        untouched: Option<&'a UntouchedBefore>,
    ) -> Observation<'a> {
        let offset_sd_v = self.offset_sd_v(untouched);
        let offset_spectrum = self.errors.drift.spectrum_after(untouched);
        Observation { frame_v, frames, offset_sd_v, offset_spectrum }
    }
}
