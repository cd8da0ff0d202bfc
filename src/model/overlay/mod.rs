//! The overlay of a skin as a PDF at true scale: a person reads from it where a weight belongs.
//! PURE. Uses: `overlay::{tiles, draw}`, sim-core's sensor, pdf-writer. Never: files, a font that is
//! embedded (Helvetica is one of the fonts that every reader has).

mod draw;
mod tiles;

use pdf_writer::{Content, Name, Pdf, Rect, Ref};
use sim_core::sensor::Sensor;

use self::draw::Pen;
use self::tiles::{Area, Sheet, Tiling};

/// Points per mm.
const POINTS_PER_MM: f64 = 72.0 / 25.4;

/// Paper of an overlay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Paper {
    /// Sheets of A4 that overlap and carry marks for cutting.
    A4,
    /// One sheet as large as the skin, for a plotter.
    Sheet,
}

/// Writes the overlay of a sensor. 1 mm of the skin is 1 mm on the paper if it is printed at 100 %.
pub fn pdf(sensor: &Sensor, paper: Paper) -> Vec<u8> {
    let area = Area::of([sensor.file.width_mm, sensor.file.height_mm]);
    let tiling = match paper {
        Paper::A4 => Tiling::a4(&area),
        Paper::Sheet => Tiling::one(&area),
    };
    let mut next = 1;
    let mut id = || {
        let id = Ref::new(next);
        next += 1;
        id
    };
    let (catalog, tree, font) = (id(), id(), id());
    let mut pdf = Pdf::new();
    pdf.catalog(catalog).pages(tree);
    pdf.type1_font(font).base_font(Name(b"Helvetica"));
    let sheets: Vec<(Ref, Ref, &Sheet)> =
        tiling.sheets.iter().map(|sheet| (id(), id(), sheet)).collect();
    let count = i32::try_from(sheets.len()).unwrap_or(i32::MAX);
    pdf.pages(tree).kids(sheets.iter().map(|(page, ..)| *page)).count(count);
    let [width_mm, height_mm] = tiling.page_mm;
    let points = |mm: f64| (mm * POINTS_PER_MM) as f32;
    for (page, content, sheet) in sheets {
        let media = Rect::new(0.0, 0.0, points(width_mm), points(height_mm));
        let mut written = pdf.page(page);
        written.media_box(media).parent(tree).contents(content);
        written.resources().fonts().pair(draw::PAGE_FONT, font);
        drop(written);
        pdf.stream(content, &drawn(sensor, &tiling, sheet));
    }
    pdf.finish()
}

/// Content of a page.
fn drawn(sensor: &Sensor, tiling: &Tiling, sheet: &Sheet) -> Vec<u8> {
    let mut content = Content::new();
    let scale = POINTS_PER_MM as f32;
    content.transform([scale, 0.0, 0.0, scale, 0.0, 0.0]);
    let mut pen = Pen::new(&mut content);
    pen.skin(sensor, tiling, sheet);
    pen.marks(tiling, sheet);
    pen.caption(&sensor.file.name, tiling, sheet);
    content.finish().into_vec()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use sim_core::sensor::Point;

    use super::*;

    /// How often each text is shown.
    fn shown(pdf: &[u8]) -> BTreeMap<String, usize> {
        let mut counts = BTreeMap::new();
        for line in String::from_utf8_lossy(pdf).lines() {
            let text = line.strip_prefix('(').and_then(|line| line.strip_suffix(") Tj"));
            if let Some(text) = text {
                *counts.entry(text.to_owned()).or_default() += 1;
            }
        }
        counts
    }

    #[test]
    fn every_point_is_on_the_sheet_once_and_on_at_least_one_tile() {
        let sensor = crate::calibrate::paper::sensor();
        let tiles = pdf(&sensor, Paper::A4);
        let (on_sheet, on_tiles) = (shown(&pdf(&sensor, Paper::Sheet)), shown(&tiles));
        let points = sensor.points().iter().map(Point::label);
        for text in points.chain((0..28).map(|electrode| format!("E{electrode}"))) {
            assert_eq!(on_sheet.get(&text), Some(&1), "{text}");
            assert!(on_tiles.contains_key(&text), "{text}");
        }
        assert_eq!(pdf(&sensor, Paper::A4), tiles, "the same bytes");
    }
}
