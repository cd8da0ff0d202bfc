//! What a bench can reach and bear, as plain values, so that a plan is linted without knowing rigs.
//! PURE. Uses: nothing. Never: the rig file (its reader fills this in).

/// Reach and limits of a rig. Machine coordinates: z grows downward from the raised home.
#[derive(Debug, Clone, PartialEq)]
pub struct Reach {
    /// The rig file, for the problems.
    pub file: String,
    /// `axes.x.travel_mm`.
    pub x_travel_mm: [f64; 2],
    /// `axes.y.travel_mm`.
    pub y_travel_mm: [f64; 2],
    /// `axes.z.travel_mm`.
    pub z_travel_mm: [f64; 2],
    /// `slot.radius_mm`: the radii that the slot allows.
    pub radius_mm: [f64; 2],
    /// `slot.backlash_mm`: every radius is approached from this much below.
    pub backlash_mm: f64,
    /// Machine position of the skin's corner, (x, y), mm.
    pub skin_origin_mm: [f64; 2],
    /// `skin.surface_z_mm`: where the surface may be.
    pub surface_z_mm: [f64; 2],
    /// `skin.clearance_mm`: height kept above the surface between configurations.
    pub clearance_mm: f64,
    /// `limits.force_n`: what trips the rig on one tip.
    pub force_n: f64,
    /// `limits.force_sum_n`: what trips the rig on all tips.
    pub force_sum_n: f64,
    /// `cells.update_ms`: real update period of the load cells.
    pub cell_update_ms: f64,
    /// `ert.electrodes`: electrodes of the readout.
    pub electrodes: u32,
}
