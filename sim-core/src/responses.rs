//! Unit responses: compression of the foam at every node under one newton on one node.
//! Uses: `mesh`, `assemble`, `boundary`, `solve`. Never: files (the cache is bytes).
//!
//! The skin is linear and its mesh fixed, so a load is a weighted sum of these rows. There is one
//! row for every node (3,503 of them), not one per point: a tip between points, at the rim or
//! tilted loads any of them. The cache's checksum is a CRC-32: a sha256 of 49 MB alone takes 0.2 s.

use crate::assemble;
use crate::boundary::FixedBottom;
use crate::digest::Digest;
use crate::mesh::{Mesh, MeshError};
use crate::sensor::Sensor;
use crate::solve::{Factor, SolveError};

/// Number of right-hand sides solved together.
const BLOCK_SIDES: usize = 64;
/// First bytes of a cache; the last digit is the layout's version.
const CACHE_MAGIC: &[u8; 8] = b"palp-ur2";

/// Why unit responses are not available.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ResponsesError {
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error(transparent)]
    Solve(#[from] SolveError),
    #[error("reading cached unit responses: {0}")]
    Damaged(Damage),
    /// A cache belongs to another sensor, mesh or element.
    #[error("reading cached unit responses: key {found}, this sensor needs {needed}")]
    OtherKey { found: String, needed: String },
}

/// Damage of a cache's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum Damage {
    #[error("not a cache of unit responses")]
    Magic,
    #[error("wrong length")]
    Length,
    #[error("wrong checksum")]
    Checksum,
}

/// The table: foam compression (mm per N, > 0 is compression) at every node, per loaded node.
#[derive(Debug, Clone, PartialEq)]
pub struct UnitResponses {
    key: [u8; 32],
    nodes: usize,
    rows: Vec<f32>,
}

impl UnitResponses {
    /// The digest of everything that the table depends on: lattice, layers, element and versions.
    pub fn key(sensor: &Sensor) -> [u8; 32] {
        let file = &sensor.file;
        let mut digest =
            Digest::new("unit responses 2; mesh rhombille 1; hex8 2x2x2 no B-bar; llt nd");
        digest.numbers([file.width_mm, file.height_mm, file.tip_diameter_mm]);
        digest.numbers(sensor.points().iter().flat_map(|p| [p.x_mm, p.y_mm]));
        for layer in [&file.layers.bottom, &file.layers.foam, &file.layers.top] {
            digest.numbers([layer.thickness_mm, layer.youngs_mpa, layer.poisson]);
            digest.count(layer.elements as usize);
        }
        digest.finish()
    }

    /// Solves for the table: seconds of work, on all cores; the result does not depend on their
    /// number.
    ///
    /// # Errors
    /// `ResponsesError::Mesh` if the mesh does not fit the sensor; `Solve` if the elastic solve
    /// fails.
    pub fn solve(sensor: &Sensor) -> Result<Self, ResponsesError> {
        let mesh = Mesh::new(sensor)?;
        let rows = solve_rows(&mesh)?;
        Ok(Self { key: Self::key(sensor), nodes: mesh.plane_nodes(), rows })
    }

    /// Number of rows, and of values in a row: the mesh's nodes.
    pub fn nodes(&self) -> usize {
        self.nodes
    }

    /// A row: foam compression at every node, mm per N on the surface at node `row`.
    pub fn row(&self, row: usize) -> &[f32] {
        &self.rows[row * self.nodes..][..self.nodes]
    }

    /// The key of the sensor of these responses.
    pub fn own_key(&self) -> &[u8; 32] {
        &self.key
    }

    /// Whether these are the responses of a sensor.
    pub fn fits(&self, sensor: &Sensor) -> bool {
        self.key == Self::key(sensor)
    }

