//! The derivative compared with differences of frames, and with identities that hold for all
//! values.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::circuit::ReadoutCircuit;
use sim_core::fields::{DisplacementLut, LutGrid, NodeFields};
use sim_core::forward::{Contact, ForwardModel, Workspace};
use sim_core::jacobian::{CONTACT_PARAMETERS, Field, JacobianWork, Mode};
use sim_core::stats::{sorted, upper_quantile};

use super::{model, responses, sensor};

const CHANNELS: usize = 784;

fn random_contacts(rng: &mut ChaCha8Rng) -> Vec<Contact> {
    let count = rng.random_range(1..=6);
    let ln_force = 0.5f64.ln()..80f64.ln();
    (0..count)
        .map(|_| Contact {
            x_mm: rng.random_range(12.0..528.0),
            y_mm: rng.random_range(12.0..548.0),
            force_n: rng.random_range(ln_force.clone()).exp(),
        })
        .collect()
}

fn frame(model: &ForwardModel, contacts: &[Contact]) -> Vec<f64> {
    model.voltages(contacts, &mut Workspace::default()).unwrap().to_vec()
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Distance of two columns, by the first one's length.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    let difference: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    norm(&difference) / norm(a)
}

/// Central differences at two steps, extrapolated to step 0 (Richardson): error of fourth order.
fn extrapolated(step: f64, at: impl Fn(f64) -> Vec<f64>) -> Vec<f64> {
    let central = |h: f64| -> Vec<f64> {
        at(h).iter().zip(at(-h)).map(|(high, low)| (high - low) / (2.0 * h)).collect()
    };
    let (wide, narrow) = (central(step), central(step / 2.0));
    wide.iter().zip(narrow).map(|(w, n)| (4.0 * n - w) / 3.0).collect()
}

fn moved(contacts: &[Contact], contact: usize, parameter: usize, by: f64) -> Vec<Contact> {
    let mut contacts = contacts.to_vec();
    let c = &mut contacts[contact];
    match parameter {
        0 => c.x_mm += by,
        1 => c.y_mm += by,
        _ => c.force_n += by,
    }
    contacts
}

/// Nodes that are pressed above the clamps.
fn pressed(model: &ForwardModel, contacts: &[Contact]) -> Vec<bool> {
    let mut work = Workspace::default();
    model.voltages(contacts, &mut work).unwrap();
    work.compression_mm().iter().map(|&x| x > 1e-4).collect()
}

/// Distance of a column from differences of frames with a step, minus the rounding error of these
/// (frames are accurate to 1e-11), relative to the column's length.
fn error(column: &[f64], numbers: &[f64], frame: &[f64], step: f64) -> f64 {
    let rounding = 2e-11 * norm(frame) / step;
    ((apart(column, numbers) * norm(column) - rounding) / norm(column)).max(0.0)
}

/// Errors of all smooth columns over random trials; a column is smooth if no node crosses a clamp
/// and no tip an edge of the lattice within the step.
fn contact_errors(model: &ForwardModel, trials: usize, broken: bool) -> (Vec<f64>, usize) {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut work = JacobianWork::default();
    let (mut errors, mut kinked) = (Vec::new(), 0);
    for _ in 0..trials {
        let contacts = random_contacts(&mut rng);
        let jacobian = model.linearise(&contacts, &mut work).unwrap().contacts().to_vec();
        assert_eq!(jacobian.len(), CHANNELS * CONTACT_PARAMETERS * contacts.len());
        for (i, column) in jacobian.chunks_exact(CHANNELS).enumerate() {
            let (contact, parameter) = (i / CONTACT_PARAMETERS, i % CONTACT_PARAMETERS);
            let step = if parameter == 2 { 1e-3 * contacts[contact].force_n } else { 1e-2 };
            let at = |by: f64| moved(&contacts, contact, parameter, by);
            let numbers = extrapolated(step, |by| frame(model, &at(by)));
            let slope = |by: f64| {
                let (contacts, mut work) = (at(by), JacobianWork::default());
                let mut linear = model.linearise(&contacts, &mut work).unwrap();
                linear.contacts()[CHANNELS * i..][..CHANNELS].to_vec()
            };
            let jumps = apart(&slope(step), &slope(-step)) > 1e-2;
            if jumps || pressed(model, &at(step)) != pressed(model, &at(-step)) {
                kinked += 1;
                continue;
            }
            let column: Vec<f64> =
                column.iter().map(|v| if broken { 1.001 * v } else { *v }).collect();
            errors.push(error(&column, &numbers, &frame(model, &contacts), step));
        }
    }
    (errors, kinked)
}

