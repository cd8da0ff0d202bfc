//! Fig. 12 and V-D: contacts that were in no training, by the paper's pipeline, both baselines, ridge and kernel
//! ridge regression, and the project's methods.
//! Uses: `lab`, `budget`, `rows`, `pictures`, `evaluate::{published, table}`. Never: training here.

use serde_json::json;

use crate::budget::{Budget, END_TO_END, R2S, RECON_NET, REGRESSIONS, Scale, most};
use crate::dataset::force_map::{ForceMapSpec, SIDE_MM};
use crate::evaluate::published::REAL_UNSEEN;
use crate::evaluate::request::{EvaluationReport, EvaluationRequest, FramesRead};
use crate::evaluate::table::{SCORE_COLUMNS, Uncertainty, markdown, published_row, score_row};
use crate::factorial::DIAMETERS_MM;
use crate::figure::Heading;
use crate::ids::{CalibrationId, ModelId};
use crate::infer::methods::Method;
use crate::lab::{DatasetFacts, Lab, Noise, StudyError, StudyResult, Training};
use crate::noise::LEVELS;
use crate::rows::{
    beats, coverage, paper_cost, perfects, read_by, reliability, score_rows, score_rows_note,
};
use crate::sheet::{OutputFile, Sheet};

#[cfg(test)]
mod every_figure;
mod pictures;

use pictures::{errors, examples, talk};

/// The recipe of the paper's Transfer-Net (V-A).
const PUBLISHED: &str = "transfer-net-published";
/// Condition on the trials that are drawn.
const TOUCHED: &str = "contact_count__gte=1";
/// Number of trials that are drawn.
const EXAMPLES: u64 = 3;

/// Methods that are scored, and the dataset on which they are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unseen {
    /// Name or id of the dataset.
    pub dataset: String,
    /// Id, start of the id, or name of a Point-Net, scored as `fast`; also proposes to `exact`.
    pub points: Option<String>,
    /// Id of a stored calibration, scored as `exact`.
    pub skin: Option<CalibrationId>,
    /// Skips the paper's nets.
    pub ours: bool,
}

/// A method's name and report.
type Named = (String, EvaluationReport);

/// Reports of the methods, by the group of the table in which they are.
struct Scores {
    /// The paper's pipeline: each map at each level of noise.
    pipeline: Vec<Named>,
    /// The baseline trained on measured trials only.
    end_to_end: Vec<Named>,
    /// The regressions on the rows of that baseline: name, and reports.
    regressions: Vec<(&'static str, Vec<Named>)>,
    /// The one-step reconstructions, Point-Net, and the fit through the exact model.
    ours: Vec<Named>,
    /// The best of the pipeline with the paper's Transfer-Net, if the budget has another one.
    published: Option<EvaluationReport>,
}

/// Scores all methods on contacts that no net was trained on, and draws some trials. Of a dataset with a split
/// the nets learn from the part train, and all methods are scored on the part test. Methods that need the
/// model of the rig's skin are skipped on others, and so are the pictures, which show that skin.
///
/// # Errors
/// Error of the lab if a training or an evaluation fails; `StudyError::NoMethod` if no method can be scored on
/// the dataset; `StudyError::Figure` if a figure cannot be drawn.
///
/// Source: paper, V-D and Fig. 12.
pub async fn fig_12<L: Lab>(lab: &L, budget: &Budget, unseen: &Unseen) -> Result<Sheet, L::Error> {
    let facts = lab.facts(&unseen.dataset).await?;
    if !facts.of_rig && (unseen.ours || !facts.has_parts) {
        let dataset = unseen.dataset.clone();
        return Err(StudyError::NoMethod { dataset }.into());
    }
    let study = Study { lab, budget, unseen, facts };
    let ours = study.ours().await?;
    let (mut pipeline, mut end_to_end, mut regressions) = (Vec::new(), Vec::new(), Vec::new());
    if !unseen.ours {
        pipeline = study.pipeline().await?;
        end_to_end = study.end_to_end(END_TO_END).await?;
        for (ending, name) in REGRESSIONS {
            let recipe = format!("{END_TO_END}-{ending}");
            regressions.push((name, study.end_to_end(&recipe).await?));
        }
    }
    let mut published = None;
    if let Some((_, report)) = best(&pipeline)
        && budget.transfer != PUBLISHED
    {
        published = Some(study.with_published(report).await?);
    }
    let scores = Scores { pipeline, end_to_end, regressions, ours, published };
    let columns = study.examples(&scores).await?;
    Ok(sheet(budget, &scores, &columns, &study.learned())?)
}

/// The arguments of the study, for its steps.
struct Study<'a, L> {
    lab: &'a L,
    budget: &'a Budget,
    unseen: &'a Unseen,
    facts: DatasetFacts,
}

