//! The schemas of the lists in an experiment file: their lengths, and the limits of their values.
//! PURE. Uses: utoipa. Never: a limit that the parser does not enforce.

use serde_json::json;
use utoipa::openapi::schema::{Array, ArrayBuilder, Object, ObjectBuilder, SchemaType, Type};

/// Different numbers of tips or contacts.
pub(super) fn counts() -> Array {
    ArrayBuilder::new()
        .items(whole().minimum(Some(1)).maximum(Some(6)).build())
        .min_items(Some(1))
        .max_items(Some(6))
        .unique_items(true)
        .description(Some("Different counts from 1 to 6, in the order in which they are done."))
        .build()
}

/// Smallest and largest radius.
pub(super) fn radii() -> Array {
    ArrayBuilder::new()
        .items(whole().minimum(Some(2)).maximum(Some(15)).build())
        .min_items(Some(2))
        .max_items(Some(2))
        .default(Some(json!([2, 12])))
        .description(Some(
            "Smallest and largest radius, in pitches of the point lattice: [lower, upper].",
        ))
        .build()
}

/// Forces of weights, N.
pub(super) fn weights() -> Array {
    let positive = ObjectBuilder::new()
        .schema_type(SchemaType::Type(Type::Number))
        .exclusive_minimum(Some(0.0))
        .build();
    ArrayBuilder::new()
        .items::<Object>(positive)
        .min_items(Some(1))
        .description(Some("Forces of the weights, N."))
        .build()
}

fn whole() -> ObjectBuilder {
    ObjectBuilder::new().schema_type(SchemaType::Type(Type::Integer))
}
