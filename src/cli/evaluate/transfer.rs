//! Table III: Transfer-Nets by the numbers of contacts in their training.
//! Uses: `lab`, `evaluate::{published, table, charts}`. Never: training here.

use clap::Args;
use serde_json::json;

use super::lab::{Lab, LabArgs, R2S, Sheet, to, with_lab};
use crate::cli::error::CliError;
use crate::evaluate::charts::{Line, lines};
use crate::evaluate::published::TABLE_III;
use crate::evaluate::request::Scored;
use crate::evaluate::table::markdown;
use crate::evaluate::voltages::VoltageScores;

const HEAD: [&str; 8] = ["trained on", "train", "I", "II", "III", "IV", "V", "VI"];

/// Options of `evaluate transfer`.
#[derive(Debug, Clone, Args)]
pub struct TransferArgs {
    /// The dataset; r2s-transfer-by-trial is split by trial, as in the paper.
    #[arg(long, value_name = "NAME", default_value = R2S)]
    dataset: String,
    #[command(flatten)]
    lab: LabArgs,
}

/// Trains and scores the nets of all rows of the table.
///
/// # Errors
/// `CliError` if a training or an evaluation fails.
pub async fn transfer(args: TransferArgs) -> Result<(), CliError> {
    with_lab(args.lab, move |lab| score(lab, args.dataset)).await
}

async fn score(lab: Lab, dataset: String) -> Result<Sheet, CliError> {
    let split_by = lab.split_by(&dataset).await?;
    let mut rows = Vec::new();
    let (mut numbers, mut curves) = (Vec::new(), Vec::new());
    let plain = lab.scored(&lab.wish(Scored::Voltages, &dataset, Some("test"))).await?;
    if let Some(scores) = &plain.voltages {
        rows.push(row("no net", None, scores));
    }
    for published in &TABLE_III {
        let most = published.trained_to;
        let conditions = vec![to(most)];
        let model = lab.transfer(&format!("transfer-to-{most}"), &dataset, &conditions).await?;
        let mut wish = lab.wish(Scored::Voltages, &dataset, Some("test"));
        wish.transfer = Some(model.id.clone());
        let test = lab.scored(&wish).await?;
        wish.part = Some("train".into());
        wish.conditions = conditions;
        let train = lab.scored(&wish).await?;
        if let (Some(test), Some(train)) = (&test.voltages, &train.voltages) {
            rows.push(row(&format!("1 to {most}"), Some(train), test));
            let places = test
                .by_contacts
                .iter()
                .filter_map(|score| Some((f64::from(score.contacts?), 100.0 * score.fvu)));
            curves.push(Line { name: format!("trained to {most}"), places: places.collect() });
        }
        let cell = |cell: &crate::evaluate::published::Transfer| {
            format!("{} / {}", cell.rmse_v, cell.fvu_percent)
        };
        let mut paper = vec![format!("  paper, 1 to {most}"), cell(&published.train)];
        paper.extend(published.test.iter().map(cell));
        rows.push(paper);
        numbers.push(json!({ "trained_to": most, "model": model.id, "test": test.voltages,
            "train": train.voltages }));
    }
    let text = format!(
        "# Table III: mean RMSE (V) / mean FVU (%) by the number of contacts\n\n{}\n{}\n",
        markdown(&HEAD, &rows),
        lab.scale_words(&format!("{}, {dataset}, split by {split_by}", plain.label))
    );
    // The paper's split and ours give two tables.
    let name = if dataset == R2S { "table-iii".into() } else { format!("table-iii-{dataset}") };
    let picture = lines("Table III", "contacts of the test trials", "mean FVU (%)", &curves)?;
    Ok(Sheet {
        name: name.clone(),
        text,
        numbers: json!({ "table": "III", "scale": lab.args.scale.name(), "label": plain.label,
            "dataset": plain.dataset, "no_net": plain.voltages, "rungs": numbers }),
        pictures: vec![(format!("{name}.svg"), picture)],
    })
}

fn row(name: &str, train: Option<&VoltageScores>, test: &VoltageScores) -> Vec<String> {
    let cell = |rmse_v: f64, fvu: f64| format!("{rmse_v:.4} / {:.1}", 100.0 * fvu);
    let train = train.map_or("-".into(), |s| cell(s.all.rmse_v, s.all.fvu));
    let of_count = |count: u32| {
        let found = test.by_contacts.iter().find(|score| score.contacts == Some(count));
        found.map_or("-".into(), |score| cell(score.rmse_v, score.fvu))
    };
    [name.to_owned(), train].into_iter().chain((1..=6).map(of_count)).collect()
}
