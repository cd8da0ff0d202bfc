//! Extent of a study: how long nets train, how many rows are used and scored; and the trainings and
//! requests that follow from it.
//! PURE. Uses: `lab` (trainings), `evaluate::request`. Never: training, scoring.

use crate::dataset::force_map::{ForceMapSpec, TABLE_IV_MAPS};
use crate::evaluate::request::{EvaluationRequest, FramesRead, OffsetsRead, Scored};
use crate::lab::{Noise, Training};

/// The dataset of Transfer-Nets.
pub const R2S: &str = "r2s-transfer";
/// The dataset of Recon-Nets.
pub const S2S: &str = "s2s-recon";
/// The dataset of the pipeline and of end-to-end nets.
pub const REAL: &str = "real";
/// The recipe of a net from simulated voltages to force maps (paper, V-B).
pub const RECON_NET: &str = "recon-net";
/// The recipe of the baseline from measured voltages to force maps (paper, V-D).
pub const END_TO_END: &str = "end-to-end";
/// The regressions that nets are compared with: ending of the names of their recipes, and name in tables.
pub const REGRESSIONS: [(&str, &str); 2] = [("ridge", "ridge"), ("kernel-ridge", "kernel ridge")];
/// The coarser of the two pixels of the factorial design, mm.
const COARSE_MM: f64 = 20.0;

/// Extent of training and scoring.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Minutes on two processors: few epochs, few rows. The numbers only show that it works.
    Small,
    /// Hours on two processors.
    Medium,
    /// As published: all rows, all epochs, every map. For a GPU.
    Full,
}

impl Scale {
    /// Name in options, captions and names of models.
    pub fn name(self) -> &'static str {
        match self {
            Self::Small => "small",
            Self::Medium => "medium",
            Self::Full => "full",
        }
    }

    /// The finer pixel of the paper's factorial design, mm. The small scale uses 10 mm, since a net
    /// of 4 mm learns almost nothing in a few minutes.
    fn fine_mm(self) -> f64 {
        if self == Self::Small { 10.0 } else { 4.0 }
    }

    /// Number of epochs and rows of a Transfer-Net; `None`: all rows.
    fn transfer(self) -> (i64, Option<i64>) {
        match self {
            Self::Small => (12, Some(20_000)),
            Self::Medium => (60, None),
            Self::Full => (1024, None),
        }
    }

    /// Extent of the training of a net for maps with this pixel, mm. A map of 4 mm takes 25 times as
    /// long as one of 20 mm; with small batches the loss decreases faster per minute.
    fn maps(self, pixel_mm: f64) -> MapTraining {
        let (epochs, rows, batch) = match self {
            Self::Small if pixel_mm < 10.0 => (2, Some(4_000), Some(16)),
            Self::Small if pixel_mm < 20.0 => (4, Some(20_000), Some(16)),
            Self::Small => (8, Some(20_000), Some(16)),
            Self::Medium => (10, Some(40_000), None),
            Self::Full => (1024, None, None),
        };
        MapTraining { epochs, rows, batch }
    }

    /// Largest number of scored rows; `None`: all.
    fn scored(self) -> Option<u64> {
        match self {
            Self::Small => Some(2_000),
            Self::Medium => Some(10_000),
            Self::Full => None,
        }
    }
}

/// Extent of the training of a net for maps.
struct MapTraining {
    epochs: i64,
    /// Largest number of rows; `None`: all.
    rows: Option<i64>,
    /// Batch size; `None`: that of the recipe.
    batch: Option<i64>,
}

/// A scale with changes.
#[derive(Debug, Clone, PartialEq)]
pub struct Budget {
    /// Extent of training and scoring.
    pub scale: Scale,
    /// Number of epochs, instead of that of the scale.
    pub epochs: Option<i64>,
    /// Number of rows for training, instead of that of the scale.
    pub rows: Option<i64>,
    /// Number of scored rows, instead of that of the scale.
    pub scored: Option<u64>,
    /// Seed of every training and of the bootstrap.
    pub seed: i64,
    /// The Transfer-Net's recipe: a carried one, or a file.
    pub transfer: String,
    /// Whether datasets are split by trial, as the paper's, in place of by configuration.
    pub by_trial: bool,
    /// The finest pixel whose maps are trained, mm, instead of that of the scale.
    pub finest_mm: Option<f64>,
}

impl Budget {
    /// Name of a dataset with the split of the budget.
    pub fn dataset(&self, name: &str) -> String {
        let is_split = self.by_trial && [R2S, S2S, REAL].contains(&name);
        if is_split { format!("{name}-by-trial") } else { name.into() }
    }

