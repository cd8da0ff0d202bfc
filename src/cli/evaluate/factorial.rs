//! Fig. 11: pixel size x diameter x noise on the held-out part of *real*, with an analysis of
//! variance in which each contact is a sample (paper V-C2).
//! Uses: `lab`, `evaluate::{anova, table, charts, published}`. Never: training here.

use serde_json::json;

use super::lab::{Lab, Sheet};
use super::method::perfects;
use super::noise::LEVELS;
use crate::cli::error::CliError;
use crate::evaluate::anova::{Anova, Factor, Factorial, Moments};
use crate::evaluate::charts::{Bar, bars};
use crate::evaluate::published::{FIG_11, Held, Marginal};
use crate::evaluate::request::Scored;
use crate::evaluate::table::{self, COLUMNS};
use crate::evaluate::touch::Metric;

/// The coarser of the two pixels; the finer one depends on the scale.
pub const COARSE_MM: u32 = 20;
pub const DIAMETERS_MM: [u32; 2] = [20, 60];
/// The paper's four criteria, as reports name them.
const CRITERIA: [(&str, &str, Metric); 4] = [
    ("number_percent", "number error (%)", Metric::Number),
    ("location_mm", "location error (mm)", Metric::Location),
    ("force_percent", "force error (%)", Metric::Force),
    ("diameter_percent", "diameter error (%)", Metric::Diameter),
];

/// Trains and scores the twelve conditions.
///
/// # Errors
/// `CliError` if a training or an evaluation fails.
pub async fn factorial(lab: Lab) -> Result<Sheet, CliError> {
    let transfer = lab.transfer_to_6().await?;
    let factor = |name: &str, levels: Vec<String>| Factor { name: name.into(), levels };
    let mm = |values: [u32; 2]| values.map(|mm| format!("{mm} mm")).to_vec();
    let pixels_mm = [lab.args.scale.fine_mm(), COARSE_MM];
    let percent = LEVELS.map(|level| format!("{:.0} %", 100.0 * level)).to_vec();
    let factors = vec![
        factor("pixel", mm(pixels_mm)),
        factor("diameter", mm(DIAMETERS_MM)),
        factor("noise", percent.clone()),
    ];
    let design = Factorial::new(factors).map_err(odd)?;
    let mut designs = CRITERIA.map(|_| design.clone());
    let (mut reports, mut shown, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
    let mut label = String::new();
    for (p, pixel_mm) in pixels_mm.into_iter().enumerate() {
        for (d, diameter_mm) in DIAMETERS_MM.into_iter().enumerate() {
            for (n, level) in LEVELS.into_iter().enumerate() {
                let map = format!("{pixel_mm}x{diameter_mm}");
                let net = lab.maps("recon-net", &map, Some((level, &transfer.id))).await?;
                let mut wish = lab.wish(Scored::Paper, "real", Some("test"));
                wish.transfer = Some(transfer.id.clone());
                wish.map = Some(net.id.clone());
                let report = lab.scored(&wish).await?;
                let cells = report.cells.clone().unwrap_or_default();
                let name = format!("{map}, {}", percent[n]);
                for (design, (key, ..)) in designs.iter_mut().zip(CRITERIA) {
                    let moments = cells.get(key).copied().unwrap_or_default();
                    design.join(&[p, d, n], moments).map_err(odd)?;
                }
                shown.push((name, cells));
                label = report.label.clone();
                numbers.push(json!({ "map": map, "noise": level, "model": net.id,
                    "report": report }));
                reports.push(report);
            }
        }
    }
    let mut text = String::from(
        "# Fig. 11: the whole pipeline on the held-out part of real, each contact a sample\n",
    );
    let (mut analyses, mut pictures) = (Vec::new(), Vec::new());
    for (design, (key, words, metric)) in designs.iter().zip(CRITERIA) {
        let bars_of = shown.iter().filter_map(|(name, cells)| bar(name, cells.get(key)?));
        pictures.push((format!("fig-11-{key}.svg"), bars(words, &bars_of.collect::<Vec<_>>())?));
        match design.analyse() {
            Ok(anova) => {
                text += &format!(
                    "\n## {words}\n\n{}\n{}\n{}",
                    means(&anova),
                    beside_published(&anova, metric),
                    table::anova(&anova)
                );
                analyses.push(json!({ "criterion": key, "anova": anova }));
            }
            // A condition without any estimate has no pairs.
            Err(why) => text += &format!("\n## {words}\n\nnot analysed: {why}\n"),
        }
    }
    text += &format!(
        "\n## A perfect map under the same rule\n\n{}\n{}\n",
        table::markdown(&COLUMNS, &perfects(reports.iter())),
        lab.scale_words(&label)
    );
    Ok(Sheet {
        name: "fig-11".into(),
        text,
        numbers: json!({ "figure": "11", "scale": lab.args.scale.name(), "label": label,
            "transfer": transfer.id, "conditions": numbers, "analyses": analyses }),
        pictures,
    })
}

fn bar(name: &str, moments: &Moments) -> Option<Bar> {
    Some(Bar { name: name.into(), mean: moments.mean()?, sd: moments.sd().unwrap_or(0.0) })
}

/// Table of the estimated marginal means of the main effects.
fn means(anova: &Anova) -> String {
    let main = anova.means.iter().filter(|mean| mean.levels.iter().flatten().count() == 1);
    let row = |mean: &crate::evaluate::anova::MarginalMean| {
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

/// Table of the marginal means in the paper's text, and ours at the same levels.
fn beside_published(anova: &Anova, metric: Metric) -> String {
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
        let ours = anova.means.iter().find(|mean| held && mean.levels == levels);
        let named = anova.factors.iter().zip(&words);
        let named = named.filter_map(|(f, word)| Some(format!("{} {}", f.name, word.as_ref()?)));
        vec![
            named.collect::<Vec<_>>().join(", "),
            format!("{:.1}", published.mean),
            ours.map_or("-".into(), |mean| format!("{:.1}", mean.mean)),
        ]
    };
    let quoted = FIG_11.iter().filter(|published| published.metric == metric);
    table::markdown(
        &["the paper's text", "published", "here"],
        &quoted.map(row).collect::<Vec<_>>(),
    )
}

fn odd(error: crate::evaluate::anova::AnovaError) -> CliError {
    CliError::argument("factorial", "the design", error.to_string())
}
