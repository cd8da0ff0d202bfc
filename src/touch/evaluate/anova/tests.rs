//! The analysis of variance compared with textbook sums; identities; rejected input.
//! Uses: `anova`. Never: an external tool (`tests/it/evaluate` has that).

use proptest::prelude::*;

use super::{Anova, AnovaError, Factor, Factorial};

fn design(levels: &[usize]) -> Factorial {
    let factor = |(number, count): (usize, &usize)| Factor {
        name: format!("f{number}"),
        levels: (0..*count).map(|level| format!("l{level}")).collect(),
    };
    Factorial::new(levels.iter().enumerate().map(factor).collect()).unwrap()
}

fn analysed(levels: &[usize], samples: &[(&[usize], f64)]) -> Anova {
    let mut factorial = design(levels);
    for (at, value) in samples {
        factorial.add(at, *value).unwrap();
    }
    factorial.analyse().unwrap()
}

#[test]
fn one_factor_is_the_text_books_analysis() {
    // Means 2, 3, 7 of three samples each around 4: SS 3 x (4 + 1 + 9) = 42, within 2 + 2 + 2.
    let samples: Vec<(&[usize], f64)> = [[1.0, 2.0, 3.0], [2.0, 3.0, 4.0], [6.0, 7.0, 8.0]]
        .into_iter()
        .zip([&[0_usize][..], &[1], &[2]])
        .flat_map(|(values, at)| values.map(|value| (at, value)))
        .collect();
    let anova = analysed(&[3], &samples);
    let effect = &anova.effects[0];
    assert!((effect.sum_of_squares - 42.0).abs() < 1e-12);
    assert_eq!((effect.df, anova.error_df, anova.samples), (2, 6, 9));
    assert!((anova.error_sum_of_squares - 6.0).abs() < 1e-12);
    assert!((effect.f.unwrap() - 21.0).abs() < 1e-12);
    // With two degrees of freedom above, the chance is (1 + 2 F / df)^(-df / 2) = 8^-3.
    assert!((effect.p.unwrap() - 8.0_f64.powi(-3)).abs() < 1e-12);
    let middle = &anova.means[1];
    assert_eq!((middle.levels.as_slice(), middle.n, middle.mean), ([Some(1)].as_slice(), 3, 3.0));
    assert!((middle.standard_error - (1.0_f64 / 3.0).sqrt()).abs() < 1e-12);
    assert!((middle.sd.unwrap() - 1.0).abs() < 1e-12);
}

#[test]
fn an_interaction_is_told_from_the_main_effects_in_unequal_cells() {
    // Cell means 0, 2 | 4, 6 add up: no interaction, whatever the sizes; then the last is 10.
    let cells: [(&[usize], &[f64]); 4] = [
        (&[0, 0], &[-1.0, 1.0]),
        (&[0, 1], &[2.0, 2.0, 2.0, 2.0, 2.0]),
        (&[1, 0], &[4.0]),
        (&[1, 1], &[3.0, 9.0]),
    ];
    let flat = |shift: f64| -> Vec<(&[usize], f64)> {
        let of_cell = |(at, values): &(&'static [usize], &'static [f64])| {
            let shift = if *at == [1, 1] { shift } else { 0.0 };
            values.iter().map(|value| (*at, value + shift)).collect::<Vec<_>>()
        };
        cells.iter().flat_map(of_cell).collect()
    };
    let additive = analysed(&[2, 2], &flat(0.0));
    assert_eq!(additive.effects[2].factors, [0, 1]);
    assert!(additive.effects[2].sum_of_squares < 1e-12);
    assert!((additive.effects[2].p.unwrap() - 1.0).abs() < 1e-6);
    // One contrast of weights 1, -1, -1, 1: SS = 4^2 / (1/2 + 1/5 + 1 + 1/2).
    let crossed = analysed(&[2, 2], &flat(4.0));
    assert!((crossed.effects[2].sum_of_squares - 16.0 / 2.2).abs() < 1e-12);
    // Unweighted: the mean of column 0 is (0 + 4) / 2 although it has two samples against one.
    let column = crossed.means.iter().find(|m| m.levels == [None, Some(0)]).unwrap();
    assert_eq!((column.mean, column.n), (2.0, 3));
    let error = (crossed.error_sum_of_squares / crossed.error_df as f64 * 0.25 * 1.5).sqrt();
    assert!((column.standard_error - error).abs() < 1e-12);
}

#[test]
fn what_cannot_be_analysed_is_refused_and_named() {
    assert_eq!(Factorial::new(Vec::new()), Err(AnovaError::NoFactors));
    let single = Factor { name: "noise".into(), levels: vec!["0".into()] };
    assert!(Factorial::new(vec![single]).unwrap_err().to_string().contains("noise: 1 levels"));
    let wide = Factor { name: "a".into(), levels: vec![String::new(); 20] };
    assert_eq!(Factorial::new(vec![wide.clone(), wide]), Err(AnovaError::Cells));

    let mut factorial = design(&[2, 2]);
    for at in [&[0, 2][..], &[0], &[0, 0, 0]] {
        assert_eq!(factorial.add(at, 1.0), Err(AnovaError::Place { at: at.to_vec() }));
    }
    assert!(matches!(factorial.add(&[0, 0], f64::NAN), Err(AnovaError::Sample { .. })));
    for at in [[0, 0], [0, 1], [1, 0]] {
        factorial.add(&at, 1.0).unwrap();
    }
    let empty = factorial.analyse().unwrap_err();
    assert_eq!(empty, AnovaError::EmptyCell { at: vec!["f0 = l1".into(), "f1 = l1".into()] });
    factorial.add(&[1, 1], 1.0).unwrap();
    assert_eq!(factorial.analyse(), Err(AnovaError::TooFew { samples: 4, cells: 4 }));
    factorial.add(&[1, 1], 1.0).unwrap();
    let constant = factorial.analyse().unwrap();
    assert!(constant.effects.iter().all(|effect| effect.f.is_none() && effect.p.is_none()));
}

proptest! {
    /// With equal cells the sums of squares of all effects and the error add up to the total, and
    /// a shift of all samples, however large, changes none of them.
    #[test]
    fn equal_cells_divide_the_total(
        values in prop::collection::vec(-1.0..1.0_f64, 2 * 2 * 3 * 4),
        shift in prop::sample::select(vec![0.0, 1e6]),
    ) {
        let mut factorial = design(&[2, 2, 3]);
        for (i, value) in values.iter().enumerate() {
            factorial.add(&[i % 2, i / 2 % 2, i / 4 % 3], value + shift).unwrap();
        }
        let anova = factorial.analyse().unwrap();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let total: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let parts: f64 = anova.effects.iter().map(|effect| effect.sum_of_squares).sum();
        prop_assert!((parts + anova.error_sum_of_squares - total).abs() < 1e-7);
        let df: u64 = anova.effects.iter().map(|effect| effect.df).sum();
        prop_assert_eq!((anova.effects.len(), df, anova.error_df), (7, 11, 36));
    }
}