#[test]
fn contacts_agree_with_extrapolated_differences() {
    let (errors, kinked) = contact_errors(model(), 40, false);
    let errors = sorted(errors);
    let (median, worst) = (upper_quantile(&errors, 0.5).unwrap(), errors[errors.len() - 1]);
    println!("{} columns, {kinked} kinked: median {median:.1e}, worst {worst:.1e}", errors.len());
    assert!(errors.len() > 3 * kinked);
    assert!(worst < 1e-6);
}

#[test]
fn twin_a_derivative_a_thousandth_too_large_is_seen() {
    let (errors, _) = contact_errors(model(), 3, true);
    assert!(errors.iter().all(|&e| e > 5e-4));
}

/// A skin with every field, lead and electrode off its nominal value.
fn other_skin() -> ForwardModel {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let mut fields = NodeFields::nominal(model().mesh());
    for field in [
        &mut fields.ln_a,
        &mut fields.ln_b,
        &mut fields.ln_c,
        &mut fields.ln_compliance,
        &mut fields.ln_sheet_conductance,
    ] {
        field.iter_mut().for_each(|v| *v = rng.random_range(-0.2..0.2));
    }
    fields.ln_sheet_anisotropy = 0.2;
    let soft = |x: f64| x * (1.0 + 0.1 * x * (-x).exp());
    fields.displacement =
        Some(DisplacementLut::sample(LutGrid { step_mm: 0.05, end_mm: 30.0 }, soft).unwrap());
    let mut circuit = ReadoutCircuit::nominal(sensor());
    for (k, site) in circuit.electrodes.iter_mut().enumerate() {
        site.lead_ohm = 100.0 + 200.0 * k as f64;
        if k % 3 == 0 {
            site.x_mm += rng.random_range(-3.0..3.0);
            site.y_mm += rng.random_range(-3.0..3.0);
            site.contact_ohm = 30.0;
        }
    }
    ForwardModel::with(sensor(), responses(), fields, circuit).unwrap()
}

fn value<'a>(
    field: Field,
    index: usize,
    fields: &'a mut NodeFields,
    circuit: &'a mut ReadoutCircuit,
) -> &'a mut f64 {
    match field {
        Field::LnA => &mut fields.ln_a[index],
        Field::LnB => &mut fields.ln_b[index],
        Field::LnC => &mut fields.ln_c[index],
        Field::LnCompliance => &mut fields.ln_compliance[index],
        Field::LnSheetConductance => &mut fields.ln_sheet_conductance[index],
        Field::LnSheetAnisotropy => &mut fields.ln_sheet_anisotropy,
        Field::LeadOhm => &mut circuit.electrodes[index].lead_ohm,
        Field::ContactOhm => &mut circuit.electrodes[index].contact_ohm,
        Field::ElectrodeX => &mut circuit.electrodes[index].x_mm,
        Field::ElectrodeY => &mut circuit.electrodes[index].y_mm,
    }
}

/// The model a step along a mode.
fn along(model: &ForwardModel, mode: &Mode, by: f64) -> ForwardModel {
    let (mut fields, mut circuit) = (model.fields().clone(), model.circuit().clone());
    for &(index, moved) in &mode.entries {
        *value(mode.field, index as usize, &mut fields, &mut circuit) += by * moved;
    }
    ForwardModel::with(sensor(), responses(), fields, circuit).unwrap()
}

/// Two modes of a field: random over a tenth of its values; on electrodes, those off the nodes.
fn random_modes(model: &ForwardModel, rng: &mut ChaCha8Rng) -> Vec<Mode> {
    let mut modes = Vec::new();
    for field in Field::ALL.into_iter().flat_map(|field| [field; 2]) {
        let count = field.len(model) as u32;
        let on_electrodes = count == 28;
        let mut entries = Vec::new();
        for i in 0..count {
            if if on_electrodes { i % 3 == 0 } else { count == 1 || rng.random_bool(0.1) } {
                entries.push((i, rng.random_range(-1.0..1.0)));
            }
        }
        modes.push(Mode { field, entries });
    }
    modes
}

