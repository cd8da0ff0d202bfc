//! The sensor file: the skin's geometry, its 804 points, its 28 electrodes and its materials.
//! Uses: serde, toml. Never: files (the text is passed in), mesh, physics, a calibration.
//!
//! Geometry is inferred, since the paper does not state it (`docs/references.md`, "Skin geometry"):
//! hexagons whose longest diagonal is the tip's 20 mm tile the skin, and a tip is centred on a
//! hexagon.

use serde::{Deserialize, Serialize};

/// Why a sensor file is invalid.
#[derive(Debug, thiserror::Error, PartialEq)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum SensorError {
    /// The text is not TOML, or has a key or a type that a sensor file does not have.
    #[error("{0}")]
    Syntax(String),
    #[error("{key} = {value}: {limit}")]
    Value { key: String, value: String, limit: String },
}

/// Contents of the sensor file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorFile {
    /// Name of the sensor, which datasets carry.
    pub name: String,
    /// Extent of the skin along x, mm.
    pub width_mm: f64,
    /// Extent of the skin along y, mm.
    pub height_mm: f64,
    /// Diameter of an indenter tip, mm; twice the hexagon's side.
    pub tip_diameter_mm: f64,
    /// The lattice of contact points.
    pub points: PointLattice,
    /// The electrodes, in measuring order.
    pub electrodes: ElectrodeRows,
    /// Layers from the bottom up.
    pub layers: Layers,
    /// Foam resistance against compression, paper Eq. 1.
    pub piezo: Piezo,
    /// Sheet resistance, source voltage and gain of the readout.
    pub circuit: Circuit,
}

/// Rows of points; odd rows are shifted by half a pitch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointLattice {
    /// Number of rows along y.
    pub rows: u32,
    /// Number of points in a row.
    pub columns: u32,
    /// y of row 0, mm.
    pub first_row_y_mm: f64,
    /// Points without a position on the skin, as `[row, column]`.
    pub left_out: Vec<[u32; 2]>,
}

/// Rows of electrodes, each `x = X0 + pitch * column`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElectrodeRows {
    /// y of each row, mm.
    pub rows_y_mm: Vec<f64>,
    /// Columns of each row, in units of the point pitch from the first point's x.
    pub columns: Vec<Vec<i32>>,
    /// Every second row runs backwards, so that neighbours in the order are neighbours on the skin.
    pub serpentine: bool,
}

/// The three bonded layers, paper II-A and III-A.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layers {
    /// High-resistance fabric at the bottom.
    pub bottom: Layer,
    /// Foam whose resistance depends on its compression.
    pub foam: Layer,
    /// Low-resistance fabric on top.
    pub top: Layer,
}

/// One linear elastic layer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Thickness without load, mm.
    pub thickness_mm: f64,
    /// Young's modulus, MPa.
    pub youngs_mpa: f64,
    /// Poisson's ratio, in [0, 0.5).
    pub poisson: f64,
    /// Number of bricks through the thickness.
    pub elements: u32,
}

/// f(x) = a / (exp(b x) - 1) + c, paper Eq. 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Piezo {
    /// Coefficient a, ohm.
    pub a_ohm: f64,
    /// Coefficient b, 1/mm.
    pub b_per_mm: f64,
    /// Coefficient c, ohm.
    pub c_ohm: f64,
    /// Conversion of the specimen's resistance to that of a node.
    pub resistance_per: ResistancePer,
}

/// Interpretation of "an array of parallel variable resistors with these same properties" (paper
/// III-B).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ResistancePer {
    /// Every node has the specimen's resistance.
    Node,
    /// Scaled by the 20 x 20 mm specimen's area over the node's.
    Area,
}

/// The readout circuit, paper III-C.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Circuit {
    /// Sheet resistance of the bottom fabric, ohm per square.
    pub sheet_ohm_per_sq: f64,
    /// Source voltage between the top layer and the sink electrode, V.
    pub source_v: f64,
    /// Gain of the readout.
    pub gain: f64,
}

/// One of the predetermined contact locations (804 of them, paper III-A).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Row on the lattice.
    pub row: u32,
    /// Column on the lattice.
    pub column: u32,
    /// Position from the skin's corner, mm.
    pub x_mm: f64,
    /// Position from the skin's corner, mm.
    pub y_mm: f64,
}

impl Point {
    /// Name of the point, as on the printed overlay: row and column from 1, such as `R7 C12`. Row 1
    /// has the smallest y, column 1 the smallest x.
    pub fn label(&self) -> String {
        format!("R{} C{}", self.row + 1, self.column + 1)
    }
}

/// A checked sensor: the file, and the points and electrodes that follow from it.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// The file it came from.
    pub file: SensorFile,
    points: Vec<Point>,
    electrodes: Vec<[f64; 2]>,
}

