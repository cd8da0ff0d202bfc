//! The recipes that the program carries, from which trainings begin.
//! Uses: `carried`, `learn::recipe`, `dataset::force_map`. Never: a training (`jobs` requests it).

use serde::Serialize;
use utoipa::ToSchema;

use super::pages::Page;
use super::problem::ApiResult;
use crate::carried::{RECIPES, about};
use crate::dataset::force_map::{ForceMapSpec, TABLE_IV_MAPS};
use crate::learn::recipe::{Net, Recipe, map_channels};

/// A recipe that the program carries.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct CarriedRecipe {
    /// Name of the recipe.
    pub name: String,
    /// The comment at the start of the file.
    pub about: String,
    /// Text of the file, for a training.
    pub text: String,
    /// Force maps of the paper's Table IV that its net can be trained for; empty if its answers are no
    /// force maps.
    pub maps: Vec<RecipeMap>,
}

/// A force map, and the keys of a recipe that follow from it.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct RecipeMap {
    /// Key `map`: pixel and diameter, mm, as `4x20`.
    pub map: String,
    /// Key `training.net.side`: number of pixels along a side of the map.
    pub side: usize,
    /// Key `training.net.channels`; null: the default of the net.
    pub channels: Option<Vec<i64>>,
}

impl RecipeMap {
    fn of(map: &ForceMapSpec, net: &Net) -> Self {
        let side = map.pixels();
        let channels = map_channels(net, side as i64).map(Vec::from);
        Self { map: map.to_string(), side, channels }
    }
}

/// Returns the recipes that the program carries.
#[utoipa::path(get, operation_id = "list_recipes", path = "/api/v1/recipes", tag = "jobs",
    responses((status = 200, body = Page<CarriedRecipe>)))]
pub async fn list() -> ApiResult<Page<CarriedRecipe>> {
    Ok(Page::whole(RECIPES.iter().map(carried).collect()))
}

fn carried((name, text): &(&str, &str)) -> CarriedRecipe {
    let recipe = Recipe::from_toml(&format!("{name}.toml"), text).ok();
    let net = recipe.filter(|recipe| recipe.task().gives_map()).map(|recipe| recipe.training.net);
    let maps = |net: Net| TABLE_IV_MAPS.iter().map(|map| RecipeMap::of(map, &net)).collect();
    CarriedRecipe {
        name: (*name).into(),
        about: about(text),
        text: (*text).into(),
        maps: net.map_or_else(Vec::new, maps),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recipe_is_valid_as_it_is_and_with_each_of_its_maps() {
        let recipes: Vec<CarriedRecipe> = RECIPES.iter().map(carried).collect();
        let with_maps = recipes.iter().filter(|recipe| recipe.maps.len() == TABLE_IV_MAPS.len());
        let names: Vec<&str> = with_maps.map(|recipe| recipe.name.as_str()).collect();
        let regressions = ["ridge", "kernel-ridge"];
        let of = |stem: &str| regressions.map(|kind| format!("{stem}-{kind}"));
        let mut known = [of("end-to-end"), of("recon")].concat();
        known.extend(["end-to-end", "recon-net"].map(str::to_owned));
        known.sort();
        assert_eq!(names, known);
        for recipe in recipes {
            assert!(recipe.about.ends_with('.'), "{}", recipe.name);
            Recipe::from_toml(&recipe.name, &recipe.text).unwrap();
            for RecipeMap { map, side, channels } in recipe.maps {
                let mut table: toml::Table = toml::from_str(&recipe.text).unwrap();
                table.insert("map".into(), map.into());
                let training = table.get_mut("training").and_then(|t| t.as_table_mut()).unwrap();
                let net = training.get_mut("net").and_then(|net| net.as_table_mut()).unwrap();
                net.insert("side".into(), (side as i64).into());
                if let Some(channels) = channels {
                    net.insert("channels".into(), channels.into());
                }
                Recipe::from_toml(&recipe.name, &toml::to_string(&table).unwrap()).unwrap();
            }
        }
    }
}
