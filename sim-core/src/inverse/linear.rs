//! Physics-based one-step reconstruction: a linear model of the frame, inverted with a penalty.
//! Uses: the forward model, faer's SVD. Never: iterations on the non-linear model, the form of a
//! force map.
//!
//! The baseline of the paper's Supplement S-VI and Fig. 12:
//! `f = argmin |J f - v|^2 + lambda |R f|^2` with R the identity (Tikhonov) or `R'R = diag(J'J)`
//! (NOSER, Cheney et al. 1990). Columns of J are frames per newton on each of the sensor's points.
//! The foam does not conduct until it is pressed, so the untouched skin has no slope: J is a secant
//! from the untouched skin to a stated force.

use faer::Mat;

use crate::forward::{Contact, ContactError, ForwardModel, Workspace};

/// Number of penalties that are compared, from the largest squared singular value down.
const PENALTIES: usize = 121;
/// Range of the compared penalties, in powers of ten.
const DECADES: f64 = 12.0;

/// Why a reconstruction is impossible.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum LinearError {
    /// The model rejects the load.
    #[error("linear model: {0}")]
    Load(#[from] ContactError),
    /// The singular values did not converge.
    #[error("linear model: singular values did not converge")]
    SingularValues,
    /// No point changes the frame at this force.
    #[error(
        "linear model: no point changes the frame at the force of the slopes; take a larger one"
    )]
    Flat,
    /// The frame has the wrong length.
    #[error("linear reconstruction: a frame of {found} voltages, {needed} needed")]
    Length { found: usize, needed: usize },
    /// A voltage is not finite.
    #[error("linear reconstruction: voltage {channel} is not a finite number")]
    NotFinite { channel: usize },
    /// The penalty is not a finite number > 0.
    #[error("linear reconstruction: penalty = {penalty} is not a finite number > 0")]
    Penalty { penalty: f64 },
}

/// The norm that is penalised.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Regularisation {
    /// All forces with the same weight.
    Tikhonov,
    /// Each force in proportion to its effect on the frame.
    Noser,
}

/// Choice of the penalty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Penalty {
    /// Least generalised cross-validation score (Golub, Heath, Wahba 1979).
    Gcv,
    /// A share of the largest squared singular value.
    Share(f64),
}

/// Frames per newton, V/N, on each point.
#[derive(Debug, Clone, PartialEq)]
pub struct PointSlopes {
    columns: Vec<f64>,
    /// Frame of the untouched skin, V.
    about_v: Vec<f64>,
}

impl PointSlopes {
    /// Slopes from the untouched skin to a force on each point alone, N.
    ///
    /// # Errors
    /// `LinearError::Load` if the model rejects the force.
    pub fn secant(model: &ForwardModel, force_n: f64) -> Result<Self, LinearError> {
        let mut work = Workspace::default();
        let about_v = model.voltages(&[], &mut work)?.to_vec();
        let points = model.sensor().points();
        let mut columns = Vec::with_capacity(points.len() * about_v.len());
        for p in points {
            let contact = Contact { x_mm: p.x_mm, y_mm: p.y_mm, force_n };
            let frame = model.voltages(&[contact], &mut work)?;
            columns.extend(frame.iter().zip(&about_v).map(|(v, rest)| (v - rest) / force_n));
        }
        Ok(Self { columns, about_v })
    }

    /// The column of a point, V/N.
    pub fn of(&self, point: usize) -> &[f64] {
        &self.columns[point * self.about_v.len()..][..self.about_v.len()]
    }
}

/// A decomposed linear model.
#[derive(Debug, Clone)]
pub struct OneStep {
    about_v: Vec<f64>,
    /// Singular values, largest first.
    values: Vec<f64>,
    /// Left vectors, one after the other.
    left: Vec<f64>,
    /// Right vectors, each force divided by the root of its penalty.
    right: Vec<f64>,
}

/// Forces that explain a frame to first order.
#[derive(Debug, Clone, PartialEq)]
pub struct Reconstruction {
    /// Force on each of the sensor's points, N; may be negative.
    pub forces_n: Vec<f64>,
    /// The penalty, as a share of the largest squared singular value.
    pub penalty: f64,
    /// Length of the residual of the frame, V.
    pub residual_v: f64,
}

/// A frame in terms of the left vectors.
struct Along {
    /// Components along the left vectors.
    parts: Vec<f64>,
    /// Squared norm of the part that no force explains, V^2.
    outside_v2: f64,
}

