//! Pictures: SVG charts and sheets, colours of maps, and comparisons of a prediction with the truth.
//!
//! [`chart`], [`whiskers`] and [`sheet`] write plain SVG ([`svg`]) whose text stays text; [`png`] makes
//! PNG of that very SVG. [`colour`] and [`legend`] colour maps, [`comparison`] and [`side_by_side`]
//! draw what scoring compared, [`baselines`] the views at growing baselines. Nothing here predicts, scores or writes files.

pub mod baselines;
pub mod chart;
pub mod colour;
pub mod comparison;
pub mod legend;
pub mod png;
pub mod sheet;
pub mod side_by_side;
pub mod svg;
pub mod whiskers;
