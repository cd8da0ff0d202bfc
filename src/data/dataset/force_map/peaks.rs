//! Estimates contacts from a force map (paper V-B2): its peaks with their forces and diameters.
//! PURE. Uses: `ForceMap` (positions of the pixels). Never: truth, scores, a map of another square.
//!
//! 1. A pixel is a summit if no pixel whose centre is within 32 mm of its centre is larger.
//! 2. A summit and the equal pixels that are connected to it by edges form one plateau, positioned at
//!    the mean of their centres. Without this rule each pixel of a flat disc (a label) would be a peak.
//! 3. No two peaks are within 32 mm of each other: in the order of decreasing value (equal values in
//!    row order), a plateau within 32 mm of an earlier one is dropped. By (1) this affects only
//!    plateaus of several pixels.
//! 4. The force of a peak is the sum of the pixels whose centres are within 32 mm of its position.
//!    Peaks below the threshold are then dropped.
//!    On a square of another side than 640 mm, all 32 mm are in proportion: a twentieth of the side.
//! 5. The diameter of a peak is that of the circle with the area of the region, connected by edges,
//!    at or above half of its largest pixel (full width at half maximum).
//!
//! Pixels that differ by less than one millionth are equal: a disc rendered in f32 is flat to a few
//! 1e-7. Pixels that are negative or not finite count as 0: they carry no force and connect
//! nothing.

use std::f64::consts::{PI, SQRT_2};

use super::ForceMap;
use crate::store::Contact;

/// Radius of the neighbourhood in which a peak is the maximum, and over which its force is summed,
/// mm.
const NEIGHBOURHOOD_MM: f64 = 32.0;
/// Smallest force of a peak in the paper (V-B2), N: the sensor's deadband.
pub const THRESHOLD_N: f64 = 5.0;
/// Pixels whose relative difference is below this are equal.
const EQUAL: f32 = 1e-6;
/// Tolerance of squared distances, so that a pixel at exactly 32 mm is within the neighbourhood.
const ROUNDING_MM2: f64 = 1e-6;

/// A contact estimated from a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// Position along x, mm, skin coordinates.
    pub x_mm: f64,
    /// Position along y, mm, skin coordinates.
    pub y_mm: f64,
    /// Sum of the pixels in the neighbourhood, N.
    pub force_n: f64,
    /// Diameter of the circle with the area at or above half of the largest pixel, mm.
    pub diameter_mm: f64,
}

impl ForceMap {
    /// Returns the peaks with a force of at least `threshold_n` (N) of a map (layout of
    /// [`ForceMap::render`], N per pixel), sorted by decreasing largest pixel.
    ///
    /// # Panics
    /// If `map` is not `pixels x pixels` long.
    pub fn peaks(&self, map: &[f32], threshold_n: f64) -> Vec<Peak> {
        // In millimetres of the paper's square.
        let scale = self.spec.scale();
        let field = Field::new(map, self.pixels(), self.spec.pixel_mm / scale);
        let mut plateaus = field.plateaus();
        plateaus.sort_by(|a, b| b.largest.total_cmp(&a.largest).then(a.first.cmp(&b.first)));
        let mut places: Vec<[f64; 2]> = Vec::new();
        let mut peaks = Vec::new();
        let mut visits = vec![0; field.values.len()];
        for (number, plateau) in (1..).zip(plateaus) {
            if places.iter().any(|&place| within(place, plateau.place_mm)) {
                continue;
            }
            places.push(plateau.place_mm);
            let force_n = field.sum_around(plateau.place_mm);
            if force_n >= threshold_n {
                let half = plateau.largest / 2.0;
                let half = field.joined(plateau.first, |value| value >= half, &mut visits, number);
                let area_mm2 = half.len() as f64 * self.spec.pixel_mm * self.spec.pixel_mm;
                peaks.push(Peak {
                    x_mm: self.origin_mm[0] + scale * plateau.place_mm[0],
                    y_mm: self.origin_mm[1] + scale * plateau.place_mm[1],
                    force_n,
                    diameter_mm: 2.0 * (area_mm2 / PI).sqrt(),
                });
            }
        }
        peaks
    }
}

