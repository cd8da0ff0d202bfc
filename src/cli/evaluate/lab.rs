//! Common parts of the tables: trained nets by recipe, scored methods, result files.
//! Uses: `client`, `cli::train`. Never: two trainings of one recipe on one dataset.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::api::{JobOut, ModelOut};
use crate::cli::client::Client;
use crate::cli::error::CliError;
use crate::cli::files::write;
use crate::cli::output::{say, say_json};
use crate::cli::train::{Changes, follow, recipe_text};
use crate::cli::{At, embed};
use crate::dataset::force_map::ForceMapSpec;
use crate::evaluate::request::{EvaluationReport, EvaluationRequest, Scored};

/// Extent of training and scoring.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Scale {
    /// Minutes on two processors: few epochs, few rows. The numbers only show that it works.
    Small,
    /// Hours on two processors.
    Medium,
    /// As published: all rows, all epochs, every map. For a GPU.
    Full,
}

impl Scale {
    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Small => "small",
            Self::Medium => "medium",
            Self::Full => "full",
        }
    }

    /// Number of epochs and rows of a Transfer-Net; `None`: all rows.
    pub fn transfer(self) -> (i64, Option<i64>) {
        match self {
            Self::Small => (12, Some(20_000)),
            Self::Medium => (60, None),
            Self::Full => (1024, None),
        }
    }

    /// Training of a net for maps with this pixel, mm. A map of 4 mm takes 25 times as long as one
    /// of 20 mm; with small batches the loss decreases faster per minute.
    pub fn maps(self, pixel_mm: f64) -> MapTraining {
        let (epochs, rows, batch) = match self {
            Self::Small if pixel_mm < 10.0 => (2, Some(4_000), Some(16)),
            Self::Small if pixel_mm < 20.0 => (4, Some(20_000), Some(16)),
            Self::Small => (8, Some(20_000), Some(16)),
            Self::Medium => (10, Some(40_000), None),
            Self::Full => (1024, None, None),
        };
        MapTraining { epochs, rows, batch }
    }

    /// The finer pixel of the paper's factorial design, mm. The small scale uses 10 mm, since a net
    /// of 4 mm learns almost nothing in a few minutes.
    pub fn fine_mm(self) -> u32 {
        if self == Self::Small { 10 } else { 4 }
    }

    /// Largest number of scored rows; `None`: all.
    pub fn scored(self) -> Option<u64> {
        match self {
            Self::Small => Some(2_000),
            Self::Medium => Some(10_000),
            Self::Full => None,
        }
    }
}

/// Training of a net for maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MapTraining {
    epochs: i64,
    /// Largest number of rows; `None`: all.
    rows: Option<i64>,
    /// Batch size; `None`: that of the recipe.
    batch: Option<i64>,
}

/// Options of a table.
#[derive(Debug, Clone, Args)]
pub struct LabArgs {
    /// Extent of training and scoring.
    #[arg(long, value_enum, default_value = "small")]
    pub scale: Scale,
    /// Number of epochs, instead of that of the scale.
    #[arg(long, value_name = "N")]
    pub epochs: Option<i64>,
    /// Number of rows for training, instead of that of the scale.
    #[arg(long, value_name = "N")]
    pub rows: Option<i64>,
    /// Number of scored rows, instead of that of the scale.
    #[arg(long, value_name = "N")]
    pub scored: Option<u64>,
    /// Seed of every training.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: i64,
    /// The Transfer-Net's recipe: transfer-net (residual form), transfer-net-published, or a file.
    #[arg(long, value_name = "RECIPE", default_value = "transfer-net")]
    pub transfer: String,
    /// Folder for numbers, tables and figures.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub at: At,
}

/// A service with the options of a table.
pub struct Lab {
    client: Client,
    /// Options of the table.
    pub args: LabArgs,
}

/// A completed table: text for people, numbers for scripts, figures.
pub struct Sheet {
    /// Name of its files.
    pub name: String,
    /// Text, Markdown.
    pub text: String,
    /// Numbers, for JSON.
    pub numbers: Value,
    /// SVG figures by their names.
    pub pictures: Vec<(String, String)>,
}

