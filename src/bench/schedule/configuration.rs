//! Configurations of the indenter: centre point, radius, attached arms; and how they are drawn.
//! PURE. Uses: sim-core's sensor, `chance`. Never: the rig's reach (`lint` checks that).
//!
//! Paper II-B and IV-A; lattice: `docs/references.md`, "Skin geometry". Arm i points at 60 (i - 1)
//! degrees, arm 1 along +x, so at a radius of k pitches every arm's tip is k steps along the point
//! lattice. Steps are counted in integers (rows, and half-pitches along x); nothing is compared
//! within a tolerance.

use serde::{Deserialize, Serialize};
use sim_core::sensor::{Point, Sensor};

use crate::chance::Chance;
use crate::record::ARMS;

/// Half-pitches along x and rows along y of one step along each arm's direction.
const ARM_STEPS: [(i64, i64); ARMS] = [(2, 0), (1, 1), (-1, 1), (-2, 0), (-1, -1), (1, -1)];

/// One configuration of the indenter for a number of attached tips.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Configuration {
    /// Number of attached tips, on arms 1 to `tips`.
    pub tips: u8,
    /// Radius in pitches of the point lattice.
    pub radius_pitches: u32,
    /// Index of the point under the centre, in the sensor's order.
    pub centre: u32,
}

/// Position of a configuration in skin coordinates, mm from the corner of the skin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stand {
    /// Centre of the indenter, (x, y), mm.
    pub centre_mm: [f64; 2],
    /// Radius of the tips, mm.
    pub radius_mm: f64,
    /// Radius in pitches of the point lattice.
    pub radius_pitches: u32,
    /// Centre of each attached tip, arm 1 first, (x, y), mm.
    pub tips_mm: Vec<[f64; 2]>,
}

/// The points of a sensor as a lattice, along which the arms step.
#[derive(Debug, Clone)]
pub struct Lattice<'a> {
    sensor: &'a Sensor,
    /// Point index by row and half-pitch along x, row-major.
    index: Vec<Option<u32>>,
    rows: i64,
    half_columns: i64,
}

impl<'a> Lattice<'a> {
    /// Indexes the points of a sensor.
    pub fn of(sensor: &'a Sensor) -> Self {
        let rows = i64::from(sensor.file.points.rows);
        let half_columns = 2 * i64::from(sensor.file.points.columns);
        let mut lattice =
            Self { sensor, index: vec![None; (rows * half_columns) as usize], rows, half_columns };
        for (i, point) in sensor.points().iter().enumerate() {
            let (half_column, row) = place(point);
            lattice.index[(row * half_columns + half_column) as usize] = Some(i as u32);
        }
        lattice
    }

    /// Points under the attached tips, arm 1 first; none if a tip would not be on a point.
    fn tip_points(&self, configuration: Configuration) -> Option<Vec<u32>> {
        let point = self.sensor.points().get(configuration.centre as usize)?;
        let (half_column, row) = place(point);
        let k = i64::from(configuration.radius_pitches);
        ARM_STEPS[..usize::from(configuration.tips).min(ARMS)]
            .iter()
            .map(|(dx, dy)| self.point_at(half_column + k * dx, row + k * dy))
            .collect()
    }

    /// All valid configurations of `tips` tips with a radius in `[lower, upper]` pitches, by
    /// radius, then by centre. Each is drawn with the same probability.
    pub fn pool(&self, tips: u8, radius_pitches: [u32; 2]) -> Vec<Configuration> {
        let points = self.sensor.points().len() as u32;
        (radius_pitches[0]..=radius_pitches[1])
            .flat_map(|radius_pitches| {
                (0..points).map(move |centre| Configuration { tips, radius_pitches, centre })
            })
            .filter(|&c| self.tip_points(c).is_some())
            .collect()
    }

    /// Position of a valid configuration, mm; none if a tip would not be on a point.
    pub fn stand(&self, configuration: Configuration) -> Option<Stand> {
        let points = self.sensor.points();
        let at = |i: u32| [points[i as usize].x_mm, points[i as usize].y_mm];
        let tips = self.tip_points(configuration)?;
        Some(Stand {
            centre_mm: at(configuration.centre),
            radius_mm: self.sensor.pitch_mm() * f64::from(configuration.radius_pitches),
            radius_pitches: configuration.radius_pitches,
            tips_mm: tips.into_iter().map(at).collect(),
        })
    }

