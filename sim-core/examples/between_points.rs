//! Blur of a tip between the nodes: foam conductance and size of the frame, compared with the
//! same tip on the nodes around it. `cargo run -p sim-core --example between_points`

use std::sync::Arc;

use sim_core::forward::{Contact, ForwardModel, Workspace};
use sim_core::responses::UnitResponses;
use sim_core::sensor::Sensor;
use sim_core::tip::Spreading;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sensor = Sensor::from_toml(include_str!("../../experiments/sensors/ert-28.toml"))?;
    let responses = Arc::new(UnitResponses::solve(&sensor)?);
    for spreading in [Spreading::Linear, Spreading::Sharp] {
        println!("{spreading:?}");
        let model = ForwardModel::new(&sensor, Arc::clone(&responses))?;
        print_ratios(&model.with_spreading(spreading))?;
    }
    Ok(())
}

fn print_ratios(model: &ForwardModel) -> Result<(), Box<dyn std::error::Error>> {
    let mesh = model.mesh();
    let inner = mesh.triangles.iter().filter(|t| {
        t.iter().all(|&n| {
            let [x, y] = mesh.nodes_mm[n as usize];
            (60.0..480.0).contains(&x) && (60.0..500.0).contains(&y)
        })
    });
    let triangles: Vec<_> =
        inner.step_by(97).map(|t| t.map(|n| mesh.nodes_mm[n as usize])).collect();
    let mut work = Workspace::default();
    let mut sums =
        |weights: &[f64; 3], force_n: f64| -> Result<[f64; 3], Box<dyn std::error::Error>> {
            let mut sums = [0.0; 3];
            for t in &triangles {
                let at = |i: usize| (0..3).map(|k| weights[k] * t[k][i]).sum::<f64>();
                let contact = Contact { x_mm: at(0), y_mm: at(1), force_n };
                let frame = model.voltages(&[contact], &mut work)?;
                sums[1] += frame.iter().map(|v| v * v).sum::<f64>().sqrt();
                sums[0] += work.to_top_s().iter().sum::<f64>();
                sums[2] += work.compression_mm().iter().copied().fold(0.0, f64::max);
            }
            Ok(sums)
        };
    let rest_s: f64 = {
        let mut work = Workspace::default();
        model.voltages(&[], &mut work)?;
        triangles.len() as f64 * work.to_top_s().iter().sum::<f64>()
    };
    println!("{} triangles; against the mean over their nodes", triangles.len());
    println!("force N  place            foam conductance  frame  deepest");
    for force_n in [1.0, 5.0, 10.0, 20.0, 40.0, 80.0] {
        let mut nodes = [0.0; 3];
        for corner in 0..3 {
            let mut weights = [0.0; 3];
            weights[corner] = 1.0;
            let of = sums(&weights, force_n)?;
            (0..3).for_each(|i| nodes[i] += of[i] / 3.0);
        }
        for (name, weights) in [
            ("a point's node", [1.0, 0.0, 0.0]),
            ("another node", [0.0, 1.0, 0.0]),
            ("edge, middle", [0.5, 0.5, 0.0]),
            ("other edge, middle", [0.0, 0.5, 0.5]),
            ("edge, quarter", [0.75, 0.25, 0.0]),
            ("triangle, middle", [1.0 / 3.0; 3]),
        ] {
            let of = sums(&weights, force_n)?;
            let ratio =
                [(of[0] - rest_s) / (nodes[0] - rest_s), of[1] / nodes[1], of[2] / nodes[2]];
            println!("{force_n:7}  {name:18}  {:14.4}  {:.4}  {:.4}", ratio[0], ratio[1], ratio[2]);
        }
    }
    Ok(())
}
