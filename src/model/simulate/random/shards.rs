//! Makes shards: row groups on threads, appended in order to a file.
//! Uses: `draw`, `encode`, sim-core, threads. Never: a folder, a clock, the order in which threads finish.
//!
//! `draw -> simulate -> encode` makes a row group on one thread; the calling thread appends row groups in
//! order. Row group n is made by thread n mod threads and waits in that thread's bounded queue: memory depends
//! on the number of threads alone, and no reordering is needed.

use std::io::Write;
use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use sim_core::batch::{BatchModel, BatchWork};
use sim_core::sensor::Sensor;

use super::encode::{self, Encoder, Layout, RowGroup, Trials};
use super::error::RandomError;
use super::manifest::{Definition, Shard};
use crate::chunk::Tell;

/// Number of row groups that a thread may be ahead of the file.
const GROUPS_AHEAD: usize = 2;

/// A row group, or its error.
pub type MadeGroup = Result<RowGroup, RandomError>;

/// Makes shards of one definition, on any number of threads.
pub struct ShardMaker<'a> {
    definition: &'a Definition,
    sensor: &'a Sensor,
    model: &'a BatchModel,
    layout: Layout,
    encoder: Encoder,
}

impl<'a> ShardMaker<'a> {
    /// Maker of a definition; `model` must be the one of the definition, for this sensor.
    ///
    /// # Errors
    /// `RandomError::Encode` if the columns of the shards cannot be laid out.
    pub fn new(
        definition: &'a Definition,
        sensor: &'a Sensor,
        model: &'a BatchModel,
    ) -> Result<Self, RandomError> {
        let failed = |source| RandomError::Encode { file: "the shards' columns".into(), source };
        let layout = Layout::new(definition, sensor.channels(), sensor.file.tip_diameter_mm)
            .map_err(failed)?;
        let encoder = layout.encoder().map_err(failed)?;
        Ok(Self { definition, sensor, model, layout, encoder })
    }

    /// Makes the row groups of these shards on threads; `append` receives them in order, and may leave the rest.
    pub fn row_groups<T>(
        &self,
        shards: &[Shard],
        threads: NonZeroUsize,
        append: impl FnOnce(&mut dyn Iterator<Item = MadeGroup>) -> T,
    ) -> T {
        thread::scope(|scope| {
            let threads = threads.get();
            let queues: Vec<Receiver<MadeGroup>> = (0..threads)
                .map(|thread| {
                    let (give, take) = sync_channel(GROUPS_AHEAD);
                    let share =
                        shards.iter().flat_map(|s| s.row_groups()).skip(thread).step_by(threads);
                    scope.spawn(move || self.make_all(share, &give));
                    take
                })
                .collect();
            let mut made = queues.iter().cycle().map(|queue| {
                // A sender is only dropped early if its thread panics; the scope then panics as well.
                queue.recv().expect("a thread makes all of its row groups")
            });
            append(&mut made)
        })
    }

    /// Appends the row groups of a shard to `out`, whose name errors state. After each group `tell` receives its
    /// number of trials; none is returned if it breaks off.
    ///
    /// # Errors
    /// `RandomError` if a row group could not be made or written.
    pub fn write<W: Write + Send>(
        &self,
        shard: &Shard,
        out: W,
        name: &str,
        made: &mut dyn Iterator<Item = MadeGroup>,
        tell: &mut Tell<'_>,
    ) -> Result<Option<W>, RandomError> {
        let failed = |source| RandomError::Encode { file: name.to_owned(), source };
        let mut file = self.layout.file(out).map_err(failed)?;
        // In this order: when the shard is complete, no queue has been skipped.
        for ((_, trials), group) in shard.row_groups().zip(made) {
            encode::append(&mut file, group?).map_err(failed)?;
            if tell(trials).is_break() {
                return Ok(None);
            }
        }
        Ok(Some(file.into_inner().map_err(failed)?))
    }

    /// Makes row groups until all are done, one fails, or the receiver is dropped.
    fn make_all(&self, row_groups: impl Iterator<Item = (u64, u64)>, give: &SyncSender<MadeGroup>) {
        let mut work = BatchWork::default();
        for (first, count) in row_groups {
            let made = self.make(first, count, &mut work);
            let failed = made.is_err();
            if give.send(made).is_err() || failed {
                return;
            }
        }
    }

    fn make(&self, first: u64, count: u64, work: &mut BatchWork) -> MadeGroup {
        let trials = self.simulate(first, count, work)?;
        self.encoder.encode(trials).map_err(|source| RandomError::Encode {
            file: format!("trials {first} to {}", first + count - 1),
            source,
        })
    }

    /// Draws and simulates consecutive trials.
    fn simulate(
        &self,
        first: u64,
        count: u64,
        work: &mut BatchWork,
    ) -> Result<Trials, RandomError> {
        let (mut contacts, mut ends) = (Vec::new(), Vec::with_capacity(count as usize));
        for index in first..first + count {
            self.definition.draws.trial(self.sensor.points(), index, &mut contacts);
            ends.push(contacts.len());
        }
        let mut trials = Trials { first, contacts, ends, voltages_v: Vec::new() };
        let mut voltages_v = vec![0.0; trials.ends.len() * self.sensor.channels()];
        self.model
            .voltages(&trials.each(), &mut voltages_v, work)
            .map_err(|source| RandomError::Simulate { first, last: first + count - 1, source })?;
        trials.voltages_v = voltages_v;
        Ok(trials)
    }
}
