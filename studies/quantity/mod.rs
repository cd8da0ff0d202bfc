//! A quantity of whole frames on any skin: nets compared with ridge and kernel ridge regression, on the same rows of a
//! dataset, or of each of several, such as one for each batch that is excluded from training.
//! Uses: `lab`, `budget`, `joined`, `evaluate::table`. Never: a net without the two regressions.

use serde_json::{Value, json};

use crate::budget::{Budget, REGRESSIONS};
use crate::evaluate::quantities::QuantityScores;
use crate::evaluate::request::{EvaluationReport, Scored};
use crate::evaluate::score::Mean;
use crate::evaluate::table::markdown;
use crate::ids::{DatasetId, ModelId};
use crate::lab::{Lab, StudyError, Training};
use crate::learn::targets::Quantity;
use crate::sheet::Sheet;

mod joined;

use joined::joined;

/// Nets that are compared, and the rows and the quantity on which they are.
#[derive(Debug, Clone, PartialEq)]
pub struct Compared {
    /// Quantity that is answered.
    pub quantity: Quantity,
    /// Names or ids of datasets with a split; each counts once in the mean of several.
    pub datasets: Vec<String>,
    /// Conditions on their rows, each `COLUMN__lte=VALUE`.
    pub conditions: Vec<String>,
    /// Recipes of nets to train: carried ones, or files.
    pub recipes: Vec<String>,
    /// Ids or names of trained nets.
    pub nets: Vec<String>,
}

/// A scored net.
struct Entry {
    name: String,
    is_baseline: bool,
    scores: QuantityScores,
    models: Vec<ModelId>,
}

/// The nets of a comparison on one dataset.
struct OnDataset {
    dataset: String,
    split_by: String,
    label: &'static str,
    /// Names of all compared nets, the same on every dataset.
    nets: Vec<String>,
    /// Those with scores, in this order; empty if no row of the test part has the quantity.
    entries: Vec<Entry>,
    reports: Vec<EvaluationReport>,
}

/// Trains both regressions and the nets of the recipes on each dataset, and scores them and the named nets on the rows
/// of its test part. The result of several datasets has the mean over them.
///
/// # Errors
/// Error of the lab if a training or an evaluation fails; `StudyError::SameDataset` if two words name one dataset;
/// `StudyError::OtherQuantity` if a named net answers another quantity.
pub async fn quantity<L: Lab>(
    lab: &L,
    budget: &Budget,
    compared: &Compared,
) -> Result<Sheet, L::Error> {
    each_is_another(lab, budget, &compared.datasets).await?;
    let mut all = Vec::new();
    for dataset in &compared.datasets {
        all.push(on_dataset(lab, budget, compared, budget.dataset(dataset)).await?);
    }
    Ok(match &all[..] {
        [one] => one.sheet(compared.quantity),
        several => joined(several, compared.quantity),
    })
}

/// Checks that no two words name one dataset, such as its name and its id: it would count twice in the mean.
async fn each_is_another<L: Lab>(
    lab: &L,
    budget: &Budget,
    datasets: &[String],
) -> Result<(), L::Error> {
    let mut known: Vec<(DatasetId, &String)> = Vec::new();
    for word in datasets {
        let id = lab.dataset_id(&budget.dataset(word)).await?;
        if let Some((id, first)) = known.iter().find(|(other, _)| *other == id) {
            let (first, again, id) = ((*first).clone(), word.clone(), id.clone());
            return Err(StudyError::SameDataset { first, again, id }.into());
        }
        known.push((id, word));
    }
    Ok(())
}

