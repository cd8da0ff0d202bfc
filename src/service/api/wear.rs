//! The wear of the rig: presses on each place of the skin, travel of the axes, age of the calibrations
//! of the load cells, the last check.
//! Uses: `store`, the rig file. Never: an import, or a run on a skin of another name.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use axum::Json;
use jiff::civil::Date;
use jiff::{Timestamp, tz::TimeZone};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::problem::ApiResult;
use crate::ids::RunUid;
use crate::record::ARMS;
use crate::store::{RunKind, RunRow, StoreResult, StoredWear};

/// Names of the axes, in the order of the stored travel.
const AXES: [&str; 4] = ["x", "y", "z", "radius"];
/// Names of a check of the rig in the log of actions.
const CHECKS: [&str; 2] = ["rig_check", "rig_check_enable"];

/// Wear of the rig by all stored runs on this skin.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Wear {
    /// Time of the first trial; null without one.
    pub since: Option<Timestamp>,
    /// Number of stored trials.
    pub trials: u64,
    /// Number of runs with stored trials.
    pub runs: usize,
    /// Time of the runs that have ended, from begin to end with all waits, h.
    pub run_h: f64,
    /// Places on which tips or weights pressed.
    pub points: WornPoints,
    /// Travel of each axis.
    pub axes: Vec<WornAxis>,
    /// Calibrations of the load cells.
    pub cells: Vec<CellAge>,
    /// Time of the last check of the rig; null without one.
    pub checked_at: Option<Timestamp>,
}

/// Places on which tips or weights pressed, one entry of each list per place.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WornPoints {
    /// x, skin coordinates, mm, rounded to 0.01 mm.
    pub x_mm: Vec<f64>,
    /// y, skin coordinates, mm, rounded to 0.01 mm.
    pub y_mm: Vec<f64>,
    /// Number of configurations in which a tip or weight pressed there: a configuration presses once,
    /// deeper with each of its trials.
    pub presses: Vec<u64>,
}

/// Travel of an axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WornAxis {
    /// Axis: `x`, `y`, `z`, or `radius` (of the arms).
    pub axis: String,
    /// Sum of the distances between the poses of trials that were stored one after the other, m: a lower
    /// bound, since the travel in between, such as raising the tips, is not stored.
    pub travel_m: f64,
}

/// Calibration of a load cell.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct CellAge {
    /// Number of the arm, 1 to 6.
    pub arm: usize,
    /// Day of the calibration, from the rig file (`cells.calibrated_on`); null if it does not state it.
    pub calibrated_on: Option<Date>,
    /// Days since then; null if unknown.
    pub age_days: Option<i32>,
}

/// Wear by runs that have ended: it does not change.
#[derive(Debug, Default)]
pub struct EndedWear(Mutex<HashMap<RunUid, Arc<StoredWear>>>);

/// Returns the wear of the rig: presses per place, travel of the axes, age of the calibrations of the
/// cells, last check.
///
/// Runs on the skin under the rig (by the name of its sensor) with the label of the rig count. The
/// response may be a minute old.
#[utoipa::path(get, operation_id = "wear", path = "/api/v1/wear", tag = "rig",
    responses((status = 200, body = Wear)))]
pub async fn wear(app: App) -> ApiResult<Json<Arc<Wear>>> {
    let read = async { read(&app).await.map(Arc::new) };
    Ok(Json(app.facts.memory.wear.get((), read).await?))
}

async fn read(app: &App) -> StoreResult<Wear> {
    let (mut by_run, mut run_h) = (Vec::new(), 0.0);
    for run in app.store.all_runs().await?.iter().rev().filter(|run| is_of_this_skin(app, run)) {
        by_run.push(of_run(app, run).await?);
        if let (Some(begin), Some(end)) = (run.started_at, run.ended_at) {
            run_h += end.duration_since(begin).as_secs_f64() / 3600.0;
        }
    }
    let today = Timestamp::now().to_zoned(TimeZone::UTC).date();
    let bench = app.facts.rig.config.bench();
    let cells = bench.map_or_else(Vec::new, |bench| cells(bench.cells.calibrated_on, today));
    let checked_at = app.store.last_accepted(&CHECKS).await?;
    Ok(sum(&by_run, run_h, cells, checked_at))
}