impl Sensor {
    /// Parses and checks a sensor file's text.
    ///
    /// # Errors
    /// `SensorError::Syntax` if the text is not a sensor file; `SensorError::Value` if a value is
    /// outside its limits.
    pub fn from_toml(text: &str) -> Result<Self, SensorError> {
        let file: SensorFile =
            toml::from_str(text).map_err(|e| SensorError::Syntax(e.to_string()))?;
        Self::new(file)
    }

    /// Checks a sensor file and lays out its points and electrodes.
    ///
    /// # Errors
    /// `SensorError::Value` if a value is outside its limits, or a point or electrode is off the
    /// skin.
    pub fn new(file: SensorFile) -> Result<Self, SensorError> {
        check(&file)?;
        let points = lay_out_points(&file);
        let electrodes = lay_out_electrodes(&file);
        let sensor = Self { file, points, electrodes };
        for (i, p) in sensor.points.iter().enumerate() {
            if !sensor.holds_tip([p.x_mm, p.y_mm]) {
                let value = format!("point {i} at ({:.2}, {:.2}) mm", p.x_mm, p.y_mm);
                return Err(bad("points", value, "a tip on every point must be on the skin"));
            }
        }
        for (k, [x, y]) in sensor.electrodes.iter().enumerate() {
            if !(0.0..=sensor.file.width_mm).contains(x)
                || !(0.0..=sensor.file.height_mm).contains(y)
            {
                let value = format!("electrode {k} at ({x:.2}, {y:.2}) mm");
                return Err(bad("electrodes", value, "must be on the skin"));
            }
        }
        Ok(sensor)
    }

    /// Distance between neighbouring points, mm: the hexagon's side times sqrt(3).
    pub fn pitch_mm(&self) -> f64 {
        pitch_mm(&self.file)
    }

    /// The hexagon's side, mm: half a tip's diameter, and the mesh's pitch.
    pub fn side_mm(&self) -> f64 {
        self.file.tip_diameter_mm / 2.0
    }

    /// x of column 0 in even rows, mm.
    pub fn first_column_x_mm(&self) -> f64 {
        first_column_x_mm(&self.file)
    }

    /// The contact points, row by row.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Electrode positions in measuring order, mm.
    pub fn electrodes_mm(&self) -> &[[f64; 2]] {
        &self.electrodes
    }

    /// Number of voltages in a frame: electrodes squared.
    pub fn channels(&self) -> usize {
        self.electrodes.len() * self.electrodes.len()
    }

    /// Index of the point within `tolerance_mm` of a position, if there is one.
    pub fn point_near(&self, at_mm: [f64; 2], tolerance_mm: f64) -> Option<usize> {
        let [x_mm, y_mm] = at_mm;
        self.points.iter().position(|p| (p.x_mm - x_mm).hypot(p.y_mm - y_mm) <= tolerance_mm)
    }

