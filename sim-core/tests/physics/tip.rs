//! Tips anywhere on the skin: loads of the nodes, and frames.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::deformation::NodeForce;
use sim_core::forward::{Contact, ContactError, Workspace};
use sim_core::tip::{Share, Spreading, TipLattice};

use super::{model, point_at, press, sensor};

fn shares(spreading: Spreading, x_mm: f64, y_mm: f64) -> Vec<Share> {
    let mut shares = Vec::new();
    TipLattice::new(sensor(), model().mesh()).spread(spreading, [x_mm, y_mm], &mut shares);
    shares
}

/// Sum of the shares (sixths) and the centre of their moment, mm.
fn sums(shares: &[Share]) -> (f64, [f64; 2]) {
    let place = |s: &Share| model().mesh().nodes_mm[s.node as usize];
    let force = shares.iter().map(|s| s.sixths).sum::<f64>();
    let centre = [0, 1].map(|i| shares.iter().map(|s| s.sixths * place(s)[i]).sum::<f64>() / force);
    (force, centre)
}

#[test]
fn on_a_point_the_six_vertices_carry_a_sixth_each_to_the_last_bit() {
    let mut work = Workspace::default();
    for (point, p) in sensor().points().iter().enumerate() {
        let loaded: Vec<_> = shares(Spreading::Sharp, p.x_mm, p.y_mm)
            .into_iter()
            .filter(|s| s.sixths != 0.0)
            .collect();
        let nodes: Vec<_> = loaded.iter().map(|s| s.node).collect();
        assert_eq!(nodes, model().mesh().points[point].vertices);
        assert!(loaded.iter().all(|s| s.sixths == 1.0));
    }
    let vertices = model().mesh().points[300].vertices;
    let forces = vertices.map(|node| NodeForce { node, force_n: 17.3 / 6.0 });
    let by_nodes = model().voltages_of_node_forces(&forces, &mut work).to_vec();
    assert_eq!(model().voltages(&[press(300, 17.3)], &mut work).unwrap(), by_nodes);
}

#[test]
fn force_and_moment_are_kept_inside_the_outermost_nodes() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..2000 {
        // All six corners are within the columns of nodes and the notches' closing triangles.
        let (x, y) = (rng.random_range(14.53..525.47), rng.random_range(10.0..550.0));
        for (spreading, most) in [(Spreading::Linear, 12), (Spreading::Sharp, 27)] {
            let all = shares(spreading, x, y);
            let (force, centre) = sums(&all);
            assert!((force - 6.0).abs() < 1e-12);
            assert!(spreading == Spreading::Sharp || all.iter().all(|s| s.sixths > -1e-12));
            assert!((centre[0] - x).hypot(centre[1] - y) < 1e-5, "({x}, {y}): {centre:?}");
            assert!(all.len() <= most || !(15.0..545.0).contains(&y), "{} nodes", all.len());
            for axis in 0..2 {
                let drift: f64 = all.iter().map(|s| s.slope_per_mm[axis]).sum();
                assert!(drift.abs() < 1e-12);
            }
        }
    }
}

#[test]
fn sharp_shares_have_no_second_moment_and_linear_ones_do() {
    let moment = |spreading, x: f64, y: f64| -> f64 {
        let of = |s: &Share| {
            let [px, py] = model().mesh().nodes_mm[s.node as usize];
            s.sixths * ((px - x).powi(2) + (py - y).powi(2))
        };
        shares(spreading, x, y).iter().map(of).sum::<f64>() / 6.0
    };
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut blur = 0.0f64;
    for _ in 0..500 {
        let (x, y) = (rng.random_range(60.0..480.0), rng.random_range(60.0..500.0));
        // The blur of the hexagon itself: its corners are 10 mm from the centre.
        assert!((moment(Spreading::Sharp, x, y) - 100.0).abs() < 1e-6);
        blur = blur.max(moment(Spreading::Linear, x, y) - 100.0);
    }
    assert!((30.0..100.0 / 3.0 + 1e-6).contains(&blur), "{blur} mm2");
}

