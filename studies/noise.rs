//! Fig. 10: residuals of the Transfer-Net, and one trial's maps at three levels of noise.
//! Uses: `lab`, `budget`, `evaluate::{charts, table}`. Never: training here.

use serde_json::json;

use crate::budget::{Budget, R2S, RECON_NET};
use crate::dataset::force_map::{ForceMapSpec, SIDE_MM};
use crate::evaluate::force_maps::{Picture, pictures, residuals};
use crate::evaluate::table::markdown;
use crate::figure::Heading;
use crate::infer::answer::FoundContact;
use crate::lab::{Lab, Noise, StudyError, Trial};
use crate::sheet::{OutputFile, Sheet};

/// Levels of noise: factors on the standard deviation of the residuals (paper, V-C1).
pub const LEVELS: [f64; 3] = [0.0, 0.1, 0.5];
/// Diameter of the map of Fig. 10B (Map 1), mm.
const DIAMETER_MM: f64 = 20.0;
/// Largest number of forces in a cell of the table.
const FORCES_SHOWN: usize = 6;
/// Conditions on the drawn trial: three contacts, one of them of 15 N or more, not trained on.
const SHOWN_TRIAL: [&str; 3] = ["contact_count__eq=3", "split__eq=test", "max_force_n__gte=15"];

/// Trains one Transfer-Net and a Recon-Net for each level of noise, and reads one trial of three
/// contacts.
///
/// # Errors
/// Error of the lab if a training or an answer fails; `StudyError::NoTrial` if the dataset has no
/// test trial of three contacts; `StudyError::Figure` if a figure cannot be drawn.
///
/// Source: paper, V-C1 and Fig. 10.
pub async fn fig_10<L: Lab>(lab: &L, budget: &Budget) -> Result<Sheet, L::Error> {
    let contacts = lab.contact_numbers(&budget.dataset(R2S)).await?;
    let transfer = lab.train(&budget.transfer_to_all(&contacts)).await?;
    let left = lab.residuals(&transfer).await?;
    let Trial { frame_v, contacts: truth, label } = triple(lab, &budget.dataset(R2S)).await?;
    let pixel_mm = budget.pixels_mm()[0];
    let spec = ForceMapSpec { pixel_mm, diameter_mm: DIAMETER_MM, side_mm: SIDE_MM };
    let mut shown = vec![Picture::of_contacts("true", spec, &truth).map_err(StudyError::from)?];
    let mut rows = Vec::new();
    for level in LEVELS {
        let training = budget.map_net(RECON_NET, spec, Noise::at(level, &transfer));
        let net = lab.train(&training).await?;
        let reading = lab.reading(&frame_v, &transfer, &net).await?;
        let percent = format!("{:.0} %", 100.0 * level);
        let found = reading.contacts.len().to_string();
        rows.push(vec![percent.clone(), found, strongest(&reading.contacts)]);
        let map = reading.force_map_n.unwrap_or_default();
        shown.push(Picture { name: format!("noise {percent}"), spec, map });
    }
    let mean = left.mean_v.iter().map(|v| v.abs()).fold(0.0, f32::max);
    let sd = |pick: fn(f32, f32) -> f32, start| left.sd_v.iter().copied().fold(start, pick);
    let text = format!(
        "# Fig. 10: transfer error, and one trial of three contacts at three levels of noise, \
         map {spec}\n\n\
         Residuals of {transfer} on {} validation trials: standard deviation {:.4} to {:.4} V, \
         largest mean {mean:.4} V (paper: 0.05 to 0.5 V, mean close to zero).\n\n{}\n{}\n",
        left.trials,
        sd(f32::min, f32::MAX),
        sd(f32::max, 0.0),
        markdown(&["noise", "contacts found", "forces, N"], &rows),
        budget.caption(label.as_str())
    );
    let title = "Fig. 10A: transfer error of each reading";
    let heading = Heading::new(title, left.trials, "validation trials", label.as_str())
        .with_note(format!("{transfer}, scale {}", budget.scale.name()));
    let fig_10a = residuals(&heading, &left).map_err(StudyError::from)?;
    let title =
        "Fig. 10B: a trial of three contacts, and the maps of nets at three levels of noise";
    let heading = Heading::new(title, 1, "trials", label.as_str())
        .with_note(format!("Map {spec}, scale {}", budget.scale.name()));
    let fig_10b = pictures(&heading, &shown, shown.len()).map_err(StudyError::from)?;
    let numbers = json!({ "figure": "10", "scale": budget.scale.name(), "label": label,
        "transfer": transfer, "residuals": left, "truth": truth });
    let figures =
        vec![OutputFile::new("fig-10a.svg", fig_10a), OutputFile::new("fig-10b.svg", fig_10b)];
    Ok(Sheet::new("fig-10", text, numbers, figures))
}

/// Forces of the strongest contacts, N; contacts are sorted by force.
fn strongest(contacts: &[FoundContact]) -> String {
    let shown = contacts.iter().take(FORCES_SHOWN).filter_map(|c| c.force_n);
    let more = if contacts.len() > FORCES_SHOWN { ", .." } else { "" };
    shown.map(|n| format!("{n:.1}")).collect::<Vec<_>>().join(", ") + more
}

/// A test trial of three contacts.
async fn triple<L: Lab>(lab: &L, dataset: &str) -> Result<Trial, L::Error> {
    let trial = lab.first_trial(dataset, &SHOWN_TRIAL.map(str::to_owned)).await?;
    let none = || StudyError::NoTrial {
        dataset: dataset.into(),
        trial: "a test trial of three contacts".into(),
    };
    Ok(trial.ok_or_else(none)?)
}
