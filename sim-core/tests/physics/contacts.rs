//! Contacts fitted to frames: known ones are found, the stated accuracy is true, and bad frames are
//! rejected.

use std::sync::OnceLock;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::forward::{Contact, Workspace};
use sim_core::inverse::contacts::{
    ContactFitter, ErrorModel, ErrorModelError, Fit, FitError, FitOptions, FitWork, FittedContact,
    FitterError, FramePair, Observation, Origin, Proposal,
};

use super::{model, press};

const CHANNELS: usize = 784;
const NOISE_V: f64 = 1.2e-3;

fn fitter() -> &'static ContactFitter {
    static FITTER: OnceLock<ContactFitter> = OnceLock::new();
    FITTER.get_or_init(|| {
        let error = ErrorModel::white(CHANNELS, NOISE_V).unwrap();
        // The model is exact here: the evidence decides, without odds against a further contact.
        let options = FitOptions { ln_odds: 0.0, ..FitOptions::default() };
        ContactFitter::new(model(), &error, options).unwrap()
    })
}

fn frame(contacts: &[Contact]) -> Vec<f64> {
    model().voltages(contacts, &mut Workspace::default()).unwrap().to_vec()
}

/// A standard normal number (Box-Muller).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, turn): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * turn).cos()
}

/// The mean of some frames with the readout's noise.
fn measured(contacts: &[Contact], frames: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    frame(contacts).iter().map(|v| v + NOISE_V / frames.sqrt() * normal(rng)).collect()
}

/// The mean of some frames, without unknown offsets.
fn observed(frame_v: &[f64], frames: f64) -> Observation<'_> {
    Observation { frame_v, frames, offset_sd_v: 0.0, offset_spectrum: &[] }
}

fn distance_mm(a: &Contact, b: &Contact) -> f64 {
    (a.x_mm - b.x_mm).hypot(a.y_mm - b.y_mm)
}

/// The fitted contact nearest to a true one.
fn nearest<'a>(fit: &'a Fit, truth: &Contact) -> &'a FittedContact {
    fit.contacts
        .iter()
        .min_by(|a, b| distance_mm(&a.contact, truth).total_cmp(&distance_mm(&b.contact, truth)))
        .expect("the fit has contacts")
}

fn three() -> [Contact; 3] {
    [
        Contact { x_mm: 143.7, y_mm: 207.3, force_n: 9.0 },
        Contact { x_mm: 333.1, y_mm: 391.9, force_n: 14.0 },
        Contact { x_mm: 401.9, y_mm: 122.2, force_n: 6.5 },
    ]
}

#[test]
fn known_contacts_come_back_from_a_rough_start_and_from_none() {
    let error = ErrorModel::white(CHANNELS, 1e-6).unwrap();
    let options = FitOptions { tolerance: 1e-6, iterations: 60, ..FitOptions::default() };
    let fitter = ContactFitter::new(model(), &error, options).unwrap();
    let frame_v = frame(&three());
    let observation = observed(&frame_v, 1.0);
    let mut work = FitWork::default();
    let rough = three().map(|c| Contact {
        x_mm: c.x_mm + 9.0,
        y_mm: c.y_mm - 7.0,
        force_n: 1.4 * c.force_n,
    });
    let refined = fitter.refine(&observation, &rough, &mut work).unwrap();
    let found = fitter.fit(&observation, &[], &mut work).unwrap();
    for fit in [refined, found] {
        assert_eq!(fit.contacts.len(), 3);
        for truth in three() {
            let c = nearest(&fit, &truth).contact;
            assert!(distance_mm(&c, &truth) < 1e-3, "{c:?} {truth:?}");
            assert!((c.force_n / truth.force_n - 1.0).abs() < 1e-5, "{c:?} {truth:?}");
        }
    }
}

#[test]
fn standard_deviations_are_those_of_repeated_frames() {
    let load = [three()[0], three()[1]];
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut work = FitWork::default();
    let mut squares = [0.0; 3];
    let draws = 60;
    for _ in 0..draws {
        let frame_v = measured(&load, 30.0, &mut rng);
        let fit = fitter().refine(&observed(&frame_v, 30.0), &load, &mut work).unwrap();
        for truth in &load {
            let c = nearest(&fit, truth);
            squares[0] += ((c.contact.x_mm - truth.x_mm) / c.x_sd_mm).powi(2);
            squares[1] += ((c.contact.y_mm - truth.y_mm) / c.y_sd_mm).powi(2);
            squares[2] += ((c.contact.force_n - truth.force_n) / c.force_sd_n).powi(2);
        }
        let spread = (2.0 * fit.degrees_of_freedom).sqrt();
        assert!((fit.chi2 - fit.degrees_of_freedom).abs() < 5.0 * spread, "{fit:?}");
    }
    // Mean squares of 120 standard normal numbers: 1 +- 0.13.
    for square in squares.map(|s| s / f64::from(2 * draws)) {
        assert!((0.55..1.6).contains(&square), "{squares:?}");
    }
}

