//! The reduction: removes all nodes except the electrodes and the top layer, without a subtraction.
//! Uses: `plan`, any `lane`. Never: a diagonal entry (it would lose the digits).
//!
//! Star-mesh transform (Grassmann-Taksar-Heyman): the top layer is one further node, and node k is
//! removed by `d = sum_i a_ik`, `l_i = a_ik / sqrt(d)`, `a_ij += l_i l_j`, where i and j run over
//! all remaining nodes. It is Cholesky with positive signs and a sum for a pivot: every entry keeps
//! nearly
//! its full relative precision, even in f32, though the condition number reaches 1e13 on an
//! untouched skin (`docs/references.md`, "Resistor network").
//!
//! Sums are linear in the columns, so the boundary of a front can be replaced by one row of its
//! sums while the pivots are computed; then each tile of the boundary is divided by them
//! separately, in the first-level cache; then the remainder is written tile by tile.

use super::TILE;
use super::lane::Lane;
use super::plan::{Front, ReductionPlan, packed, packed_entry};

/// Four rows of a column.
type Rows<L> = [L; TILE];
/// Four columns of four rows.
type Tile<L> = [Rows<L>; TILE];

/// Memory of a reduction.
pub(crate) struct ReduceWork<L> {
    /// The pivots' columns of the current front, by tiles.
    panel: Vec<Rows<L>>,
    /// `1 / sqrt(d)` of the current front's pivots.
    roots: Vec<Rows<L>>,
    /// Remainders that have not been added to their parents; parents and children alternate.
    stacks: [Vec<L>; 2],
}

impl<L> Default for ReduceWork<L> {
    fn default() -> Self {
        Self { panel: Vec::new(), roots: Vec::new(), stacks: [Vec::new(), Vec::new()] }
    }
}

/// Removes the nodes. `to_top`: conductance of each node to the top layer, S, >= 0, in the plan's
/// order, with the lanes of a node adjacent. The result is the electrodes' block with the top as
/// its last row: by columns, strictly below the diagonal.
#[inline(always)]
pub(crate) fn reduce<'w, L: Lane>(
    plan: &ReductionPlan,
    to_top: &[L::Number],
    work: &'w mut ReduceWork<L>,
) -> &'w [L] {
    let zero = L::splat(0.0);
    let ReduceWork { panel, roots, stacks } = work;
    for (stack, &size) in stacks.iter_mut().zip(&plan.stacks) {
        grow(stack, size, zero);
    }
    let [even, odd] = stacks;
    let mut heights = [0; 2];
    for front in &plan.fronts {
        let blocks = front.columns() / TILE;
        grow(panel, front.tiles() * front.columns(), [zero; TILE]);
        grow(roots, blocks, [zero; TILE]);
        let panel = &mut panel[..front.tiles() * front.columns()];
        let roots = &mut roots[..blocks];
        let (own, of_children) =
            if front.parity == 0 { (&mut *even, &*odd) } else { (&mut *odd, &*even) };
        let [own_height, below] = if front.parity == 0 { [0, 1] } else { [1, 0] };

        assemble(front, panel, to_top, &of_children[..heights[below]]);
        sum_boundary(front, panel);
        factor_pivots(front, panel, roots);
        divide_boundary(front, panel, roots);

        let start = heights[own_height];
        let remainder = &mut own[start..start + front.remainder()];
        write_remainder(front, panel, remainder);
        let mut end = heights[below];
        for child in &front.children {
            add(remainder, &child.remainder, &of_children[end - child.remainder.len()..end]);
            end -= child.len();
        }
        heights[below] = end;
        heights[own_height] += front.remainder();
    }
    let kept = plan.kept() + 1;
    let reduced = &mut even[..packed(kept)];
    for &(entry, conductance_s) in &plan.between_kept {
        let value = &mut reduced[entry as usize];
        *value = value.add(L::splat(conductance_s));
    }
    let electrodes = to_top[(plan.order().len() - plan.kept()) * L::LANES..].chunks_exact(L::LANES);
    for (electrode, to_top) in electrodes.take(plan.kept()).enumerate() {
        let value = &mut reduced[packed_entry(kept, kept - 1, electrode)];
        *value = value.add(L::load(to_top));
    }
    reduced
}