    /// The point nearest to a position. A sensor has at least one point.
    pub fn nearest_point(&self, [x_mm, y_mm]: [f64; 2]) -> Option<&Point> {
        let distance = |p: &&Point| (p.x_mm - x_mm).hypot(p.y_mm - y_mm);
        self.points.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    /// Whether a tip centred at a position is wholly on the skin.
    pub fn holds_tip(&self, at_mm: [f64; 2]) -> bool {
        let r = self.file.tip_diameter_mm / 2.0;
        (r..=self.file.width_mm - r).contains(&at_mm[0])
            && (r..=self.file.height_mm - r).contains(&at_mm[1])
    }
}

fn pitch_mm(file: &SensorFile) -> f64 {
    file.tip_diameter_mm / 2.0 * 3f64.sqrt()
}

fn first_column_x_mm(file: &SensorFile) -> f64 {
    (file.width_mm - (f64::from(file.points.columns) - 0.5) * pitch_mm(file)) / 2.0
}

fn lay_out_points(file: &SensorFile) -> Vec<Point> {
    let (pitch, x0) = (pitch_mm(file), first_column_x_mm(file));
    let row_step = 0.75 * file.tip_diameter_mm;
    let lattice = &file.points;
    (0..lattice.rows)
        .flat_map(|row| (0..lattice.columns).map(move |column| (row, column)))
        .filter(|&(row, column)| !lattice.left_out.contains(&[row, column]))
        .map(|(row, column)| Point {
            row,
            column,
            x_mm: x0 + pitch * (f64::from(column) + 0.5 * f64::from(row % 2)),
            y_mm: lattice.first_row_y_mm + row_step * f64::from(row),
        })
        .collect()
}

fn lay_out_electrodes(file: &SensorFile) -> Vec<[f64; 2]> {
    let (pitch, x0) = (pitch_mm(file), first_column_x_mm(file));
    let rows = &file.electrodes;
    let mut out = Vec::new();
    for (i, (&y, columns)) in rows.rows_y_mm.iter().zip(&rows.columns).enumerate() {
        let mut row: Vec<[f64; 2]> =
            columns.iter().map(|&c| [x0 + pitch * f64::from(c), y]).collect();
        if rows.serpentine && i % 2 == 1 {
            row.reverse();
        }
        out.extend(row);
    }
    out
}

fn bad(key: &str, value: impl ToString, limit: &str) -> SensorError {
    SensorError::Value { key: key.into(), value: value.to_string(), limit: limit.into() }
}

fn positive(key: &str, value: f64) -> Result<(), SensorError> {
    if value.is_finite() && value > 0.0 {
        Ok(())
    } else {
        Err(bad(key, value, "must be a positive number"))
    }
}

fn check(file: &SensorFile) -> Result<(), SensorError> {
    positive("width_mm", file.width_mm)?;
    positive("height_mm", file.height_mm)?;
    positive("tip_diameter_mm", file.tip_diameter_mm)?;
    if file.points.rows == 0 || file.points.columns == 0 {
        return Err(bad("points.rows, points.columns", 0, "must be at least 1"));
    }
    if file.electrodes.rows_y_mm.len() != file.electrodes.columns.len() {
        let limit = "needs one list of columns for each of rows_y_mm";
        return Err(bad("electrodes.columns", file.electrodes.columns.len(), limit));
    }
    for (name, layer) in [
        ("layers.bottom", &file.layers.bottom),
        ("layers.foam", &file.layers.foam),
        ("layers.top", &file.layers.top),
    ] {
        positive(&format!("{name}.thickness_mm"), layer.thickness_mm)?;
        positive(&format!("{name}.youngs_mpa"), layer.youngs_mpa)?;
        if !(0.0..0.5).contains(&layer.poisson) {
            return Err(bad(&format!("{name}.poisson"), layer.poisson, "must be in [0, 0.5)"));
        }
        if !(1..=16).contains(&layer.elements) {
            return Err(bad(&format!("{name}.elements"), layer.elements, "must be 1 to 16"));
        }
    }
    positive("piezo.a_ohm", file.piezo.a_ohm)?;
    positive("piezo.b_per_mm", file.piezo.b_per_mm)?;
    positive("piezo.c_ohm", file.piezo.c_ohm)?;
    positive("circuit.sheet_ohm_per_sq", file.circuit.sheet_ohm_per_sq)?;
    positive("circuit.source_v", file.circuit.source_v)?;
    positive("circuit.gain", file.circuit.gain)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paper() -> Sensor {
        Sensor::from_toml(include_str!("../../experiments/sensors/ert-28.toml")).unwrap()
    }

    #[test]
    fn the_papers_skin_has_804_points_and_28_electrodes() {
        let s = paper();
        assert_eq!(s.points().len(), 804);
        assert_eq!(s.electrodes_mm().len(), 28);
        assert_eq!(s.channels(), 784);
        assert!((s.first_column_x_mm() - 49.1635).abs() < 1e-4);
    }

    #[test]
    fn a_point_is_named_by_its_row_and_column_from_1() {
        let s = paper();
        let p = s.points()[0];
        // The corner has no point.
        assert_eq!(p.label(), "R1 C2");
        let near = s.nearest_point([p.x_mm + 3.0, p.y_mm - 2.0]).unwrap();
        assert_eq!(near.label(), "R1 C2");
        let mut labels: Vec<String> = s.points().iter().map(Point::label).collect();
        labels.sort();
        labels.dedup();
        assert_eq!(labels.len(), 804);
    }

    #[test]
    fn half_of_the_electrodes_have_a_point_at_10_mm() {
        let s = paper();
        let near = s.electrodes_mm().iter().filter(|&&e| s.point_near(e, 10.01).is_some()).count();
        assert_eq!(near, 14);
    }

    #[test]
    fn neighbours_in_the_measuring_order_are_neighbours_on_the_skin() {
        let s = paper();
        for pair in s.electrodes_mm().windows(2) {
            let d = (pair[0][0] - pair[1][0]).hypot(pair[0][1] - pair[1][1]);
            assert!(d < 180.0, "{d}");
        }
    }

    #[test]
    fn a_wrong_value_names_the_key_and_the_limit() {
        let text = include_str!("../../experiments/sensors/ert-28.toml")
            .replace("poisson = 0.05", "poisson = 0.5");
        let error = Sensor::from_toml(&text).unwrap_err().to_string();
        assert_eq!(error, "layers.foam.poisson = 0.5: must be in [0, 0.5)");
    }
}
