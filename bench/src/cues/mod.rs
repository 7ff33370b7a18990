//! Which pictorial depth cues a model uses: the experiments of the thesis' chapter 4.
//!
//! Sprites are pasted into pictures of a prepared set ([`backgrounds`], [`composite`], [`sprites`]) in
//! one of three experiments ([`experiments`], PROTOCOL 5.1 to 5.3): relative size, occlusion and
//! luminance contrast, height in the visual field. Any model that `bench` can run is asked about each
//! composite ([`measure`]); what it says ([`reader`]) becomes one row each ([`rows`]), and rows alone
//! make the statistics and words ([`summary`]) and the curves ([`curves`]). [`journal`] lets an
//! interrupted run go on; [`sheets`] shows composites; [`run`] is one run.
//!
//! Sprite depth is the median over what is opaque, eroded by 2 pixels; the same pixels of the
//! clean background are its reference. Models without a scale are judged by relative measures.
//! [`cutouts`] makes sprites of a labelled set's own objects.

pub mod backgrounds;
pub mod composite;
pub mod curves;
pub mod cutouts;
pub mod error;
pub mod experiments;
pub mod journal;
pub mod measure;
pub mod reader;
pub mod rows;
pub mod run;
pub mod sheets;
pub mod sprites;
pub mod summary;

pub use error::CueError;
