//! Table IV and Fig. 9: Recon-Nets of twelve force maps, on simulated voltages, and the regressions that they must beat.
//! Uses: `lab`, `budget`, `rows`, `evaluate::{published, table, charts}`. Never: training here.

use serde_json::json;

use crate::budget::{Budget, RECON_NET, REGRESSIONS, S2S};
use crate::dataset::force_map::{ForceMapSpec, TABLE_IV_MAPS};
use crate::evaluate::charts::{Heat, heats};
use crate::evaluate::published::table_iv as published_table_iv;
use crate::evaluate::score::{Mean, Score};
use crate::evaluate::table::{SCORE_COLUMNS, Uncertainty, markdown, published_row, score_row};
use crate::figure::Heading;
use crate::infer::methods::Method;
use crate::lab::{Lab, StudyError, TableNet};
use crate::rows::{beats, distances_note};
use crate::sheet::{OutputFile, Sheet};

/// The nets of the twelve maps, in the order of the table: of each map the Recon-Net, then the regressions on its rows.
pub fn table_iv_nets(budget: &Budget) -> Vec<TableNet> {
    let scores = vec![budget.request(Method::Paper, S2S, Some("test"))];
    let net = |recipe: &str, spec| {
        let training = budget.map_net(recipe, spec, None);
        TableNet { training, scores: scores.clone() }
    };
    let mut nets = Vec::new();
    for spec in budget.table_iv_maps() {
        nets.push(net(RECON_NET, spec));
        nets.extend(REGRESSIONS.map(|(ending, _)| net(&format!("recon-{ending}"), spec)));
    }
    nets
}

/// Trains and scores the nets of the twelve maps, and the regressions, on the test part of `s2s-recon`.
///
/// # Errors
/// Error of the lab if a training or an evaluation fails; `StudyError::Figure` if Fig. 9 cannot be
/// drawn.
///
/// Source: paper, Table IV and Fig. 9.
pub async fn table_iv<L: Lab>(lab: &L, budget: &Budget) -> Result<Sheet, L::Error> {
    let (mut rows, mut numbers, mut scores) = (Vec::new(), Vec::new(), Vec::new());
    let mut scored = 0;
    let (mut label, mut note) = ("", String::new());
    // The maps on which the net does not beat a regression.
    let mut lost = REGRESSIONS.map(|_| Vec::new());
    let (trained, mut nets) = (budget.table_iv_maps(), table_iv_nets(budget).into_iter());
    for (number, spec) in (1..).zip(TABLE_IV_MAPS).filter(|(_, spec)| trained.contains(spec)) {
        let mut reports = Vec::new();
        for TableNet { training, scores } in nets.by_ref().take(1 + REGRESSIONS.len()) {
            let model = lab.train(&training).await?;
            reports.push((lab.score(&scores[0].of_net(&model)).await?, model));
        }
        let regressions = reports.split_off(1);
        let Some((report, model)) = reports.pop() else { continue };
        let name = format!("Map {number}, {spec}");
        if let (Some(found), Some(perfect)) = (&report.contacts, &report.perfect) {
            rows.push(score_row(&name, &found.all, Uncertainty::Spread));
            rows.push(score_row("  perfect map", &perfect.all, Uncertainty::Spread));
            scores.push((spec, found.all.clone()));
        }
        let mut compared = Vec::new();
        for (((_, name), lost), (other, model)) in
            REGRESSIONS.iter().zip(&mut lost).zip(regressions)
        {
            let found = other.contacts.iter();
            rows.extend(
                found.map(|s| score_row(&format!("  {name}"), &s.all, Uncertainty::Spread)),
            );
            if beats(&report, &other) == Some(false) {
                lost.push(spec.to_string());
            }
            compared.push(json!({ "name": name, "model": model, "report": other }));
        }
        rows.extend(published_table_iv(spec).map(|paper| published_row("  paper", &paper)));
        scored = report.rows;
        label = report.label.as_str();
        note = distances_note(&report);
        numbers.push(json!({ "map": spec.to_string(), "model": model, "report": report,
            "regressions": compared }));
    }
    let mut verdicts = String::new();
    for ((_, name), lost) in REGRESSIONS.iter().zip(&lost).filter(|_| !scores.is_empty()) {
        verdicts += &verdict(name, lost, scores.len());
    }
    let text = format!(
        "# Table IV: Recon-Net on simulated voltages, mean ± standard deviation\n\n{}\n{note}{}{}\n",
        markdown(&SCORE_COLUMNS, &rows),
        verdicts,
        budget.caption(&format!("simulated; twins of {label} trials"))
    );
    let title = "Fig. 9: errors of a Recon-Net by the pixel and the diameter of its force map";
    let heading = Heading::new(title, scored, "trials for each map", label).with_note(format!(
        "Scale {}; frames: simulated twins of these trials",
        budget.scale.name()
    ));
    let fig_9 = heats(&heading, &heats_of(&scores)).map_err(StudyError::from)?;
    let numbers = json!({ "table": "IV", "scale": budget.scale.name(), "maps": numbers,
        "verdicts": verdicts.lines().collect::<Vec<_>>() });
    Ok(Sheet::new("table-iv", text, numbers, vec![OutputFile::new("fig-9.svg", fig_9)]))
}

/// States whether the nets of some maps beat a regression; `lost`: the maps on which they do not.
fn verdict(name: &str, lost: &[String], maps: usize) -> String {
    let words = match lost {
        [] => format!("beats {name} on all maps"),
        lost => {
            format!("does NOT beat {name} on {} of {maps} maps: {}", lost.len(), lost.join(", "))
        }
    };
    format!("By the paper's rule for the best of many nets (V-D) the Recon-Net {words}.\n")
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::small;
    use crate::lab::Training;
    use crate::lab::fake::{FakeLab, result};

    #[test]
    fn regressions_are_next_to_each_net_on_its_rows_and_a_net_that_beats_none_says_so() {
        let lab = FakeLab { scores: true, ..FakeLab::default() };
        let sheet = result(table_iv(&lab, &small())).unwrap();
        let trained = lab.trained.lock().unwrap();
        assert_eq!(trained.len(), 36);
        let same = |t: &Training| (t.dataset.clone(), t.map, t.rows, t.conditions.clone());
        for of_map in trained.chunks(3) {
            let recipes: Vec<&str> = of_map.iter().map(|t| t.recipe.as_str()).collect();
            assert_eq!(recipes, ["recon-net", "recon-ridge", "recon-kernel-ridge"]);
            assert!(of_map.iter().all(|t| same(t) == same(&of_map[0])), "{of_map:?}");
        }
        let scored = lab.scored.lock().unwrap();
        let nets: Vec<&str> = scored.iter().map(|r| r.map.as_deref().unwrap()).collect();
        assert_eq!((nets.len(), nets[0], nets[35]), (36, "mdl-1", "mdl-36"));
        // The fake lab scores all alike.
        let words = "does NOT beat kernel ridge on 12 of 12 maps: 4x20, ";
        assert!(
            sheet.text.contains(words) && sheet.text.contains("|   kernel ridge "),
            "{}",
            sheet.text
        );
        assert_eq!(sheet.numbers["maps"][11]["regressions"][1]["name"], "kernel ridge");
        let last = sheet.numbers["verdicts"][1].as_str().unwrap();
        assert!(last.contains(words), "{last}");
        assert!(verdict("ridge", &[], 12).contains("beats ridge on all maps"));
    }
}
