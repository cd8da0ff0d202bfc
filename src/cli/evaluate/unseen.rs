//! Fig. 12 and V-D: contacts that were in no training, by the paper's pipeline, both baselines and
//! the project's methods.
//! Uses: `lab`, `evaluate::{published, table, charts}`. Never: training here.

use clap::Args;
use serde_json::json;

use super::factorial::{COARSE_MM, DIAMETERS_MM};
use super::lab::{Lab, LabArgs, R2S, Scale, Sheet, to, with_lab};
use super::method::{perfects, read_by, rows};
use super::noise::LEVELS;
use crate::cli::error::CliError;
use crate::dataset::force_map::{ForceMapSpec, TABLE_IV};
use crate::evaluate::charts::{Bar, Picture, bars, pictures};
use crate::evaluate::published::REAL_UNSEEN;
use crate::evaluate::request::{EvaluationReport, EvaluationRequest, Example, FramesRead, Scored};
use crate::evaluate::score::Mean;
use crate::evaluate::table::{Beside, COLUMNS, markdown, published_row, score_row};
use crate::store::Contact;

/// The recipe of the paper's Transfer-Net (V-A).
const PUBLISHED: &str = "transfer-net-published";
/// Number of trials that are drawn.
const EXAMPLES: u64 = 3;

/// Options of `evaluate unseen`.
#[derive(Debug, Clone, Args)]
pub struct UnseenArgs {
    /// Id or name of a Point-Net, scored as `fast`; also proposes to `exact`.
    #[arg(long, value_name = "MODEL")]
    points: Option<String>,
    /// Id of a calibration stored in the service, scored as `exact`.
    #[arg(long, value_name = "CAL")]
    skin: Option<String>,
    /// Skip the paper's nets: score our methods only.
    #[arg(long)]
    ours: bool,
    /// Name or id of the dataset.
    #[arg(long, value_name = "NAME", default_value = "real-unseen")]
    dataset: String,
    #[command(flatten)]
    lab: LabArgs,
}

/// Runs `palpate evaluate unseen`.
///
/// # Errors
/// `CliError` if a training or an evaluation fails.
pub async fn unseen(args: UnseenArgs) -> Result<(), CliError> {
    with_lab(args.lab.clone(), move |lab| score(lab, args)).await
}

/// A method's name and report.
type Named = (String, EvaluationReport);
type Scores = Vec<Named>;

async fn score(lab: Lab, args: UnseenArgs) -> Result<Sheet, CliError> {
    let ours = ours(&lab, &args).await?;
    let (pipeline, end_to_end) = if args.ours {
        (Scores::new(), Scores::new())
    } else {
        (pipeline(&lab, &args).await?, end_to_end(&lab, &args).await?)
    };
    let mut table = Vec::new();
    let best = best(&pipeline);
    let mut published = None;
    if let Some((name, report)) = best {
        table.extend(rows(&format!("real-to-sim, best: {name}"), report));
        if lab.args.transfer != PUBLISHED {
            let report = with_published(&lab, &args, report).await?;
            table.extend(rows("  the same, Transfer-Net as published", &report));
            published = Some(report);
        }
    }
    if let Some((name, report)) = self::best(&end_to_end) {
        table.extend(rows(&format!("end-to-end, best: {name}"), report));
    }
    table.push(published_row("paper, best of 36 of 4 to 20 mm, 1024 epochs", &REAL_UNSEEN));
    for (name, report) in &ours {
        table.extend(rows(name, report));
    }
    let any = ours.iter().chain(&pipeline).map(|(_, report)| report).next();
    let all = ours.iter().chain(&pipeline).chain(&end_to_end).map(|(_, report)| report);
    table.extend(perfects(all));
    let label = any.map(|report| report.label.clone()).unwrap_or_default();
    let text = format!(
        "# Fig. 12: contacts that no net has seen, mean [95 % interval]\n\n{}\n{}{}{}{}\n",
        markdown(&COLUMNS, &table),
        nets(&pipeline, &end_to_end),
        best.map_or(String::new(), |(_, report)| format!("real-to-sim, best: {}", read_by(report))),
        ours.last().map_or(String::new(), |(_, exact)| format!("exact: {}\n", read_by(exact))),
        lab.scale_words(&label)
    );
    let listed = |scores: &Scores| -> Vec<_> {
        scores.iter().map(|(name, report)| json!({ "name": name, "report": report })).collect()
    };
    let mut pictures =
        figures(&[("real-to-sim", &pipeline), ("end-to-end", &end_to_end), ("", &ours)])?;
    let bests = [("real-to-sim", best), ("end-to-end", self::best(&end_to_end))];
    pictures.push(("fig-12a.svg".into(), examples(&lab, &args, &bests).await?));
    Ok(Sheet {
        name: "fig-12".into(),
        text,
        numbers: json!({ "figure": "12", "scale": lab.args.scale.name(), "label": label,
            "real_to_sim": listed(&pipeline), "end_to_end": listed(&end_to_end),
            "ours": listed(&ours), "best": best.map(|(name, _)| name),
            "best_with_published_transfer": published }),
        pictures,
    })
}