#[test]
fn between_nodes_a_sharp_tip_draws_its_current_and_a_linear_one_does_not() {
    let [a, b, c] =
        model().mesh().triangles[3400].map(|node| model().mesh().nodes_mm[node as usize]);
    let mut work = Workspace::default();
    let mut conductance = |[x_mm, y_mm]: [f64; 2]| -> f64 {
        model().voltages(&[Contact { x_mm, y_mm, force_n: 20.0 }], &mut work).unwrap();
        work.to_top_s().iter().sum()
    };
    let on_nodes = [a, b, c].map(&mut conductance).iter().sum::<f64>() / 3.0;
    let middle = [0, 1].map(|i| (a[i] + b[i] + c[i]) / 3.0);
    let sharp = conductance(middle) / on_nodes;
    let linear = shares(Spreading::Linear, middle[0], middle[1]);
    let force = |s: &Share| NodeForce { node: s.node, force_n: 20.0 / 6.0 * s.sixths };
    let linear: Vec<NodeForce> = linear.iter().map(force).collect();
    model().voltages_of_node_forces(&linear, &mut work);
    let blurred = work.to_top_s().iter().sum::<f64>() / on_nodes;
    assert!((sharp - 1.0).abs() < 0.06 && blurred < 0.9, "{sharp} {blurred}");
}

#[test]
fn at_the_rim_no_force_is_lost_and_none_pulls() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for i in 0..2000 {
        let (x, y) = match i % 4 {
            0 => (rng.random_range(10.0..14.53), rng.random_range(10.0..550.0)),
            1 => (rng.random_range(525.47..530.0), rng.random_range(10.0..550.0)),
            2 => (rng.random_range(10.0..530.0), 10.0),
            _ => (if i % 8 == 3 { 10.0 } else { 530.0 }, if i % 16 < 8 { 10.0 } else { 550.0 }),
        };
        let all = shares(Spreading::Linear, x, y);
        let (force, centre) = sums(&all);
        assert!((force - 6.0).abs() < 1e-12 && all.iter().all(|s| s.sixths > -1e-12));
        // Two of six corners move by up to 4.6 mm; in the skin's corners one more by 2.5 mm.
        assert!(
            (centre[0] - x).abs() < 1.6 && (centre[1] - y).abs() < 0.5,
            "({x}, {y}): {centre:?}"
        );
    }
}

#[test]
fn shares_are_continuous_and_their_slopes_are_right() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let step = 1e-6;
    let mut kinks = 0;
    for _ in 0..3000 {
        let (x, y) = (rng.random_range(10.1..529.9), rng.random_range(10.1..549.9));
        for axis in 0..2 {
            let at = |by: f64| {
                let [dx, dy] = if axis == 0 { [by, 0.0] } else { [0.0, by] };
                shares(Spreading::Sharp, x + dx, y + dy)
            };
            let (low, here, high) = (at(-step), at(0.0), at(step));
            let of = |list: &[Share], node: u32| {
                list.iter().find(|s| s.node == node).map_or(0.0, |s| s.sixths)
            };
            for share in &here {
                let slope = (of(&high, share.node) - of(&low, share.node)) / (2.0 * step);
                assert!(slope.abs() < 1.0, "a jump at ({x}, {y})");
                kinks += usize::from((slope - share.slope_per_mm[axis]).abs() > 1e-6);
            }
        }
    }
    assert!(kinks < 5, "{kinks}");
}

#[test]
fn a_contact_off_the_skin_or_pulling_is_refused_by_name() {
    let mut work = Workspace::default();
    let mut refuse = |c: Contact| model().voltages(&[press(1, 1.0), c], &mut work).unwrap_err();
    let c = press(5, 10.0);
    let error = refuse(Contact { y_mm: 9.9, ..c });
    assert_eq!(
        error.to_string(),
        "contact 1: y_mm = 9.9 is outside 10 to 550 mm: a tip must be wholly on the skin"
    );
    let error = refuse(Contact { x_mm: f64::NAN, ..c });
    assert!(matches!(error, ContactError::OffSkin { contact: 1, field: "x_mm", .. }), "{error}");
    let error = refuse(Contact { force_n: -1.0, ..c });
    assert_eq!(error.to_string(), "contact 1: force_n = -1 is not a finite number >= 0 N");
    for force_n in [f64::NAN, f64::INFINITY] {
        assert!(matches!(refuse(Contact { force_n, ..c }), ContactError::Force { .. }));
    }
    let p = sensor().points()[point_at(270.0, 280.0)];
    for (x_mm, y_mm) in [(10.0, 10.0), (530.0, 550.0), (10.0, 281.3), (p.x_mm + 0.3, p.y_mm)] {
        let frame = model().voltages(&[Contact { x_mm, y_mm, force_n: 240.0 }], &mut work).unwrap();
        assert!(frame.iter().all(|v| v.is_finite() && v.abs() <= 12.0));
    }
}