#[inline(always)]
fn grow<T: Copy>(values: &mut Vec<T>, size: usize, fill: T) {
    if values.len() < size {
        values.resize(size, fill);
    }
}

/// Fills a front's columns: resistors, foam, remainders of the children. The last child's remainder
/// is at the end of `remainders`.
#[inline(always)]
fn assemble<L: Lane>(front: &Front, panel: &mut [Rows<L>], to_top: &[L::Number], remainders: &[L]) {
    panel.fill([L::splat(0.0); TILE]);
    let entries = panel.as_flattened_mut();
    for &(entry, conductance_s) in &front.resistors {
        let value = &mut entries[entry as usize];
        *value = value.add(L::splat(conductance_s));
    }
    let top = front.boundary_row() + front.boundary - 1;
    let of_top = top / TILE * front.columns() * TILE + top % TILE;
    let to_top = to_top[front.first * L::LANES..].chunks_exact(L::LANES);
    for (pivot, to_top) in to_top.take(front.pivots).enumerate() {
        entries[of_top + pivot * TILE] = L::load(to_top);
    }
    let mut end = remainders.len();
    for child in &front.children {
        end -= child.len();
        add(entries, &child.pivots, &remainders[end..end + child.pivots.len()]);
    }
}

#[inline(always)]
fn add<L: Lane>(targets: &mut [L], places: &[u32], values: &[L]) {
    for (&place, &value) in places.iter().zip(values) {
        let target = &mut targets[place as usize];
        *target = target.add(value);
    }
}

/// Sums the boundary's rows into the row after the pivots.
#[inline(always)]
fn sum_boundary<L: Lane>(front: &Front, panel: &mut [Rows<L>]) {
    let (pivots, columns) = (front.pivots, front.columns());
    let (own, boundary) = panel.split_at_mut(front.boundary_row() / TILE * columns);
    for k in 0..pivots {
        let mut sum = L::splat(0.0);
        for tile in boundary.chunks_exact(columns) {
            sum = sum.add(sum_of(tile[k]));
        }
        own[pivots / TILE * columns + k][pivots % TILE] = sum;
    }
}

/// Divides the pivots' own rows, and the row of sums, by the pivots; fills `roots`.
///
/// Columns that only pad the last tile are zero and stay so.
#[inline(always)]
fn factor_pivots<L: Lane>(front: &Front, panel: &mut [Rows<L>], roots: &mut [Rows<L>]) {
    let columns = front.columns();
    let own = &mut panel[..front.boundary_row() / TILE * columns];
    for (block, roots) in roots.iter_mut().enumerate() {
        let start = block * TILE;
        let (block, below) = own[block * columns..].split_at_mut(columns);
        let (before, square) = block.split_at_mut(start);
        let square = first_tile(square);
        // Contributions of earlier pivots; the sums of the rows below the block.
        *square = accumulate(*square, before, before);
        let mut sums = [L::splat(0.0); TILE];
        for tile in below.chunks_exact_mut(columns) {
            let (left, tile) = tile.split_at_mut(start);
            let tile = first_tile(tile);
            *tile = accumulate(*tile, left, before);
            for (sum, rows) in sums.iter_mut().zip(tile) {
                *sum = sum.add(sum_of(*rows));
            }
        }
        *roots = factor_square(square, sums);
        for tile in below.chunks_exact_mut(columns) {
            let tile = first_tile(&mut tile[start..]);
            *tile = divide(*tile, square, roots);
        }
    }
}

