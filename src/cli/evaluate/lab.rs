//! The service as the lab of a study: trainings and evaluations are its jobs.
//! Uses: `client`, `cli::train`, `jobs::chunks`, `studies::lab`. Never: two trainings of one recipe on one dataset.

use std::path::{Path, PathBuf};

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use parking_lot::Mutex;
use reqwest::multipart::Part;
use serde_json::{Value, json};

use crate::api::{FrameAnswer, InferOptions, InferRequest, JobOut, ModelOut};
use crate::cli::client::Client;
use crate::cli::download::DATASET_WAIT;
use crate::cli::error::{CliError, CliResult};
use crate::cli::files::read_input;
use crate::cli::job::wait_for;
use crate::cli::next::Next;
use crate::cli::output::{Output, note};
use crate::cli::picture::Pictures;
use crate::cli::train::{Changes, recipe_text};
use crate::cli::view::rows;
use crate::cli::{At, embed};
use crate::dataset::import::sensor::ImportedSensor;
use crate::digest::sha256_hex;
use crate::evaluate::request::{EvaluationReport, EvaluationRequest};
use crate::ids::{DatasetId, ModelId};
use crate::infer::answer::Reading;
use crate::infer::methods::Method;
use crate::infer::registry::SENSOR_FILE;
use crate::jobs::chunks::{DatasetFile, NetOrder, NetScore, SCORES_FILE};
use crate::learn::model_file::Manifest;
use crate::learn::order::{MANIFEST, ONNX, RESIDUALS};
use crate::learn::residuals::Residuals;
use crate::record::CONTACTS_MAX;
use crate::simulate::schema::SIM_VOLTAGES_V;
use crate::store::{RunKind, RunRow, TaskRow, TaskState};
use crate::studies::budget::{Budget, Scale};
use crate::studies::lab::{DatasetFacts, Lab, NO_METHOD, StudyError, TableNet, Training, Trial};
use crate::studies::sheet::Sheet;
use crate::syntax::parse_toml;

/// Newest jobs among which one of the same request is looked for.
const JOBS_LOOKED_AT: usize = 1000;

/// Extent of training and scoring.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum ScaleName {
    /// Minutes on two processors: few epochs and rows. It only shows that it works.
    Small,
    /// Hours on two processors.
    Medium,
    /// As published: all rows, all epochs, every map. For a GPU.
    Full,
}

/// Options that determine the extent of a table.
#[derive(Debug, Clone, Args)]
pub struct ExtentArgs {
    /// Extent of training and scoring.
    #[arg(long, value_enum, default_value = "small")]
    scale: ScaleName,
    /// Number of epochs, instead of that of the scale.
    #[arg(long, value_name = "N")]
    epochs: Option<i64>,
    /// Number of rows for training, instead of that of the scale.
    #[arg(long, value_name = "N")]
    rows: Option<i64>,
    /// Number of scored rows, instead of that of the scale.
    #[arg(long, value_name = "N")]
    scored: Option<u64>,
    /// Seed of every training.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: i64,
    /// The Transfer-Net's recipe: transfer-net (residual form), transfer-net-published, or a file.
    #[arg(long, value_name = "RECIPE", default_value = "transfer-net")]
    transfer: String,
    /// Split real, r2s-transfer and s2s-recon by trial, as the paper did, in place of by configuration.
    #[arg(long)]
    by_trial: bool,
    /// Finest pixel of the force maps that are trained, mm, instead of that of the scale.
    #[arg(long, value_name = "MM", value_parser = pixels_mm())]
    finest_mm: Option<u8>,
}

/// Options of a table.
#[derive(Debug, Clone, Args)]
pub struct LabArgs {
    #[command(flatten)]
    extent: ExtentArgs,
    /// Folder that `palpate cluster gather` has written. Of nets: those of the table are added to the service, with
    /// the scores that they have there; the others are trained. Of an evaluation: its scores are shown.
    #[arg(long, value_name = "DIR")]
    trained: Option<PathBuf>,
    #[command(flatten)]
    pictures: Pictures,
    #[command(flatten)]
    at: At,
}

