//! The skin's surface under a tip, compared with the unit responses and with differences.

use sim_core::mesh::Mesh;
use sim_core::sensor::Sensor;
use sim_core::surface::SurfaceSinking;

use super::{model, point_at, responses, sensor};

/// The paper's skin with other moduli: factors on the foam's and on the fabrics'.
fn scaled(foam: f64, fabric: f64) -> Sensor {
    let mut file = sensor().file.clone();
    file.layers.foam.youngs_mpa *= foam;
    file.layers.bottom.youngs_mpa *= fabric;
    file.layers.top.youngs_mpa *= fabric;
    Sensor::new(file).unwrap()
}

#[test]
fn the_tip_sinks_by_the_foams_compression_and_a_little_more() {
    let point = point_at(270.0, 280.0);
    let nodes = model().mesh().points[point];
    let compression = |node: u32| -> f64 {
        let of = |loaded: &u32| f64::from(responses().row(*loaded as usize)[node as usize]);
        nodes.vertices.iter().map(of).sum::<f64>() / 6.0
    };
    let mean = nodes.vertices.iter().map(|&v| compression(v)).sum::<f64>() / 6.0;
    let tip = SurfaceSinking::solve(sensor(), &[point]).unwrap().of_tip(0).mm_per_n;
    // Fabrics 300 times as stiff as the foam hardly become thinner.
    assert!(tip > mean && tip < 1.02 * mean, "tip {tip}, foam {mean} mm/N");
}

#[test]
fn softer_moduli_sink_in_proportion_and_the_derivative_is_that_of_differences() {
    let point = point_at(270.0, 280.0);
    let p = sensor().points()[point];
    let beside = Mesh::new(sensor()).unwrap().locate([p.x_mm + 23.0, p.y_mm + 4.0]);
    let sinking = |foam: f64, fabric: f64| {
        let surface = SurfaceSinking::solve(&scaled(foam, fabric), &[point]).unwrap();
        [surface.of_tip(0), surface.at(0, &beside)]
    };
    let (here, halved) = (sinking(1.0, 1.0), sinking(0.5, 0.5));
    let h: f64 = 1e-3;
    let (more, less) = (sinking(h.exp(), 1.0), sinking((-h).exp(), 1.0));
    let (stiffer, softer) = (sinking(1.0, h.exp()), sinking(1.0, (-h).exp()));
    for place in 0..2 {
        let s = here[place];
        assert!((halved[place].mm_per_n / s.mm_per_n - 2.0).abs() < 1e-9);
        let by_foam = (more[place].mm_per_n - less[place].mm_per_n) / (2.0 * h);
        assert!((by_foam / s.by_ln_foam - 1.0).abs() < 1e-5, "{by_foam} {s:?}");
        let by_fabric = (stiffer[place].mm_per_n - softer[place].mm_per_n) / (2.0 * h);
        let homogeneous = -s.mm_per_n - s.by_ln_foam;
        assert!((by_fabric - homogeneous).abs() < 1e-5 * s.mm_per_n.abs(), "{by_fabric} {s:?}");
    }
    // A stiffer fabric flattens the dent: less under the tip, and not the same share next to it.
    let share = |n: usize| (-here[n].mm_per_n - here[n].by_ln_foam) / here[n].mm_per_n;
    assert!(share(0) < 0.0 && (share(0) - share(1)).abs() > 0.05, "{} {}", share(0), share(1));
}

#[test]
fn many_points_are_solved_as_one_is() {
    let points: Vec<usize> = (0..70).map(|n| 11 * n).collect();
    let all = SurfaceSinking::solve(sensor(), &points).unwrap();
    let last = SurfaceSinking::solve(sensor(), &points[69..]).unwrap();
    let (a, b) = (all.of_tip(69).mm_per_n, last.of_tip(0).mm_per_n);
    assert!((a / b - 1.0).abs() < 1e-9, "{a} {b}");
}
