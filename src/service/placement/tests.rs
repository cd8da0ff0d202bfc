//! The verdict on placements, case by case.

use sim_core::sensor::Sensor;

use super::verdict::{AskedContact, Verdict, direction, judge};
use crate::campaign::shown::placement::VerdictKind;
use crate::infer::answer::{FoundContact, Reading};
use crate::record::PlacedContact;

const SENSOR: &str = include_str!("../../../experiments/sensors/ert-28.toml");

fn sensor() -> Sensor {
    Sensor::from_toml(SENSOR).unwrap()
}

/// A position by the row and column of its point, from 1.
fn at(row: u32, column: u32) -> [f64; 2] {
    let sensor = sensor();
    let found = sensor.points().iter().find(|p| p.row + 1 == row && p.column + 1 == column);
    let p = found.unwrap();
    [p.x_mm, p.y_mm]
}

fn asked(weights: &[([f64; 2], f64)]) -> Vec<AskedContact> {
    let placed: Vec<PlacedContact> = weights
        .iter()
        .map(|&([x_mm, y_mm], force_n)| PlacedContact { x_mm, y_mm, force_n })
        .collect();
    AskedContact::all(&placed, Some(&sensor()))
}

fn felt(contacts: &[([f64; 2], f64)]) -> Reading {
    let found = |&([x_mm, y_mm], force_n): &([f64; 2], f64)| FoundContact {
        x_mm,
        y_mm,
        force_n: Some(force_n),
        x_sd_mm: Some(3.0),
        y_sd_mm: Some(3.0),
        force_sd_n: Some(0.3),
        ..FoundContact::default()
    };
    Reading { contacts: contacts.iter().map(found).collect(), ..Reading::default() }
}

fn shifted([x, y]: [f64; 2], dx: f64, dy: f64) -> [f64; 2] {
    [x + dx, y + dy]
}

fn verdict(asked: &[AskedContact], reading: &Reading) -> Verdict {
    judge(asked, reading, true, Some(&sensor()))
}

/// Three weights far from each other.
fn three() -> Vec<([f64; 2], f64)> {
    vec![(at(7, 12), 7.358), (at(20, 6), 4.905), (at(28, 20), 9.81)]
}

#[test]
fn weights_within_the_accuracy_of_the_method_are_right_in_any_order() {
    let mut found = three();
    found.reverse();
    for (at_mm, force_n) in &mut found {
        *at_mm = shifted(*at_mm, 12.0, -14.0);
        *force_n *= 1.2;
    }
    let verdict = verdict(&asked(&three()), &felt(&found));
    assert_eq!(verdict.kind, VerdictKind::Right, "{verdict:?}");
    assert_eq!(verdict.words, ["all 3 weights are felt where they were asked"]);
    let order: Vec<_> = verdict.matches.iter().map(|m| (m.asked, m.felt)).collect();
    assert_eq!(order, [(1, Some(2)), (2, Some(1)), (3, Some(0))]);
}

#[test]
fn a_weight_on_another_point_is_named_with_where_it_is_felt() {
    let mut found = three();
    found[0].0 = shifted(found[0].0, -58.0, 0.0);
    let verdict = verdict(&asked(&three()), &felt(&found));
    assert_eq!(verdict.kind, VerdictKind::Wrong);
    assert_eq!(
        verdict.words,
        ["weight 1 (7.4 N) was asked at R7 C12 and is felt 58 mm to the left, near R7 C9"]
    );
    assert!((verdict.matches[0].distance_mm.unwrap() - 58.0).abs() < 1e-9);
}

#[test]
fn another_weight_on_the_point_is_named() {
    let mut found = three();
    found[1].1 = 9.7;
    let verdict = verdict(&asked(&three()), &felt(&found));
    assert_eq!(verdict.kind, VerdictKind::Wrong);
    assert_eq!(verdict.words, ["weight 2 (4.9 N) was asked at R20 C6 and 9.7 N are felt there"]);
}

