//! Table IV and Fig. 9: Recon-Nets of twelve force maps, on simulated voltages.
//! Uses: `lab`, `evaluate::{published, table, charts}`. Never: training here.

use serde_json::json;

use super::lab::{Lab, Sheet};
use crate::cli::error::CliError;
use crate::dataset::force_map::TABLE_IV;
use crate::evaluate::charts::{Heat, heats};
use crate::evaluate::published::table_iv;
use crate::evaluate::request::Scored;
use crate::evaluate::score::{Mean, Score};
use crate::evaluate::table::{Beside, COLUMNS, markdown, published_row, score_row};

/// Trains and scores the nets of the twelve maps.
///
/// # Errors
/// `CliError` if a training or an evaluation fails.
pub async fn maps(lab: Lab) -> Result<Sheet, CliError> {
    let (mut rows, mut numbers, mut scores) = (Vec::new(), Vec::new(), Vec::new());
    let mut label = String::new();
    for (number, spec) in (1..).zip(TABLE_IV) {
        let model = lab.maps("recon-net", &spec.to_string(), None).await?;
        let mut wish = lab.wish(Scored::Paper, "s2s-recon", Some("test"));
        wish.map = Some(model.id.clone());
        let report = lab.scored(&wish).await?;
        let name = format!("Map {number}, {spec}");
        if let (Some(found), Some(perfect)) = (&report.contacts, &report.perfect) {
            rows.push(score_row(&name, &found.all, Beside::Spread));
            rows.push(score_row("  perfect map", &perfect.all, Beside::Spread));
            scores.push((spec, found.all.clone()));
        }
        rows.extend(table_iv(spec).map(|published| published_row("  paper", &published)));
        numbers.push(json!({ "map": spec.to_string(), "model": model.id, "report": report }));
        label = report.label;
    }
    let text = format!(
        "# Table IV: Recon-Net on simulated voltages, mean ± standard deviation\n\n{}\n{}\n",
        markdown(&COLUMNS, &rows),
        lab.scale_words(&format!("simulated; twins of {label} trials"))
    );
    Ok(Sheet {
        name: "table-iv".into(),
        text,
        numbers: json!({ "table": "IV", "scale": lab.args.scale.name(), "maps": numbers }),
        pictures: vec![("fig-9.svg".into(), heats("Fig. 9", &figure(&scores))?)],
    })
}

/// Means by pixel and diameter.
fn figure(scores: &[(crate::dataset::force_map::ForceMapSpec, Score)]) -> Vec<Heat> {
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
