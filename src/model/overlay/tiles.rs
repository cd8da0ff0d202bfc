//! How the overlay is divided among sheets of paper.
//! PURE. Uses: nothing. Never: the PDF. All lengths in mm; origins in skin coordinates.

/// Space left of the skin, for the names of the rows.
const LEFT_MM: f64 = 12.0;
/// Space right of the skin and above it.
const AROUND_MM: f64 = 5.0;
/// Space below the skin, for the names of the columns and the ruler.
const BELOW_MM: f64 = 24.0;
/// A4, upright.
const A4_MM: [f64; 2] = [210.0, 297.0];
/// Edge of a sheet that a printer may leave blank.
const BLANK_EDGE_MM: f64 = 7.0;
/// Strip that neighbouring sheets have in common.
pub(super) const OVERLAP_MM: f64 = 10.0;

/// The drawn part of the plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Area {
    /// Lower left corner.
    origin_mm: [f64; 2],
    /// Width and height.
    size_mm: [f64; 2],
}

impl Area {
    /// Area of a skin, with its legends; `skin_mm`: its width and height.
    pub fn of(skin_mm: [f64; 2]) -> Self {
        let [width_mm, height_mm] = skin_mm;
        let size_mm = [width_mm + LEFT_MM + AROUND_MM, height_mm + BELOW_MM + AROUND_MM];
        Self { origin_mm: [-LEFT_MM, -BELOW_MM], size_mm }
    }
}

/// One sheet of paper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sheet {
    /// Column, from 0 at the left, and row, from 0 at the bottom.
    pub at: [usize; 2],
    /// Lower left corner of its part of the plane.
    pub origin_mm: [f64; 2],
}

/// Division of the drawing into sheets of paper.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tiling {
    /// Width and height of the paper.
    pub page_mm: [f64; 2],
    /// Width of the blank edge of each sheet, mm.
    pub margin_mm: f64,
    /// Number of columns and rows.
    pub counts: [usize; 2],
    /// The sheets, row by row from the bottom.
    pub sheets: Vec<Sheet>,
}

impl Tiling {
    /// One sheet, as large as needed.
    pub fn one(area: &Area) -> Self {
        let page_mm = area.size_mm.map(|mm| mm + 2.0 * BLANK_EDGE_MM);
        let sheets = vec![Sheet { at: [0, 0], origin_mm: area.origin_mm }];
        Self { page_mm, margin_mm: BLANK_EDGE_MM, counts: [1, 1], sheets }
    }

    /// Sheets of A4, upright or across, whichever needs fewer.
    pub fn a4(area: &Area) -> Self {
        let upright = Self::of(area, A4_MM);
        let across = Self::of(area, [A4_MM[1], A4_MM[0]]);
        if across.sheets.len() < upright.sheets.len() { across } else { upright }
    }

    fn of(area: &Area, page_mm: [f64; 2]) -> Self {
        let part_mm = page_mm.map(|mm| mm - 2.0 * BLANK_EDGE_MM);
        let axes: [(usize, f64); 2] = std::array::from_fn(|axis| {
            let (size, step) = (area.size_mm[axis], part_mm[axis] - OVERLAP_MM);
            let count = ((size - OVERLAP_MM) / step).ceil().max(1.0);
            // The paper beyond the area is divided between both ends.
            let spare = count * step + OVERLAP_MM - size;
            (count as usize, area.origin_mm[axis] - spare / 2.0)
        });
        let [(columns, x_mm), (rows, y_mm)] = axes;
        let step_mm = part_mm.map(|mm| mm - OVERLAP_MM);
        let at = (0..rows).flat_map(|row| (0..columns).map(move |column| [column, row]));
        let sheet = |at: [usize; 2]| Sheet {
            at,
            origin_mm: [x_mm + at[0] as f64 * step_mm[0], y_mm + at[1] as f64 * step_mm[1]],
        };
        let sheets = at.map(sheet).collect();
        Self { page_mm, margin_mm: BLANK_EDGE_MM, counts: [columns, rows], sheets }
    }

    /// Width and height of the part of the plane on one sheet.
    pub fn part_mm(&self) -> [f64; 2] {
        self.page_mm.map(|mm| mm - 2.0 * self.margin_mm)
    }

    /// Whether something within `reach_mm` of a position is on a sheet.
    pub fn shows(&self, sheet: &Sheet, at_mm: [f64; 2], reach_mm: f64) -> bool {
        let part_mm = self.part_mm();
        (0..2).all(|axis| {
            let from = sheet.origin_mm[axis];
            (from - reach_mm..=from + part_mm[axis] + reach_mm).contains(&at_mm[axis])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn covered(tiling: &Tiling, at_mm: [f64; 2]) -> usize {
        tiling.sheets.iter().filter(|sheet| tiling.shows(sheet, at_mm, 0.0)).count()
    }

    #[test]
    fn tiles_cover_the_area_and_overlap_by_a_strip() {
        let area = Area::of([540.0, 560.0]);
        let tiling = Tiling::a4(&area);
        assert_eq!(tiling.counts, [3, 3]);
        let corners = [area.origin_mm, [545.0, 565.0], [-12.0, 565.0], [545.0, -24.0]];
        for at in corners.into_iter().chain([[270.0, 280.0]]) {
            assert!(covered(&tiling, at) >= 1, "{at:?}");
        }
        let (a, b) = (&tiling.sheets[0], &tiling.sheets[1]);
        assert!((b.origin_mm[0] - a.origin_mm[0] - (196.0 - OVERLAP_MM)).abs() < 1e-9);
        let seam = [b.origin_mm[0] + OVERLAP_MM / 2.0, a.origin_mm[1] + 100.0];
        assert_eq!(covered(&tiling, seam), 2);
    }

    #[test]
    fn one_sheet_is_as_large_as_the_skin_and_its_legends() {
        let tiling = Tiling::one(&Area::of([540.0, 560.0]));
        assert_eq!(tiling.page_mm, [571.0, 603.0]);
        assert_eq!(tiling.sheets.len(), 1);
        let small = Tiling::a4(&Area::of([100.0, 100.0]));
        assert_eq!(small.sheets.len(), 1);
        let wide = Tiling::a4(&Area::of([250.0, 100.0]));
        assert_eq!((wide.sheets.len(), wide.page_mm), (1, [297.0, 210.0]));
    }
}
