//! Fig. 11: pixel size x diameter x noise on the held-out part of *real*, with an analysis of
//! variance in which each contact is a sample (paper, V-C2).
//! Uses: `lab`, `budget`, `evaluate::{anova, table, charts, published}`. Never: training here.

use std::collections::BTreeMap;

use serde_json::json;

use crate::budget::{Budget, R2S, REAL, RECON_NET};
use crate::dataset::force_map::{ForceMapSpec, SIDE_MM};
use crate::evaluate::anova::{Anova, Factor, Factorial, MarginalMean, Moments};
use crate::evaluate::charts::{Bar, bars};
use crate::evaluate::published::{FIG_11, Held, Marginal};
use crate::evaluate::request::EvaluationReport;
use crate::evaluate::table::{self, SCORE_COLUMNS};
use crate::evaluate::touch::Metric;
use crate::figure::Heading;
use crate::ids::ModelId;
use crate::infer::methods::Method;
use crate::lab::{Lab, Noise, StudyResult};
use crate::noise::LEVELS;
use crate::rows::{distances_note, perfects};
use crate::sheet::{OutputFile, Sheet};

/// The two diameters over which forces are spread, mm.
pub const DIAMETERS_MM: [f64; 2] = [20.0, 60.0];
/// The paper's four criteria: key in reports, name in tables, metric.
const CRITERIA: [(&str, &str, Metric); 4] = [
    ("number_percent", "number error (%)", Metric::Number),
    ("location_mm", "location error (mm)", Metric::Location),
    ("force_percent", "force error (%)", Metric::Force),
    ("diameter_percent", "diameter error (%)", Metric::Diameter),
];

/// One cell of the design.
struct Condition {
    /// Indices of the levels: pixel, diameter, noise.
    at: [usize; 3],
    map: ForceMapSpec,
    /// Factor on the noise.
    level: f64,
    /// Id of the Recon-Net.
    model: ModelId,
    report: EvaluationReport,
}

impl Condition {
    fn name(&self) -> String {
        format!("{}, {}", self.map, percent(self.level))
    }

    /// Sums over contacts by criterion; empty if the report has none.
    fn cells(&self) -> BTreeMap<String, Moments> {
        self.report.cells.clone().unwrap_or_default()
    }
}

/// Trains and scores the paper's pipeline in twelve conditions: two pixels, two diameters, three
/// levels of noise; then analyses the variance of each of the four criteria.
///
/// # Errors
/// Error of the lab if a training or an evaluation fails; `StudyError::Design` if the budget has one pixel
/// only, or scores do not fit the design; `StudyError::Figure` if a figure cannot be drawn.
///
/// Source: paper, V-C2 and Fig. 11.
pub async fn fig_11<L: Lab>(lab: &L, budget: &Budget) -> Result<Sheet, L::Error> {
    // A budget with one pixel is refused before nets are trained.
    design(budget)?;
    let contacts = lab.contact_numbers(&budget.dataset(R2S)).await?;
    let transfer = lab.train(&budget.transfer_to_all(&contacts)).await?;
    let mut conditions = Vec::new();
    for (p, pixel_mm) in budget.pixels_mm().into_iter().enumerate() {
        for (d, diameter_mm) in DIAMETERS_MM.into_iter().enumerate() {
            for (n, level) in LEVELS.into_iter().enumerate() {
                let map = ForceMapSpec { pixel_mm, diameter_mm, side_mm: SIDE_MM };
                let training = budget.map_net(RECON_NET, map, Noise::at(level, &transfer));
                let model = lab.train(&training).await?;
                let mut request = budget.request(Method::Paper, REAL, Some("test"));
                request.transfer = Some(transfer.to_string());
                request.map = Some(model.to_string());
                let report = lab.score(&request).await?;
                conditions.push(Condition { at: [p, d, n], map, level, model, report });
            }
        }
    }
    Ok(sheet(budget, &transfer, &conditions)?)
}

fn percent(level: f64) -> String {
    format!("{:.0} %", 100.0 * level)
}