/// True if a pixel is larger than another, or equal to it within the tolerance.
fn equal_or_above(value: f32, other: f32) -> bool {
    value >= other * (1.0 - EQUAL)
}

/// True if two positions are in the same neighbourhood.
fn within(a: [f64; 2], b: [f64; 2]) -> bool {
    let (x, y) = (a[0] - b[0], a[1] - b[1]);
    x * x + y * y <= NEIGHBOURHOOD_MM * NEIGHBOURHOOD_MM + ROUNDING_MM2
}

/// Equal, connected pixels, at least one of which is a summit.
struct Plateau {
    /// Index of the first pixel in row order.
    first: usize,
    /// The largest pixel, N.
    largest: f32,
    /// Mean of the pixels' centres, mm from the map's corner.
    place_mm: [f64; 2],
}

/// A map with a rim of zeros as wide as the neighbourhood, so that no neighbourhood extends beyond
/// it.
struct Field {
    values: Vec<f32>,
    pixel_mm: f64,
    /// Pixels along a side of the map.
    pixels: usize,
    /// Width of the rim, pixels: at least 1.
    rim: usize,
}

impl Field {
    fn new(map: &[f32], pixels: usize, pixel_mm: f64) -> Self {
        assert_eq!(map.len(), pixels * pixels, "a map of {pixels} x {pixels} pixels");
        let rim = ((NEIGHBOURHOOD_MM / pixel_mm) as usize).max(1);
        let stride = pixels + 2 * rim;
        let mut values = vec![0.0; stride * stride];
        for (row, line) in map.chunks_exact(pixels).enumerate() {
            let start = (row + rim) * stride + rim;
            for (value, &pixel) in values[start..start + pixels].iter_mut().zip(line) {
                *value = if pixel > 0.0 && pixel < f32::INFINITY { pixel } else { 0.0 };
            }
        }
        Self { values, pixel_mm, pixels, rim }
    }

    fn stride(&self) -> usize {
        self.pixels + 2 * self.rim
    }

    /// Index offsets from a pixel to the others of its neighbourhood, the nearest first.
    fn circle(&self) -> Vec<isize> {
        let (rim, stride) = (self.rim as isize, self.stride() as isize);
        let mm = |pixels: isize| pixels as f64 * self.pixel_mm;
        let mut steps: Vec<(isize, isize)> = (-rim..=rim)
            .flat_map(|row| (-rim..=rim).map(move |column| (row, column)))
            .filter(|&step| step != (0, 0) && within([mm(step.1), mm(step.0)], [0.0; 2]))
            .collect();
        steps.sort_by_key(|(row, column)| row * row + column * column);
        steps.into_iter().map(|(row, column)| row * stride + column).collect()
    }

    /// The plateaus, unsorted. The map is searched in blocks that fit in a neighbourhood: only the
    /// largest pixels of a block can be summits, so that few pixels are checked fully.
    fn plateaus(&self) -> Vec<Plateau> {
        let side = (NEIGHBOURHOOD_MM / self.pixel_mm / SQRT_2) as usize + 1;
        let (circle, stride) = (self.circle(), self.stride());
        let mut taken = vec![0; self.values.len()];
        let mut found = Vec::new();
        let lines = |first: usize| first + self.rim..(first + side).min(self.pixels) + self.rim;
        for row in (0..self.pixels).step_by(side) {
            for column in (0..self.pixels).step_by(side) {
                let in_block = || lines(row).map(|row| row * stride + lines(column).start);
                let width = lines(column).len();
                let mut largest = 0.0;
                for start in in_block() {
                    for &value in &self.values[start..start + width] {
                        largest = if value > largest { value } else { largest };
                    }
                }
                if largest == 0.0 {
                    continue;
                }
                for at in in_block().flat_map(|start| start..start + width) {
                    let may_be = equal_or_above(self.values[at], largest) && taken[at] == 0;
                    if may_be && self.is_summit(at, &circle) {
                        let own = self.values[at];
                        let equal =
                            |value| equal_or_above(value, own) && equal_or_above(own, value);
                        found.push(self.plateau(&self.joined(at, equal, &mut taken, 1)));
                    }
                }
            }
        }
        found
    }