    /// Configuration of a pool closest to a position, at the radius closest to `radius_pitches`;
    /// the first of equal ones.
    pub fn nearest(
        &self,
        pool: &[Configuration],
        radius_pitches: u32,
        place_mm: [f64; 2],
    ) -> Option<Configuration> {
        let points = self.sensor.points();
        let far = |c: &Configuration| {
            let p = points[c.centre as usize];
            (p.x_mm - place_mm[0]).powi(2) + (p.y_mm - place_mm[1]).powi(2)
        };
        pool.iter().copied().min_by(|a, b| {
            let off = |c: &Configuration| c.radius_pitches.abs_diff(radius_pitches);
            off(a).cmp(&off(b)).then(far(a).total_cmp(&far(b)))
        })
    }

    fn point_at(&self, half_column: i64, row: i64) -> Option<u32> {
        let inside = (0..self.half_columns).contains(&half_column) && (0..self.rows).contains(&row);
        if inside { self.index[(row * self.half_columns + half_column) as usize] } else { None }
    }
}

/// Draws uniformly from a pool, with replacement. An empty pool returns no draws.
pub fn draw(pool: &[Configuration], count: u32, chance: &mut Chance) -> Vec<Configuration> {
    let Ok(size @ 1..) = u32::try_from(pool.len()) else { return Vec::new() };
    (0..count).map(|_| pool[chance.below(size) as usize]).collect()
}

/// Half-pitches along x from column 0 of the even rows, and the row.
fn place(point: &Point) -> (i64, i64) {
    (2 * i64::from(point.column) + i64::from(point.row % 2), i64::from(point.row))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::tests::skin;

    #[test]
    fn pools_of_the_papers_sensor_have_the_counted_sizes() {
        let sensor = skin();
        let lattice = Lattice::of(&sensor);
        let sizes: Vec<usize> = (1..=6).map(|n| lattice.pool(n, [2, 12]).len()).collect();
        assert_eq!(sizes, [6457, 5115, 4246, 3377, 2684, 2684]);
    }

    #[test]
    fn every_tip_stands_at_its_radius_in_its_arms_direction() {
        let sensor = skin();
        let lattice = Lattice::of(&sensor);
        for configuration in lattice.pool(6, [2, 12]) {
            let stand = lattice.stand(configuration).unwrap();
            for (arm, tip) in stand.tips_mm.iter().enumerate() {
                let angle = (60.0 * arm as f64).to_radians();
                let x = stand.centre_mm[0] + stand.radius_mm * angle.cos();
                let y = stand.centre_mm[1] + stand.radius_mm * angle.sin();
                assert!((tip[0] - x).hypot(tip[1] - y) < 1e-9);
                assert!(sensor.point_near(*tip, 1e-9).is_some());
            }
        }
    }

    #[test]
    fn a_tip_over_a_point_that_was_left_out_is_not_legal() {
        let sensor = skin();
        let lattice = Lattice::of(&sensor);
        let at = |row, column| {
            sensor.points().iter().position(|p| (p.row, p.column) == (row, column)).unwrap() as u32
        };
        let towards_corner = Configuration { tips: 4, radius_pitches: 2, centre: at(0, 2) };
        assert_eq!(lattice.tip_points(towards_corner), None);
        let beside_it = Configuration { tips: 4, radius_pitches: 2, centre: at(0, 3) };
        assert!(lattice.tip_points(beside_it).is_some());
    }

    /// Chi-square over the pool of six tips: 2683 degrees of freedom, 99.9 % point 2916.
    #[test]
    fn draws_are_uniform_over_the_pool() {
        let sensor = skin();
        let pool = Lattice::of(&sensor).pool(6, [2, 12]);
        let count = 20 * pool.len() as u32;
        let mut seen = std::collections::BTreeMap::new();
        for c in draw(&pool, count, &mut Chance::named(11, "uniform")) {
            *seen.entry(c).or_insert(0.0) += 1.0;
        }
        let chi2: f64 = pool
            .iter()
            .map(|c| (seen.get(c).copied().unwrap_or(0.0) - 20.0f64).powi(2) / 20.0)
            .sum();
        assert!((2461.0..2916.0).contains(&chi2), "{chi2}");
    }
}