/// Trains and scores on one dataset, whose name has the split of the budget.
async fn on_dataset<L: Lab>(
    lab: &L,
    budget: &Budget,
    compared: &Compared,
    dataset: String,
) -> Result<OnDataset, L::Error> {
    let split_by = lab.split_by(&dataset).await?;
    let (mut entries, mut reports) = (Vec::new(), Vec::new());
    let baselines = REGRESSIONS.map(|(recipe, name)| (recipe.to_owned(), name.to_owned(), true));
    let recipes = compared.recipes.iter().map(|recipe| (recipe.clone(), recipe.clone(), false));
    let mut scored: Vec<(String, bool, String)> = Vec::new();
    for (recipe, name, is_baseline) in baselines.into_iter().chain(recipes) {
        let model = lab.train(&training(budget, compared, &dataset, &recipe)).await?;
        scored.push((name, is_baseline, model.to_string()));
    }
    scored.extend(compared.nets.iter().map(|net| (net.clone(), false, net.clone())));
    let nets: Vec<String> = scored.iter().map(|(name, ..)| name.clone()).collect();
    for (name, is_baseline, net) in scored {
        let mut request = budget.request(Scored::Quantity, &dataset, Some("test"));
        request.conditions.clone_from(&compared.conditions);
        request.net = Some(net);
        // The table states no scale, so none limits its rows.
        request.limit = budget.scored;
        let report = lab.score(&request).await?;
        if let Some(scores) = report.quantity.clone() {
            let wanted = compared.quantity.name();
            if scores.quantity != wanted {
                let (net, answers) = (name, scores.quantity);
                return Err(StudyError::OtherQuantity { net, answers, wanted }.into());
            }
            entries.push(Entry { name, is_baseline, scores, models: report.models.clone() });
        }
        reports.push(report);
    }
    let label = reports.first().map_or("", |report| report.label.as_str());
    Ok(OnDataset { dataset, split_by, label, nets, entries, reports })
}

impl OnDataset {
    /// The result of this dataset alone.
    fn sheet(&self, quantity: Quantity) -> Sheet {
        let Self { dataset, split_by, label, entries, reports, .. } = self;
        let name = quantity.name();
        let verdicts = verdicts(entries, |_, _| String::new());
        let notes = notes(reports).into_iter().map(|note| format!("Note: {note}.\n"));
        let text = format!(
            "# {}{} on the test part of {dataset} ({label}, split by {split_by})\n\n{}\n{verdicts}{}{}",
            name[..1].to_uppercase(),
            &name[1..],
            markdown(&head(quantity), &rows(entries)),
            remarks(entries),
            notes.collect::<String>(),
        );
        let numbers = json!({ "quantity": name, "dataset": dataset, "split_by": split_by,
            "label": label, "nets": entries.iter().map(Entry::numbers).collect::<Vec<Value>>(),
            "verdicts": verdicts.lines().collect::<Vec<_>>() });
        Sheet::new(&format!("quantity-{name}"), text, numbers, Vec::new())
    }
}

fn training(budget: &Budget, compared: &Compared, dataset: &str, recipe: &str) -> Training {
    // A recipe file's name, without its folder and ending.
    let stem = recipe.rsplit('/').next().unwrap_or(recipe).trim_end_matches(".toml");
    Training {
        recipe: recipe.into(),
        stem: format!("{stem}-{}", compared.quantity.name()),
        dataset: Some(dataset.into()),
        conditions: compared.conditions.clone(),
        answers: Some(compared.quantity),
        epochs: budget.epochs,
        rows: budget.rows,
        seed: budget.seed,
        ..Training::default()
    }
}

fn head(quantity: Quantity) -> [&'static str; 6] {
    let error = match quantity {
        Quantity::Position => "wrong by mm",
        Quantity::Pattern => "wrong places",
        Quantity::Count => "wrong by",
        Quantity::Force => "wrong by N",
    };
    ["net", "rows", error, "median", "right %", "of ridge"]
}

fn rows(entries: &[Entry]) -> Vec<Vec<String>> {
    let Some(first) = entries.first() else { return Vec::new() };
    let ridge = first.scores.cost();
    let mut rows: Vec<Vec<String>> = entries.iter().map(|entry| entry.row(ridge)).collect();
    rows.push(constant_row(&first.scores));
    rows
}

