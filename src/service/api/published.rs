//! Values that the paper prints, to be shown next to measured ones.
//! Uses: `evaluate::published`, `dataset::force_map`. Never: a measured value.

use axum::Json;
use serde::Serialize;
use utoipa::ToSchema;

use crate::dataset::force_map;
use crate::evaluate::published::{
    Published, REAL_HEX, REAL_RANDOM, REAL_UNSEEN, Rung, SIMULATION_FVU, TABLE_III, TABLE_IV,
};
use crate::store::RunKind;

/// Values that the paper prints.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PublishedValues {
    /// Table I: number of trials by number of contacts.
    pub table_i: Vec<PublishedTrials>,
    /// Table III: Transfer-Net, by the largest number of contacts that it learned.
    pub table_iii: Vec<Rung>,
    /// Table IV: Recon-Net alone, by map.
    pub table_iv: Vec<PublishedMap>,
    /// V-D: the whole pipeline on Real-Unseen, its best of 36.
    pub real_unseen: Published,
    /// Fig. 7F: median FVU of the simulation, read from the figure.
    pub simulation_fvu: f64,
}

/// Trials of a dataset of the paper.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct PublishedTrials {
    /// Kind of the campaign.
    pub kind: RunKind,
    /// Number of trials with 1 to 6 contacts.
    pub trials: [u64; 6],
}

/// Scores of a map.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PublishedMap {
    /// Pixel and diameter, mm, as `4x20`.
    pub map: String,
    /// Its scores.
    pub score: Published,
}

/// Returns values that the paper prints: Tables I, III and IV, Fig. 7F, V-D.
#[utoipa::path(get, operation_id = "published", path = "/api/v1/published", tag = "jobs",
    responses((status = 200, body = PublishedValues)))]
pub async fn published() -> Json<PublishedValues> {
    let maps = force_map::TABLE_IV_MAPS.iter().zip(TABLE_IV);
    Json(PublishedValues {
        table_i: vec![
            PublishedTrials { kind: RunKind::RealHex, trials: REAL_HEX },
            PublishedTrials { kind: RunKind::RealRandom, trials: REAL_RANDOM },
        ],
        table_iii: TABLE_III.to_vec(),
        table_iv: maps.map(|(map, score)| PublishedMap { map: map.to_string(), score }).collect(),
        real_unseen: REAL_UNSEEN,
        simulation_fvu: SIMULATION_FVU,
    })
}
