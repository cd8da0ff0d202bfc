//! The compression of the foam over the skin, on a grid that can be drawn.
//! PURE. Uses: sim-core, serde, utoipa. Never: the deformation of the other layers.

use serde::Serialize;
use sim_core::forward::ForwardModel;
use utoipa::ToSchema;

/// Distance of neighbouring places, mm: half of that of the mesh's nodes.
const PITCH_MM: f64 = 5.0;
/// Resolution of a value, 1/mm.
const PER_MM: f64 = 1000.0;

/// Compression of the foam on a grid over the skin.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct DentMap {
    /// Number of places along x.
    pub columns: usize,
    /// Number of places along y.
    pub rows: usize,
    /// Distance of neighbouring places, mm.
    pub pitch_mm: f64,
    /// Position of the first place along x, mm.
    pub x0_mm: f64,
    /// Position of the first place along y, mm.
    pub y0_mm: f64,
    /// Compression, mm, rounded to 0.001: `rows` times `columns` values, row by row from `y0_mm` on.
    pub values: Vec<f64>,
}

/// Samples the compression of the nodes, mm, on a grid: linear between three nodes, and as at the
/// outermost nodes where the mesh ends before the skin.
pub fn dent(model: &ForwardModel, compression_mm: &[f64]) -> DentMap {
    let file = &model.sensor().file;
    let places = |extent_mm: f64| (extent_mm / PITCH_MM).floor() as usize + 1;
    let (columns, rows) = (places(file.width_mm), places(file.height_mm));
    // Centred, if the extent is not a multiple of the pitch.
    let first = |extent_mm: f64, count: usize| 0.5 * (extent_mm - PITCH_MM * (count - 1) as f64);
    let (x0_mm, y0_mm) = (first(file.width_mm, columns), first(file.height_mm, rows));
    let value_mm = |column: usize, row: usize| {
        let at = [x0_mm + PITCH_MM * column as f64, y0_mm + PITCH_MM * row as f64];
        let corners = model.lattice().around(at);
        let (sum, weights) = corners.iter().flatten().fold((0.0, 0.0), |(sum, weights), corner| {
            let mm = compression_mm[corner.node as usize];
            (sum + corner.sixths * mm, weights + corner.sixths)
        });
        // Beyond the notches of the rim a weight is negative.
        let mm = if weights > 0.0 { (sum / weights).max(0.0) } else { 0.0 };
        (mm * PER_MM).round() / PER_MM
    };
    let grid = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
    let values = grid.map(|(column, row)| value_mm(column, row)).collect();
    DentMap { columns, rows, pitch_mm: PITCH_MM, x0_mm, y0_mm, values }
}

#[cfg(test)]
mod tests {
    use sim_core::forward::{Contact, Workspace};

    use super::*;
    use crate::calibrate::paper::MODEL;

    #[test]
    fn the_deepest_place_is_under_the_tip_and_the_values_are_those_of_the_nodes() {
        let mut work = Workspace::default();
        let tip = Contact { x_mm: 120.0, y_mm: 430.0, force_n: 20.0 };
        MODEL.voltages(&[tip], &mut work).unwrap();
        let grid = dent(&MODEL, work.compression_mm());
        assert_eq!((grid.columns, grid.rows, grid.x0_mm, grid.y0_mm), (109, 113, 0.0, 0.0));
        assert_eq!(grid.values.len(), 109 * 113);
        let (deepest, mm) =
            grid.values.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
        let x_mm = grid.pitch_mm * (deepest % grid.columns) as f64;
        let y_mm = grid.pitch_mm * (deepest / grid.columns) as f64;
        assert!((x_mm - tip.x_mm).hypot(y_mm - tip.y_mm) < 15.0, "({x_mm}, {y_mm})");
        let most = work.compression_mm().iter().copied().fold(0.0, f64::max);
        assert!(*mm > 0.5 * most && *mm <= most + 1e-3, "{mm} of {most}");
        assert_eq!(grid.values[0], 0.0);
    }
}