#[test]
fn an_untouched_skin_has_no_contacts() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut work = FitWork::default();
    for frames in [1.0, 30.0] {
        for _ in 0..10 {
            let frame_v = measured(&[], frames, &mut rng);
            let fit = fitter().fit(&observed(&frame_v, frames), &[], &mut work);
            assert_eq!(fit.unwrap().contacts, []);
        }
    }
}

#[test]
fn the_number_of_contacts_follows_from_the_evidence() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut work = FitWork::default();
    let near = Contact { x_mm: 270.0, y_mm: 300.0, force_n: 15.0 };
    let pair = [near, Contact { x_mm: 304.0, y_mm: 306.0, force_n: 12.0 }];
    let loads = [vec![press(300, 8.0)], pair.to_vec(), three().to_vec()];
    for load in loads {
        let frame_v = measured(&load, 30.0, &mut rng);
        let observation = observed(&frame_v, 30.0);
        let fit = fitter().fit(&observation, &[], &mut work).unwrap();
        assert_eq!(fit.contacts.len(), load.len(), "{load:?} {fit:?}");
        for truth in &load {
            let c = nearest(&fit, truth);
            let off = distance_mm(&c.contact, truth);
            assert!(off < 4.0 * c.x_sd_mm.hypot(c.y_sd_mm), "{off} mm: {c:?} {truth:?}");
        }
        // The same bytes from the same frame.
        assert_eq!(fit, fitter().fit(&observation, &[], &mut work).unwrap());
    }
}

#[test]
fn frames_that_do_not_decide_have_several_explanations() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let mut work = FitWork::default();
    let (mut ambiguous, mut follows, steps) = (0, 0, 20);
    // From one place to two that are clearly apart: evidence changes sides in between.
    for step in 0..steps {
        let apart_mm = 20.0 + 6.0 * f64::from(step);
        let one = Contact { x_mm: 210.0, y_mm: 290.0, force_n: 8.0 };
        let load = [one, Contact { x_mm: one.x_mm + apart_mm, ..one }];
        let frame_v = measured(&load, 1.0, &mut rng);
        let observation = observed(&frame_v, 1.0);
        let fit = fitter().fit(&observation, &[], &mut work).unwrap();
        let shares: Vec<f64> = fit.alternatives.iter().map(|e| e.probability).collect();
        let answer = fit.probability.unwrap();
        assert!(answer + shares.iter().sum::<f64>() <= 1.0 + 1e-9, "{answer} {shares:?}");
        assert!(shares.len() <= 3 && shares.iter().all(|share| *share >= 0.05), "{shares:?}");
        assert!(shares.is_sorted_by(|a, b| a >= b), "{shares:?}");
        for other in &fit.alternatives {
            let here =
                |c: &FittedContact| distance_mm(&nearest(&fit, &c.contact).contact, &c.contact);
            let moved = other.contacts.iter().any(|c| here(c) >= 8.0);
            assert!(other.contacts.len() != fit.contacts.len() || moved, "{fit:?}");
        }
        ambiguous += usize::from(!fit.alternatives.is_empty());
        let tracked = fitter().track(&observation, &fit, &mut work).unwrap();
        if tracked.origin == Origin::Tracked {
            follows += 1;
            assert_eq!(tracked.probability, fit.probability);
            assert_eq!(tracked.alternatives, fit.alternatives);
        }
    }
    assert!(ambiguous > 0 && follows > 0, "{ambiguous} and {follows} of {steps} frames");
    let clear = measured(&[press(300, 20.0)], 30.0, &mut rng);
    let observation = observed(&clear, 30.0);
    let fit = fitter().fit(&observation, &[], &mut work).unwrap();
    assert!(fit.probability > Some(0.5), "{fit:?}");
    assert_eq!(fitter().refine(&observation, &[], &mut work).unwrap().probability, None);
}

