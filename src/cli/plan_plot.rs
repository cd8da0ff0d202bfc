//! `palpate plan --plot`: the plan of an experiment on the skin.
//! Uses: `files`, `figure::tour`, `picture`. Never: the network, motion.

use std::path::Path;

use super::error::CliResult;
use super::files::{ExperimentFiles, RigFiles};
use super::output::{counted, duration};
use super::picture;
use crate::evaluate::figures::FigureError;
use crate::figure::Heading;
use crate::figure::skin::Outline;
use crate::figure::tour::{Leg, Stop, WAY_STOPS, tour};
use crate::schedule::plan::{Kind, Plan, Step};
use crate::schedule::preflight::Preflight;

/// Draws the plan on this rig to a file.
///
/// # Errors
/// `CliError` if the figure cannot be drawn or written.
pub async fn plot(
    file: &Path,
    files: &ExperimentFiles,
    rig: &RigFiles,
    preflight: &Preflight,
) -> CliResult<()> {
    let label = format!("planned, {} rig", rig.config.label().as_str());
    let things = match files.plan.kind {
        Kind::RealHex => "configurations",
        Kind::RealRandom => "manual trials",
    };
    let Plan { experiment, sensor, seed, .. } = &files.plan;
    let title = format!("Plan of {experiment} on {sensor}, seed {seed}");
    let heading = Heading::new(title, preflight.configurations, things, &label).with_note(format!(
        "{}, about {} without persons. {}",
        counted(preflight.trials, "trial", "trials"),
        duration(preflight.duration_s),
        marks(&files.plan)
    ));
    let drawn = tour(&heading, &Outline::of(&files.sensor), &legs(&files.plan));
    let svg = drawn.map_err(|why| FigureError { figure: "the plan", why })?;
    picture::write(file, &svg).await
}

/// What the marks of the figure are.
fn marks(plan: &Plan) -> &'static str {
    match plan.kind {
        Kind::RealHex if plan.settings.iter().any(|s| s.configurations as usize > WAY_STOPS) => {
            "Dots: positions of tips, coloured by the first visit; triangle: first centre of the indenter; \
             crosses: reference presses; circles: electrodes"
        }
        Kind::RealHex => {
            "Dots: tips; grey line: way of the indenter from the triangle; crosses: reference presses; \
             circles: electrodes"
        }
        Kind::RealRandom => "Dots: weights; circles: electrodes",
    }
}

/// The stretches of a plan with their positions: one per setting, or the manual trials.
fn legs(plan: &Plan) -> Vec<Leg> {
    if plan.kind == Kind::RealRandom {
        let stop = |placement: &crate::schedule::manual::PlannedPlacement| Stop {
            centre_mm: None,
            tips_mm: placement.contacts.iter().map(|c| [c.x_mm, c.y_mm]).collect(),
        };
        let stops: Vec<Stop> = plan.placements().map(stop).collect();
        let name = counted(stops.len() as u64, "manual trial", "manual trials");
        return vec![Leg { name, stops, references_mm: Vec::new() }];
    }
    let of_setting = |setting: u32| {
        let mut leg = Leg { name: String::new(), stops: Vec::new(), references_mm: Vec::new() };
        for step in &plan.steps {
            match step {
                Step::Configuration(c) if c.setting == setting => leg.stops.push(Stop {
                    centre_mm: Some(c.stand.centre_mm),
                    tips_mm: c.stand.tips_mm.clone(),
                }),
                Step::Reference(press) if press.setting == setting => {
                    leg.references_mm.extend(press.stand.tips_mm.iter().copied());
                }
                _ => {}
            }
        }
        // A position has one mark, however often it is pressed.
        leg.references_mm.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        leg.references_mm.dedup();
        leg
    };
    let named = plan.settings.iter().zip(0_u32..).map(|(setting, at)| {
        let tips = counted(setting.tips.into(), "tip", "tips");
        let count = counted(setting.configurations.into(), "configuration", "configurations");
        Leg { name: format!("{tips}, {count}"), ..of_setting(at) }
    });
    named.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(name: &str) -> Plan {
        ExperimentFiles::read(Path::new(name)).unwrap().plan
    }

    #[test]
    fn every_configuration_is_a_stop_of_its_setting() {
        let plan = plan("quickstart");
        let legs = legs(&plan);
        assert_eq!(legs.len(), plan.settings.len());
        let stops: usize = legs.iter().map(|leg| leg.stops.len()).sum();
        assert_eq!(stops, plan.configurations().count());
        let tips = |leg: &Leg| leg.stops[0].tips_mm.len();
        assert_eq!(tips(&legs[0]), usize::from(plan.settings[0].tips));
    }

    #[test]
    fn manual_trials_are_one_stretch_without_a_way() {
        let plan = plan("real-random");
        let legs = legs(&plan);
        assert_eq!((legs.len(), legs[0].stops.len()), (1, plan.placements().count()));
        assert!(legs[0].stops.iter().all(|stop| stop.centre_mm.is_none()));
    }
}
