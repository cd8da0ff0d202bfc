//! Force maps against thin strips, sums and cases known by hand.
//! Uses: `dataset::force_map`. Never: files.

use std::f64::consts::PI;

use proptest::prelude::*;

use super::{Contact, Disc, ForceMap, ForceMapError, ForceMapSpec, SIDE_MM, Span, TABLE_IV_MAPS};

const SKIN_MM: [f64; 2] = [540.0, 560.0];

pub(super) fn map(spec: &str) -> ForceMap {
    ForceMap::new(spec.parse().unwrap(), SKIN_MM).unwrap()
}

fn contact((x_mm, y_mm, force_n): (f64, f64, f64)) -> Contact {
    Contact { x_mm, y_mm, force_n }
}

pub(super) fn drawn(map: &ForceMap, contacts: &[(f64, f64, f64)]) -> Vec<f32> {
    let mut pixels = vec![0.0; map.pixels() * map.pixels()];
    let contacts: Vec<Contact> = contacts.iter().copied().map(contact).collect();
    map.render(&contacts, &mut pixels).unwrap();
    pixels
}

fn sum(pixels: &[f32]) -> f64 {
    pixels.iter().map(|&n| f64::from(n)).sum()
}

/// Area of a disc around the origin within a rectangle, by adding up 20,000 thin strips.
fn by_strips(radius: f64, x: [f64; 2], y: [f64; 2]) -> f64 {
    const STRIPS: i32 = 20_000;
    let width = (x[1] - x[0]) / f64::from(STRIPS);
    let height = |i| {
        let at: f64 = x[0] + (f64::from(i) + 0.5) * width;
        let half_chord = (radius * radius - at * at).max(0.0).sqrt();
        (y[1].min(half_chord) - y[0].max(-half_chord)).max(0.0)
    };
    (0..STRIPS).map(|i| height(i) * width).sum()
}

proptest! {
    #[test]
    fn areas_are_those_of_thin_strips(
        radius in 0.5..160.0_f64,
        from in (-1.5..1.2_f64, -1.5..1.2_f64),
        extent in (0.001..2.5_f64, 0.001..2.5_f64),
    ) {
        let x = [from.0 * radius, (from.0 + extent.0) * radius];
        let y = [from.1 * radius, (from.1 + extent.1) * radius];
        let disc = Disc::new(radius);
        let span = |ends: [f64; 2]| Span::new(disc.line(ends[0]), disc.line(ends[1]));
        let exact = disc.within(&span(x), &span(y));
        let error = (exact - by_strips(radius, x, y)).abs();
        prop_assert!(error < 1e-5 * radius * radius, "{exact} differs by {error}");
    }

    #[test]
    fn a_map_sums_to_its_forces_wherever_they_are(
        which in 0..TABLE_IV_MAPS.len(),
        contacts in prop::collection::vec(
            (-49.0..589.0_f64, -39.0..599.0_f64, 0.1..60.0_f64), 0..7,
        ),
    ) {
        let map = ForceMap::new(TABLE_IV_MAPS[which], SKIN_MM).unwrap();
        let pixels = drawn(&map, &contacts);
        let forces: f64 = contacts.iter().map(|c| c.2).sum();
        prop_assert!((sum(&pixels) - forces).abs() <= 1e-6 * forces, "{}", sum(&pixels));
        prop_assert!(pixels.iter().all(|&n| n >= 0.0));
    }

    #[test]
    fn only_pixels_that_the_disc_overlaps_are_touched(
        (x, y) in (60.0..480.0_f64, 60.0..500.0_f64), diameter in 1.0..120.0_f64,
    ) {
        let spec = ForceMapSpec { pixel_mm: 10.0, diameter_mm: diameter, side_mm: SIDE_MM };
        let map = ForceMap::new(spec, SKIN_MM).unwrap();
        let pixels = drawn(&map, &[(x, y, 1.0)]);
        for (i, &newtons) in pixels.iter().enumerate() {
            let low = [(i % 64) as f64 * 10.0 - 50.0, (i / 64) as f64 * 10.0 - 40.0];
            let dx = x - x.clamp(low[0], low[0] + 10.0);
            let dy = y - y.clamp(low[1], low[1] + 10.0);
            if dx.hypot(dy) > diameter / 2.0 + 1e-9 {
                prop_assert_eq!(newtons, 0.0);
            }
        }
    }
}

#[test]
fn a_10_mm_disc_on_10_mm_pixels_keeps_its_force() {
    let map = map("10x10");
    // In the middle of pixel (row 14, column 15): tangent to its four lines.
    let pixels = drawn(&map, &[(105.0, 105.0, 7.5)]);
    assert_eq!(pixels[14 * 64 + 15], 7.5);
    assert_eq!(pixels.iter().filter(|&&n| n != 0.0).count(), 1);
    // On a corner of four pixels: a quarter each.
    let pixels = drawn(&map, &[(100.0, 100.0, 8.0)]);
    for i in [13 * 64 + 14, 13 * 64 + 15, 14 * 64 + 14, 14 * 64 + 15] {
        assert!((pixels[i] - 2.0).abs() < 1e-6, "{}", pixels[i]);
    }
    assert_eq!(pixels.iter().filter(|&&n| n != 0.0).count(), 4);
}

