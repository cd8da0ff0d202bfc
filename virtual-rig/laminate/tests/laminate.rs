//! The skin of gap c against limits, balance, refinement, reciprocity and ngspice.

use std::fmt::Write;
use std::process::Command;

use laminate::laws::{ConductanceLaw, FoamLaw};
use laminate::press::{Foundation, Patch, Punch};
use laminate::sheet::Sheet;
use laminate::{Forces, Laminate, Laws, Plan, Readout, Stroke, Touch};

const GAP_C: &str = include_str!("../../../experiments/gaps/gap-c.toml");

fn laws() -> Laws {
    let file: toml::Table = toml::from_str(GAP_C).unwrap();
    file["laminate"].clone().try_into().unwrap()
}

/// The paper's skin with electrodes on a square lattice, symmetric about both axes.
fn plan() -> Plan {
    let places = [45.0, 135.0, 225.0, 315.0, 405.0, 495.0];
    let electrodes_mm = places.iter().flat_map(|&y| places.map(|x| [x, y + 10.0]));
    Plan {
        size_mm: [540.0, 560.0],
        electrodes_mm: electrodes_mm.collect(),
        tip_diameter_mm: 20.0,
        foam_mm: 4.0,
        sheet_ohm_per_sq: 1e4,
        source_v: 12.0,
    }
}

/// Laws without chance.
fn even(mut laws: Laws) -> Laws {
    (laws.foam.ln_sd, laws.sheet.ln_sd) = (0.0, 0.0);
    (laws.conductance.ln_sd, laws.conductance.ln_cell_sd) = (0.0, 0.0);
    (laws.tips.tilt_sd_deg, laws.tips.slope_sd_deg, laws.stage.height_sd_mm) = (0.0, 0.0, 0.0);
    let e = &mut laws.electrodes;
    (e.offset_sd_mm, e.contact_ln_sd, e.lead_ln_sd) = (0.0, 0.0, 0.0);
    laws
}

fn touch(x_mm: f64, y_mm: f64, force_n: f64) -> Touch {
    Touch { arm: 0, at_mm: [x_mm, y_mm], force_n, stroke: Stroke::Loading }
}

fn press(laws: &Laws, punch: Punch) -> (Foundation, Patch) {
    let foundation = Foundation::nominal(&plan(), laws, 100.0);
    let patch = foundation.press(&[punch]).unwrap().remove(0);
    (foundation, patch)
}

fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    (values.map(|v| v * v).sum::<f64>() / count).sqrt()
}

/// Relative difference of two frames.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    rms(a.iter().zip(b).map(|(a, b)| a - b)) / rms(b.iter().copied())
}

#[test]
fn columns_that_do_not_touch_follow_the_foams_law() {
    let mut laws = laws();
    (laws.cover.tension_n_per_mm, laws.cover.bending_n_mm, laws.foam.shear_mpa) = (0.0, 0.0, 0.0);
    let punch = Punch { at_mm: [50.0, 50.0], force_n: 20.0, slope: [0.0; 2] };
    let (foundation, patch) = press(&laws, punch);
    let grid = foundation.grid();
    let inside = |cell| grid.share(cell, punch.at_mm, 10.0, 4) == 1.0;
    let under = patch.pressures_mpa.iter().filter(|(cell, _)| inside(*cell));
    let pressures: Vec<f64> = under.map(|(_, pressure)| *pressure).collect();
    let (least, most) =
        pressures.iter().fold((f64::MAX, 0.0), |(a, b): (f64, f64), p| (a.min(*p), b.max(*p)));
    assert!(pressures.len() > 30 && most / least - 1.0 < 1e-6, "{least} .. {most}");
    // The depth of foam and fabric at that pressure, by the laws themselves.
    let depth = 4.0 * laws.foam.law.strain(most) + laws.cover.overlap_mm(most);
    assert!((patch.depths_mm[0] / depth - 1.0).abs() < 1e-6, "{} {depth}", patch.depths_mm[0]);
    let beyond =
        patch.pressures_mpa.iter().filter(|(c, _)| grid.share(*c, punch.at_mm, 10.0, 4) == 0.0);
    assert!(beyond.map(|(_, p)| p.abs()).fold(0.0, f64::max) < 1e-9 * most);
}

