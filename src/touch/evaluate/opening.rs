//! Fig. 12 as one picture: trials that no net has seen with the answers of the methods on the skin,
//! next to the location errors of all methods.
//! PURE. Uses: plotters, `figure`, `evaluate::{figures, force_maps}`. Never: files, a contact that no
//! method has answered.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::charts::{from_top, segments};
use super::figures::{FigureResult, page};
use super::force_maps::Picture;
use crate::dataset::read::PAPER_SKIN;
use crate::figure::style::{AxesStyle, COLOURS, INK, SMALL, TEXT, TINY, framed, plain};
use crate::figure::{Area, Drawn, Heading, NumberChart, PageSize, with_n};
use crate::store::Contact;

/// A method's answer to a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// Estimated contacts, mm and N.
    pub contacts: Vec<Contact>,
    /// Force map of the net, if it has one.
    pub map: Option<Picture>,
}

/// A trial: its true contacts, and the answers in the order of the methods.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Contacts that were measured, mm and N.
    pub truth: Vec<Contact>,
    /// Answer of each method.
    pub answers: Vec<Answer>,
}

/// Location error of a method.
#[derive(Debug, Clone, PartialEq)]
pub struct Rank {
    /// Name of the method.
    pub name: String,
    /// Mean location error, mm.
    pub mean_mm: f64,
    /// 95 % interval of the mean, mm, if known.
    pub interval_mm: Option<[f64; 2]>,
    /// Number of contacts in the mean; 0 for a published value without one.
    pub n: u64,
    /// Number of answers per true contact, if known: many answers are close to every contact.
    pub answers_per_contact: Option<f64>,
    /// Source of the value.
    pub role: Role,
}

/// Whose value it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Computed here, a method of the paper.
    Paper,
    /// Computed here, a method of this project.
    Ours,
    /// Printed in the paper.
    Published,
    /// The error of a perfect force map under the same rule.
    Perfect,
}

/// Size of a skin with its margin, and of the list of errors, px.
const CELL: [u32; 2] = [216, 226];
const RANKS_PX: u32 = 560;
/// Height of the names of the columns, px.
const HEAD_PX: u32 = 32;
/// Least force of a pixel that is drawn, as a share of the largest.
const FAINT: f32 = 0.03;
/// Most answers that are drawn, the strongest.
const ANSWERS_SHOWN: usize = 8;
/// Length of the scale bar, mm.
const BAR_MM: f64 = 100.0;

/// Draws rows of trials with a column per method, and the errors. `methods`: names of the columns after the true
/// contacts.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn opening(
    heading: &Heading,
    methods: &[String],
    rows: &[Row],
    ranks: &[Rank],
) -> FigureResult<String> {
    let columns = 1 + methods.len();
    let skins_px = CELL[0] * columns as u32;
    let height_px = HEAD_PX + CELL[1] * rows.len().max(2) as u32;
    let size = PageSize { width_px: skins_px + RANKS_PX, height_px };
    let heading = heading.clone().with_note(format!(
        "{} of them drawn. {}. Rings: true contacts, wider for larger forces; dots: answers with their force; \
         shade: force map of a net. Right: mean distance of matched contacts with its 95 % interval, and \
         answers per contact; blue: our methods, yellow: the paper's nets trained here, red: as printed",
        rows.len(),
        heading.note
    ));
    page("Fig. 12", size, &heading, |area| {
        let (left, right) = area.split_horizontally(skins_px);
        let (names, grid) = left.split_vertically(HEAD_PX);
        let centred = SMALL.into_font().style(FontStyle::Bold).color(&INK);
        let centred = centred.pos(Pos::new(HPos::Center, VPos::Center));
        let heads = ["true contacts"].into_iter().chain(methods.iter().map(String::as_str));
        for (at, name) in heads.enumerate() {
            let x = (CELL[0] * at as u32 + CELL[0] / 2) as i32;
            names.draw(&Text::new(name, (x, HEAD_PX as i32 / 2), centred.clone()))?;
        }
        let (grid, _) = grid.split_vertically(CELL[1] * rows.len().max(1) as u32);
        let cells = grid.split_evenly((rows.len().max(1), columns));
        for (row, cells) in rows.iter().zip(cells.chunks(columns)) {
            cell(&cells[0], &row.truth, None)?;
            for (answer, area) in row.answers.iter().zip(&cells[1..]) {
                cell(area, &row.truth, Some(answer))?;
            }
        }
        errors(&right, ranks)
    })
}