impl<L: Lab> Study<'_, L> {
    /// Request for scores on the dataset, or on its part test; the scale does not limit its rows.
    fn request(&self, method: Method) -> EvaluationRequest {
        let part = self.facts.has_parts.then_some("test");
        let mut request = self.budget.request(method, &self.unseen.dataset, part);
        request.limit = self.budget.scored;
        request
    }

    /// A training on the dataset's part train, if it has one, with maps of the extent of its skin.
    fn training(&self, training: Training) -> Training {
        if !self.facts.has_parts {
            return training;
        }
        let map = training.map.map(|map| self.on_skin(map));
        Training { dataset: Some(self.unseen.dataset.clone()), map, ..training }
    }

    /// A map of the paper on the dataset's skin.
    fn on_skin(&self, map: ForceMapSpec) -> ForceMapSpec {
        if self.facts.of_rig { map } else { map.on_skin(self.facts.skin_mm) }
    }

    /// Sentence on what the nets learned, if it is not the paper's data.
    fn learned(&self) -> String {
        if !self.facts.has_parts {
            return String::new();
        }
        let dataset = &self.unseen.dataset;
        format!("The nets learned from the part train of {dataset}; its part test is scored.\n")
    }

    async fn ours(&self) -> Result<Vec<Named>, L::Error> {
        let Unseen { points, skin, .. } = self.unseen;
        let mut scores = Vec::new();
        if !self.facts.of_rig {
            return Ok(scores);
        }
        for (name, method) in
            [("one step, Tikhonov", Method::Tikhonov), ("one step, NOSER", Method::Noser)]
        {
            let mut request = self.request(method);
            request.skin = skin.clone();
            scores.push((name.into(), self.lab.score(&request).await?));
        }
        let reads = [("1 frame", FramesRead::First), ("mean", FramesRead::Mean)];
        let has = |frames: FramesRead| self.facts.has_first_frames || frames == FramesRead::Mean;
        for (read, frames) in reads.into_iter().filter(|(_, frames)| has(*frames)) {
            if points.is_some() {
                let mut request = self.request(Method::Fast);
                (request.points, request.frames) = (points.clone(), frames);
                scores.push((format!("fast, {read}"), self.lab.score(&request).await?));
            }
            let mut request = self.request(Method::Exact);
            (request.points, request.skin, request.frames) = (points.clone(), skin.clone(), frames);
            scores.push((format!("exact, {read}"), self.lab.score(&request).await?));
        }
        Ok(scores)
    }

    async fn pipeline(&self) -> Result<Vec<Named>, L::Error> {
        let mut scores = Vec::new();
        if self.facts.has_parts && !self.facts.has_simulated {
            return Ok(scores);
        }
        let training = self.budget.transfer_to_all(&self.contacts().await?);
        let transfer = self.lab.train(&self.training(training)).await?;
        for map in maps(self.budget) {
            for level in LEVELS {
                let training = self.budget.map_net(RECON_NET, map, Noise::at(level, &transfer));
                let net = self.lab.train(&self.training(training)).await?;
                let mut request = self.request(Method::Paper);
                request.transfer = Some(transfer.to_string());
                request.map = Some(net.to_string());
                let name = format!("{}, {:.0} %", self.on_skin(map), 100.0 * level);
                scores.push((name, self.lab.score(&request).await?));
            }
        }
        Ok(scores)
    }

    /// Numbers of contacts of the rows from which Transfer-Nets learn.
    async fn contacts(&self) -> Result<Vec<u32>, L::Error> {
        let has_parts = self.facts.has_parts;
        let own = has_parts.then(|| self.unseen.dataset.clone());
        self.lab.contact_numbers(&own.unwrap_or_else(|| self.budget.dataset(R2S))).await
    }

    /// Scores the best of the pipeline with the paper's Transfer-Net: least squares in volts.
    async fn with_published(&self, best: &EvaluationReport) -> Result<EvaluationReport, L::Error> {
        let most = most(&self.contacts().await?);
        let training = self.budget.transfer_by(PUBLISHED, "transfer-published", R2S, most);
        let transfer = self.lab.train(&self.training(training)).await?;
        let mut request = self.request(Method::Paper);
        request.transfer = Some(transfer.to_string());
        request.map = best.models.last().map(ModelId::to_string);
        self.lab.score(&request).await
    }

    /// Scores nets of a recipe, from measured voltages to each map.
    async fn end_to_end(&self, recipe: &str) -> Result<Vec<Named>, L::Error> {
        let mut scores = Vec::new();
        for map in maps(self.budget) {
            let training = self.training(self.budget.map_net(recipe, map, None));
            let net = self.lab.train(&training).await?;
            let mut request = self.request(Method::Paper);
            request.map = Some(net.to_string());
            scores.push((self.on_skin(map).to_string(), self.lab.score(&request).await?));
        }
        Ok(scores)
    }

    /// Answers of each drawn method to the first trials; none on another skin than the rig's.
    async fn examples(&self, scores: &Scores) -> Result<Vec<Named>, L::Error> {
        if !self.facts.of_rig {
            return Ok(Vec::new());
        }
        let mut requests = Vec::new();
        let bests =
            [("real-to-sim", best(&scores.pipeline)), ("end-to-end", best(&scores.end_to_end))];
        for (name, best) in bests {
            let Some((_, report)) = best else { continue };
            let mut request = self.request(Method::Paper);
            // Reports name the Transfer-Net first, if there is one.
            request.map = report.models.last().map(ModelId::to_string);
            let transfer = report.models.first().filter(|_| report.models.len() > 1);
            request.transfer = transfer.map(ModelId::to_string);
            requests.push((name, request));
        }
        for (name, method) in [("one step", Method::Tikhonov), ("exact", Method::Exact)] {
            let mut request = self.request(method);
            request.skin = self.unseen.skin.clone();
            if method == Method::Exact {
                request.points = self.unseen.points.clone();
            }
            requests.push((name, request));
        }
        let mut columns = Vec::new();
        for (name, mut request) in requests {
            (request.limit, request.examples) = (Some(EXAMPLES), EXAMPLES);
            request.conditions = vec![TOUCHED.into()];
            columns.push((name.into(), self.lab.score(&request).await?));
        }
        Ok(columns)
    }
}