fn wish(lab: &Lab, args: &UnseenArgs, scored: Scored) -> EvaluationRequest {
    let mut wish = lab.wish(scored, &args.dataset, None);
    wish.limit = lab.args.scored;
    wish
}

/// The one-step reconstructions, Point-Net, and the fit through the exact model.
async fn ours(lab: &Lab, args: &UnseenArgs) -> Result<Scores, CliError> {
    let mut scores = Scores::new();
    for (name, scored) in
        [("one step, Tikhonov", Scored::Tikhonov), ("one step, NOSER", Scored::Noser)]
    {
        let mut wish = wish(lab, args, scored);
        wish.skin = args.skin.clone();
        scores.push((name.into(), lab.scored(&wish).await?));
    }
    for (read, frames) in [("1 frame", FramesRead::First), ("mean", FramesRead::Mean)] {
        if args.points.is_some() {
            let mut wish = wish(lab, args, Scored::Fast);
            (wish.points, wish.frames) = (args.points.clone(), frames);
            scores.push((format!("fast, {read}"), lab.scored(&wish).await?));
        }
        let mut wish = wish(lab, args, Scored::Exact);
        (wish.points, wish.skin, wish.frames) = (args.points.clone(), args.skin.clone(), frames);
        scores.push((format!("exact, {read}"), lab.scored(&wish).await?));
    }
    Ok(scores)
}

/// The maps of Table IV; below full scale those of the factorial design.
fn maps(scale: Scale) -> Vec<String> {
    if scale == Scale::Full {
        return TABLE_IV.map(|spec| spec.to_string()).to_vec();
    }
    let of_pixel = |pixel_mm| DIAMETERS_MM.map(|diameter| format!("{pixel_mm}x{diameter}"));
    [scale.fine_mm(), COARSE_MM].into_iter().flat_map(of_pixel).collect()
}

/// The paper's pipeline: every map at every level of noise.
async fn pipeline(lab: &Lab, args: &UnseenArgs) -> Result<Scores, CliError> {
    let transfer = lab.transfer_to_6().await?;
    let mut scores = Scores::new();
    for map in maps(lab.args.scale) {
        for level in LEVELS {
            let net = lab.maps("recon-net", &map, Some((level, &transfer.id))).await?;
            let mut wish = wish(lab, args, Scored::Paper);
            wish.transfer = Some(transfer.id.clone());
            wish.map = Some(net.id);
            let name = format!("{map}, {:.0} %", 100.0 * level);
            scores.push((name, lab.scored(&wish).await?));
        }
    }
    Ok(scores)
}

/// The best of the pipeline with the paper's Transfer-Net: least squares in volts.
async fn with_published(
    lab: &Lab,
    args: &UnseenArgs,
    best: &EvaluationReport,
) -> Result<EvaluationReport, CliError> {
    let all = [to(6)];
    let transfer = lab.transfer_by(PUBLISHED, "transfer-published-to-6", R2S, &all).await?;
    let mut wish = wish(lab, args, Scored::Paper);
    (wish.transfer, wish.map) = (Some(transfer.id), best.models.last().cloned());
    lab.scored(&wish).await
}

/// The baseline trained on measured trials only.
async fn end_to_end(lab: &Lab, args: &UnseenArgs) -> Result<Scores, CliError> {
    let mut scores = Scores::new();
    for map in maps(lab.args.scale) {
        let net = lab.maps("end-to-end", &map, None).await?;
        let mut wish = wish(lab, args, Scored::Paper);
        wish.map = Some(net.id);
        scores.push((map, lab.scored(&wish).await?));
    }
    Ok(scores)
}