/// Factors a tile on the diagonal, with one further row: the sums of all rows below. Returns
/// `1 / sqrt(d)`.
///
/// A pivot needs `1 / d` of the previous one; the roots are computed when all are known.
#[inline(always)]
#[expect(clippy::needless_range_loop, reason = "rows and columns of one square, by their numbers")]
fn factor_square<L: Lane>(square: &mut Tile<L>, mut sums: Rows<L>) -> Rows<L> {
    let mut roots = sums;
    for k in 0..TILE {
        let mut d = sums[k];
        for row in k + 1..TILE {
            d = d.add(square[k][row]);
        }
        let reciprocal = d.reciprocal();
        roots[k] = reciprocal;
        for column in k + 1..TILE {
            let factor = square[k][column].mul(reciprocal);
            sums[column] = sums[k].mul_add(factor, sums[column]);
            for row in column + 1..TILE {
                square[column][row] = square[k][row].mul_add(factor, square[column][row]);
            }
        }
    }
    for (column, root) in square.iter_mut().zip(&mut roots) {
        *root = root.sqrt();
        *column = scaled(*column, *root);
    }
    roots
}

/// Divides the boundary's rows by the pivots.
#[inline(always)]
fn divide_boundary<L: Lane>(front: &Front, panel: &mut [Rows<L>], roots: &[Rows<L>]) {
    let columns = front.columns();
    if columns == 0 {
        return;
    }
    let (own, boundary) = panel.split_at_mut(front.boundary_row() / TILE * columns);
    for tile in boundary.chunks_exact_mut(columns) {
        for ((block, roots), own) in roots.iter().enumerate().zip(own.chunks_exact(columns)) {
            let (left, tile) = tile.split_at_mut(block * TILE);
            let (before, square) = own.split_at(block * TILE);
            let tile = first_tile(tile);
            let sums = accumulate(*tile, left, before);
            *tile = divide(sums, square.first_chunk().expect(WHOLE), roots);
        }
    }
}

/// Writes `sum_k l_ik l_jk` between all boundary nodes.
#[inline(always)]
fn write_remainder<L: Lane>(front: &Front, panel: &[Rows<L>], remainder: &mut [L]) {
    let (rows, columns) = (front.boundary, front.columns());
    if columns == 0 {
        remainder.fill(L::splat(0.0));
        return;
    }
    let zero = [[L::splat(0.0); TILE]; TILE];
    let mut tiles = panel[front.boundary_row() / TILE * columns..].chunks_exact(columns);
    let mut rest = remainder;
    let mut below = rows;
    while let Some(right) = tiles.next() {
        let right = &right[..front.pivots];
        let diagonal = accumulate(zero, right, right);
        if below <= TILE {
            let corner = (0..below).flat_map(|c| (c + 1..below).map(move |r| (c, r)));
            for (value, (c, r)) in rest.iter_mut().zip(corner) {
                *value = diagonal[c][r];
            }
            return;
        }
        let (a, others) = rest.split_at_mut(below - 1);
        let (b, others) = others.split_at_mut(below - 2);
        let (c, others) = others.split_at_mut(below - 3);
        let (d, others) = others.split_at_mut(below - 4);
        a[..3].copy_from_slice(&diagonal[0][1..]);
        b[..2].copy_from_slice(&diagonal[1][2..]);
        c[..1].copy_from_slice(&diagonal[2][3..]);
        let targets = a[3..].chunks_mut(TILE).zip(b[2..].chunks_mut(TILE));
        let targets = targets.zip(c[1..].chunks_mut(TILE).zip(d.chunks_mut(TILE)));
        for (left, ((a, b), (c, d))) in tiles.clone().zip(targets) {
            let sums = accumulate(zero, left, right);
            for (target, sums) in [a, b, c, d].into_iter().zip(&sums) {
                if let Ok(target) = <&mut Rows<L>>::try_from(&mut *target) {
                    *target = *sums;
                } else {
                    target.copy_from_slice(&sums[..target.len()]);
                }
            }
        }
        rest = others;
        below -= TILE;
    }
}

const WHOLE: &str = "columns are padded to whole tiles";

#[inline(always)]
fn first_tile<L>(columns: &mut [Rows<L>]) -> &mut Tile<L> {
    columns.first_chunk_mut().expect(WHOLE)
}

#[inline(always)]
fn sum_of<L: Lane>([a, b, c, d]: Rows<L>) -> L {
    a.add(b).add(c.add(d))
}

