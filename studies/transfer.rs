//! Table III: Transfer-Nets by the numbers of contacts in their training.
//! Uses: `lab`, `budget`, `evaluate::{published, table, charts}`. Never: training here.

use serde_json::json;

use crate::budget::{Budget, R2S, REGRESSIONS, most, up_to};
use crate::evaluate::charts::{Line, Panel, panels};
use crate::evaluate::published::{Rung, TABLE_III, Transfer};
use crate::evaluate::request::{EvaluationReport, EvaluationRequest, Scored};
use crate::evaluate::table::markdown;
use crate::evaluate::voltages::VoltageScores;
use crate::figure::Heading;
use crate::ids::ModelId;
use crate::lab::{Lab, StudyError, TableNet};
use crate::sheet::{OutputFile, Sheet};

/// Columns: RMSE (V) / FVU (%) on the rows of the training, then on test trials of 1 to 6 contacts.
const HEAD: [&str; 8] = ["trained on", "train", "I", "II", "III", "IV", "V", "VI"];

/// The nets on 1, 1 to 2, .. contacts of a dataset, one for each number of contacts that occurs, in the order of the
/// table; then the regressions on the rows of the last; scored on the parts test and train.
///
/// `contacts`: the numbers of contacts of the dataset's part train ([`Lab::contact_numbers`]).
pub fn table_iii_nets(budget: &Budget, dataset: &str, contacts: &[u32]) -> Vec<TableNet> {
    let of = |recipe: &str, stem: &str, most: u32| {
        let training = budget.transfer_by(recipe, stem, dataset, most);
        let conditions = vec![up_to(most)];
        let test = budget.request(Scored::Voltages, dataset, Some("test"));
        let train = EvaluationRequest { part: Some("train".into()), conditions, ..test.clone() };
        TableNet { training, scores: vec![test, train] }
    };
    let nets = trained_to(contacts).into_iter().map(|to| of(&budget.transfer, "transfer", to));
    let regressions = REGRESSIONS.map(|(ending, _)| {
        let recipe = format!("transfer-{ending}");
        of(&recipe, &recipe, most(contacts))
    });
    nets.chain(regressions).collect()
}

/// The largest numbers of contacts of the nets that are trained, ascending: those that occur, at least 1. A net up to
/// another number would learn the rows of the net before it.
fn trained_to(contacts: &[u32]) -> Vec<u32> {
    let occurs = |to: &u32| contacts.contains(to) || (contacts.is_empty() && *to == 1);
    TABLE_III.iter().map(|rung| rung.trained_to).filter(occurs).collect()
}

/// Trains Transfer-Nets on 1, 1 to 2, .. contacts, up to each number of contacts of the dataset's part train, and
/// compares their voltages with simulated ones for each number of contacts; also the measured voltages without a net.
///
/// # Errors
/// Error of the lab if a training or an evaluation fails; `StudyError::Figure` if the figure cannot
/// be drawn.
///
/// Source: paper, V-A and Table III.
pub async fn table_iii<L: Lab>(lab: &L, budget: &Budget, dataset: &str) -> Result<Sheet, L::Error> {
    let dataset = &budget.dataset(dataset);
    let split_by = lab.split_by(dataset).await?;
    let mut rows = Vec::new();
    let (mut numbers, mut curves) = (Vec::new(), Vec::new());
    let plain = lab.score(&budget.request(Scored::Voltages, dataset, Some("test"))).await?;
    if let Some(scores) = &plain.voltages {
        rows.push(row("no net", None, scores));
    }
    let contacts = lab.contact_numbers(dataset).await?;
    let (trained, most) = (trained_to(&contacts), most(&contacts));
    let mut nets = table_iii_nets(budget, dataset, &contacts);
    let regressions = nets.split_off(trained.len());
    let (mut nets, mut last, mut not_trained) = (nets.into_iter(), None, Vec::new());
    for published in &TABLE_III {
        let to = published.trained_to;
        if trained.contains(&to)
            && let Some(net) = nets.next()
        {
            let (model, [test, train]) = scored(lab, &net).await?;
            if let (Some(test), Some(train)) = (&test, &train) {
                rows.push(row(&format!("1 to {to}"), Some(train), test));
                curves.push(panel(published, test, plain.voltages.as_ref()));
            }
            numbers.push(json!({ "trained_to": to, "model": model, "test": test, "train": train }));
            last = test;
        } else {
            not_trained.push(to);
        }
        rows.push(paper_row(published));
    }
    let (mut verdicts, mut compared) = (String::new(), Vec::new());
    for ((_, name), net) in REGRESSIONS.into_iter().zip(regressions) {
        let (model, [test, train]) = scored(lab, &net).await?;
        if let (Some(test), Some(train)) = (&test, &train) {
            rows.push(row(&format!("{name}, 1 to {most}"), Some(train), test));
            verdicts += &last.as_ref().map_or(String::new(), |net| verdict(net, name, test, most));
        }
        compared.push(json!({ "name": name, "model": model, "test": test, "train": train }));
    }
    let text = format!(
        "# Table III: mean RMSE (V) / mean FVU (%) by the number of contacts\n\n{}\n{}{verdicts}{}\n",
        markdown(&HEAD, &rows),
        note(&not_trained),
        budget.caption(&format!("{}, {dataset}, split by {split_by}", plain.label.as_str()))
    );
    // Each split has its table: by configuration, and by trial as in the paper.
    let name = if dataset == R2S { "table-iii".into() } else { format!("table-iii-{dataset}") };
    let figure =
        panels(&heading(budget, &plain), "contacts of a test trial", "mean FVU (%)", &curves)
            .map_err(StudyError::from)?;
    let numbers = json!({ "table": "III", "scale": budget.scale.name(), "label": plain.label,
        "dataset": plain.dataset, "no_net": plain.voltages, "rungs": numbers,
        "not_trained_to": not_trained, "regressions": compared,
        "verdicts": verdicts.lines().collect::<Vec<_>>() });
    let figures = vec![OutputFile::new(format!("{name}.svg"), figure)];
    Ok(Sheet::new(&name, text, numbers, figures))
}

