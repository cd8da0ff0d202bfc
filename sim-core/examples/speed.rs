//! Time per frame of each method, in one run: `cargo run -p sim-core --example speed`.
//! Uses: all of sim-core, faer, ngspice where it is installed. Never: more than one thread.
//!
//! Every figure is the least of many repetitions on one core, so that other work on the machine
//! matters little. Prints Markdown.

use std::error::Error;
use std::hint::black_box;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Conj, Mat, Par, Side};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::batch::{BatchModel, BatchWork, Kernel};
use sim_core::forward::{Contact, ForwardModel, Workspace};
use sim_core::network::SheetNetwork;
use sim_core::responses::UnitResponses;
use sim_core::sensor::Sensor;
use sim_core::spice::{LoadedCircuit, netlist};

/// Contacts per trial.
const COUNTS: [usize; 3] = [1, 3, 6];
/// Trials per repetition of the batch paths: a multiple of the lanes of every kernel.
const TRIALS: usize = 64;

fn main() -> Result<(), Box<dyn Error>> {
    let sensor = Sensor::from_toml(include_str!("../../experiments/sensors/ert-28.toml"))?;
    let model = ForwardModel::new(&sensor, Arc::new(responses(&sensor)?))?;
    let trials = COUNTS.map(|contacts| random_trials(&sensor, contacts));
    let mut rows: Vec<(String, [f64; 3])> = Vec::new();

    println!("| kernel | multiply-adds/ns, peak | reached | share |\n|---|---|---|---|");
    for kernel in Kernel::ALL.into_iter().filter(|kernel| kernel.is_here()) {
        let batch = BatchModel::new(&model, kernel);
        let us = [0, 1, 2].map(|i| batch_us(&batch, &trials[i]));
        let peak = peak_per_ns(kernel);
        let reached = model.multiply_adds() as f64 / (1e3 * us[0]);
        let share = 100.0 * reached / peak;
        println!("| {} | {peak:.1} | {reached:.1} | {share:.0} % |", kernel.name());
        rows.push((format!("ours, {}", kernel.name()), us));
    }
    let mut work = Workspace::default();
    let us = trials.each_ref().map(|trials| {
        least_us(40, || {
            black_box(model.voltages(&trials[0], &mut work).expect("the trial is legal"));
        })
    });
    rows.push(("ours, f64, one at a time".into(), us));
    let network = model.network()?;
    let mut faer = [[0.0; 3]; 2];
    for (i, trials) in trials.iter().enumerate() {
        model.voltages(&trials[0], &mut work)?;
        let matrix = conductances(&network, work.to_top_s())?;
        faer[0][i] = one_factor_us(&network, &matrix)?;
        faer[1][i] = factor_per_injection_us(&network, work.to_top_s())?;
    }
    rows.push(("faer: sparse LLT (analysed once), 28 solves; network only".into(), faer[0]));
    rows.push(("faer: 28 separate factorisations, as the paper; network only".into(), faer[1]));
    match ngspice_us(&model, &network, &trials, &mut work)? {
        Some(us) => rows.push(("ngspice, 28 x one injection; network only".into(), us)),
        None => println!("\nngspice is not installed: skipped"),
    }
    print_table(&rows);
    println!(
        "\n{} nodes, {} resistors, {} multiply-adds a frame. Paper: 0.41 s a trial, two threads.",
        network.places_mm.len(),
        network.resistors.len(),
        model.multiply_adds()
    );
    Ok(())
}

fn print_table(rows: &[(String, [f64; 3])]) {
    println!("\n| us a trial and core | 1 contact | 3 contacts | 6 contacts | ratio |");
    println!("|---|---|---|---|---|");
    let fastest = rows[0].1[2];
    for (name, us) in rows {
        let digits = if us[0] < 1e3 { 1 } else { 0 };
        let [a, b, c] = us.map(|us| format!("{us:.digits$}"));
        println!("| {name} | {a} | {b} | {c} | {:.1} |", us[2] / fastest);
    }
}

/// The unit responses, from a cache in the system's temporary folder if there is one.
fn responses(sensor: &Sensor) -> Result<UnitResponses, Box<dyn Error>> {
    let path = std::env::temp_dir().join("sim-core-speed.responses");
    if let Ok(bytes) = std::fs::read(&path)
        && let Ok(responses) = UnitResponses::from_bytes(&bytes, sensor)
    {
        return Ok(responses);
    }
    let responses = UnitResponses::solve(sensor)?;
    std::fs::write(&path, responses.to_bytes())?;
    Ok(responses)
}

/// Contacts on different points, 5 to 40 N.
fn random_trials(sensor: &Sensor, contacts: usize) -> Vec<Vec<Contact>> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let points = sensor.points();
    let mut contact = || {
        let p = points[rng.random_range(0..points.len())];
        Contact { x_mm: p.x_mm, y_mm: p.y_mm, force_n: rng.random_range(5.0..40.0) }
    };
    (0..TRIALS).map(|_| (0..contacts).map(|_| contact()).collect()).collect()
}

/// Least time of some repetitions, us.
fn least_us(repetitions: usize, mut work: impl FnMut()) -> f64 {
    let once = |_| {
        let start = Instant::now();
        work();
        start.elapsed()
    };
    let least = (0..repetitions).map(once).min().unwrap_or(Duration::MAX);
    1e6 * least.as_secs_f64()
}

