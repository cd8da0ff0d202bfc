//! Rows of a dataset as a net's samples: a frame and its target.
//! Uses: `learn::examples`, `dataset::force_map`, nets' trait. Never: frames or maps in memory.

use nets::error::SamplesError;
use nets::samples::Samples;

use crate::dataset::force_map::{ForceMap, MapContact};
use crate::learn::error::LearnError;
use crate::learn::examples::Examples;
use crate::learn::targets::Targets;
use crate::store::Contact;

/// Frames to frames (Transfer-Net): of each row the first gathered column, and the second.
#[derive(Debug)]
pub struct FramePairs<'a> {
    /// Source of the frames.
    pub examples: &'a Examples,
    /// Indices of the rows.
    pub rows: Vec<u32>,
}

/// Frames to force maps (Recon-Net, end-to-end): of each row the first gathered column, and its
/// contacts as a map.
#[derive(Debug)]
pub struct FramesAndMaps<'a> {
    /// Source of the frames.
    pub examples: &'a Examples,
    /// Indices of the rows.
    pub rows: Vec<u32>,
    /// Renderer of the maps.
    pub draws: ForceMap,
    /// Force of a contact without a stated force, N: 1 if no contact has one, so that a map
    /// contains positions only.
    pub force_of_unknown_n: Option<f64>,
}

/// Frames to a quantity: of each row the first gathered column, and the quantity of its contacts.
#[derive(Debug)]
pub struct FramesAndTargets<'a> {
    /// Source of the frames.
    pub examples: &'a Examples,
    /// Indices of the rows, each with a target.
    pub rows: Vec<u32>,
    /// Quantity that the net estimates, with the known places.
    pub targets: Targets,
}

/// Samples in memory: few, and read again after every epoch.
#[derive(Debug)]
pub struct Fixed {
    lens: [usize; 2],
    inputs: Vec<f32>,
    targets: Vec<f32>,
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
        let norm = |input: &[f32]| input.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>().sqrt();
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

    fn read(
        &self,
        samples: &[u64],
        inputs: &mut [f32],
        targets: &mut [f32],
    ) -> Result<(), SamplesError> {
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
pub fn drawn(
    contacts: &[Contact],
    force_of_unknown_n: Option<f64>,
) -> Result<Vec<MapContact>, &'static str> {
    let of = |c: &Contact| {
        let force_n = c.force_n.or(force_of_unknown_n).ok_or("a contact without a force")?;
        let x_mm = c.x_mm.ok_or("a contact without a position")?;
        let y_mm = c.y_mm.ok_or("a contact without a position")?;
        Ok(MapContact { x_mm, y_mm, force_n })
    };
    contacts.iter().map(of).collect()
}

fn failed(row: u32, error: impl std::fmt::Display) -> SamplesError {
    SamplesError::Source { message: format!("row {row}: {error}") }
}

impl Samples for FramePairs<'_> {
    fn len(&self) -> u64 {
        self.rows.len() as u64
    }

    fn input_len(&self) -> usize {
        self.examples.channels
    }

    fn target_len(&self) -> usize {
        self.examples.channels
    }

    fn read(
        &self,
        samples: &[u64],
        inputs: &mut [f32],
        targets: &mut [f32],
    ) -> Result<(), SamplesError> {
        let channels = self.examples.channels;
        let frames = inputs.chunks_exact_mut(channels).zip(targets.chunks_exact_mut(channels));
        for (&sample, (input, target)) in samples.iter().zip(frames) {
            let row = self.rows[sample as usize];
            let failed = |error: LearnError| failed(row, error);
            self.examples.frame(row, 0, input).map_err(failed)?;
            self.examples.frame(row, 1, target).map_err(failed)?;
        }
        Ok(())
    }
}

impl Samples for FramesAndMaps<'_> {
    fn len(&self) -> u64 {
        self.rows.len() as u64
    }

    fn input_len(&self) -> usize {
        self.examples.channels
    }

    fn target_len(&self) -> usize {
        self.draws.pixels() * self.draws.pixels()
    }

    fn read(
        &self,
        samples: &[u64],
        inputs: &mut [f32],
        targets: &mut [f32],
    ) -> Result<(), SamplesError> {
        targets.fill(0.0);
        let frames = inputs.chunks_exact_mut(self.examples.channels);
        let frames = frames.zip(targets.chunks_exact_mut(self.target_len()));
        for (&sample, (input, map)) in samples.iter().zip(frames) {
            let row = self.rows[sample as usize];
            self.examples.frame(row, 0, input).map_err(|error| failed(row, error))?;
            let contacts = drawn(self.examples.contacts(row), self.force_of_unknown_n);
            let contacts = contacts.map_err(|error| failed(row, error))?;
            self.draws.render(&contacts, map).map_err(|error| failed(row, error))?;
        }
        Ok(())
    }
}

impl Samples for FramesAndTargets<'_> {
    fn len(&self) -> u64 {
        self.rows.len() as u64
    }

    fn input_len(&self) -> usize {
        self.examples.channels
    }

    fn target_len(&self) -> usize {
        self.targets.len()
    }

    fn read(
        &self,
        samples: &[u64],
        inputs: &mut [f32],
        targets: &mut [f32],
    ) -> Result<(), SamplesError> {
        let frames = inputs.chunks_exact_mut(self.examples.channels);
        let frames = frames.zip(targets.chunks_exact_mut(self.targets.len()));
        for (&sample, (input, target)) in samples.iter().zip(frames) {
            let row = self.rows[sample as usize];
            self.examples.frame(row, 0, input).map_err(|error| failed(row, error))?;
            let of_row = self.targets.of_row(self.examples.contacts(row));
            let of_row = of_row.ok_or_else(|| failed(row, "contacts without this quantity"))?;
            target.copy_from_slice(&of_row);
        }
        Ok(())
    }
}