#[test]
fn pixels_inside_the_disc_hold_its_pressure() {
    let map = map("4x60");
    let pixels = drawn(&map, &[(270.0, 280.0, 30.0)]);
    let expected = 30.0 * 16.0 / (PI * 900.0);
    for i in [79 * 160 + 80, 80 * 160 + 80, 84 * 160 + 76, 80 * 160 + 86] {
        assert!((f64::from(pixels[i]) / expected - 1.0).abs() < 1e-7, "{}", pixels[i]);
    }
}

#[test]
fn rows_are_y_and_columns_are_x() {
    let pixels = drawn(&map("20x2"), &[(-45.0, -35.0, 1.0), (585.0, -35.0, 2.0)]);
    assert_eq!((pixels[0], pixels[31]), (1.0, 2.0));
    let pixels = drawn(&map("20x2"), &[(-45.0, 595.0, 3.0)]);
    assert_eq!(pixels[31 * 32], 3.0);
}

#[test]
fn a_disc_beyond_the_rim_keeps_its_force_on_the_square() {
    // Half of it is on the square: twice the pressure.
    let pixels = drawn(&map("10x100"), &[(-50.0, 280.0, 5.0)]);
    assert!((sum(&pixels) - 5.0).abs() < 5e-6);
    let pressure = 5.0 / (PI * 2500.0 / 2.0);
    assert!((f64::from(pixels[32 * 64]) / (100.0 * pressure) - 1.0).abs() < 1e-6);
}

#[test]
fn contacts_that_no_pixel_can_hold_are_refused() {
    let map = map("4x20");
    let mut pixels = vec![0.0; 160 * 160];
    for at in [(-61.0, 0.0, 1.0), (0.0, 620.0, 1.0), (f64::NAN, 0.0, 1.0), (0.0, 0.0, f64::NAN)] {
        let refused = map.render(&[contact(at)], &mut pixels);
        assert!(matches!(refused, Err(ForceMapError::Contact { .. })), "{at:?}");
    }
    assert!(pixels.iter().all(|&n| n == 0.0));
}

#[test]
fn a_specification_is_read_back_as_it_is_written() {
    for (spec, written) in TABLE_IV_MAPS.iter().zip(["4x20", "4x28", "4x32", "4x44"]) {
        assert_eq!(spec.to_string(), written);
    }
    let of_pad = ForceMapSpec { pixel_mm: 2.5, diameter_mm: 10.0, side_mm: 100.0 };
    assert_eq!((of_pad.to_string().as_str(), of_pad.pixels()), ("2.5x10x100", 40));
    let of_paper = ForceMapSpec { pixel_mm: 6.4, diameter_mm: 12.5, side_mm: SIDE_MM };
    for spec in TABLE_IV_MAPS.into_iter().chain([of_paper, of_pad]) {
        assert_eq!(spec.to_string().parse(), Ok(spec));
        let json = serde_json::to_string(&spec).unwrap();
        assert_eq!(serde_json::from_str::<ForceMapSpec>(&json).unwrap(), spec);
    }
}

#[test]
fn a_refused_specification_names_its_limit() {
    for (text, limit) in [
        ("4", "pixel x diameter in mm"),
        ("4x", "pixel x diameter in mm"),
        ("ax20", "pixel x diameter in mm"),
        ("1x20", "from 2 to 160 mm"),
        ("320x20", "from 2 to 160 mm"),
        ("NaNx20", "from 2 to 160 mm"),
        ("7x20", "must divide 640 mm"),
        ("4x0", "above 0 and at most 320 mm"),
        ("4x321", "above 0 and at most 320 mm"),
        ("4xNaN", "above 0 and at most 320 mm"),
        ("4x20x100x1", "pixel x diameter in mm"),
        ("4x20x5", "side 5 mm: must be from 10 to 6400 mm"),
        ("3x20x100", "must divide 100 mm"),
        ("26x20x100", "from 0.3125 to 25 mm"),
        ("2.5x51x100", "above 0 and at most 50 mm"),
    ] {
        let error = text.parse::<ForceMapSpec>().unwrap_err().to_string();
        assert!(error.contains(limit), "{text}: {error}");
    }
    let large = ForceMap::new(TABLE_IV_MAPS[0], [700.0, 560.0]).unwrap_err().to_string();
    assert!(large.contains("at most 640 mm"), "{large}");
}

#[test]
fn a_map_of_another_skin_has_as_many_pixels_and_covers_it() {
    let spec: ForceMapSpec = "10x20".parse().unwrap();
    assert_eq!(spec.on_skin(100.0).to_string(), "1.8x3.6x115.2");
    let stated: ForceMapSpec = "2.5x10x100".parse().unwrap();
    for spec in TABLE_IV_MAPS.into_iter().chain([stated]) {
        for skin_mm in [20.0, 50.0, 333.0, 1500.0] {
            let map = spec.on_skin(skin_mm).checked().unwrap();
            assert_eq!(map.pixels(), spec.pixels());
            assert!((1.0..2.0).contains(&(map.side_mm / skin_mm)), "{map} on {skin_mm} mm");
        }
    }
}
