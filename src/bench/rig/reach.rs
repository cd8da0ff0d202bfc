//! Properties of a rig file that a plan needs: reach, force limits, speeds.
//! PURE. Uses: `schedule::{reach, estimate}`, `rig::{config, setup}`. Never: devices.

use super::config::{LinearAxis, RigConfig};
use super::setup::RigSetup;
use crate::schedule::estimate::{Bench, Motion, StageTimes};
use crate::schedule::reach::{Reach, StageReach};

/// Reach and limits of a rig; `file` is its name in problems.
pub fn reach(file: &str, rig: &RigSetup) -> Reach {
    let stage = rig.bench().map(stage_reach);
    Reach { file: file.into(), electrodes: rig.ert().electrodes().into(), stage }
}

fn stage_reach(rig: &RigConfig) -> StageReach {
    StageReach {
        x_travel_mm: rig.axes.x.travel_mm,
        y_travel_mm: rig.axes.y.travel_mm,
        z_travel_mm: rig.axes.z.travel_mm,
        radius_mm: rig.slot.radius_mm,
        backlash_mm: rig.slot.backlash_mm,
        skin_origin_mm: [rig.skin.origin_x_mm, rig.skin.origin_y_mm],
        surface_z_mm: rig.skin.surface_z_mm,
        clearance_mm: rig.skin.clearance_mm,
        force_n: rig.limits.force_n,
        force_sum_n: rig.limits.force_sum_n,
        cell_update_ms: rig.cells.update_ms,
    }
}

/// Properties that determine the duration of a plan.
pub fn bench(rig: &RigSetup) -> Bench {
    Bench {
        stage: rig.bench().map(stage_times),
        frame_rate_hz: rig.ert().frame_rate_hz(),
        clock_rate: rig.clock_rate(),
    }
}

fn stage_times(rig: &RigConfig) -> StageTimes {
    let linear = |axis: &LinearAxis| Motion {
        speed_mm_s: axis.speed_mm_s,
        acceleration_mm_s2: axis.acceleration_mm_s2,
    };
    let per_deg = rig.slot.mm_per_deg.abs();
    StageTimes {
        x: linear(&rig.axes.x),
        y: linear(&rig.axes.y),
        z: linear(&rig.axes.z),
        radial: Motion {
            speed_mm_s: rig.axes.radial.speed_deg_s * per_deg,
            acceleration_mm_s2: rig.axes.radial.acceleration_deg_s2 * per_deg,
        },
        approach_mm_s: rig.approach_speed_mm_s(),
        clearance_mm: rig.skin.clearance_mm,
        surface_z_mm: rig.skin.surface_z_mm,
        backlash_mm: rig.slot.backlash_mm,
        cell_update_ms: rig.cells.update_ms,
        z_watchdog_ms: rig.axes.z.guard.watchdog_ms,
    }
}