/// The best by the paper's rule (V-D).
fn best(scores: &Scores) -> Option<&Named> {
    let cost = |report: &EvaluationReport| Some(report.contacts.as_ref()?.all.paper_cost());
    let costs = scores.iter().filter_map(|named| Some((cost(&named.1)?, named)));
    costs.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, named)| named)
}

/// Tables of all of the paper's nets, if there are any.
fn nets(pipeline: &Scores, end_to_end: &Scores) -> String {
    let named = |way: &'static str| {
        move |row: Vec<String>| {
            let name = format!("{way} {}", row[0]);
            [vec![name], row[1..].to_vec()].concat()
        }
    };
    let rows = every(pipeline).map(named("real-to-sim"));
    let rows: Vec<_> = rows.chain(every(end_to_end).map(named("end-to-end"))).collect();
    if rows.is_empty() {
        return String::new();
    }
    format!("All nets, by map and noise:\n\n{}\n", markdown(&COLUMNS, &rows))
}

/// One row per net.
fn every(scores: &Scores) -> impl Iterator<Item = Vec<String>> {
    scores.iter().filter_map(|(name, report)| {
        Some(score_row(name, &report.contacts.as_ref()?.all, Beside::Interval))
    })
}

/// Some trials with each method's answers (Fig. 12A): one row each, true contacts first.
async fn examples(
    lab: &Lab,
    args: &UnseenArgs,
    bests: &[(&str, Option<&Named>)],
) -> Result<String, CliError> {
    let few = |mut wish: EvaluationRequest| {
        (wish.limit, wish.examples) = (Some(EXAMPLES), EXAMPLES);
        wish
    };
    let mut columns = Vec::new();
    for (name, best) in bests {
        let Some((_, report)) = best else { continue };
        let mut wish = few(wish(lab, args, Scored::Paper));
        // Reports name the Transfer-Net first, if there is one.
        wish.map = report.models.last().cloned();
        wish.transfer = report.models.first().cloned().filter(|_| report.models.len() > 1);
        columns.push((*name, lab.scored(&wish).await?));
    }
    for (name, scored) in [("one step", Scored::Tikhonov), ("exact", Scored::Exact)] {
        let mut wish = few(wish(lab, args, scored));
        wish.skin = args.skin.clone();
        if scored == Scored::Exact {
            wish.points = args.points.clone();
        }
        columns.push((name, lab.scored(&wish).await?));
    }
    let mut maps = Vec::new();
    for row in 0..EXAMPLES as usize {
        let of_row = columns.iter().filter_map(|(name, report)| {
            Some((*name, report.map.as_deref()?.parse().ok()?, report.examples.get(row)?))
        });
        let of_row: Vec<(&str, ForceMapSpec, &Example)> = of_row.collect();
        let Some((_, _, first)) = of_row.first() else { break };
        let name = format!("{} contacts", first.truth.len());
        maps.push(Picture::of_contacts(&name, TABLE_IV[0], &first.truth)?);
        for (name, spec, example) in of_row {
            maps.push(match &example.reading.force_map_n {
                Some(map) => Picture { name: name.into(), spec, map: map.clone() },
                None => {
                    let found: Vec<Contact> =
                        example.reading.contacts.iter().map(Contact::from).collect();
                    Picture::of_contacts(name, spec, &found)?
                }
            });
        }
    }
    Ok(pictures("Fig. 12A: true contacts, and each method's answer", &maps, 1 + columns.len())?)
}

fn figures(groups: &[(&str, &Scores)]) -> Result<Vec<(String, String)>, CliError> {
    type Pick = fn(&crate::evaluate::score::Score) -> Option<Mean>;
    let quantities: [(&str, &str, Pick); 3] = [
        ("location", "contact location error (mm)", |score| score.location_mm),
        ("force", "contact force error (%)", |score| score.force_percent),
        ("diameter", "contact diameter error (%)", |score| score.diameter_percent),
    ];
    let mut pictures = Vec::new();
    for (key, words, pick) in quantities {
        let mut all = Vec::new();
        for (group, scores) in groups {
            all.extend(scores.iter().filter_map(|(name, report)| {
                let mean = pick(&report.contacts.as_ref()?.all)?;
                let name = format!("{group} {name}").trim().to_owned();
                Some(Bar { name, mean: mean.mean, sd: mean.sd.unwrap_or(0.0) })
            }));
        }
        if !all.is_empty() {
            pictures.push((format!("fig-12-{key}.svg"), bars(words, &all)?));
        }
    }
    Ok(pictures)
}
