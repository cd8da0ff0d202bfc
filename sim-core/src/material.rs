//! Isotropic linear elasticity: the stress of a strain.
//! Uses: nothing. Never: geometry.
//!
//! `s = D e` with Voigt order xx, yy, zz, xy, yz, zx and engineering shear strains, E in MPa (=
//! N/mm2). Valid for small strains; the foam's real law is far from it (paper III-A: 24 % error).

/// Elastic constants of an isotropic material.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Isotropic {
    /// Young's modulus, MPa.
    pub youngs_mpa: f64,
    /// Poisson's ratio, in [0, 0.5).
    pub poisson: f64,
}

impl Isotropic {
    /// Stiffness matrix D, MPa.
    pub fn stiffness_mpa(self) -> [[f64; 6]; 6] {
        let Self { youngs_mpa, poisson } = self;
        let lambda = youngs_mpa * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson));
        let shear = youngs_mpa / (2.0 * (1.0 + poisson));
        let mut d = [[0.0; 6]; 6];
        for i in 0..3 {
            d[i][..3].fill(lambda);
            d[i][i] += 2.0 * shear;
            d[i + 3][i + 3] = shear;
        }
        d
    }
}