impl OneStep {
    /// Decomposes the slopes; takes 1 s to 2 s.
    ///
    /// # Errors
    /// `LinearError::Flat` if no point changes the frame; `LinearError::SingularValues` without
    /// convergence.
    pub fn new(slopes: &PointSlopes, regularisation: Regularisation) -> Result<Self, LinearError> {
        let channels = slopes.about_v.len();
        let points = slopes.columns.len() / channels;
        let length = |point: usize| slopes.of(point).iter().map(|v| v * v).sum::<f64>().sqrt();
        let lengths: Vec<f64> = (0..points).map(length).collect();
        let longest = lengths.iter().copied().fold(0.0, f64::max);
        if !(longest > 0.0 && longest.is_finite()) {
            return Err(LinearError::Flat);
        }
        let roots: Vec<f64> = match regularisation {
            Regularisation::Tikhonov => vec![1.0; points],
            // Avoids a division by zero for a point without effect.
            Regularisation::Noser => lengths.iter().map(|l| l.max(1e-6 * longest)).collect(),
        };
        let scaled = Mat::from_fn(channels, points, |i, j| slopes.of(j)[i] / roots[j]);
        let svd = scaled.thin_svd().map_err(|_| LinearError::SingularValues)?;
        let rank = channels.min(points);
        let values: Vec<f64> = (0..rank).map(|i| svd.S()[i]).collect();
        let (u, v) = (svd.U(), svd.V());
        let left = (0..rank).flat_map(|k| (0..channels).map(move |i| (i, k))).map(|at| u[at]);
        let right = (0..rank).flat_map(|k| (0..points).map(move |j| (j, k)));
        Ok(Self {
            about_v: slopes.about_v.clone(),
            left: left.collect(),
            right: right.map(|(j, k)| v[(j, k)] / roots[j]).collect(),
            values,
        })
    }

    /// Returns the forces of a frame, V.
    ///
    /// # Errors
    /// `Length` or `NotFinite` if the frame is invalid; `Penalty` if a given share is not positive.
    pub fn solve(&self, frame_v: &[f64], penalty: Penalty) -> Result<Reconstruction, LinearError> {
        let along = self.along(frame_v)?;
        let largest = self.values[0].powi(2);
        let share = match penalty {
            Penalty::Share(share) if share > 0.0 && share.is_finite() => share,
            Penalty::Share(penalty) => return Err(LinearError::Penalty { penalty }),
            Penalty::Gcv => self.least_gcv(&along),
        };
        let penalty_v2 = share * largest;
        let points = self.right.len() / self.values.len();
        let mut forces_n = vec![0.0; points];
        for ((part, value), right) in
            along.parts.iter().zip(&self.values).zip(self.right.chunks_exact(points))
        {
            let weight = part * value / (value * value + penalty_v2);
            forces_n.iter_mut().zip(right).for_each(|(f, r)| *f += weight * r);
        }
        let (residual_v2, _) = self.lengths(&along, penalty_v2);
        Ok(Reconstruction { forces_n, penalty: share, residual_v: residual_v2.sqrt() })
    }

    fn along(&self, frame_v: &[f64]) -> Result<Along, LinearError> {
        let needed = self.about_v.len();
        if frame_v.len() != needed {
            return Err(LinearError::Length { found: frame_v.len(), needed });
        }
        if let Some(channel) = frame_v.iter().position(|v| !v.is_finite()) {
            return Err(LinearError::NotFinite { channel });
        }
        let change: Vec<f64> = frame_v.iter().zip(&self.about_v).map(|(v, a)| v - a).collect();
        let part = |left: &[f64]| left.iter().zip(&change).map(|(l, c)| l * c).sum::<f64>();
        let parts: Vec<f64> = self.left.chunks_exact(needed).map(part).collect();
        let square = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>();
        let outside_v2 = (square(&change) - square(&parts)).max(0.0);
        Ok(Along { parts, outside_v2 })
    }

    /// Squared lengths of the residual and of the penalised forces.
    fn lengths(&self, along: &Along, penalty_v2: f64) -> (f64, f64) {
        let terms = along.parts.iter().zip(&self.values).map(|(part, value)| {
            let kept = value * value / (value * value + penalty_v2);
            let force = if *value > 0.0 { kept * part / value } else { 0.0 };
            (((1.0 - kept) * part).powi(2), force * force)
        });
        terms.fold((along.outside_v2, 0.0), |sum, term| (sum.0 + term.0, sum.1 + term.1))
    }

    /// Generalised cross-validation at a penalty: `|J f - v|^2 / trace(I - A)^2`, V^2, A the map from the frame
    /// to its fit.
    fn gcv(&self, along: &Along, penalty_v2: f64) -> f64 {
        let kept: f64 =
            self.values.iter().map(|value| value * value / (value * value + penalty_v2)).sum();
        let free = self.about_v.len() as f64 - kept;
        self.lengths(along, penalty_v2).0 / (free * free)
    }

    /// Shares of the largest squared singular value that are compared.
    fn shares() -> impl Iterator<Item = f64> {
        let step = DECADES / (PENALTIES - 1) as f64;
        (0..PENALTIES).map(move |i| 10f64.powf(-step * i as f64))
    }

    fn least_gcv(&self, along: &Along) -> f64 {
        let largest = self.values[0].powi(2);
        let scored = Self::shares().map(|share| (share, self.gcv(along, share * largest)));
        scored.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(1.0, |best| best.0)
    }
}
