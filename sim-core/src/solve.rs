//! The elastic solve: one sparse Cholesky factor, many right-hand sides.
//! Uses: faer's sparse LLT. Never: faer's thread pool (blocks are solved side by side instead, so
//! that the result does not depend on the number of threads).

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltError;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{CreationError, FaerError, SparseColMat};
use faer::{Conj, MatMut, Par, Side};

/// Why the elastic solve did not work.
#[derive(Debug, thiserror::Error)]
pub enum SolveError {
    /// The matrix could not be built.
    #[error("assembling the stiffness matrix: {0:?}")]
    Assemble(CreationError),
    /// The factor's structure could not be found.
    #[error("analysing the stiffness matrix: {0:?}")]
    Analyse(FaerError),
    /// The matrix is not positive definite: a material or a brick is unsound.
    #[error("factorising the stiffness matrix: {0:?}")]
    Factorise(LltError),
    /// Not enough memory for the factor.
    #[error("factorising the stiffness matrix: out of memory")]
    Memory,
}

/// A Cholesky factor of a symmetric positive definite matrix.
pub struct Factor {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
}

impl Factor {
    /// Factorises a matrix whose lower triangle is given.
    pub fn new(lower: &SparseColMat<usize, f64>) -> Result<Self, SolveError> {
        let symbolic = factorize_symbolic_cholesky(
            lower.symbolic(),
            Side::Lower,
            SymmetricOrdering::Amd,
            CholeskySymbolicParams::default(),
        )
        .map_err(SolveError::Analyse)?;
        let mut values = vec![0.0; symbolic.len_val()];
        let scratch =
            symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, faer::Spec::default());
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| SolveError::Memory)?;
        symbolic
            .factorize_numeric_llt(
                &mut values,
                lower.as_ref(),
                Side::Lower,
                Default::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                faer::Spec::default(),
            )
            .map_err(SolveError::Factorise)?;
        Ok(Self { symbolic, values })
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.symbolic.nrows()
    }

    /// Solves for `columns` right-hand sides in place (column-major, `unknowns * columns` values).
    pub fn solve(&self, block: &mut [f64], columns: usize) -> Result<(), SolveError> {
        let scratch = self.symbolic.solve_in_place_scratch::<f64>(columns, Par::Seq);
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| SolveError::Memory)?;
        LltRef::new(&self.symbolic, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(block, self.unknowns(), columns),
            Par::Seq,
            MemStack::new(&mut memory),
        );
        Ok(())
    }
}
