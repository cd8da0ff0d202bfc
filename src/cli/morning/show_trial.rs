//! `palpate show TRIAL`: forces, depth, place and frame of a trial, next to its twin.
//! Uses: `client`, `frame`, `chart`. Never: a change.

use std::fmt::Write;

use super::chart::{printed, width};
use super::frame::{Ink, Picture, draw};
use crate::api::Page;
use crate::cli::client::Client;
use crate::cli::error::{CliError, CliResult};
use crate::cli::find::find_run;
use crate::cli::output::{Output, filled, is_coloured, say, say_drawn, say_json};
use crate::cli::table::or_dash;
use crate::cli::times::second;
use crate::store::TrialRow;

/// Width of the bar of a force, characters.
const BAR: usize = 36;

/// What a person typed for a trial.
#[derive(Debug, PartialEq, Eq)]
pub enum TrialName {
    /// `t812`: the number of a stored trial.
    Id(i64),
    /// `3/81/4`: a configuration and depth of a run.
    Key {
        /// Number or uid of the run, or `last`.
        run: String,
        /// Index of the configuration in the plan.
        configuration: u32,
        /// Index of the depth in the plan.
        depth_index: u32,
    },
}

/// Reads the name of a trial; `None` for other texts.
pub fn named(text: &str) -> Option<TrialName> {
    if let Some(number) = text.strip_prefix('t') {
        return number.parse().ok().map(TrialName::Id);
    }
    let parts: Vec<&str> = text.split('/').collect();
    let [run, configuration, depth_index] = parts[..] else { return None };
    let (configuration, depth_index) = (configuration.parse().ok()?, depth_index.parse().ok()?);
    Some(TrialName::Key { run: run.into(), configuration, depth_index })
}

/// Shows a trial.
///
/// # Errors
/// `CliError` if there is no such trial, or a request fails.
pub async fn show(client: &Client, name: &TrialName, output: Output) -> CliResult<()> {
    let trial = stored(client, name, true).await?;
    if output == Output::Json {
        say_json(&trial);
        return Ok(());
    }
    say(words(&trial));
    if let Some(measured) = trial.voltages_v.clone() {
        let pictures = pictures(measured, trial.sim_voltages_v.clone());
        let ink = match std::env::var("COLORTERM").as_deref() {
            _ if !is_coloured() => Ink::Shades,
            Ok("truecolor" | "24bit") => Ink::Colours,
            _ => Ink::Palette,
        };
        say("\nframe: a row per injection, a column per reading; the end of each scale holds 98 %");
        say_drawn(&printed(&draw(&pictures, ink, width())));
    }
    Ok(())
}

/// Returns the stored trial that a person named. `voltages`: with its mean frame, and the simulated one.
///
/// # Errors
/// `CliError::NoSuch` if there is no such trial; others as [`Client::send`].
pub async fn stored(client: &Client, name: &TrialName, voltages: bool) -> CliResult<TrialRow> {
    let query = match name {
        TrialName::Id(id) => format!("/api/v1/trials?trial_id={id}"),
        TrialName::Key { run, configuration, depth_index } => {
            let run = find_run(client, run).await?.uid;
            let key = format!("configuration={configuration}&depth_index={depth_index}");
            format!("/api/v1/runs/{run}/trials?{key}")
        }
    };
    let path = format!("{query}&voltages={voltages}&limit=1");
    let page: Page<TrialRow> = client.get(&path).await?;
    page.items.into_iter().next().ok_or_else(|| {
        let shown = match name {
            TrialName::Id(id) => format!("t{id}"),
            TrialName::Key { run, configuration, depth_index } => {
                format!("{run}/{configuration}/{depth_index}")
            }
        };
        CliError::NoSuch(format!("no trial {shown}: palpate trials lists the newest"))
    })
}

/// The measured frame, its twin on the same scale, and their difference.
fn pictures(measured_v: Vec<f32>, simulated_v: Option<Vec<f32>>) -> Vec<Picture> {
    let measured = Picture::new("measured", measured_v);
    let Some(simulated_v) = simulated_v.filter(|v| v.len() == measured.voltages_v.len()) else {
        return vec![measured];
    };
    let difference = measured.voltages_v.iter().zip(&simulated_v).map(|(m, s)| m - s).collect();
    let twin = Picture { end_v: measured.end_v, ..Picture::new("twin, same scale", simulated_v) };
    vec![measured, twin, Picture::new("measured minus twin", difference)]
}