/// Analyses the conditions and shows them.
fn sheet(budget: &Budget, transfer: &ModelId, conditions: &[Condition]) -> StudyResult<Sheet> {
    let mut text = String::from(
        "# Fig. 11: the whole pipeline on the held-out part of real, each contact a sample\n",
    );
    let (mut analyses, mut figures) = (Vec::new(), Vec::new());
    let last = conditions.last();
    let label = last.map_or("", |condition| condition.report.label.as_str());
    let rows = last.map_or(0, |condition| condition.report.rows);
    for (key, words, metric) in CRITERIA {
        let mut design = design(budget)?;
        let mut drawn = Vec::new();
        for condition in conditions {
            let cells = condition.cells();
            design.join(&condition.at, cells.get(key).copied().unwrap_or_default())?;
            drawn.extend(cells.get(key).and_then(|moments| bar(&condition.name(), moments)));
        }
        let title = format!("Fig. 11: {words} by pixel x diameter (mm) and noise of the training");
        let heading = Heading::new(title, rows, "trials for each condition", label)
            .with_note(format!("Scale {}", budget.scale.name()));
        let figure = bars(&heading, words, &drawn)?;
        figures.push(OutputFile::new(format!("fig-11-{key}.svg"), figure));
        match design.analyse() {
            Ok(anova) => {
                text += &format!(
                    "\n## {words}\n\n{}\n{}\n{}",
                    means(&anova),
                    with_published(&anova, metric),
                    table::anova(&anova)
                );
                analyses.push(json!({ "criterion": key, "anova": anova }));
            }
            // A condition without any estimate has no pairs.
            Err(why) => text += &format!("\n## {words}\n\nnot analysed: {why}\n"),
        }
    }
    text += &format!(
        "\n## A perfect map under the same rule\n\n{}\n{}{}\n",
        table::markdown(&SCORE_COLUMNS, &perfects(conditions.iter().map(|c| &c.report))),
        last.map_or_else(String::new, |condition| distances_note(&condition.report)),
        budget.caption(label)
    );
    let numbers = conditions.iter().map(|condition| {
        let Condition { map, level, model, report, .. } = condition;
        json!({ "map": map.to_string(), "noise": level, "model": model, "report": report })
    });
    let numbers = json!({ "figure": "11", "scale": budget.scale.name(), "label": label,
        "transfer": transfer, "conditions": numbers.collect::<Vec<_>>(), "analyses": analyses });
    Ok(Sheet::new("fig-11", text, numbers, figures))
}

/// The design without samples: three factors, 2 x 2 x 3 levels.
fn design(budget: &Budget) -> StudyResult<Factorial> {
    let factor = |name: &str, levels: Vec<String>| Factor { name: name.into(), levels };
    let mm = |values: &[f64]| values.iter().map(|mm| format!("{mm} mm")).collect();
    let factors = vec![
        factor("pixel", mm(&budget.pixels_mm())),
        factor("diameter", mm(&DIAMETERS_MM)),
        factor("noise", LEVELS.map(percent).to_vec()),
    ];
    Ok(Factorial::new(factors)?)
}

fn bar(name: &str, moments: &Moments) -> Option<Bar> {
    Some(Bar {
        name: name.into(),
        mean: moments.mean()?,
        sd: moments.sd().unwrap_or(0.0),
        n: moments.count(),
    })
}

/// Table of the estimated marginal means of the main effects.
fn means(anova: &Anova) -> String {
    let main = anova.means.iter().filter(|mean| mean.levels.iter().flatten().count() == 1);
    let row = |mean: &MarginalMean| {
        let held = mean.levels.iter().enumerate().find_map(|(f, level)| Some((f, (*level)?)));
        let (factor, level) = held.unwrap_or_default();
        let factor = &anova.factors[factor];
        let sd = mean.sd.map_or("-".into(), |sd| format!("{sd:.1}"));
        vec![
            format!("{} {}", factor.name, factor.levels[level]),
            mean.n.to_string(),
            format!("{:.2}", mean.mean),
            format!("{:.2}", mean.standard_error),
            sd,
        ]
    };
    let head = ["averaged over the others", "contacts", "estimated mean", "standard error", "sd"];
    table::markdown(&head, &main.map(row).collect::<Vec<_>>())
}

/// Table of the marginal means in the paper's text, and the means here at the same levels.
fn with_published(anova: &Anova, metric: Metric) -> String {
    let row = |published: &Marginal| {
        let Held { pixel_mm, diameter_mm, noise_percent } = published.held;
        let held = [(pixel_mm, "mm"), (diameter_mm, "mm"), (noise_percent, "%")];
        let words = held.map(|(value, unit)| value.map(|value| format!("{value} {unit}")));
        let level = |(factor, word): (&Factor, &Option<String>)| {
            word.as_ref().and_then(|word| factor.levels.iter().position(|level| level == word))
        };
        let levels: Vec<_> = anova.factors.iter().zip(&words).map(level).collect();
        // A level that is not in this design is not the mean over all of them.
        let held = levels.iter().zip(&words).all(|(level, word)| level.is_some() == word.is_some());
        let here = anova.means.iter().find(|mean| held && mean.levels == levels);
        let named = anova.factors.iter().zip(&words);
        let named = named.filter_map(|(f, word)| Some(format!("{} {}", f.name, word.as_ref()?)));
        vec![
            named.collect::<Vec<_>>().join(", "),
            format!("{:.1}", published.mean),
            here.map_or("-".into(), |mean| format!("{:.1}", mean.mean)),
        ]
    };
    let quoted = FIG_11.iter().filter(|published| published.metric == metric);
    table::markdown(
        &["the paper's text", "published", "here"],
        &quoted.map(row).collect::<Vec<_>>(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::small;
    use crate::evaluate::anova::AnovaError;
    use crate::lab::StudyError;
    use crate::lab::fake::{FakeLab, result};

    #[test]
    fn a_budget_with_one_pixel_is_refused_before_nets_are_trained() {
        let lab = FakeLab::default();
        let budget = Budget { finest_mm: Some(20.0), ..small() };
        let refused = result(fig_11(&lab, &budget)).unwrap_err();
        assert!(matches!(refused, StudyError::Design(AnovaError::Levels { .. })), "{refused}");
        assert!(lab.trained.lock().unwrap().is_empty());
    }
}
