//! The gap file: how virtual reality differs from the nominal model.
//! Uses: serde, toml. Never: files (the text is handed in), chance.

use serde::{Deserialize, Serialize};

/// What is wrong with a gap file.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum GapError {
    /// The text is not TOML, or has a key or a type that a gap file does not have.
    #[error("{0}")]
    Syntax(#[from] toml::de::Error),
    /// A value is outside its limits.
    #[error("{key} = {value}: {limit}")]
    Value {
        /// Dotted key in the file.
        key: &'static str,
        /// The value found.
        value: f64,
        /// What is allowed.
        limit: &'static str,
    },
}

/// A gap file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gap {
    /// Name that datasets carry.
    pub name: String,
    /// Materials over the skin.
    pub fields: FieldsGap,
    /// The foam's law.
    pub foam: FoamGap,
    /// The electrodes.
    pub electrodes: ElectrodesGap,
    /// The tips.
    pub tips: TipsGap,
    /// Drift and noise.
    pub readout: ReadoutGap,
    /// Forces against depth.
    pub mechanics: MechanicsGap,
}

/// Standard deviations of the logarithms of factors on the nominal values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldsGap {
    /// Correlation lengths, mm; each variance is shared equally between them.
    pub correlation_mm: Vec<f64>,
    /// a of Eq. 1, smooth part.
    pub ln_a_sd: f64,
    /// a of Eq. 1, independent from node to node.
    pub ln_a_white_sd: f64,
    /// b of Eq. 1.
    pub ln_b_sd: f64,
    /// c of Eq. 1.
    pub ln_c_sd: f64,
    /// Foam compression.
    pub ln_compliance_sd: f64,
    /// Conductance of the sheet.
    pub ln_sheet_sd: f64,
}

/// The foam: softening first, then stiffening towards a limit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FoamGap {
    /// Strength of the softening.
    pub softening: f64,
    /// Where it is strongest, mm.
    pub softening_at_mm: f64,
    /// Compression that is never exceeded, mm.
    pub limit_mm: f64,
    /// Sharpness of the bend towards the limit.
    pub limit_exponent: f64,
}

impl FoamGap {
    /// Real compression of a linear one, mm.
    pub fn apply(&self, linear_mm: f64) -> f64 {
        let t = linear_mm / self.softening_at_mm;
        let soft = linear_mm * (1.0 + self.softening * (t * (1.0 - t).exp() - 0.5));
        let bent = 1.0 + (soft / self.limit_mm).powf(self.limit_exponent);
        soft / bent.powf(1.0 / self.limit_exponent)
    }
}

/// The electrodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElectrodesGap {
    /// Displacement per axis, mm.
    pub offset_sd_mm: f64,
    /// Contact resistance, ohm.
    pub contact_ohm: f64,
    /// Median resistance of a lead, ohm.
    pub lead_ohm: f64,
    /// Spread of its logarithm.
    pub lead_ln_sd: f64,
    /// Around each electrode, within this, mm,
    pub soft_radius_mm: f64,
    /// the foam is softer by this share.
    pub soft_compliance: f64,
    /// Number of loose electrodes.
    pub loose: u32,
    /// What a loose one has more in its lead, ohm.
    pub loose_ohm: f64,
}

/// The tips.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TipsGap {
    /// Tilt per axis: a vertex in direction n carries (1 + t.n) / 6 of the force.
    pub tilt_sd: f64,
}

/// Drift and noise at the output.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReadoutGap {
    /// Drift of ln a, as a gain.
    pub ln_a_drift_sd: f64,
    /// How long it remembers, s.
    pub ln_a_drift_time_s: f64,
    /// Drift of the gain.
    pub gain_drift_sd: f64,
    /// How long it remembers, s.
    pub gain_drift_time_s: f64,
    /// Fixed offset of a channel, mV.
    pub offset_sd_mv: f64,
    /// Noise of one reading, mV.
    pub noise_sd_mv: f64,
    /// Growth of the signal of a held load per decade of seconds.
    pub creep_per_decade: f64,
}

