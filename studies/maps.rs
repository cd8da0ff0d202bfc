//! Table IV and Fig. 9: Recon-Nets of twelve force maps, on simulated voltages.
//! Uses: `lab`, `budget`, `evaluate::{published, table, charts}`. Never: training here.

use serde_json::json;

use crate::budget::{Budget, RECON_NET, S2S};
use crate::dataset::force_map::{ForceMapSpec, TABLE_IV_MAPS};
use crate::evaluate::charts::{Heat, heats};
use crate::evaluate::published::table_iv as published_table_iv;
use crate::evaluate::score::{Mean, Score};
use crate::evaluate::table::{SCORE_COLUMNS, Uncertainty, markdown, published_row, score_row};
use crate::figure::Heading;
use crate::infer::methods::Method;
use crate::lab::{Lab, StudyError, TableNet};
use crate::sheet::{OutputFile, Sheet};

/// The nets of the twelve maps, in the order of the table.
pub fn table_iv_nets(budget: &Budget) -> Vec<TableNet> {
    let scores = vec![budget.request(Method::Paper, S2S, Some("test"))];
    let net = |spec| {
        let training = budget.map_net(RECON_NET, spec, None);
        TableNet { training, scores: scores.clone() }
    };
    TABLE_IV_MAPS.map(net).into()
}

/// Trains and scores the nets of the twelve maps on the test part of `s2s-recon`.
///
/// # Errors
/// Error of the lab if a training or an evaluation fails; `StudyError::Figure` if Fig. 9 cannot be
/// drawn.
///
/// Source: paper, Table IV and Fig. 9.
pub async fn table_iv<L: Lab>(lab: &L, budget: &Budget) -> Result<Sheet, L::Error> {
    let (mut rows, mut numbers, mut scores) = (Vec::new(), Vec::new(), Vec::new());
    let mut scored = 0;
    let mut label = "";
    let nets = TABLE_IV_MAPS.into_iter().zip(table_iv_nets(budget));
    for (number, (spec, TableNet { training, scores: requests })) in (1..).zip(nets) {
        let model = lab.train(&training).await?;
        let report = lab.score(&requests[0].of_net(&model)).await?;
        let name = format!("Map {number}, {spec}");
        if let (Some(found), Some(perfect)) = (&report.contacts, &report.perfect) {
            rows.push(score_row(&name, &found.all, Uncertainty::Spread));
            rows.push(score_row("  perfect map", &perfect.all, Uncertainty::Spread));
            scores.push((spec, found.all.clone()));
        }
        rows.extend(published_table_iv(spec).map(|paper| published_row("  paper", &paper)));
        numbers.push(json!({ "map": spec.to_string(), "model": model, "report": report }));
        scored = report.rows;
        label = report.label.as_str();
    }
    let text = format!(
        "# Table IV: Recon-Net on simulated voltages, mean ± standard deviation\n\n{}\n{}\n",
        markdown(&SCORE_COLUMNS, &rows),
        budget.caption(&format!("simulated; twins of {label} trials"))
    );
    let title = "Fig. 9: errors of a Recon-Net by the pixel and the diameter of its force map";
    let heading = Heading::new(title, scored, "trials for each map", label).with_note(format!(
        "Scale {}; frames: simulated twins of these trials",
        budget.scale.name()
    ));
    let fig_9 = heats(&heading, &heats_of(&scores)).map_err(StudyError::from)?;
    let numbers = json!({ "table": "IV", "scale": budget.scale.name(), "maps": numbers });
    Ok(Sheet::new("table-iv", text, numbers, vec![OutputFile::new("fig-9.svg", fig_9)]))
}

/// Mean errors by pixel and diameter, mm: four heat maps.
fn heats_of(scores: &[(ForceMapSpec, Score)]) -> Vec<Heat> {
    type Pick = fn(&Score) -> Option<Mean>;
    let quantities: [(&str, Pick); 4] = [
        ("number error (%)", |score| score.number_percent),
        ("location error (mm)", |score| score.closest_mm),
        ("force error (%)", |score| score.force_percent),
        ("diameter error (%)", |score| score.diameter_percent),
    ];
    let heat = |(name, pick): (&str, Pick)| Heat {
        name: name.into(),
        cells: scores
            .iter()
            .filter_map(|(spec, score)| {
                Some(([spec.pixel_mm, spec.diameter_mm], pick(score)?.mean))
            })
            .collect(),
    };
    quantities.into_iter().map(heat).collect()
}
