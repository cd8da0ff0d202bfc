//! The studies: the tables and figures of the paper, computed again and compared with the published
//! values. A study asks a [`lab::Lab`] for trained nets and scores, and returns text, numbers and
//! figures.
//! Uses: `words`, `store`, `data`, `touch`. Never: the command line, HTTP, the terminal, files, a runtime.
//!
//! | module | paper | result |
//! |---|---|---|
//! | `simulation` | Fig. 7 | fit of simulated twins to the trials of a run |
//! | `method` | | scores of one method on one dataset |
//! | `quantity` | | positions, patterns, counts or forces: nets next to ridge and kernel ridge |
//! | `transfer` | Table III | Transfer-Nets by the number of contacts in training |
//! | `maps` | Table IV, Fig. 9 | Recon-Nets of twelve force maps |
//! | `noise` | Fig. 10 | residuals of a Transfer-Net, and maps at three levels of noise |
//! | `factorial` | Fig. 11 | pixel x diameter x noise, with an analysis of variance |
//! | `unseen` | Fig. 12, V-D | all methods on contacts that no net was trained on |

use palpate_data::dataset;
use palpate_model::figure;
use palpate_store as store;
use palpate_touch::{evaluate, infer, learn};
use palpate_words::{ids, plain};

pub mod lab;
pub mod budget;
pub mod sheet;
pub mod rows;
pub mod simulation;
pub mod method;
pub mod quantity;
pub mod transfer;
pub mod maps;
pub mod noise;
pub mod factorial;
pub mod unseen;
