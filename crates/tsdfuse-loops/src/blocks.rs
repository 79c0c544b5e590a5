//! Sparse symmetric systems of 6×6 blocks, solved by Cholesky's factorization.
//!
//! Unknowns are eliminated in the order of their degree, the smallest first (Tinney & Walker, 1967), so a long chain with few closures stays
//! sparse. Everything happens on one thread, in one order.

use std::collections::BTreeSet;

use nalgebra::{Matrix6, Vector6};

/// What an elimination does, which depends only on which blocks there are: for all systems with the same ones.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    /// Where each unknown stands in the order of elimination.
    place: Vec<u32>,
    /// The unknown at each place.
    order: Vec<u32>,
    /// Of each place: where its column of blocks begins. Each column starts with its diagonal block.
    starts: Vec<usize>,
    /// The places of all blocks below the diagonal, column by column, ascending; the diagonal's own place first.
    rows: Vec<u32>,
}

impl Plan {
    /// For `unknowns`, of which these pairs have a block in common.
    pub(crate) fn new(unknowns: usize, pairs: impl IntoIterator<Item = (usize, usize)>) -> Self {
        let mut neighbours = vec![BTreeSet::new(); unknowns];
        for (a, b) in pairs {
            if a != b {
                neighbours[a].insert(b as u32);
                neighbours[b].insert(a as u32);
            }
        }
        let mut queue: BTreeSet<(usize, u32)> = neighbours
            .iter()
            .enumerate()
            .map(|(i, n)| (n.len(), i as u32))
            .collect();
        let (mut place, mut order) = (vec![0; unknowns], Vec::with_capacity(unknowns));
        let mut columns = Vec::with_capacity(unknowns);
        while let Some((_, next)) = queue.pop_first() {
            place[next as usize] = order.len() as u32;
            order.push(next);
            let around = std::mem::take(&mut neighbours[next as usize]);
            // What remains of them is connected now.
            for &a in &around {
                let own = &mut neighbours[a as usize];
                queue.remove(&(own.len(), a));
                own.remove(&next);
                own.extend(around.iter().filter(|&&b| b != a));
                queue.insert((own.len(), a));
            }
            columns.push(around);
        }
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for (at, column) in columns.into_iter().enumerate() {
            let mut below: Vec<u32> = column.into_iter().map(|unknown| place[unknown as usize]).collect();
            below.sort_unstable();
            rows.push(at as u32);
            rows.extend(below);
            starts.push(rows.len());
        }
        Self {
            place,
            order,
            starts,
            rows,
        }
    }

    fn column(&self, at: usize) -> std::ops::Range<usize> {
        self.starts[at]..self.starts[at + 1]
    }

    /// A system without any sums.
    pub(crate) fn system(&self) -> System<'_> {
        System {
            plan: self,
            blocks: vec![Matrix6::zeros(); self.rows.len()],
        }
    }
}

/// The lower half of a symmetric matrix of 6×6 blocks.
#[derive(Clone, Debug)]
pub(crate) struct System<'a> {
    plan: &'a Plan,
    blocks: Vec<Matrix6<f64>>,
}

