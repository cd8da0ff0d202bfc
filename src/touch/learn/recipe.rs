//! A recipe: dataset, net and training. One TOML file.
//! PURE. Uses: nets (its part of the file), `dataset::force_map`. Never: data.

use nets::error::RecipeError;
pub use nets::net::Net;
use serde::{Deserialize, Serialize};

use super::task::{Answers, NetTask};
use crate::dataset::force_map::ForceMapSpec;
use crate::ids::ModelId;
use crate::problem::{Checks, Problem};
use crate::syntax::parse_toml;

/// Largest number of rows in an epoch: their order is in memory.
const EPOCH_ROWS_MAX: u64 = 20_000_000;
/// Longest name, characters.
const RECIPE_NAME_MAX: usize = 80;
/// Largest side of maps, pixels, that are drawn with fewer layers than a net's default: from a first
/// image of 8 or 4 pixels, as larger maps are from one of 10.
const FEW_PIXELS: i64 = 64;
/// Channels of these layers.
const FEWER_CHANNELS: [i64; 3] = [128, 64, 32];

/// Returns the channels (`training.net.channels`) of a net whose maps have this side, pixels; `None`: the
/// default of the net, or a regression, which has none.
pub fn map_channels(net: &Net, side: i64) -> Option<[i64; 3]> {
    let has_channels = matches!(net, Net::ReconNet(_) | Net::EndToEnd(_));
    (has_channels && side <= FEW_PIXELS).then_some(FEWER_CHANNELS)
}

/// Contents of a recipe file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Name of its models.
    pub name: String,
    /// Name or id of a dataset. A Point-Net without one is trained on simulations made during
    /// training.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dataset: Option<String>,
    /// Conditions that a row must meet, each `COLUMN__lte=VALUE`, in training, validation and test.
    #[serde(default, rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<String>,
    /// Largest number of rows for training, taken evenly.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows: Option<u64>,
    /// Pixel and diameter of the force maps, mm: `4x20`. Only for nets with force maps as answers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<ForceMapSpec>,
    /// Id, start of the id, or name of the Transfer-Net whose residuals are the noise that `training.noise` scales.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_of: Option<String>,
    /// Net, optimiser, noise, end of training.
    pub training: nets::recipe::Recipe,
}

impl Recipe {
    /// Reads and checks a recipe.
    ///
    /// # Errors
    /// All problems of the text or its values.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Vec<Problem>> {
        let recipe: Self = parse_toml(file, text)?;
        recipe.check(file)?;
        Ok(recipe)
    }

    /// Task of its net.
    pub fn task(&self) -> NetTask {
        NetTask::of(&self.training.net)
    }

    fn check(&self, file: &str) -> Result<(), Vec<Problem>> {
        let task = self.task();
        let mut checks = Checks::of(file);
        let word = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        let named = (1..=RECIPE_NAME_MAX).contains(&self.name.len()) && self.name.chars().all(word);
        let own = self.name.parse::<ModelId>().is_err();
        checks.require(named && own, "name", &self.name, "must be letters, digits, - _ . only");
        let map = self.map.map_or("none".into(), |map| map.to_string());
        let limit = "must be set for nets with force maps as answers, and only for these";
        checks.require(task.gives_map() == self.map.is_some(), "map", map, limit);
        let dataset = self.dataset.as_deref().unwrap_or("none");
        let has_data = self.dataset.is_some() || task.answers() == Answers::Points;
        checks.require(has_data, "dataset", dataset, "must be a dataset's name or id");
        let rows = self.rows.unwrap_or(1);
        checks.require((1..=EPOCH_ROWS_MAX).contains(&rows), "rows", rows, "must be 1 to 20000000");
        let level = self.training.noise.level;
        let limit = "must name the Transfer-Net whose residuals training.noise.level scales";
        let noise_of = self.noise_of.as_deref().unwrap_or("none");
        checks.require(level == 0.0 || self.noise_of.is_some(), "noise_of", noise_of, limit);
        let mut problems = checks.done().err().unwrap_or_default();
        if let Err(error) = self.training.check() {
            problems.push(match error {
                RecipeError::Value { field, found, limit } => {
                    let key = format!("training.{field}");
                    Problem::new(file, &key, found, format!("must be {limit}"))
                }
                RecipeError::Text(error) => Problem::whole(file, format!("training: {error}")),
            });
        }
        if problems.is_empty() { Ok(()) } else { Err(problems) }
    }
}
