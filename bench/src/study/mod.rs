//! A study of several variants and seeds, from the folders that `train study` writes to the answer.
//!
//! [`folder`] finds the runs, [`measure`] takes the model of each finished one through the pipeline of
//! `bench --table`, into a folder of its own, once; [`write`](mod@write) makes tables, differences and the
//! answer of all rows, [`curves`] draws how the runs went, [`pictures`] what variants make of
//! the same images. What is said of rows is
//! [`crate::rows::study`]'s.

pub mod curves;
pub mod folder;
pub mod measure;
pub mod pictures;
pub mod write;

use std::path::PathBuf;

use crate::{
    evaluate::{request::RunError, write::WriteError},
    rows::{compare::CompareError, leaderboard::PublishError},
};

/// Why a study gives no answer.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// A file or folder cannot be used.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// No folder of `train study`.
    #[error(
        "{0} is not the folder of a study: it has no runs.csv; `train study STUDY.yaml --out {0}` makes one"
    )]
    NoStudy(PathBuf),
    /// A file of a study that is not as it should be.
    #[error("{path}: {reason}")]
    Unusable {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// Two folders have different models of one run.
    #[error("{name}: {first} has a model, and {second} another model; give one of them only")]
    TwoModels {
        /// The run.
        name: String,
        /// A folder of it.
        first: PathBuf,
        /// Another folder of it.
        second: PathBuf,
    },
    /// No run of the name or number.
    #[error("the study has no run {given}; its runs are, from 0 to {last}: {names}")]
    NoRun {
        /// What was asked for.
        given: String,
        /// The number of the last run.
        last: usize,
        /// All names.
        names: String,
    },
    /// Two sets whose results would share a folder.
    #[error("two of the sets are called {0}; their results would share a folder")]
    SetNames(String),
    /// No run is finished.
    #[error("no run of the study is finished: none has a model.onnx")]
    NothingFinished,
    /// A model cannot be measured.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Rows cannot be read.
    #[error(transparent)]
    Rows(#[from] CompareError),
    /// The record beside rows cannot be read.
    #[error(transparent)]
    Coverage(#[from] PublishError),
    /// Rows that do not make a study.
    #[error(transparent)]
    Study(#[from] strat_metrics::study::StudyError),
    /// Tables cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// CSV could not be formed.
    #[error(transparent)]
    Csv(#[from] strat_metrics::CsvError),
    /// Figures cannot be drawn.
    #[error(transparent)]
    Draw(#[from] crate::draw::png::DrawError),
}