fn words(trial: &TrialRow) -> String {
    let number = |value: Option<f64>, digits: usize, unit: &str| {
        or_dash(value.map(|value| format!("{value:.digits$} {unit}")))
    };
    let mut text = format!(
        "trial t{} ({}): run {}, {}; configuration {}, depth index {}, attempt {}",
        trial.trial_id.0,
        trial.label.as_str(),
        trial.scan_id,
        trial.experiment,
        trial.configuration,
        trial.depth_index,
        trial.attempt,
    );
    let mut line = |name: &str, value: String| {
        let _ = write!(text, "\n  {name:<10} {value}");
    };
    if let Some(at) = trial.measured_at {
        line("measured", second(at));
    }
    line("depth", number(trial.depth_mm, 2, "mm"));
    if let Some(reached) = trial.reached {
        let error = trial.depth_error_mm().unwrap_or(0.0);
        line(
            "placement",
            format!(
                "x {:.2}, y {:.2}, z {:.2} mm ({error:+.3} mm of its target), radius {:.2} mm",
                reached.x_mm, reached.y_mm, reached.z_mm, reached.radius_mm
            ),
        );
    }
    if let Some(who) = &trial.placed_by {
        line("placed by", who.clone());
    }
    line("contacts", trial.contact_count.to_string());
    line("settled", number(trial.settle_ms, 0, "ms"));
    line("overshoot", number(trial.scalars.overshoot_n, 2, "N"));
    let fit = match trial.fvu {
        Some(fvu) => {
            format!("FVU {fvu:.3}, RMSE {}", number(trial.rmse_v.map(|v| 1e3 * v), 2, "mV"))
        }
        None => "none".into(),
    };
    line("twin", fit);
    if !trial.flags.is_empty() {
        let flags: Vec<&str> = trial.flags.iter().map(|flag| flag.as_str()).collect();
        line("FLAGS", flags.join(", "));
    }
    text.push_str(&forces(trial));
    text
}

/// A bar for each tip; placed weights are listed.
fn forces(trial: &TrialRow) -> String {
    let most = trial.arms.iter().map(|arm| arm.force_n).fold(1.0, f64::max);
    let mut text = String::new();
    for arm in &trial.arms {
        let bar = filled(arm.force_n / most, BAR);
        let (x, y) = (arm.x_mm, arm.y_mm);
        let _ = write!(
            text,
            "\n  arm {}  {:>7.2} N  x {x:>6.1}  y {y:>6.1} mm  {bar}",
            arm.arm, arm.force_n
        );
    }
    if trial.arms.is_empty() {
        for contact in &trial.contacts {
            let shown = |value: Option<f64>| or_dash(value.map(|value| format!("{value:.2}")));
            let [x, y, n] = [contact.x_mm, contact.y_mm, contact.force_n].map(shown);
            let _ = write!(text, "\n  contact  {n} N  x {x}  y {y} mm");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trial_is_named_by_its_number_or_its_key() {
        assert_eq!(named("t812"), Some(TrialName::Id(812)));
        let key = |run: &str, configuration, depth_index| {
            Some(TrialName::Key { run: run.into(), configuration, depth_index })
        };
        assert_eq!(named("3/81/4"), key("3", 81, 4));
        assert_eq!(named("last/0/1"), key("last", 0, 1));
        for run in ["3", "last", "t", "3/81", "3/x/4", "0193ab"] {
            assert_eq!(named(run), None, "{run}");
        }
    }

    #[test]
    fn a_twin_has_the_scale_of_the_measured_frame() {
        let drawn = pictures(vec![0.1; 784], Some(vec![0.4; 784]));
        let ends: Vec<f64> = drawn.iter().map(|picture| picture.end_v).collect();
        assert!((ends[0] - ends[1]).abs() < 1e-12 && (ends[2] - 0.3).abs() < 1e-6, "{ends:?}");
        assert_eq!(pictures(vec![0.1; 784], None).len(), 1);
        assert_eq!(pictures(vec![0.1; 784], Some(vec![0.4; 10])).len(), 1);
    }
}
