//! The pictures of Fig. 12: maps of some trials, errors of all methods, and both in one for a talk.
//! PURE. Uses: `evaluate::{charts, force_maps, opening}`. Never: scores computed here.

use super::{EXAMPLES, Named, Scores, best};
use crate::dataset::force_map::{ForceMapSpec, TABLE_IV_MAPS};
use crate::evaluate::charts::{Bar, bars};
use crate::evaluate::figures::FigureResult;
use crate::evaluate::force_maps::{Picture, pictures};
use crate::evaluate::opening::{Answer, Rank, Role, Row, opening};
use crate::evaluate::published::REAL_UNSEEN;
use crate::evaluate::request::{EvaluationReport, Example};
use crate::evaluate::score::{Mean, Score};
use crate::figure::Heading;
use crate::infer::methods::Method;
use crate::sheet::OutputFile;
use crate::store::Contact;

/// Fig. 12A: trials with each method's answer, one row each, true contacts first.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn examples(heading: &Heading, columns: &[Named]) -> FigureResult<String> {
    let mut maps = Vec::new();
    for row in 0..EXAMPLES as usize {
        let of_row = columns.iter().filter_map(|(name, report)| {
            Some((name.as_str(), report.map.as_deref()?.parse().ok()?, report.examples.get(row)?))
        });
        let of_row: Vec<(&str, ForceMapSpec, &Example)> = of_row.collect();
        let Some((_, _, first)) = of_row.first() else { break };
        let name = format!("{} contacts", first.truth.len());
        maps.push(Picture::of_contacts(&name, TABLE_IV_MAPS[0], &first.truth)?);
        for (name, spec, example) in of_row {
            maps.push(match &example.reading.force_map_n {
                Some(map) => Picture { name: name.into(), spec, map: map.clone() },
                None => {
                    let found: Vec<Contact> =
                        example.reading.contacts.iter().map(Contact::from).collect();
                    Picture::of_contacts(name, spec, &found)?
                }
            });
        }
    }
    let title = "Fig. 12A: true contacts, and the answer of each method";
    let heading = Heading { n: (maps.len() / (1 + columns.len())) as u64, ..heading.titled(title) };
    pictures(&heading, &maps, 1 + columns.len())
}

/// Fig. 12 as one picture: the drawn trials on the skin, and the location error of each method.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn talk(heading: &Heading, scores: &Scores, columns: &[Named]) -> FigureResult<String> {
    let answer = |report: &EvaluationReport, row: usize| {
        let reading = &report.examples.get(row)?.reading;
        let spec = report.map.as_deref().and_then(|map| map.parse().ok());
        // Of methods without a map the contacts are drawn alone.
        let net = report.scored == Method::Paper.into();
        let map = reading.force_map_n.as_ref().filter(|_| net).zip(spec);
        let map = map.map(|(map, spec)| Picture { name: String::new(), spec, map: map.clone() });
        Some(Answer { contacts: reading.contacts.iter().map(Contact::from).collect(), map })
    };
    let row = |at: usize| {
        let truth = columns.iter().find_map(|(_, report)| report.examples.get(at))?.truth.clone();
        let answers = columns.iter().map(|(_, report)| {
            answer(report, at).unwrap_or(Answer { contacts: Vec::new(), map: None })
        });
        Some(Row { truth, answers: answers.collect() })
    };
    let rows: Vec<Row> = (0..EXAMPLES as usize).map_while(row).collect();
    let methods: Vec<String> = columns.iter().map(|(name, _)| name.clone()).collect();
    let heading = heading.titled("Where and how hard: contacts that no net has seen");
    opening(&heading, &methods, &rows, &ranks(scores))
}

/// Location errors: the best of each kind of net, all other methods, and the paper's.
fn ranks(scores: &Scores) -> Vec<Rank> {
    let rank = |name: String, score: &Score, mean: Mean, role: Role| Rank {
        name,
        mean_mm: mean.mean,
        interval_mm: mean.low_95.zip(mean.high_95).map(|(low, high)| [low, high]),
        n: mean.n,
        answers_per_contact: (score.contacts > 0)
            .then(|| score.estimates as f64 / score.contacts as f64),
        role,
    };
    let of = |name: &str, report: &EvaluationReport, role: Role| {
        let score = &report.contacts.as_ref()?.all;
        Some(rank(name.into(), score, score.location_mm?, role))
    };
    let bests = [("real-to-sim", &scores.pipeline), ("end-to-end", &scores.end_to_end)];
    let nets = bests.into_iter().filter_map(|(name, group)| of(name, &best(group)?.1, Role::Paper));
    let ours = scores.ours.iter().filter_map(|(name, report)| of(name, report, Role::Ours));
    let mut all: Vec<Rank> = nets.chain(ours).collect();
    let any = scores.pipeline.iter().chain(&scores.ours).map(|(_, report)| report);
    let perfect = any.filter_map(|report| {
        let score = &report.perfect.as_ref()?.all;
        Some(rank("perfect map".into(), score, score.location_mm?, Role::Perfect))
    });
    all.extend(perfect.take(1));
    if !all.is_empty() {
        all.push(Rank {
            name: "paper (measured)".into(),
            mean_mm: REAL_UNSEEN.location_mm.mean,
            interval_mm: None,
            n: 0,
            answers_per_contact: None,
            role: Role::Published,
        });
    }
    all
}

/// Figures of the errors of location, mm, force and diameter, %: one bar per method.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn errors(heading: &Heading, groups: &[(&str, &Vec<Named>)]) -> FigureResult<Vec<OutputFile>> {
    type Pick = fn(&Score) -> Option<Mean>;
    let quantities: [(&str, &str, Pick); 3] = [
        ("location", "contact location error (mm)", |score| score.location_mm),
        ("force", "contact force error (%)", |score| score.force_percent),
        ("diameter", "contact diameter error (%)", |score| score.diameter_percent),
    ];
    let mut figures = Vec::new();
    for (key, words, pick) in quantities {
        let mut all = Vec::new();
        for (group, scores) in groups {
            all.extend(scores.iter().filter_map(|(name, report)| {
                let mean = pick(&report.contacts.as_ref()?.all)?;
                let name = format!("{group} {name}").trim().to_owned();
                Some(Bar { name, mean: mean.mean, sd: mean.sd.unwrap_or(0.0), n: mean.n })
            }));
        }
        if !all.is_empty() {
            let heading = heading.titled(format!("Fig. 12: {words} of all methods"));
            let figure = bars(&heading, words, &all)?;
            figures.push(OutputFile::new(format!("fig-12-{key}.svg"), figure));
        }
    }
    Ok(figures)
}
