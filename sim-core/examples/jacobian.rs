//! The adjoint Jacobian compared with one-sided differences: time and agreement.
//! `cargo run -p sim-core --example jacobian`

use std::sync::Arc;
use std::time::{Duration, Instant};

use sim_core::forward::{Contact, ForwardModel, Workspace};
use sim_core::jacobian::{Field, FieldGradient, JacobianWork, Mode};
use sim_core::responses::UnitResponses;
use sim_core::sensor::Sensor;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sensor = Sensor::from_toml(include_str!("../../experiments/sensors/ert-28.toml"))?;
    let model = ForwardModel::new(&sensor, Arc::new(UnitResponses::solve(&sensor)?))?;
    let (mut work, mut adjoint) = (Workspace::default(), JacobianWork::default());
    println!("contacts  frame us  factor  jacobian  differences  ratio  (best of 100, one core)");
    for count in [1, 3, 6] {
        let contacts: Vec<Contact> = (0..count)
            .map(|i| {
                let turn = f64::from(i);
                let (x_mm, y_mm) = (270.0 + 150.0 * turn.cos(), 280.0 + 150.0 * turn.sin());
                Contact { x_mm, y_mm, force_n: 10.0 + 5.0 * turn }
            })
            .collect();
        let frame = best(|| model.voltages(&contacts, &mut work).map(|_| ()))?;
        let factor = best(|| model.linearise(&contacts, &mut adjoint).map(|_| ()))?;
        let jacobian = best(|| model.jacobian(&contacts, &mut adjoint).map(|_| ()))?;
        let differences = best(|| {
            for i in 0..3 * contacts.len() {
                let mut moved = contacts.clone();
                let c = &mut moved[i / 3];
                *[&mut c.x_mm, &mut c.y_mm, &mut c.force_n][i % 3] += 1e-3;
                model.voltages(&moved, &mut work)?;
            }
            model.voltages(&contacts, &mut work).map(|_| ())
        })?;
        let ratio = differences / jacobian;
        println!(
            "{count:8}  {frame:8.0}  {factor:6.0}  {jacobian:8.0}  {differences:11.0}  {ratio:5.1}"
        );
    }
    let contacts = [Contact { x_mm: 200.0, y_mm: 200.0, force_n: 20.0 }];
    let mut gradient = FieldGradient::zeros(&model);
    let residual = vec![1.0; sensor.channels()];
    let pull = best(|| {
        model.linearise(&contacts, &mut adjoint).map(|mut l| l.pull(&residual, &mut gradient))
    })?;
    let count: usize = Field::ALL.iter().map(|field| field.len(&model)).sum();
    println!("gradient by all {count} parameters of the fields: {pull:.0} us, factor included");
    let modes: Vec<Mode> = (0..200)
        .map(|m| Mode {
            field: Field::LnA,
            entries: (m * 17..m * 17 + 60).map(|i| (i, 1.0)).collect(),
        })
        .collect();
    let by_modes = best(|| {
        model.linearise(&contacts, &mut adjoint).map(|mut l| l.modes(&modes).len()).map(|_| ())
    })?;
    println!("jacobian by 200 modes of 60 nodes: {by_modes:.0} us, factor included");
    Ok(())
}

/// Least time of 100 runs, us.
fn best<E>(mut run: impl FnMut() -> Result<(), E>) -> Result<f64, E> {
    let mut least = Duration::MAX;
    for _ in 0..100 {
        let began = Instant::now();
        run()?;
        least = least.min(began.elapsed());
    }
    Ok(1e6 * least.as_secs_f64())
}