/// Runs `work` with a lab and shows its result.
///
/// # Errors
/// `CliError` if the service cannot be reached or started, a file cannot be written, or `work`
/// fails.
pub async fn with_lab<F>(
    args: LabArgs,
    work: impl FnOnce(Lab) -> F + Send + 'static,
) -> Result<(), CliError>
where
    F: Future<Output = Result<Sheet, CliError>> + Send + 'static,
{
    let at = args.at.clone();
    embed::with_server(&at, move |client| async move {
        let (json, out) = (args.at.json, args.out.clone());
        let sheet = work(Lab { client, args }).await?;
        if let Some(folder) = &out {
            write(&folder.join(format!("{}.md", sheet.name)), &sheet.text)?;
            let numbers = format!("{:#}\n", sheet.numbers);
            write(&folder.join(format!("{}.json", sheet.name)), &numbers)?;
            for (name, svg) in &sheet.pictures {
                write(&folder.join(name), svg)?;
            }
        }
        if json {
            say_json(&sheet.numbers);
        } else {
            say(sheet.text.trim_end());
            if let Some(folder) = &out {
                say(format_args!("\nnumbers, table and figures in {}", folder.display()));
            }
        }
        Ok(())
    })
    .await
}

impl Lab {
    /// Returns the model of a recipe with changes: an existing one, or a newly trained one.
    ///
    /// # Errors
    /// `CliError` if the recipe is invalid or the training fails.
    pub async fn trained(&self, recipe: &str, changes: Changes) -> Result<ModelOut, CliError> {
        let named = Changes { seed: Some(self.args.seed), all_epochs: true, ..changes };
        let text = recipe_text(recipe, &named)?;
        let dataset = toml::from_str::<toml::Table>(&text).ok();
        let dataset = dataset.and_then(|recipe| recipe.get("dataset")?.as_str().map(str::to_owned));
        let dataset = match dataset {
            Some(name) => self.dataset(&name).await?,
            None => String::new(),
        };
        // The name contains recipe and data: an equal request finds the model.
        let digest = hex::encode(Sha256::digest(format!("{text}{dataset}")));
        let stem = named.name.clone().unwrap_or_else(|| "model".into());
        let name = format!("{stem}-{}", &digest[..8]);
        let models: Vec<ModelOut> = self.client.get("/api/v1/models").await?;
        if let Some(model) = models.into_iter().find(|model| model.name == name) {
            return Ok(model);
        }
        let recipe = recipe_text(recipe, &Changes { name: Some(name), ..named })?;
        self.say(&format!("training {stem}"));
        let asked: JobOut =
            self.client.post("/api/v1/trainings", &json!({ "recipe": recipe })).await?;
        let done = follow(&self.client, asked).await?;
        let id = done.result.as_ref().and_then(|r| r["model"].as_str()).unwrap_or_default();
        self.client.get(&format!("/api/v1/models/{id}")).await
    }

    /// Returns the Transfer-Net of the options, trained on these rows of a dataset.
    ///
    /// # Errors
    /// As [`Self::trained`].
    pub async fn transfer(
        &self,
        stem: &str,
        dataset: &str,
        conditions: &[String],
    ) -> Result<ModelOut, CliError> {
        self.transfer_by(&self.args.transfer, stem, dataset, conditions).await
    }

    /// Returns the Transfer-Net of the paper's pipeline, trained on all numbers of contacts.
    ///
    /// # Errors
    /// As [`Self::trained`].
    pub async fn transfer_to_6(&self) -> Result<ModelOut, CliError> {
        self.transfer("transfer-to-6", R2S, &[to(6)]).await
    }

    /// Returns a Transfer-Net of a recipe, trained on these rows of a dataset.
    ///
    /// # Errors
    /// As [`Self::trained`].
    pub async fn transfer_by(
        &self,
        recipe: &str,
        stem: &str,
        dataset: &str,
        conditions: &[String],
    ) -> Result<ModelOut, CliError> {
        let (epochs, rows) = self.args.scale.transfer();
        let changes = Changes {
            name: Some(format!("{stem}-{}", self.args.scale.name())),
            dataset: Some(dataset.into()),
            conditions: conditions.to_vec(),
            epochs: Some(self.args.epochs.unwrap_or(epochs)),
            rows: self.args.rows.or(rows),
            ..Changes::default()
        };
        self.trained(recipe, changes).await
    }