/// One skin with true contacts, and the answer of a method to them.
fn cell(area: &Area<'_>, truth: &[Contact], answer: Option<&Answer>) -> Drawn {
    let (width, height) = (PAPER_SKIN.width_mm, PAPER_SKIN.height_mm);
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .build_cartesian_2d(-4.0..width + 4.0, -4.0..height + 4.0)?;
    let corners = [(0.0, 0.0), (width, height)];
    chart.draw_series([Rectangle::new(corners, RGBColor(250, 250, 248).filled())])?;
    if let Some(map) = answer.and_then(|answer| answer.map.as_ref()) {
        let largest = map.map.iter().copied().fold(1e-6, f32::max);
        let (pixels, mm, side) = (map.spec.pixels(), map.spec.pixel_mm, map.spec.side_mm);
        let seen = map.map.iter().enumerate().filter(|(_, n)| **n > FAINT * largest);
        chart.draw_series(seen.filter_map(|(at, newtons)| {
            let x = (at % pixels) as f64 * mm - 0.5 * (side - width);
            let y = (at / pixels) as f64 * mm - 0.5 * (side - height);
            let inside = x > -mm && y > -mm && x < width && y < height;
            let ends = [(x.max(0.0), y.max(0.0)), ((x + mm).min(width), (y + mm).min(height))];
            let shade = COLOURS[2].mix(0.75 * f64::from((newtons / largest).sqrt()));
            inside.then(|| Rectangle::new(ends, shade.filled()))
        }))?;
    }
    chart.draw_series([Rectangle::new(corners, INK.mix(0.7).stroke_width(1))])?;
    // Contacts left of the others have their force on the left.
    let middle_of = |contacts: &[Contact]| {
        let known: Vec<f64> = contacts.iter().filter_map(|contact| contact.x_mm).collect();
        known.iter().sum::<f64>() / known.len().max(1) as f64
    };
    let middle_mm = middle_of(truth);
    for [x, y, newtons] in truth.iter().filter_map(Contact::pressed) {
        let radius_px = 5 + (1.3 * newtons.max(0.0).sqrt()) as i32;
        chart.draw_series([Circle::new((x, y), radius_px, INK.stroke_width(2))])?;
        if answer.is_none() {
            force(&mut chart, [x, y], newtons, (radius_px, x >= middle_mm))?;
        }
    }
    let answers = answer.map_or(&[][..], |answer| &answer.contacts);
    let middle_mm = middle_of(answers);
    for contact in answers.iter().take(ANSWERS_SHOWN) {
        let (Some(x), Some(y)) = (contact.x_mm, contact.y_mm) else { continue };
        // The square of a map is larger than the skin.
        if !((0.0..=width).contains(&x) && (0.0..=height).contains(&y)) {
            continue;
        }
        chart.draw_series([Circle::new((x, y), 4, COLOURS[1].filled())])?;
        if let Some(newtons) = contact.force_n {
            force(&mut chart, [x, y], newtons, (6, x >= middle_mm))?;
        }
    }
    if answers.len() > ANSWERS_SHOWN {
        let more = format!("and {} weaker", answers.len() - ANSWERS_SHOWN);
        chart.draw_series([Text::new(more, (16.0, 30.0), TINY)])?;
    }
    if answer.is_none() {
        let bar = [(20.0, 24.0), (20.0 + BAR_MM, 24.0)];
        chart.draw_series([PathElement::new(bar, INK.stroke_width(3))])?;
        let name = Text::new(format!("{BAR_MM:.0} mm"), (20.0, 58.0), TINY);
        chart.draw_series([name])?;
    }
    Ok(())
}

/// Writes a force next to a contact: on its right if wanted, unless an edge is near.
fn force(
    chart: &mut NumberChart<'_, '_>,
    [x, y]: [f64; 2],
    newtons: f64,
    (radius_px, on_right): (i32, bool),
) -> Drawn {
    let share = x / PAPER_SKIN.width_mm;
    let is_left = share < 0.15 || (on_right && share < 0.85);
    let side = if is_left { HPos::Left } else { HPos::Right };
    let style = TINY.into_font().color(&INK).pos(Pos::new(side, VPos::Center));
    let away = if is_left { radius_px + 3 } else { -radius_px - 3 };
    let words = format!("{newtons:.0} N");
    chart.draw_series([EmptyElement::at((x, y)) + Text::new(words, (away, 0), style)])?;
    Ok(())
}

