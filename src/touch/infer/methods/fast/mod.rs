//! Contacts from Point-Net's answer: the probabilities of neighbouring points are pooled
//! (`docs/references.md`, "Feasibility study").
//! Uses: `infer::registry`. Never: the exact model, files.
//!
//! In the order of decreasing probability: the probability of a point and those of the free points
//! within 36 mm are pooled into one candidate at their weighted mean; these points are then used.

use std::sync::Arc;

use super::{Frames, ReadyMethod};
use crate::ids::ModelId;
use crate::infer::answer::{FoundContact, Reading};
use crate::infer::error::InferResult;
use crate::infer::maps::ForceMaps;
use crate::infer::registry::Model;
use crate::learn::task::Answers;

/// Points within this distance belong to one contact, mm: the second ring of points, at 34.6 mm, is
/// the smallest distance of another tip of the indenter. Without that ring the counts of 600 trials
/// of weights were worse (44 % right instead of 50 %, one Point-Net).
const POOL_MM: f64 = 36.0;
/// Points below this probability do not start a candidate.
const SEED_PROBABILITY: f64 = 0.02;
/// Pooled probability from which a candidate is proposed to the exact method.
pub const PROPOSED: f64 = 0.15;
/// Pooled probability from which a candidate is reported as a contact.
pub const SAID: f64 = 0.5;

/// A net with answers per point.
#[derive(Debug, Clone)]
pub struct PointPipeline {
    model: Arc<Model>,
}

impl PointPipeline {
    /// Wraps a Point-Net.
    ///
    /// # Errors
    /// `InferError::OtherTask` if the model is not a Point-Net.
    pub fn new(model: Arc<Model>) -> InferResult<Self> {
        if model.manifest.model.task.answers() != Answers::Points {
            return Err(model.of_other_task("a Point-Net is needed"));
        }
        Ok(Self { model })
    }

    /// Model of the net.
    pub fn net(&self) -> &Model {
        &self.model
    }

    /// Id of the model.
    pub fn model(&self) -> &ModelId {
        &self.model.manifest.id
    }

    /// Returns the candidates of each frame (V, one after the other) with at least the pooled
    /// probability `least`, the most probable first.
    ///
    /// # Errors
    /// `InferError::Plan` if the net fails on a frame.
    pub fn candidates(&self, frames: &[f32], least: f64) -> InferResult<Vec<Vec<FoundContact>>> {
        let mut answers = Vec::new();
        self.model.plan.answer(frames, &mut answers)?;
        let points = &self.model.points_mm;
        let answers = answers.chunks_exact(2 * points.len());
        Ok(answers.map(|answer| pool(points, answer, least)).collect())
    }
}

impl ReadyMethod for PointPipeline {
    fn read(&self, frames: &Frames<'_>, _: ForceMaps) -> InferResult<Vec<Reading>> {
        let range = &self.model.manifest.model.trained_on;
        let candidates = self.candidates(frames.voltages_v, SAID)?;
        let frames = frames.voltages_v.chunks_exact(self.model.plan.channels());
        let read = |(frame, mut contacts): (&[f32], Vec<FoundContact>)| {
            contacts.sort_by(|a, b| {
                b.force_n.partial_cmp(&a.force_n).unwrap_or(std::cmp::Ordering::Equal)
            });
            let forces_n: Vec<f64> = contacts.iter().filter_map(|c| c.force_n).collect();
            let outside = range.frame(frame).into_iter().chain(range.answer(&forces_n));
            let outside = outside.map(|out| out.to_string()).collect();
            Reading { contacts, outside, ..Reading::default() }
        };
        Ok(frames.zip(candidates).map(read).collect())
    }
    fn nets(&self) -> Vec<&Model> {
        vec![self.net()]
    }

    fn size_mm(&self) -> [f64; 2] {
        self.model.size_mm()
    }
}

/// Candidates from logits and log-forces (`[2][points]`).
fn pool(points_mm: &[[f64; 2]], answer: &[f32], least: f64) -> Vec<FoundContact> {
    let (logits, ln_forces) = answer.split_at(points_mm.len());
    let probability: Vec<f64> =
        logits.iter().map(|&logit| 1.0 / (1.0 + f64::from(-logit).exp())).collect();
    let mut order: Vec<usize> =
        (0..points_mm.len()).filter(|&p| probability[p] >= SEED_PROBABILITY).collect();
    order.sort_by(|&a, &b| probability[b].total_cmp(&probability[a]));
    let mut taken = vec![false; points_mm.len()];
    let mut found = Vec::new();
    for seed in order {
        if taken[seed] {
            continue;
        }
        let (mut sum, mut place, mut ln_force) = (0.0, [0.0; 2], 0.0);
        for (point, [x, y]) in points_mm.iter().enumerate() {
            let [x0, y0] = points_mm[seed];
            if !taken[point] && (x - x0).hypot(y - y0) <= POOL_MM {
                taken[point] = true;
                let p = probability[point];
                sum += p;
                place = [place[0] + p * x, place[1] + p * y];
                ln_force += p * f64::from(ln_forces[point]);
            }
        }
        if sum >= least {
            found.push(FoundContact {
                x_mm: place[0] / sum,
                y_mm: place[1] / sum,
                force_n: Some((ln_force / sum).exp()),
                presence: Some(sum.min(1.0)),
                ..FoundContact::default()
            });
        }
    }
    found.sort_by(|a, b| b.presence.partial_cmp(&a.presence).unwrap_or(std::cmp::Ordering::Equal));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points in a row, 20 mm apart.
    fn row() -> Vec<[f64; 2]> {
        (0..10).map(|i| [100.0 + 20.0 * f64::from(i), 200.0]).collect()
    }

    fn answer(of: &[(usize, f32, f32)]) -> Vec<f32> {
        let mut answer = vec![-12.0; 10];
        answer.extend([1.0; 10]);
        for &(point, logit, ln_force) in of {
            answer[point] = logit;
            answer[10 + point] = ln_force;
        }
        answer
    }

    #[test]
    fn neighbours_that_share_a_contact_are_one_candidate_between_them() {
        let answer = answer(&[(2, 0.0, 2.0), (3, 0.0, 2.0), (8, 5.0, 3.0)]);
        let found = pool(&row(), &answer, 0.15);
        assert_eq!(found.len(), 2);
        assert!((found[1].force_n.unwrap() - 3f64.exp()).abs() < 0.1, "{found:?}");
        assert!((found[0].x_mm - 150.0).abs() < 0.1 && found[0].presence.unwrap() > 0.99);
    }

    #[test]
    fn what_is_improbable_is_left_out() {
        assert_eq!(pool(&row(), &answer(&[(4, -1.0, 2.0)]), SAID), []);
        assert_eq!(pool(&row(), &answer(&[(4, -1.0, 2.0)]), PROPOSED).len(), 1);
        assert_eq!(pool(&row(), &answer(&[]), PROPOSED), []);
    }
}
