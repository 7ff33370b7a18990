//! Times a model the way MLPerf's LoadGen does, and never one that predicts something else.
//!
//! Scenarios and rules follow LoadGen's definitions: *single stream* and *multi stream* send the
//! next query when the last has been answered (a query is one image, or one batch), *offline* has
//! all images at hand and is measured by throughput alone. A measurement ends when both the minimum
//! duration and the minimum number of queries are reached. The percentile `p` of `n` sorted
//! latencies is the one at the index `floor(n p / 100)`, counted from 0. There is a warm-up, which
//! is not counted.
//!
//! Two stages are timed: the session alone (tensor in, tensor out, copies included), and the way
//! from a file on disk to a map of the image's own size (read, decode, resize, run, upsample,
//! convert). Files are in the system's cache, as each has been read before.
//!
//! Before anything is timed, and once more after it, the predictions are held against those of the
//! accuracy path ([`crate::model::Model::predict`] in a session of its own); a difference above [`AGREEMENT`] is
//! an error and gives no row.
//!
//! Not here: LoadGen's server scenario, its power measurement and its statistical early stopping.

mod measure;
mod rows;
mod timing;

pub use measure::{
    AGREEMENT, Bench, ImageFile, Latencies, LatencyError, MAX_IMAGES, Measured, Minimum, WARM_UP,
    clock, percentile,
};
pub use rows::{FORMAT, HEADER, LatencyRow, Scenario, Stage, read_rows, table, write_rows};
pub use timing::{Timing, images_of_folder, images_of_set};
