//! Reach and force limits of a bench as plain values, so that a plan is checked without a rig.
//! PURE. Uses: nothing. Never: the rig file (its reader fills this in).

/// Reach and limits of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct Reach {
    /// Name of the rig file, for problems.
    pub file: String,
    /// `ert.electrodes`: number of electrodes of the readout.
    pub electrodes: u32,
    /// Reach and limits of the stage; absent for a skin alone.
    pub stage: Option<StageReach>,
}

/// Reach and limits of a stage. Machine coordinates: z increases downward from the raised home.
#[derive(Debug, Clone, PartialEq)]
pub struct StageReach {
    /// `axes.x.travel_mm`, mm.
    pub x_travel_mm: [f64; 2],
    /// `axes.y.travel_mm`, mm.
    pub y_travel_mm: [f64; 2],
    /// `axes.z.travel_mm`, mm.
    pub z_travel_mm: [f64; 2],
    /// `slot.radius_mm`: range of radii of the slots, mm.
    pub radius_mm: [f64; 2],
    /// `slot.backlash_mm`: every radius is approached from this distance below, mm.
    pub backlash_mm: f64,
    /// Machine position of the skin's corner, (x, y), mm.
    pub skin_origin_mm: [f64; 2],
    /// `skin.surface_z_mm`: range of the height of the surface, machine mm.
    pub surface_z_mm: [f64; 2],
    /// `skin.clearance_mm`: clearance to the surface between configurations, mm.
    pub clearance_mm: f64,
    /// `limits.force_n`: force on one tip that trips the rig, N.
    pub force_n: f64,
    /// `limits.force_sum_n`: sum of forces that trips the rig, N.
    pub force_sum_n: f64,
    /// `cells.update_ms`: actual update period of the load cells, process ms.
    pub cell_update_ms: f64,
}