#[test]
fn a_moved_load_is_followed_and_a_new_one_is_searched() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut work = FitWork::default();
    let fit_of = |load: &[Contact], before: Option<&Fit>, rng: &mut _, work: &mut _| {
        let frame_v = measured(load, 30.0, rng);
        let observation = observed(&frame_v, 30.0);
        match before {
            None => fitter().fit(&observation, &[], work).unwrap(),
            Some(before) => fitter().track(&observation, before, work).unwrap(),
        }
    };
    let first = fit_of(&three(), None, &mut rng, &mut work);
    let moved = three().map(|c| Contact { x_mm: c.x_mm + 4.0, ..c });
    let tracked = fit_of(&moved, Some(&first), &mut rng, &mut work);
    assert_eq!(tracked.origin, Origin::Tracked);
    for truth in &moved {
        let c = nearest(&tracked, truth);
        assert!(distance_mm(&c.contact, truth) < 4.0 * c.x_sd_mm.hypot(c.y_sd_mm), "{c:?}");
    }
    // Far from the others: 89 mm from one of them, a fifth contact is as probable in some frames.
    let grown = [&moved[..], &[press(520, 9.0)]].concat();
    let searched = fit_of(&grown, Some(&tracked), &mut rng, &mut work);
    assert_eq!((searched.origin, searched.contacts.len()), (Origin::Search, 4));
    let gone = fit_of(&moved[..1], Some(&searched), &mut rng, &mut work);
    assert_eq!((gone.origin, gone.contacts.len()), (Origin::Search, 1));
}

#[test]
fn a_still_load_is_looked_at_again_as_its_frames_add_up() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut work = FitWork::default();
    let load = [&three()[..], &[Contact { x_mm: 250.0, y_mm: 300.0, force_n: 2.5 }]].concat();
    let mut mean_v = vec![0.0; CHANNELS];
    let (mut fits, mut searches): (Vec<Fit>, _) = (Vec::new(), Vec::new());
    for n in 1..=30 {
        let frame_v = measured(&load, 1.0, &mut rng);
        mean_v.iter_mut().zip(&frame_v).for_each(|(m, v)| *m += (v - *m) / f64::from(n));
        let observation = observed(&mean_v, f64::from(n));
        let fit = match fits.last() {
            None => fitter().fit(&observation, &[], &mut work).unwrap(),
            Some(before) => fitter().track(&observation, before, &mut work).unwrap(),
        };
        if fit.origin == Origin::Search {
            searches.push(n);
        }
        fits.push(fit);
    }
    // Contacts too weak for one frame are found, and no search runs at every frame.
    assert_eq!((fits[0].contacts.len(), fits[29].contacts.len()), (3, 4), "{:?}", fits[29]);
    assert!(searches.len() <= 4 && searches.contains(&25), "{searches:?}");
    let observation = observed(&mean_v, 30.0);
    let searched = fitter().fit(&observation, &[], &mut work).unwrap();
    for (tracked, found) in fits[29].contacts.iter().zip(&searched.contacts) {
        assert!(distance_mm(&tracked.contact, &found.contact) < 0.2 * found.x_sd_mm);
    }
}

#[test]
fn bad_frames_and_settings_are_refused_by_name() {
    let mut work = FitWork::default();
    let mut fit =
        |frame_v: &[f64], frames: f64| fitter().fit(&observed(frame_v, frames), &[], &mut work);
    let mut frame_v = frame(&three());
    let short = fit(&frame_v[1..], 1.0);
    assert_eq!(short, Err(FitError::Length { found: CHANNELS - 1, needed: CHANNELS }));
    assert_eq!(fit(&frame_v, 0.5), Err(FitError::Frames { frames: 0.5 }));
    frame_v[77] = f64::NAN;
    assert_eq!(fit(&frame_v, 1.0), Err(FitError::NotFinite { channel: 77 }));
    let off = Contact { x_mm: -1.0, y_mm: 100.0, force_n: 5.0 };
    let sound = frame(&[]);
    let observation = observed(&sound, 1.0);
    let proposals = [Proposal { contact: off, weight: 1.0 }];
    let refused = fitter().fit(&observation, &proposals, &mut work);
    assert!(matches!(refused, Err(FitError::Contact(_))), "{refused:?}");

    let white = ErrorModel::white(CHANNELS, NOISE_V).unwrap();
    let options = FitOptions { force_ln_sd: 0.0, ..FitOptions::default() };
    let refused = ContactFitter::new(model(), &white, options);
    assert!(matches!(refused, Err(FitterError::Option { field: "force_ln_sd", .. })));
    let other = ErrorModel::white(CHANNELS - 1, NOISE_V).unwrap();
    let refused = ContactFitter::new(model(), &other, FitOptions::default());
    assert!(matches!(refused, Err(FitterError::Channels { .. })));
    let none = ErrorModel::white(3, 0.0);
    assert_eq!(none, Err(ErrorModelError::Noise { channel: 0, sd_v: 0.0 }));
}