#[test]
fn the_foam_carries_the_force_and_yields_before_it_locks() {
    let depth = |force_n: f64| {
        let punch = Punch { at_mm: [50.0, 50.0], force_n, slope: [0.01, -0.02] };
        let (foundation, patch) = press(&laws(), punch);
        let area = foundation.grid().side_mm.powi(2);
        let carried: f64 = patch.pressures_mpa.iter().map(|(_, p)| area * p).sum();
        // What is missing goes through the fabric to beyond the patch.
        assert!((carried / force_n - 1.0).abs() < 0.01, "{carried} of {force_n} N");
        assert!(patch.steps < 40, "{} steps", patch.steps);
        patch.depths_mm[0]
    };
    let depths: Vec<f64> = [5.0, 10.0, 20.0, 40.0, 80.0].map(depth).to_vec();
    let slopes: Vec<f64> = depths.windows(2).map(|d| d[1] - d[0]).collect();
    assert!(slopes.iter().all(|s| *s > 0.05), "{depths:?}");
    // Twice the force: less than twice the way once the foam locks.
    assert!(slopes[3] < 2.0 * slopes[2], "{depths:?}");
}

#[test]
fn a_tilted_tip_presses_with_the_edge_that_it_has_in_the_skin() {
    let tilted = Punch { at_mm: [50.0, 50.0], force_n: 3.0, slope: [0.15, 0.0] };
    let (foundation, patch) = press(&laws(), tilted);
    let at = |x_mm: f64| {
        let near = |(cell, _): &&(usize, f64)| {
            let [x, y] = foundation.grid().centre_mm(*cell);
            (x - x_mm).abs() < 1.3 && (y - 50.0).abs() < 1.3
        };
        patch.pressures_mpa.iter().find(near).unwrap().1
    };
    assert!(at(57.5) > 20.0 * at(42.5).abs(), "{} {}", at(57.5), at(42.5));
}

#[test]
fn tips_that_are_near_share_the_fabric_and_far_ones_do_not() {
    let skin = Laminate::new(&plan(), &even(laws()), 1).unwrap();
    let sum = |touches: &[Touch]| skin.pressures_mpa(touches).unwrap();
    let together = |gap_mm: f64| {
        let pair = [touch(270.0, 280.0, 15.0), touch(270.0 + gap_mm, 280.0, 15.0)];
        let [both, one, other] = [&pair[..], &pair[..1], &pair[1..]].map(sum);
        let alone: Vec<f64> = one.iter().zip(&other).map(|(a, b)| a + b).collect();
        apart(&both, &alone)
    };
    assert!(together(60.0) < 1e-3, "{}", together(60.0));
    assert!(together(22.5) > 0.01, "{}", together(22.5));
}

#[test]
fn finer_squares_change_the_frame_little() {
    let frame = |foam_mm: f64, sheet_mm: f64| {
        let mut laws = even(laws());
        (laws.grid.foam_mm, laws.grid.sheet_mm) = (foam_mm, sheet_mm);
        let skin = Laminate::new(&plan(), &laws, 1).unwrap();
        skin.voltages(&[touch(203.0, 301.0, 20.0), touch(333.0, 122.0, 10.0)]).unwrap()
    };
    let finest = frame(1.25, 2.5);
    let [coarse, fine] = [frame(2.5, 5.0), frame(1.25, 5.0)].map(|frame| apart(&frame, &finest));
    println!("relative change to squares of 1.25 and 2.5 mm: {coarse:.4}, sheet alone {fine:.4}");
    assert!(coarse < 0.05 && fine < 0.05, "{coarse} {fine}");
}

