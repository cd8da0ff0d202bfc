//! Several datasets in one table: each net by its mean over them, and on each.
//! PURE. Uses: `evaluate::{score, table}`. Never: a net, an interval of few datasets.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use super::{Entry, OnDataset, constant_row, head, notes, remarks, verdicts};
use crate::evaluate::quantities::QuantityScores;
use crate::evaluate::score::Mean;
use crate::evaluate::table::markdown;
use crate::ids::ModelId;
use crate::learn::targets::Quantity;
use crate::sheet::Sheet;

/// What the rows of a table of several datasets are.
const MEANS: &str = "The row of a net is the mean of the datasets below it ± the standard deviation between them, and \
                     the sum of their rows. Each dataset counts once.\n";

/// The result of several datasets in one table: each net by its mean over them, and on each.
pub(super) fn joined(all: &[OnDataset], quantity: Quantity) -> Sheet {
    let name = quantity.name();
    let nets: &[String] = all.first().map_or(&[], |one| one.nets.as_slice());
    // The entries of these datasets are those of all nets in one order: nets are compared by their place in it. A
    // dataset that lacks one is in no mean.
    let (scored, without): (Vec<&OnDataset>, Vec<&OnDataset>) =
        all.iter().partition(|one| one.entries.iter().map(|entry| &entry.name).eq(nets));
    let mean = |at: usize| {
        let of: Vec<&Entry> = scored.iter().map(|one| &one.entries[at]).collect();
        Entry::mean(&of)
    };
    let means: Vec<Entry> = (0..nets.len()).filter_map(mean).collect();
    let verdicts = verdicts(&means, |net, baseline| less_on(&scored, net, baseline));
    let mut notes_of_each = String::new();
    for one in without {
        let has_no_scores = |net: &&str| one.entries.iter().all(|entry| entry.name != **net);
        let lacking = nets.iter().map(String::as_str).filter(has_no_scores);
        notes_of_each += &format!(
            "{} lacks the scores of {}, and is in no mean.\n",
            one.dataset,
            lacking.collect::<Vec<&str>>().join(", ")
        );
    }
    for one in all {
        for note in notes(&one.reports) {
            notes_of_each += &format!("Note on {}: {note}.\n", one.dataset);
        }
    }
    let text = format!(
        "# {}{} on the test parts of {} datasets ({}, split by {})\n\n{}\n{verdicts}{}{}{notes_of_each}",
        name[..1].to_uppercase(),
        &name[1..],
        all.len(),
        each_once(all.iter().map(|one| one.label)),
        each_once(all.iter().map(|one| one.split_by.as_str())),
        markdown(&head(quantity), &joined_rows(&means, &scored)),
        MEANS,
        remarks(&means),
    );
    let of_each: Vec<Value> = all.iter().map(|one| one.sheet(quantity).numbers).collect();
    let numbers = json!({ "quantity": name, "datasets": of_each,
        "nets": means.iter().map(Entry::numbers).collect::<Vec<Value>>(),
        "verdicts": verdicts.lines().collect::<Vec<_>>() });
    Sheet::new(&format!("quantity-{name}"), text, numbers, Vec::new())
}

/// On how many datasets a net has a smaller error than a regression.
fn less_on(scored: &[&OnDataset], net: usize, baseline: usize) -> String {
    let is_less =
        |one: &&&OnDataset| one.entries[net].scores.cost() < one.entries[baseline].scores.cost();
    let less = scored.iter().filter(is_less).count();
    format!(" (less error on {less} of {} datasets)", scored.len())
}

/// Different words, with "and" in between.
fn each_once<'a>(words: impl Iterator<Item = &'a str>) -> String {
    words.collect::<BTreeSet<&str>>().into_iter().collect::<Vec<&str>>().join(" and ")
}

/// The rows of datasets with scores of every net: of each net its mean, then each dataset.
fn joined_rows(means: &[Entry], scored: &[&OnDataset]) -> Vec<Vec<String>> {
    let Some(first) = means.first() else { return Vec::new() };
    let below = |one: &OnDataset, mut row: Vec<String>| {
        row[0] = format!("  {}", one.dataset);
        row
    };
    let mut rows = Vec::new();
    for (at, mean) in means.iter().enumerate() {
        rows.push(mean.row(first.scores.cost()));
        for one in scored {
            let ridge = &one.entries[0].scores;
            rows.push(below(one, one.entries[at].row(ridge.cost())));
        }
    }
    rows.push(constant_row(&first.scores));
    rows.extend(scored.iter().map(|one| below(one, constant_row(&one.entries[0].scores))));
    rows
}

impl Entry {
    /// A net by the mean of its scores on several datasets, each counted once, with the standard deviation between
    /// them; `None` without scores.
    fn mean(of: &[&Self]) -> Option<Self> {
        let mean = |values: Vec<f64>| -> Option<Mean> {
            // The interval of a bootstrap over few datasets is too narrow.
            Some(Mean { low_95: None, high_95: None, ..Mean::of_rows(&values, 1)? })
        };
        let mut models: Vec<ModelId> = of.iter().flat_map(|entry| entry.models.clone()).collect();
        models.dedup();
        let first = of.first()?;
        let scores = QuantityScores {
            quantity: first.scores.quantity.clone(),
            rows: of.iter().map(|entry| entry.scores.rows).sum(),
            left_out: of.iter().map(|entry| entry.scores.left_out).sum(),
            error: mean(of.iter().map(|entry| entry.scores.error.mean).collect())?,
            median_error: mean(of.iter().map(|entry| entry.scores.median_error).collect())?.mean,
            right: mean(of.iter().filter_map(|entry| Some(entry.scores.right?.mean)).collect()),
            constant_error: mean(of.iter().map(|entry| entry.scores.constant_error).collect())?
                .mean,
        };
        Some(Self { name: first.name.clone(), is_baseline: first.is_baseline, scores, models })
    }
}
