//! The gap file: difference between a virtual skin and the nominal model.
//! Uses: `laminate::laws` (the check of a value), serde, toml. Never: files (the text is passed in), random numbers.

use laminate::keyed;
use laminate::laws::{ValueError, require};
use serde::{Deserialize, Serialize};

/// Error in a gap file.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum GapError {
    /// The text is not TOML, or has a key or a type that a gap file does not have.
    #[error("{0}")]
    Syntax(#[from] toml::de::Error),
    /// A value is outside its limits.
    #[error(transparent)]
    Value(#[from] ValueError),
}

/// Contents of a gap file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gap {
    /// Name of the gap, stored with datasets.
    pub name: String,
    /// Variation of the materials over the skin.
    pub fields: FieldsGap,
    /// Law of the foam.
    pub foam: FoamGap,
    /// Deviations of the electrodes.
    pub electrodes: ElectrodesGap,
    /// Deviations of the tips.
    pub tips: TipsGap,
    /// Drift and noise of the readout.
    pub readout: ReadoutGap,
    /// Forces of the tips as functions of the depth.
    pub mechanics: MechanicsGap,
}

/// Standard deviations of the logarithms of factors on the nominal values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldsGap {
    /// Correlation lengths, mm; each variance is divided equally among them.
    pub correlation_mm: Vec<f64>,
    /// Standard deviation of ln a (Eq. 1), smooth part.
    pub ln_a_sd: f64,
    /// Standard deviation of ln a (Eq. 1), independent at each node.
    pub ln_a_white_sd: f64,
    /// Standard deviation of ln b (Eq. 1).
    pub ln_b_sd: f64,
    /// Standard deviation of ln c (Eq. 1).
    pub ln_c_sd: f64,
    /// Standard deviation of the logarithm of the foam's compliance.
    pub ln_compliance_sd: f64,
    /// Standard deviation of the logarithm of the sheet's conductance.
    pub ln_sheet_sd: f64,
}

/// Law of the foam: softening at first, then stiffening towards a limit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FoamGap {
    /// Strength of the softening, relative.
    pub softening: f64,
    /// Compression at which it is strongest, mm.
    pub softening_at_mm: f64,
    /// Upper limit of the compression, mm.
    pub limit_mm: f64,
    /// Exponent that determines the sharpness of the transition to the limit.
    pub limit_exponent: f64,
}

impl FoamGap {
    /// Compression according to the law for a linear compression, mm.
    pub fn apply(&self, linear_mm: f64) -> f64 {
        let t = linear_mm / self.softening_at_mm;
        let soft = linear_mm * (1.0 + self.softening * (t * (1.0 - t).exp() - 0.5));
        let bent = 1.0 + (soft / self.limit_mm).powf(self.limit_exponent);
        soft / bent.powf(1.0 / self.limit_exponent)
    }
}

/// Deviations of the electrodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElectrodesGap {
    /// Standard deviation of the displacement per axis, mm.
    pub offset_sd_mm: f64,
    /// Contact resistance, ohm.
    pub contact_ohm: f64,
    /// Median resistance of a lead, ohm.
    pub lead_ohm: f64,
    /// Standard deviation of the logarithm of the lead resistance.
    pub lead_ln_sd: f64,
    /// Radius around each electrode within which the foam is softer, mm.
    pub soft_radius_mm: f64,
    /// Relative increase of the compliance there.
    pub soft_compliance: f64,
    /// Number of loose electrodes.
    pub loose: u32,
    /// Additional resistance in the lead of a loose electrode, ohm.
    pub loose_ohm: f64,
}

/// Deviations of the tips.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TipsGap {
    /// Standard deviation of the tilt per axis: a vertex in direction n carries (1 + t.n) / 6 of
    /// the force.
    pub tilt_sd: f64,
}

/// Drift and noise of the output.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReadoutGap {
    /// Standard deviation of the drift of ln a, as a gain.
    pub ln_a_drift_sd: f64,
    /// Correlation time of that drift, s.
    pub ln_a_drift_time_s: f64,
    /// Standard deviation of the drift of the gain.
    pub gain_drift_sd: f64,
    /// Correlation time of that drift, s.
    pub gain_drift_time_s: f64,
    /// Standard deviation of the fixed offset of a channel, mV.
    pub offset_sd_mv: f64,
    /// Standard deviation of the noise of one reading, mV.
    pub noise_sd_mv: f64,
    /// Relative growth of the signal of a held load per decade of seconds.
    pub creep_per_decade: f64,
}

/// Forces of the tips as functions of the stage's depth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MechanicsGap {
    /// Mean travel at which a tip reaches 5 N, mm.
    pub travel_to_5_n_mm: f64,
    /// Height above the surface found by touch-off at which that travel starts, mm.
    pub travel_starts_above_mm: f64,
    /// Standard deviation between configurations, mm.
    pub configuration_sd_mm: f64,
    /// Standard deviation between tips, mm.
    pub tip_sd_mm: f64,
    /// Correlation length of these deviations, mm.
    pub flatness_correlation_mm: f64,
    /// Additional travel of each tip before contact, mm.
    pub tip_offsets_mm: [f64; 6],
    /// Length of the soft toe, up to 5 N, mm.
    pub toe_mm: f64,
    /// Exponent of the toe: 5 N (s / toe)^exponent.
    pub toe_exponent: f64,
    /// Slope after the toe, N/mm.
    pub slope_n_per_mm: f64,
    /// Relative decrease of the force while unloading.
    pub unloading_softer: f64,
}

impl Gap {
    /// Parses and checks the text of a gap file.
    ///
    /// # Errors
    /// `GapError` for the first problem.
    pub fn from_toml(text: &str) -> Result<Self, GapError> {
        let gap: Self = toml::from_str(text)?;
        gap.check()?;
        Ok(gap)
    }

    fn check(&self) -> Result<(), ValueError> {
        for (key, value) in keyed!(self,
            fields: ln_a_sd, ln_a_white_sd, ln_b_sd, ln_c_sd, ln_compliance_sd, ln_sheet_sd;
            foam: softening; electrodes: offset_sd_mm, lead_ohm, lead_ln_sd, soft_radius_mm,
                soft_compliance, loose_ohm; tips: tilt_sd;
            readout: ln_a_drift_sd, gain_drift_sd, offset_sd_mv, noise_sd_mv, creep_per_decade;
            mechanics: travel_starts_above_mm, configuration_sd_mm, tip_sd_mm)
        {
            require(key, value, value >= 0.0, "must be a number >= 0")?;
        }
        let lengths_mm = &self.fields.correlation_mm;
        let mut positive = Vec::from(keyed!(self,
            foam: softening_at_mm, limit_mm, limit_exponent; electrodes: contact_ohm;
            readout: ln_a_drift_time_s, gain_drift_time_s; mechanics: travel_to_5_n_mm,
                flatness_correlation_mm, toe_mm, toe_exponent, slope_n_per_mm));
        positive.push(("fields.correlation_mm, count", lengths_mm.len() as f64));
        positive.extend(lengths_mm.iter().map(|&l| ("fields.correlation_mm", l)));
        for (key, value) in positive {
            require(key, value, value > 0.0, "must be a number > 0")?;
        }
        for value in self.mechanics.tip_offsets_mm {
            require("mechanics.tip_offsets_mm", value, true, "must be numbers")?;
        }
        let share = self.mechanics.unloading_softer;
        let ok = (0.0..1.0).contains(&share);
        require("mechanics.unloading_softer", share, ok, "must be in [0, 1)")
    }
}