/// The maps of Table IV; below full scale those of the factorial design.
fn maps(budget: &Budget) -> Vec<ForceMapSpec> {
    if budget.scale == Scale::Full {
        return budget.table_iv_maps();
    }
    let of_pixel = |pixel_mm| {
        DIAMETERS_MM.map(|diameter_mm| ForceMapSpec { pixel_mm, diameter_mm, side_mm: SIDE_MM })
    };
    budget.pixels_mm().into_iter().flat_map(of_pixel).collect()
}

/// The best by the paper's rule (V-D).
fn best(scores: &[Named]) -> Option<&Named> {
    let costs = scores.iter().filter_map(|named| Some((paper_cost(&named.1)?, named)));
    costs.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, named)| named)
}

/// Shows the scores. `columns`: answers to the drawn trials; `learned`: a sentence on the data of the nets.
fn sheet(budget: &Budget, scores: &Scores, columns: &[Named], learned: &str) -> StudyResult<Sheet> {
    let Scores { pipeline, end_to_end, regressions, ours, published } = scores;
    let mut groups = vec![("real-to-sim", pipeline), ("end-to-end", end_to_end)];
    groups.extend(regressions.iter().map(|(name, scores)| (*name, scores)));
    let nets = nets(&groups);
    let best_pipeline = best(pipeline);
    let mut table = Vec::new();
    if let Some((name, report)) = best_pipeline {
        table.extend(score_rows(&format!("real-to-sim, best: {name}"), report));
    }
    if let Some(report) = published {
        table.extend(score_rows("  the same, Transfer-Net as published", report));
    }
    if let Some((name, report)) = best(end_to_end) {
        table.extend(score_rows(&format!("end-to-end, best: {name}"), report));
    }
    for (name, scores) in regressions {
        let found = best(scores).into_iter();
        table.extend(found.flat_map(|(map, s)| score_rows(&format!("{name}, best: {map}"), s)));
    }
    table.push(published_row("paper, best of 36 of 4 to 20 mm, 1024 epochs", &REAL_UNSEEN));
    for (name, report) in ours {
        table.extend(score_rows(name, report));
    }
    let verdicts = verdicts(&groups);
    groups.push(("", ours));
    let all = || groups.iter().flat_map(|(_, scores)| scores.iter()).map(|(_, report)| report);
    table.extend(perfects(all()));
    let any = all().next();
    let label = any.map_or("", |report| report.label.as_str());
    let note = any.map_or_else(String::new, score_rows_note);
    let by_best = best_pipeline
        .map_or(String::new(), |(_, report)| format!("real-to-sim, best: {}", read_by(report)));
    let text = format!(
        "# Fig. 12: contacts that no net has seen, mean [95 % interval]\n\n{}\n{note}{verdicts}{}{}{nets}{by_best}{}\
         {learned}{}\n",
        markdown(&SCORE_COLUMNS, &table),
        coverage(named(ours)),
        reliability(named(ours)),
        ours.last().map_or(String::new(), |(_, exact)| format!("exact: {}\n", read_by(exact))),
        budget.caption(label)
    );
    let listed = |scores: &[Named]| -> Vec<_> {
        scores.iter().map(|(name, report)| json!({ "name": name, "report": report })).collect()
    };
    let of_regression = |(name, scores): &(&str, Vec<Named>)| -> serde_json::Value {
        json!({ "name": name, "nets": listed(scores) })
    };
    let compared: Vec<_> = regressions.iter().map(of_regression).collect();
    let numbers = json!({ "figure": "12", "scale": budget.scale.name(), "label": label,
        "real_to_sim": listed(pipeline), "end_to_end": listed(end_to_end),
        "regressions": compared, "ours": listed(ours),
        "verdicts": verdicts.lines().collect::<Vec<_>>(),
        "best": best_pipeline.map(|(name, _)| name), "best_with_published_transfer": published });
    let heading = Heading::new("", any.map_or(0, |report| report.rows), "trials", label)
        .with_note(format!("Scale {}", budget.scale.name()));
    let mut figures = errors(&heading, &groups)?;
    if !columns.is_empty() {
        figures.push(OutputFile::new("fig-12a.svg", examples(&heading, columns)?));
        figures.push(OutputFile::new("fig-12.svg", talk(&heading, scores, columns)?));
    }
    Ok(Sheet::new("fig-12", text, numbers, figures))
}

