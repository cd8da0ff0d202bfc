//! Rows of a dataset as a net's samples: a frame and its target.
//! Uses: `learn::examples`, `dataset::force_map`, nets' trait. Never: frames or maps in memory.

use nets::error::{SamplesError, SamplesResult};
use nets::samples::Samples;
use sim_core::forward;
use sim_core::stats::norm;

use crate::dataset::force_map::ForceMap;
use crate::learn::error::LearnError;
use crate::learn::examples::Examples;
use crate::learn::targets::Targets;
use crate::store::Contact;

/// Rows of a dataset as samples: of each row the first gathered column, and its target.
#[derive(Debug)]
pub struct RowSamples<'a> {
    /// Source of the frames.
    pub examples: &'a Examples,
    /// Indices of the rows, each with a target.
    pub rows: Vec<u32>,
    /// Target of a row.
    pub target: Target,
}

/// What a net answers of a row.
#[derive(Debug)]
pub enum Target {
    /// The second gathered column (Transfer-Net).
    Frame,
    /// Its contacts as a map (Recon-Net, end-to-end).
    Map {
        /// Renderer of the maps.
        draws: ForceMap,
        /// Force of a contact without a stated force, N: 1 if no contact has one, so that a map
        /// contains positions only.
        force_of_unknown_n: Option<f64>,
    },
    /// A quantity of its contacts, with the known places.
    Quantity(Targets),
}

/// Samples in memory: few, and read again after every epoch.
#[derive(Debug)]
pub struct Fixed {
    /// Lengths of an input and of a target.
    pub lens: [usize; 2],
    /// The inputs, one after the other.
    pub inputs: Vec<f32>,
    /// The targets, one after the other.
    pub targets: Vec<f32>,
}

impl Fixed {
    /// Reads the first epoch of other samples.
    ///
    /// # Errors
    /// `LearnError::Train` if a sample cannot be read.
    pub fn of(samples: &dyn Samples) -> Result<Self, LearnError> {
        let lens = [samples.input_len(), samples.target_len()];
        let count = samples.len();
        let [mut inputs, mut targets] = lens.map(|len| vec![0.0; len * count as usize]);
        let numbers: Vec<u64> = (0..count).collect();
        let read = samples.read(&numbers, &mut inputs, &mut targets);
        read.map_err(|error| LearnError::Train(error.into()))?;
        Ok(Self { lens, inputs, targets })
    }

    /// The largest Euclidean norm of an input.
    pub fn max_norm_v(&self) -> Option<f64> {
        self.inputs.chunks_exact(self.lens[0]).map(norm).reduce(f64::max)
    }
}

impl Samples for Fixed {
    fn len(&self) -> u64 {
        (self.inputs.len() / self.lens[0]) as u64
    }

    fn input_len(&self) -> usize {
        self.lens[0]
    }

    fn target_len(&self) -> usize {
        self.lens[1]
    }

    fn read(&self, samples: &[u64], inputs: &mut [f32], targets: &mut [f32]) -> SamplesResult<()> {
        for (out, from, len) in
            [(inputs, &self.inputs, self.lens[0]), (targets, &self.targets, self.lens[1])]
        {
            for (&sample, out) in samples.iter().zip(out.chunks_exact_mut(len)) {
                out.copy_from_slice(&from[sample as usize * len..][..len]);
            }
        }
        Ok(())
    }
}

/// Converts contacts to those of a map.
///
/// # Errors
/// A text if a contact has no position or no force; the caller adds the row.
fn drawn(
    contacts: &[Contact],
    force_of_unknown_n: Option<f64>,
) -> Result<Vec<forward::Contact>, &'static str> {
    let of = |c: &Contact| {
        let force_n = c.force_n.or(force_of_unknown_n).ok_or("a contact without a force")?;
        let x_mm = c.x_mm.ok_or("a contact without a position")?;
        let y_mm = c.y_mm.ok_or("a contact without a position")?;
        Ok(forward::Contact { x_mm, y_mm, force_n })
    };
    contacts.iter().map(of).collect()
}

fn failed(row: u32, error: impl std::fmt::Display) -> SamplesError {
    SamplesError::Source { message: format!("row {row}: {error}") }
}

impl RowSamples<'_> {
    /// Writes the target of a row into `out`.
    fn write_target(&self, row: u32, out: &mut [f32]) -> SamplesResult<()> {
        let contacts = self.examples.contacts(row);
        match &self.target {
            Target::Frame => {
                self.examples.frame(row, 1, out).map_err(|error| failed(row, error))?;
            }
            Target::Map { draws, force_of_unknown_n } => {
                out.fill(0.0);
                let contacts = drawn(contacts, *force_of_unknown_n);
                let contacts = contacts.map_err(|error| failed(row, error))?;
                draws.render(&contacts, out).map_err(|error| failed(row, error))?;
            }
            Target::Quantity(targets) => {
                let of_row = targets.of_row(contacts);
                let of_row = of_row.ok_or_else(|| failed(row, "contacts without this quantity"))?;
                out.copy_from_slice(&of_row);
            }
        }
        Ok(())
    }
}

impl Samples for RowSamples<'_> {
    fn len(&self) -> u64 {
        self.rows.len() as u64
    }

    fn input_len(&self) -> usize {
        self.examples.channels
    }

    fn target_len(&self) -> usize {
        match &self.target {
            Target::Frame => self.examples.channels,
            Target::Map { draws, .. } => draws.pixels() * draws.pixels(),
            Target::Quantity(targets) => targets.len(),
        }
    }

    fn read(&self, samples: &[u64], inputs: &mut [f32], targets: &mut [f32]) -> SamplesResult<()> {
        let frames = inputs.chunks_exact_mut(self.examples.channels);
        let frames = frames.zip(targets.chunks_exact_mut(self.target_len()));
        for (&sample, (input, target)) in samples.iter().zip(frames) {
            let row = self.rows[sample as usize];
            self.examples.frame(row, 0, input).map_err(|error| failed(row, error))?;
            self.write_target(row, target)?;
        }
        Ok(())
    }
}