/// Pixels of the paper's force maps, mm.
fn pixels_mm() -> impl TypedValueParser<Value = u8> {
    PossibleValuesParser::new(["4", "10", "20"]).try_map(|mm| mm.parse::<u8>())
}

impl ExtentArgs {
    /// The budget of these options.
    pub fn budget(&self) -> Budget {
        Budget {
            scale: match self.scale {
                ScaleName::Small => Scale::Small,
                ScaleName::Medium => Scale::Medium,
                ScaleName::Full => Scale::Full,
            },
            epochs: self.epochs,
            rows: self.rows,
            scored: self.scored,
            seed: self.seed,
            transfer: self.transfer.clone(),
            by_trial: self.by_trial,
            finest_mm: self.finest_mm.map(f64::from),
        }
    }
}

/// Runs a study with a service as its lab, and shows its result.
///
/// # Errors
/// `CliError` if the service cannot be reached or started, a file cannot be written, or the study
/// fails.
pub async fn with_lab(
    args: LabArgs,
    study: impl AsyncFnOnce(&ServiceLab, &Budget) -> CliResult<Sheet>,
) -> CliResult<()> {
    embed::with_purpose(&args.at, embed::Purpose::Computes, async |client| {
        let lab = ServiceLab::new(client.clone(), args.at.output(), args.trained.clone());
        // A gathered evaluation has its scores in the folder itself, a net in its own folder.
        if let Some(folder) = &args.trained
            && folder.join(SCORES_FILE).exists()
        {
            lab.take_scores(folder)?;
        }
        let sheet = study(&lab, &args.extent.budget()).await?;
        show(&sheet, &args).await
    })
    .await
}

/// Writes and prints the result of a study.
async fn show(sheet: &Sheet, args: &LabArgs) -> CliResult<()> {
    let (mut words, mut next) = (sheet.text.trim_end().to_owned(), Next::of(&args.at));
    match &args.pictures.out {
        Some(folder) => {
            args.pictures.write_all(folder, &sheet.files).await?;
            words += &format!("\n\nnumbers, table and figures in {}", folder.display());
        }
        None => next = next.same_command("with --out DIR", "writes numbers, table and figures"),
    }
    args.at.output().say(&sheet.numbers, words);
    next.suggest("palpate model list", "the nets, with their last scores").say();
    Ok(())
}

/// A lab whose trainings and evaluations are jobs of a service.
pub struct ServiceLab {
    client: Client,
    output: Output,
    /// Folder of gathered nets.
    trained: Option<PathBuf>,
    /// Scores of the gathered nets of this study.
    scores: Mutex<Vec<NetScore>>,
}

/// A training with all names resolved.
struct ResolvedTraining {
    /// Name of the model: it contains recipe and data, so that an equal request finds the model.
    name: String,
    /// Text of the recipe, with this name.
    recipe: String,
    /// Description of the dataset; null without one.
    dataset: Value,
}

impl ServiceLab {
    /// A lab at a service; `trained`: folder of gathered nets.
    pub fn new(client: Client, output: Output, trained: Option<PathBuf>) -> Self {
        Self { client, output, trained, scores: Mutex::default() }
    }

    /// A net of a table, for a work order.
    ///
    /// # Errors
    /// `CliError` if the recipe is invalid or names no dataset, or the dataset cannot be made.
    pub async fn net_order(&self, net: &TableNet) -> CliResult<NetOrder> {
        let TableNet { training, scores } = net;
        let ResolvedTraining { recipe, dataset, .. } = self.resolve(training).await?;
        let limit = "must name a dataset: nets on simulations are not made in chunks";
        let file: DatasetFile = serde_json::from_value(dataset)
            .map_err(|_| CliError::argument("recipe", &training.recipe, limit))?;
        let path = format!("/api/v1/datasets/{}/lineage", file.id);
        let lineage: Value = self.client.get(&path).await?;
        Ok(NetOrder::new(&recipe, file, &lineage["lineage"], scores.clone())?)
    }