    /// The pixels of the factorial design, mm, the finer one first; one if no finer one is trained.
    pub fn pixels_mm(&self) -> Vec<f64> {
        let fine_mm = self.finest_mm.unwrap_or_else(|| self.scale.fine_mm());
        if fine_mm < COARSE_MM { vec![fine_mm, COARSE_MM] } else { vec![COARSE_MM] }
    }

    /// The maps of Table IV that are trained: those whose pixels are no finer than the finest, in the order of the table.
    pub fn table_iv_maps(&self) -> Vec<ForceMapSpec> {
        let is_trained = |map: &ForceMapSpec| self.finest_mm.is_none_or(|mm| map.pixel_mm >= mm);
        TABLE_IV_MAPS.into_iter().filter(is_trained).collect()
    }

    /// Training of the Transfer-Net of the paper's pipeline, on all numbers of contacts of [`R2S`]: the last net of
    /// Table III. `contacts`: these numbers ([`crate::lab::Lab::contact_numbers`]).
    pub fn transfer_to_all(&self, contacts: &[u32]) -> Training {
        self.transfer_by(&self.transfer, "transfer", R2S, most(contacts))
    }

    /// Training of a Transfer-Net of a recipe, on the rows of a dataset with at most `most` contacts.
    pub fn transfer_by(&self, recipe: &str, stem: &str, dataset: &str, most: u32) -> Training {
        let (epochs, rows) = self.scale.transfer();
        Training {
            recipe: recipe.into(),
            stem: format!("{stem}-to-{most}-{}", self.scale.name()),
            dataset: Some(self.dataset(dataset)),
            conditions: vec![up_to(most)],
            epochs: Some(self.epochs.unwrap_or(epochs)),
            rows: self.rows.or(rows),
            seed: self.seed,
            ..Training::default()
        }
    }

    /// Training of a net for these maps: [`RECON_NET`], [`END_TO_END`] or one of their regressions, on the recipe's
    /// dataset.
    pub fn map_net(&self, recipe: &str, map: ForceMapSpec, noise: Option<Noise>) -> Training {
        let MapTraining { epochs, rows, batch } = self.scale.maps(map.pixel_mm);
        let percent = 100.0 * noise.as_ref().map_or(0.0, |noise| noise.level);
        let learned = if recipe.starts_with(END_TO_END) { REAL } else { S2S };
        Training {
            recipe: recipe.into(),
            stem: format!("{recipe}-{map}-{percent:.0}-{}", self.scale.name()),
            // Without a name it is that of the recipe, split by configuration.
            dataset: self.by_trial.then(|| self.dataset(learned)),
            map: Some(map),
            epochs: Some(self.epochs.unwrap_or(epochs)),
            rows: self.rows.or(rows),
            batch,
            noise,
            seed: self.seed,
            ..Training::default()
        }
    }

    /// Request for scores on a part of a dataset; on all of it if `part` is absent.
    pub fn request(
        &self,
        scored: impl Into<Scored>,
        dataset: &str,
        part: Option<&str>,
    ) -> EvaluationRequest {
        EvaluationRequest {
            scored: scored.into(),
            dataset: self.dataset(dataset),
            part: part.map(str::to_owned),
            conditions: Vec::new(),
            transfer: None,
            map: None,
            points: None,
            net: None,
            skin: None,
            frames: FramesRead::default(),
            offsets: OffsetsRead::default(),
            threshold_n: None,
            place_sd_mm: None,
            limit: self.scored.or(self.scale.scored()),
            examples: 0,
            seed: self.seed.unsigned_abs(),
        }
    }

    /// Caption of every table: its scale and data.
    pub fn caption(&self, label: &str) -> String {
        let extent = |epochs: i64, rows: Option<i64>| {
            let rows = self.rows.or(rows);
            let rows = rows.map_or("all rows".into(), |rows| format!("up to {rows} rows"));
            format!("{} epochs of {rows}", self.epochs.unwrap_or(epochs))
        };
        let transfer = self.scale.transfer();
        let mut maps = self.table_iv_maps();
        maps.dedup_by_key(|map| map.pixel_mm);
        let maps = maps.iter().map(|map| {
            let training = self.scale.maps(map.pixel_mm);
            format!("{} ({} mm)", extent(training.epochs, training.rows), map.pixel_mm)
        });
        format!(
            "Scale {}: Transfer-Net by {}, {}; nets of maps {}; seed {}{}. Data: {label}. \
             The paper's: transfer-net-published, 1024 epochs of all rows, measured.",
            self.scale.name(),
            self.transfer,
            extent(transfer.0, transfer.1),
            maps.collect::<Vec<_>>().join(", "),
            self.seed,
            if self.by_trial { "; split by trial" } else { "" },
        )
    }
}