/// The reports with the names of their methods.
fn named(scores: &[Named]) -> impl Iterator<Item = (&str, &EvaluationReport)> {
    scores.iter().map(|(name, report)| (name.as_str(), report))
}

/// States whether the best net of each of the paper's groups, the first two, beats the best of each regression.
fn verdicts(groups: &[(&str, &Vec<Named>)]) -> String {
    let bests: Vec<_> = groups.iter().map(|(name, scores)| (name, best(scores))).collect();
    let (nets, regressions) = bests.split_at(2);
    let mut text = String::new();
    for (group, net) in nets {
        for (name, other) in regressions {
            let (Some((_, net)), Some((_, other))) = (net, other) else { continue };
            let Some(beats) = beats(net, other) else { continue };
            let words = if beats { "beats" } else { "does NOT beat" };
            text += &format!("The best {group} {words} the best of {name} by the paper's rule.\n");
        }
    }
    text
}

/// Table of the nets of these groups, if there are any.
fn nets(groups: &[(&str, &Vec<Named>)]) -> String {
    let mut rows = Vec::new();
    for (group, scores) in groups {
        let row = |(name, report): &Named| {
            let name = format!("{group} {name}");
            Some(score_row(&name, &report.contacts.as_ref()?.all, Uncertainty::Interval))
        };
        rows.extend(scores.iter().filter_map(row));
    }
    if rows.is_empty() {
        return String::new();
    }
    format!("All nets, by map and noise:\n\n{}\n", markdown(&SCORE_COLUMNS, &rows))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::small;
    use crate::lab::fake::{FakeLab, REAL_UNSEEN_FACTS, result};

    fn unseen(ours: bool) -> Unseen {
        Unseen { dataset: "real-unseen".into(), points: None, skin: None, ours }
    }

    #[test]
    fn the_papers_nets_are_trained_for_every_map_and_noise() {
        let lab = FakeLab::default();
        result(fig_12(&lab, &small(), &unseen(false))).unwrap();
        // A Transfer-Net, four maps at three levels of noise, four end-to-end nets, and two regressions of each.
        let trained = lab.trained.lock().unwrap();
        assert_eq!(trained.len(), 1 + 4 * 3 + 4 + 2 * 4);
        let recipe = |n: usize| trained[n].recipe.as_str();
        let recipes = ["end-to-end", "end-to-end-ridge", "end-to-end-kernel-ridge"];
        assert_eq!([recipe(13), recipe(17), recipe(21)], recipes);
        let same = |a: usize, b: usize| {
            let [a, b] = [a, b].map(|n| &trained[n]);
            (&a.dataset, a.map, a.rows) == (&b.dataset, b.map, b.rows)
        };
        assert!((13..17).all(|n| same(n, n + 4) && same(n, n + 8)), "{trained:?}");
        // Two one-step baselines, `exact` by the first frame and by the mean, and two examples.
        assert_eq!(lab.scored.lock().unwrap().len(), 2 + 2 + 4 * 3 + 4 + 2 * 4 + 2);
    }

    #[test]
    fn a_net_that_does_not_beat_a_regression_says_so() {
        // The fake lab scores all alike.
        let lab = FakeLab { scores: true, ..FakeLab::default() };
        let sheet = result(fig_12(&lab, &small(), &unseen(false))).unwrap();
        for words in ["real-to-sim does NOT beat the best of ridge", "| kernel ridge, best: 10x20"]
        {
            assert!(sheet.text.contains(words), "{words}: {}", sheet.text);
        }
        assert_eq!(sheet.numbers["regressions"][1]["nets"].as_array().unwrap().len(), 4);
        let verdicts = sheet.numbers["verdicts"].as_array().unwrap();
        let lost = |line: &serde_json::Value| line.as_str().unwrap().contains("does NOT beat");
        assert!(verdicts.len() == 4 && verdicts.iter().all(lost), "{verdicts:?}");
    }

    #[test]
    fn our_methods_need_no_training() {
        let lab = FakeLab::default();
        let sheet = result(fig_12(&lab, &small(), &unseen(true))).unwrap();
        assert!(lab.trained.lock().unwrap().is_empty());
        assert!(lab.scored.lock().unwrap().iter().all(|request| request.dataset == "real-unseen"));
        assert!(sheet.files.iter().any(|file| file.name == "fig-12a.svg"));
    }

    #[test]
    fn a_dataset_of_another_skin_trains_and_tests_the_nets_that_need_no_model() {
        let facts = DatasetFacts {
            has_parts: true,
            has_simulated: false,
            of_rig: false,
            has_first_frames: false,
            skin_mm: 100.0,
        };
        let lab = FakeLab { scores: true, facts: Some(facts), ..FakeLab::default() };
        let sheet =
            result(fig_12(&lab, &small(), &Unseen { dataset: "pad".into(), ..unseen(false) }));
        let sheet = sheet.unwrap();
        let trained = lab.trained.lock().unwrap();
        let maps: Vec<String> =
            trained.iter().map(|training| training.map.unwrap().to_string()).collect();
        let four = ["1.8x3.6x115.2", "1.8x10.8x115.2", "3.6x3.6x115.2", "3.6x10.8x115.2"];
        assert_eq!(maps, [four; 3].concat());
        assert!(trained.iter().all(|training| training.dataset.as_deref() == Some("pad")));
        assert!(trained.iter().all(|training| training.map.unwrap().checked().is_ok()));
        let scored = lab.scored.lock().unwrap();
        let of_test = |r: &EvaluationRequest| r.part.as_deref() == Some("test") && r.map.is_some();
        assert!(scored.len() == 12 && scored.iter().all(of_test), "{scored:?}");
        assert!(sheet.text.contains("part train of pad") && sheet.text.contains("virtual"));
        assert!(sheet.files.iter().any(|file| file.name == "fig-12-location.svg"));
        assert!(
            !sheet.files.iter().any(|file| file.name == "fig-12.svg"),
            "it shows the rig's skin"
        );
        // With twins, the whole pipeline.
        let lab = FakeLab {
            facts: Some(DatasetFacts { has_simulated: true, ..facts }),
            ..FakeLab::default()
        };
        result(fig_12(&lab, &small(), &unseen(false))).unwrap();
        assert_eq!(lab.trained.lock().unwrap().len(), 1 + 4 * 3 + 4 + 2 * 4);
        for (ours, has_parts) in [(true, true), (false, false)] {
            let facts = DatasetFacts { has_parts, ..facts };
            let lab = FakeLab { facts: Some(facts), ..FakeLab::default() };
            let refused = result(fig_12(&lab, &small(), &unseen(ours))).unwrap_err();
            assert!(matches!(refused, StudyError::NoMethod { .. }), "{refused}");
        }
    }

    #[test]
    fn means_without_raw_frames_are_scored_as_means() {
        let facts = DatasetFacts { has_first_frames: false, ..REAL_UNSEEN_FACTS };
        let lab = FakeLab { facts: Some(facts), ..FakeLab::default() };
        result(fig_12(&lab, &small(), &unseen(true))).unwrap();
        let scored = lab.scored.lock().unwrap();
        assert!(scored.iter().all(|request| request.frames == FramesRead::Mean));
        assert_eq!(scored.len(), 2 + 1 + 2);
    }
}