    /// Resolves the names of a training; makes its dataset if needed.
    async fn resolve(&self, training: &Training) -> CliResult<ResolvedTraining> {
        let stem = &training.stem;
        let changes = changes(training, stem);
        let text = recipe_text(&training.recipe, &changes)?;
        let named = toml::from_str::<toml::Table>(&text).ok();
        let named = named.and_then(|recipe| recipe.get("dataset")?.as_str().map(str::to_owned));
        let dataset = match named {
            Some(name) => self.dataset(&name).await?,
            None => Value::Null,
        };
        let id = dataset["id"].as_str().unwrap_or_default();
        let digest = sha256_hex(format!("{text}{id}"));
        let name = format!("{stem}-{}", &digest[..8]);
        let changes = Changes { name: Some(name.clone()), ..changes };
        let recipe = recipe_text(&training.recipe, &changes)?;
        Ok(ResolvedTraining { name, recipe, dataset })
    }

    /// Takes the scores of a gathered net or evaluation.
    fn take_scores(&self, folder: &Path) -> CliResult<()> {
        let path = folder.join(SCORES_FILE);
        let scores: Vec<NetScore> = serde_json::from_str(&read_input(&path)?)
            .map_err(|error| CliError::in_file(&path, error.to_string()))?;
        self.scores.lock().extend(scores);
        Ok(())
    }

    /// Adds a gathered net to the service.
    async fn add_gathered(&self, name: &str, folder: &Path) -> CliResult<ModelOut> {
        let path = folder.join(MANIFEST);
        let manifest: Manifest = parse_toml(&path.display().to_string(), &read_input(&path)?)?;
        let mut texts = vec![
            ("sensor", Part::text(read_input(&folder.join(SENSOR_FILE))?)),
            ("facts", Part::text(manifest.model.to_toml())),
            ("name", Part::text(name.to_owned())),
            ("id", Part::text(manifest.id.to_string())),
        ];
        let residuals = folder.join(RESIDUALS);
        if residuals.exists() {
            texts.push(("residuals", Part::text(read_input(&residuals)?)));
        }
        if self.output == Output::Text {
            note(format_args!("adding {name}"));
        }
        self.client.upload("/api/v1/models", &folder.join(ONNX), texts).await
    }

    /// Requests a job and waits for its end. A job of the same request that has not ended is not requested a second time:
    /// the service resumes it if an earlier command was killed.
    async fn job(&self, path: &str, request: Value) -> CliResult<JobOut> {
        let (jobs, _) = self.client.first::<JobOut>("/api/v1/jobs?", JOBS_LOOKED_AT).await?;
        let is_same = |job: &JobOut| {
            let TaskRow { state, request: of, .. } = &job.task;
            matches!(state, TaskState::Waiting | TaskState::Running) && *of == request
        };
        let asked = match jobs.into_iter().find(is_same) {
            Some(job) => job,
            None => self.client.post(&format!("/api/v1/{path}"), &request).await?,
        };
        wait_for(&self.client, asked).await
    }

    /// Description of a dataset, which is made if needed.
    async fn dataset(&self, name: &str) -> CliResult<Value> {
        let client = self.client.patient(DATASET_WAIT).showing("making the dataset");
        client.post("/api/v1/datasets", &json!({ "name": name })).await
    }

    /// Whether the first frame of the first trial of a dataset is stored; a mean of one frame is that frame.
    async fn has_first_frame(&self, dataset: &str) -> CliResult<bool> {
        let path = format!("/api/v1/datasets/{dataset}/rows?columns=trial_id,frame_count&limit=1");
        let page: Value = self.client.get(&path).await?;
        let row = &page["items"][0];
        let frames = format!("/api/v1/trials/{}/frames", row["trial_id"]);
        let stored: Option<Value> = self.client.if_there(&frames).await?;
        Ok(stored.is_some() || row["frame_count"] == 1)
    }
}