#[test]
fn fields_agree_with_extrapolated_differences() {
    let model = other_skin();
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    let mut work = JacobianWork::default();
    for trial in 0..3 {
        let contacts = random_contacts(&mut rng);
        let modes = random_modes(&model, &mut rng);
        let mut linear = model.linearise(&contacts, &mut work).unwrap();
        let columns = linear.modes(&modes).to_vec();
        for (mode, column) in modes.iter().zip(columns.chunks_exact(CHANNELS)) {
            let step = match mode.field {
                Field::LeadOhm | Field::ContactOhm => 1.0,
                Field::LnC => 0.1,
                Field::LnA | Field::ElectrodeX | Field::ElectrodeY => 1e-2,
                _ => 1e-3,
            };
            let numbers = extrapolated(step, |by| frame(&along(&model, mode, by), &contacts));
            let error = error(column, &numbers, &frame(&model, &contacts), step);
            println!(
                "trial {trial} {:?}: {:.1e}, beyond rounding {error:.1e}",
                mode.field,
                apart(column, &numbers)
            );
            assert!(error < 1e-5, "{:?}: {error:e}", mode.field);
        }
    }
}

fn whole(model: &ForwardModel, field: Field) -> Mode {
    let entries = (0..field.len(model) as u32).map(|i| (i, 1.0)).collect();
    Mode { field, entries }
}

/// All resistances times one factor, or all forces and the compliance by inverse ones, do not
/// change the frame. Returns the residuals of the two sums, relative to the size of their terms.
fn sum_rules(model: &ForwardModel, contacts: &[Contact], work: &mut JacobianWork) -> [f64; 2] {
    let mut linear = model.linearise(contacts, work).unwrap();
    let mut modes = [Field::LnA, Field::LnC, Field::LnSheetConductance, Field::LnCompliance]
        .map(|f| whole(model, f))
        .to_vec();
    for e in &mut modes[2].entries {
        e.1 = -1.0;
    }
    for (field, of) in [
        (Field::LeadOhm, (|e| e.lead_ohm) as fn(&sim_core::circuit::ElectrodeSite) -> f64),
        (Field::ContactOhm, |e| e.contact_ohm),
    ] {
        let sites = model.circuit().electrodes.iter().enumerate();
        modes.push(Mode { field, entries: sites.map(|(k, e)| (k as u32, of(e))).collect() });
    }
    let columns = linear.modes(&modes).to_vec();
    let column = |i: usize| &columns[CHANNELS * i..][..CHANNELS];
    let by_contacts = linear.contacts();
    let total = |parts: &[(f64, &[f64])]| -> f64 {
        let sum: Vec<f64> =
            (0..CHANNELS).map(|i| parts.iter().map(|(w, p)| w * p[i]).sum()).collect();
        let size: f64 = parts.iter().map(|(w, p)| w.abs() * norm(p)).fold(0.0, f64::max);
        norm(&sum) / size
    };
    let scaled = [0, 1, 2, 4, 5].map(|i| (1.0, column(i)));
    let mut pressed = vec![(-1.0, column(3))];
    for (c, by) in contacts.iter().zip(by_contacts.chunks_exact(CHANNELS * CONTACT_PARAMETERS)) {
        pressed.push((c.force_n, &by[2 * CHANNELS..]));
    }
    [total(&scaled), total(&pressed)]
}

#[test]
fn what_leaves_the_frame_unchanged_has_no_derivative() {
    let mut work = JacobianWork::default();
    let mut rng = ChaCha8Rng::seed_from_u64(24);
    let other = other_skin();
    let centre = |force_n| vec![Contact { x_mm: 263.0, y_mm: 277.0, force_n }];
    let loads: Vec<_> = (0..10)
        .map(|_| random_contacts(&mut rng))
        .chain([0.05, 0.5, 5.0, 240.0].map(centre))
        .collect();
    for contacts in &loads {
        for model in [model(), &other] {
            let left = sum_rules(model, contacts, &mut work);
            println!(
                "{} contacts, {:.2} N: {:.1e}, {:.1e}",
                contacts.len(),
                contacts[0].force_n,
                left[0],
                left[1]
            );
            assert!(left.iter().all(|&left| left < 1e-9), "{left:?}");
        }
    }
    // The untouched skin scales too; there is no contact to move.
    assert!(sum_rules(model(), &[], &mut work)[0] < 1e-9);
}

#[test]
fn a_linearised_models_frame_is_the_models_to_the_last_bit() {
    let mut rng = ChaCha8Rng::seed_from_u64(25);
    let mut work = JacobianWork::default();
    for _ in 0..5 {
        let contacts = random_contacts(&mut rng);
        let linear = model().linearise(&contacts, &mut work).unwrap();
        assert_eq!(linear.frame_v(), frame(model(), &contacts));
    }
}
