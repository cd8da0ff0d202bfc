//! `palpate cluster sbatch table`: the trainings and evaluations of a table of the paper, as a work order with the files
//! of their datasets.
//! Uses: `evaluate::lab` (a service resolves datasets), `jobs::chunks`, `studies`. Never: a training.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use clap::{Args, ValueEnum};

use super::OrderPlace;
use crate::chunk::folder::{OrderFolder, input_file};
use crate::cli::client::Client;
use crate::cli::download::download_whole;
use crate::cli::embed;
use crate::cli::error::{CliError, CliResult};
use crate::cli::evaluate::lab::{ExtentArgs, ServiceLab};
use crate::jobs::chunks::{DatasetFile, FIRST_GPU, ONE_THREAD, work_order};
use crate::new_file::{Finished, Look};
use crate::studies::budget::R2S;
use crate::studies::lab::Lab;
use crate::studies::maps::table_iv_nets;
use crate::studies::transfer::table_iii_nets;

/// Options of a job that trains on a GPU.
const GPU_RESOURCES: [&str; 1] = ["gres=gpu:1"];

/// Tables whose nets do not need one another.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum TableName {
    /// Table IV: Recon-Nets of twelve force maps.
    Maps,
    /// Table III: Transfer-Nets by the number of contacts in training.
    Transfer,
}

/// Options that determine the nets of a table.
#[derive(Debug, Clone, Args)]
pub struct TableRequest {
    /// Table whose nets are trained, as `palpate evaluate` names it.
    #[arg(value_enum, value_name = "TABLE")]
    table: TableName,
    /// The dataset of the table transfer, as of `palpate evaluate transfer`.
    #[arg(long, value_name = "NAME", default_value = R2S)]
    dataset: String,
    #[command(flatten)]
    extent: ExtentArgs,
    /// Train on the first NVIDIA GPU of a task, for which the trainer was built.
    #[arg(long)]
    gpu: bool,
    #[command(flatten)]
    pub place: OrderPlace,
}

impl TableRequest {
    /// Writes the work order into a folder, with the files of its datasets, which are made if needed. Returns the
    /// folder, and whether the order is new there.
    ///
    /// # Errors
    /// `CliError` if the service cannot be reached or started, a recipe or a dataset is invalid, the folder contains
    /// another order, or a file cannot be downloaded or written.
    pub async fn write(&self, folder: &Path, json: bool) -> CliResult<(OrderFolder, bool)> {
        let at = self.place.at(json);
        let budget = self.extent.budget();
        let compute = if self.gpu { FIRST_GPU } else { ONE_THREAD };
        embed::with_purpose(&at, embed::Purpose::Computes, async |client| {
            let lab = ServiceLab::new(client.clone(), at.output(), None);
            let table = match self.table {
                TableName::Maps => table_iv_nets(&budget),
                TableName::Transfer => {
                    let contacts = lab.contact_numbers(&budget.dataset(&self.dataset)).await?;
                    table_iii_nets(&budget, &self.dataset, &contacts)
                }
            };
            let mut nets = Vec::new();
            for net in &table {
                nets.push(lab.net_order(net).await?);
            }
            let datasets = nets.iter().map(|net| (net.dataset.sha256.clone(), net.dataset.clone()));
            let datasets: BTreeMap<String, DatasetFile> = datasets.collect();
            let written = OrderFolder::write(folder, work_order(nets, compute))?;
            for dataset in datasets.values() {
                copy(client, dataset, &input_file(folder, &dataset.sha256)).await?;
            }
            Ok(written)
        })
        .await
    }

    /// Options of the job that the trainings need.
    pub fn resources(&self) -> &'static [&'static str] {
        if self.gpu { &GPU_RESOURCES } else { &[] }
    }
}

/// Downloads the file of a dataset, unless it is there.
async fn copy(client: &Client, dataset: &DatasetFile, path: &Path) -> CliResult<()> {
    let failed = |source| CliError::File { path: path.into(), source };
    let whole = Finished { bytes: dataset.bytes, sha256: dataset.sha256.clone() };
    if whole.is_at(path, Look::Sha256).map_err(failed)? {
        return Ok(());
    }
    if let Some(folder) = path.parent() {
        // As readable as the other folders of the order.
        fs::create_dir_all(folder).map_err(failed)?;
    }
    let url = format!("/api/v1/data/{}.parquet", dataset.id);
    download_whole(client, &url, &whole, path).await
}
