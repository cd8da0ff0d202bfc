//! The elastic solve: one sparse Cholesky factor, many right-hand sides.
//! Uses: faer's sparse LLT and dense kernels. Never: faer's thread pool (blocks are solved in
//! parallel instead, so that the result does not depend on the number of threads).
//!
//! The factor's columns come in blocks ("supernodes"). Right-hand sides are stored row by row, so
//! that scattering a block's rows moves whole cache lines; on the way down, blocks that the load
//! does not reach are skipped. faer's own solve does neither, and takes three times as long here.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltError;
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::sparse::linalg::cholesky::supernodal::SupernodalLltRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{CreationError, FaerError, SparseColMat};
use faer::{Accum, Conj, MatMut, MatRef, Par, Side, Spec};

/// Why the elastic solve failed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum SolveError {
    #[error("assembling the stiffness matrix: {0:?}")]
    Assemble(CreationError),
    #[error("analysing the stiffness matrix: {0:?}")]
    Analyse(FaerError),
    /// The matrix is not positive definite: a material or a brick is invalid.
    #[error("factorising the stiffness matrix: {0:?}")]
    Factorise(LltError),
    #[error("factorising the stiffness matrix: out of memory")]
    Memory,
}

/// A Cholesky factor of a symmetric positive definite matrix.
pub struct Factor {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
}

impl Factor {
    /// Factorises a matrix whose upper triangle is given; unknowns are eliminated in their order.
    ///
    /// # Errors
    /// `SolveError` if the analysis or the factorisation fails, or memory is exhausted.
    pub fn new(upper: &SparseColMat<usize, f64>) -> Result<Self, SolveError> {
        let symbolic = factorize_symbolic_cholesky(
            upper.symbolic(),
            Side::Upper,
            SymmetricOrdering::Identity,
            CholeskySymbolicParams::default(),
        )
        .map_err(SolveError::Analyse)?;
        let mut values = vec![0.0; symbolic.len_val()];
        let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default());
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| SolveError::Memory)?;
        symbolic
            .factorize_numeric_llt(
                &mut values,
                upper.as_ref(),
                Side::Upper,
                Default::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                Spec::default(),
            )
            .map_err(SolveError::Factorise)?;
        Ok(Self { symbolic, values })
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.symbolic.nrows()
    }

    /// Solves for `columns` right-hand sides in place: row-major, `unknowns * columns` values.
    ///
    /// # Errors
    /// `SolveError::Memory` if memory is exhausted.
    pub fn solve(&self, block: &mut [f64], columns: usize) -> Result<(), SolveError> {
        match self.symbolic.raw() {
            SymbolicCholeskyRaw::Supernodal(symbolic) => {
                let factor = SupernodalLltRef::new(symbolic, &self.values);
                let mut remainder = Vec::new();
                for s in 0..symbolic.n_supernodes() {
                    down(factor, s, block, columns, &mut remainder);
                }
                for s in (0..symbolic.n_supernodes()).rev() {
                    up(factor, s, block, columns, &mut remainder);
                }
            }
            SymbolicCholeskyRaw::Simplicial(_) => {
                let scratch = self.symbolic.solve_in_place_scratch::<f64>(columns, Par::Seq);
                let mut memory = MemBuffer::try_new(scratch).map_err(|_| SolveError::Memory)?;
                LltRef::new(&self.symbolic, &self.values).solve_in_place_with_conj(
                    Conj::No,
                    MatMut::from_row_major_slice_mut(block, self.unknowns(), columns),
                    Par::Seq,
                    MemStack::new(&mut memory),
                );
            }
        }
        Ok(())
    }
}

/// One block of `L y = b`: its own unknowns, then their contributions to later ones.
fn down(
    factor: SupernodalLltRef<'_, usize, f64>,
    s: usize,
    x: &mut [f64],
    columns: usize,
    remainder: &mut Vec<f64>,
) {
    let supernode = factor.supernode(s);
    let size = supernode.val().ncols();
    let own = &mut x[supernode.start() * columns..][..size * columns];
    if own.iter().all(|&v| v == 0.0) {
        return;
    }
    let (diagonal, below) = supernode.val().split_at_row(size);
    let mut own = MatMut::from_row_major_slice_mut(own, size, columns);
    solve_lower_triangular_in_place(diagonal, own.as_mut(), Par::Seq);
    remainder.resize(below.nrows() * columns, 0.0);
    let taken = MatMut::from_row_major_slice_mut(remainder, below.nrows(), columns);
    matmul(taken, Accum::Replace, below, own.as_ref(), 1.0, Par::Seq);
    for (&row, taken) in supernode.pattern().iter().zip(remainder.chunks_exact(columns)) {
        for (x, taken) in x[row * columns..][..columns].iter_mut().zip(taken) {
            *x -= taken;
        }
    }
}

/// One block of `L' x = y`: the contributions of later unknowns, then its own.
fn up(
    factor: SupernodalLltRef<'_, usize, f64>,
    s: usize,
    x: &mut [f64],
    columns: usize,
    remainder: &mut Vec<f64>,
) {
    let supernode = factor.supernode(s);
    let size = supernode.val().ncols();
    let (diagonal, below) = supernode.val().split_at_row(size);
    remainder.clear();
    for &row in supernode.pattern() {
        remainder.extend_from_slice(&x[row * columns..][..columns]);
    }
    let later = MatRef::from_row_major_slice(remainder, below.nrows(), columns);
    let own = &mut x[supernode.start() * columns..][..size * columns];
    let mut own = MatMut::from_row_major_slice_mut(own, size, columns);
    matmul(own.as_mut(), Accum::Add, below.transpose(), later, -1.0, Par::Seq);
    solve_upper_triangular_in_place(diagonal.transpose(), own, Par::Seq);
}