/// Trains a net, and scores it on the parts test and train.
async fn scored<L: Lab>(
    lab: &L,
    net: &TableNet,
) -> Result<(ModelId, [Option<VoltageScores>; 2]), L::Error> {
    let model = lab.train(&net.training).await?;
    let test = lab.score(&net.scores[0].of_net(&model)).await?.voltages;
    let train = lab.score(&net.scores[1].of_net(&model)).await?.voltages;
    Ok((model, [test, train]))
}

/// States whether the last net, on 1 to `most` contacts, beats a regression on all test trials.
fn verdict(net: &VoltageScores, name: &str, regression: &VoltageScores, most: u32) -> String {
    let [net, other] = [net, regression].map(|scores| 100.0 * scores.all.fvu);
    let words = if net < other { "beats" } else { "does NOT beat" };
    let on = contacts_up_to(most);
    format!("The Transfer-Net of {on} {words} {name}: FVU {net:.1} and {other:.1} %.\n")
}

/// States which nets of the table are not trained, by their largest numbers of contacts; empty without any.
fn note(not_trained: &[u32]) -> String {
    if not_trained.is_empty() {
        return String::new();
    }
    let numbers: Vec<String> = not_trained.iter().map(u32::to_string).collect();
    format!(
        "No trial of the part train has one of these numbers of contacts: {}. The nets up to them are not trained; \
         their rows contain only the paper's values.\n",
        numbers.join(", ")
    )
}

fn contacts_up_to(most: u32) -> String {
    if most == 1 { "1 contact".into() } else { format!("1 to {most} contacts") }
}

fn heading(budget: &Budget, plain: &EvaluationReport) -> Heading {
    let title =
        "Table III: voltages of Transfer-Nets, by the numbers of contacts in their training";
    let rows = plain.voltages.as_ref().map_or(0, |scores| scores.all.trials);
    Heading::new(title, rows, "test trials", plain.label.as_str()).with_note(format!(
        "Shaded: numbers of contacts in the training; lines end at numbers without a test trial. Scale {}, seed {}",
        budget.scale.name(),
        budget.seed
    ))
}

/// FVU by the number of contacts: here, published, and without a net.
fn panel(published: &Rung, test: &VoltageScores, plain: Option<&VoltageScores>) -> Panel {
    let of = |scores: &VoltageScores| -> Vec<(f64, f64)> {
        let known = scores.by_contacts.iter().filter(|score| score.contacts > Some(0));
        known.filter_map(|s| Some((f64::from(s.contacts?), 100.0 * s.fvu))).collect()
    };
    let line = |name: &str, places: Vec<(f64, f64)>| Line { name: name.into(), places };
    let paper =
        published.test.iter().zip(1..).map(|(cell, count)| (f64::from(count), cell.fvu_percent));
    Panel {
        name: format!("trained on {}", contacts_up_to(published.trained_to)),
        known_to: f64::from(published.trained_to),
        lines: vec![
            line("this training", of(test)),
            line("paper (measured)", paper.collect()),
            line("no net", plain.map(of).unwrap_or_default()),
        ],
    }
}

/// The paper's row under [`HEAD`].
fn paper_row(published: &Rung) -> Vec<String> {
    let cell = |cell: &Transfer| format!("{} / {}", cell.rmse_v, cell.fvu_percent);
    let name = format!("  paper, 1 to {}", published.trained_to);
    [name, cell(&published.train)].into_iter().chain(published.test.iter().map(cell)).collect()
}