impl System<'_> {
    /// Adds to the block of two unknowns (row, column), of which the plan knows.
    pub(crate) fn add(&mut self, row: usize, column: usize, block: &Matrix6<f64>) {
        let (r, c) = (self.plan.place[row], self.plan.place[column]);
        let (at, below) = (r.min(c) as usize, r.max(c));
        let range = self.plan.column(at);
        if let Ok(found) = self.plan.rows[range.clone()].binary_search(&below) {
            let own = &mut self.blocks[range.start + found];
            if r >= c {
                *own += block;
            } else {
                *own += block.transpose();
            }
        }
    }

    /// Multiplies the diagonal by `1 + share`, and adds a little.
    pub(crate) fn damp(&mut self, share: f64) {
        for at in 0..self.plan.order.len() {
            let block = &mut self.blocks[self.plan.starts[at]];
            for i in 0..6 {
                block[(i, i)] += share * block[(i, i)] + 1e-12;
            }
        }
    }

    /// `x` with `self · x = b`; `None` unless the matrix is positive definite.
    pub(crate) fn solve(mut self, b: &[Vector6<f64>]) -> Option<Vec<Vector6<f64>>> {
        let plan = self.plan;
        let n = plan.order.len();
        for at in 0..n {
            let range = plan.column(at);
            let diagonal = self.blocks[range.start].cholesky()?.unpack();
            self.blocks[range.start] = diagonal;
            for k in range.start + 1..range.end {
                // L_rk = A_rk L_kk⁻ᵀ
                let turned = diagonal.solve_lower_triangular(&self.blocks[k].transpose())?;
                self.blocks[k] = turned.transpose();
            }
            for s in range.start + 1..range.end {
                let right = self.blocks[s].transpose();
                let mut there = plan.starts[plan.rows[s] as usize];
                for r in s..range.end {
                    // Whatever lies below in this column has a block there, too.
                    while plan.rows[there] != plan.rows[r] {
                        there += 1;
                    }
                    let product = self.blocks[r] * right;
                    self.blocks[there] -= product;
                }
            }
        }
        let mut x: Vec<Vector6<f64>> = plan.order.iter().map(|&unknown| b[unknown as usize]).collect();
        for at in 0..n {
            let range = plan.column(at);
            x[at] = self.blocks[range.start].solve_lower_triangular(&x[at])?;
            for k in range.start + 1..range.end {
                let less = self.blocks[k] * x[at];
                x[plan.rows[k] as usize] -= less;
            }
        }
        for at in (0..n).rev() {
            let range = plan.column(at);
            let mut sum = x[at];
            for k in range.start + 1..range.end {
                sum -= self.blocks[k].tr_mul(&x[plan.rows[k] as usize]);
            }
            x[at] = self.blocks[range.start].tr_solve_lower_triangular(&sum)?;
        }
        Some(plan.place.iter().map(|&at| x[at as usize]).collect())
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;

    #[test]
    fn a_sparse_system_has_the_solution_of_the_dense_one() {
        let n = 40;
        let mut pairs: Vec<(usize, usize)> = (1..n).map(|i| (i - 1, i)).collect();
        pairs.extend([(3, 30), (31, 5), (0, 39), (12, 33), (13, 33)]);
        let plan = Plan::new(n, pairs.iter().copied());
        let mut state = 1_u32;
        let mut random = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24) - 0.5
        };
        let (mut system, mut dense) = (plan.system(), DMatrix::zeros(6 * n, 6 * n));
        for (a, b) in pairs {
            let (ja, jb) = (Matrix6::from_fn(|_, _| random()), Matrix6::from_fn(|_, _| random()));
            let mut add = |r: usize, c: usize, m: Matrix6<f64>| {
                // Of two halves either may be named.
                if r >= c || (r + c).is_multiple_of(2) {
                    system.add(r, c, &m);
                }
                if r < c && (r + c).is_multiple_of(2) {
                    return;
                }
                let mut view = dense.fixed_view_mut::<6, 6>(6 * r, 6 * c);
                view += m;
            };
            add(a, a, ja.transpose() * ja);
            add(b, b, jb.transpose() * jb);
            let (low, high, m) = if a < b {
                (a, b, jb.transpose() * ja)
            } else {
                (b, a, ja.transpose() * jb)
            };
            add(high, low, m);
        }
        system.damp(0.1);
        for i in 0..6 * n {
            dense[(i, i)] += 0.1 * dense[(i, i)] + 1e-12;
        }
        dense.fill_upper_triangle_with_lower_triangle();
        let b: Vec<Vector6<f64>> = (0..n).map(|_| Vector6::from_fn(|_, _| random())).collect();
        let want = dense
            .cholesky()
            .unwrap()
            .solve(&DVector::from_iterator(6 * n, b.iter().flat_map(|v| v.iter().copied())));
        let got = system.solve(&b).unwrap();
        let got = DVector::from_iterator(6 * n, got.iter().flat_map(|v| v.iter().copied()));
        assert!((got - &want).norm() < 1e-9 * want.norm());
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_has_no_solution() {
        let plan = Plan::new(2, [(0, 1)]);
        let mut system = plan.system();
        system.add(0, 0, &Matrix6::identity());
        system.add(1, 0, &(Matrix6::identity() * 2.0));
        system.add(1, 1, &Matrix6::identity());
        assert!(system.solve(&[Vector6::zeros(); 2]).is_none());
    }
}
