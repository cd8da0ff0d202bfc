//! What requests wait for, with the rows that are done: datasets that are made, imports that are stored.
//! Uses: `build::Progress`. Never: the work itself; work that has ended.

use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Weak};

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::build::Progress;

/// Kind of work on rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum MakingKind {
    /// A dataset is made.
    Dataset,
    /// The trials of an import are stored.
    Import,
}

/// A dataset that is being made, or an import that is being stored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Making {
    /// Kind of the work.
    pub kind: MakingKind,
    /// Name of the dataset, or of the imported experiment.
    pub name: String,
    /// Number of rows written.
    pub rows_done: u64,
    /// Number of rows to write; 0 until they are counted.
    pub rows_total: u64,
}

/// Work of which another owner holds the progress.
#[derive(Debug)]
struct BeingMade {
    kind: MakingKind,
    name: String,
    progress: Weak<Progress>,
}

/// All that is being made. Work is listed until its progress is dropped.
#[derive(Debug, Default)]
pub struct AllMaking(Mutex<Vec<BeingMade>>);

impl AllMaking {
    /// Lists work, and returns the progress that it must keep.
    pub fn begin(&self, kind: MakingKind, name: &str) -> Arc<Progress> {
        let progress = Arc::<Progress>::default();
        let mut all = self.0.lock();
        all.retain(|work| work.progress.strong_count() > 0);
        all.push(BeingMade { kind, name: name.into(), progress: Arc::downgrade(&progress) });
        progress
    }

    /// Returns what is being made now, oldest first.
    pub fn list(&self) -> Vec<Making> {
        let shown = |work: &BeingMade| {
            let progress = work.progress.upgrade()?;
            Some(Making {
                kind: work.kind,
                name: work.name.clone(),
                rows_done: progress.done.load(Relaxed),
                rows_total: progress.total.load(Relaxed),
            })
        };
        self.0.lock().iter().filter_map(shown).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_is_listed_while_its_progress_is_kept() {
        let all = AllMaking::default();
        let dataset = all.begin(MakingKind::Dataset, "real");
        let import = all.begin(MakingKind::Import, "pad");
        dataset.total.store(40, Relaxed);
        dataset.done.store(12, Relaxed);
        let of = |kind, name: &str, rows_done, rows_total| Making {
            kind,
            name: name.into(),
            rows_done,
            rows_total,
        };
        let pad = of(MakingKind::Import, "pad", 0, 0);
        assert_eq!(all.list(), [of(MakingKind::Dataset, "real", 12, 40), pad.clone()]);
        drop(dataset);
        assert_eq!(all.list(), [pad]);
        drop(import);
        assert!(all.list().is_empty());
    }
}