#[test]
fn offsets_move_light_contacts_and_standard_deviations_state_it() {
    let load = [press(330, 8.0)];
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut work = FitWork::default();
    let (draws, drift_v, none) = (30, 3e-4, Vec::new());
    // Differences of neighbours have little of the waves around the electrodes that turn slowly.
    let of_buffers: Vec<f64> = (0..=14)
        .map(|turns| 1.0 - (std::f64::consts::TAU * f64::from(turns) / 28.0).cos())
        .collect();
    let known = [(0.0, &none), (drift_v, &none), (drift_v, &of_buffers)];
    // Mean squared error of a position, in variances and in mm^2: offsets unknown to the fit, those of which
    // only the size is known, and those that are known to be differences of buffers.
    let (mut squares, mut squares_mm2) = ([0.0; 3], [0.0; 3]);
    for _ in 0..draws {
        let buffers_v: Vec<f64> =
            (0..28).map(|_| drift_v / 2f64.sqrt() * normal(&mut rng)).collect();
        let mut frame_v = measured(&load, 30.0, &mut rng);
        for (i, v) in frame_v.iter_mut().enumerate() {
            *v += buffers_v[i % 28] - buffers_v[(i + 1) % 28];
        }
        for (case, (offset_sd_v, offset_spectrum)) in known.into_iter().enumerate() {
            let observation =
                Observation { frame_v: &frame_v, frames: 30.0, offset_sd_v, offset_spectrum };
            let fit = fitter().refine(&observation, &load, &mut work).unwrap();
            let found = nearest(&fit, &load[0]);
            squares[case] += ((found.contact.x_mm - load[0].x_mm) / found.x_sd_mm).powi(2) / 2.0;
            squares[case] += ((found.contact.y_mm - load[0].y_mm) / found.y_sd_mm).powi(2) / 2.0;
            squares_mm2[case] += distance_mm(&found.contact, &load[0]).powi(2);
            assert!(found.by_model.iter().all(|share| *share < 1e-9), "noise alone: {found:?}");
        }
    }
    let [unknown, size, buffers] = squares.map(|square| square / f64::from(draws));
    let rms_mm = squares_mm2.map(|square| (square / f64::from(draws)).sqrt());
    println!(
        "offsets of {drift_v} V: {unknown:.1} variances if unknown, {size:.2} if their size is known,"
    );
    println!("{buffers:.2} if they are known as differences of buffers; {rms_mm:.1?} mm");
    assert!(unknown > 4.0, "{unknown}");
    assert!((0.2..2.5).contains(&size) && (0.2..2.5).contains(&buffers), "{size} {buffers}");
    assert!(rms_mm[2] < 0.8 * rms_mm[1], "{rms_mm:?}");
    let frame_v = &frame(&load);
    let refuse = |offset_sd_v, offset_spectrum: &[f64]| {
        let observation = Observation { frame_v, frames: 1.0, offset_sd_v, offset_spectrum };
        fitter().fit(&observation, &[], &mut FitWork::default())
    };
    let refused = refuse(-1.0, &[]);
    assert!(matches!(refused, Err(FitError::Offset { .. })));
    let wrong = Err(FitError::Spectrum { found: 2, needed: 15 });
    assert_eq!(refuse(drift_v, &[1.0, 1.0]), wrong);
    assert!(matches!(refuse(drift_v, &[f64::NAN; 15]), Err(FitError::Spectrum { .. })));
}

#[test]
fn the_models_error_is_learnt_from_pairs() {
    // Errors of 5 % along one direction and 2 % spread over all channels.
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let direction: Vec<f64> = (0..CHANNELS).map(|i| (i as f64 * 0.37).sin()).collect();
    let length = direction.iter().map(|d| d * d).sum::<f64>().sqrt();
    let pairs: Vec<[Vec<f64>; 2]> = (0..300)
        .map(|i| {
            let modelled = frame(&[press(200 + i, 20.0)]);
            let signal = modelled.iter().map(|v| v * v).sum::<f64>().sqrt();
            let along = 0.05 * signal * normal(&mut rng) / length;
            let spread = 0.02 * signal / (CHANNELS as f64).sqrt();
            let off = direction.iter().map(|d| along * d);
            let measured = modelled.iter().zip(off).map(|(v, off)| {
                v + off + spread * normal(&mut rng) + NOISE_V / 2.0 * normal(&mut rng)
            });
            [measured.collect(), modelled.clone()]
        })
        .collect();
    let pairs: Vec<FramePair<'_>> = pairs
        .iter()
        .map(|[measured_v, modelled_v]| FramePair {
            measured_v,
            modelled_v,
            frames: 4.0,
            offset_sd_v: 0.0,
        })
        .collect();
    let white = ErrorModel::white(CHANNELS, NOISE_V).unwrap();
    let learnt = white.clone().with_pairs(&pairs, 3).unwrap();
    let expected = 0.05f64.hypot(0.02);
    assert!((learnt.relative() / expected - 1.0).abs() < 0.15, "{}", learnt.relative());
    let few = white.with_pairs(&pairs[..3], 3);
    assert_eq!(few, Err(ErrorModelError::FewPairs { found: 3, given: 3, needed: 4 }));
}
