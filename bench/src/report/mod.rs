//! One HTML page about the results below a folder.
//!
//! The page is a function of files that other commands have written: `rows.csv` and `run.yaml` of
//! [`crate::evaluate`] with the pictures beside them, `latency.csv` of [`crate::latency`],
//! `cues.csv` of [`crate::cues`] and `study-results.yaml` of [`crate::study`]. Figures, intervals and marks are those of the tables
//! ([`strat_metrics::tables`]); nothing is measured here. Rows of several runs over the same data
//! share their tables.
//!
//! Everything is within the page: style, one script that sorts tables, charts as SVG and small
//! JPEG pictures. Its content security policy lets it load nothing else. Without scripts it shows
//! the same, unsorted.
//!
//! Not here: choosing what is best or drawing maps; `bench --extremes N` makes the pictures of the
//! best and worst images.

mod builder;
mod charts;
mod collect;
mod cues;
mod data_set;
mod html;
mod images;
mod origin;
mod page;
mod speed;
mod study;
mod training;
mod verdict;

pub use collect::{Collected, CueResults, DataSet, ReportError, Run, collect};
pub use page::{BEGINS, Rendered, render};
pub use study::StudyResults;