#[test]
fn impedances_are_reciprocal_and_a_mirrored_touch_gives_a_mirrored_frame() {
    let plan = plan();
    let sheet = Sheet::new(&plan, &laws(), 4).unwrap();
    let leaks: Vec<f64> = (0..sheet.grid().cells()).map(|n| 1e-12 * (1 + n % 7) as f64).collect();
    let (z, n) = (sheet.impedances_ohm(&leaks).unwrap(), plan.electrodes_mm.len());
    let odd =
        (0..n * n).map(|at| (z[at] - z[n * (at % n) + at / n]).abs() / z[at]).fold(0.0, f64::max);
    assert!(odd < 1e-10, "{odd}");
    // Mirrored about x: electrode j becomes mirror(j).
    let skin = Laminate::new(&plan, &even(laws()), 1).unwrap();
    let mirror = |j: usize| j / 6 * 6 + (5 - j % 6);
    let volts = |x_mm: f64| -> Vec<f64> {
        let frame = skin.voltages(&[touch(x_mm, 200.0, 30.0)]).unwrap();
        // From differences back to voltages against the electrode of the injection.
        (0..n * n)
            .map(|at| {
                let (k, j) = (at / n, at % n);
                let along =
                    |from: usize, to: usize| (from..to).map(|i| frame[n * k + i]).sum::<f64>();
                if j < k { along(j, k) } else { -along(k, j) }
            })
            .collect()
    };
    let (left, right) = (volts(200.0), volts(340.0));
    let mirrored: Vec<f64> =
        (0..n * n).map(|at| right[n * mirror(at / n) + mirror(at % n)]).collect();
    assert!(apart(&left, &mirrored) < 1e-8, "{}", apart(&left, &mirrored));
    assert!(apart(&left, &right) > 0.1);
}

#[test]
fn differences_vanish_with_the_resistance_of_the_sheet_and_pressure_makes_them() {
    let mut laws = even(laws());
    laws.electrodes.lead_ohm = 0.0;
    let skin = Laminate::new(&plan(), &laws, 1).unwrap();
    let pressed =
        |skin: &Laminate| rms(skin.voltages(&[touch(270.0, 280.0, 40.0)]).unwrap().into_iter());
    let mut ten_times_less = laws.clone();
    ten_times_less.electrodes.contact_ohm_mm2 /= 10.0;
    let metal = Plan { sheet_ohm_per_sq: 1e3, ..plan() };
    let ratio = pressed(&skin) / pressed(&Laminate::new(&metal, &ten_times_less, 1).unwrap());
    assert!((9.5..10.0).contains(&ratio), "{ratio}");
    let mv = |touches: &[Touch]| 1e3 * rms(skin.voltages(touches).unwrap().into_iter());
    let signals = [mv(&[]), mv(&[touch(270.0, 280.0, 5.0)]), mv(&[touch(270.0, 280.0, 40.0)])];
    assert!(
        signals[0] < 0.1 && signals[1] > 0.1 && signals[2] > 20.0 * signals[1],
        "{signals:?} mV"
    );
    let back = Touch { stroke: Stroke::Unloading, ..touch(270.0, 280.0, 5.0) };
    assert!(mv(&[back]) > 1.05 * signals[1]);
    for nowhere in
        [touch(-1.0, 280.0, 9.0), touch(270.0, 280.0, f64::NAN), touch(270.0, 280.0, 0.0)]
    {
        assert_eq!(skin.voltages(&[nowhere]).unwrap(), skin.voltages(&[]).unwrap());
    }
}

#[test]
fn a_seed_is_a_skin() {
    let frame = |seed| {
        let skin = Laminate::new(&plan(), &laws(), seed).unwrap();
        skin.voltages(&[touch(270.0, 280.0, 20.0), touch(100.0, 100.0, 12.0)]).unwrap()
    };
    let first = frame(3);
    assert_eq!(first, frame(3));
    let other = apart(&frame(4), &first);
    assert!((0.1..3.0).contains(&other), "{other}");
}

#[test]
fn forces_grow_with_depth_from_the_height_of_the_skin() {
    let forces = Forces::new(&plan(), &laws(), 2).unwrap();
    let mut at_five_mm = Vec::new();
    for (x, y) in [(60.0, 70.0), (270.0, 280.0), (333.0, 122.0), (480.0, 500.0)] {
        for arm in 0..6 {
            let force = |z_mm: f64, stroke| forces.force_n(arm, [x, y], z_mm, stroke);
            let curve: Vec<f64> =
                (0..=50).map(|n| force(0.1 * f64::from(n), Stroke::Loading)).collect();
            assert!(curve.windows(2).all(|f| f[1] >= f[0]), "{curve:?}");
            assert_eq!(force(-3.0, Stroke::Loading), 0.0);
            assert!(force(4.0, Stroke::Unloading) < force(4.0, Stroke::Loading));
            // No jump: a tenth of a millimetre is at most a few newtons.
            assert!(curve.windows(2).all(|f| f[1] - f[0] < 3.0), "{curve:?}");
            at_five_mm.push(curve[50]);
        }
    }
    let mean = at_five_mm.iter().sum::<f64>() / at_five_mm.len() as f64;
    assert!((20.0..50.0).contains(&mean), "{mean} N at 5 mm");
}