/// Whether a run pressed the skin under the rig.
fn is_of_this_skin(app: &App, run: &RunRow) -> bool {
    /// The part of a sensor file that is compared.
    #[derive(Deserialize)]
    struct Named {
        name: String,
    }
    let name = toml::from_str::<Named>(&run.sensor).map(|sensor| sensor.name);
    run.kind != RunKind::Imported
        && run.label == app.facts.rig.config.label()
        && name.is_ok_and(|name| name == app.serving.sensor().file.name)
}

async fn of_run(app: &App, run: &RunRow) -> StoreResult<Arc<StoredWear>> {
    let ended = &app.facts.memory.ended_wear.0;
    if let Some(known) = ended.lock().get(&run.uid).cloned() {
        return Ok(known);
    }
    let wear = Arc::new(app.store.wear(run.uid).await?);
    if run.exit_status.is_some() && !run.is_resumable {
        ended.lock().insert(run.uid, wear.clone());
    }
    Ok(wear)
}

/// Calibrations of the cells, whose days are those of arms 1 to 6.
fn cells(calibrated_on: Option<[Date; ARMS]>, today: Date) -> Vec<CellAge> {
    let age = |arm: usize| {
        let day = calibrated_on.map(|days| days[arm]);
        let age_days = day.and_then(|day| Some(day.until(today).ok()?.get_days()));
        CellAge { arm: arm + 1, calibrated_on: day, age_days }
    };
    (0..ARMS).map(age).collect()
}

/// Adds the wear by several runs, which took `run_h`, h.
fn sum(
    by_run: &[Arc<StoredWear>],
    run_h: f64,
    cells: Vec<CellAge>,
    checked_at: Option<Timestamp>,
) -> Wear {
    let hundredths = |mm: f64| (mm * 100.0).round() as i64;
    let mut places: BTreeMap<(i64, i64), u64> = BTreeMap::new();
    let mut travel_mm = [0.0; AXES.len()];
    for wear in by_run {
        for point in &wear.points {
            let place = (hundredths(point.x_mm), hundredths(point.y_mm));
            *places.entry(place).or_default() += point.presses;
        }
        for (sum, travel) in travel_mm.iter_mut().zip(wear.travel_mm) {
            *sum += travel;
        }
    }
    let mut points = WornPoints::default();
    for ((x, y), presses) in places {
        points.x_mm.push(x as f64 / 100.0);
        points.y_mm.push(y as f64 / 100.0);
        points.presses.push(presses);
    }
    let axis = |(axis, mm): (&str, f64)| WornAxis { axis: axis.into(), travel_m: mm / 1e3 };
    Wear {
        since: by_run.iter().filter_map(|wear| wear.since).min(),
        trials: by_run.iter().map(|wear| wear.trials).sum(),
        runs: by_run.iter().filter(|wear| wear.trials > 0).count(),
        run_h,
        points,
        axes: AXES.into_iter().zip(travel_mm).map(axis).collect(),
        cells,
        checked_at,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::PressedPoint;

    #[test]
    fn wear_of_several_runs_adds_up_by_place() {
        let point = |x_mm, presses| PressedPoint { x_mm, y_mm: 55.0, presses };
        let at = |s| Timestamp::from_second(s).ok();
        let run = |since, points| {
            Arc::new(StoredWear { since, trials: 3, points, travel_mm: [500.0, 250.0, 4.0, 0.0] })
        };
        let none = Arc::new(StoredWear::default());
        let first = run(at(100), vec![point(17.320508, 2), point(34.64, 1)]);
        let second = run(at(50), vec![point(17.32, 5)]);
        let wear = sum(&[first, second, none], 1.5, Vec::new(), None);
        assert_eq!((wear.since, wear.trials, wear.runs), (at(50), 6, 2));
        assert_eq!(wear.points.x_mm, [17.32, 34.64]);
        assert_eq!(wear.points.presses, [7, 1]);
        let axes: Vec<_> = wear.axes.iter().map(|a| (a.axis.as_str(), a.travel_m)).collect();
        assert_eq!(axes, [("x", 1.0), ("y", 0.5), ("z", 0.008), ("radius", 0.0)]);
    }

    #[test]
    fn the_age_of_a_calibration_is_in_days() {
        let day = |text: &str| text.parse::<Date>().unwrap();
        let today = day("2026-06-03");
        assert_eq!(cells(Some([day("2026-05-04"); ARMS]), today)[5].age_days, Some(30));
        let unknown = cells(None, today);
        assert_eq!((unknown.len(), unknown[0].arm, unknown[0].age_days), (6, 1, None));
    }
}
