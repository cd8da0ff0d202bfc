//! `palpate placement`, `confirm`, `repeat`: manual trials from the terminal.
//! Uses: `client`. Never: a judgement (the service makes it).

use clap::Args;
use serde_json::{Value, json};

use super::ask::{ActArgs, act_in_time};
use super::error::CliResult;
use super::{At, embed};
use crate::api::{PlacementOut, Stage};
use crate::campaign::shown::status::{RunStatus, Wanted};

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
/// As [`act_in_time`]; also if the skin contradicts the placement, or the run waits for something else meanwhile.
pub async fn confirm(args: &ConfirmArgs) -> CliResult<()> {
    let more = |run: &RunStatus| confirmation(args, run.wanted.as_ref());
    act_in_time(&args.act, "confirm", more).await
}

/// Fields of a confirmation. It states what was done: if another person has confirmed it meanwhile, this one must not
/// confirm what the run waits for next.
fn confirmation(args: &ConfirmArgs, wanted: Option<&Wanted>) -> Value {
    let mut more = json!({ "anyway": args.anyway });
    match (args.trial, wanted) {
        (Some(trial), _) => more["trial"] = trial.into(),
        (None, Some(Wanted::Placement { trial, .. })) => more["trial"] = (*trial).into(),
        (None, Some(Wanted::Tips { tips })) => more["tips"] = (*tips).into(),
        (None, None) => {}
    }
    more
}

/// Runs `palpate repeat`.
///
/// # Errors
/// As [`act_in_time`].
pub async fn repeat(args: &RepeatArgs) -> CliResult<()> {
    let more = args.trial.map_or_else(|| json!({}), |trial| json!({ "trial": trial }));
    act_in_time(&args.act, "repeat", |_| more).await
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_confirmation_states_what_the_run_waits_for() {
        let of = |trial, wanted: Option<Wanted>| {
            let act = ActArgs { why: None, at: At::default() };
            confirmation(&ConfirmArgs { trial, anyway: false, act }, wanted.as_ref())
        };
        let placement = || Some(Wanted::Placement { trial: 5, contacts: Vec::new() });
        assert_eq!(of(None, placement()), json!({ "anyway": false, "trial": 5 }));
        assert_eq!(of(Some(4), placement()), json!({ "anyway": false, "trial": 4 }));
        let tips = of(None, Some(Wanted::Tips { tips: 3 }));
        assert_eq!(tips, json!({ "anyway": false, "tips": 3 }));
        assert_eq!(of(None, None), json!({ "anyway": false }));
    }
}