    /// True if no pixel of the neighbourhood is larger. The nearest pixels are compared first,
    /// because nearly every pixel has a larger one close to it.
    fn is_summit(&self, at: usize, circle: &[isize]) -> bool {
        let value = self.values[at];
        circle.iter().all(|step| equal_or_above(value, self.values[at.wrapping_add_signed(*step)]))
    }

    /// Returns the pixels that are connected to `from` by edges over pixels for which `belongs` is
    /// true (it must be false for 0) and that do not have this mark yet; marks them. `marks` has one
    /// for each pixel.
    fn joined(
        &self,
        from: usize,
        belongs: impl Fn(f32) -> bool,
        marks: &mut [u32],
        mark: u32,
    ) -> Vec<usize> {
        let stride = self.stride();
        let mut region = vec![from];
        marks[from] = mark;
        let mut next = 0;
        while let Some(&at) = region.get(next) {
            next += 1;
            for neighbour in [at - stride, at - 1, at + 1, at + stride] {
                if marks[neighbour] != mark && belongs(self.values[neighbour]) {
                    marks[neighbour] = mark;
                    region.push(neighbour);
                }
            }
        }
        region
    }

    fn plateau(&self, region: &[usize]) -> Plateau {
        let (mut largest, mut sum_mm) = (0.0_f32, [0.0; 2]);
        let mut first = usize::MAX;
        for &at in region {
            first = first.min(at);
            largest = largest.max(self.values[at]);
            sum_mm[0] += self.centre_mm(at % self.stride());
            sum_mm[1] += self.centre_mm(at / self.stride());
        }
        let count = region.len() as f64;
        Plateau { first, largest, place_mm: sum_mm.map(|mm| mm / count) }
    }

    /// Centre of a row or column (index including the rim), mm from the map's corner.
    fn centre_mm(&self, line: usize) -> f64 {
        (line as f64 - self.rim as f64 + 0.5) * self.pixel_mm
    }

    /// Sum of the pixels whose centres are in the neighbourhood of a position of the map, N.
    fn sum_around(&self, place_mm: [f64; 2]) -> f64 {
        let lines = |at_mm: f64| {
            let line = |mm: f64| (mm / self.pixel_mm).clamp(0.0, self.pixels as f64) as usize;
            let last = line(at_mm + NEIGHBOURHOOD_MM).min(self.pixels - 1);
            self.rim + line(at_mm - NEIGHBOURHOOD_MM)..=self.rim + last
        };
        let mut sum_n = 0.0;
        for row in lines(place_mm[1]) {
            for column in lines(place_mm[0]) {
                if within(place_mm, [self.centre_mm(column), self.centre_mm(row)]) {
                    sum_n += f64::from(self.values[row * self.stride() + column]);
                }
            }
        }
        sum_n
    }
}

