//! Candidate contacts: hypotheses with one contact more or less, from the table of shapes.
//! Uses: `shapes`, `descent`. Never: the exact model.
//!
//! A beam of hypotheses grows by one contact at a time. The position of the next one: at every site
//! the part of a contact's frame that the present contacts cannot imitate is compared with the
//! residual. Each new hypothesis is fitted as a whole before it is ranked.
//! A change of what it finds increases `READINGS_VERSION` of the jobs, too: machines of one version must find the same.

use super::FitOptions;
use super::basis::Projected;
use super::dense::{PAD, dot};
use super::descent::{DescentWork, EACH, Effort, Predict, Prior, Problem, descend};
use super::shapes::{Place, Shapes};
use super::whitener::Whitener;
use crate::forward::{ContactResult, ForwardModel};

/// Number of hypotheses of each count that are extended.
const BEAM: usize = 4;
/// Number of places tried for the next contact of each hypothesis.
const PICKS: usize = 6;
/// Smallest distance between those places, mm.
const APART_MM: f64 = 30.0;
/// Force at which the shape of a site is evaluated, N.
const SITE_N: f64 = 9.0;
/// Range of the first estimate of the force at a site, as ln N.
const FIRST_LN_FORCE: [f64; 2] = [0.7, 4.1];
/// A count whose score is worse than the best by this (in -2 ln evidence) is not extended.
const HOPELESS: f64 = 16.0;
/// Hypotheses whose contacts all agree to this distance are the same, mm.
const SAME_HYPOTHESIS_MM: f64 = 8.0;
pub(super) const EFFORT: Effort = Effort { iterations: 12, tolerance: 0.05 };

/// A candidate load.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Hypothesis {
    pub places: Vec<Place>,
    /// -2 ln evidence, up to a constant of the frame.
    pub score: f64,
}

/// Memory of a search; may be reused.
#[derive(Debug, Default)]
pub(super) struct SearchWork {
    descent: DescentWork,
    residual: Vec<f64>,
    tangents: Vec<f64>,
    gains: Vec<(f64, f64)>,
    /// Frame of each site, whitened.
    sites: Vec<f64>,
}

/// The table as a model: frames of contacts are sums, which are whitened.
pub(super) struct Sum<'a> {
    pub model: &'a ForwardModel,
    pub shapes: &'a Shapes,
    pub whitener: &'a Whitener,
    /// Difference of the exact model from the sum, at the load of the last comparison, whitened.
    pub lacks: &'a [f64],
}

impl Predict for Sum<'_> {
    fn predict(
        &mut self,
        places: &[Place],
        z: &mut Vec<f64>,
        slopes: &mut Vec<f64>,
    ) -> ContactResult<()> {
        z.clear();
        z.resize(self.lacks.len(), 0.0);
        slopes.resize(z.len() * EACH * places.len(), 0.0);
        for (place, slopes) in places.iter().zip(slopes.chunks_exact_mut(EACH * z.len())) {
            self.shapes.add(self.model, *place, z, slopes);
        }
        self.whitener.apply(z);
        self.whitener.apply(slopes);
        z.iter_mut().zip(self.lacks).for_each(|(z, lacks)| *z += lacks);
        Ok(())
    }
}

/// A search through one frame.
pub(super) struct Search<'a> {
    pub model: &'a ForwardModel,
    pub shapes: &'a Shapes,
    pub frame: &'a Projected,
    pub prior: &'a Prior,
    pub options: &'a FitOptions,
    pub none: &'a [f64],
}

