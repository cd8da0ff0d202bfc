//! Fig. 10: residuals of the Transfer-Net, and one trial's maps at three levels of noise.
//! Uses: `lab`, `evaluate::charts`. Never: training here.

use serde_json::{Value, json};

use super::lab::{Lab, Sheet};
use crate::api::{FrameAnswer, InferRequest, Wish};
use crate::cli::error::CliError;
use crate::dataset::force_map::ForceMapSpec;
use crate::evaluate::charts::{Picture, pictures, residuals};
use crate::evaluate::table::markdown;
use crate::infer::answer::FoundContact;
use crate::infer::methods::Method;
use crate::learn::residuals::Residuals;
use crate::store::Contact;

/// Diameter of the map of Fig. 10B (Map 1), mm.
const DIAMETER_MM: u32 = 20;
/// Largest number of forces in a cell of the table.
const FORCES_SHOWN: usize = 6;
/// Levels of noise (paper V-C1).
pub const LEVELS: [f64; 3] = [0.0, 0.1, 0.5];

/// Trains one Transfer-Net and three Recon-Nets, and reads one trial of three contacts.
///
/// # Errors
/// `CliError` if a training or an answer fails.
pub async fn noise(lab: Lab) -> Result<Sheet, CliError> {
    let transfer = lab.transfer_to_6().await?;
    let path = format!("/api/v1/models/{}/residuals", transfer.id);
    let left: Residuals = lab.client().get(&path).await?;
    let (frame, truth, label) = triple(&lab).await?;
    let map = format!("{}x{DIAMETER_MM}", lab.args.scale.fine_mm());
    let spec: ForceMapSpec =
        map.parse().map_err(|_| CliError::argument("map", &map, "must be pixel x diameter, mm"))?;
    let mut shown = vec![Picture::of_contacts("true", spec, &truth)?];
    let mut rows = Vec::new();
    for level in LEVELS {
        let net = lab.maps("recon-net", &map, Some((level, &transfer.id))).await?;
        let answer = read(&lab, &frame, &transfer.id, &net.id).await?;
        let contacts = &answer.reading.contacts;
        rows.push(vec![
            format!("{:.0} %", 100.0 * level),
            contacts.len().to_string(),
            strongest(contacts),
        ]);
        let map = answer.reading.force_map_n.unwrap_or_default();
        shown.push(Picture { name: format!("noise {:.0} %", 100.0 * level), spec, map });
    }
    let mean = left.mean_v.iter().map(|v| v.abs()).fold(0.0, f32::max);
    let sd = |pick: fn(f32, f32) -> f32, start| left.sd_v.iter().copied().fold(start, pick);
    let text = format!(
        "# Fig. 10: transfer error, and one trial of three contacts at three levels of noise, \
         map {map}\n\n\
         Residuals of {} on {} validation trials: standard deviation {:.4} to {:.4} V, largest \
         mean {mean:.4} V (paper: 0.05 to 0.5 V, mean close to zero).\n\n{}\n{}\n",
        transfer.id,
        left.trials,
        sd(f32::min, f32::MAX),
        sd(f32::max, 0.0),
        markdown(&["noise", "contacts found", "forces, N"], &rows),
        lab.scale_words(&label)
    );
    Ok(Sheet {
        name: "fig-10".into(),
        text,
        numbers: json!({ "figure": "10", "scale": lab.args.scale.name(), "label": label,
            "transfer": transfer.id, "residuals": left, "truth": truth }),
        pictures: vec![
            ("fig-10a.svg".into(), residuals(&left.mean_v, &left.sd_v)?),
            ("fig-10b.svg".into(), pictures("Fig. 10B", &shown, shown.len())?),
        ],
    })
}

/// Forces of the strongest contacts, N; contacts are sorted by force.
fn strongest(contacts: &[FoundContact]) -> String {
    let shown = contacts.iter().take(FORCES_SHOWN).filter_map(|c| c.force_n);
    let more = if contacts.len() > FORCES_SHOWN { ", .." } else { "" };
    shown.map(|n| format!("{n:.1}")).collect::<Vec<_>>().join(", ") + more
}

/// The frame and contacts of a test trial of three contacts.
async fn triple(lab: &Lab) -> Result<(Vec<f32>, Vec<Contact>, String), CliError> {
    let path = "/api/v1/datasets/r2s-transfer/rows?contact_count__eq=3&split__eq=test&\
                max_force_n__gte=15&columns=voltages_v,contacts,label&limit=1";
    let page: Value = lab.client().get(path).await?;
    let row = &page["rows"][0];
    let frame = serde_json::from_value(row["voltages_v"].clone());
    let frame = frame.map_err(|_| {
        CliError::argument("r2s-transfer", "none", "must have a test trial of three contacts")
    })?;
    let truth = serde_json::from_value(row["contacts"].clone()).unwrap_or_default();
    Ok((frame, truth, row["label"].as_str().unwrap_or_default().to_owned()))
}

/// Returns a frame's answer by a given Transfer-Net and Recon-Net.
///
/// # Errors
/// `CliError` if the service refuses.
pub async fn read(
    lab: &Lab,
    frame: &[f32],
    transfer: &str,
    map: &str,
) -> Result<FrameAnswer, CliError> {
    let wish = Wish {
        method: Method::Paper,
        model: Some(map.into()),
        transfer: Some(transfer.into()),
        map: true,
        averaged: 1.0,
    };
    let request = InferRequest { wish, frames: vec![frame.to_vec()] };
    let answers: Vec<FrameAnswer> = lab.client().post("/api/v1/infer", &request).await?;
    answers.into_iter().next().ok_or_else(|| CliError::argument("frame", "none", "no answer"))
}
