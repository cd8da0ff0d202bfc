//! `palpate placement`, `confirm`, `repeat`: manual trials from the terminal.
//! Uses: `client`. Never: a judgement (the service makes it).

use clap::Args;
use serde_json::json;

use super::ask::{ActArgs, act};
use super::error::CliResult;
use super::{At, embed};
use crate::api::{PlacementOut, Stage};

/// Options of `confirm`.
#[derive(Debug, Clone, Args)]
pub struct ConfirmArgs {
    /// Index of the placement that was made [default: the one that the run waits for].
    #[arg(long, value_name = "TRIAL")]
    pub trial: Option<u32>,
    /// Store the placement even if the skin contradicts it; its trial gets the flag `doubted`.
    #[arg(long)]
    pub anyway: bool,
    #[command(flatten)]
    pub act: ActArgs,
}

/// Options of `repeat`.
#[derive(Debug, Clone, Args)]
pub struct RepeatArgs {
    /// Index of the placement to repeat [default: the one that was measured last].
    #[arg(long, value_name = "TRIAL")]
    pub trial: Option<u32>,
    #[command(flatten)]
    pub act: ActArgs,
}

/// Runs `palpate confirm`.
///
/// # Errors
/// As [`act`]; also if the skin contradicts the placement.
pub async fn confirm(args: &ConfirmArgs) -> CliResult<()> {
    let mut more = json!({ "anyway": args.anyway });
    if let Some(trial) = args.trial {
        more["trial"] = trial.into();
    }
    act(&args.act, "confirm", more).await
}

/// Runs `palpate repeat`.
///
/// # Errors
/// As [`act`].
pub async fn repeat(args: &RepeatArgs) -> CliResult<()> {
    let more = args.trial.map_or_else(|| json!({}), |trial| json!({ "trial": trial }));
    act(&args.act, "repeat", more).await
}

/// Runs `palpate placement`.
///
/// # Errors
/// `CliError` if the service cannot be reached, or no run asks for a placement.
pub async fn placement(at: &At) -> CliResult<()> {
    let client = embed::server(at).await?;
    let placement: PlacementOut = client.get("/api/v1/placement").await?;
    at.output().say(&placement, words(&placement));
    Ok(())
}

fn words(placement: &PlacementOut) -> String {
    let PlacementOut { scan_id, experiment, trial, of, done, repeated, .. } = placement;
    let stage = match placement.stage {
        Stage::Place => "place these weights, then run `palpate confirm`",
        Stage::Settling => "the skin settles",
        Stage::Measuring => "frames are taken",
        Stage::Stored => "stored",
    };
    let mut lines = vec![
        format!(
            "run      {scan_id}, {experiment}: {done} of {of} placements stored, {repeated} repeated"
        ),
        format!("trial    {trial}: {stage}"),
    ];
    for contact in &placement.contacts {
        lines.push(format!(
            "weight {} {:>6.3} N at {:<8} x {:.1}  y {:.1} mm",
            contact.number, contact.force_n, contact.point, contact.x_mm, contact.y_mm
        ));
    }
    lines.push(format!("verdict  {}", placement.verdict.kind.as_str()));
    lines.extend(placement.verdict.words.iter().map(|words| format!("         {words}")));
    lines.push(match placement.untouched_at {
        Some(at) => format!("skin     untouched at {at:.0}: offsets are taken from there"),
        None => "skin     not tared: take everything off it, then run `palpate rig tare`".into(),
    });
    if let Some(last) = &placement.last {
        let verdict = last.verdict.map_or("not known", |verdict| verdict.as_str());
        lines.push(format!("last     trial {}, verdict {verdict}", last.trial));
    }
    lines.join("\n")
}