/// A row under [`HEAD`]; a dash where there are no trials.
fn row(name: &str, train: Option<&VoltageScores>, test: &VoltageScores) -> Vec<String> {
    let cell = |rmse_v: f64, fvu: f64| format!("{rmse_v:.4} / {:.1}", 100.0 * fvu);
    let train = train.map_or("-".into(), |s| cell(s.all.rmse_v, s.all.fvu));
    let of_count = |count: u32| {
        let found = test.by_contacts.iter().find(|score| score.contacts == Some(count));
        found.map_or("-".into(), |score| cell(score.rmse_v, score.fvu))
    };
    [name.to_owned(), train].into_iter().chain((1..=6).map(of_count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::small;
    use crate::lab::Training;
    use crate::lab::fake::{FakeLab, result};

    #[test]
    fn six_nets_and_two_regressions_are_trained_and_scored_on_test_and_training_rows() {
        let lab = FakeLab::default();
        let sheet = result(table_iii(&lab, &small(), R2S)).unwrap();
        let trained = lab.trained.lock().unwrap();
        let conditions: Vec<&str> = trained.iter().map(|t| t.conditions[0].as_str()).collect();
        assert_eq!(conditions.len(), 8);
        assert_eq!(
            (conditions[0], conditions[5]),
            ("contact_count__lte=1", "contact_count__lte=6")
        );
        let recipes: Vec<&str> = trained[5..].iter().map(|t| t.recipe.as_str()).collect();
        assert_eq!(recipes[1..], ["transfer-ridge", "transfer-kernel-ridge"]);
        // The rows of the last net.
        let same = |t: &Training| (t.dataset.clone(), t.conditions.clone(), t.rows, t.seed);
        assert!(trained[6..].iter().all(|t| same(t) == same(&trained[5])), "{trained:?}");
        assert_eq!(sheet.numbers["regressions"].as_array().unwrap().len(), 2);
        let scored = lab.scored.lock().unwrap();
        assert_eq!(scored.len(), 17);
        assert_eq!((&scored[0].transfer, scored[12].transfer.as_deref()), (&None, Some("mdl-6")));
        assert_eq!(scored[12].part.as_deref(), Some("train"));
        let names: Vec<&str> = sheet.files.iter().map(|file| file.name.as_str()).collect();
        assert_eq!(names[1..], ["table-iii.json", "table-iii.svg"]);
    }

    #[test]
    fn a_net_that_does_not_beat_a_regression_says_so() {
        let of = |fvu| VoltageScores::of(&[(1, 0.01, Some(fvu)), (2, 0.01, Some(fvu))]).unwrap();
        let text = verdict(&of(0.1), "ridge", &of(0.2), 1);
        assert!(text.contains("of 1 contact beats ridge: FVU 10.0 and 20.0 %"), "{text}");
        let text = verdict(&of(0.2), "kernel ridge", &of(0.2), 6);
        assert!(text.contains("of 1 to 6 contacts does NOT beat kernel ridge"), "{text}");
        let lab = FakeLab { scores: true, ..FakeLab::default() };
        let sheet = result(table_iii(&lab, &small(), R2S)).unwrap();
        let text = &sheet.text;
        assert!(
            text.contains("| kernel ridge, 1 to 6 |") && text.contains("NOT beat ridge"),
            "{text}"
        );
        let verdicts = sheet.numbers["verdicts"].as_array().unwrap();
        let in_text = |line: &serde_json::Value| text.contains(line.as_str().unwrap());
        assert!(verdicts.len() == 2 && verdicts.iter().all(in_text), "{verdicts:?}");
    }

    #[test]
    fn no_net_is_trained_up_to_a_number_of_contacts_that_no_trial_has() {
        let contacts = Some(vec![1, 2, 4]);
        let lab = FakeLab { scores: true, contacts, ..FakeLab::default() };
        let sheet = result(table_iii(&lab, &small(), R2S)).unwrap();
        let trained = lab.trained.lock().unwrap();
        let stems: Vec<&str> = trained.iter().map(|t| t.stem.as_str()).collect();
        let wanted = [
            "transfer-to-1-small",
            "transfer-to-2-small",
            "transfer-to-4-small",
            "transfer-ridge-to-4-small",
            "transfer-kernel-ridge-to-4-small",
        ];
        assert_eq!(stems, wanted);
        assert!(trained[2..].iter().all(|t| t.conditions == [up_to(4)]), "{trained:?}");
        // Measured voltages, and each net on two parts.
        assert_eq!(lab.scored.lock().unwrap().len(), 1 + 2 * 5);
        let text = &sheet.text;
        for words in [
            "| 1 to 4 ",
            "|   paper, 1 to 3 ",
            "|   paper, 1 to 6 ",
            "| kernel ridge, 1 to 4 |",
            "of these numbers of contacts: 3, 5, 6. The nets up to them are not trained",
            "The Transfer-Net of 1 to 4 contacts does NOT beat ridge",
        ] {
            assert!(text.contains(words), "{words}: {text}");
        }
        assert!(!text.contains("| 1 to 3 ") && !text.contains("ridge, 1 to 6"), "{text}");
        assert_eq!(sheet.numbers["rungs"].as_array().unwrap().len(), 3);
        assert_eq!(sheet.numbers["not_trained_to"], json!([3, 5, 6]));
        // One net at least, and no note if all are trained.
        let lab = FakeLab { contacts: Some(Vec::new()), ..FakeLab::default() };
        result(table_iii(&lab, &small(), R2S)).unwrap();
        assert_eq!(lab.trained.lock().unwrap().len(), 1 + 2);
        let sheet = result(table_iii(&FakeLab::default(), &small(), R2S)).unwrap();
        assert!(!sheet.text.contains("not trained"), "{}", sheet.text);
    }
}
