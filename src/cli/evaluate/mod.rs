//! `palpate evaluate`: runs the studies of the paper's tables and figures with a service, and shows
//! their results.
//! Uses: `studies`, `client`. Never: computed scores (the service trains and scores).

use clap::{Args, Subcommand};

use super::error::{CliError, CliResult};
use super::infer::methods;
use super::train::quantities;
use super::{At, embed, vocabulary};
use crate::evaluate::request::{EvaluationRequest, FramesRead, OffsetsRead};
use crate::ids::CalibrationId;
use crate::infer::methods::Method;
use crate::learn::targets::Quantity;
use crate::studies;
use crate::studies::budget::{Budget, R2S};
use crate::studies::factorial::fig_11;
use crate::studies::maps::table_iv;
use crate::studies::method::scores;
use crate::studies::noise::fig_10;
use crate::studies::quantity::Compared;
use crate::studies::transfer::table_iii;
use crate::studies::unseen::{Unseen, fig_12};
use lab::{LabArgs, with_lab};

pub mod lab;
mod simulation;

/// Options of `evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Table or figure to compute.
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Compare simulated twins with a run's trials: RMSE, FVU, deadband, as in the paper's Fig. 7.
    ///
    /// Waits until every trial has its twin. With --out it writes simulation.json, one CSV per
    /// table and one SVG per figure.
    Simulation(simulation::SimulationArgs),
    /// Score a method on a dataset: estimated compared with true contacts, by their number and their spacing.
    Method {
        #[command(flatten)]
        method: MethodRequest,
        #[command(flatten)]
        lab: LabArgs,
    },
    /// Compare nets with ridge and kernel ridge regression on a position, pattern, count or force.
    ///
    /// For any skin, also of imported trials. Trains both regressions and the nets of --recipe on the
    /// dataset's rows, and scores all of them on the same rows of its part test. Of several datasets,
    /// such as one for each batch that is excluded from training, the table has the mean, too.
    Quantity {
        /// Quantity: position (of one contact), pattern (of known places), count or force.
        #[arg(value_name = "QUANTITY", value_parser = quantities())]
        quantity: Quantity,
        /// Name or id of a dataset with a split; may be repeated.
        #[arg(long = "dataset", value_name = "NAME", default_value = "real")]
        datasets: Vec<String>,
        /// A condition on its rows; may be repeated.
        #[arg(long = "where", value_name = "CONDITION")]
        conditions: Vec<String>,
        /// A recipe to train: a carried one, or a file; may be repeated [default: mlp].
        #[arg(long = "recipe", value_name = "RECIPE")]
        recipes: Vec<String>,
        /// Id, start of the id, or name of a trained net; may be repeated.
        #[arg(long = "net", value_name = "MODEL")]
        nets: Vec<String>,
        #[command(flatten)]
        lab: LabArgs,
    },
    /// Table III: Transfer-Nets trained on 1, 1 to 2, .. 1 to 6 contacts, tested on each number.
    ///
    /// No net is trained up to a number of contacts that no trial of the part train has.
    Transfer {
        /// Name of the dataset.
        #[arg(long, value_name = "NAME", default_value = R2S)]
        dataset: String,
        #[command(flatten)]
        lab: LabArgs,
    },
    /// Table IV and Fig. 9: Recon-Nets of twelve force maps, on simulated voltages.
    Maps(LabArgs),
    /// Fig. 10: residuals of the Transfer-Net, and one trial's maps at three levels of noise.
    Noise(LabArgs),
    /// Fig. 11: pixel size x diameter x noise, with a three-factor analysis of variance.
    Factorial(LabArgs),
    /// Fig. 12 and V-D: the paper's pipeline, both baselines and our methods on Real-Unseen.
    Unseen {
        /// Id, start of the id, or name of a Point-Net, scored as `fast`; also proposes to `exact`.
        #[arg(long, value_name = "MODEL")]
        points: Option<String>,
        /// Id of a calibration stored in the service, scored as `exact` [default: the serving one].
        #[arg(long, value_name = "CAL")]
        skin: Option<String>,
        /// Skip the paper's nets: score our methods only.
        #[arg(long)]
        ours: bool,
        /// Name or id of the dataset, also of imported trials. If it has a split, nets learn from its part train,
        /// and its part test is scored.
        #[arg(long, value_name = "NAME", default_value = "real-unseen")]
        dataset: String,
        #[command(flatten)]
        lab: LabArgs,
    },
    /// Show the values that the paper prints; nothing is computed.
    Published(At),
}

