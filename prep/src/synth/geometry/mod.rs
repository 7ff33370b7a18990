//! Shapes that rays meet, windows set into walls, and the street they stand on.
//!
//! Not here: what the shapes stand for (`objects`), where they stand (`world`), and the search
//! for the nearest one along a ray (`scene`).

pub(crate) mod recess;
pub(crate) mod shapes;
pub(crate) mod street;
