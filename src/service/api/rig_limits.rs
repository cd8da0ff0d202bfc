//! The limits of the rig, and the ranges of its axes, from its rig file.
//! Uses: `rig::config`. Never: a comparison with a sample (the campaign does that), a request to a device.

use axum::Json;
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use crate::rig::config::RigConfig;

/// Limits of the rig.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RigLimitsOut {
    /// Longest time without a frame, wall ms.
    pub frame_age_ms: u64,
    /// Limits of stage, indenter and load cells; null for a skin and its board alone.
    pub bench: Option<BenchLimits>,
}

/// Limits of stage, indenter and load cells.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct BenchLimits {
    /// Limit of the force on one cell, N.
    pub force_n: f64,
    /// Limit of the sum of forces, N.
    pub force_sum_n: f64,
    /// Allowed increase of the force between a sample and the stop that follows it, N.
    pub force_margin_n: f64,
    /// Allowed increase of the sum of forces in the same time, N.
    pub force_sum_margin_n: f64,
    /// Largest change of a cell's zero between two tares, and largest force below zero, N.
    pub tare_drift_n: f64,
    /// Longest time without a fresh sample of cells and positions while pressing, wall ms.
    pub sample_age_ms: u64,
    /// Range of x, machine coordinates, mm.
    pub x_mm: [f64; 2],
    /// Range of y, machine coordinates, mm.
    pub y_mm: [f64; 2],
    /// Range of z, machine coordinates, positive downward, mm.
    pub z_mm: [f64; 2],
    /// Range of the radius of the arms, mm.
    pub radius_mm: [f64; 2],
    /// Range of z in which the touch-off must find the surface, mm.
    pub surface_z_mm: [f64; 2],
    /// Clearance to the surface in lateral and radial motion, mm.
    pub clearance_mm: f64,
}

impl From<&RigConfig> for BenchLimits {
    fn from(config: &RigConfig) -> Self {
        let RigConfig { axes, slot, skin, limits, .. } = config;
        Self {
            force_n: limits.force_n,
            force_sum_n: limits.force_sum_n,
            force_margin_n: limits.force_margin_n,
            force_sum_margin_n: limits.sum_margin_n(),
            tare_drift_n: limits.tare_drift_n,
            sample_age_ms: config.sample_age_ms(),
            x_mm: axes.x.travel_mm,
            y_mm: axes.y.travel_mm,
            z_mm: axes.z.travel_mm,
            radius_mm: slot.radius_mm,
            surface_z_mm: skin.surface_z_mm,
            clearance_mm: skin.clearance_mm,
        }
    }
}

/// Returns the limits that trip the rig, and the ranges of its axes, as its rig file states them.
#[utoipa::path(get, operation_id = "rig_limits", path = "/api/v1/rig/limits", tag = "rig",
    responses((status = 200, body = RigLimitsOut)))]
pub async fn limits(app: App) -> Json<RigLimitsOut> {
    let rig = &app.facts.rig.config;
    let bench = rig.bench().map(BenchLimits::from);
    Json(RigLimitsOut { frame_age_ms: rig.frame_age_ms(), bench })
}
