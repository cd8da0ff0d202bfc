//! Training of Palpate's nets, in a separate process: reads an order, trains, writes the result.
//! Uses: burn, here alone; nets, `learn` of the chapter `touch`. Never: the store, HTTP, two processes
//! on one folder.

use palpate_data::dataset;
use palpate_model::simulate;
use palpate_store as store;
use palpate_touch::{infer, learn};
use palpate_words::{ids, new_file};

// A net as tensors, and its steps.
pub mod device;
mod upsample;
mod model;
mod loss;
mod adam;
pub mod answer;
pub mod train;

// A training of an order.
pub mod error;
mod rows;
pub mod recipe;
mod talk;
mod observer;
pub mod job;

#[cfg(test)]
mod against_torch;
#[cfg(all(test, feature = "gpu"))]
mod against_processor;