fn batch_us(batch: &BatchModel, trials: &[Vec<Contact>]) -> f64 {
    let trials: Vec<&[Contact]> = trials.iter().map(Vec::as_slice).collect();
    let mut out = vec![0.0; trials.len() * batch.frame_len()];
    let mut work = BatchWork::default();
    let us = least_us(100, || {
        batch.voltages(black_box(&trials), &mut out, &mut work).expect("the trials are legal");
    });
    us / trials.len() as f64
}

fn peak_per_ns(kernel: Kernel) -> f64 {
    let count = 600_000;
    let us = least_us(40, || {
        black_box(kernel.multiply_adds(black_box(count)));
    });
    (count * kernel.lanes()) as f64 / (1e3 * us)
}

/// The network's matrix, lower triangle; the top layer is ground.
fn conductances(
    network: &SheetNetwork,
    to_top_s: &[f64],
) -> Result<SparseColMat<usize, f64>, Box<dyn Error>> {
    let mut triplets: Vec<_> =
        to_top_s.iter().enumerate().map(|(i, &g)| Triplet::new(i, i, g)).collect();
    for r in &network.resistors {
        let (i, j, g) = (r.a as usize, r.b as usize, r.conductance_s);
        triplets.push(Triplet::new(i, i, g));
        triplets.push(Triplet::new(j, j, g));
        triplets.push(Triplet::new(i.max(j), i.min(j), -g));
    }
    let n = to_top_s.len();
    SparseColMat::try_new_from_triplets(n, n, &triplets).map_err(|e| format!("{e:?}").into())
}

/// One numeric factorisation and 28 solves after the analysis; the faster of faer's two layouts.
fn one_factor_us(
    network: &SheetNetwork,
    matrix: &SparseColMat<usize, f64>,
) -> Result<f64, Box<dyn Error>> {
    let simplicial = factor_us(network, matrix, SupernodalThreshold::FORCE_SIMPLICIAL)?;
    Ok(simplicial.min(factor_us(network, matrix, SupernodalThreshold::FORCE_SUPERNODAL)?))
}

fn factor_us(
    network: &SheetNetwork,
    matrix: &SparseColMat<usize, f64>,
    layout: SupernodalThreshold,
) -> Result<f64, Box<dyn Error>> {
    let symbolic = factorize_symbolic_cholesky(
        matrix.symbolic(),
        Side::Lower,
        SymmetricOrdering::Amd,
        CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: layout,
            ..CholeskySymbolicParams::default()
        },
    )
    .map_err(|e| format!("{e:?}"))?;
    let electrodes = &network.electrodes;
    let scratch = symbolic
        .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
        .or(symbolic.solve_in_place_scratch::<f64>(electrodes.len(), Par::Seq));
    let mut memory = MemBuffer::new(scratch);
    let mut values = vec![0.0; symbolic.len_val()];
    let mut right = Mat::<f64>::zeros(matrix.nrows(), electrodes.len());
    Ok(least_us(20, || {
        symbolic
            .factorize_numeric_llt(
                &mut values,
                matrix.as_ref(),
                Side::Lower,
                Default::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                Default::default(),
            )
            .expect("the network reaches the top layer");
        right.fill(0.0);
        for (k, &electrode) in electrodes.iter().enumerate() {
            right[(electrode as usize, k)] = 1.0;
        }
        let factor = LltRef::new(&symbolic, &values);
        factor.solve_in_place_with_conj(
            Conj::No,
            right.as_mut(),
            Par::Seq,
            MemStack::new(&mut memory),
        );
    }))
}

/// Solves each injection as a separate system, with that electrode as ground: analysis and
/// factorisation are repeated.
fn factor_per_injection_us(
    network: &SheetNetwork,
    to_top_s: &[f64],
) -> Result<f64, Box<dyn Error>> {
    faer::set_global_parallelism(Par::Seq);
    let grounded: Vec<_> = network
        .electrodes
        .iter()
        .map(|&electrode| {
            // Ground is represented by a conductance far above all others.
            let mut to_ground = to_top_s.to_vec();
            to_ground[electrode as usize] += 1e6;
            conductances(network, &to_ground)
        })
        .collect::<Result<_, _>>()?;
    let right = Mat::<f64>::from_fn(to_top_s.len(), 1, |i, _| 12.0 * to_top_s[i]);
    Ok(least_us(2, || {
        for matrix in &grounded {
            let factor = matrix.sp_cholesky(Side::Lower).expect("the network is grounded");
            black_box(factor.solve(&right));
        }
    }))
}

/// ngspice's wall time for one injection, times 28; `None` where it is not installed.
fn ngspice_us(
    model: &ForwardModel,
    network: &SheetNetwork,
    trials: &[Vec<Vec<Contact>>; 3],
    work: &mut Workspace,
) -> Result<Option<[f64; 3]>, Box<dyn Error>> {
    if Command::new("ngspice").arg("--version").output().is_err() {
        return Ok(None);
    }
    let path = std::env::temp_dir().join(format!("sim-core-speed-{}.cir", std::process::id()));
    let mut us = [0.0; 3];
    for (us, trials) in us.iter_mut().zip(trials) {
        model.voltages(&trials[0], work)?;
        let (circuit, to_top_s) = (model.circuit(), work.to_top_s());
        let skin = LoadedCircuit { title: "one injection", network, circuit, to_top_s };
        std::fs::write(&path, netlist(&skin, 0)?)?;
        *us = 28.0
            * least_us(2, || {
                let run = Command::new("ngspice").arg("-b").arg(&path).output();
                assert!(run.is_ok_and(|run| run.status.success()), "ngspice failed");
            });
    }
    std::fs::remove_file(&path)?;
    Ok(Some(us))
}