impl Lab for ServiceLab {
    type Error = CliError;

    async fn dataset_id(&self, dataset: &str) -> CliResult<DatasetId> {
        let row = self.dataset(dataset).await?;
        Ok(DatasetId::unchecked(row["id"].as_str().unwrap_or_default()))
    }

    async fn split_by(&self, dataset: &str) -> CliResult<String> {
        let row = self.dataset(dataset).await?;
        Ok(row["definition"]["split"]["by"].as_str().unwrap_or("nothing").to_owned())
    }

    async fn contact_numbers(&self, dataset: &str) -> CliResult<Vec<u32>> {
        let row = self.dataset(dataset).await?;
        let (id, report) = (row["id"].as_str().unwrap_or_default(), &row["report"]);
        let part = if report["parts"]["train"].is_u64() { "&split__eq=train" } else { "" };
        let mut found = Vec::new();
        for number in (1_u32..).take(CONTACTS_MAX) {
            let of_number = format!("contact_count__eq={number}{part}&columns=contact_count");
            let path = format!("/api/v1/datasets/{id}/rows?{of_number}&limit=1");
            let page: Value = self.client.get(&path).await?;
            if !rows(&page, "items").is_empty() {
                found.push(number);
            }
        }
        Ok(found)
    }

    async fn facts(&self, dataset: &str) -> CliResult<DatasetFacts> {
        let row = self.dataset(dataset).await?;
        let (id, report) = (row["id"].as_str().unwrap_or_default(), &row["report"]);
        let lineage: Value = self.client.get(&format!("/api/v1/datasets/{id}/lineage")).await?;
        let runs = rows(&lineage["lineage"], "runs");
        let rig: Value = self.client.get("/api/v1/sensor").await?;
        let mut columns = rows(report, "columns").iter();
        let side_mm = |of: &str| rig[of].as_f64().unwrap_or_default();
        let mut facts = DatasetFacts {
            has_parts: ["train", "test"].iter().all(|part| report["parts"][*part].is_u64()),
            has_simulated: columns.any(|column| column["name"] == SIM_VOLTAGES_V),
            of_rig: true,
            has_first_frames: true,
            skin_mm: side_mm("width_mm").max(side_mm("height_mm")),
        };
        if let Some(uid) = runs.first().and_then(|run| run["uid"].as_str()) {
            let run: RunRow = self.client.get(&format!("/api/v1/runs/{uid}")).await?;
            let sensor = ImportedSensor::from_toml("the sensor file of the run", &run.sensor)?;
            facts.of_rig = rig["name"] == sensor.name && rig["channels"] == sensor.channels;
            facts.skin_mm = sensor.width_mm.max(sensor.height_mm);
        }
        if runs.iter().any(|run| run["kind"] == RunKind::Imported.as_str()) {
            facts.has_first_frames = self.has_first_frame(id).await?;
        }
        Ok(facts)
    }

    async fn train(&self, training: &Training) -> CliResult<ModelId> {
        let stem = &training.stem;
        let ResolvedTraining { name, recipe, .. } = self.resolve(training).await?;
        let gathered = self.trained.as_ref().map(|folder| folder.join(&name));
        let gathered = gathered.filter(|folder| folder.is_dir());
        if let Some(folder) = &gathered {
            self.take_scores(folder)?;
        }
        let models: Vec<ModelOut> = self.client.all("/api/v1/models?").await?;
        if let Some(model) = models.into_iter().find(|model| model.name == name) {
            return Ok(model.id);
        }
        if let Some(folder) = &gathered {
            return Ok(self.add_gathered(&name, folder).await?.id);
        }
        if self.output == Output::Text {
            note(format_args!("training {stem}"));
        }
        let done = self.job("trainings", json!({ "recipe": recipe })).await?;
        let id = done.task.result.as_ref().and_then(|r| r["model"].as_str()).unwrap_or_default();
        let model: ModelOut = self.client.get(&format!("/api/v1/models/{id}")).await?;
        Ok(model.id)
    }

