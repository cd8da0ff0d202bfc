//! `palpate cluster sbatch table`: the trainings and evaluations of a table of the paper, as a work order.
//! Uses: `evaluate::lab` (a service resolves datasets), `jobs::chunks`, `studies`. Never: a training.

use clap::{Args, ValueEnum};

use super::OrderPlace;
use crate::chunk::order::WorkOrder;
use crate::cli::embed;
use crate::cli::error::CliError;
use crate::cli::evaluate::lab::{ExtentArgs, ServiceLab};
use crate::cli::output::Output;
use crate::jobs::chunks::{FIRST_GPU, ONE_THREAD, work_order};
use crate::studies::budget::R2S;
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
    /// The work order; datasets are made if needed.
    ///
    /// # Errors
    /// `CliError` if the service cannot be reached or started, or a recipe or a dataset is invalid.
    pub async fn order(&self, output: Output) -> Result<WorkOrder, CliError> {
        let at = self.place.at(output);
        let budget = self.extent.budget();
        let table = match self.table {
            TableName::Maps => table_iv_nets(&budget),
            TableName::Transfer => table_iii_nets(&budget, &self.dataset),
        };
        let nets = embed::with_server(&at, move |client| async move {
            let lab = ServiceLab::new(client, output, None);
            let mut nets = Vec::new();
            for net in &table {
                nets.push(lab.net_order(net).await?);
            }
            Ok(nets)
        });
        let compute = if self.gpu { FIRST_GPU } else { ONE_THREAD };
        Ok(work_order(nets.await?, compute))
    }

    /// Options of the job that the trainings need.
    pub fn resources(&self) -> &'static [&'static str] {
        if self.gpu { &GPU_RESOURCES } else { &[] }
    }
}