/// The condition of at most `contacts` contacts.
pub fn up_to(contacts: u32) -> String {
    format!("contact_count__lte={contacts}")
}

/// Largest of these numbers of contacts; 1 without any.
pub fn most(contacts: &[u32]) -> u32 {
    contacts.iter().copied().max().unwrap_or(1)
}

/// The small scale without changes.
#[cfg(test)]
pub fn small() -> Budget {
    let transfer = "transfer-net".into();
    let (epochs, rows, scored, finest_mm) = (None, None, None, None);
    let (scale, by_trial) = (Scale::Small, false);
    Budget { scale, epochs, rows, scored, seed: 1, transfer, by_trial, finest_mm }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::force_map::SIDE_MM;
    use crate::ids::ModelId;
    use crate::infer::methods::Method;

    #[test]
    fn a_net_is_named_by_recipe_map_noise_and_scale() {
        let map = ForceMapSpec { pixel_mm: 10.0, diameter_mm: 20.0, side_mm: SIDE_MM };
        let noise = Noise::at(0.1, &ModelId::unchecked("mdl-1"));
        assert_eq!(small().map_net(RECON_NET, map, noise).stem, "recon-net-10x20-10-small");
        assert_eq!(small().map_net(END_TO_END, map, None).stem, "end-to-end-10x20-0-small");
        let transfer = small().transfer_to_all(&[1, 2, 4]);
        assert_eq!(transfer.stem, "transfer-to-4-small");
        assert_eq!(transfer.conditions, ["contact_count__lte=4"]);
        assert_eq!(Noise::at(0.0, &ModelId::unchecked("mdl-1")), None);
    }

    #[test]
    fn every_dataset_of_a_table_is_split_by_trial_if_one_is() {
        let by_trial = Budget { by_trial: true, ..small() };
        let map = ForceMapSpec { pixel_mm: 10.0, diameter_mm: 20.0, side_mm: SIDE_MM };
        let of_map = |budget: &Budget, recipe| budget.map_net(recipe, map, None).dataset;
        assert_eq!(of_map(&by_trial, RECON_NET).as_deref(), Some("s2s-recon-by-trial"));
        assert_eq!(of_map(&by_trial, END_TO_END).as_deref(), Some("real-by-trial"));
        assert_eq!(of_map(&by_trial, "end-to-end-ridge").as_deref(), Some("real-by-trial"));
        assert_eq!(of_map(&small(), RECON_NET), None);
        let transfer = by_trial.transfer_to_all(&[6]).dataset;
        assert_eq!(transfer.as_deref(), Some("r2s-transfer-by-trial"));
        for name in ["real-unseen", "pad", "real-by-trial"] {
            assert_eq!(by_trial.request(Method::Exact, name, None).dataset, name);
        }
        assert!(by_trial.caption("virtual").contains("split by trial"));
    }

    #[test]
    fn a_change_replaces_the_value_of_the_scale() {
        let changed = Budget { epochs: Some(3), rows: Some(50), scored: Some(7), ..small() };
        let training = changed.transfer_to_all(&[6]);
        assert_eq!((training.epochs, training.rows), (Some(3), Some(50)));
        assert_eq!(changed.request(Method::Exact, "real", None).limit, Some(7));
        assert_eq!(small().request(Method::Exact, "real", None).limit, Some(2_000));
        assert!(changed.caption("virtual").contains("3 epochs of up to 50 rows"));
    }

    #[test]
    fn maps_with_finer_pixels_than_the_finest_are_not_trained() {
        let full = Budget { scale: Scale::Full, ..small() };
        assert_eq!((full.pixels_mm(), full.table_iv_maps().len()), (vec![4.0, 20.0], 12));
        let coarse = Budget { finest_mm: Some(10.0), ..full.clone() };
        let maps: Vec<String> = coarse.table_iv_maps().iter().map(ToString::to_string).collect();
        assert_eq!(maps, ["10x10", "10x30", "10x50", "10x70", "20x20", "20x60"]);
        assert_eq!(coarse.pixels_mm(), [10.0, 20.0]);
        let caption = coarse.caption("virtual");
        assert!(caption.contains("(10 mm)") && !caption.contains("(4 mm)"), "{caption}");
        assert_eq!(Budget { finest_mm: Some(20.0), ..full }.pixels_mm(), [20.0]);
    }
}