/// Location errors, one below the other, the smallest first.
fn errors(area: &Area<'_>, ranks: &[Rank]) -> Drawn {
    let mut ranks: Vec<&Rank> = ranks.iter().collect();
    ranks.sort_by(|a, b| a.mean_mm.total_cmp(&b.mean_mm));
    let count = ranks.len();
    if count == 0 {
        area.draw(&Text::new("no method has answered a contact", (30, 60), TEXT))?;
        return Ok(());
    }
    let end = ranks.iter().map(|rank| rank.interval_mm.map_or(rank.mean_mm, |[_, high]| high));
    // Room for the numbers right of the longest bar.
    let end = 1.9 * end.fold(1.0, f64::max);
    let mut chart = framed(area, [14, 50, 250])
        .margin_top(HEAD_PX)
        .build_cartesian_2d(0.0..end, segments(count))?;
    let place = |at: usize| SegmentValue::CenterOf(count - 1 - at);
    chart
        .configure_mesh()
        .disable_y_mesh()
        .x_desc("mean location error (mm)")
        .x_label_formatter(&plain)
        .y_labels(count)
        .y_label_formatter(&|at| from_top(at, &ranks).copied().map_or(String::new(), named))
        .axis_style(INK.mix(0.4))
        .styled()
        .draw()?;
    for (at, rank) in ranks.iter().enumerate() {
        let colour = match rank.role {
            Role::Ours => COLOURS[1],
            Role::Paper => COLOURS[2],
            Role::Published => COLOURS[5],
            Role::Perfect => COLOURS[0],
        };
        let stem = [(0.0, place(at)), (rank.mean_mm, place(at))];
        chart.draw_series([PathElement::new(stem, colour.mix(0.35).stroke_width(8))])?;
        if let Some([low, high]) = rank.interval_mm {
            let ends = [(low, place(at)), (high, place(at))];
            chart.draw_series([PathElement::new(ends, INK.stroke_width(2))])?;
        }
        chart.draw_series([Circle::new((rank.mean_mm, place(at)), 7, colour.filled())])?;
        let value = EmptyElement::at((rank.interval_mm.map_or(rank.mean_mm, |i| i[1]), place(at)))
            + Text::new(
                value_words(rank),
                (12, 0),
                SMALL.into_font().color(&INK).pos(Pos::new(HPos::Left, VPos::Center)),
            );
        chart.draw_series([value])?;
    }
    Ok(())
}

fn value_words(rank: &Rank) -> String {
    let mean = format!("{:.0} mm", rank.mean_mm);
    rank.answers_per_contact.map_or(mean.clone(), |many| format!("{mean}, {many:.1} answers"))
}

fn named(rank: &Rank) -> String {
    if rank.n == 0 { rank.name.clone() } else { with_n(&rank.name, rank.n) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::force_map::TABLE_IV_MAPS;

    #[test]
    fn rows_columns_and_errors_are_drawn_also_without_any() {
        let at = |x_mm: f64, force_n: f64| Contact {
            x_mm: Some(x_mm),
            y_mm: Some(300.0),
            force_n: Some(force_n),
            diameter_mm: None,
        };
        let truth = vec![at(100.0, 12.0), at(450.0, 30.0)];
        let map = Picture::of_contacts("net", TABLE_IV_MAPS[0], &truth).unwrap();
        let answers = vec![
            Answer { contacts: vec![at(120.0, 10.0)], map: Some(map) },
            Answer { contacts: truth.clone(), map: None },
        ];
        let rank = |name: &str, mean_mm, role| Rank {
            name: name.into(),
            mean_mm,
            interval_mm: Some([mean_mm - 1.0, mean_mm + 1.0]),
            n: 1171,
            answers_per_contact: Some(1.25),
            role,
        };
        let ranks = [rank("exact", 4.0, Role::Ours), rank("net", 40.0, Role::Paper)];
        let heading = Heading::new("Contacts that no net has seen", 20, "trials", "virtual");
        let methods = ["net".to_owned(), "exact".to_owned()];
        let svg = opening(&heading, &methods, &[Row { truth, answers }], &ranks).unwrap();
        for text in [
            "true contacts",
            "30 N",
            "100 mm",
            "exact, n = 1,171",
            "4 mm, 1.2 answers",
            "n = 20 trials",
            "(mm)",
        ] {
            assert!(svg.contains(text), "{text}");
        }
        let none = opening(&heading, &[], &[], &[]).unwrap();
        assert!(none.contains("no method has answered") && !none.contains("NaN"));
    }
}
