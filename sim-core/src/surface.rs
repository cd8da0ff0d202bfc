//! Sinking of the skin's surface under a tip, the quantity that an indentation test measures.
//! Uses: `mesh`, `assemble`, `boundary`, `solve`. Never: measurements, foam compression alone.
//!
//! A tip on a point loads its six vertices equally (paper III-A). The tip's displacement is the
//! mean sinking of those six nodes of the skin's top face: top fabric, foam and bottom fabric
//! together.
//!
//! The stiffness is a sum over layers, `K = E_foam K_foam + E_fabric K_fabric`, so that the
//! derivative of the sinking by ln(E_foam) is one further solve with the same factor:
//! `K u' = -E_foam K_foam u`. The derivative by ln(E_fabric) is `-u - u'`, since u scales as 1/E if
//! all moduli scale together.

use faer::sparse::SparseColMat;

use crate::assemble;
use crate::boundary::FixedBottom;
use crate::mesh::{Mesh, MeshPlace};
use crate::responses::ResponsesError;
use crate::sensor::Sensor;
use crate::solve::Factor;

/// Number of points whose loads are solved together.
const BLOCK_POINTS: usize = 64;

/// Sinking of the top face, mm per N (> 0 is down), for a tip on each of some points.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceSinking {
    units: Vec<Unit>,
}

/// Response to one newton on one point.
#[derive(Debug, Clone, PartialEq)]
struct Unit {
    /// The nodes that the tip loads.
    loaded: [u32; 6],
    /// For every node of the top face: sinking, and its derivative by ln(foam modulus), mm per N.
    nodes: Vec<Sinking>,
}

/// Sinking of one position.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sinking {
    /// Sinking, mm per N, > 0 is down.
    pub mm_per_n: f64,
    /// Its derivative by the logarithm of the foam's modulus, mm per N.
    pub by_ln_foam: f64,
}

impl SurfaceSinking {
    /// Solves for tips on points, given by index; takes 1 s to 2 s, longer for hundreds of points.
    ///
    /// # Panics
    /// If an index is not one of the sensor's points.
    ///
    /// # Errors
    /// `ResponsesError` if the mesh does not fit the sensor or the elastic solve fails.
    pub fn solve(sensor: &Sensor, points: &[usize]) -> Result<Self, ResponsesError> {
        let mesh = Mesh::new(sensor)?;
        let boundary = FixedBottom::new(&mesh);
        let factor = Factor::new(&assemble::stiffness(&mesh, &boundary)?)?;
        let foam = assemble::stiffness(&foam_alone(&mesh), &boundary)?;
        let surface = mesh.levels() - 1;
        let up = |node: usize| {
            boundary.unknown(surface, node, 2).expect("the top face is above the fixed bottom")
        };
        let loaded: Vec<[u32; 6]> = points.iter().map(|&p| mesh.points[p].vertices).collect();
        let mut units = Vec::with_capacity(points.len());
        for tips in loaded.chunks(BLOCK_POINTS) {
            let columns = tips.len();
            let mut raised = vec![0.0; boundary.unknowns() * columns];
            for (column, vertices) in tips.iter().enumerate() {
                for &vertex in vertices {
                    raised[up(vertex as usize) * columns + column] = -1.0 / 6.0;
                }
            }
            factor.solve(&mut raised, columns)?;
            let mut derivative = minus_product(&foam, &raised, columns);
            factor.solve(&mut derivative, columns)?;
            units.extend(tips.iter().enumerate().map(|(column, &loaded)| {
                let sinking = |node| {
                    let at = up(node) * columns + column;
                    Sinking { mm_per_n: -raised[at], by_ln_foam: -derivative[at] }
                };
                Unit { loaded, nodes: (0..mesh.plane_nodes()).map(sinking).collect() }
            }));
        }
        Ok(Self { units })
    }

    /// Sinking of the tip on the n-th requested point: the mean of its six loaded nodes.
    pub fn of_tip(&self, n: usize) -> Sinking {
        let unit = &self.units[n];
        unit.mean(unit.loaded.map(|node| (node, 1.0 / 6.0)))
    }

    /// Sinking of a position of the top face under a tip on the n-th requested point.
    pub fn at(&self, n: usize, place: &MeshPlace) -> Sinking {
        self.units[n].mean(std::array::from_fn::<_, 3, _>(|k| (place.nodes[k], place.weights[k])))
    }
}

impl Unit {
    fn mean<const N: usize>(&self, weighted: [(u32, f64); N]) -> Sinking {
        weighted.iter().fold(Sinking::default(), |sum, &(node, weight)| {
            let s = self.nodes[node as usize];
            Sinking {
                mm_per_n: sum.mm_per_n + weight * s.mm_per_n,
                by_ln_foam: sum.by_ln_foam + weight * s.by_ln_foam,
            }
        })
    }
}

/// The mesh with fabrics of zero stiffness.
fn foam_alone(mesh: &Mesh) -> Mesh {
    let mut mesh = mesh.clone();
    let [bottom, top] = mesh.foam_levels;
    for (level, sheet) in mesh.sheets.iter_mut().enumerate() {
        if !(bottom..top).contains(&level) {
            sheet.youngs_mpa = 0.0;
        }
    }
    mesh
}

/// `-K x` for a symmetric K whose upper triangle is given; x row by row.
fn minus_product(upper: &SparseColMat<usize, f64>, x: &[f64], columns: usize) -> Vec<f64> {
    let mut out = vec![0.0; x.len()];
    let mut subtract = |row: usize, from: usize, value: f64| {
        let (out, x) = (&mut out[row * columns..], &x[from * columns..]);
        for (out, x) in out.iter_mut().zip(&x[..columns]) {
            *out -= value * x;
        }
    };
    for j in 0..upper.ncols() {
        for (i, &value) in upper.row_idx_of_col(j).zip(upper.val_of_col(j)) {
            subtract(i, j, value);
            if i != j {
                subtract(j, i, value);
            }
        }
    }
    out
}