#[test]
fn a_missing_weight_and_an_object_that_was_not_asked_are_named() {
    let mut found = three();
    found.truncate(2);
    let missing = verdict(&asked(&three()), &felt(&found));
    assert_eq!(missing.kind, VerdictKind::Wrong);
    assert_eq!(missing.words, ["weight 3 (9.8 N) was asked at R28 C20 and is not felt"]);
    let mut found = three();
    found.push((at(3, 3), 6.0));
    let added = verdict(&asked(&three()), &felt(&found));
    assert_eq!(added.kind, VerdictKind::Wrong);
    assert_eq!(added.words, ["a contact of 6.0 N is felt near R3 C3, where no weight was asked"]);
    found[3].1 = 1.0;
    assert_eq!(verdict(&asked(&three()), &felt(&found)).kind, VerdictKind::Right);
    let none = verdict(&asked(&three()), &felt(&[]));
    assert_eq!((none.kind, none.words.len()), (VerdictKind::Wrong, 3));
}

#[test]
fn two_close_weights_felt_as_one_are_no_contradiction() {
    let weights = [(at(10, 10), 4.905), (at(10, 12), 9.81), (at(28, 20), 9.81)];
    let found = [(shifted(at(10, 11), 4.0, 0.0), 14.0), (at(28, 20), 9.5)];
    let one = verdict(&asked(&weights), &felt(&found));
    assert_eq!(one.kind, VerdictKind::Unsure);
    assert_eq!(one.words, ["weights 1 and 2 are close and are felt as one contact"]);
    // With the force of one only, the other is missing.
    let found = [(at(10, 12), 9.5), (at(28, 20), 9.5)];
    assert_eq!(verdict(&asked(&weights), &felt(&found)).kind, VerdictKind::Wrong);
}

#[test]
fn a_weight_felt_as_two_close_contacts_is_right_if_together_they_have_its_place_and_force() {
    let weights = [(at(20, 6), 4.905), (at(6, 25), 9.81)];
    let parts = |one_n: f64, dx_mm: f64, other_n: f64| {
        let other = shifted(at(6, 25), dx_mm, 0.0);
        let found = [(at(20, 6), 4.9), (at(6, 25), one_n), (other, other_n)];
        verdict(&asked(&weights), &felt(&found))
    };
    let both = parts(5.0, 28.0, 6.8);
    assert_eq!((both.kind, both.words.len()), (VerdictKind::Right, 1), "{:?}", both.words);
    // A hand next to the weight, and two contacts that are not close.
    assert_eq!(parts(9.5, 28.0, 6.8).kind, VerdictKind::Wrong);
    assert_eq!(parts(5.0, 60.0, 5.0).kind, VerdictKind::Wrong);
}

#[test]
fn what_is_not_certain_is_not_called_wrong() {
    let mut found = three();
    found[0].0 = shifted(found[0].0, 0.0, 40.0);
    let moved = felt(&found);
    let kind = |at_rest| judge(&asked(&three()), &moved, at_rest, None).kind;
    assert_eq!(kind(true), VerdictKind::Wrong);
    assert_eq!(kind(false), VerdictKind::Unsure);
    let mut vague = moved.clone();
    vague.contacts[0].x_sd_mm = Some(20.0);
    assert_eq!(verdict(&asked(&three()), &vague).kind, VerdictKind::Unsure);
    let mut unexplained = moved;
    unexplained.outside.push("misfit = 9.0: limit 3".into());
    assert_eq!(verdict(&asked(&three()), &unexplained).kind, VerdictKind::Unsure);
}

#[test]
fn directions_are_those_of_a_person_who_looks_at_the_skin() {
    for (x, y, way) in [
        (9.0, 1.0, "to the right"),
        (-5.0, -5.0, "down and to the left"),
        (0.0, 8.0, "up"),
        (-8.0, -0.1, "to the left"),
    ] {
        assert_eq!(direction(x, y), way);
    }
}