/// The row of the best constant on the rows of these scores.
fn constant_row(scores: &QuantityScores) -> Vec<String> {
    let constant = format!("{:.2}", scores.constant_error);
    let absent = || "-".to_owned();
    vec!["best constant".into(), scores.rows.to_string(), constant, absent(), absent(), absent()]
}

fn with_interval(mean: Mean, scale: f64, digits: usize) -> String {
    let shown = |value: f64| format!("{:.digits$}", scale * value);
    match (mean.low_95.zip(mean.high_95), mean.sd) {
        (Some((low, high)), _) => format!("{} [{}, {}]", shown(mean.mean), shown(low), shown(high)),
        // A mean over datasets.
        (None, Some(sd)) => format!("{} ± {}", shown(mean.mean), shown(sd)),
        (None, None) => shown(mean.mean),
    }
}

impl Entry {
    fn row(&self, ridge: f64) -> Vec<String> {
        let QuantityScores { rows, error, median_error, right, .. } = &self.scores;
        vec![
            self.name.clone(),
            rows.to_string(),
            with_interval(*error, 1.0, 2),
            format!("{median_error:.2}"),
            right.map_or("-".into(), |right| with_interval(right, 100.0, 1)),
            if ridge > 0.0 { format!("{:.2}", self.scores.cost() / ridge) } else { "-".into() },
        ]
    }

    fn numbers(&self) -> Value {
        json!({ "name": self.name, "models": self.models, "scores": self.scores })
    }
}

/// For each net whether it beats each regression, and whether that may be chance: a net that does not is not worth its
/// training. `more`: end of a sentence, by the indices of net and regression.
fn verdicts(entries: &[Entry], more: impl Fn(usize, usize) -> String) -> String {
    let those = |baselines: bool| {
        entries.iter().enumerate().filter(move |(_, entry)| entry.is_baseline == baselines)
    };
    let mut text = String::new();
    for (at, net) in those(false) {
        for (of, baseline) in those(true) {
            let (cost, other) = (net.scores.cost(), baseline.scores.cost());
            let words = if cost < other {
                let less = 100.0 * (1.0 - cost / other);
                let overlap = net.scores.overlaps(&baseline.scores);
                let chance = if overlap { ", but their 95 % intervals overlap" } else { "" };
                format!("beats {}: {less:.0} % less error{chance}", baseline.name)
            } else {
                format!("does NOT beat {}", baseline.name)
            };
            text += &format!("{} {words}{}.\n", net.name, more(at, of));
        }
    }
    text
}

/// What the errors are of.
fn remarks(entries: &[Entry]) -> String {
    let mut text = String::new();
    let left_out = entries.first().map_or(0, |entry| entry.scores.left_out);
    if left_out > 0 {
        text += &format!("{left_out} rows without this quantity have no score.\n");
    }
    if entries.iter().any(|entry| entry.scores.right.is_some()) {
        text += "Error here: the share of rows that are not right.\n";
    }
    text
}

