//! What can go wrong in a comparison.

/// The one error of this crate. Its message is one line.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EvalError {
    /// There are no triangles.
    #[error("the {0} has no triangles: is it a cloud of points?")]
    NoTriangles(&'static str),
    /// All triangles are degenerate or not finite.
    #[error("the {0} has no area: all its {1} triangles are degenerate or not finite")]
    NoArea(&'static str, usize),
    /// There are no points.
    #[error("the reference has no points")]
    NoPoints,
    /// All points are NaN, infinite or absurdly far away.
    #[error("none of the {0} points of the reference is finite and within 100 000 km of the origin")]
    NoFinitePoints(usize),
    /// A corner of a triangle is not a vertex.
    #[error("triangle {triangle} of the {of} has corner {corner}, but there are {vertices} vertices")]
    Corner {
        /// Which mesh.
        of: &'static str,
        /// The number of the triangle.
        triangle: usize,
        /// The number of the vertex.
        corner: u32,
        /// The number of vertices.
        vertices: usize,
    },
    /// Nearest neighbours are numbered with 32 bits.
    #[error("{0} points are more than can be numbered: take fewer samples, or each N-th scan")]
    TooManyPoints(usize),
    /// The crop or the reference's box leaves nothing.
    #[error("no part of the {of} lies within {within}")]
    NothingWithin {
        /// The mesh or the reference.
        of: &'static str,
        /// The box.
        within: String,
    },
    /// Every distance of a direction exceeds the protocol's limit.
    #[error(
        "all {points} distances from {direction} exceed {limit_m} m, beyond which this protocol leaves them out: is the reference of another place or unit?"
    )]
    AllLeftOut {
        /// The direction: from what to what.
        direction: &'static str,
        /// The number of points.
        points: usize,
        /// The limit.
        limit_m: f64,
    },
    /// A field of the protocol is out of range.
    #[error("{field} {wrong}")]
    Protocol {
        /// Its name.
        field: &'static str,
        /// What is wrong with it.
        wrong: String,
    },
}

/// Result with this crate's [`EvalError`].
pub type Result<T, E = EvalError> = std::result::Result<T, E>;