    /// Returns a net for maps: `recon-net` or `end-to-end`, with this map and this noise.
    ///
    /// # Errors
    /// As [`Self::trained`].
    pub async fn maps(
        &self,
        recipe: &str,
        map: &str,
        noise: Option<(f64, &str)>,
    ) -> Result<ModelOut, CliError> {
        let spec: ForceMapSpec = map
            .parse()
            .map_err(|_| CliError::argument("map", map, "must be pixel x diameter, mm"))?;
        let MapTraining { epochs, rows, batch } = self.args.scale.maps(spec.pixel_mm);
        let level = noise.map_or(0.0, |(level, _)| level);
        let changes = Changes {
            name: Some(format!("{recipe}-{map}-{:.0}-{}", 100.0 * level, self.args.scale.name())),
            map: Some(map.into()),
            epochs: Some(self.args.epochs.unwrap_or(epochs)),
            rows: self.args.rows.or(rows),
            batch,
            noise: noise.map(|(level, _)| level).filter(|level| *level > 0.0),
            noise_of: noise.filter(|(level, _)| *level > 0.0).map(|(_, of)| of.to_owned()),
            ..Changes::default()
        };
        self.trained(recipe, changes).await
    }

    /// Runs an evaluation and returns its report.
    ///
    /// # Errors
    /// `CliError` if the evaluation fails.
    pub async fn scored(&self, request: &EvaluationRequest) -> Result<EvaluationReport, CliError> {
        let asked: JobOut = self.client.post("/api/v1/evaluations", request).await?;
        let id = asked.id.clone();
        let done = follow(&self.client, asked).await?;
        let report = serde_json::from_value(done.result.unwrap_or_default());
        report.map_err(|error| CliError::Refused {
            operation: id,
            status: 500,
            detail: format!("its report cannot be read: {error}"),
        })
    }

    /// A request with this lab's rows and seed.
    pub fn wish(&self, scored: Scored, dataset: &str, part: Option<&str>) -> EvaluationRequest {
        EvaluationRequest {
            scored,
            dataset: dataset.into(),
            part: part.map(str::to_owned),
            conditions: Vec::new(),
            transfer: None,
            map: None,
            points: None,
            skin: None,
            frames: Default::default(),
            threshold_n: crate::dataset::force_map::peaks::THRESHOLD_N,
            place_sd_mm: None,
            limit: self.args.scored.or(self.args.scale.scored()),
            examples: 0,
            seed: self.args.seed.unsigned_abs(),
        }
    }

    /// Returns the id of a dataset, which is made if needed.
    ///
    /// # Errors
    /// `CliError` if the dataset cannot be made.
    pub async fn dataset(&self, name: &str) -> Result<String, CliError> {
        let row: Value =
            self.client.patient(MAKING).get(&format!("/api/v1/datasets/{name}")).await?;
        Ok(row["id"].as_str().unwrap_or_default().to_owned())
    }

    /// Returns the unit of a dataset's split, which is never divided.
    ///
    /// # Errors
    /// `CliError` if the dataset cannot be read.
    pub async fn split_by(&self, name: &str) -> Result<String, CliError> {
        let row: Value =
            self.client.patient(MAKING).get(&format!("/api/v1/datasets/{name}")).await?;
        Ok(row["definition"]["split"]["by"].as_str().unwrap_or("nothing").to_owned())
    }

    /// Client of the service.
    pub fn client(&self) -> &Client {
        &self.client
    }

    /// Prints progress for people; silent with `--json`.
    pub fn say(&self, words: &str) {
        if !self.args.at.json {
            eprintln!("{words}");
        }
    }

    /// Caption of every table: its scale and data.
    pub fn scale_words(&self, label: &str) -> String {
        let budget = |epochs: i64, rows: Option<i64>| {
            let rows = self.args.rows.or(rows);
            let rows = rows.map_or("all rows".into(), |rows| format!("up to {rows} rows"));
            format!("{} epochs of {rows}", self.args.epochs.unwrap_or(epochs))
        };
        let transfer = self.args.scale.transfer();
        let maps = PIXELS_MM.map(|pixel_mm| {
            let training = self.args.scale.maps(pixel_mm);
            format!("{} ({pixel_mm} mm)", budget(training.epochs, training.rows))
        });
        format!(
            "Scale {}: Transfer-Net by {}, {}; nets of maps {}; seed {}. Data: {label}. \
             The paper's: transfer-net-published, 1024 epochs of all rows, measured.",
            self.args.scale.name(),
            self.args.transfer,
            budget(transfer.0, transfer.1),
            maps.join(", "),
            self.args.seed,
        )
    }
}

/// The dataset of Transfer-Nets.
pub const R2S: &str = "r2s-transfer";

/// The condition of at most `contacts` contacts.
pub fn to(contacts: u32) -> String {
    format!("contact_count__lte={contacts}")
}

/// The paper's pixels, mm.
const PIXELS_MM: [f64; 3] = [4.0, 10.0, 20.0];

/// Longest wait until a dataset is made.
const MAKING: std::time::Duration = std::time::Duration::from_secs(3600);
