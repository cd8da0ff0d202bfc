//! The skin's unit responses for fast superposition: one row per point, in the order of removal.
//! Uses: `responses`, `network::lane`. Never: forces other than as a factor.
//!
//! A row is the compression at every node under one newton on a point, mm. Its blocks of sixteen
//! nodes with negligible values are skipped: the response decays within about ten tip widths.

use super::foam::BLOCK_NODES;
use crate::forward::ForwardModel;
use crate::network::lane::Lane32;

/// Responses below this are skipped, mm/N: the sum of 6 x 240 N of them is a hundredth of the
/// smallest compression that Eq. 1 distinguishes from zero.
const LEAST_RESPONSE_MM_PER_N: f64 = 1e-9;

/// Position of a point and its row.
#[derive(Debug)]
struct PointRow {
    place_mm: [f64; 2],
    blocks: Vec<u16>,
    /// mm/N, block after block.
    values: Vec<f32>,
}

/// The rows of all points, sorted by position.
#[derive(Debug)]
pub(super) struct PointRows(Vec<PointRow>);

impl PointRows {
    /// Builds the rows of a model's points; `order` is the order of removal.
    pub(super) fn new(model: &ForwardModel, order: &[u32]) -> Self {
        let points = model.sensor().points();
        let mut rows: Vec<PointRow> = points
            .iter()
            .enumerate()
            .map(|(point, p)| row(model, order, point, [p.x_mm, p.y_mm]))
            .collect();
        rows.sort_by(|a, b| compare(&a.place_mm, &b.place_mm));
        Self(rows)
    }

    /// Number of the row of the point at exactly this position.
    pub(super) fn find(&self, x_mm: f64, y_mm: f64) -> Option<usize> {
        self.0.binary_search_by(|row| compare(&row.place_mm, &[x_mm, y_mm])).ok()
    }

    /// Adds a force on a point to the compression (mm) of all nodes, and marks the blocks touched.
    #[inline(always)]
    pub(super) fn add<L: Lane32>(
        &self,
        row: usize,
        force_n: f64,
        compression_mm: &mut [[f32; BLOCK_NODES]],
        touched: &mut [bool],
    ) {
        let row = &self.0[row];
        let force = L::splat(force_n);
        for (&block, units) in row.blocks.iter().zip(row.values.chunks_exact(BLOCK_NODES)) {
            touched[usize::from(block)] = true;
            let sums = compression_mm[usize::from(block)].chunks_exact_mut(L::LANES);
            for (sum, units) in sums.zip(units.chunks_exact(L::LANES)) {
                L::load(units).mul_add(force, L::load(sum)).store(sum);
            }
        }
    }
}

fn compare(a: &[f64; 2], b: &[f64; 2]) -> std::cmp::Ordering {
    a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]))
}

fn row(model: &ForwardModel, order: &[u32], point: usize, place_mm: [f64; 2]) -> PointRow {
    let responses = model.responses();
    let mut sum = vec![0.0; responses.nodes()];
    for node in model.mesh().points[point].vertices {
        for (sum, &unit) in sum.iter_mut().zip(responses.row(node as usize)) {
            *sum += f64::from(unit) / 6.0;
        }
    }
    let mut found = PointRow { place_mm, blocks: Vec::new(), values: Vec::new() };
    for (block, nodes) in order.chunks(BLOCK_NODES).enumerate() {
        let unit = |&node: &u32| sum.get(node as usize).copied().unwrap_or(0.0);
        if nodes.iter().any(|node| unit(node).abs() >= LEAST_RESPONSE_MM_PER_N) {
            found.blocks.push(block as u16);
            found.values.extend(nodes.iter().map(|node| unit(node) as f32));
            found.values.resize(found.blocks.len() * BLOCK_NODES, 0.0);
        }
    }
    found
}
