//! `palpate vocabulary` and `palpate evaluate published`: the names that requests use, and the values that the paper
//! prints.
//! Uses: `client`, `table`. Never: a copy of a list (the service states them).

use clap::Args;
use serde_json::Value;

use super::error::{CliError, CliResult};
use super::output::{Output, say, say_json};
use super::table::{Table, or_dash};
use super::view::rows;
use super::{At, embed};

/// Options of `vocabulary`.
#[derive(Debug, Clone, Args)]
pub struct VocabularyArgs {
    /// List to show, such as flags, trips or formats; all if absent.
    pub list: Option<String>,
    #[command(flatten)]
    pub at: At,
}

/// Prints the names that requests and answers use; as JSON the answer of the service.
///
/// # Errors
/// `CliError` if there is no such list, or the service cannot be reached.
pub async fn vocabulary(args: VocabularyArgs) -> CliResult<()> {
    let output = args.at.output();
    let words = read(&args.at, "/api/v1/vocabulary").await?;
    let found = args.list.as_ref().map_or(Some(&words), |list| words.get(list));
    match found.filter(|_| output == Output::Json) {
        Some(found) => say_json(found),
        None => say(table(&words, args.list.as_deref())?),
    }
    Ok(())
}

/// Prints the values of the paper's Tables III and IV; as JSON all that the service states.
///
/// # Errors
/// `CliError` if the service cannot be reached.
pub async fn published(at: &At) -> CliResult<()> {
    let values = read(at, "/api/v1/published").await?;
    let words = format!(
        "Table III, Transfer-Net: RMSE in V / FVU in %, by number of contacts\n{}\n\n\
         Table IV, Recon-Net alone, and V-D, the whole pipeline\n{}",
        transfer(&values),
        maps(&values),
    );
    at.output().say(&values, words);
    Ok(())
}

async fn read(at: &At, path: &'static str) -> CliResult<Value> {
    embed::with_purpose(at, embed::Purpose::Reads, async |client| client.get(path).await).await
}

fn table(words: &Value, list: Option<&str>) -> CliResult<Table> {
    let lists: Vec<(&String, &Vec<Value>)> = words
        .as_object()
        .into_iter()
        .flatten()
        .filter_map(|(name, items)| Some((name, items.as_array()?)))
        .collect();
    if let Some(wanted) = list.filter(|wanted| lists.iter().all(|(name, _)| name != wanted)) {
        let names: Vec<&str> = lists.iter().map(|(name, _)| name.as_str()).collect();
        let limit = format!("must be one of {}", names.join(", "));
        return Err(CliError::argument("LIST", wanted, limit));
    }
    let mut table = Table::new("list | name | meaning", "the service states no names");
    for (name, items) in lists.iter().filter(|(name, _)| list.is_none_or(|list| *name == list)) {
        for item in *items {
            table.push([(*name).clone(), text(&item["name"]), meaning(item)]);
        }
    }
    Ok(table)
}

/// What a name means; of a force map its pixel and its diameter.
fn meaning(item: &Value) -> String {
    match (item["about"].as_str(), &item["pixel_mm"], &item["diameter_mm"]) {
        (Some(about), ..) => about.to_owned(),
        (None, pixel, diameter) => format!("pixels of {pixel} mm, diameter {diameter} mm"),
    }
}

fn text(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

fn transfer(values: &Value) -> Table {
    let heads = "trained on | 1> | 2> | 3> | 4> | 5> | 6>";
    let mut table = Table::new(heads, "the service states no values");
    for rung in rows(values, "table_iii") {
        let cells = rows(rung, "test").iter();
        let cells = cells.map(|cell| format!("{} / {}", cell["rmse_v"], cell["fvu_percent"]));
        table.push([format!("1 to {}", rung["trained_to"])].into_iter().chain(cells));
    }
    table
}

fn maps(values: &Value) -> Table {
    let mut table = Table::new(
        "map | number error, %> | location error, mm> | force error, %> | diameter error, %>",
        "the service states no values",
    );
    let mut row = |name: String, score: &Value| {
        let spread = |key: &str| {
            let mean = score[key]["mean"].as_f64();
            let sd = score[key]["sd"].as_f64().map_or_else(String::new, |sd| format!(" ± {sd}"));
            or_dash(mean.map(|mean| format!("{mean}{sd}")))
        };
        let keys = ["number_percent", "location_mm", "force_percent", "diameter_percent"];
        table.push([name].into_iter().chain(keys.map(spread)));
    };
    for map in rows(values, "table_iv") {
        row(text(&map["map"]), &map["score"]);
    }
    row("Real-Unseen".into(), &values["real_unseen"]);
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_list_is_shown_alone_and_an_unknown_one_is_refused_with_the_lists() {
        let words = json!({ "flags": [{ "name": "doubted", "about": "Stored although." }],
            "maps": [{ "name": "4x20", "pixel_mm": 4.0, "diameter_mm": 20.0 }],
            "simulation": { "contacts_max": 6 } });
        let all = table(&words, None).unwrap().to_string();
        assert!(all.contains("Stored although.") && all.contains("pixels of 4.0 mm"), "{all}");
        let flags = table(&words, Some("flags")).unwrap().to_string();
        assert_eq!(flags.lines().count(), 2, "{flags}");
        let refused = table(&words, Some("flag")).unwrap_err().to_string();
        assert!(refused.contains("must be one of flags, maps"), "{refused}");
    }

    #[test]
    fn a_printed_mean_without_a_deviation_is_shown_alone() {
        let score = |sd: Option<f64>| {
            let mean = json!({ "mean": 11.0, "sd": sd });
            json!({ "number_percent": mean, "location_mm": mean, "force_percent": mean,
                "diameter_percent": mean })
        };
        let values = json!({ "table_iv": [{ "map": "4x20", "score": score(Some(22.0)) }],
            "real_unseen": score(None), "table_iii": [{ "trained_to": 1,
            "test": vec![json!({ "rmse_v": 0.003, "fvu_percent": 4.8 }); 6] }] });
        let shown = maps(&values).to_string();
        assert_eq!(shown.matches("11 ± 22").count(), 4, "{shown}");
        assert_eq!(shown.matches('±').count(), 4, "{shown}");
        assert_eq!(transfer(&values).to_string().matches("0.003 / 4.8").count(), 6);
    }
}