impl From<Peak> for Contact {
    fn from(peak: Peak) -> Self {
        Self {
            x_mm: Some(peak.x_mm),
            y_mm: Some(peak.y_mm),
            force_n: Some(peak.force_n),
            diameter_mm: Some(peak.diameter_mm),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::tests::{drawn, map};
    use super::*;
    use crate::dataset::force_map::ForceMapSpec;

    const PIXELS: usize = 160;

    /// A map of 4 mm pixels with these values at these (row, column).
    fn with(pixels: &[(usize, usize, f32)]) -> Vec<f32> {
        let mut map = vec![0.0; PIXELS * PIXELS];
        for (row, column, value) in pixels {
            map[row * PIXELS + column] = *value;
        }
        map
    }

    fn forces(peaks: &[Peak]) -> Vec<f64> {
        peaks.iter().map(|peak| peak.force_n).collect()
    }

    #[test]
    fn a_flat_disc_is_one_peak_with_its_place_force_and_width() {
        for spec in ["4x20", "4x28", "4x44", "4x60", "10x30", "10x50"] {
            let map = map(spec);
            let contacts = [(270.0, 280.0, 12.0), (100.3, 417.9, 7.5), (401.7, 99.1, 6.0)];
            let mut peaks = map.peaks(&drawn(&map, &contacts), 5.0);
            peaks.sort_by(|a, b| b.force_n.total_cmp(&a.force_n));
            assert_eq!(peaks.len(), 3, "{spec}: {peaks:?}");
            let (pixel_mm, diameter_mm) = (map.spec.pixel_mm, map.spec.diameter_mm);
            for (peak, (x_mm, y_mm, force_n)) in peaks.iter().zip(contacts) {
                let off = (peak.x_mm - x_mm).hypot(peak.y_mm - y_mm);
                assert!(off < 0.6 * pixel_mm, "{spec}: {off} mm off");
                assert!((peak.force_n / force_n - 1.0).abs() < 0.03, "{spec}: {peak:?}");
                let wide = peak.diameter_mm - diameter_mm;
                assert!(wide.abs() < 0.8 * pixel_mm, "{spec}: {wide} mm too wide");
            }
        }
    }

    #[test]
    fn the_larger_of_two_within_a_circle_is_the_peak_and_both_make_its_force() {
        let map = map("4x20");
        // 8 pixels are 32 mm, within the circle; 9 are not. Rows and columns count alike.
        let near = map.peaks(&with(&[(80, 80, 6.0), (88, 80, 5.0)]), 5.0);
        assert_eq!(forces(&near), [11.0]);
        assert_eq!((near[0].x_mm, near[0].y_mm), (272.0, 282.0));
        let apart = map.peaks(&with(&[(80, 80, 5.0), (80, 89, 6.0)]), 5.0);
        assert_eq!(forces(&apart), [6.0, 5.0], "the largest first");
        assert_eq!((apart[0].x_mm, apart[0].y_mm), (308.0, 282.0));
        // Equal ones are no different: the first in row order is the one.
        assert_eq!(forces(&map.peaks(&with(&[(80, 80, 6.0), (80, 88, 6.0)]), 5.0)), [12.0]);
        assert_eq!(forces(&map.peaks(&with(&[(80, 80, 6.0), (80, 89, 6.0)]), 5.0)), [6.0, 6.0]);
        // A chain: the middle one belongs to the first, which does not reach the last.
        let chain = map.peaks(&with(&[(80, 80, 9.0), (80, 88, 8.0), (80, 96, 7.0)]), 1.0);
        assert_eq!(forces(&chain), [17.0], "the last has a larger one within its circle too");
    }

    #[test]
    fn the_threshold_is_on_the_sum_and_reaches_to_the_maps_corners() {
        let map = map("4x20");
        let pixels = with(&[(0, 0, 3.0), (0, 1, 2.0), (159, 159, 4.9)]);
        let peaks = map.peaks(&pixels, THRESHOLD_N);
        assert_eq!(forces(&peaks), [5.0]);
        assert_eq!((peaks[0].x_mm, peaks[0].y_mm), (-48.0, -38.0));
        assert_eq!(map.peaks(&pixels, 0.0).len(), 2);
        assert!(map.peaks(&with(&[]), 0.0).is_empty());
        let everywhere = map.peaks(&[0.5; PIXELS * PIXELS], 5.0);
        assert_eq!(everywhere.len(), 1);
        assert_eq!((everywhere[0].x_mm, everywhere[0].y_mm), (270.0, 280.0));
    }

    #[test]
    fn a_map_of_another_side_is_the_papers_in_proportion() {
        // 100 mm in place of 640: a neighbourhood has 5 mm.
        let spec: ForceMapSpec = "0.625x5x100".parse().unwrap();
        let map = ForceMap::new(spec, [100.0, 80.0]).unwrap();
        let pixels = drawn(&map, &[(20.0, 20.0, 6.0), (26.0, 20.0, 7.0), (90.0, 70.0, 8.0)]);
        let mut peaks = map.peaks(&pixels, 5.0);
        peaks.sort_by(|a, b| a.x_mm.total_cmp(&b.x_mm));
        for (peak, [x_mm, y_mm, force_n]) in
            peaks.iter().zip([[20.0, 20.0, 6.0], [26.0, 20.0, 7.0], [90.0, 70.0, 8.0]])
        {
            let apart = (peak.x_mm - x_mm).hypot(peak.y_mm - y_mm);
            assert!(apart < 0.7 && (peak.diameter_mm - 5.0).abs() < 1.0, "{peak:?}");
            // Neighbours 6 mm apart share the rims of their circles of 5 mm.
            assert!(peak.force_n > force_n - 0.1 && peak.force_n < force_n + 4.0, "{peak:?}");
        }
        assert_eq!(peaks.len(), 3);
    }

    #[test]
    fn a_flat_floor_hides_no_peak() {
        // What a net adds everywhere is joined to every peak, and larger than nothing.
        for spec in ["4x20", "20x20"] {
            let map = map(spec);
            let mut pixels = drawn(&map, &[(270.0, 280.0, 12.0), (100.0, 420.0, 7.5)]);
            let bare = map.peaks(&pixels, 5.0);
            pixels.iter_mut().for_each(|pixel| *pixel += 0.002);
            let raised = map.peaks(&pixels, 5.0);
            assert_eq!(raised.len(), 2, "{spec}: {raised:?}");
            for (raised, bare) in raised.iter().zip(bare) {
                assert_eq!((raised.x_mm, raised.y_mm), (bare.x_mm, bare.y_mm));
                assert!((0.0..0.5).contains(&(raised.force_n - bare.force_n)));
            }
        }
    }

    #[test]
    fn pixels_that_are_negative_or_no_numbers_count_as_nothing() {
        let map = map("4x20");
        let clean = with(&[(80, 80, 6.0), (80, 81, 4.0)]);
        let mut dirty = clean.clone();
        for (at, value) in [(0, f32::NAN), (9, f32::INFINITY), (7, f32::NEG_INFINITY), (4, -1e9)] {
            dirty[79 * PIXELS + 76 + at] = value;
        }
        assert_eq!(map.peaks(&dirty, 5.0), map.peaks(&clean, 5.0));
        assert!(map.peaks(&[f32::NAN; PIXELS * PIXELS], 0.0).is_empty());
    }

    #[test]
    fn the_width_is_that_of_the_region_at_half_height_that_holds_the_peak() {
        let map = map("4x20");
        // Three pixels at half or above joined by edges; one touches by a corner, one is lower.
        let mut pixels =
            vec![(80, 80, 8.0), (80, 81, 4.0), (81, 80, 5.0), (82, 81, 6.0), (79, 80, 3.9)];
        let area_mm2 = |pixels: f64| pixels * 16.0;
        let width = |pixels: f64| 2.0 * (area_mm2(pixels) / PI).sqrt();
        assert_eq!(map.peaks(&with(&pixels), 5.0)[0].diameter_mm, width(3.0));
        pixels.push((81, 81, 4.1));
        assert_eq!(map.peaks(&with(&pixels), 5.0)[0].diameter_mm, width(5.0));
    }

    proptest! {
        /// For discs at any positions of any map of Table IV, no two peaks are neighbours, none is
        /// under the threshold, and contacts that are far from each other are all found.
        #[test]
        fn peaks_keep_their_distance(
            which in 0..crate::dataset::force_map::TABLE_IV_MAPS.len(),
            contacts in prop::collection::vec(
                (20.0..520.0_f64, 20.0..540.0_f64, 8.0..40.0_f64), 0..7,
            ),
        ) {
            let spec = crate::dataset::force_map::TABLE_IV_MAPS[which];
            let map = ForceMap::new(spec, [540.0, 560.0]).unwrap();
            let peaks = map.peaks(&drawn(&map, &contacts), 5.0);
            for (i, peak) in peaks.iter().enumerate() {
                prop_assert!(peak.force_n >= 5.0 && peak.diameter_mm > 0.0);
                for other in &peaks[..i] {
                    let apart = (peak.x_mm - other.x_mm).hypot(peak.y_mm - other.y_mm);
                    prop_assert!(apart > NEIGHBOURHOOD_MM, "{apart} mm apart");
                }
            }
            let distance = |a: &(f64, f64, f64), b: &(f64, f64, f64)| (a.0 - b.0).hypot(a.1 - b.1);
            let alone = contacts.iter().enumerate().all(|(i, contact)| {
                contacts[..i].iter().all(|other| distance(contact, other) > 160.0)
            });
            if alone {
                prop_assert_eq!(peaks.len(), contacts.len());
            }
        }
    }
}
