//! Moduli fitted to single-point indentations: force on a tip, and sinking of the skin's surface.
//! PURE. Uses: `table`, `regression`, sim-core's surface. Never: the foam's compression instead.
//!
//! Columns: `point` (index) or `x_mm, y_mm` (within 0.5 mm of a point); `force_n`;
//! `displacement_mm`, counted from the first contact, down is positive: of the tip (mean of the six
//! nodes that it loads), or, with `gauge_x_mm, gauge_y_mm`, of the skin's surface at that position.
//! Cells of `gauge_*` may be empty: the tip's displacement.
//!
//! The tip alone determines one number, N/mm: a soft foam and a soft fabric cannot be
//! distinguished. Gauges next to the tip can distinguish them, since a stiff fabric spreads the
//! dent. Unknowns are ln(foam modulus) and, if the data determine it, ln(factor on both fabrics'
//! moduli). Errors of displacement are assumed to be equal in mm (a gauge's resolution, the skin's
//! unevenness), as in the paper's RMSE.

use std::collections::BTreeSet;

use sim_core::calibration::{FoamCalibration, mesh_id};
use sim_core::forward::POINT_TOLERANCE_MM;
use sim_core::mesh::{Mesh, MeshError, MeshPlace};
use sim_core::responses::ResponsesError;
use sim_core::sensor::{Sensor, SensorFile};
use sim_core::surface::SurfaceSinking;

use super::regression::{self, Prediction, Regression, RegressionError};
use super::table::{self, Column, Row};
use super::{CalibrateError, accuracy};
use crate::digest::sha256_hex;
use crate::problem::Problem;
use crate::record::Label;

const MOST_MM: f64 = 1e4;
const FOAM_COLUMNS: [Column; 7] = [
    Column::number("point", [0.0, 1e9], "must be the index of a point"),
    Column::number("x_mm", [0.0, MOST_MM], "must be a number >= 0"),
    Column::number("y_mm", [0.0, MOST_MM], "must be a number >= 0"),
    Column::number(
        "force_n",
        [f64::MIN_POSITIVE, 1000.0],
        "must be a number above 0, at most 1000",
    ),
    Column::number("displacement_mm", [-100.0, 100.0], "must be a number from -100 to 100"),
    Column::number("gauge_x_mm", [0.0, MOST_MM], "must be a number >= 0, or empty").or_empty(),
    Column::number("gauge_y_mm", [0.0, MOST_MM], "must be a number >= 0, or empty").or_empty(),
];

/// The fabric counts as identified if its 95 % interval is within this factor either way ...
const IDENTIFIED_WITHIN: f64 = 2.0;
/// ... and its derivative differs from the foam's by at least this squared sine: points of the mesh
/// differ by 1e-5, which does not measure a fabric.
const IDENTIFIED_APART: f64 = 1e-4;

/// A row of an indentation test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Indentation {
    /// Index of the point under the tip.
    pub point: usize,
    /// Force on the tip, N.
    pub force_n: f64,
    /// Measured displacement, mm, down is positive.
    pub displacement_mm: f64,
    /// Position of the gauge, mm; `None` is the tip itself.
    pub gauge_mm: Option<[f64; 2]>,
}

/// Moduli fitted to indentations.
#[derive(Debug, Clone, PartialEq)]
pub struct FoamFit {
    /// Result for the calibration file.
    pub calibration: FoamCalibration,
    /// Origin of the table.
    pub label: Label,
    /// The measurements, each with the fitted displacement.
    pub rows: Vec<FittedRow>,
    /// Standard deviation of the residuals, mm.
    pub residual_sd_mm: f64,
    /// Half-width of a 95 % interval in standard deviations.
    pub t_95: f64,
}

/// A measurement with the fitted value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedRow {
    /// Row of the table.
    pub measured: Indentation,
    /// Distance of the gauge from the tip's centre, mm; `None` is the tip itself.
    pub distance_mm: Option<f64>,
    /// Displacement of the fitted model, mm.
    pub fitted_mm: f64,
    /// Standard deviation of the fitted displacement due to that of the moduli, mm.
    pub fitted_sd_mm: f64,
}

