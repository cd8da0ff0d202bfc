//! The sensor, as pictures of the skin need it: size, electrodes, points of contact.
//! Uses: sim-core's sensor, `dataset::force_map`, `store`. Never: its conductivity or its circuit (the sensor file has them).

use axum::Json;
use serde::{Deserialize, Serialize};
use sim_core::sensor::Sensor;
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::problem::{ApiError, ApiResult, Params};
use super::runs::find;
use crate::dataset::force_map::SIDE_MM;

/// Selection of a sensor.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct SensorParams {
    /// The sensor of this run: uid or scan_id. Absent: the sensor under the rig.
    pub run: Option<String>,
}

/// A sensor in skin coordinates: x to the right along its width, y upwards along its height, mm.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct SensorOut {
    /// Name of the sensor.
    pub name: String,
    /// Width of the skin, mm.
    pub width_mm: f64,
    /// Height of the skin, mm.
    pub height_mm: f64,
    /// Corners of the skin in their order, mm; null for a rectangle of this width and height.
    pub outline_mm: Option<Vec<[f64; 2]>>,
    /// Electrodes in measuring order.
    pub electrodes: Vec<ElectrodeOut>,
    /// Points on which tips press, row by row, mm.
    pub points_mm: Vec<[f64; 2]>,
    /// Diameter of a tip, mm.
    pub tip_diameter_mm: f64,
    /// Thickness of the foam, mm: the largest depth of a simulated contact.
    pub foam_thickness_mm: f64,
    /// Side of the square that force maps cover, mm; its centre is the centre of the skin.
    pub force_map_mm: f64,
    /// Number of values of a frame.
    pub channels: usize,
    /// Number of injections of a frame.
    pub injections: usize,
}

/// Index and position of an electrode.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct ElectrodeOut {
    /// Index in measuring order, from 0.
    pub index: usize,
    /// x, skin coordinates, mm.
    pub x_mm: f64,
    /// y, skin coordinates, mm.
    pub y_mm: f64,
}

impl SensorOut {
    /// Describes a sensor.
    pub(super) fn of(sensor: &Sensor) -> Self {
        let electrodes = sensor.electrodes_mm();
        let electrode = |(index, [x_mm, y_mm]): (usize, &[f64; 2])| ElectrodeOut {
            index,
            x_mm: *x_mm,
            y_mm: *y_mm,
        };
        Self {
            name: sensor.file.name.clone(),
            width_mm: sensor.file.width_mm,
            height_mm: sensor.file.height_mm,
            // A sensor file describes rectangular skins only.
            outline_mm: None,
            electrodes: electrodes.iter().enumerate().map(electrode).collect(),
            points_mm: sensor.points().iter().map(|p| [p.x_mm, p.y_mm]).collect(),
            tip_diameter_mm: sensor.file.tip_diameter_mm,
            foam_thickness_mm: sensor.file.layers.foam.thickness_mm,
            force_map_mm: SIDE_MM,
            channels: sensor.channels(),
            injections: electrodes.len(),
        }
    }
}

/// Returns the sensor under the rig, or that of a run.
#[utoipa::path(get, operation_id = "sensor", path = "/api/v1/sensor", tag = "rig",
    params(SensorParams), responses((status = 200, body = SensorOut),
        (status = 404, description = "no run has this uid or scan_id, or its sensor has no file")))]
pub async fn sensor(app: App, Params(params): Params<SensorParams>) -> ApiResult<Json<SensorOut>> {
    Ok(Json(SensorOut::of(&sensor_of(&app, params.run.as_deref()).await?)))
}

/// The sensor of a run, named by its uid or scan_id; without one the sensor under the rig.
///
/// # Errors
/// 404 if no run has this name, or if its sensor has no readable file.
pub(super) async fn sensor_of(app: &App, run: Option<&str>) -> ApiResult<Sensor> {
    let Some(run) = run else { return Ok(app.serving.sensor().clone()) };
    let run = find(app, run).await?;
    Sensor::from_toml(&run.sensor).map_err(|error| {
        let words = format!("run {}: its sensor has no readable file: {error}", run.scan_id);
        ApiError::not_found(words)
    })
}