#[test]
fn a_readout_counts_drifts_and_hums() {
    let laws = laws();
    let still = vec![0.0; 784];
    let mean_frame = |readout: &mut Readout, from_s: f64, frames: u32| {
        let mut sum = vec![0.0; 784];
        let mut frame = vec![0.0f32; 784];
        for n in 0..frames {
            readout.frame(&still, from_s + f64::from(n) / 30.0, &mut frame);
            sum.iter_mut()
                .zip(&frame)
                .for_each(|(sum, v)| *sum += f64::from(*v) / f64::from(frames));
        }
        sum
    };
    let mut readout = Readout::new(&laws, 1, 28);
    let mut frame = vec![0.0f32; 784];
    readout.frame(&still, 0.0, &mut frame);
    let counts = frame.iter().map(|v| f64::from(*v) / (1e-3 * laws.readout.count_mv));
    assert!(
        counts.clone().all(|c| (c - c.round()).abs() < 1e-2) && counts.clone().any(|c| c != 0.0)
    );
    let mut readout = Readout::new(&laws, 1, 28);
    let (first, soon) = (mean_frame(&mut readout, 0.0, 300), mean_frame(&mut readout, 60.0, 300));
    let later = mean_frame(&mut readout, 86_400.0, 300);
    // Per pair over all injections, without what all channels share.
    let pairs = |frame: &[f64]| {
        let mean = frame.iter().sum::<f64>() / 784.0;
        (0..28)
            .map(|j| frame.iter().skip(j).step_by(28).sum::<f64>() / 28.0 - mean)
            .collect::<Vec<_>>()
    };
    let change_mv =
        |a: &[f64], b: &[f64]| 1e3 * rms(pairs(a).iter().zip(pairs(b)).map(|(a, b)| a - b));
    let (minute, day) = (change_mv(&soon, &first), change_mv(&later, &first));
    println!("offsets change by {minute:.3} mV in a minute, {day:.3} mV in a day");
    assert!(day > 1.5 * minute && (0.04..0.15).contains(&day), "{minute} {day}");
    // The offset of the converter is that of all channels.
    let mut warm = laws.clone();
    let r = &mut warm.readout;
    (r.white_mv, r.mains_mv, r.flicker_mv, r.count_mv) = (0.0, 0.0, 0.0, 1e-6);
    (r.offset_mv, r.offset_per_day_mv, r.offset_per_k_mv) = (0.0, 0.0, 0.0);
    r.converter_per_k_mv = 10.0;
    Readout::new(&warm, 1, 28).frame(&still, 20_000.0, &mut frame);
    assert!(frame.iter().all(|v| *v == frame[0] && v.abs() > 1e-5), "{:?}", &frame[..3]);
    // The mains is seen within one frame, and is not in a readout without it.
    let mut hum = |mains_mv: f64| {
        let mut laws = laws.clone();
        (laws.readout.mains_mv, laws.readout.white_mv, laws.readout.count_mv) =
            (mains_mv, 0.0, 1e-6);
        let mut readout = Readout::new(&laws, 1, 28);
        readout.frame(&still, 0.0, &mut frame);
        let [mut along, mut across] = [0.0; 2];
        for (i, v) in frame.iter().enumerate() {
            let (sin, cos) = (std::f64::consts::TAU * 50.0 * i as f64 / 24_000.0).sin_cos();
            along += f64::from(*v) * sin / 392.0;
            across += f64::from(*v) * cos / 392.0;
        }
        1e3 * f64::hypot(along, across)
    };
    assert!((hum(5.0) - 5.0).abs() < 0.3 && hum(0.0) < 0.3);
}