/// Reads indentations and fits the moduli to them; takes some seconds. `tell` is called before each trial solution of the
/// skin, with its number from 1.
///
/// # Errors
/// `CalibrateError` if a cell is invalid, the data do not determine the moduli, or the solve fails.
pub fn calibrate(
    file: &str,
    text: &str,
    sensor: &Sensor,
    tell: &mut dyn FnMut(usize),
) -> Result<FoamFit, CalibrateError> {
    let rows = read(file, text, sensor)?;
    let skin = Skin::new(sensor, &rows)?;
    let observed: Vec<f64> = rows.iter().map(|r| r.displacement_mm).collect();
    let failed = |error: RegressionError<CalibrateError>| match error {
        RegressionError::Model(error) => error,
        other => CalibrateError::undetermined(file, other),
    };
    let mut solutions = 0;
    let mut sinking = |ln: [f64; 2]| {
        solutions += 1;
        tell(solutions);
        skin.sinking(ln)
    };
    let start = sensor.file.layers.foam.youngs_mpa.ln();
    let alone = regression::fit(&observed, [start], |&[foam]| {
        sinking([foam, 0.0]).map(|p| one_unknown(&p))
    })
    .map_err(failed)?;
    let at = [alone.parameters[0], 0.0];
    let both = if fabric_is_identified(&sinking(at)?, &alone) {
        Some(regression::fit(&observed, at, |ln| sinking(*ln)).map_err(failed)?)
    } else {
        None
    };
    // Identified both at the start value of the fabric and at the fitted one.
    let both = both.filter(|r| interval_is_narrow(r.covariance[1][1], r.t_95()));
    match both {
        Some(r) => finish(file, text, sensor, &rows, &r, Some(1)),
        None => finish(file, text, sensor, &rows, &alone, None),
    }
}

fn one_unknown(both: &Prediction<2>) -> Prediction<1> {
    let slopes = both.slopes.iter().map(|s| [s[0]]).collect();
    Prediction { values: both.values.clone(), slopes }
}

/// Whether the data determine the fabric: the accuracy of two unknowns, with the residuals of one.
fn fabric_is_identified(at: &Prediction<2>, alone: &Regression<1>) -> bool {
    let sum = |i: usize, j: usize| at.slopes.iter().map(|s| s[i] * s[j]).sum::<f64>();
    let (foam, fabric, mixed) = (sum(0, 0), sum(1, 1), sum(0, 1));
    let apart = 1.0 - mixed * mixed / (foam * fabric);
    let variance = alone.residual_sd.powi(2) / (fabric * apart);
    // Written so that a value that is not a number is not identified.
    apart > IDENTIFIED_APART && interval_is_narrow(variance, alone.t_95())
}

fn interval_is_narrow(variance_ln: f64, t_95: f64) -> bool {
    t_95 * variance_ln.sqrt() < IDENTIFIED_WITHIN.ln()
}

fn finish<const P: usize>(
    file: &str,
    text: &str,
    sensor: &Sensor,
    rows: &[Indentation],
    r: &Regression<P>,
    fabric: Option<usize>,
) -> Result<FoamFit, CalibrateError> {
    let fabric_factor = fabric.map(|parameter| r.exponential(parameter));
    let factor = fabric_factor.map_or(1.0, |f| f.value);
    let fitted: Vec<FittedRow> = rows
        .iter()
        .zip(&r.residuals)
        .zip(&r.slopes)
        .map(|((&measured, residual), slope)| FittedRow {
            measured,
            distance_mm: measured.gauge_mm.map(|[x, y]| {
                let p = sensor.points()[measured.point];
                (p.x_mm - x).hypot(p.y_mm - y)
            }),
            fitted_mm: measured.displacement_mm - residual,
            fitted_sd_mm: r.prediction_sd(slope),
        })
        .collect();
    let measured: Vec<f64> = fitted.iter().map(|row| row.measured.displacement_mm).collect();
    let modelled: Vec<f64> = fitted.iter().map(|row| row.fitted_mm).collect();
    let alike = || CalibrateError::undetermined(file, "all displacements are the same");
    let layers = &sensor.file.layers;
    let calibration = FoamCalibration {
        data_sha256: sha256_hex(text),
        rows: rows.len(),
        mesh: mesh_id(sensor)?,
        force_n: rows.iter().map(|row| row.force_n).fold(0.0, f64::max),
        bottom_mpa: factor * layers.bottom.youngs_mpa,
        top_mpa: factor * layers.top.youngs_mpa,
        foam_mpa: r.exponential(0),
        fabric_factor,
        displacement: accuracy(&measured, &modelled).ok_or_else(alike)?,
    };
    let (residual_sd_mm, t_95) = (r.residual_sd, r.t_95());
    Ok(FoamFit { calibration, label: table::label(text), rows: fitted, residual_sd_mm, t_95 })
}

/// The skin under the rows' loads, at any moduli.
struct Skin<'a> {
    file: &'a SensorFile,
    /// Loaded points, ascending.
    points: Vec<usize>,
    loads: Vec<Load>,
}

