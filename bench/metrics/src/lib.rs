//! Evaluation protocols, per-image depth metrics, statistics, tables and leaderboards.
//!
//! The definitions are those of Godard et al.'s public evaluation of 2017, which the thesis
//! uses for its tables 3.1 to 3.3, with every legacy habit written out as a field of a
//! [`Protocol`]. The way through the crate:
//!
//! 1. [`protocol()`] names the rules, [`evaluate()`] scores one image under them;
//! 2. an [`ImageScore`] becomes a line of `rows.csv` ([`Row`]);
//! 3. [`tables`] and [`leaderboard`] are pure functions of such lines and of the thesis'
//!    own figures in [`published`].
//!
//! ```
//! use strat_metrics::tables::{self, Coverage, Source, ThesisTable};
//! use strat_metrics::{GroundTruth, KnownCamera, Row, RowContext, StereoCamera, evaluate, protocol};
//!
//! let rules = protocol("kitti2015").ok_or("no such protocol")?;
//! let calibration = StereoCamera { focal_px: 721.5377, baseline_m: 0.5327 };
//! let camera = KnownCamera { calibration, nominal_focal_px: Some(721.5377) };
//! let truth = GroundTruth::new((2, 1), &[20.0, 0.0], camera)?;
//! let context = RowContext {
//!     model: "mine".into(),
//!     protocol: rules.name.clone(),
//!     protocol_digest: rules.digest(),
//!     data_digest: "digest of the prepared set".into(),
//!     ..RowContext::default()
//! };
//! let scores = evaluate(&rules, &truth, &[9.7, 9.7])?;
//! let rows: Vec<Row> = scores
//!     .into_iter()
//!     .map(|score| Row::new(&context, "kitti2015/000000", score))
//!     .collect();
//! let coverage = Coverage { expected_images: 200, source: Source::Kitti };
//! let table = tables::build(ThesisTable::Table31, &rows, &coverage)?;
//! assert!(table.first_line().contains("1 of 200 images"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The crate reads and writes only through readers, writers and strings handed to it: it opens no
//! file and runs no model. Of the workspace it knows `strat-splits` alone, for what was recorded
//! together and how many images a test set has. Resizing a prediction to the size of the ground
//! truth is left to the caller.

pub mod baselines;
mod columns;
pub mod compare;
pub mod cues;
mod evaluate;
mod flip;
mod interval;
pub mod leaderboard;
mod logarithm;
mod metrics;
mod protocol;
pub mod published;
pub mod ranking;
pub mod rows;
pub mod statistics;
pub mod study;
mod sums;
pub mod tables;
mod thesis;

pub use columns::CsvError;
pub use evaluate::{
    Compared, ComparedPixel, EvaluateError, Fit, GroundTruth, ImageScore, Prediction, Scratch,
    TruthRows, evaluate, evaluate_depth, evaluate_measured, evaluate_prediction,
    evaluate_with_pixels,
};
pub use flip::flip_blend;
pub use metrics::{
    CropBox, FurtherMetric, FurtherMetrics, Metric, Metrics, benchmark_box, crop_box, d1_all,
    median,
};
pub use protocol::{
    Alignment, BenchmarkCrop, Camera, CameraError, Crop, D1Rule, GroundTruthKind, Group, Grouping,
    InfiniteDepth, KnownCamera, LogBase, PostProcessing, Protocol, ProtocolName, Resize,
    StereoCamera, Suffix, UnknownGroup, protocol, protocols,
};
pub use rows::{Row, RowContext};
pub use sums::{all_metrics, depth_metrics};