#[test]
fn other_laws_are_smooth_and_wrong_ones_are_named() {
    let ogden = FoamLaw::Ogden { modulus_mpa: 0.2, exponent: 3.0, volumetric: 1.2 };
    for law in [laws().foam.law, ogden] {
        for n in 1..150 {
            let strain = 0.01 * f64::from(n) - 0.2;
            let (below, above) = (law.pressure(strain - 1e-6), law.pressure(strain + 1e-6));
            let slope = (above.pressure_mpa - below.pressure_mpa) / 2e-6;
            let stated = law.pressure(strain).slope;
            assert!(slope > 0.0 && (slope / stated - 1.0).abs() < 1e-3, "{law:?} at {strain}");
        }
        assert!((law.pressure(law.strain(0.1)).pressure_mpa / 0.1 - 1.0).abs() < 1e-9);
    }
    let mut d = laws();
    d.foam.law = ogden;
    d.conductance.law = ConductanceLaw::Percolation {
        s_per_mm2_at_1_mpa: 1e-7,
        threshold_mpa: 0.01,
        exponent: 1.5,
    };
    assert!(Laminate::new(&plan(), &d, 1).is_ok());
    for (key, spoil) in [
        ("grid.sheet_mm", (|l| l.grid.sheet_mm = 6.0) as fn(&mut Laws)),
        ("foam.unloading", |l| l.foam.unloading = 1.0),
        ("cover.loft_mm", |l| l.cover.loft_mm = 0.0),
        ("readout.white_mv", |l| l.readout.white_mv = f64::NAN),
    ] {
        let mut laws = laws();
        spoil(&mut laws);
        let words = Laminate::new(&plan(), &laws, 1).unwrap_err().to_string();
        assert!(words.starts_with(key), "{words}");
    }
}

#[test]
fn the_network_agrees_with_ngspice() {
    if Command::new("ngspice").arg("-v").output().is_err() {
        let required = std::env::var_os("PALPATE_REQUIRE_TOOLS").is_some();
        assert!(!required, "ngspice is missing, and PALPATE_REQUIRE_TOOLS is set");
        println!("LEFT OUT: ngspice is not installed");
        return;
    }
    let mut laws = laws();
    laws.grid.sheet_mm = 20.0;
    let plan = plan();
    let sheet = Sheet::new(&plan, &laws, 2).unwrap();
    let leaks: Vec<f64> =
        (0..sheet.grid().cells()).map(|n| if n % 97 == 5 { 2e-7 } else { 4e-12 }).collect();
    let (frame, n) = (sheet.frame_v(&leaks).unwrap(), plan.electrodes_mm.len());
    for sink in [0, 17, 35] {
        let mut text = String::from("* finite volumes\n.options gmin=1e-30\nVsource top 0 DC 12\n");
        let squares = sheet.grid().cells();
        let name = |node: usize| match node.checked_sub(squares) {
            Some(electrode) if electrode == sink => "pad".to_owned(),
            Some(electrode) => format!("e{electrode}"),
            None => format!("n{node}"),
        };
        writeln!(text, "Rlead pad 0 {:e}", sheet.leads_ohm()[sink]).unwrap();
        for (i, r) in sheet.resistors().iter().enumerate() {
            let [a, b] = r.between.map(name);
            writeln!(text, "Rs{i} {a} {b} {:e}", 1.0 / r.conductance_s).unwrap();
        }
        for (i, leak) in leaks.iter().enumerate() {
            writeln!(text, "Rf{i} n{i} top {:e}", 1.0 / leak).unwrap();
        }
        text += ".control\nset numdgt=15\nrun\n";
        let others = || (0..n).filter(|j| *j != sink);
        others().for_each(|j| writeln!(text, "print v(e{j})").unwrap());
        text += "quit\n.endc\n.op\n.end\n";
        let file = std::env::temp_dir().join(format!("laminate-{}-{sink}.cir", std::process::id()));
        std::fs::write(&file, text).unwrap();
        let run = Command::new("ngspice").arg("-b").arg(&file).output().unwrap();
        std::fs::remove_file(&file).unwrap();
        let answer = String::from_utf8_lossy(&run.stdout).into_owned();
        let mut volts = vec![0.0; n];
        for j in others() {
            let (_, value) = answer.split_once(&format!("v(e{j}) = ")).expect("a voltage");
            volts[j] = value.lines().next().unwrap().trim().parse().unwrap();
        }
        let spice: Vec<f64> = (0..n).map(|j| volts[j] - volts[(j + 1) % n]).collect();
        let worst = apart(&frame[n * sink..][..n], &spice);
        assert!(worst < 1e-7, "injection {sink}: {worst}");
    }
}
