//! Pictures: charts, error maps, models side by side.
//!
//! [`chart`] writes SVG and makes PNG of it, [`comparison`] draws one image's depth and error,
//! [`side_by_side`] the sheets of `bench figures`. Nothing here runs a model or measures.

pub mod chart;
pub mod comparison;
pub mod side_by_side;
