//! Zeros of the cells: read in the air before each configuration, with bounds.
//! Uses: `campaign::stage`. Never: storage.

use super::control::Control;
use super::halt::Halt;
use super::interlock::{self, TripKind};
use super::stage::Stage;
use crate::rig::config::ARMS;

/// Spread of a cell's readings in the air above which it is not tared, in its noise.
const NOISE_MULTIPLE: f64 = 10.0;

/// Averages `samples` fresh readings of the attached cells and makes them the zeros. `first` accepts
/// any zero; later ones may not have drifted by more than the rig's limit since the last.
pub async fn tare(
    stage: &mut Stage,
    control: &mut Control,
    samples: u32,
    first: bool,
) -> Result<Vec<(u8, f64)>, Halt> {
    let tips = usize::from(stage.tips);
    let mut readings: Vec<[f64; ARMS]> = Vec::with_capacity(samples as usize);
    for _ in 0..samples {
        // A module gives the same sample twice when it is read faster than it converts.
        stage.clock.sleep(stage.config.cells.update_ms / 1e3).await;
        control.attend().await?;
        readings.push(stage.bench.cells.read().await?.volts);
    }
    let cells = &stage.config.cells;
    let n = readings.len() as f64;
    let mut zeros = stage.tare_v;
    for i in 0..tips {
        let arm = i + 1;
        let mean = readings.iter().map(|r| r[i]).sum::<f64>() / n;
        let spread = readings.iter().map(|r| (r[i] - mean).abs()).fold(0.0, f64::max);
        let spread_n = spread * cells.newtons_per_volt();
        if !interlock::is_live(cells, mean) {
            let detail = format!("cell {arm} reads {mean:.3} V in the air: disconnected");
            return Err(Halt::trip(TripKind::Cell, detail));
        }
        if spread_n > NOISE_MULTIPLE * cells.force_noise_n {
            let limit = NOISE_MULTIPLE * cells.force_noise_n;
            return Err(Halt::Failed(format!(
                "cell {arm} moves by {spread_n:.2} N in the air, limit {limit:.2} N"
            )));
        }
        let moved_n = ((mean - stage.tare_v[i]) * cells.newtons_per_volt()).abs();
        let limit = stage.config.limits.tare_drift_n;
        if !first && moved_n > limit {
            let detail = format!(
                "zero of cell {arm} moved by {moved_n:.2} N since the last, limit {limit} N"
            );
            return Err(Halt::trip(TripKind::Cell, detail));
        }
        zeros[i] = mean;
    }
    stage.tare_v = zeros;
    Ok((0..tips).map(|i| (i as u8 + 1, zeros[i])).collect())
}