    /// Returns the bytes of a cache: magic, key, nodes, rows, CRC-32 over everything before it.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(52 + 4 * self.rows.len());
        bytes.extend_from_slice(CACHE_MAGIC);
        bytes.extend_from_slice(&self.key);
        bytes.extend_from_slice(&(self.nodes as u64).to_le_bytes());
        for value in &self.rows {
            bytes.extend_from_slice(&value.to_le_bytes());
        }
        let checksum = crc32fast::hash(&bytes);
        bytes.extend_from_slice(&checksum.to_le_bytes());
        bytes
    }

    /// Reads the bytes of a cache for a sensor.
    ///
    /// # Errors
    /// `ResponsesError::Damaged` if the bytes are not an intact cache; `OtherKey` if they are
    /// another sensor's.
    pub fn from_bytes(bytes: &[u8], sensor: &Sensor) -> Result<Self, ResponsesError> {
        let damaged = ResponsesError::Damaged;
        let (content, sum) = bytes.split_last_chunk::<4>().ok_or(damaged(Damage::Length))?;
        let (magic, rest) = content.split_first_chunk::<8>().ok_or(damaged(Damage::Length))?;
        if magic != CACHE_MAGIC {
            return Err(damaged(Damage::Magic));
        }
        let (key, rest) = rest.split_first_chunk::<32>().ok_or(damaged(Damage::Length))?;
        let needed = Self::key(sensor);
        if *key != needed {
            return Err(ResponsesError::OtherKey {
                found: hex::encode(key),
                needed: hex::encode(needed),
            });
        }
        let (nodes, rows) = rest.split_first_chunk::<8>().ok_or(damaged(Damage::Length))?;
        let nodes = u64::from_le_bytes(*nodes) as usize;
        if nodes.checked_mul(nodes).and_then(|n| n.checked_mul(4)) != Some(rows.len()) {
            return Err(damaged(Damage::Length));
        }
        if crc32fast::hash(content) != u32::from_le_bytes(*sum) {
            return Err(damaged(Damage::Checksum));
        }
        let (words, _) = rows.as_chunks::<4>();
        Ok(Self { key: *key, nodes, rows: words.iter().map(|w| f32::from_le_bytes(*w)).collect() })
    }
}

/// A loaded node and its row of the table.
type Slot<'a> = (usize, &'a mut [f32]);

/// Solves one row per node; blocks of right-hand sides are distributed over threads.
fn solve_rows(mesh: &Mesh) -> Result<Vec<f32>, ResponsesError> {
    let boundary = FixedBottom::new(mesh);
    let factor = Factor::new(&assemble::stiffness(mesh, &boundary)?)?;
    let nodes = mesh.plane_nodes();
    let surface = mesh.levels() - 1;
    let mut rows = vec![0f32; nodes * nodes];
    // Loads that use the same parts of the factor are solved together.
    let mut slots: Vec<Slot<'_>> = rows.chunks_exact_mut(nodes).enumerate().collect();
    slots.sort_by_key(|(node, _)| boundary.unknown(surface, *node, 2));
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let mut shares: Vec<Vec<&mut [Slot<'_>]>> = (0..threads).map(|_| Vec::new()).collect();
    for (i, block) in slots.chunks_mut(BLOCK_SIDES).enumerate() {
        shares[i % threads].push(block);
    }
    std::thread::scope(|scope| {
        let workers: Vec<_> = shares
            .into_iter()
            .map(|share| scope.spawn(|| solve_share(mesh, &boundary, &factor, share)))
            .collect();
        workers
            .into_iter()
            .try_for_each(|w| w.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })?;
    Ok(rows)
}

fn solve_share(
    mesh: &Mesh,
    boundary: &FixedBottom,
    factor: &Factor,
    share: Vec<&mut [Slot<'_>]>,
) -> Result<(), SolveError> {
    let surface = mesh.levels() - 1;
    let [bottom, top] = mesh.foam_levels;
    let mut block = Vec::new();
    for slots in share {
        let columns = slots.len();
        block.clear();
        block.resize(boundary.unknowns() * columns, 0.0);
        for (column, (loaded, _)) in slots.iter().enumerate() {
            if let Some(unknown) = boundary.unknown(surface, *loaded, 2) {
                block[unknown * columns + column] = -1.0;
            }
        }
        factor.solve(&mut block, columns)?;
        let up = |level: usize, node: usize, column: usize| {
            let unknown = boundary.unknown(level, node, 2);
            unknown.map_or(0.0, |unknown| block[unknown * columns + column])
        };
        for node in 0..mesh.plane_nodes() {
            for (column, (_, row)) in slots.iter_mut().enumerate() {
                row[node] = (up(bottom, node, column) - up(top, node, column)) as f32;
            }
        }
    }
    Ok(())
}