/// A row in terms of the solver.
struct Load {
    /// Index into the skin's points.
    at: usize,
    force_n: f64,
    gauge: Option<MeshPlace>,
}

impl<'a> Skin<'a> {
    fn new(sensor: &'a Sensor, rows: &[Indentation]) -> Result<Self, CalibrateError> {
        let unmeshed = |e: MeshError| CalibrateError::Surface(ResponsesError::Mesh(e));
        let mesh = Mesh::new(sensor).map_err(unmeshed)?;
        let points: Vec<usize> =
            rows.iter().map(|r| r.point).collect::<BTreeSet<_>>().into_iter().collect();
        let loads = rows
            .iter()
            .map(|r| Load {
                at: points.partition_point(|&p| p < r.point),
                force_n: r.force_n,
                gauge: r.gauge_mm.map(|at_mm| mesh.locate(at_mm)),
            })
            .collect();
        Ok(Self { file: &sensor.file, points, loads })
    }

    /// Displacements at ln(foam modulus, MPa) and ln(factor on the fabrics), and their derivatives.
    fn sinking(&self, [foam, fabric]: [f64; 2]) -> Result<Prediction<2>, CalibrateError> {
        let mut file = self.file.clone();
        file.layers.foam.youngs_mpa = foam.exp();
        file.layers.bottom.youngs_mpa *= fabric.exp();
        file.layers.top.youngs_mpa *= fabric.exp();
        let surface = SurfaceSinking::solve(&Sensor::new(file)?, &self.points)?;
        let row = |load: &Load| {
            let s = match &load.gauge {
                None => surface.of_tip(load.at),
                Some(place) => surface.at(load.at, place),
            };
            let slopes = [s.by_ln_foam, -s.mm_per_n - s.by_ln_foam];
            (load.force_n * s.mm_per_n, slopes.map(|slope| load.force_n * slope))
        };
        let (values, slopes) = self.loads.iter().map(row).unzip();
        Ok(Prediction { values, slopes })
    }
}

fn read(file: &str, text: &str, sensor: &Sensor) -> Result<Vec<Indentation>, CalibrateError> {
    let rows = table::read(file, text, &FOAM_COLUMNS).map_err(CalibrateError::Measurements)?;
    let (mut out, mut problems) = (Vec::with_capacity(rows.len()), Vec::new());
    for row in &rows {
        match indentation(file, row, sensor) {
            Ok(indentation) => out.push(indentation),
            Err(problem) => problems.push(problem),
        }
    }
    if problems.is_empty() { Ok(out) } else { Err(CalibrateError::Measurements(problems)) }
}

fn indentation(file: &str, row: &Row, sensor: &Sensor) -> Result<Indentation, Problem> {
    let header = |limit: &str| Problem::whole(file, format!("the header {limit}"));
    let [point, x, y, force, displacement, gauge_x, gauge_y] = row.values[..] else {
        return Err(header("must have the requested columns"));
    };
    let (Some(force_n), Some(displacement_mm)) = (force, displacement) else {
        return Err(header("needs force_n and displacement_mm"));
    };
    let points = sensor.points();
    let point = match (point, x, y) {
        (Some(point), None, None) => Some(point as usize)
            .filter(|&p| p as f64 == point && p < points.len())
            .ok_or_else(|| {
                let limit = format!("must be a whole number from 0 to {}", points.len() - 1);
                row.problem(file, "point", point, &limit)
            })?,
        (None, Some(x), Some(y)) => {
            sensor.point_near([x, y], POINT_TOLERANCE_MM).ok_or_else(|| {
                let limit =
                    format!("must be within {POINT_TOLERANCE_MM} mm of a point of the sensor");
                row.problem(file, "x_mm, y_mm", format!("{x}, {y}"), &limit)
            })?
        }
        _ => return Err(header("needs either point, or x_mm and y_mm")),
    };
    let gauge_mm = match (gauge_x, gauge_y) {
        (None, None) => None,
        (Some(x), Some(y)) if x <= sensor.file.width_mm && y <= sensor.file.height_mm => {
            Some([x, y])
        }
        (Some(x), Some(y)) => {
            let limit = "must be on the skin";
            return Err(row.problem(file, "gauge_x_mm, gauge_y_mm", format!("{x}, {y}"), limit));
        }
        (x, y) => {
            let found = [x, y].map(|v| v.map_or("empty".into(), |v| v.to_string())).join(", ");
            let limit = "needs both, or neither";
            return Err(row.problem(file, "gauge_x_mm, gauge_y_mm", found, limit));
        }
    };
    Ok(Indentation { point, force_n, displacement_mm, gauge_mm })
}