impl Search<'_> {
    /// Returns hypotheses of all counts, best first; `starts` are tried in addition to those found.
    ///
    /// # Errors
    /// `ContactError` if the model rejects a contact.
    pub fn run(
        &self,
        starts: &[Vec<Place>],
        work: &mut SearchWork,
    ) -> ContactResult<Vec<Hypothesis>> {
        work.sites.clear();
        for site in 0..self.shapes.sites_mm().len() {
            let row = self.shapes.of_site(site, SITE_N.ln());
            work.sites.extend(row.iter().map(|s| f64::from(*s)));
        }
        self.frame.whitener.apply(&mut work.sites);
        let mut levels: Vec<Vec<Hypothesis>> = vec![Vec::new(); self.options.most_contacts + 1];
        self.judge(Vec::new(), &mut levels, work)?;
        for start in starts {
            self.judge(start.clone(), &mut levels, work)?;
        }
        let mut best = f64::INFINITY;
        for count in 0..self.options.most_contacts {
            let here = levels[count].first().map_or(f64::INFINITY, |h| h.score);
            best = best.min(here);
            if here > best + HOPELESS {
                break;
            }
            for parent in levels[count].iter().take(BEAM).cloned().collect::<Vec<_>>() {
                for child in self.grown(&parent, work)? {
                    self.judge(child, &mut levels, work)?;
                }
            }
        }
        // Backwards: each larger hypothesis without one of its contacts.
        for count in (1..=self.options.most_contacts).rev() {
            for parent in levels[count].iter().take(1).cloned().collect::<Vec<_>>() {
                for without in 0..count {
                    let mut places = parent.places.clone();
                    places.remove(without);
                    self.judge(places, &mut levels, work)?;
                }
            }
        }
        let mut all: Vec<Hypothesis> = levels.into_iter().flatten().collect();
        all.sort_by(|a, b| a.score.total_cmp(&b.score));
        Ok(all)
    }

    /// Fits a hypothesis and stores it under its count, best first.
    fn judge(
        &self,
        mut places: Vec<Place>,
        levels: &mut [Vec<Hypothesis>],
        work: &mut SearchWork,
    ) -> ContactResult<()> {
        let Some(level) = levels.get_mut(places.len()) else { return Ok(()) };
        let mut sum = self.sum();
        let problem = self.problem();
        let optimum = descend(&problem, &mut sum, &mut places, EFFORT, &mut work.descent)?;
        if closest_mm(&places) < self.options.least_distance_mm || !optimum.score.is_finite() {
            return Ok(());
        }
        let hypothesis = Hypothesis { places, score: optimum.score };
        if let Some(twin) = level.iter_mut().find(|h| same(&h.places, &hypothesis.places)) {
            if twin.score > hypothesis.score {
                *twin = hypothesis;
            }
        } else {
            level.push(hypothesis);
        }
        level.sort_by(|a, b| a.score.total_cmp(&b.score));
        Ok(())
    }

    fn problem(&self) -> Problem<'_> {
        Problem { z: &self.frame.z, prior: self.prior }
    }

    fn sum(&self) -> Sum<'_> {
        let Self { model, shapes, frame, none, .. } = *self;
        Sum { model, shapes, whitener: &frame.whitener, lacks: none }
    }

    /// The hypotheses with one further contact, at the sites with the largest gain.
    fn grown(&self, parent: &Hypothesis, work: &mut SearchWork) -> ContactResult<Vec<Vec<Place>>> {
        self.gains(&parent.places, work)?;
        let mut children: Vec<Vec<Place>> = Vec::with_capacity(PICKS);
        let sites = self.shapes.sites_mm();
        let far = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) >= APART_MM;
        let mut picked: Vec<[f64; 2]> = Vec::with_capacity(PICKS);
        while picked.len() < PICKS {
            let open = work.gains.iter().enumerate().filter(|(site, (gain, _))| {
                *gain > 0.0 && picked.iter().all(|&p| far(p, sites[*site]))
            });
            let Some((site, &(_, strength))) = open.max_by(|a, b| a.1.0.total_cmp(&b.1.0)) else {
                break;
            };
            picked.push(sites[site]);
            let ln_force = self.shapes.ln_force_of(strength);
            let ln_force = ln_force.clamp(FIRST_LN_FORCE[0], FIRST_LN_FORCE[1]);
            let mut child = parent.places.clone();
            child.push([sites[site][0], sites[site][1], ln_force]);
            children.push(child);
        }
        Ok(children)
    }

    /// For every site: the decrease of the misfit by a contact there, to first order and with the
    /// other contacts adapting, and its strength.
    fn gains(&self, places: &[Place], work: &mut SearchWork) -> ContactResult<()> {
        let mut places = places.to_vec();
        let mut sum = self.sum();
        let stay = Effort { iterations: 1, tolerance: 0.0 };
        descend(&self.problem(), &mut sum, &mut places, stay, &mut work.descent)?;
        work.residual.clear();
        work.residual.extend_from_slice(work.descent.residual());
        let width = work.residual.len();
        tangents(work.descent.slopes(), width, &mut work.tangents);
        project_out(&mut work.residual, &work.tangents);
        work.gains.clear();
        for shape in work.sites.chunks_exact(width) {
            let whole = dot(shape, shape);
            let imitated: f64 =
                work.tangents.chunks_exact(width).map(|t| dot(t, shape).powi(2)).sum();
            let own = (whole - imitated).max(1e-3 * whole);
            let along = dot(shape, &work.residual);
            let gain = if along > 0.0 { along * along / own } else { 0.0 };
            work.gains.push((gain, along / own));
        }
        Ok(())
    }
}

/// An orthonormal basis of the slopes.
fn tangents(slopes: &[f64], width: usize, out: &mut Vec<f64>) {
    out.clear();
    for slope in slopes.chunks_exact(width) {
        let start = out.len();
        out.extend_from_slice(slope);
        let (before, own) = out.split_at_mut(start);
        let whole = dot(own, own);
        for tangent in before.chunks_exact(width) {
            let along = dot(tangent, own);
            own.iter_mut().zip(tangent).for_each(|(o, t)| *o -= along * t);
        }
        let left = dot(own, own);
        if left > 1e-10 * whole {
            own.iter_mut().for_each(|o| *o /= left.sqrt());
        } else {
            out.truncate(start);
        }
    }
}

fn project_out(vector: &mut [f64], tangents: &[f64]) {
    debug_assert_eq!(vector.len() % PAD, 0);
    for tangent in tangents.chunks_exact(vector.len()) {
        let along = dot(tangent, vector);
        vector.iter_mut().zip(tangent).for_each(|(v, t)| *v -= along * t);
    }
}

/// Distance of the two closest contacts, mm.
pub(super) fn closest_mm(places: &[Place]) -> f64 {
    let pairs = places
        .iter()
        .enumerate()
        .flat_map(|(i, a)| places[..i].iter().map(move |b| (a[0] - b[0]).hypot(a[1] - b[1])));
    pairs.fold(f64::INFINITY, f64::min)
}

/// Whether two hypotheses with the same number of contacts are equal up to [`SAME_HYPOTHESIS_MM`].
pub(super) fn same(a: &[Place], b: &[Place]) -> bool {
    a.len() == b.len()
        && a.iter().all(|p| b.iter().any(|q| (p[0] - q[0]).hypot(p[1] - q[1]) < SAME_HYPOTHESIS_MM))
}
