//! `GET /api/v1/sensor/overlay.pdf`: the points of the skin at true scale, for printing.
//! Uses: `overlay`, `sensor`. Never: the rig.

use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::IntoParams;

use super::App;
use super::problem::{ApiResult, Params};
use super::sensor::sensor_of;
use crate::overlay::{self, Paper};

/// Paper of an overlay.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum PaperName {
    /// Sheets of A4 that overlap.
    #[default]
    A4,
    /// One sheet as large as the skin.
    Sheet,
}

impl From<PaperName> for Paper {
    fn from(name: PaperName) -> Self {
        match name {
            PaperName::A4 => Self::A4,
            PaperName::Sheet => Self::Sheet,
        }
    }
}

/// Options of an overlay.
#[derive(Debug, Clone, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct OverlayParams {
    /// Paper: `a4` (the default) or `sheet`.
    #[serde(default)]
    #[param(inline)]
    pub paper: PaperName,
    /// The run whose sensor is drawn: uid or scan_id. Absent: the sensor of this rig.
    pub run: Option<String>,
}

/// Returns the overlay of the skin as a PDF at true scale: its points with their names, its electrodes,
/// its outline, and rulers with which the print is checked.
#[utoipa::path(get, operation_id = "sensor_overlay", path = "/api/v1/sensor/overlay.pdf",
    tag = "rig", params(OverlayParams),
    responses((status = 200, body = Vec<u8>, content_type = "application/pdf"),
        (status = 404, description = "no run has this uid or scan_id, or its sensor has no file")))]
pub async fn overlay(app: App, Params(asked): Params<OverlayParams>) -> ApiResult<Response> {
    let sensor = sensor_of(&app, asked.run.as_deref()).await?;
    let pdf = overlay::pdf(&sensor, asked.paper.into());
    let headers = [
        (header::CONTENT_TYPE, "application/pdf"),
        (header::CONTENT_DISPOSITION, "inline; filename=\"overlay.pdf\""),
    ];
    Ok((headers, pdf).into_response())
}