/// Forces of the tips against the stage's depth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MechanicsGap {
    /// Mean travel at which a tip reaches 5 N, mm.
    pub travel_to_5_n_mm: f64,
    /// Height above the surface found by touch-off at which that travel starts, mm.
    pub travel_starts_above_mm: f64,
    /// Spread from configuration to configuration, mm.
    pub configuration_sd_mm: f64,
    /// Spread from tip to tip, mm.
    pub tip_sd_mm: f64,
    /// Distance over which these spreads forget, mm.
    pub flatness_correlation_mm: f64,
    /// How much later each tip comes, mm.
    pub tip_offsets_mm: [f64; 6],
    /// Length of the soft toe, up to 5 N, mm.
    pub toe_mm: f64,
    /// Its shape: 5 N (s / toe)^exponent.
    pub toe_exponent: f64,
    /// Slope after the toe, N/mm.
    pub slope_n_per_mm: f64,
    /// Share by which the force is lower while unloading.
    pub unloading_softer: f64,
}

impl Gap {
    /// Parses and checks a gap file's text.
    pub fn from_toml(text: &str) -> Result<Self, GapError> {
        let gap: Self = toml::from_str(text)?;
        gap.check()?;
        Ok(gap)
    }

    fn check(&self) -> Result<(), GapError> {
        let (f, e, r, m) = (&self.fields, &self.electrodes, &self.readout, &self.mechanics);
        for (key, value) in [
            ("fields.ln_a_sd", f.ln_a_sd),
            ("fields.ln_a_white_sd", f.ln_a_white_sd),
            ("fields.ln_b_sd", f.ln_b_sd),
            ("fields.ln_c_sd", f.ln_c_sd),
            ("fields.ln_compliance_sd", f.ln_compliance_sd),
            ("fields.ln_sheet_sd", f.ln_sheet_sd),
            ("foam.softening", self.foam.softening),
            ("electrodes.offset_sd_mm", e.offset_sd_mm),
            ("electrodes.lead_ohm", e.lead_ohm),
            ("electrodes.lead_ln_sd", e.lead_ln_sd),
            ("electrodes.soft_radius_mm", e.soft_radius_mm),
            ("electrodes.soft_compliance", e.soft_compliance),
            ("electrodes.loose_ohm", e.loose_ohm),
            ("tips.tilt_sd", self.tips.tilt_sd),
            ("readout.ln_a_drift_sd", r.ln_a_drift_sd),
            ("readout.gain_drift_sd", r.gain_drift_sd),
            ("readout.offset_sd_mv", r.offset_sd_mv),
            ("readout.noise_sd_mv", r.noise_sd_mv),
            ("readout.creep_per_decade", r.creep_per_decade),
            ("mechanics.travel_starts_above_mm", m.travel_starts_above_mm),
            ("mechanics.configuration_sd_mm", m.configuration_sd_mm),
            ("mechanics.tip_sd_mm", m.tip_sd_mm),
        ] {
            require(key, value, value >= 0.0, "must be a number >= 0")?;
        }
        let mut positive = vec![
            ("foam.softening_at_mm", self.foam.softening_at_mm),
            ("foam.limit_mm", self.foam.limit_mm),
            ("foam.limit_exponent", self.foam.limit_exponent),
            ("electrodes.contact_ohm", e.contact_ohm),
            ("readout.ln_a_drift_time_s", r.ln_a_drift_time_s),
            ("readout.gain_drift_time_s", r.gain_drift_time_s),
            ("mechanics.travel_to_5_n_mm", m.travel_to_5_n_mm),
            ("mechanics.flatness_correlation_mm", m.flatness_correlation_mm),
            ("mechanics.toe_mm", m.toe_mm),
            ("mechanics.toe_exponent", m.toe_exponent),
            ("mechanics.slope_n_per_mm", m.slope_n_per_mm),
            ("fields.correlation_mm, how many", f.correlation_mm.len() as f64),
        ];
        positive.extend(f.correlation_mm.iter().map(|&l| ("fields.correlation_mm", l)));
        for (key, value) in positive {
            require(key, value, value > 0.0, "must be a number > 0")?;
        }
        for value in m.tip_offsets_mm {
            require("mechanics.tip_offsets_mm", value, true, "must be numbers")?;
        }
        let share = m.unloading_softer;
        require(
            "mechanics.unloading_softer",
            share,
            (0.0..1.0).contains(&share),
            "must be in [0, 1)",
        )
    }
}

fn require(
    key: &'static str,
    value: f64,
    holds: bool,
    limit: &'static str,
) -> Result<(), GapError> {
    if holds && value.is_finite() { Ok(()) } else { Err(GapError::Value { key, value, limit }) }
}