/// Options that determine the scores of a method, except for their extent.
#[derive(Debug, Clone, Args)]
pub struct MethodRequest {
    /// Method from a frame to contacts.
    #[arg(value_name = "METHOD", value_parser = methods(Method::ALL.into_iter()))]
    method: Method,
    /// Name or id of a dataset.
    #[arg(long, value_name = "NAME", default_value = "real-unseen")]
    dataset: String,
    /// Part: train, validation or test; all rows if absent.
    #[arg(long, value_name = "PART")]
    part: Option<String>,
    /// A condition on its rows; may be repeated.
    #[arg(long = "where", value_name = "CONDITION")]
    conditions: Vec<String>,
    /// Id, start of the id, or name of a Transfer-Net.
    #[arg(long, value_name = "MODEL")]
    with_transfer: Option<String>,
    /// Id, start of the id, or name of a net for maps.
    #[arg(long, value_name = "MODEL")]
    map: Option<String>,
    /// Id, start of the id, or name of a Point-Net.
    #[arg(long, value_name = "MODEL")]
    points: Option<String>,
    /// Id of a calibration stored in the service [default: the serving one].
    #[arg(long, value_name = "CAL")]
    skin: Option<String>,
    /// Read only the first frame of each trial, instead of the mean of all.
    #[arg(long)]
    first_frame: bool,
    /// Take the offsets of the calibration off, not those of the untouched skin before each trial.
    #[arg(long)]
    calibrated_offsets: bool,
    /// Least force of a peak, N [default: 5]
    ///
    /// For a map of another square than 640 mm: an eighth of the largest force in the training of its net, if that
    /// is less.
    #[arg(long, value_name = "N")]
    threshold_n: Option<f64>,
    /// Skip contacts of exact whose position has a larger standard deviation than this, mm.
    #[arg(long, value_name = "MM")]
    place_sd_mm: Option<f64>,
}

/// Runs `palpate evaluate`.
///
/// # Errors
/// `CliError` if a training or an evaluation fails, or a file cannot be written.
pub async fn evaluate(args: EvaluateArgs) -> CliResult<()> {
    match args.what {
        What::Simulation(args) => {
            embed::command(&args.at, embed::Purpose::Computes, &args, simulation::simulation).await
        }
        What::Method { method, lab } => {
            with_lab(lab, async |lab, budget| scores(lab, &method.request(budget)).await).await
        }
        What::Quantity { quantity, datasets, conditions, recipes, nets, lab } => {
            for (at, name) in datasets.iter().enumerate() {
                if datasets[..at].contains(name) {
                    return Err(CliError::argument("dataset", name, "must be named once"));
                }
            }
            let default = recipes.is_empty() && nets.is_empty();
            let recipes = if default { vec!["mlp".into()] } else { recipes };
            let compared = Compared { quantity, datasets, conditions, recipes, nets };
            with_lab(lab, async |lab, budget| {
                studies::quantity::quantity(lab, budget, &compared).await
            })
            .await
        }
        What::Transfer { dataset, lab } => {
            with_lab(lab, async |lab, budget| table_iii(lab, budget, &dataset).await).await
        }
        What::Maps(args) => with_lab(args, async |lab, budget| table_iv(lab, budget).await).await,
        What::Noise(args) => with_lab(args, async |lab, budget| fig_10(lab, budget).await).await,
        What::Factorial(args) => {
            with_lab(args, async |lab, budget| fig_11(lab, budget).await).await
        }
        What::Unseen { points, skin, ours, dataset, lab } => {
            // The service checks the id when it reads the calibration.
            let skin = skin.map(CalibrationId::unchecked);
            let unseen = Unseen { dataset, points, skin, ours };
            with_lab(lab, async |lab, budget| fig_12(lab, budget, &unseen).await).await
        }
        What::Published(at) => vocabulary::published(&at).await,
    }
}

impl MethodRequest {
    /// The request for scores; the scale does not limit its rows.
    pub fn request(self, budget: &Budget) -> EvaluationRequest {
        EvaluationRequest {
            limit: budget.scored,
            conditions: self.conditions,
            transfer: self.with_transfer,
            map: self.map,
            points: self.points,
            // The service checks the id when it reads the calibration.
            skin: self.skin.map(CalibrationId::unchecked),
            threshold_n: self.threshold_n,
            place_sd_mm: self.place_sd_mm,
            frames: if self.first_frame { FramesRead::First } else { FramesRead::Mean },
            offsets: match self.calibrated_offsets {
                true => OffsetsRead::Calibration,
                false => OffsetsRead::Untouched,
            },
            ..budget.request(self.method, &self.dataset, self.part.as_deref())
        }
    }
}
