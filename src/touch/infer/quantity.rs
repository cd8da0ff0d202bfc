//! Answers of nets that estimate a quantity of a whole frame: position, pattern, count or force.
//! Uses: `registry`, `plan`. Never: what serves; a frame of another length than the net's.

use nets::quantity::Quantity;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::error::InferResult;
use super::registry::Model;

/// The answer of a net to one frame; of the quantities, the one that it answers.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct QuantityAnswer {
    /// Position of the contact: x, y, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_mm: Option<[f32; 2]>,
    /// The known places that are pressed: x, y, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pressed_mm: Option<Vec<[f64; 2]>>,
    /// Number of contacts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub count: Option<u32>,
    /// Sum of the contacts' forces, N.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_n: Option<f32>,
    /// Properties of the frame outside the trained range of the model, as text.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outside: Vec<String>,
}

impl QuantityAnswer {
    /// The answers of two nets of different quantities to one frame.
    pub fn and(self, other: Self) -> Self {
        Self {
            position_mm: self.position_mm.or(other.position_mm),
            pressed_mm: self.pressed_mm.or(other.pressed_mm),
            count: self.count.or(other.count),
            force_n: self.force_n.or(other.force_n),
            outside: [self.outside, other.outside].concat(),
        }
    }
}

impl Model {
    /// The quantity that the net answers.
    ///
    /// # Errors
    /// `InferError::OtherTask` if it answers a map, a frame or points.
    pub fn quantity(&self) -> InferResult<Quantity> {
        let wanted = "a net that answers a position, pattern, count or force is needed";
        self.manifest.model.task.quantity().ok_or_else(|| self.of_other_task(wanted))
    }

    /// Answers frames, V, one after the other, each of the net's channels.
    ///
    /// # Errors
    /// `InferError::OtherTask` if the net answers no quantity; `Plan` if frames are incomplete or not
    /// finite.
    pub fn quantities(&self, frames: &[f32]) -> InferResult<Vec<QuantityAnswer>> {
        let quantity = self.quantity()?;
        let facts = &self.manifest.model;
        let mut numbers = Vec::new();
        self.plan.answer(frames, &mut numbers)?;
        let each = numbers.chunks_exact(quantity.len(facts.places_mm.len()));
        let answered = frames.chunks_exact(facts.channels).zip(each).map(|(frame, numbers)| {
            let outside = facts.trained_on.frame(frame).map(|out| out.to_string());
            let answer = QuantityAnswer {
                outside: outside.into_iter().collect(),
                ..QuantityAnswer::default()
            };
            match quantity {
                Quantity::Position => {
                    QuantityAnswer { position_mm: Some([numbers[0], numbers[1]]), ..answer }
                }
                Quantity::Pattern => {
                    let pressed = facts.places_mm.iter().zip(numbers).filter(|(_, y)| **y > 0.0);
                    let pressed = pressed.map(|(place_mm, _)| *place_mm).collect();
                    QuantityAnswer { pressed_mm: Some(pressed), ..answer }
                }
                Quantity::Count => {
                    QuantityAnswer { count: Some(numbers[0].round().max(0.0) as u32), ..answer }
                }
                Quantity::Force => QuantityAnswer { force_n: Some(numbers[0]), ..answer },
            }
        });
        Ok(answered.collect())
    }
}