    async fn score(&self, request: &EvaluationRequest) -> CliResult<EvaluationReport> {
        let known = self.scores.lock().iter().find(|score| score.request == *request).cloned();
        if let Some(NetScore { report, .. }) = known {
            return Ok(report);
        }
        let done = self.job("evaluations", json!(request)).await?;
        let report = serde_json::from_value(done.task.result.unwrap_or_default());
        report.map_err(|error| CliError::Refused {
            status: 500,
            detail: format!("its report cannot be read: {error}"),
            again: false,
        })
    }

    async fn residuals(&self, transfer: &ModelId) -> CliResult<Residuals> {
        self.client.get(&format!("/api/v1/models/{transfer}/residuals")).await
    }

    async fn first_trial(&self, dataset: &str, conditions: &[String]) -> CliResult<Option<Trial>> {
        let conditions = conditions.join("&");
        let path = format!(
            "/api/v1/datasets/{dataset}/rows?{conditions}&columns=voltages_v,contacts,label&limit=1"
        );
        let page: Value = self.client.get(&path).await?;
        let row = &page["items"][0];
        let read = (
            serde_json::from_value(row["voltages_v"].clone()),
            serde_json::from_value(row["label"].clone()),
        );
        let (Ok(frame_v), Ok(label)) = read else { return Ok(None) };
        Ok(Some(Trial {
            frame_v,
            contacts: serde_json::from_value(row["contacts"].clone()).unwrap_or_default(),
            label,
        }))
    }

    async fn reading(
        &self,
        frame_v: &[f32],
        transfer: &ModelId,
        map: &ModelId,
    ) -> CliResult<Reading> {
        let options = InferOptions {
            method: Method::Paper,
            model: Some(map.to_string()),
            transfer: Some(transfer.to_string()),
            map: true,
            averaged: 1.0,
        };
        let request = InferRequest { options, frames: vec![frame_v.to_vec()] };
        let answers: Vec<FrameAnswer> = self.client.post("/api/v1/infer", &request).await?;
        let answer = answers.into_iter().next();
        let answer = answer.ok_or_else(|| CliError::argument("frame", "none", "no answer"))?;
        Ok(answer.reading)
    }
}

/// Changes of a recipe for a training; a study's nets learn all epochs.
fn changes(training: &Training, name: &str) -> Changes {
    Changes {
        name: Some(name.into()),
        dataset: training.dataset.clone(),
        conditions: training.conditions.clone(),
        answers: training.answers,
        map: training.map.map(|map| map.to_string()),
        seed: Some(training.seed),
        epochs: training.epochs,
        rows: training.rows,
        batch: training.batch,
        noise: training.noise.as_ref().map(|noise| noise.level),
        noise_of: training.noise.as_ref().map(|noise| noise.of.to_string()),
        // A net with the recipe's epochs also ends as the recipe requires.
        all_epochs: training.epochs.is_some(),
    }
}

impl From<StudyError> for CliError {
    fn from(error: StudyError) -> Self {
        match error {
            StudyError::Figure(error) => Self::Figure(error),
            StudyError::Design(error) => {
                Self::argument("factorial", "the design", error.to_string())
            }
            StudyError::OtherQuantity { net, answers, wanted } => {
                let limit = format!("must be a net of the {wanted}, not of the {answers}");
                Self::argument("net", net, limit)
            }
            StudyError::SameDataset { first, again, id } => {
                let limit = format!("must be another dataset than {first}; both are {id}");
                Self::argument("dataset", again, limit)
            }
            StudyError::NoMethod { dataset } => Self::argument("dataset", dataset, NO_METHOD),
            StudyError::NoTrial { dataset, trial } => {
                Self::argument(&dataset, "none", format!("must have {trial}"))
            }
        }
    }
}