/// Restrictions of the reports, each once.
fn notes(reports: &[EvaluationReport]) -> Vec<&String> {
    let mut notes: Vec<&String> = reports.iter().flat_map(|report| &report.notes).collect();
    notes.sort();
    notes.dedup();
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::small;
    use crate::lab::fake::{FakeLab, result};

    fn compared() -> Compared {
        Compared {
            quantity: Quantity::Position,
            datasets: vec!["pad".into()],
            conditions: vec!["contact_count=1".into()],
            recipes: vec!["my/mlp.toml".into()],
            nets: vec!["mine".into()],
        }
    }

    #[test]
    fn both_regressions_are_trained_on_the_rows_of_the_nets_and_scored_on_the_same() {
        let lab = FakeLab::default();
        result(quantity(&lab, &small(), &compared())).unwrap();
        let trained = lab.trained.lock().unwrap();
        let recipes: Vec<&str> = trained.iter().map(|t| t.recipe.as_str()).collect();
        assert_eq!(recipes, ["ridge", "kernel-ridge", "my/mlp.toml"]);
        assert_eq!(trained[2].stem, "mlp-position");
        let same = |t: &Training| {
            (t.dataset.clone(), t.conditions.clone(), t.answers, t.rows, t.seed)
                == (
                    Some("pad".into()),
                    vec!["contact_count=1".into()],
                    Some(Quantity::Position),
                    None,
                    1,
                )
        };
        assert!(trained.iter().all(same), "{trained:?}");
        let scored = lab.scored.lock().unwrap();
        let nets: Vec<&str> = scored.iter().filter_map(|request| request.net.as_deref()).collect();
        assert_eq!(nets, ["mdl-1", "mdl-2", "mdl-3", "mine"]);
        assert!(
            scored.iter().all(|r| r.part.as_deref() == Some("test") && r.limit == scored[0].limit)
        );
        assert_eq!(scored[0].limit, None, "all rows of the part, whatever the scale");
    }

    #[test]
    fn a_net_of_another_quantity_is_refused() {
        // The nets of the fake lab answer a force.
        let lab = FakeLab { scores: true, ..FakeLab::default() };
        let of =
            |quantity| result(self::quantity(&lab, &small(), &Compared { quantity, ..compared() }));
        let refused = of(Quantity::Position).unwrap_err().to_string();
        assert_eq!(refused, "ridge answers the force: must answer the position");
        let sheet = of(Quantity::Force).unwrap();
        let verdicts = &sheet.numbers["verdicts"];
        assert_eq!(
            (&verdicts[0], &verdicts[3]),
            (
                &"my/mlp.toml does NOT beat ridge.".into(),
                &"mine does NOT beat kernel ridge.".into()
            )
        );
    }

    fn entry(name: &str, is_baseline: bool, error: f64) -> Entry {
        Entry {
            name: name.into(),
            is_baseline,
            scores: QuantityScores {
                quantity: "force".into(),
                rows: 2,
                left_out: 1,
                error: Mean::of_rows(&[error, error], 1).unwrap(),
                median_error: error,
                right: None,
                constant_error: 9.0,
            },
            models: Vec::new(),
        }
    }

    #[test]
    fn a_net_that_does_not_beat_a_regression_says_so() {
        let mut entries =
            [entry("ridge", true, 4.0), entry("kernel ridge", true, 2.0), entry("mlp", false, 3.0)];
        let text = verdicts(&entries, |_, _| String::new());
        assert!(text.contains("mlp beats ridge: 25 % less error."), "{text}");
        assert!(text.contains("mlp does NOT beat kernel ridge."), "{text}");
        assert!(remarks(&entries).contains("1 rows without"), "{}", remarks(&entries));
        assert_eq!(rows(&entries)[2], ["mlp", "2", "3.00 [3.00, 3.00]", "3.00", "-", "0.75"]);
        for Entry { scores, .. } in &mut entries {
            let error = scores.error.mean;
            scores.error = Mean::of_rows(&[error - 2.0, error + 2.0], 1).unwrap();
        }
        let text = verdicts(&entries, |_, _| String::new());
        assert!(text.contains("25 % less error, but their 95 % intervals overlap."), "{text}");
    }

    #[test]
    fn several_datasets_are_one_table_of_their_means() {
        let on = |dataset: &str, errors: [f64; 3]| OnDataset {
            dataset: dataset.into(),
            split_by: "run".into(),
            label: "virtual",
            nets: ["ridge", "kernel ridge", "mlp"].map(str::to_owned).into(),
            entries: vec![
                entry("ridge", true, errors[0]),
                entry("kernel ridge", true, errors[1]),
                entry("mlp", false, errors[2]),
            ],
            reports: Vec::new(),
        };
        let unscored = OnDataset { entries: Vec::new(), ..on("c", [0.0; 3]) };
        let all = [on("a", [4.0, 2.0, 3.0]), on("b", [8.0, 6.5, 6.0]), unscored];
        let sheet = joined(&all, Quantity::Force);
        let text = &sheet.text;
        assert!(
            text.starts_with("# Force on the test parts of 3 datasets (virtual, split by run)")
        );
        for wanted in [
            "mlp beats ridge: 25 % less error (less error on 2 of 2 datasets).",
            "mlp does NOT beat kernel ridge (less error on 1 of 2 datasets).",
            "2 rows without this quantity",
            "c lacks the scores of ridge, kernel ridge, mlp, and is in no mean.",
        ] {
            assert!(text.contains(wanted), "{wanted}: {text}");
        }
        let mut table: Vec<Vec<&str>> = Vec::new();
        for line in text.lines().filter(|line| line.starts_with("| ")) {
            table.push(line.trim_matches('|').split('|').map(str::trim).collect());
        }
        assert_eq!(table.len(), 1 + 1 + 4 * 3, "a head, a rule, three nets and a constant: {text}");
        assert_eq!(table[8], ["mlp", "4", "4.50 ± 2.12", "4.50", "-", "0.75"]);
        assert_eq!(table[10], ["b", "2", "6.00 [6.00, 6.00]", "6.00", "-", "0.75"]);
        assert_eq!(table[13], ["b", "2", "9.00", "-", "-", "-"]);
        let numbers = &sheet.numbers;
        assert_eq!(numbers["datasets"][1]["nets"][2]["scores"]["error"]["mean"], 6.0);
        let error = &numbers["nets"][2]["scores"]["error"];
        assert_eq!(error["mean"], 4.5);
        assert_eq!(error["n"], 2, "datasets");
        assert_eq!(error.get("low_95"), None, "no interval of two datasets");
        // Each has two of the nets: the second of one is not the second of the other.
        let mut all = [on("a", [4.0, 2.0, 3.0]), on("b", [8.0, 6.5, 6.0])];
        all[0].entries.remove(1);
        all[1].entries.remove(2);
        let sheet = joined(&all, Quantity::Force);
        assert_eq!(sheet.numbers["nets"], json!([]), "{}", sheet.text);
        for wanted in ["a lacks the scores of kernel ridge,", "b lacks the scores of mlp,"] {
            assert!(sheet.text.contains(wanted), "{wanted}: {}", sheet.text);
        }
    }

    #[test]
    fn a_dataset_that_is_named_twice_is_refused_before_nets_are_trained() {
        let of = |words: [&str; 2], by_trial| {
            let lab = FakeLab::default();
            let datasets = words.map(str::to_owned).into();
            let budget = Budget { by_trial, ..small() };
            let refused = result(quantity(&lab, &budget, &Compared { datasets, ..compared() }));
            (refused.unwrap_err().to_string(), lab.trained.lock().unwrap().len())
        };
        let words = "ds-pad: must be another dataset than pad; both are ds-pad";
        assert_eq!(of(["pad", "ds-pad"], false), (words.into(), 0));
        let words = "real-by-trial: must be another dataset than real; both are ds-real-by-trial";
        assert_eq!(of(["real", "real-by-trial"], true), (words.into(), 0));
    }

    #[test]
    fn nets_of_several_datasets_are_trained_and_scored_on_each() {
        let lab = FakeLab { scores: true, ..FakeLab::default() };
        let datasets = vec!["without-1".into(), "without-2".into()];
        let compared = Compared { quantity: Quantity::Force, datasets, ..compared() };
        let sheet = result(quantity(&lab, &small(), &compared)).unwrap();
        let trained = lab.trained.lock().unwrap();
        let on: Vec<&str> = trained.iter().filter_map(|t| t.dataset.as_deref()).collect();
        assert_eq!(on, [["without-1"; 3], ["without-2"; 3]].concat());
        let scored = lab.scored.lock().unwrap();
        let on: Vec<&str> = scored.iter().map(|request| request.dataset.as_str()).collect();
        assert_eq!(on, [["without-1"; 4], ["without-2"; 4]].concat());
        assert_eq!(sheet.numbers["nets"][0]["models"].as_array().map(Vec::len), Some(0));
        assert_eq!(sheet.numbers["verdicts"].as_array().map(Vec::len), Some(4));
    }
}
