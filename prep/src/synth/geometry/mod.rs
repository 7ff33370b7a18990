//! Shapes that rays meet, and the street they stand on.

pub(crate) mod shapes;
pub(crate) mod street;