/// `sums[c] + sum_k left[k] right[k][c]`: one tile, over all columns that both have.
#[inline(always)]
fn accumulate<L: Lane>(sums: Tile<L>, left: &[Rows<L>], right: &[Rows<L>]) -> Tile<L> {
    let [mut a, mut b, mut c, mut d] = sums;
    if L::COLUMNS_AT_ONCE == 4 {
        for (rows, factors) in left.iter().zip(right) {
            a = fused(rows, factors[0], a);
            b = fused(rows, factors[1], b);
            c = fused(rows, factors[2], c);
            d = fused(rows, factors[3], d);
        }
    } else {
        for (rows, factors) in left.iter().zip(right) {
            a = fused(rows, factors[0], a);
            b = fused(rows, factors[1], b);
        }
        for (rows, factors) in left.iter().zip(right) {
            c = fused(rows, factors[2], c);
            d = fused(rows, factors[3], d);
        }
    }
    [a, b, c, d]
}

#[inline(always)]
fn fused<L: Lane>(rows: &Rows<L>, factor: L, [a, b, c, d]: Rows<L>) -> Rows<L> {
    [
        rows[0].mul_add(factor, a),
        rows[1].mul_add(factor, b),
        rows[2].mul_add(factor, c),
        rows[3].mul_add(factor, d),
    ]
}

#[inline(always)]
fn scaled<L: Lane>([a, b, c, d]: Rows<L>, factor: L) -> Rows<L> {
    [a.mul(factor), b.mul(factor), c.mul(factor), d.mul(factor)]
}

/// Divides a tile by the pivots of a tile on the diagonal.
#[inline(always)]
fn divide<L: Lane>([a, b, c, d]: Tile<L>, square: &Tile<L>, roots: &Rows<L>) -> Tile<L> {
    let a = scaled(a, roots[0]);
    let b = scaled(fused(&a, square[0][1], b), roots[1]);
    let c = scaled(fused(&b, square[1][2], fused(&a, square[0][2], c)), roots[2]);
    let d = fused(&b, square[1][3], fused(&a, square[0][3], d));
    let d = scaled(fused(&c, square[2][3], d), roots[3]);
    [a, b, c, d]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::kron::{KronReduction, KronWork};
    use crate::network::{Resistor, SheetNetwork};

    /// A square patch with diagonals, all conductances different.
    fn patch(side: u32, electrodes: Vec<u32>) -> SheetNetwork {
        let mut resistors = Vec::new();
        for (y, x) in (0..side).flat_map(|y| (0..side).map(move |x| (y, x))) {
            let a = y * side + x;
            for (dx, dy) in [(1, 0), (0, 1), (1, 1)] {
                if x + dx < side && y + dy < side {
                    let b = a + dx + side * dy;
                    let conductance_s = 1e-5 * (1.0 + f64::from(a * 7 + b * 3).sin().powi(2));
                    resistors.push(Resistor { a, b, conductance_s });
                }
            }
        }
        let place = |at: u32| [f64::from(at % side), f64::from(at / side)];
        SheetNetwork { places_mm: (0..side * side).map(place).collect(), resistors, electrodes }
    }

    #[test]
    fn it_agrees_with_the_other_layout_of_the_same_method() {
        for (side, electrodes) in
            [(2, vec![0, 3]), (9, vec![3, 40, 41, 80]), (23, vec![0, 250, 528])]
        {
            let network = patch(side, electrodes);
            let to_top: Vec<f64> =
                (0..side * side).map(|i| 1e-9 * (1.5 + f64::from(i).cos())).collect();
            let mut work = KronWork::default();
            let expected = KronReduction::new(&network).reduce(&to_top, &mut work);
            let plan = ReductionPlan::new(&network);
            let ordered: Vec<f64> = plan.order().iter().map(|&n| to_top[n as usize]).collect();
            let mut work = ReduceWork::default();
            let found: &[f64] = reduce(&plan, &ordered, &mut work);
            let kept = plan.kept();
            for (column, row) in (0..kept).flat_map(|c| (c + 1..=kept).map(move |r| (c, r))) {
                let found = found[packed_entry(kept + 1, row, column)];
                let expected = expected[column * (kept + 1) + row];
                assert!((found / expected - 1.0).abs() < 1e-13, "{side}: {row}, {column}");
            }
        }
    }
}
