//! What a model gives.

/// One output tensor, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Output {
    /// Its name in the graph.
    pub name: String,
    /// Its dimensions.
    pub shape: Vec<usize>,
    /// Its values.
    pub data: Vec<f32>,
}
